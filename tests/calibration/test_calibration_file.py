"""The calibration file: every bit comes back, a bad file is named with its field, apply follows the model."""

import copy
import dataclasses
import json
import math
import subprocess
import sys
from pathlib import Path

import jsonschema
import numpy as np
import pytest

import imucal
from imucal.cli import main

SCHEMA = json.loads((Path(imucal.__file__).parent / "schema" / "calibration-1.json").read_text())


def example(**changes):
    numbers = np.random.default_rng(3)
    root = numbers.normal(size=(21, 21)) * 1e-5
    fields = {
        "accelerometer": imucal.Triad(
            [[414.5, 0.1, -0.2], [0.1, 412.0, 0.3], [-0.2, 0.3, 414.6 + math.pi * 1e-13]],
            [33124, 33275, 32364.1],
        ),
        "gyroscope": imucal.Triad(
            np.diag([4777.9, 4764.2, 4773.6]) + numbers.normal(size=(3, 3)), [1e-300, -0.0, 5e2 / 3]
        ),
        "accel_unit": "lsb",
        "gyro_unit": "lsb",
        "gravity_mps2": 9.81744,
        "covariance": root @ root.T,
        "noise": {"gyro_noise_density_radps_per_sqrt_hz": 1e-4 * (0.1 + 0.2)},
        "temperature_range_degc": (21.3, 24.9),
        "fit": {"iterations": 7, "chi2_per_dof": np.float64(1.1), "converged": True},
        "control_set": {
            "chi2_per_dof": 1.2,
            "gravity_norm_rms_mps2": 0.001,
            "gravity_direction_rms_deg": 0.47,
            "rests": 31,
            "moves": 30,
        },
        "provenance": imucal.Provenance(
            (imucal.Source("a.csv", "0" * 64),), (), "0.1.0", "2024-02-03T04:05:06Z"
        ),
        "serial_number": "unité-42",
    }
    fields["covariance_names"] = tuple(
        [f"accel_bias_{a}" for a in "xyz"]
        + [f"accel_sensitivity_{e}" for e in ("xx", "yy", "zz", "xy", "xz", "yz")]
        + [f"gyro_bias_{a}" for a in "xyz"]
        + [f"gyro_sensitivity_{a}{b}" for a in "xyz" for b in "xyz"]
    )
    return imucal.Calibration(**{**fields, **changes})


def with_effects():
    """The example with effects: one plain, one with a shape, one that is a user's own."""
    per_volt = tuple(imucal.EffectParameter(axis, "rad/s/V", 1e-3) for axis in "xyz")
    own = imucal.UserEffect(
        "gyro_bias_supply",
        "gyroscope",
        per_volt,
        lambda state: state.auxiliary["supply_v"][:, None, None] * np.eye(3),
    )
    effects = (
        imucal.EffectValues("gyro_bias_temperature", [math.pi * 1e-5, -0.0, 1e-300]),
        imucal.EffectValues("gyro_bias_supply", [0.1, 0.2, 0.1 + 0.2]),
        imucal.EffectValues("accel_bias_warmup", [0.01, 0.02, 1 / 3], shape=math.e * 30),
    )
    names = [f"{effect}_{axis}" for effect in ("gyro_bias_temperature", "gyro_bias_supply") for axis in "xyz"]
    names += [f"accel_bias_warmup_{number}" for number in ("x", "y", "z", "tau")]
    root = np.random.default_rng(4).normal(size=(31, 31)) * 1e-5
    return example(
        effects=effects,
        user_effects=[own],
        covariance=root @ root.T,
        covariance_names=(*example().covariance_names, *names),
    )


def bits(array):
    return np.ascontiguousarray(array, dtype=np.float64).tobytes()


@pytest.mark.parametrize(
    "missing", [("axes",), ("references",), ("axes", "references", "verdict", "reasons")]
)
def test_a_file_of_an_older_version_is_read(missing):
    document = example().to_dict()
    older = {name: value for name, value in document.items() if name not in missing}
    jsonschema.validate(older, SCHEMA)
    read = imucal.Calibration.from_dict(older).to_dict()
    assert {name: value for name, value in read.items() if name not in missing} == older
    assert read["axes"] == "x,y,z"


def test_round_trip_keeps_every_bit(tmp_path):
    calibration = example()
    path = tmp_path / "cal.json"
    calibration.save(path)
    again = imucal.Calibration.load(path)
    for triad in ("accelerometer", "gyroscope"):
        assert bits(getattr(again, triad).sensitivity) == bits(getattr(calibration, triad).sensitivity)
        assert bits(getattr(again, triad).bias) == bits(getattr(calibration, triad).bias)
    assert bits(again.covariance) == bits(calibration.covariance)
    assert again.to_dict() == calibration.to_dict()
    again.save(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == path.read_bytes()


def test_round_trip_keeps_every_bit_of_the_effects(tmp_path):
    calibration, path = with_effects(), tmp_path / "cal.json"
    calibration.save(path)
    again = imucal.Calibration.load(path, user_effects=calibration.user_effects)
    assert [values.name for values in again.effects] == [values.name for values in calibration.effects]
    for loaded, saved in zip(again.effects, calibration.effects, strict=True):
        assert (bits(loaded.values), loaded.shape) == (bits(saved.values), saved.shape)
    assert again.user_effects == calibration.user_effects
    assert again.to_dict() == calibration.to_dict()
    assert again.covariance_names == calibration.covariance_names == tuple(p.name for p in again.parameters)
    again.save(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == path.read_bytes()


def test_a_users_effect_can_be_read_without_its_definition_but_not_applied(tmp_path, capsys):
    calibration, path = with_effects(), tmp_path / "cal.json"
    calibration.save(path)
    again = imucal.Calibration.load(path)
    assert again.parameters == calibration.parameters
    assert again.user_effects[0].parameters == calibration.user_effects[0].parameters
    again.save(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == path.read_bytes()
    still = np.zeros((3, 3))
    recording = imucal.Recording(
        np.arange(3.0),
        still,
        still,
        temperature_degc=[25, 25, 25],
        auxiliary={"supply_v": [3.3, 3.3, 3.3]},
        accel_unit="lsb",
        gyro_unit="lsb",
    )
    with pytest.raises(imucal.InputError, match="gyro_bias_supply is not in the file: pass it"):
        again.apply_recording(recording)
    imucal.write(recording, tmp_path / "run.csv")
    assert main(["apply", str(path), str(tmp_path / "run.csv"), "-o", str(tmp_path / "out.csv")]) == 1
    assert "gyro_bias_supply is not in the file: pass it" in capsys.readouterr().err
    whole = imucal.Calibration.load(path, user_effects=calibration.user_effects)
    np.testing.assert_array_equal(
        whole.apply_recording(recording).angular_rate, calibration.apply_recording(recording).angular_rate
    )


def test_effects_stand_in_the_file_with_sigma_and_unit():
    document = with_effects().to_dict()
    assert document["reference_temperature_degc"] == 25.0
    temperature, supply, warmup = document["effects"]
    assert (temperature["name"], temperature["sensor"]) == ("gyro_bias_temperature", "gyroscope")
    assert temperature["shape"] is None
    std = {p.name: p.std for p in with_effects().parameters}
    assert temperature["parameters"][0] == {
        "name": "x",
        "value": math.pi * 1e-5,
        "std": std["gyro_bias_temperature_x"],
        "unit": "rad/s/K",
    }
    assert supply["user_defined"] is True and supply["parameters"][2]["typical"] == 1e-3
    assert warmup["shape"] == {
        "name": "tau",
        "value": math.e * 30,
        "std": std["accel_bias_warmup_tau"],
        "unit": "s",
    }
    assert "user_defined" not in warmup
    assert [p["name"] for p in document["parameters"][-4:]] == [
        f"accel_bias_warmup_{n}" for n in ("x", "y", "z", "tau")
    ]


def test_a_file_from_before_effects_is_read():
    document = example().to_dict()
    del document["reference_temperature_degc"]
    assert imucal.Calibration.from_dict(document).to_dict() == example().to_dict()


def test_random_floats_keep_every_bit(tmp_path):
    numbers = np.random.default_rng(11)
    patterns = numbers.integers(0, 2**63, 20_000, dtype=np.uint64).view(np.float64)
    values = patterns[np.isfinite(patterns)].tolist()
    example(fit={"values": values}).save(tmp_path / "cal.json")
    assert bits(imucal.Calibration.load(tmp_path / "cal.json").fit["values"]) == bits(values)


@pytest.mark.parametrize("frame", ["symmetric", "triangular"])
def test_saved_file_follows_the_schema(tmp_path, frame):
    bare = imucal.Calibration(
        imucal.Triad(np.eye(3), np.zeros(3)), imucal.Triad(np.eye(3), np.zeros(3)), frame
    )
    for calibration in (example(), with_effects(), bare):
        calibration.save(tmp_path / "cal.json")
        document = json.loads((tmp_path / "cal.json").read_text())
        jsonschema.Draft202012Validator.check_schema(SCHEMA)
        jsonschema.validate(document, SCHEMA, jsonschema.Draft202012Validator)


def test_a_calibration_is_shown_in_one_line():
    figures = {"chi2_per_dof": 1.25, "gravity_direction_rms_deg": 0.05, "rests": 40, "moves": 39}
    other = {**figures, "chi2_per_dof": "large"}
    triad = imucal.Triad(np.eye(3), np.zeros(3))
    assert repr(imucal.Calibration(triad, triad)) == (
        "Calibration(unit without a number, accelerometer in m/s^2, gyroscope in rad/s, no effects)"
    )
    shown = repr(imucal.Calibration(triad, triad, serial_number="0042", calibration_set=figures))
    assert shown == (
        "Calibration(unit '0042', accelerometer in m/s^2, gyroscope in rad/s, no effects, calibration set: "
        "gravity direction error per move 0.05 deg rms, chi2 per degree of freedom 1.25)"
    )
    shown = repr(dataclasses.replace(with_effects(), control_set=other, calibration_set=figures))
    assert "gyroscope in lsb, 3 effects, control set: gravity direction error per move 0.05 deg rms)" in shown


def test_parameters_are_named_in_the_fixed_order():
    calibration = example()
    parameters = calibration.parameters
    assert tuple(p.name for p in parameters) == calibration.covariance_names
    assert (parameters[0].value, parameters[0].unit) == (33124, "lsb")
    assert (parameters[6].value, parameters[6].unit) == (0.1, "lsb/(m/s^2)")
    assert parameters[13].value == calibration.gyroscope.sensitivity[0, 1]
    assert parameters[20].std == math.sqrt(calibration.covariance[20, 20])
    lower = example(
        frame="triangular", accelerometer=imucal.Triad([[1, 0, 0], [2, 3, 0], [4, 5, 6]], [0, 0, 0])
    )
    assert {p.name: p.value for p in lower.parameters[3:9]} == {
        "accel_sensitivity_xx": 1,
        "accel_sensitivity_yy": 3,
        "accel_sensitivity_zz": 6,
        "accel_sensitivity_yx": 2,
        "accel_sensitivity_zx": 4,
        "accel_sensitivity_zy": 5,
    }


@pytest.mark.parametrize("number", [float("nan"), float("inf"), np.float64("-inf")])
def test_what_is_not_finite_is_not_written(tmp_path, number):
    path = tmp_path / "cal.json"
    example().save(path)
    before = path.read_bytes()
    with pytest.raises(imucal.InputError, match=r"\$\.fit\.deep\[1\]\.x is -?(nan|inf)"):
        example(fit={"deep": [1, {"x": number}]}).save(path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"frame": "ned"}, "frame is 'ned'"),
        ({"gravity_mps2": 0.0}, "gravity_mps2 is 0.0"),
        ({"covariance": np.eye(3)}, r"covariance has the shape \(3, 3\), \(21, 21\) is needed"),
        ({"covariance": -np.eye(21)}, "negative variance"),
    ],
)
def test_wrong_fields(fields, message):
    with pytest.raises(imucal.InputError, match=message):
        example(**fields)


@pytest.mark.parametrize(
    ("sensitivity", "bias", "message"),
    [
        (np.eye(2), np.zeros(3), r"sensitivity has the shape \(2, 2\)"),
        (np.eye(3), np.zeros((3, 1)), r"bias has the shape \(3, 1\)"),
        (np.diag([1, 1, 0]), np.zeros(3), "nearly singular"),
        (np.diag([1, 1, math.nan]), np.zeros(3), "contains the value nan"),
    ],
)
def test_wrong_triads(sensitivity, bias, message):
    with pytest.raises(imucal.InputError, match=message):
        imucal.Triad(sensitivity, bias)


def edited(path, change):
    """The document of the example with effects after `change`, written to `path`."""
    document = copy.deepcopy(with_effects().to_dict())
    change(document)
    path.write_text(json.dumps(document))


def put(*keys, value):
    def change(document):
        for key in keys[:-1]:
            document = document[key]
        document[keys[-1]] = value

    return change


BAD_FIELDS = {
    "no schema": (lambda d: d.pop("schema"), "has no schema"),
    "other schema": (put("schema", value="imucal.calibration/2"), "has the schema 'imucal.calibration/2'"),
    "no T": (lambda d: d["gyroscope"].pop("T"), r"the field \$\.gyroscope\.T is missing"),
    "short T": (
        put("accelerometer", "T", value=[[1, 2, 3]]),
        r"\$\.accelerometer\.T .* a list of 3 items, not 1",
    ),
    "text in T": (
        put("accelerometer", "T", 1, 2, value="7"),
        r'\$\.accelerometer\.T\[1\]\[2\] is "7", it must be a num',
    ),
    "true in bias": (put("gyroscope", "bias", 0, value=True), r"\$\.gyroscope\.bias\[0\] is true"),
    "object for list": (
        put("gyroscope", "bias", value={}),
        r"\$\.gyroscope\.bias is \{\}, it must be a list",
    ),
    "null gravity": (put("gravity_mps2", value=None), r"\$\.gravity_mps2 is null"),
    "unknown unit": (put("raw_units", "gyroscope", value="dps"), r'\$\.raw_units\.gyroscope is "dps"'),
    "unknown frame": (put("accelerometer", "frame", value="ned"), r"one of symmetric, triangular"),
    "no provenance": (lambda d: d.pop("provenance"), r"\$\.provenance is missing"),
    "singular": (put("accelerometer", "T", value=[[0] * 3] * 3), "nearly singular"),
    "other value": (
        put("parameters", 3, "value", value=1.0),
        r"\$\.parameters\[3\]\.value is 1.0, but \$\.accelerometer\.T\[0\]\[0\] gives 414.5: correct one",
    ),
    "newer effect": (put("effects", 0, "name", value="new"), r"\$\.effects\[0\] is not known .* \(new\)"),
    "effect of another sensor": (
        put("effects", 0, "sensor", value="accelerometer"),
        r'\$\.effects\[0\]\.sensor is "accelerometer", it must be one of gyroscope',
    ),
    "short effect": (
        lambda d: d["effects"][0]["parameters"].pop(),
        r"\$\.effects\[0\]\.parameters has 2 items, 3 or 6 or 9 are needed",
    ),
    "other parameter": (
        put("effects", 0, "parameters", 1, "name", value="q"),
        r'\$\.effects\[0\]\.parameters\[1\]\.name is "q", it must be one of y',
    ),
    "other unit": (
        put("effects", 0, "parameters", 1, "unit", value="deg/s/K"),
        r"\$\.effects\[0\]\.parameters\[1\]\.unit is .* it must be one of rad/s/K",
    ),
    "text for an effect's number": (
        put("effects", 0, "parameters", 1, "value", value="1"),
        r"\$\.effects\[0\]\.parameters\[1\]\.value is .* a number",
    ),
    "no shape": (put("effects", 2, "shape", value=None), r"\$\.effects\[2\]\.shape is null"),
    "a shape too many": (
        put("effects", 0, "shape", value={"name": "tau", "value": 1.0, "std": None, "unit": "s"}),
        r"\$\.effects\[0\]\.shape must be null",
    ),
    "negative shape": (put("effects", 2, "shape", "value", value=-1.0), "shape of accel_bias_warmup is -1.0"),
    "effect's other value": (
        put("parameters", 21, "value", value=1.0),
        r"\$\.parameters\[21\]\.value is 1.0, but \$\.effects\[0\]\.parameters\[0\]\.value gives 3\.14",
    ),
    "an effect twice": (lambda d: d["effects"].append(d["effects"][0]), "an effect occurs twice"),
    "a user's name that is taken": (
        put("effects", 1, "name", value="gyro_bias_drift"),
        "the catalogue has an effect gyro_bias_drift already",
    ),
    "a user's effect without typical size": (
        lambda d: d["effects"][1]["parameters"][0].pop("typical"),
        r"\$\.effects\[1\]\.parameters\[0\]\.typical is missing",
    ),
    "other reference temperature": (
        put("reference_temperature_degc", value=20.0),
        r"\$\.reference_temperature_degc is 20.0: the reference temperature of this version .* is 25.0",
    ),
    "covariance": (lambda d: d["covariance"]["names"].pop(), r"\$\.covariance\.matrix"),
    "huge": (put("gravity_mps2", value=10**400), r"\$\.gravity_mps2 .*finite"),
}


@pytest.mark.parametrize("case", BAD_FIELDS, ids=str)
def test_bad_field_is_named(tmp_path, case):
    change, message = BAD_FIELDS[case]
    edited(tmp_path / "cal.json", change)
    with pytest.raises(imucal.FormatError, match=message) as caught:
        imucal.Calibration.load(tmp_path / "cal.json")
    assert str(caught.value).startswith(f"{tmp_path / 'cal.json'}: ")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "empty"),
        ("{", "is not JSON: line 1, column 2"),
        ("[]", "has no schema"),
        ('"x"', "has no schema"),
        ('{"schema": NaN}', "NaN is no JSON number"),
        ("time_s,accel_x_mps2\n", "is not JSON"),
        ("[" * 100_000, "is not JSON"),
        ('{"schema": ' + "1" * 5000 + "}", "is JSON that cannot be read"),
    ],
)
def test_other_files(tmp_path, text, message):
    path = tmp_path / "cal.json"
    path.write_text(text)
    with pytest.raises(imucal.FormatError, match=message):
        imucal.Calibration.load(path)


def test_apply_is_the_inverse_of_the_model():
    calibration = example(gyroscope=imucal.Triad(np.eye(3) + 0.01, [1, 2, 3]))
    numbers = np.random.default_rng(1)
    rate, force = numbers.normal(size=(100, 3)), numbers.normal(size=(100, 3))
    raw_rate = rate @ calibration.gyroscope.sensitivity.T + calibration.gyroscope.bias
    raw_force = force @ calibration.accelerometer.sensitivity.T + calibration.accelerometer.bias
    again_rate, again_force = calibration.apply(np.asfortranarray(raw_rate), raw_force.tolist())
    np.testing.assert_allclose(again_rate, rate, atol=1e-13)
    np.testing.assert_allclose(again_force, force, atol=1e-10)
    with pytest.raises(imucal.InputError, match="specific_force has 99 rows but 100 are needed"):
        calibration.apply(raw_rate, raw_force[1:])
    raw = imucal.Recording(
        np.arange(100), raw_force, raw_rate, accel_unit="lsb", gyro_unit="lsb", name="run.csv"
    )
    corrected = calibration.apply_recording(raw)
    np.testing.assert_array_equal(corrected.specific_force, again_force)
    assert (corrected.accel_unit, corrected.gyro_unit) == ("m/s^2", "rad/s")
    with pytest.raises(
        imucal.InputError, match="accelerometer is in m/s\\^2 but the calibration expects lsb"
    ):
        calibration.apply_recording(corrected)


def test_import_is_light():
    program = (
        "import sys, imucal; print([m for m in ('pyarrow', 'click', 'plotly', 'rich') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
