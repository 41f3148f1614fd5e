"""What the documents of --json say of themselves: which kind, which unit, which files, which version."""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path

import pytest

import imucal
from imucal.cli import main

PAGE = Path(__file__).resolve().parents[2] / "docs/production-line.md"
ROW = re.compile(r"^\| `imucal ([a-z ]+)` \| `(imucal\.[a-z-]+/1)` \| (.*) \|$", re.MULTILINE)
LIMITS = {"schema": "imucal.limits/1", "calibration_set": {"rests": {"min": 1}}}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The documents of four commands on one unit."""
    folder = tmp_path_factory.mktemp("documents")
    for name, seed, moves in (("run", 11, 45), ("control", 12, 20)):
        program = imucal.Program.random(seed=seed, moves=moves)
        imucal.write(imucal.simulate(program, seed=seed, rate_hz=50).recording, folder / f"{name}.csv")
    (folder / "limits.json").write_text(json.dumps(LIMITS))
    run, control, unit, limits = (
        str(folder / name) for name in ("run.csv", "control.csv", "0042.json", "limits.json")
    )
    for words in (
        ["calibrate", run, "--control", control, "--serial-number", "0042", "-o", unit],
        ["evaluate", unit, control],
        ["limits", "check", limits, unit],
        ["diff", unit, unit],
    ):
        name = " ".join(words[: 2 if words[0] == "limits" else 1])
        assert main([*words, "--json", str(folder / f"{name} result.json")]) == 0
    return folder


def document(folder, command):
    return json.loads((folder / f"{command} result.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("command", ["calibrate", "evaluate", "limits check", "diff"])
def test_a_document_has_the_fields_of_the_page(folder, command):
    rows = ROW.findall(PAGE.read_text(encoding="utf-8"))
    [(schema, fields)] = [fields for name, *fields in rows if name == command]
    found = document(folder, command)
    assert found["schema"] == schema
    assert set(found) == {"schema", *re.findall(r"`([a-z_]+)`", fields)}


def test_a_document_says_which_unit_files_and_version_it_is_of(folder):
    saved = imucal.Calibration.load(folder / "0042.json").to_dict()
    calibrated, judged, checked, compared = (
        document(folder, command) for command in ("calibrate", "evaluate", "limits check", "diff")
    )
    for of_unit in (calibrated, judged, *checked["units"], compared["before"], compared["after"]):
        assert of_unit["serial_number"] == "0042"
        assert of_unit["provenance"] == saved["provenance"]
    assert compared["serial_number"] == "0042"
    control = folder / "control.csv"
    source = {"path": str(control), "sha256": hashlib.sha256(control.read_bytes()).hexdigest()}
    assert judged["recordings"] == calibrated["control"]["recordings"]
    assert judged["recordings"] == [{"name": "control.csv", "files": [source]}]
    for made_now in (judged, checked, compared):
        assert made_now["imucal_version"] == imucal.__version__


def test_two_units_have_no_serial_number_in_common(folder):
    one = imucal.Calibration.load(folder / "0042.json")
    other = imucal.Calibration.from_dict({**one.to_dict(), "serial_number": "0043"})
    compared = imucal.diff(one, other).to_dict()
    assert compared["serial_number"] is None
    assert [compared[which]["serial_number"] for which in ("before", "after")] == ["0042", "0043"]


def test_a_file_that_cannot_be_judged_has_no_provenance(folder, tmp_path):
    (tmp_path / "broken.json").write_text("{}")
    words = ["limits", "check", str(folder / "limits.json"), str(tmp_path / "broken.json")]
    assert main([*words, "--json", str(tmp_path / "checked.json")]) == 1
    [unit] = json.loads((tmp_path / "checked.json").read_text(encoding="utf-8"))["units"]
    assert (unit["verdict"], unit["provenance"]) == ("no_result", None)
