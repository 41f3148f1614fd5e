"""Tests of one group run in one process, so that costly fixtures of a module are made once."""

import subprocess
import sys

TESTS = """
import os
import pytest

@pytest.mark.xdist_group("one")
@pytest.mark.parametrize("number", range(8))
def test_process(number):
    with open("processes.txt", "a") as file:
        file.write(os.environ["PYTEST_XDIST_WORKER"] + " ")
"""


def test_a_group_runs_in_one_process(tmp_path):
    (tmp_path / "test_group.py").write_text(TESTS)
    options = ["-q", "-p", "no:cacheprovider", "--numprocesses", "2", "--dist", "loadgroup"]
    done = subprocess.run(
        [sys.executable, "-m", "pytest", *options], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout
    processes = (tmp_path / "processes.txt").read_text().split()
    assert len(processes) == 8 and len(set(processes)) == 1
