"""Ctrl-C and SIGTERM end a command that calculates, and an array that changes meanwhile crashes nothing."""

import contextlib
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import imucal
from children import heed_signals

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the time of a child is read from /proc")

COMMAND = Path(sys.executable).with_name("imucal")
# Only a command that hangs takes this long, s; one that calculates ends within half a second.
HANGS_S = 300.0
# Processor time after which a command has loaded its modules and calculates, s.
WORKS_S = 1.5
# Size of a journal with a header of 6 kB and about a second of samples.
JOURNAL_BYTES = 30_000
ENDLESS = ["plan", "optimal", "--proposals", "2000000000", "-o"]


def processor_s(process):
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / 100.0


def interrupted(words, number, works_s=WORKS_S, journal=None):
    """Run a command, and send a signal when it has calculated for `works_s`; exit code, standard error.

    journal  file of samples whose first second shows as well that the command works
    """

    def works():
        has_samples = journal is not None and journal.exists() and journal.stat().st_size > JOURNAL_BYTES
        return has_samples or processor_s(process) >= works_s

    process = subprocess.Popen(
        words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=heed_signals
    )
    end_s = time.monotonic() + HANGS_S
    while process.poll() is None and not works() and time.monotonic() < end_s:
        time.sleep(0.02)
    process.send_signal(number)
    try:
        _, shown = process.communicate(timeout=HANGS_S)
    finally:
        process.kill()
    return process.returncode, shown


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "code", "what"),
    [(signal.SIGINT, 130, "interrupted"), (signal.SIGTERM, 143, "ended by SIGTERM")],
)
def test_a_command_that_calculates_is_ended(tmp_path, number, code, what):
    output = tmp_path / "program.json"
    output.write_text("old")
    assert interrupted([COMMAND, *ENDLESS, output], number) == (
        code,
        f"imucal: {what}, no file is incomplete\n",
    )
    assert output.read_text() == "old"
    assert list(tmp_path.iterdir()) == [output]


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    """Recordings that take a command more than a second: in motion, at rest, as text, a control run."""
    folder = tmp_path_factory.mktemp("long")

    def stand(seed, moves):
        program = imucal.Program.random(seed=seed, moves=moves, hold_s=2.0)
        return imucal.simulate(program, seed=seed, unit="bmi088", rate_hz=400.0).recording

    imucal.write(stand(1, 500), folder / "run.parquet")
    control = stand(2, 60)
    imucal.write(control, folder / "control.parquet")
    imucal.write(control, folder / "run.csv")
    still = imucal.simulate(imucal.Static(1800.0), seed=3, unit="bmi088", rate_hz=400.0).recording
    imucal.write(still, folder / "still.parquet")
    return folder


LONG = {
    "simulate": ["simulate", "random", "--moves=5000", "--rate-hz=400", "-o", "OUT.csv"],
    "convert": ["convert", "run.csv", "-o", "OUT.csv"],
    "inspect": ["inspect", "run.parquet"],
    "calibrate": ["calibrate", "run.parquet", "-o", "OUT.json"],
    "report": ["calibrate", "control.parquet", "-o", "OUT.json", "--report", "OUT.html"],
    "gap": ["gap", "run.parquet", "--control", "control.parquet", "-o", "OUT.json"],
    "noise": ["noise", "still.parquet"],
    "stand": ["stand", "run", "random", "--driver=simulated", "--speed=1", "-o", "OUT.csv"],
}


@pytest.mark.slow
@pytest.mark.parametrize("name", LONG)
def test_ctrl_c_leaves_no_part_of_a_file(recordings, tmp_path, name):
    """At several times of a run, until one of them is before its end."""
    words = [str(tmp_path / word) if word.startswith("OUT.") else word for word in LONG[name]]
    words = [str(recordings / word) if (recordings / word).is_file() else word for word in words]
    for works_s in (1.0, 0.6, 0.4, 0.25):
        # A run of the stand mostly waits.
        code, shown = interrupted([COMMAND, *words], signal.SIGINT, works_s, tmp_path / "OUT.csv.journal")
        if code == 130:
            break
        # At the very end of a process Python no longer handles the signal.
        assert code in (0, 2, -signal.SIGINT), shown
        for file in tmp_path.iterdir():
            file.unlink()
    assert code == 130, shown
    assert "interrupted" in shown
    # A run of the stand keeps its journal, from which `imucal stand recover` makes a recording.
    left = [file for file in tmp_path.iterdir() if "journal" not in file.name]
    if name in ("calibrate", "report"):
        # The calibration is complete before the report is begun, and before the result is printed.
        assert [file.name for file in left] in ([], ["OUT.json"])
        assert all(imucal.Calibration.load(file) for file in left)
    elif name == "convert" and left:
        # The file is complete before the summary is printed. It never has a part of the samples only.
        assert len(imucal.read(left[0])) == len(imucal.read(recordings / "run.csv"))
    else:
        assert left == []


@pytest.mark.slow
def test_a_function_raises_the_exception_of_the_handler():
    program = (
        "import signal, imucal\n"
        "class Stop(Exception): pass\n"
        "def stop(*_): raise Stop\n"
        "signal.signal(signal.SIGUSR1, stop)\n"
        "try: imucal.plan('optimal', proposals=2_000_000_000)\n"
        "except Stop: print('stopped'); raise SystemExit(7)"
    )
    assert interrupted([sys.executable, "-c", program], signal.SIGUSR1) == (7, "")


def test_arrays_that_another_thread_changes():
    """The result is of no use, but it is a result or an ImucalError."""
    run = imucal.simulate(imucal.Program.random(seed=1, moves=12), rate_hz=50.0, seed=1).recording
    arrays = [np.array(array) for array in (run.time_s, run.specific_force, run.angular_rate)]
    recording = imucal.Recording(*arrays)
    # Recording makes its own view read-only; the array of the caller can still be written.
    is_done = threading.Event()

    def change():
        chance = np.random.default_rng(1)
        while not is_done.is_set():
            for array in arrays[1:]:
                rows = chance.integers(0, len(array), 50)
                array[rows] = chance.choice([np.nan, 0.0, 1e300, -9.8, np.inf, 3.0], (50, 3))

    writer = threading.Thread(target=change)
    writer.start()
    try:
        for work in (imucal.inspect, imucal.calibrate, imucal.noise) * 4:
            with contextlib.suppress(imucal.ImucalError):
                work(recording)
            for array, original in zip(
                arrays, (run.time_s, run.specific_force, run.angular_rate), strict=True
            ):
                array[:] = original
    finally:
        is_done.set()
        writer.join()
