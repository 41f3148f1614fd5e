"""`imucal show` prints what a calibration file contains."""

import json
from pathlib import Path

import pytest

import imucal
from imucal.cli import main


@pytest.fixture(scope="module")
def result():
    run, control = (imucal.simulate("tumble", seed=seed, rate_hz=100.0).recording for seed in (1, 2))
    return imucal.calibrate(run, control=control, serial_number="0042")


@pytest.fixture
def file(result, tmp_path):
    result.calibration.save(tmp_path / "unit.json")
    return str(tmp_path / "unit.json")


def test_the_parameters_and_the_verdict_of_a_file(file, result, capsys):
    assert main(["show", file, "--units", "si"]) == 0
    shown = capsys.readouterr().out
    lines = {words[0]: words[1:] for line in shown.splitlines() if (words := line.split())}
    for parameter in result.calibration.parameters:
        if "bias" in parameter.name:
            value, std, unit = lines[parameter.name]
            assert float(value) == pytest.approx(parameter.value, abs=parameter.std)
            assert float(std) == pytest.approx(parameter.std, rel=0.05)
            assert unit == parameter.unit
    assert shown.startswith("unit 0042: accelerometer in m/s^2, gyroscope in rad/s; body frame symmetric\n")
    assert "standard gravity 9.80665 m/s^2 is assumed" in shown and "the clock of the time stamps" in shown
    assert shown.splitlines()[-1].startswith(f"verdict: {result.calibration.verdict}")


def test_datasheet_units_are_printed_by_default(file, capsys):
    assert main(["show", file]) == 0
    assert [
        line.split()[-1] for line in capsys.readouterr().out.splitlines() if line.startswith("gyro_bias")
    ] == ["deg/s"] * 3


def test_the_document_is_the_file(file, capsys):
    assert main(["show", file, "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out) == json.loads(Path(file).read_text(encoding="utf-8"))


def test_the_program_of_an_imported_calibration_is_named(file, tmp_path, capsys):
    exported, imported = tmp_path / "calibration.json", tmp_path / "imported.json"
    assert main(["export", file, "--to", "basalt", "-o", str(exported)]) == 0
    assert main(["import", str(exported), "-o", str(imported)]) == 0
    capsys.readouterr()
    assert main(["show", str(imported)]) == 0
    assert "made by Basalt" in capsys.readouterr().out


def test_a_file_that_is_no_calibration_is_refused(tmp_path, capsys):
    (tmp_path / "other.json").write_text("{}")
    assert main(["show", str(tmp_path / "other.json")]) == 1
    assert "other.json" in capsys.readouterr().err
