"""Places that cannot be read or written: an error, and the old files as they were."""

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

import imucal
from changes import (
    changed,
    stand_run,
)
from imucal.cli import main

COMMAND = Path(sys.executable).with_name("imucal")

POSIX = pytest.mark.skipif(sys.platform == "win32", reason="POSIX")
NOT_ROOT = pytest.mark.skipif(
    sys.platform != "win32" and os.geteuid() == 0, reason="the superuser may do anything"
)


@pytest.fixture
def run(tmp_path):
    """A good recording in its own folder, and a calibration file that was there before."""
    imucal.write(changed(stand_run().recording), tmp_path / "run.parquet")
    (tmp_path / "cal.json").write_text("old")
    return tmp_path


def calibrated(place, *more):
    return main(["calibrate", str(place / "run.parquet"), "-o", str(place / "cal.json"), *more])


def assert_old_files_only(place, capsys, words):
    shown = capsys.readouterr()
    assert words in shown.err
    assert "Traceback" not in shown.err
    assert (place / "cal.json").read_text() == "old"
    assert sorted(path.name for path in place.iterdir()) == ["cal.json", "run.parquet"]


@POSIX
@NOT_ROOT
def test_no_permission_to_read(run, capsys):
    (run / "run.parquet").chmod(0)
    assert calibrated(run) == 1
    assert_old_files_only(run, capsys, "no permission")


@POSIX
@NOT_ROOT
def test_read_only_folder(run, capsys):
    run.chmod(0o555)
    try:
        assert calibrated(run) == 1
        assert_old_files_only(run, capsys, "cannot be written: Permission denied")
    finally:
        run.chmod(0o755)


@POSIX
@pytest.mark.parametrize("number", [errno.EACCES, errno.EROFS, errno.EDQUOT])
def test_folder_that_takes_no_file(run, capsys, monkeypatch, number):
    def refuse(*_, **__):
        raise OSError(number, os.strerror(number))

    # Without files that have no name, as on other systems.
    monkeypatch.delattr("os.O_TMPFILE", raising=False)
    monkeypatch.setattr("tempfile.mkstemp", refuse)
    assert calibrated(run) == 1
    assert_old_files_only(run, capsys, f"cannot be written: {os.strerror(number)}")


@pytest.mark.parametrize("where", ["os.fsync", "os.link", "os.fchmod"])
def test_disk_full_at_any_step(run, capsys, monkeypatch, where):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(where, full)
    assert calibrated(run) == 1
    monkeypatch.undo()
    assert_old_files_only(run, capsys, "No space left on device; what was there is unchanged")


@POSIX
@pytest.mark.skipif(not Path("/dev/full").exists(), reason="there is no /dev/full here")
def test_full_device(run, capsys):
    assert main(["calibrate", str(run / "run.parquet"), "-o", "/dev/full"]) == 1
    assert_old_files_only(run, capsys, "/dev/full cannot be written: No space left on device")
    assert main(["calibrate", str(run / "run.parquet"), "--json", "/dev/full"]) == 1
    assert_old_files_only(run, capsys, "/dev/full cannot be written")


def test_output_that_is_a_folder_or_in_none(run, capsys):
    (run / "cal.json").unlink()
    (run / "cal.json").mkdir()
    assert calibrated(run) == 1
    assert "it is a folder" in capsys.readouterr().err
    assert main(["calibrate", str(run / "run.parquet"), "-o", str(run / "none" / "cal.json")]) == 1
    assert f"there is no folder {run / 'none'}: create it first" in capsys.readouterr().err


@pytest.mark.slow
@POSIX
@pytest.mark.skipif(sys.platform == "darwin", reason="file names are UTF-8 there")
def test_file_names_that_are_no_text(run):
    name = os.fsdecode(b"\xff.parquet")
    (run / "run.parquet").rename(run / name)
    environment = {**os.environ, "PYTHONIOENCODING": "utf-8:strict"}
    for arguments, code in (
        (["calibrate", name, "-o", "cal.json", "--json", "-"], 0),
        (["inspect", name], 0),
        (["convert", name, "-o", os.fsdecode(b"\xfe.csv")], 0),
        (["calibrate", os.fsdecode(b"\xfd.csv")], 1),
    ):
        done = subprocess.run([COMMAND, *arguments], cwd=run, capture_output=True, env=environment)
        assert done.returncode == code, done.stderr
        assert b"Traceback" not in done.stderr
    assert imucal.Calibration.load(run / "cal.json").provenance.files[0].path == name
