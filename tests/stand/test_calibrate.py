"""One unit on the line: a good one passes and is exported, a hidden fault is named.

`calibrate_unit` and `assess` are called directly where equipment has to fail at a chosen moment.
"""

import dataclasses
import errno
import json
from contextlib import nullcontext
from datetime import datetime
from types import SimpleNamespace

import numpy as np
import pytest

import imucal
from imucal import Program, Step
from imucal.cli import main
from imucal.document.temporary import TemporaryFile
from imucal.stand.line import Order, calibrate_unit
from imucal.stand.programs import in_another_order, ranges_deg
from imucal.stand.simulated import SimulatedStand
from imucal.stand.verdict import assess

pytestmark = pytest.mark.slow

NAMES = {"slip": "mount_slip", "loose-mount": "loose_mount", "clipping": "clipping", "dead-axis": "dead_axis"}


@pytest.fixture
def line(tmp_path, monkeypatch, capsys):
    """Run `imucal stand calibrate` on a simulated stand; its exit code, its document, and what it said."""
    monkeypatch.chdir(tmp_path)

    def run(*options, seed=1):
        given = ["--driver", "simulated", "--speed", "2000", "--seed", str(seed), "--fault-seed", str(seed)]
        given += [
            "--control-seed",
            str(100 + seed),
            "--rate-hz",
            "100",
            "--json",
            "result.json",
            "-o",
            "units",
        ]
        code = main(["stand", "calibrate", *given, *options])
        said = capsys.readouterr()
        return code, json.loads((tmp_path / "result.json").read_text()), said.out + said.err

    return run


def test_a_good_unit_passes_and_is_exported(line, tmp_path):
    code, document, said = line(
        *("--serial-number", "0042", "--operator", "Ada", "--unit", "random:bmi088:3", "--stand", "cheap:2"),
        *("--export", "c-header", "--export", "ros"),
    )
    assert (code, document["verdict"], document["reasons"]) == (0, "passed", []), said
    folder = tmp_path / "units/0042"
    files = {"run.csv", "control.csv", "calibration.json", "result.json", "c-header.h", "ros.yaml"}
    assert {path.name for path in folder.iterdir()} == files
    calibration = imucal.Calibration.load(folder / "calibration.json")
    assert calibration.serial_number == "0042"
    assert calibration.provenance.operator == "Ada"
    assert [source.path for source in calibration.provenance.files] == ["units/0042/run.csv"]
    assert [source.path for source in calibration.provenance.control_files] == ["units/0042/control.csv"]
    # The export is that of this calibration.
    assert (folder / "ros.yaml").read_text() == imucal.export(calibration, "ros").text
    # What the line says is in the folder, too.
    assert json.loads((folder / "result.json").read_text()) == document
    assert document["operator"] == "Ada"
    assert document["imucal_version"] == imucal.__version__
    made = calibration.provenance
    named = [{"path": source.path, "sha256": source.sha256} for source in (*made.files, *made.control_files)]
    assert document["recordings"] == named
    assert document["control_seed"] == 101
    assert "passed" in said.splitlines()[-1]
    # The unit is what it is: errors of the 21 parameters as large as they should be.
    unit = imucal.simulate(imucal.Static(1.0), seed=1, unit="random:bmi088:3").truth.calibration
    truth = {parameter.name: parameter.value for parameter in unit.parameters}
    pulls = [(p.value - truth[p.name]) / p.std for p in calibration.parameters if p.name in truth]
    assert len(pulls) == 21
    assert np.sqrt(np.mean(np.square(pulls))) < 2.0


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize("fault", NAMES)
def test_a_hidden_fault_is_named(line, fault, seed, tmp_path):
    stand = ("--stand", f"cheap:{seed}", "--unit", f"random:bmi088:{seed}")
    code, document, said = line("--fault", fault, "--export", "px4", *stand, seed=seed)
    assert (code, document["verdict"]) == (2, "failed")
    named = [reason["code"] for reason in document["reasons"]]
    # The first reason is the fault's; no other fault is named besides.
    assert named[0] == NAMES[fault], said
    assert not set(named) & (set(NAMES.values()) - {NAMES[fault]})
    assert NAMES[fault] in said.splitlines()[-1]
    # Nothing that could be taken for a calibration to be shipped.
    files = {path.name for path in (tmp_path / "units/unit").iterdir()}
    assert not files & {"calibration.json", "px4.params"}
    assert document["exports"] == []


@pytest.mark.parametrize("seed", [1, 2])
def test_a_unit_without_fault_is_not_accused(line, seed):
    code, document, said = line("--stand", f"cheap:{seed}", "--unit", f"random:bmi088:{seed}", seed=seed)
    assert (code, document["reasons"]) == (0, []), said


def test_limits_decide(line, tmp_path):
    limits = {
        "schema": "imucal.limits/1",
        "parameters": {"gyro_bias_*": {"unit": "rad/s", "min": -1e-6, "max": 1e-6}},
    }
    (tmp_path / "limits.json").write_text(json.dumps(limits))
    code, document, said = line("--limits", "limits.json", "--serial-number", "7")
    assert (code, document["verdict"]) == (2, "failed")
    assert {reason["code"] for reason in document["reasons"]} == {"limit"}
    assert "gyro_bias_" in document["reasons"][0]["message"]
    assert imucal.Calibration.load(tmp_path / "units/7/rejected.json").serial_number == "7"
    assert document["result"]["judgement"]["passed"] is False
    assert "limit" in said


def test_a_program_that_determines_too_little_is_refused_before_anything_moves(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Program((Step((0, 0, 0), 0, 3), Step((20, 0, 0), 1, 3))).write("short.json")
    for program, missing in (("short.json", "accel_sensitivity_xx"), ("grid", "gyro_sensitivity_yx")):
        assert main(["stand", "calibrate", "--program", program, "-o", "units"]) == 1
        said = capsys.readouterr().err
        assert f"the program {program} does not determine" in said
        assert missing in said
    assert not (tmp_path / "units").exists()


def test_a_second_try_leaves_the_first_one_alone(line, tmp_path):
    serial = ("--serial-number", "A/7 b", "--fault", "dead-axis")
    first = line(*serial)[1]["folder"]
    before = {path.name: path.read_bytes() for path in (tmp_path / first).iterdir()}
    second = line(*serial)[1]["folder"]
    assert (first, second) == ("units/A_7_b", "units/A_7_b-2")
    assert {path.name: path.read_bytes() for path in (tmp_path / first).iterdir()} == before


# Poses of a stand with end stops and without its outer motor.
LIMITED = [(0, 90, 0), (0, -90, 90), (0, 45, 180), (0, -45, 270), (0, 80, -90), (0, 10, 30), (0, -70, 200)]


def limited(path):
    """A program file of `LIMITED`."""
    turns = np.diff([(0, 0, 0), *LIMITED], axis=0).tolist()
    program = Program((Step((0, 0, 0), 0, 2), *(Step(tuple(turn), 2, 2) for turn in turns)))
    program.write(path)
    return program


@pytest.mark.parametrize("seed", range(5))
def test_the_control_run_of_a_file_goes_where_the_file_does(seed, tmp_path):
    program = limited(tmp_path / "limited.json")
    control = in_another_order(program, seed)
    path = np.cumsum([step.turn_deg for step in control.steps], axis=0)
    # Forward and back along the path of the file: an end stop is not passed, nor a forbidden zone crossed.
    there = [(0, 0, 0), *LIMITED]
    assert np.allclose(path, [*there, *there[-2::-1]])
    assert ranges_deg(control) == ranges_deg(program) == [[0, 0], [-90, 90], [-90, 270]]
    # Every pose is held once, and the first one at both ends.
    held = [tuple(pose) for pose, step in zip(path, control.steps, strict=True) if step.hold_s > 0]
    assert sorted(held) == sorted([(0, 0, 0), *there])
    assert held != [*there, (0, 0, 0)]
    assert {step.move_s for step in control.steps if any(step.turn_deg)} == {2}


def test_a_file_alone_decides_where_the_motors_go(line, tmp_path):
    Program.random(seed=4, moves=24).write(tmp_path / "mine.json")
    code, document, said = line("--program", "mine.json", "--serial-number", "1")
    assert (code, document["verdict"]) == (0, "passed"), said
    run, control = (np.degrees(imucal.read(f"units/1/{name}.csv").stand_rad) for name in ("run", "control"))
    assert np.all(control.min(0) >= run.min(0) - 1e-9)
    assert np.all(control.max(0) <= run.max(0) + 1e-9)
    assert np.allclose(document["range_deg"]["control"], np.stack([run.min(0), run.max(0)], axis=1))
    # Said before the start: that nothing real moves, and where both go.
    assert [row.split(":")[0] for row in said.splitlines()[:3]] == ["simulated", "run", "control"]

    Program.random(seed=5, moves=20).write(tmp_path / "other.json")
    code, document, said = line("--program", "mine.json", "--control-program", "other.json")
    assert document["range_deg"]["control"] == ranges_deg(Program.read("other.json")), said
    assert document["control_program"] == "other.json"


def test_the_control_program_is_drawn_and_said(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    seeds = []
    for folder in ("one", "two"):
        given = ["--speed", "2000", "--rate-hz", "50", "-o", folder, "--json", "result.json"]
        assert main(["stand", "calibrate", "--driver", "simulated", *given]) == 0
        seeds.append(json.loads((tmp_path / "result.json").read_text())["control_seed"])
        # The seed gives the program again: the motors turned by the same angles.
        drawn = imucal.simulate(Program.random(seed=seeds[-1], moves=20), seed=1, rate_hz=50.0).recording
        control = imucal.read(tmp_path / folder / "unit/control.csv")
        assert np.allclose(control.stand_rad, drawn.stand_rad, rtol=1e-12, atol=1e-12)
    assert seeds[0] != seeds[1]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--export", "kalibr-imu"), "noise"),
        (("--export", "nothing"), "format"),
        (("--limits", "none.json"), "none.json"),
        (("--program", "none.json"), "none.json"),
        (("--fault", "fire"), "fault"),
        (("--serial-number", " "), "serial number is empty"),
        (("--serial-number", "0" * 256), "the serial number has 256 characters: give at most 200"),
        (("--serial-number", "é" * 200), "the serial number has 200 characters, which is too long"),
        (("--json", "none/result.json"), "there is no folder none"),
    ],
)
def test_orders_that_cannot_be_done_are_refused_before_anything_moves(
    options, said, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    assert main(["stand", "calibrate", "--driver", "simulated", "-o", "units", *options]) == 1
    assert said in capsys.readouterr().err
    assert not list(tmp_path.glob("units/*"))


def test_exports_that_raw_counts_do_not_allow_are_refused_before_anything_moves(tmp_path):
    columns = ("time_s", *(f"{sensor}_{axis}_lsb" for sensor in ("accel", "gyro") for axis in "xyz"))
    still = SimpleNamespace(columns=columns)
    order = Order(Program.random(seed=1), exports=("c-header", "kalibr"))
    with pytest.raises(imucal.InputError, match=r"raw counts, but kalibr only corrects .* one of c-header"):
        calibrate_unit(order, lambda *_: (still, still), tmp_path, view=nullcontext)


def test_an_export_that_fails_leaves_the_verdict(line, tmp_path, monkeypatch):
    def export(calibration, name):
        if name == "kalibr":
            raise imucal.InputError("no place for it")
        return imucal.export(calibration, name)

    monkeypatch.setattr("imucal.stand.line.export", export)
    code, document, said = line("--export", "kalibr", "--export", "ros")
    assert (code, document["verdict"]) == (1, "passed")
    assert document["not_written"] == {"kalibr": "no place for it"}
    assert [item["format"] for item in document["exports"]] == ["ros"]
    assert "kalibr is not written: no place for it" in said
    assert json.loads((tmp_path / "units/unit/result.json").read_text()) == document


@pytest.mark.parametrize("when", ["run", "control"])
def test_a_port_that_is_missing_leaves_no_empty_folder(when, line, tmp_path, monkeypatch):
    opened = []

    def start(stand):
        # It is the driver and the source at once.
        if stand not in opened:
            opened.append(stand)
        if len(opened) > (when == "control"):
            raise imucal.ImucalError("the stand cannot be driven: no port")
        stand._started_s = 0.0

    monkeypatch.setattr(SimulatedStand, "start", start)
    if when == "run":
        assert main(["stand", "calibrate", "-o", "units"]) == 1
        assert list((tmp_path / "units").iterdir()) == []
        return
    code, document, said = line()
    assert (code, document["verdict"], document["reasons"][0]["code"]) == (1, "no_result", "run_error"), said
    assert "no port" in document["reasons"][0]["message"]
    assert json.loads((tmp_path / "units/unit/result.json").read_text()) == document
    # What is there of it can be found again.
    assert [recording["path"] for recording in document["recordings"]] == ["units/unit/run.csv"]
    assert datetime.fromisoformat(document["date"]).tzinfo is not None


def test_an_interrupt_says_how_the_recording_is_had(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    poll = SimulatedStand.poll

    def interrupted(stand):
        if stand.counts()["samples"]:
            raise KeyboardInterrupt
        return poll(stand)

    monkeypatch.setattr(SimulatedStand, "poll", interrupted)
    assert main(["stand", "calibrate", "--speed", "1000", "-o", "units"]) == 130
    wanted = "imucal stand recover units/unit/run.csv.journal -o units/unit/run.csv"
    assert wanted in capsys.readouterr().err
    document = json.loads((tmp_path / "units/unit/result.json").read_text())
    assert (document["verdict"], document["reasons"][0]["code"]) == ("no_result", "run_interrupted")
    assert main(wanted.split()[1:]) == 0


def test_a_full_disk_says_how_the_recording_is_had(line, tmp_path, monkeypatch):
    replace = TemporaryFile.replace

    def full(self, target, file):
        if str(target).endswith(".csv"):
            raise OSError(errno.ENOSPC, "No space left on device")
        replace(self, target, file)

    monkeypatch.setattr(TemporaryFile, "replace", full)
    code, document, said = line()
    assert (code, document["verdict"], document["reasons"][0]["code"]) == (1, "no_result", "run_error")
    message = document["reasons"][0]["message"]
    assert "No space left on device" in message
    assert "imucal stand recover units/unit/run.csv.journal -o units/unit/run.csv" in message
    assert message in said


# What becomes of a turn of the three motors.
MOTORS = {
    "reversed": lambda x, y, z: (x, -y, z),
    "exchanged": lambda x, y, z: (y, x, z),
    "stuck": lambda x, y, z: (x, y, 0),
    "two stuck": lambda x, y, z: (0, 0, z),
    "all stuck": lambda x, y, z: (0, 0, 0),
}


@pytest.mark.parametrize("fault", MOTORS)
def test_a_fault_of_the_motors_is_not_the_units(fault):
    told = Program.random(seed=1, moves=25)
    steps = tuple(Step(MOTORS[fault](*step.turn_deg), step.move_s, step.hold_s) for step in told.steps)
    options = {"seed": 3, "unit": "random:bmi088:4", "rate_hz": 100.0}
    angles = imucal.simulate(told, **options).recording.stand_rad.copy()
    # Encoders that are not heard now and then are no other fault.
    angles[1234] = np.nan
    run = imucal.simulate(Program(steps), stand="cheap:2", **options).recording
    found = assess(dataclasses.replace(run, stand_rad=angles), None, [told], gravity_mps2=9.80665)
    code, says = "stand_mismatch", "a motor may be stuck"
    if fault == "all stuck":
        code, says = "no_motion", "the stand did not move"
    assert [reason.code for reason in found.reasons] == [code]
    assert says in found.reasons[0].message
    # No result, and no second run with such a stand.
    assert (found.judged, found.result) == (False, None)


def test_frozen_data_are_not_dead_axes():
    program = Program.random(seed=1, moves=10)
    run = imucal.simulate(program, seed=3, rate_hz=50.0).recording
    still = np.ones_like(run.specific_force)
    frozen = dataclasses.replace(run, specific_force=still, angular_rate=still)
    found = assess(frozen, None, [program], gravity_mps2=9.80665)
    assert ([reason.code for reason in found.reasons], found.judged) == (["no_motion"], False)
