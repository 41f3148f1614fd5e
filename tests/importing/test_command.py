"""The command that imports calibrations, and its page."""

import json
import subprocess
import sys

import numpy as np
import pytest
import yaml

import imucal
from estimator_imports import kalibr_block
from import_files import B_ACCEL, B_GYRO, ROOT, written
from imucal.cli import main
from imucal.importing import READERS, readers_markdown
from laboratory_imports import MISALIGNMENT, imu_tk_text
from realsense_imports import REALSENSE


def test_command(tmp_path, capsys):
    path = written(tmp_path, "imu.yaml", yaml.dump({"imu0": kalibr_block()}))
    output, document = tmp_path / "imported.json", tmp_path / "document.json"
    assert (
        main(["import", str(path), "-o", str(output), "--json", str(document), "--gyro-bias", "0.1,0,-0.2"])
        == 0
    )
    shown = capsys.readouterr().out
    assert "not in the file: covariance, temperature, gravity, accel bias" in shown
    found = json.loads(document.read_text())
    assert found["format"] == "kalibr" and "accel_bias" in found["missing"]
    calibration = imucal.Calibration.load(output)
    assert calibration.gyroscope.bias.tolist() == [0.1, 0.0, -0.2]
    assert calibration.judged[0] == "incomplete" and "Kalibr" in calibration.judged[1][0]
    assert calibration.provenance.imported.files[0].path == str(path)


def test_an_evaluation_names_what_the_file_does_not_state(tmp_path):
    run = imucal.simulate("random", unit="paper", seed=1, rate_hz=50)
    exported = imucal.export(run.truth.calibration, "kalibr")
    exported.save(tmp_path / "k.yaml")
    without = imucal.evaluate(imucal.read_calibration(tmp_path / "k.yaml"), run.recording)
    assert without.verdict == "poor"
    assert "the files of Kalibr do not state accel bias, gyro bias" in without.reasons[-1]
    truth = run.truth.calibration
    known = imucal.read_calibration(
        tmp_path / "k.yaml", accel_bias=truth.accelerometer.bias, gyro_bias=truth.gyroscope.bias
    )
    assert imucal.evaluate(known, run.recording).verdict == "good"


def test_command_names_the_formats_and_the_faults(tmp_path, capsys):
    assert main(["import", "--list"]) == 0
    listed = capsys.readouterr().out
    assert all(f"{name}: " in listed for name in READERS)
    assert main(["import", str(written(tmp_path, "x.txt", "hello"))]) == 1
    assert "-o PATH" in capsys.readouterr().err
    assert main(["import", str(tmp_path / "x.txt"), "-o", str(tmp_path / "o.json")]) == 1
    assert "no calibration that imucal reads" in capsys.readouterr().err
    numbers = [
        imu_tk_text(MISALIGNMENT, np.full(3, 9.8), B_ACCEL),
        imu_tk_text(MISALIGNMENT, np.ones(3), B_GYRO),
    ]
    pair = [str(written(tmp_path, name, text)) for name, text in zip(("acc", "gyro"), numbers, strict=True)]
    assert main(["import", *pair, "-o", str(tmp_path / "o.json")]) == 1
    assert "give --accel-unit g or --accel-unit lsb" in capsys.readouterr().err
    assert not (tmp_path / "o.json").exists()


def test_other_commands_name_the_import(tmp_path):
    path = written(tmp_path, "calibration.json", REALSENSE)
    with pytest.raises(imucal.FormatError, match="imucal import reads calibrations of other programs"):
        imucal.Calibration.load(path)


def test_the_page_has_the_table_of_formats():
    page = (ROOT / "docs/imports.md").read_text(encoding="utf-8")
    assert readers_markdown() in page, "put readers_markdown() of imucal.importing into docs/imports.md"


def test_yaml_is_loaded_only_for_yaml(tmp_path):
    path = written(tmp_path, "calibration.json", REALSENSE)
    code = f"import sys, imucal; imucal.read_calibration({str(path)!r}); assert 'yaml' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
