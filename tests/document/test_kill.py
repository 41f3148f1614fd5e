"""A process that is killed while it writes leaves the complete old file or the complete new one.

`write_json` is called directly, because no command writes a document alone.
"""

import json
import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest

import imucal
from children import HANGS_S, ended, heed_signals, stopped_while_writing
from imucal.document.json_document import write_json

pytestmark = [pytest.mark.skipif(sys.platform == "win32", reason="signals are POSIX"), pytest.mark.slow]

COMMAND = Path(sys.executable).with_name("imucal")

# Writes the old file and then forks one child per moment. A profile function counts the calls of the writing
# child and kills it at the given call. The parent prints the counts of old, new and other bytes.
MOMENTS = """
import os, signal, sys
from pathlib import Path
import numpy as np
import imucal
# All that a child would load, or most of its calls were those of its imports.
import imucal.calibration.calibration, imucal.calibration.file, imucal.cli.output, imucal.io.canonical
from imucal.document.json_document import write_json
import pyarrow.compute, pyarrow.csv, pyarrow.parquet

target = Path(sys.argv[1])

def recording(value):
    return imucal.Recording(np.arange(500) / 100, *[np.full((500, 3), value)] * 2)

def write(kind, value):
    if kind == "recording":
        imucal.write(recording(value), target)
    elif kind == "calibration":
        triad = imucal.Triad(value * np.eye(3), np.zeros(3))
        imucal.Calibration(triad, triad).save(target)
    else:
        write_json({"values": [value] * 500}, target)

def in_child(work):
    child = os.fork()
    if child == 0:
        try:
            work()
        finally:
            os._exit(1)
    return os.waitpid(child, 0)[1]

def finished(kind, value):
    write(kind, value)
    os._exit(0)

def killed_at(kind, moment):
    calls = 0
    def count(*_):
        nonlocal calls
        calls += 1
        if calls == moment:
            os.kill(os.getpid(), signal.SIGKILL)
    sys.setprofile(count)
    write(kind, 2.5)
    sys.setprofile(None)
    os.write(told, str(calls).encode())
    os._exit(0)

kind = sys.argv[2]
telling, told = os.pipe()
assert in_child(lambda: finished(kind, 2.5)) == 0
new = target.read_bytes()
assert in_child(lambda: finished(kind, 1.5)) == 0
old = target.read_bytes()
assert old != new
assert in_child(lambda: killed_at(kind, 0)) == 0
calls = int(os.read(telling, 20))
# Each of the first and of the last calls, and calls at growing distances from both ends.
distances = [1]
while distances[-1] < calls:
    distances.append(distances[-1] + max(1, distances[-1] // int(sys.argv[3])))
seen = {"old": 0, "new": 0, "broken": 0}
assert in_child(lambda: finished(kind, 1.5)) == 0
for moment in sorted({*distances[:-1], *(calls - distance for distance in distances[:-1])}):
    status = in_child(lambda: killed_at(kind, moment))
    assert status == 0 or os.WTERMSIG(status) == signal.SIGKILL
    found = target.read_bytes()
    seen["old" if found == old else "new" if found == new else "broken"] += 1
    if found != old:
        assert in_child(lambda: finished(kind, 1.5)) == 0
print(*seen.values())
"""


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("run.csv", "recording"),
        ("run.parquet", "recording"),
        ("cal.json", "calibration"),
        ("result.json", "document"),
    ],
)
def test_killed_at_any_call_leaves_the_old_or_the_new_file(tmp_path, name, kind):
    target = tmp_path / name
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", MOMENTS, str(target), kind, "10"],
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    old, new, broken = map(int, done.stdout.split())
    assert broken == 0
    assert old > 20
    assert new > 0
    # A process that is killed between the naming of its complete file and the rename leaves one such file.
    others = [path.name for path in tmp_path.iterdir() if path != target]
    assert len(others) <= 1
    assert all(other.startswith(".imucal-") and other.endswith(".tmp") for other in others)


@pytest.fixture(scope="module")
def long_recording(tmp_path_factory):
    """Long enough for a process to be stopped while it writes it as text."""
    path = tmp_path_factory.mktemp("long") / "run.parquet"
    values = np.random.default_rng(0).normal(size=(400_000, 6))
    imucal.write(imucal.Recording(np.arange(400_000) / 1000, values[:, :3], values[:, 3:]), path)
    return path


def writing(output, *words, before=heed_signals):
    """The installed command, stopped in the middle of its writing."""

    def start():
        if output.exists():
            output.write_text("old")
        return subprocess.Popen(
            [COMMAND, *map(str, words), "-o", str(output)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            preexec_fn=before,
        )

    return stopped_while_writing(start, output)


def test_installed_command_killed_while_it_writes(long_recording, tmp_path):
    output = tmp_path / "out.csv"
    output.write_text("old")
    process = writing(output, "convert", long_recording)
    process.kill()
    process.communicate()
    assert process.returncode == -signal.SIGKILL
    assert output.read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["out.csv"]
    subprocess.run(
        [COMMAND, "convert", str(long_recording), "-o", str(output)], check=True, capture_output=True
    )
    assert len(imucal.read(output)) == 400_000


@pytest.mark.parametrize("command", ["convert", "apply"])
@pytest.mark.parametrize(
    ("name", "code", "what"),
    [
        (signal.SIGINT, 130, "interrupted"),
        (signal.SIGTERM, 143, "ended by SIGTERM"),
        (signal.SIGHUP, 129, "ended by SIGHUP"),
    ],
)
def test_interrupted_while_it_writes(long_recording, tmp_path, command, name, code, what):
    output, unit = tmp_path / "out.csv", tmp_path / "unit.json"
    output.write_text("old")
    triad = imucal.Triad(np.eye(3), np.zeros(3))
    imucal.Calibration(triad, triad).save(unit)
    words = [command, *([unit] if command == "apply" else []), long_recording]
    process = writing(output, *words)
    shown = ended(process, name)
    assert output.read_text() == "old"
    assert shown == f"imucal: {what}, no file is incomplete\n"
    assert process.returncode == code
    assert sorted(tmp_path.iterdir()) == [output, unit]


def test_a_signal_that_is_ignored_stays_ignored(long_recording, tmp_path):
    """As under nohup."""
    output = tmp_path / "out.csv"
    process = writing(
        output,
        "convert",
        long_recording,
        before=lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN),
    )
    shown = ended(process, signal.SIGHUP)
    assert (process.returncode, shown) == (0, "")
    assert len(imucal.read(output)) == 400_000


def test_interrupted_at_any_time(long_recording, tmp_path):
    """From the start of the command to its end: reading, checking, fitting or writing."""
    output = tmp_path / "out.csv"
    # The command prints inside `main`. A signal before `main` is handled by Python, which prints a traceback.
    program = textwrap.dedent(
        """
        import sys
        from imucal.cli import app
        run = app._run
        def ready_and_run(arguments):
            print("ready", flush=True)
            return run(arguments)
        app._run = ready_and_run
        sys.exit(app.main())
        """
    )
    codes = set()
    for delay_s in np.linspace(0.005, 1.2, 6):
        process = subprocess.Popen(
            [sys.executable, "-c", program, "convert", str(long_recording), "-o", str(output)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},
            preexec_fn=heed_signals,
        )
        process.stdout.readline()
        time.sleep(delay_s)
        process.send_signal(signal.SIGINT)
        _, shown = process.communicate(timeout=HANGS_S)
        codes.add(process.returncode)
        assert "Traceback" not in shown
        assert [path for path in tmp_path.iterdir() if path != output] == []
        if output.exists():
            assert output.read_bytes().count(b"\n") == 400_001
            output.unlink()
    assert 130 in codes
    assert codes <= {0, 130, -signal.SIGINT}


@pytest.fixture
def named_files(monkeypatch):
    """A file system without files that have no name."""
    monkeypatch.delattr(os, "O_TMPFILE", raising=False)


def test_files_with_names_are_removed_after_their_process(tmp_path, named_files):
    left, young, locked = (tmp_path / f".imucal-{name}.tmp" for name in ("left", "young", "locked"))
    for path in (left, young, locked):
        path.write_bytes(b"half a file")
    for path in (left, locked):
        os.utime(path, (1e9, 1e9))
    import fcntl

    with locked.open("rb+") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        write_json({"a": 1}, tmp_path / "a.json")
    assert {path.name for path in tmp_path.iterdir()} == {young.name, locked.name, "a.json"}


@pytest.mark.parametrize("is_named", [False, True])
def test_a_name_of_255_bytes_is_written_and_a_longer_one_is_an_error(tmp_path, is_named, request):
    if is_named:
        request.getfixturevalue("named_files")
    target = tmp_path / f"{'é' * 125}.json"
    for value in (1, 2):
        write_json({"value": value}, target)
        assert json.loads(target.read_text()) == {"value": value}
    target.chmod(0o640)
    write_json({}, target)
    assert target.stat().st_mode & 0o777 == 0o640
    with pytest.raises(imucal.InputError, match="File name too long"):
        write_json({}, tmp_path / f"{'é' * 126}.json")
    assert list(tmp_path.iterdir()) == [target]
