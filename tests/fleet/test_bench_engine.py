"""The engine of the benchmarks: killed runs go on, a killed worker loses nothing, and errors are said."""

import os
import signal
import subprocess
import sys
import time

import pytest

from children import HANGS_S
from engine import Engine
from imucal.fleet.local import LocalPool

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="processes are killed and found by /proc"),
]
CALLS = 40
# Appends a line to a file for each call, as a benchmark's main program.
PROGRAM = """
import sys, time
from pathlib import Path
from engine import Engine
from imucal.fleet.local import LocalPool

def square(number):
    with Path(folder, "calls").open("a") as file:
        file.write(f"{number}\\n")
    time.sleep(0.02)
    return number * number

folder = sys.argv[1]
with Engine(lambda: LocalPool(2), Path(folder, "log.sqlite")) as engine:
    print(sum(engine.map(square, range(CALLS), name="square", per_task=2)))
""".replace("CALLS", str(CALLS))


def calls(folder):
    path = folder / "calls"
    return [int(line) for line in path.read_text().split()] if path.exists() else []


def test_a_killed_benchmark_goes_on(tmp_path):
    words = [sys.executable, "-c", PROGRAM, str(tmp_path)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    first = subprocess.Popen(words, stdout=subprocess.DEVNULL, env=environment)
    end_s = time.monotonic() + HANGS_S
    while len(calls(tmp_path)) < CALLS // 2 and first.poll() is None and time.monotonic() < end_s:
        time.sleep(0.005)
    first.send_signal(signal.SIGKILL)
    assert first.wait(HANGS_S) == -signal.SIGKILL
    before = len(calls(tmp_path))
    done = subprocess.run(words, capture_output=True, text=True, check=True, env=environment)
    assert done.stdout.split() == [str(sum(number * number for number in range(CALLS)))]
    # Only the tasks that were in the processes are computed again: two calls in each of four tasks.
    assert set(calls(tmp_path)) == set(range(CALLS))
    assert before < CALLS
    assert len(calls(tmp_path)) <= CALLS + 8
    third = len(calls(tmp_path))
    subprocess.run(words, capture_output=True, check=True, env=environment)
    assert len(calls(tmp_path)) == third


def ends_once(path):
    if not path.exists():
        path.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "answer"


def test_a_killed_worker_is_replaced_and_an_error_is_said(tmp_path):
    with Engine(lambda: LocalPool(1), None) as engine:
        assert list(engine.map(ends_once, [tmp_path / "was-here"], name="once")) == ["answer"]
        with pytest.raises(SystemExit, match=r"(?s)division 0.*ZeroDivisionError"):
            list(engine.map(lambda number: 1 / number, [0], name="division"))
