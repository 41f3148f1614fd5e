"""The script for the line: its exit code is never better than what became of the file."""

import os
import subprocess
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "examples/production_line.sh"


@pytest.mark.skipif(os.name == "nt", reason="there is no sh")
@pytest.mark.parametrize("code", [0, 2])
def test_a_file_that_cannot_be_moved_is_no_verdict(code, tmp_path):
    # An imucal that says so, and writes nothing.
    (tmp_path / "imucal").write_text(f"#!/bin/sh\nexit {code}\n")
    (tmp_path / "imucal").chmod(0o755)
    environment = {**os.environ, "PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}"}
    given = ["sh", SCRIPT, "0042", "run.csv", "control.csv"]
    done = subprocess.run(given, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (1, "")
