"""Duration of whole processes: import, help, one calibration. `make bench`, to docs/results/speed.md."""

import os
import statistics
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from compare import OTHERS, REPORT, XSENS, machine_name
from sections import write_section

ROUNDS = 11
PEER = Path(__file__).with_name("scipy_process.py")


@dataclass(frozen=True)
class Process:
    """A command, and its largest time as a share of that of another command."""

    name: str
    command: list[str]
    beside: str | None = None
    most: float | None = None


def processes() -> list[Process]:
    """The timed commands, the references first."""
    python, imucal = sys.executable, str(Path(sys.executable).with_name("imucal"))
    found = [
        Process("`import numpy`", [python, "-c", "import numpy"]),
        Process("`import imucal`", [python, "-c", "import imucal"], "`import numpy`", 1.5),
        Process("`imucal --help`", [python, imucal, "--help"], "`import numpy`", 3.0),
    ]
    if XSENS.is_dir() and OTHERS.is_file():
        files = [str(XSENS / "xsens_acc.mat"), str(XSENS / "xsens_gyro.mat")]
        options = ["--format", "imu_tk", "--gravity", "9.81744"]
        scipy = "SciPy program on the Xsens files"
        found += [
            Process(scipy, [python, str(PEER), str(OTHERS), *files]),
            Process(
                "`imucal calibrate` on the Xsens files",
                [python, imucal, "calibrate", *files, *options],
                scipy,
                0.5,
            ),
        ]
    return found


def median_ms(found: list[Process]) -> dict[str, float]:
    """Median times over interleaved rounds, all on one processor."""
    one = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    times: dict[str, list[float]] = {process.name: [] for process in found}
    for turn in range(ROUNDS + 1):
        for process in found:
            start = time.perf_counter()
            subprocess.run(process.command, check=True, stdout=subprocess.DEVNULL, env={**os.environ, **one})
            if turn > 0:  # the first round warms up
                times[process.name].append((time.perf_counter() - start) * 1e3)
    return {name: statistics.median(values) for name, values in times.items()}


def main() -> None:
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    found = processes()
    ms = median_ms(found)
    rows = []
    for process in found:
        cells = ["", "", ""]
        if process.beside is not None and process.most is not None:
            times = ms[process.name] / ms[process.beside]
            cells = [
                f"{times:.2f} times {process.beside}",
                f"{process.most:g}",
                "met" if times <= process.most else "missed",
            ]
        rows.append(f"| {process.name} | {ms[process.name]:.0f} | {' | '.join(cells)} |")
    body = f"""
{machine_name()}, one used. Times of whole processes, including the interpreter; medians of {ROUNDS}
interleaved rounds.

| | ms | is | at most | |
|---|---:|---|---:|---|
{chr(10).join(rows)}
"""
    write_section(REPORT, "Speed", "Processes", body)


if __name__ == "__main__":
    main()
