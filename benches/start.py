"""Processor time of whole processes: import, help, one calibration: `make bench`, docs/results/speed.md."""

import os
import statistics
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import comparison
from compare import OTHERS, REPORT, XSENS
from sections import machine_name, write_section

ROUNDS = 11
# Processor time of imu_tk on the Xsens files, s; it is not built by this benchmark.
IMU_TK_S = 0.32
PEER = Path(__file__).with_name("scipy_process.py")


@dataclass(frozen=True)
class Process:
    """A command, and its largest time as a share of that of another command, or in ms."""

    name: str
    command: list[str]
    beside: str | None = None
    most: float | None = None
    most_ms: float | None = None
    stdin: Path | None = None


def imu_calib(folder: Path) -> Process:
    """The crate imu-calib on the Xsens recording in SI units, which it needs; it is compiled here."""
    target = comparison.ROOT / "target" / "peers"
    os.environ["CARGO_TARGET_DIR"] = str(target)
    subprocess.run(["cargo", "build", "--quiet", "--release"], cwd=comparison.PEER, check=True)
    path = folder / "xsens.f64"
    recording = comparison.xsens()
    np.column_stack([recording.time_s, recording.specific_force, recording.angular_rate]).tofile(path)
    # Rests are found with the first 40 s, which are at rest; one calibration instead of a median of nine.
    command = [str(target / "release" / "peer-imu-calib"), repr(comparison.XSENS_GRAVITY_MPS2), "40", "1"]
    return Process("imu-calib 0.3.1 (Rust) on the Xsens recording as binary numbers", command, stdin=path)


def processes(folder: Path) -> list[Process]:
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
            imu_calib(folder),
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
    # Installed packages have bytecode; with this variable the sources would be compiled in each process.
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    times: dict[str, list[float]] = {process.name: [] for process in found}
    for turn in range(ROUNDS + 1):
        for process in found:
            with (process.stdin or Path(os.devnull)).open("rb") as stdin:
                child = subprocess.Popen(
                    process.command, stdin=stdin, stdout=subprocess.DEVNULL, env={**environment, **one}
                )
            _, status, usage = os.wait4(child.pid, 0)
            if status:
                raise SystemExit(f"{process.name} ended with {status}")
            if turn > 0:  # the first round warms up
                times[process.name].append((usage.ru_utime + usage.ru_stime) * 1e3)
    return {name: statistics.median(values) for name, values in times.items()}


def main() -> None:
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    with tempfile.TemporaryDirectory() as name:
        found = processes(Path(name))
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

For the same files, imu_tk (C++) takes {IMU_TK_S:g} s of processor time, measured on another occasion.
imu-calib reads no text and computes no standard deviations.
"""
    write_section(REPORT, "Speed", "Processes", body)


if __name__ == "__main__":
    main()
