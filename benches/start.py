"""Processor time of whole processes: import, help, one calibration: `make bench`, docs/results/speed.md."""

import os
import statistics
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from compare import OTHERS, REPORT, XSENS, machine_name
from sections import write_section

ROUNDS = 11
# Processor times of other programs on the Xsens files, s; they are not built by this benchmark.
IMU_TK_S, IMU_CALIB_S = 0.32, 0.044
PEER = Path(__file__).with_name("scipy_process.py")


@dataclass(frozen=True)
class Process:
    """A command, and its largest time as a share of that of another command, or in ms."""

    name: str
    command: list[str]
    beside: str | None = None
    most: float | None = None
    most_ms: float | None = None


def processes() -> list[Process]:
    """The timed commands, the references first."""
    python, imucal = sys.executable, str(Path(sys.executable).with_name("imucal"))
    found = [
        Process("`import numpy`", [python, "-c", "import numpy"]),
        Process("`import imucal`", [python, "-c", "import imucal"], "`import numpy`", 1.5),
        Process("`imucal --help`", [python, imucal, "--help"], "`import numpy`", 1.0),
        Process("`imucal --version`", [python, imucal, "--version"], "`import numpy`", 1.0),
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
                0.3,
                250.0,
            ),
        ]
    return found


def median_ms(found: list[Process]) -> dict[str, float]:
    """Median processor times over interleaved rounds, all on one processor."""
    one = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    times: dict[str, list[float]] = {process.name: [] for process in found}
    for turn in range(ROUNDS + 1):
        for process in found:
            child = subprocess.Popen(process.command, stdout=subprocess.DEVNULL, env={**os.environ, **one})
            _, status, usage = os.wait4(child.pid, 0)
            if status:
                raise SystemExit(f"{process.name} ended with {status}")
            if turn > 0:  # the first round warms up
                times[process.name].append((usage.ru_utime + usage.ru_stime) * 1e3)
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
            is_met = times <= process.most and ms[process.name] <= (process.most_ms or ms[process.name])
            limit = f"{process.most:g}" + (f", and {process.most_ms:g} ms" if process.most_ms else "")
            cells = [
                f"{times:.2f} times {process.beside}",
                limit,
                "met" if is_met else "missed",
            ]
        rows.append(f"| {process.name} | {ms[process.name]:.0f} | {' | '.join(cells)} |")
    body = f"""
{machine_name()}, one used. Processor times (user and system) of whole processes, including the interpreter;
medians of {ROUNDS} interleaved rounds.

| | ms | is | at most | |
|---|---:|---|---:|---|
{chr(10).join(rows)}

For the same files, imu_tk takes {IMU_TK_S:g} s of processor time and imu-calib (Rust) {IMU_CALIB_S:g} s,
measured on another occasion. Both are compiled programs.
"""
    write_section(REPORT, "Speed", "Processes", body)


if __name__ == "__main__":
    main()
