"""Time from Ctrl-C to the end of each long command: `make signals`, to docs/results/signals.md."""

import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Final

import numpy as np
from rich.progress import track

import imucal
from sections import write_section

PAGE: Final = Path(__file__).parents[1] / "docs/results/signals.md"
COMMAND: Final = [sys.executable, "-m", "imucal"]
# Processor times of a command at which it is interrupted, s. A command that has ended before does not count.
WORKED_S: Final = (0.3, 0.5, 0.8, 1.2, 1.6, 2.0, 3.0)
LONG: Final = {
    "simulate": ["simulate", "random", "--moves=20000", "--rate-hz=400", "-o", "out.csv"],
    "convert": ["convert", "run.csv", "-o", "out.csv"],
    "inspect": ["inspect", "run.parquet"],
    "calibrate": ["calibrate", "run.parquet", "-o", "out.json"],
    "calibrate --report": ["calibrate", "run.parquet", "-o", "out.json", "--report", "out.html"],
    "calibrate --unit": ["calibrate", "shorter.parquet", "--unit=bmi088", "-o", "out.json"],
    "evaluate": ["evaluate", "calibration.json", "run.parquet"],
    "apply": ["apply", "calibration.json", "run.parquet", "-o", "out.csv"],
    "gap": ["gap", "run.parquet", "--control=control.parquet", "-o", "out.json"],
    "noise": ["noise", "still.parquet"],
    "plan": ["plan", "optimal", "--proposals=200000", "-o", "out.json"],
    "stand run": ["stand", "run", "random", "--driver=simulated", "--speed=1", "-o", "out.csv"],
}


def processor_s(pid: int) -> float:
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def interrupted(words: list[str], folder: Path, worked_s: float) -> tuple[float, float] | None:
    """Wall time and processor time from the signal to the end, s; None if the command ended before."""
    for file in folder.glob("out*"):
        file.unlink()
    with subprocess.Popen(
        [*COMMAND, *words], cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as process:
        while process.poll() is None and processor_s(process.pid) < worked_s:
            time.sleep(0.005)
        if process.poll() is not None:
            return None
        before_s, start_s = processor_s(process.pid), time.monotonic()
        process.send_signal(signal.SIGINT)
        _, _, usage = os.wait4(process.pid, 0)
        process.returncode = 0
        return time.monotonic() - start_s, usage.ru_utime + usage.ru_stime - before_s


def prepare(folder: Path) -> None:
    def stand(seed: int, moves: int) -> imucal.Recording:
        program = imucal.Program.random(seed=seed, moves=moves, hold_s=2.0)
        return imucal.simulate(program, seed=seed, unit="bmi088", rate_hz=400.0).recording

    run, control = stand(1, 1000), stand(2, 100)
    imucal.write(run, folder / "run.parquet")
    # The varying biases of a unit's profile are taken into account for up to 6,000 residuals.
    imucal.write(stand(4, 600), folder / "shorter.parquet")
    imucal.write(control, folder / "control.parquet")
    imucal.write(control, folder / "run.csv")
    imucal.calibrate(control).calibration.save(folder / "calibration.json")
    still = imucal.simulate(imucal.Static(3600.0), seed=3, unit="bmi088", rate_hz=400.0).recording
    imucal.write(still, folder / "still.parquet")


def main() -> None:
    rows = []
    signal.signal(signal.SIGINT, signal.default_int_handler)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepare(folder)
        for command, words in track(LONG.items(), "interrupting", total=len(LONG)):
            tried = [interrupted(words, folder, worked_s) for worked_s in WORKED_S]
            taken = np.array([times for times in tried if times is not None])
            if len(taken) == 0:
                rows.append(f"| {command} | 0 | - | - | - |")
                continue
            wall, processor = taken.T
            rows.append(
                f"| {command} | {len(taken)} | {np.median(wall):.2f} | {wall.max():.2f} "
                f"| {processor.max():.2f} |"
            )
    load = os.getloadavg()[0]
    body = f"""
Written by `make signals`. Each command is interrupted after {", ".join(f"{s:g}" for s in WORKED_S)} s of
processor time, unless it has ended. Time from the signal to the end of the process, s. The computer has
{os.cpu_count()} processors and had a load of {load:.1f} at the end; with a load above its number of
processors, a process waits for most of the wall time.

| command | interrupted | median, s | longest, s | longest, processor time, s |
|---|---:|---:|---:|---:|
{chr(10).join(rows)}
"""
    write_section(PAGE, "Signals", "Time from Ctrl-C to the end of a command", body)


if __name__ == "__main__":
    main()
