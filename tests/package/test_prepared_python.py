"""Programs in a prepared process behave as in a new one: arguments, streams, folder, environment, and end."""

import os
import signal
import subprocess
import sys

import pytest

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="programs are the installed ones")

SURROUNDINGS = """
import json, os, sys
print(json.dumps({
    "argv": sys.argv, "first": sys.path[0], "folder": os.getcwd(), "name": __name__, "read": sys.stdin.read(),
    "environment": dict(os.environ), "seekable": sys.stdout.seekable(), "encoding": sys.stdout.encoding,
    "errors": sys.stderr.errors, "lines": [sys.stdout.line_buffering, sys.stderr.line_buffering],
    "through": sys.stdout.write_through,
}, sort_keys=True))
print("to stderr", file=sys.stderr)
"""


def both(programs, *words, **options):
    """What a prepared process and a new one say, and how they end."""
    options = {"capture_output": True, "text": True, **options}
    return [
        (done.returncode, done.stdout, done.stderr)
        for python in (programs / "python", sys.executable)
        for done in [subprocess.run([python, *words], **options)]
    ]


@pytest.mark.parametrize("given", ["-c", "script.py"])
def test_surroundings_are_those_of_a_new_process(programs, tmp_path, given):
    (tmp_path / "script.py").write_text(SURROUNDINGS)
    words = ["-c", SURROUNDINGS, "a b", "é"] if given == "-c" else [given, "a b", "é"]
    prepared, new = both(programs, *words, cwd=tmp_path, input="some\ntext", env={**os.environ, "PWD": "x"})
    assert prepared == new
    assert prepared[0] == 0
    assert '"some\\ntext"' in prepared[1]


@pytest.mark.parametrize(
    "program",
    [
        "import sys; sys.exit(3)",
        "import sys; sys.exit('said')",
        "import os, signal; os.kill(os.getpid(), signal.SIGTERM)",
        "import atexit; atexit.register(print, 'last')",
        "import threading as t; t.Thread(target=lambda: (t.main_thread().join(), print('later'))).start()",
        "import sys; sys.exit(259)",
    ],
)
def test_it_ends_as_a_new_process(programs, program):
    prepared, new = both(programs, "-c", program)
    assert prepared == new


def test_a_signal_that_kills_is_passed_on(programs):
    program = "import os; os.kill(os.getpid(), 9)"
    assert subprocess.run([programs / "python", "-c", program]).returncode == -signal.SIGKILL


def test_output_goes_to_files_and_pipes(programs, tmp_path):
    path = f"{programs}{os.pathsep}{os.environ['PATH']}"
    line = (
        "python -c 'print(1)' > a.txt; python -c 'print(2)' >> a.txt; cat a.txt | python -c 'print(input())'"
    )
    done = subprocess.run(
        ["sh", "-c", line], cwd=tmp_path, env={**os.environ, "PATH": path}, capture_output=True
    )
    assert (tmp_path / "a.txt").read_text() == "1\n2\n"
    assert done.stdout == b"1\n"


@pytest.mark.parametrize("name", ["PYTHONIOENCODING", "IMUCAL_TRACEBACK", "LC_ALL"])
def test_another_environment_makes_a_new_process(programs, name):
    program = f"import os, sys; print(os.environ[{name!r}], 'numpy' in sys.modules)"
    environment = {**os.environ, name: "latin-1"}
    done = subprocess.run(
        [programs / "python", "-c", program], env=environment, capture_output=True, text=True
    )
    assert done.stdout == "latin-1 False\n"


def test_imucal_is_the_installed_one(programs):
    done = subprocess.run([programs / "imucal", "calibrate", "none.csv"], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (1, "")
    assert "none.csv" in done.stderr
