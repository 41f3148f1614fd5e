"""Damaged, wrong and unusual files: message and exit code of a command, and the error of the same call."""

import atexit
import functools
import json
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
import pytest

import imucal
from bad_recordings import counts, good_result
from changes import (
    changed,
    program,
    rows,
    stand_run,
)
from imucal import FormatError, InputError, Program
from imucal.cli import main
from imucal.recording.one_unit import with_own_names

COMMAND = Path(sys.executable).with_name("imucal")


@functools.cache
def folder():
    """Good files, and bad ones made of them."""
    place = Path(tempfile.mkdtemp(prefix="imucal-"))
    atexit.register(shutil.rmtree, place, ignore_errors=True)
    good, control = changed(stand_run().recording), stand_run(2).recording
    imucal.write(good, place / "good.parquet")
    imucal.write(good, place / "good.csv")
    imucal.write(control, place / "control.parquet")
    imucal.write(counts(good), place / "counts.parquet")
    imucal.write(changed(control, angular_rate=0 * control.angular_rate + 0.01), place / "dead.parquet")
    hasty = Program.random(seed=2, moves=30, hold_s=0.5)
    imucal.write(imucal.simulate(hasty, rate_hz=100, seed=2).recording, place / "no-rest.parquet")
    imucal.write(program(((0.0, 0.0, 0.0), 1.0, 60.0))(None), place / "still.parquet")
    calibration = good_result().calibration
    calibration.save(place / "cal.json")
    document = json.loads((place / "cal.json").read_text())

    lines = (place / "good.csv").read_text().splitlines()
    header, cells = lines[0], lines[50].split(",")
    text = {
        "nothing.csv": "",
        "header.csv": header + "\n",
        "missing.csv": "\n".join(line.rpartition(",")[0] for line in lines),
        "mixed.csv": "\n".join([header.replace("accel_x_mps2", "accel_x_g"), *lines[1:]]),
        "twice.csv": "\n".join([header.replace("accel_y", "accel_x"), *lines[1:]]),
        "text.csv": "\n".join([*lines[:50], ",".join([*cells[:2], "full", *cells[3:]]), *lines[51:]]),
        "gap.csv": "\n".join([*lines[:50], ",".join([*cells[:2], "", *cells[3:]]), *lines[51:]]),
        "ragged.csv": "\n".join([*lines[:50], lines[50] + ",7", *lines[51:]]),
        "cut.csv": "\n".join(lines).rpartition(",")[0],
        "comma.csv": "\n".join(line.replace(".", ",") for line in lines),
        "page.csv": "<!doctype html>\n<html><body>404</body></html>\n",
        "text.parquet": "hello",
        "text.json": "time_s,accel_x",
        "cut.json": (place / "cal.json").read_text()[:500],
        "null.json": "null",
        "nan.json": json.dumps({**document, "gravity_mps2": float("nan")}),
        "schema.json": json.dumps({**document, "schema": "imucal.calibration/9"}),
        "shape.json": json.dumps(
            {**document, "accelerometer": {**document["accelerometer"], "T": [[1, 0, 0]]}}
        ),
        "unit.json": json.dumps({**document, "raw_units": {"accelerometer": "lsb", "gyroscope": "lsb"}}),
        "singular.json": json.dumps(
            {**document, "accelerometer": {**document["accelerometer"], "T": [[0] * 3] * 3}}
        ),
        "gravity.json": json.dumps({**document, "gravity_mps2": 9.75}),
    }
    for name, content in text.items():
        (place / name).write_text(content)
    (place / "binary.csv").write_bytes(np.random.default_rng(0).bytes(3000))
    (place / "utf16.csv").write_bytes("\n".join(lines).encode("utf-16"))
    (place / "cut.parquet").write_bytes((place / "good.parquet").read_bytes()[:9000])
    (place / "garbled.parquet").write_bytes(b"PAR1" + np.random.default_rng(0).bytes(500) + b"PAR1")
    (place / "folder.csv").mkdir()
    return place


# Command line, the words of the message, and the class that the same call raises in Python.
BAD_FILES = {
    "no such file": ("calibrate none.csv", "none.csv: there is no such file", InputError),
    "a folder": ("calibrate folder.csv", "folder.csv is a folder", InputError),
    "an empty file": ("calibrate nothing.csv", r"nothing.csv is empty \(0 bytes\)", FormatError),
    "a header alone": ("calibrate header.csv", r"header.csv: there is no sample \[empty\]", None),
    "a column missing": (
        "calibrate missing.csv",
        r"missing.csv: the column gyro_z_\* is missing",
        FormatError,
    ),
    "mixed units": ("calibrate mixed.csv", "the units of accel_x_g, accel_y_mps2, .* are mixed", FormatError),
    "a column twice": ("calibrate twice.csv", "the column accel_x_mps2 is given twice", FormatError),
    "an empty cell": ("calibrate gap.csv", r"accel_y have NaN .* sample 49 \[non_finite\]", None),
    "decimal commas": ("calibrate comma.csv", "line 2 has 14 values, 7 are needed", FormatError),
    "a web page": ("calibrate page.csv", "page.csv: the format could not be determined", FormatError),
    "a binary file": ("calibrate binary.csv", "binary.csv is a binary file", FormatError),
    "a cut Parquet": ("calibrate cut.parquet", "cut.parquet is a damaged or truncated Parquet", FormatError),
    "a garbled Parquet": ("calibrate garbled.parquet", "garbled.parquet is a damaged", FormatError),
    "text named Parquet": ("calibrate text.parquet", "text.parquet is not a Parquet file", FormatError),
    "the same file twice": ("calibrate good.csv good.parquet", "[recordings_overlap]", None),
    "units of two kinds": ("calibrate good.parquet counts.parquet", "need the same raw units", None),
    "control of the same data": ("calibrate good.csv --control good.parquet", "give another recording", None),
    "control without rests": ("calibrate good.csv --control no-rest.parquet", "no rest of 1 s or more", None),
    "control with a dead gyroscope": ("calibrate good.csv --control dead.parquet", "[stuck_axis]", None),
    "control in counts": ("calibrate good.csv --control counts.parquet", "calibration expects m/s", None),
    "unknown format": ("calibrate good.csv --format xml", "unknown format 'xml'", None),
    "a time column and a rate": ("calibrate good.csv --rate-hz 100", "there is a time column time_s", None),
    "text for a number": ("calibrate good.csv --gravity earth", "'--gravity'", None),
    "evaluate: not JSON": (
        "evaluate text.json good.csv",
        "text.json is not JSON: line 1, column 1",
        FormatError,
    ),
    "evaluate: cut JSON": ("evaluate cut.json good.csv", "cut.json is not JSON: line", FormatError),
    "evaluate: null": ("evaluate null.json good.csv", "has no schema", FormatError),
    "evaluate: NaN": ("evaluate nan.json good.csv", "NaN is no JSON number", FormatError),
    "evaluate: another schema": (
        "evaluate schema.json good.csv",
        "has the schema 'imucal.calibration/9'",
        FormatError,
    ),
    "evaluate: wrong shape": (
        "evaluate shape.json good.csv",
        r"\$.accelerometer.T .* 3 items, not 1",
        FormatError,
    ),
    "evaluate: singular": ("evaluate singular.json good.csv", "nearly singular", FormatError),
    "evaluate: a recording": ("evaluate good.parquet good.csv", "good.parquet is not JSON", FormatError),
    "evaluate: other units": (
        "evaluate unit.json control.parquet",
        r"\$.gyroscope.T is about 0.977 lsb per rad/s, but \$.raw_units.gyroscope is lsb",
        FormatError,
    ),
    "evaluate: no rests": ("evaluate cal.json no-rest.parquet", "no rest of 1 s or more", None),
    "evaluate: NaN for a duration": ("evaluate cal.json good.csv --min-rest-s nan", "min.rest.s = NaN", None),
    "apply: other units": (
        "apply cal.json counts.parquet -o out.csv",
        "but the calibration expects m/s",
        None,
    ),
    "apply: a cut file": ("apply cut.json good.csv -o out.csv", "cut.json is not JSON", FormatError),
    "convert: other ending": ("convert good.csv -o out.xlsx", "change the extension", None),
    "simulate: no rate": ("simulate random --rate-hz 0 -o out.csv", "rate_hz is 0", None),
    "simulate: not a program": (
        "simulate cal.json -o out.csv",
        "has the schema 'imucal.calibration/1'",
        None,
    ),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_bad_files(name, capsys, monkeypatch):
    line, words, error = BAD_FILES[name]
    arguments = line.split()
    monkeypatch.chdir(folder())
    before = sorted(Path().iterdir())
    if arguments[0] == "calibrate":
        arguments += ["-o", "out.json"]
    assert main(arguments) == 1
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.startswith("imucal: ")
    assert "Traceback" not in shown.err
    if words.startswith("["):
        assert words in shown.err
    else:
        assert re.search(words, shown.err), shown.err
    assert sorted(Path().iterdir()) == before
    if error is not None:
        call = imucal.read if arguments[0] == "calibrate" else imucal.Calibration.load
        with pytest.raises(error):
            call(arguments[1])


# Files of which one row is not read: the file, the row, and the warning about it.
LEFT_OUT = {
    "text in a cell": ("text.csv", 49, "1 lines with text among the numbers (the first: line 51)"),
    "a row too long": (
        "ragged.csv",
        49,
        "1 lines with too few or too many values (the first: line 51, '0.49,",
    ),
    "a cut CSV": ("cut.csv", 12199, "an incomplete last line ('121.99,"),
}


@pytest.mark.parametrize("name", LEFT_OUT)
def test_a_bad_row_is_left_out_and_said(name, capsys, monkeypatch, tmp_path):
    file, row, words = LEFT_OUT[name]
    monkeypatch.chdir(folder())
    recording, good = imucal.read(file), imucal.read("good.csv")
    for column in ("time_s", "specific_force", "angular_rate"):
        np.testing.assert_array_equal(
            getattr(recording, column), np.delete(getattr(good, column), row, axis=0)
        )
    [finding] = recording.findings
    assert (finding.code, finding.severity, finding.count) == ("lines_left_out", "warning", 1)
    assert words in finding.message
    assert main(["calibrate", file, "-o", str(tmp_path / "cal.json")]) == 0
    shown = capsys.readouterr().out
    assert f"warning: {file}: left out: {words}" in shown
    assert "[lines_left_out]" in shown


def test_utf_16_is_read(monkeypatch):
    monkeypatch.chdir(folder())
    recording, good = imucal.read("utf16.csv"), imucal.read("good.csv")
    assert not recording.findings
    for column in ("time_s", "specific_force", "angular_rate"):
        np.testing.assert_array_equal(getattr(recording, column), getattr(good, column))


def test_a_control_recording_without_moves_judges_nothing(capsys, monkeypatch):
    monkeypatch.chdir(folder())
    assert main(["evaluate", "cal.json", "still.parquet"]) == 2
    assert "verdict: poor; control set: 1 usable rests and no usable move" in capsys.readouterr().out


@pytest.mark.parametrize(("times", "control_times"), [(1, 1), (1, 2), (2, 1)])
def test_a_run_does_not_judge_itself_however_its_samples_are_held(times, control_times):
    run, control = (
        rows(lambda n, m=m: np.arange(n).repeat(m))(stand_run().recording) for m in (times, control_times)
    )
    with pytest.raises(InputError, match="which is a calibration recording"):
        imucal.calibrate(run, control=control)


def test_recordings_of_one_name_get_names_of_their_own():
    recordings = [changed(stand_run().recording, name=name) for name in ("a", "a", "a (2)", "a")]
    assert [r.name for r in with_own_names(recordings)] == ["a", "a (2)", "a (2) (2)", "a (3)"]


def test_a_calibration_for_another_gravity_is_a_poor_verdict(capsys, monkeypatch):
    monkeypatch.chdir(folder())
    assert main(["evaluate", "gravity.json", "control.parquet"]) == 2
    assert "verdict: poor; control set: residuals are" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["calibrate", "good.csv", "-o", "/dev/null"], 0, ""),
        (["calibrate", "missing.csv", "-o", "cal.json"], 1, "gyro_z"),
        (["calibrate", "cut.parquet", "-o", "cal.json"], 1, "damaged or truncated"),
        (["evaluate", "schema.json", "good.csv"], 1, "imucal.calibration/9"),
        (["evaluate", "gravity.json", "control.parquet"], 2, ""),
        (["calibrate", "good.csv", "--folds", "-1"], 1, "folds is -1"),
    ],
)
def test_installed_command(arguments, code, words):
    before = {path: path.stat().st_mtime_ns for path in folder().iterdir()}
    done = subprocess.run([COMMAND, *arguments], cwd=folder(), capture_output=True, text=True)
    assert done.returncode == code
    assert words in done.stderr
    assert "Traceback" not in done.stderr
    assert {path: path.stat().st_mtime_ns for path in folder().iterdir()} == before
