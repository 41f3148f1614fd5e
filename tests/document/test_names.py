"""Names that break lines or reverse text: refused where they are chosen, escaped where they are found."""

import json
import subprocess
import sys
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
import yaml

import imucal
from imucal.cli import main
from imucal.noise_analysis.files import kalibr_yaml

# A line separator, a next line, an override of the direction, a null, an escape of a terminal, a line break.
HOSTILE = [
    "\u2028evil: 1",
    "\x85evil: 1",
    "\u202eevil",
    "\x00",
    "\x1b[31mevil",
    "\nevil: 1",
    "\u200fevil",
    "\ufeff",
]
TRIAD = imucal.Triad(np.eye(3), np.zeros(3))


def calibration(name):
    source = imucal.Source(f"run{name}#.csv", "0" * 64)
    return imucal.Calibration(TRIAD, TRIAD, provenance=imucal.Provenance(files=(source,)))


@pytest.mark.parametrize("name", HOSTILE)
def test_a_name_of_a_person_is_refused(name, tmp_path):
    per_volt = (imucal.EffectParameter("x", "rad/s", 1e-3),)
    with pytest.raises(imucal.InputError, match=r"serial number is .*U\+[0-9A-F]{4}: give characters"):
        imucal.Calibration(TRIAD, TRIAD, serial_number=f"42{name}")
    with pytest.raises(imucal.InputError, match="use letters, digits and _"):
        imucal.UserEffect("mine", "gyroscope", (imucal.EffectParameter(f"x{name}", "rad/s", 1e-3),), None)
    with pytest.raises(imucal.InputError, match=r"the unit of the parameter x of mine .*U\+"):
        imucal.UserEffect("mine", "gyroscope", (imucal.EffectParameter("x", f"rad{name}", 1e-3),), None)
    with pytest.raises(imucal.InputError, match="use letters, digits and _"):
        imucal.UserEffect(f"mine{name}", "gyroscope", per_volt, None)
    document = calibration("").to_dict()
    document["provenance"]["operator"] = f"me{name}"
    with pytest.raises(imucal.FormatError, match=r"\$\.provenance\.operator is .*U\+"):
        imucal.Calibration.from_dict(document)


@pytest.mark.parametrize("name", ["unité-42", "单元 7", "वहन", "Ω/2", "a" * 200])
def test_names_of_any_language_are_names(name):
    assert imucal.Calibration(TRIAD, TRIAD, serial_number=name).serial_number == name


@pytest.mark.parametrize("name", HOSTILE)
def test_a_name_of_a_file_stays_in_its_comment(name, tmp_path):
    unit = calibration(name)
    unit.save(tmp_path / "cal.json")
    text = (tmp_path / "cal.json").read_text()
    assert text.replace("\n", "").isprintable()
    again = imucal.Calibration.load(tmp_path / "cal.json")
    assert again.provenance.files[0].path == f"run{name}#.csv"
    for format in ("c-header", "rust", "matlab", "kalibr", "ros", "px4", "ardupilot", "fusion"):
        written = imucal.export(unit, format).text
        assert written.replace("\n", "").replace("\t", "").isprintable(), format
        # Python breaks lines where YAML, Rust or an editor may.
        assert written.splitlines() == written.split("\n")[: len(written.splitlines())]
    assert list(yaml.safe_load(imucal.export(unit, "kalibr").text)) == ["imu0"]
    assert list(yaml.safe_load(imucal.export(unit, "ros").text)) == ["SM", "bias"]
    assert "evil" not in json.loads(imucal.export(unit, "basalt").text)


def test_noise_for_kalibr_and_gazebo(tmp_path):
    run = imucal.simulate("static", unit="mpu6050", seed=1, rate_hz=100).recording
    named = imucal.Recording(
        run.time_s, run.specific_force, run.angular_rate, name="r\u2028update_rate: 1 --> <x/>"
    )
    noise = imucal.noise(named)
    assert (
        yaml.safe_load(imucal.export(calibration(""), "kalibr-imu", noise=noise).text)["update_rate"] == 100
    )
    ElementTree.fromstring(imucal.export(calibration(""), "gazebo", noise=noise).text)
    with pytest.raises(imucal.InputError, match=r"rostopic is .*U\+2028"):
        kalibr_yaml(noise, rostopic="/imu\u2028x: 1")


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such file names")
@pytest.mark.parametrize("name", [name for name in HOSTILE if "\x00" not in name])
def test_the_terminal_shows_names_escaped(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run = imucal.simulate("random", seed=1, rate_hz=50).recording
    imucal.write(run, f"run{name}.csv")
    (tmp_path / f"bad{name}.csv").write_text("1,2\n")
    assert main(["convert", f"run{name}.csv", "-o", f"out{name}.csv", "--json", "-"]) == 0
    assert main(["inspect", f"run{name}.csv"]) in (0, 2)
    assert main(["convert", f"bad{name}.csv", "-o", "out.csv"]) == 1
    assert main(["calibrate", f"run{name}.csv", "-o", f"cal{name}.json"]) == 0
    assert main(["export", f"cal{name}.json", "--to", "kalibr"]) == 0
    shown = capsys.readouterr()
    assert (shown.out + shown.err).replace("\n", "").isprintable()


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_columns_are_named_on_one_line(ending, tmp_path):
    path = tmp_path / f"run.{ending}"
    given = {f"supply{name}": np.arange(3.0) for name in HOSTILE if "\x00" not in name}
    recording = imucal.Recording(np.arange(3.0), np.zeros((3, 3)), np.zeros((3, 3)), auxiliary=given)
    assert all(name.isprintable() for name in recording.auxiliary)
    imucal.write(recording, path)
    assert list(imucal.read(path).auxiliary) == list(recording.auxiliary)
    assert r"supply\u2028evil: 1" in recording.auxiliary


@pytest.mark.parametrize(("size", "code"), [(255, 0), (256, 1)])
def test_an_output_has_any_name_that_a_file_can_have(size, code, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    imucal.write(imucal.simulate("static", seed=1).recording, "still.csv")
    assert main(["convert", "still.csv", "-o", "n" * (size - 4) + ".csv"]) == code
    shown = capsys.readouterr().err
    assert ("its name has 256 bytes, and a file name has at most 255: give a shorter one" in shown) is bool(
        code
    )


@pytest.mark.slow
@pytest.mark.parametrize("redirected", ["| head -c 0", ">&-", ">&- 2>&-", "| true"])
@pytest.mark.parametrize("words", ["", "--json -"])
def test_a_closed_output_changes_nothing_but_the_printing(redirected, words, tmp_path):
    imucal.write(imucal.simulate("static", seed=1).recording, tmp_path / "still.csv")
    # The verdict of a unit that only rests is poor.
    program = f"{sys.executable} -m imucal.cli inspect {tmp_path}/still.csv {words}"
    done = subprocess.run(
        ["bash", "-o", "pipefail", "-c", f"{program} {redirected}"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout) == (2, "")
    assert "Traceback" not in done.stderr and "bug" not in done.stderr
    program = f"{sys.executable} -m imucal.cli convert {tmp_path}/still.csv -o {tmp_path}/out.csv {words}"
    done = subprocess.run(
        ["bash", "-o", "pipefail", "-c", f"{program} {redirected}"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert len(imucal.read(tmp_path / "out.csv")) == 12_000
