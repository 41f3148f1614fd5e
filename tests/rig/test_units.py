"""The unit files: valid, sourced, simulated, and drawn from as their spread says.

`to_json` is used, because it is the text that documents are compared by.
"""

import dataclasses
import json
from importlib import resources

import jsonschema
import numpy as np
import pytest

import imucal
from imucal.document.json_document import to_json
from imucal.effects import catalogue

FOLDER = resources.files("imucal")
SCHEMA = json.loads((FOLDER / "schema" / "unit-1.json").read_text(encoding="utf-8"))
NAMES = imucal.unit_names()
G = 9.80665
DEG = np.pi / 180


def file_of(name):
    return json.loads((FOLDER / "rig" / "shipped" / f"{name}.json").read_text(encoding="utf-8"))


def test_all_units_are_there():
    assert set(NAMES) == {"paper", "ideal", "bmi088", "adis16460", "icm42688p", "mpu6050", "lsm6dso"}


@pytest.mark.parametrize("name", NAMES)
def test_a_unit_file_is_valid_and_every_figure_has_its_source(name):
    document = file_of(name)
    jsonschema.Draft202012Validator(SCHEMA).validate(document)
    assert document["name"] == name
    for section in ("accelerometer", "gyroscope", "spread"):
        for key, figure in document[section].items():
            if isinstance(figure, dict):
                assert figure["source"] in document["sources"], (section, key)


@pytest.mark.parametrize("name", NAMES)
def test_a_unit_is_simulated_as_its_file_says(name):
    unit = imucal.Unit.named(name)
    run = imucal.simulate(imucal.Static(duration_s=40.0), unit=name, rate_hz=100, seed=1)
    for sensor, measured in (
        (unit.accelerometer, run.recording.specific_force),
        (unit.gyroscope, run.recording.angular_rate),
    ):
        if sensor.lsb is None:
            assert (np.ptp(measured, axis=0) == 0).all()
            continue
        counts = measured / sensor.lsb
        np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
        # White noise and rounding; flicker adds little at this length.
        expected = np.hypot(sensor.noise_density * 10.0, sensor.lsb / np.sqrt(12))
        assert measured.std(axis=0) == pytest.approx([expected] * 3, rel=0.1)


def test_figures_are_those_of_the_datasheets():
    bmi088 = imucal.Unit.named("bmi088")
    # Densities of datasheets are one-sided.
    assert bmi088.gyroscope.noise_density == pytest.approx(0.014 * DEG / np.sqrt(2))
    assert bmi088.accelerometer.lsb == pytest.approx(G / 10920)
    # 2 deg/h is the floor of the Allan deviation, 0.664 B.
    assert bmi088.gyroscope.bias_instability * 0.6643 == pytest.approx(2 * DEG / 3600, rel=1e-3)
    assert imucal.Unit.named("mpu6050").accelerometer.noise_density == pytest.approx(400e-6 * G / np.sqrt(2))
    paper = imucal.Unit.named("paper")
    assert paper.gyroscope.sensitivity[0].tolist() == [0.9771, 0.0094 * 1.0309, -0.0060 * 1.0030]
    assert paper.accelerometer.bias == pytest.approx(np.array([-0.0427, 0.0241, 0.0402]) * G)


@pytest.mark.parametrize(
    ("name", "sensor", "rms", "bandwidth_hz"),
    [
        ("mpu6050", "gyroscope", 0.05 * DEG, 98.0),
        ("icm42688p", "gyroscope", 0.028 * DEG, 100.0),
    ],
)
def test_simulated_noise_in_a_bandwidth_is_that_of_the_datasheet(name, sensor, rms, bandwidth_hz):
    """The root mean square noise behind a filter, which a datasheet gives with its one-sided density.

    The simulated filter is a Butterworth filter of second order: it passes the noise of 1.11 times its
    bandwidth. A two-sided density would give 1.41 times as much.
    """
    unit = imucal.Unit.named(name)
    filtered = dataclasses.replace(
        getattr(unit, sensor), filter_hz=bandwidth_hz, lsb=None, bits=None, bias_instability=0.0
    )
    run = imucal.simulate(
        imucal.Static(30.0), unit=dataclasses.replace(unit, **{sensor: filtered}), rate_hz=1000, seed=2
    ).recording
    measured = run.angular_rate if sensor == "gyroscope" else run.specific_force
    found = np.sqrt(np.mean(measured.var(axis=0)) / 1.11)
    assert found == pytest.approx(rms, rel=0.12)


def test_a_one_sided_density_is_that_of_an_allan_deviation_times_the_square_root_of_two(tmp_path):
    document = file_of("ideal")
    given = {"value": 0.01, "unit": "deg/s/sqrt(Hz)"}
    document["gyroscope"]["noise_density_one_sided"] = given
    path = tmp_path / "own.json"
    path.write_text(json.dumps(document))
    run = imucal.simulate(imucal.Static(600.0), unit=path, rate_hz=100, seed=1).recording
    taus_s, deviations = imucal.allan_deviation(run.angular_rate, 100.0, [1.0])
    assert taus_s == [1.0]
    assert deviations[0] == pytest.approx([0.01 * DEG / np.sqrt(2)] * 3, rel=0.08)
    document["gyroscope"]["noise_density"] = given
    path.write_text(json.dumps(document))
    with pytest.raises(imucal.FormatError, match="has noise_density and noise_density_one_sided: give one"):
        imucal.Unit.read(path)


@pytest.mark.parametrize("name", ["paper", "mpu6050", "random:bmi088:5"])
def test_a_written_unit_comes_back_bit_for_bit(name, tmp_path):
    unit = imucal.simulate("static", unit=name, rate_hz=10, seed=1).truth.setup.unit
    unit.write(tmp_path / "unit.json")
    jsonschema.Draft202012Validator(SCHEMA).validate(json.loads((tmp_path / "unit.json").read_text()))
    again = imucal.Unit.read(tmp_path / "unit.json")
    assert to_json(again.to_dict()) == to_json(unit.to_dict())
    runs = [
        imucal.simulate("static", unit=u, rate_hz=10, seed=1).recording
        for u in (unit, tmp_path / "unit.json")
    ]
    assert (runs[0].angular_rate == runs[1].angular_rate).all()


def test_drawn_units_scatter_as_the_spread_says():
    units = [imucal.Unit.random("mpu6050", seed) for seed in range(1000)]
    accel = np.array([u.accelerometer.sensitivity for u in units])
    gyro = np.array([u.gyroscope.sensitivity for u in units])
    # In the body frame the accelerometer's off-diagonal entry is the mean of two; the gyroscope turns along.
    drawn = {
        "accel bias x": ([u.accelerometer.bias[0] for u in units], 0.050 * G),
        "accel bias z": ([u.accelerometer.bias[2] for u in units], 0.080 * G),
        "accel scale": ([s[0, 0] - 1 for s in accel], 0.03),
        "accel misalignment": ([s[0, 1] for s in accel], 0.02 / np.sqrt(2)),
        # Maxima of 20 deg/s and of 3 % are three standard deviations.
        "gyro bias": ([u.gyroscope.bias[1] for u in units], 20 * DEG / 3),
        "gyro scale": ([s[2, 2] - 1 for s in gyro], 0.01),
        "gyro misalignment": ([s[1, 0] for s in gyro], 0.02 * np.sqrt(1 + 1 / 2)),
        "accel bias over temperature": ([u.effects[0].values[2] for u in units], 1.33e-3 * G),
        "g-sensitivity": ([u.effects[-1].values[4] for u in units], 0.1 * DEG / G),
    }
    for name, (values, std) in drawn.items():
        values = np.asarray(values)
        assert abs(values.mean()) < 4 * std / np.sqrt(1000) + 1e-3 * std, name
        # The entries of the two matrices are so to first order in the misalignment of 2 %.
        assert values.std() == pytest.approx(std, rel=4 / np.sqrt(2000) + 0.02), name
    assert (accel == np.swapaxes(accel, 1, 2)).all()
    assert [effect.name for effect in units[0].effects] == [
        "accel_bias_temperature",
        "accel_scale_temperature",
        "gyro_bias_temperature",
        "gyro_scale_temperature",
        "gyro_g_sensitivity",
    ]


def test_the_same_seed_draws_the_same_unit():
    first, again, other = (imucal.Unit.random("bmi088", seed) for seed in (7, 7, 8))
    assert to_json(first.to_dict()) == to_json(again.to_dict())
    assert (first.gyroscope.bias != other.gyroscope.bias).all()
    by_name = imucal.simulate("static", unit="random:bmi088:7", rate_hz=10, seed=1).truth
    assert (by_name.calibration.gyroscope.bias == first.gyroscope.bias).all()


def test_a_profile_of_ones_own_is_drawn_from(tmp_path):
    document = file_of("ideal")
    document["spread"]["gyro_bias"] = {"value": 3, "unit": "deg/s", "limit": "typical"}
    (tmp_path / "own.json").write_text(json.dumps(document))
    unit = imucal.Unit.random(tmp_path / "own.json", 1)
    assert (unit.gyroscope.bias != 0).all()
    assert (unit.accelerometer.sensitivity == np.eye(3)).all()


@pytest.mark.parametrize("effect", catalogue(), ids=lambda effect: effect.name)
def test_a_profile_may_spread_any_effect(effect, tmp_path):
    document = file_of("ideal")
    unit = effect.parameters[0].unit
    document["spread"][effect.name] = {"value": 1e-3, "unit": unit, "limit": "typical"}
    (tmp_path / "own.json").write_text(json.dumps(document))
    drawn = imucal.Unit.random(tmp_path / "own.json", 1)
    assert [values.name for values in drawn.effects] == [effect.name]
    [values] = drawn.effects
    assert (values.values != 0).all()
    assert (values.shape is None) == (effect.shape is None)
    document["spread"][effect.name]["value"] = [1e-3, 2e-3, 3e-3]
    (tmp_path / "own.json").write_text(json.dumps(document))
    if effect.plain == 3:
        imucal.Unit.random(tmp_path / "own.json", 1)
    else:
        with pytest.raises(imucal.FormatError, match=f"{effect.name}.value is .* must be a number"):
            imucal.Unit.random(tmp_path / "own.json", 1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.update(schema="imucal.unit/9"), "has the schema 'imucal.unit/9'"),
        (lambda d: d.pop("gyroscope"), r"\$\.gyroscope is missing"),
        (
            lambda d: d["gyroscope"]["noise_density_one_sided"].update(unit="furlong"),
            "unit is 'furlong': give one of rad/s",
        ),
        (
            lambda d: d["gyroscope"]["noise_density_one_sided"].update(unit="ug/sqrt(Hz)"),
            "give one of rad/s/sqrt",
        ),
        (
            lambda d: d["gyroscope"].update(bias={"value": [1, 2], "unit": "rad/s"}),
            "a list of 3 items, not 2",
        ),
        (lambda d: d["accelerometer"]["resolution"].update(value=0), "resolution.value is 0"),
        (
            lambda d: d["gyroscope"].update(bias_instability={"value": 1, "unit": "deg/h"}),
            "has allan_floor and bias_instability",
        ),
        (lambda d: d.update(effects=[{"name": "gyro_bias_drift", "values": ["a"]}]), r"values\[0\] is \"a\""),
        (
            lambda d: d.update(effects=[{"name": "gyro_bias_drift", "values": [1]}]),
            "3 parameters: 1 were given",
        ),
        (lambda d: d.update(effects=[{"name": "bogus", "values": [1]}]), r"effects\[0\]: there is no effect"),
        (lambda d: d["gyroscope"].update(noise_densty=None), r"gyroscope.noise_densty is no field"),
        (lambda d: d.update(spreads={}), r"\$.spreads is no field"),
    ],
)
def test_a_bad_unit_file_is_refused_by_its_field(change, message, tmp_path):
    document = file_of("bmi088")
    change(document)
    (tmp_path / "bad.json").write_text(json.dumps(document))
    with pytest.raises(imucal.FormatError, match=message):
        imucal.Unit.read(tmp_path / "bad.json")


@pytest.mark.parametrize(
    ("unit", "message"),
    [
        ("bogus", "the unit 'bogus' is not known: give one of adis16460"),
        ("random:bogus", "the unit 'bogus' is not known: give one of adis16460"),
        ("random:bmi088:x", "give random:NAME or random:NAME:SEED"),
        ("random:ideal", "ideal.json gives no spread"),
        ("none.json", "none.json: there is no such file"),
    ],
)
def test_a_unit_that_is_none_is_an_error_with_the_way_out(unit, message):
    with pytest.raises(imucal.InputError, match=message):
        imucal.simulate("static", unit=unit, seed=1)
