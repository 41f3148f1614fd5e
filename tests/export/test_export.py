"""Exports against the consumers' own formulas, written here from their code, on raw samples.

Where a consumer comes as a package it is run (imufusion); C and Rust are in test_compiled.py.

`convert_frame` of `imucal._core` gives the reference for frames, and `xml_comment` is called directly,
because no calibration has a comment with such text.
"""

import dataclasses
import fnmatch
import json
import re
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import imufusion
import numpy as np
import pytest
import yaml

import imucal
from imucal.cli import main
from imucal.effects import catalogue
from imucal.exporting import FORMATS, formats_markdown

ROOT = Path(__file__).resolve().parents[2]
ACCELEROMETER = imucal.Triad(
    [[0.9804, 0.0012, 0.0055], [0.0012, 0.9727, 0.0043], [0.0055, 0.0043, 0.9921]], [-0.42, 0.24, 0.39]
)
GYROSCOPE = imucal.Triad(
    [[0.9771, 0.0097, -0.0060], [-0.0084, 1.0309, -0.0031], [0.0087, 0.0036, 1.0030]], [-0.035, 0.0042, 0.001]
)
UNIT = imucal.Calibration(ACCELEROMETER, GYROSCOPE, serial_number="0042")
# Not symmetric: here rows are told from columns.
TRIANGULAR = imucal.Calibration(
    imucal.Triad([[0.9804, 0, 0], [0.0112, 0.9727, 0], [-0.0155, 0.0083, 0.9921]], ACCELEROMETER.bias),
    GYROSCOPE,
    frame="triangular",
)
COUNTS = imucal.Calibration(
    imucal.Triad(ACCELEROMETER.sensitivity * 418.0, [31.0, -24.0, 96.0]),
    imucal.Triad(GYROSCOPE.sensitivity * 4775.0, [17.0, -45.0, 51.0]),
    accel_unit="lsb",
    gyro_unit="lsb",
)
G_SENSITIVITY = imucal.EffectValues(
    "gyro_g_sensitivity",
    np.array([[0.02, 0.06, 0.14], [-0.28, 0.004, 0.17], [-0.15, -0.17, 0.05]]).ravel() * 1e-3,
)
GYRO_WARM = imucal.EffectValues("gyro_bias_temperature", [2e-4, -3e-4, 1e-4, 2e-6, 4e-6, -3e-6])
ACCEL_WARM = imucal.EffectValues("accel_bias_temperature", [2e-3, -1e-3, 3e-3])
SINGLE = 2.0**-24
in_both_frames = pytest.mark.parametrize("unit", [UNIT, TRIANGULAR], ids=["symmetric", "triangular"])
in_all_units = pytest.mark.parametrize(
    "unit", [UNIT, TRIANGULAR, COUNTS], ids=["symmetric", "triangular", "counts"]
)
NEEDS_NOISE = [name for name, form in FORMATS.items() if form.needs_noise]
CORRECTING = [name for name in FORMATS if name not in NEEDS_NOISE]


def unit_with(*effects, unit=UNIT, **changes):
    return dataclasses.replace(unit, effects=effects, **changes)


def raw(unit=UNIT, count=500):
    """Raw samples of a unit that is thrown about: rate and force in its own units."""
    random = np.random.default_rng(3)
    rate, force = random.normal(0, 2, (count, 3)), random.normal(0, 10, (count, 3))
    return (
        rate @ unit.gyroscope.sensitivity.T + unit.gyroscope.bias,
        force @ unit.accelerometer.sensitivity.T + unit.accelerometer.bias,
    )


def recording(unit=UNIT):
    """The same as a recording that warms from 5 to 65 degC."""
    rate, force = raw(unit)
    return imucal.Recording(
        np.arange(len(rate)) / 100.0, force, rate, temperature_degc=np.linspace(5.0, 65.0, len(rate))
    )


def rotation_between(before, after):
    """The matrix R with after = R before, from samples alone; it must be a rotation."""
    found = np.linalg.lstsq(before, after, rcond=None)[0].T
    np.testing.assert_allclose(found @ found.T, np.eye(3), rtol=0, atol=1e-14)
    assert np.linalg.det(found) > 0
    return found


def assert_turned(unit, rate, force):
    """Rate and force are those of `apply` in another frame, the same one for both."""
    expected_rate, expected_force = unit.apply(*raw(unit))
    rotation = rotation_between(expected_force, force)
    np.testing.assert_allclose(force, expected_force @ rotation.T, rtol=0, atol=1e-13)
    np.testing.assert_allclose(rate, expected_rate @ rotation.T, rtol=0, atol=1e-13)
    return rotation


# --- the consumers' formulas ----------------------------------------------------------------------


@in_both_frames
@pytest.mark.parametrize("effects", [(), (G_SENSITIVITY,)], ids=["linear", "g-sensitivity"])
def test_kalibr(unit, effects):
    unit = unit_with(*effects, unit=unit)
    exported = imucal.export(unit, "kalibr")
    imu = yaml.safe_load(exported.text)["imu0"]
    assert imu["model"] == "scale-misalignment"
    m_accel, m_gyro = np.array(imu["accelerometers"]["M"]), np.array(imu["gyroscopes"]["M"])
    a, c_gyro_i = np.array(imu["gyroscopes"]["A"]), np.array(imu["gyroscopes"]["C_gyro_i"])
    assert (np.triu(m_accel, 1) == 0).all() and (np.triu(m_gyro, 1) == 0).all()
    np.testing.assert_allclose(c_gyro_i @ c_gyro_i.T, np.eye(3), rtol=0, atol=1e-14)
    assert np.linalg.det(c_gyro_i) > 0
    # IccSensors.py: a = M a_i + b, w = M (C_gyro_i w_i) + A (C_gyro_i a_i) + b; the biases are the user's.
    rate, force = raw(unit)
    force_i = np.linalg.solve(m_accel, (force - unit.accelerometer.bias).T).T
    rate_gyro = np.linalg.solve(m_gyro, (rate - unit.gyroscope.bias - force_i @ c_gyro_i.T @ a.T).T).T
    rotation = assert_turned(unit, rate_gyro @ c_gyro_i, force_i)
    said = re.search(r"R = (\[\[.*?\]\])", exported.text.replace("\n#  ", ""), re.DOTALL)
    assert (said is None) == (unit.frame == "triangular")
    np.testing.assert_allclose(json.loads(said[1]) if said else np.eye(3), rotation, rtol=0, atol=1e-13)


def test_kalibr_says_the_biases_that_it_does_not_carry():
    exported = imucal.export(UNIT, "kalibr")
    assert "-0.42, 0.24, 0.39" in exported.lost[0] and "-0.035, 0.0042, 0.001" in exported.lost[0]


@in_both_frames
def test_basalt(unit):
    value = json.loads(imucal.export(unit, "basalt").text)["value0"]
    accel, gyro = value["calib_accel_bias"], value["calib_gyro_bias"]
    assert (len(accel), len(gyro)) == (9, 12)
    # calib_bias.hpp, getBiasAndScale and getCalibrated.
    accel_scale = np.zeros((3, 3))
    accel_scale[:, 0] = accel[3:6]
    accel_scale[1, 1], accel_scale[2, 1], accel_scale[2, 2] = accel[6:]
    gyro_scale = np.column_stack((gyro[3:6], gyro[6:9], gyro[9:12]))
    rate, force = raw(unit)
    assert_turned(
        unit, rate + rate @ gyro_scale.T - gyro[:3], force + force @ accel_scale.T - np.array(accel[:3])
    )


@in_both_frames
def test_ros_imu_calib(unit):
    document = yaml.safe_load(imucal.export(unit, "ros").text)
    matrix, bias = np.reshape(document["SM"], (3, 3)), np.array(document["bias"])
    rate, force = raw(unit)
    # accel_calib.cpp, applyCalib.
    np.testing.assert_allclose(force @ matrix.T - bias, unit.apply(rate, force)[1], rtol=0, atol=1e-13)
    # apply_calib.cpp, rawImuCallback: the rate at rest is subtracted, and nothing else.
    model = imucal.export(unit, "ros").same_as
    np.testing.assert_allclose(
        model.apply(rate, force)[0], rate - np.array([-0.035, 0.0042, 0.001]), rtol=0, atol=1e-13
    )


@in_both_frames
def test_realsense(unit):
    imu = json.loads(imucal.export(unit, "realsense").text)["imus"][0]
    rate, force = raw(unit)
    expected = unit.apply(rate, force)
    for sensor, samples, wanted in (("gyroscope", rate, expected[0]), ("accelerometer", force, expected[1])):
        # rs-imu-calibration.py: Y = w X, with w = (raw, -1), and X row by row in the file.
        x = np.vstack((np.reshape(imu[sensor]["scale_and_alignment"], (3, 3)), imu[sensor]["bias"]))
        w = np.hstack((samples, -np.ones((len(samples), 1))))
        np.testing.assert_allclose(w @ x, wanted, rtol=0, atol=1e-13)


@in_all_units
def test_fusion(unit):
    text = imucal.export(unit, "fusion").text

    def constant(name):
        numbers = re.search(rf"\b{name} = ([^;]*);", text)[1]
        return np.array([float(n) for n in re.findall(r"-?[\d.]+(?:e-?\d+)?(?=f)", numbers)])

    rate, force = raw(unit)
    expected = unit.apply(rate, force)
    for sensor, samples, wanted in (
        ("gyroscope", rate, np.rad2deg(expected[0])),
        ("accelerometer", force, expected[1] / 9.80665),
    ):
        arguments = (
            constant(f"{sensor}Misalignment").reshape(3, 3),
            constant(f"{sensor}Sensitivity"),
            constant(f"{sensor}Offset"),
        )
        found = np.array([imufusion.model_inertial(sample, *arguments) for sample in samples])
        # A few roundings of float32 of numbers of this size.
        size = np.abs(wanted).max(axis=1, keepdims=True) + np.abs(arguments[2] * arguments[1]).max()
        assert (np.abs(found - wanted) <= 8 * SINGLE * size).all()


@in_all_units
def test_matlab(unit):
    text = imucal.export(unit, "matlab").text
    code = [line for line in text.splitlines() if not line.startswith("%")]
    assert code[0] == "function [rate, force] = imucal_correct(raw_rate, raw_force)"
    constants = {}
    for line in code[1:5]:
        name, numbers = re.fullmatch(r"(\w+) = \[(.*)\];", line).groups()
        constants[name] = np.array([[float(n) for n in row.split(",")] for row in numbers.split(";")])
    assert code[5:] == [
        "rate = bsxfun(@minus, raw_rate, gyro_bias) / gyro_T';",
        "force = bsxfun(@minus, raw_force, accel_bias) / accel_T';",
        "end",
    ]
    # A / B solves X B = A.
    expected = unit.apply(*raw(unit))
    for samples, sensor, wanted in zip(raw(unit), ("gyro", "accel"), expected, strict=True):
        found = np.linalg.solve(constants[f"{sensor}_T"], (samples - constants[f"{sensor}_bias"]).T).T
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-13)


def px4_parameters(text):
    rows = [line.split("\t") for line in text.splitlines() if line and not line.startswith("#")]
    assert all(row[:2] == ["1", "1"] and row[4] in {"6", "9"} for row in rows)
    return {row[2]: (int if row[4] == "6" else float)(row[3]) for row in rows}


def px4(parameters, rec):
    """Accelerometer.hpp and Gyroscope.hpp Correct; TemperatureCompensation.cpp calc_thermal_offsets_3D."""

    def vector(name):
        return np.array([parameters[name.format(axis)] for axis in "XYZ"])

    def thermal(letter):
        if not parameters.get(f"TC_{letter}_ENABLE"):
            return 0.0
        low, high, reference = (parameters[f"TC_{letter}0_{name}"] for name in ("TMIN", "TMAX", "TREF"))
        delta = (np.clip(rec.temperature_degc, low, high) - reference)[:, None]
        x0, x1, x2, x3 = (
            np.array([parameters[f"TC_{letter}0_X{power}_{i}"] for i in range(3)]) for power in range(4)
        )
        return x0 + x1 * delta + x2 * delta**2 + x3 * delta**3

    force = (rec.specific_force - thermal("A") - vector("CAL_ACC0_{}OFF")) * vector("CAL_ACC0_{}SCALE")
    return rec.angular_rate - thermal("G") - vector("CAL_GYRO0_{}OFF"), force


def ardupilot_parameters(text):
    rows = [line.split(",") for line in text.splitlines() if line and not line.startswith("#")]
    return {name: float(value) for name, value in rows}


def ardupilot(parameters, rec):
    """_rotate_and_correct_accel and _gyro of AP_InertialSensor_Backend.cpp; AP_InertialSensor_tempcal.cpp."""

    def vector(name):
        return np.array([parameters[f"{name}_{axis}"] for axis in "XYZ"])

    def thermal(name):
        if not parameters.get("INS_TCAL1_ENABLE"):
            return 0.0
        c = [vector(f"INS_TCAL1_{name}{power}") for power in (1, 2, 3)]

        def polynomial(degc):
            held = np.clip(degc, parameters["INS_TCAL1_TMIN"], parameters["INS_TCAL1_TMAX"])
            x = np.reshape(held - 35.0, (-1, 1))
            return (c[0] + (c[1] + c[2] * x) * x) * x * 1.0e-6

        return polynomial(rec.temperature_degc) - polynomial(parameters[f"INS_{name}1_CALTEMP"])

    force = (rec.specific_force - thermal("ACC") - vector("INS_ACCOFFS")) * vector("INS_ACCSCAL")
    return rec.angular_rate - thermal("GYR") - vector("INS_GYROFFS"), force


AUTOPILOTS = {"px4": (px4_parameters, px4), "ardupilot": (ardupilot_parameters, ardupilot)}
PLAIN_ACCELEROMETER = imucal.Triad(np.diag([0.98, 1.02, 0.99]), [-0.42, 0.24, 0.39])
PLAIN_GYROSCOPE = imucal.Triad(np.eye(3), [-0.035, 0.0042, 0.001])


@pytest.mark.parametrize("name", AUTOPILOTS)
@pytest.mark.parametrize(
    "effects",
    [(), (GYRO_WARM,), (ACCEL_WARM,), (GYRO_WARM, ACCEL_WARM)],
    ids=["linear", "gyro", "accel", "both"],
)
@pytest.mark.parametrize("plain", [True, False], ids=["what it can carry", "misaligned"])
def test_autopilots(name, effects, plain):
    triads = {"accelerometer": PLAIN_ACCELEROMETER, "gyroscope": PLAIN_GYROSCOPE} if plain else {}
    unit = unit_with(*effects, temperature_range_degc=(5.0, 65.0), **triads)
    exported = imucal.export(unit, name)
    parse, formula = AUTOPILOTS[name]
    rec = recording(unit)
    rate, force = formula(parse(exported.text), rec)
    # Of a unit without misalignment nothing is lost; of another what the export says.
    expected = (unit if plain else exported.same_as).apply_recording(rec)
    np.testing.assert_allclose(rate, expected.angular_rate, rtol=0, atol=2 * SINGLE)
    np.testing.assert_allclose(force, expected.specific_force, rtol=0, atol=200 * SINGLE)


@pytest.mark.parametrize("name", AUTOPILOTS)
def test_a_range_without_the_reference_temperature_changes_nothing_in_it(name):
    unit = unit_with(
        GYRO_WARM,
        accelerometer=PLAIN_ACCELEROMETER,
        gyroscope=PLAIN_GYROSCOPE,
        temperature_range_degc=(40.0, 65.0),
    )
    parse, formula = AUTOPILOTS[name]
    rec = recording(unit)
    warm = rec.temperature_degc >= 40.0
    rate, _ = formula(parse(imucal.export(unit, name).text), rec)
    expected = unit.apply_recording(rec).angular_rate
    np.testing.assert_allclose(rate[warm], expected[warm], rtol=0, atol=2 * SINGLE)


def test_the_scales_of_autopilots_leave_the_smallest_errors():
    scales = px4_parameters(imucal.export(UNIT, "px4").text)
    # A mean of squares over all directions is the one over three that are orthogonal.
    directions = np.eye(3)
    for i, axis in enumerate("XYZ"):
        seen = directions @ UNIT.accelerometer.sensitivity.T
        best = np.linalg.lstsq(seen[:, [i]], directions[:, i], rcond=None)[0][0]
        assert scales[f"CAL_ACC0_{axis}SCALE"] == pytest.approx(best, rel=1e-7)


def test_autopilots_start_from_the_frame_nearest_to_the_sensor():
    triangular = imucal._core.convert_frame(ACCELEROMETER.sensitivity, GYROSCOPE.sensitivity, "triangular")
    turned = imucal.Calibration(
        imucal.Triad(triangular[0], ACCELEROMETER.bias),
        imucal.Triad(triangular[1], GYROSCOPE.bias),
        frame="triangular",
    )
    found = px4_parameters(imucal.export(turned, "px4").text)
    assert found == pytest.approx(px4_parameters(imucal.export(UNIT, "px4").text), rel=1e-7)


# --- noise ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def still():
    """A unit, and the noise of its recording at rest."""
    unit = imucal.Unit.named("icm42688p")
    recording = imucal.simulate(imucal.Static(400), unit=unit, rate_hz=100, seed=2).recording
    return unit, imucal.noise(recording)


def test_gazebo(still):
    simulated, figures = still
    exported = imucal.export(UNIT, "gazebo", noise=figures)
    imu = ElementTree.fromstring(exported.text)
    for sensor, element, triad, source in (
        ("gyro", "angular_velocity", UNIT.gyroscope, simulated.gyroscope),
        ("accel", "linear_acceleration", UNIT.accelerometer, simulated.accelerometer),
    ):
        for i, axis in enumerate("xyz"):
            noise = imu.find(f"{element}/{axis}/noise")
            assert noise.get("type") == "gaussian"
            assert float(noise.findtext("mean")) == triad.bias[i]
            # GaussianNoiseModel.cc adds N(mean, stddev) to every sample: the white noise before rounding.
            white = source.noise_density * figures.rate_hz**0.5
            assert float(noise.findtext("stddev")) == pytest.approx(white, rel=0.02)
            walk = figures.axes[f"{sensor}_{axis}"].random_walk.value
            assert (noise.findtext("dynamic_bias_stddev") is None) == (walk is None)
    assert exported.same_as is None and exported.residual([]) is None


def test_the_walk_of_gazebo_is_that_of_the_figures(still):
    # GaussianNoiseModel.cc: sigma_b_d over dt, whose square grows as K^2 t while t is short against tau.
    _, figures = still
    axis = dataclasses.replace(
        figures.axes["gyro_x"], random_walk=imucal.NoiseFigure(3e-6, 1e-7, 2e-6, 4e-6, "rad/s/s/sqrt(Hz)")
    )
    walking = dataclasses.replace(figures, axes={**figures.axes, "gyro_x": axis})
    imu = ElementTree.fromstring(imucal.export(UNIT, "gazebo", noise=walking).text)
    noise = imu.find("angular_velocity/x/noise")
    tau = float(noise.findtext("dynamic_bias_correlation_time"))
    sigma_b = float(noise.findtext("dynamic_bias_stddev"))
    dt = 0.01
    sigma_b_d = np.sqrt(-(sigma_b**2) * tau / 2 * np.expm1(-2 * dt / tau))
    assert sigma_b_d == pytest.approx(3e-6 * np.sqrt(dt), rel=1e-3)


def test_kalibr_imu(still):
    noise = still[1]
    figures = yaml.safe_load(imucal.export(UNIT, "kalibr-imu", noise=noise).text)
    densities = [noise.axes[f"gyro_{axis}"].noise_density.value for axis in "xyz"]
    assert figures["gyroscope_noise_density"] == pytest.approx(max(densities))
    assert figures["update_rate"] == pytest.approx(100.0)


# --- messages -------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", CORRECTING)
def test_every_file_says_how_it_is_applied_and_what_is_lost(name):
    unit = unit_with(G_SENSITIVITY, GYRO_WARM, serial_number="0042")
    exported = imucal.export(unit, name)
    said = re.sub(r"\s+", " ", re.sub(r"\n *(#|//|%|\*) *", " ", exported.text))
    for phrase in (
        FORMATS[name].formula,
        "raw samples in m/s^2 and rad/s",
        "unit 0042",
        "Body frame: orthogonal",
    ):
        assert phrase in said, phrase
    for loss in exported.lost:
        assert f"Not exported: {loss}" in said, loss
    for effect in ("gyro_g_sensitivity", "gyro_bias_temperature"):
        lost = f"the effect {effect}" in exported.lost
        assert lost == (effect not in {values.name for values in exported.same_as.effects})


FEATURES = {
    "scale of the accelerometer": {"accelerometer": imucal.Triad(np.diag([1.02, 0.98, 1.01]), [0, 0, 0])},
    "misalignment of the accelerometer": {
        "accelerometer": imucal.Triad([[1, 0.01, 0.02], [0.01, 1, -0.01], [0.02, -0.01, 1]], [0, 0, 0])
    },
    "scale of the gyroscope": {"gyroscope": imucal.Triad(np.diag([1.02, 0.98, 1.01]), [0, 0, 0])},
    "misalignment of the gyroscope": {
        "gyroscope": imucal.Triad([[1, 0.01, 0.02], [0.03, 1, -0.01], [0.02, 0.01, 1]], [0, 0, 0])
    },
}
PERFECT = imucal.Calibration(imucal.Triad(np.eye(3), [0, 0, 0]), imucal.Triad(np.eye(3), [0, 0, 0]))


@pytest.mark.parametrize("feature", FEATURES)
@pytest.mark.parametrize("name", CORRECTING)
def test_a_part_of_the_triads_is_carried_or_said_to_be_lost(name, feature):
    unit = dataclasses.replace(PERFECT, **FEATURES[feature])
    exported = imucal.export(unit, name)
    rate, force = unit.apply(*raw(unit))
    other_rate, other_force = exported.same_as.apply(*raw(unit))
    # INAV rounds gains to 1/4096. In whatever frame: lengths, and the angle between rate and force.
    rounding = 0.05 if name == "inav" else 1e-9
    differs = any(
        not np.allclose(a, b, rtol=0, atol=rounding)
        for a, b in (
            (np.linalg.norm(rate, axis=1), np.linalg.norm(other_rate, axis=1)),
            (np.linalg.norm(force, axis=1), np.linalg.norm(other_force, axis=1)),
            (np.sum(rate * force, axis=1), np.sum(other_rate * other_force, axis=1)),
        )
    )
    what, _, sensor = feature.partition(" of ")
    assert any(loss.startswith(feature) for loss in exported.lost) == differs
    # And the table of formats has it.
    assert bool(re.search(rf"{what}.* of (both|{sensor})", FORMATS[name].omits)) == differs


@pytest.mark.parametrize("name", CORRECTING)
def test_an_effect_is_carried_or_said_to_be_lost(name):
    carried = FORMATS[name].includes
    for effect in catalogue():
        if effect.sensor == "encoder" or "attitude" in effect.needs:
            continue
        values = [p.typical for p in effect.parameters[: effect.plain]]
        shape = None if effect.shape is None else effect.shape.typical
        exported = imucal.export(unit_with(imucal.EffectValues(effect.name, values, shape)), name)
        lost = f"the effect {effect.name}" in exported.lost
        assert lost == (not exported.same_as.effects), effect.name
        patterns = re.findall(r"[\w*]+_[\w*]+", carried)
        listed = "every effect of the catalogue" in carried or any(
            fnmatch.fnmatch(effect.name, pattern) for pattern in patterns
        )
        assert listed == (not lost), effect.name


@pytest.mark.parametrize("name", CORRECTING)
def test_raw_counts_are_taken_or_refused_by_name(name):
    if FORMATS[name].takes_counts:
        options = {"accel_lsb_per_g": 4096, "gyro_lsb_per_dps": 83.3} if name == "inav" else {}
        assert "raw samples in lsb and lsb" in imucal.export(COUNTS, name, **options).text
    else:
        with pytest.raises(
            imucal.InputError, match=f"the accelerometer and the gyroscope.*raw counts.*{name}"
        ):
            imucal.export(COUNTS, name)


def test_what_is_not_known_is_refused():
    with pytest.raises(imucal.InputError, match=r"no format 'px5': give one of c-header, .*px4"):
        imucal.export(UNIT, "px5")
    for name in NEEDS_NOISE:
        with pytest.raises(imucal.InputError, match="--noise"):
            imucal.export(UNIT, name)


@pytest.mark.parametrize("name", ["kalibr", "basalt", "px4", "ardupilot"])
def test_left_handed_axes_are_refused_where_a_frame_is_needed(name):
    flip = np.diag([1.0, 1.0, -1.0])
    left = imucal.Calibration(imucal.Triad(ACCELEROMETER.sensitivity @ flip, [0, 0, 0]), GYROSCOPE)
    with pytest.raises(imucal.InputError, match="left-handed"):
        imucal.export(left, name)


@pytest.mark.parametrize("name", ["px4", "ardupilot", "ros"])
def test_a_gyroscope_turned_against_the_accelerometer_is_refused_where_it_has_no_place(name):
    turn = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])
    turned = imucal.Calibration(ACCELEROMETER, imucal.Triad(GYROSCOPE.sensitivity @ turn, [0, 0, 0]))
    said = (
        "gyroscope axes do not match .*its x lies along y, its y lies along z, its z lies along x.* swap the "
        "sensor's columns"
    )
    with pytest.raises(imucal.InputError, match=said):
        imucal.export(turned, name)
    half_turn = imucal.Calibration(ACCELEROMETER, imucal.Triad(np.diag([-1.0, -1.0, 1.0]), [0, 0, 0]))
    with pytest.raises(
        imucal.InputError, match="its x lies along -x, its y lies along -y, its z lies along z"
    ):
        imucal.export(half_turn, name)


@pytest.mark.parametrize("name", ["px4", "ardupilot"])
def test_axes_that_are_all_turned_are_turned_back(name):
    turned = imucal.Calibration(*(imucal.Triad(np.diag([-1.0, -1.0, 1.0]), [0, 0, 0]) for _ in range(2)))
    exported = imucal.export(turned, name)
    assert not exported.lost
    rate, force = exported.same_as.apply([[0.1, 0.2, 0.3]], [[1.0, 2.0, 3.0]])
    np.testing.assert_array_equal(rate, [[0.1, 0.2, 0.3]])
    np.testing.assert_array_equal(force, [[1.0, 2.0, 3.0]])


# --- the command ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A calibration without errors, of a unit of the paper, and a control recording of it."""
    folder = tmp_path_factory.mktemp("export")
    run = imucal.simulate(imucal.Program.random(seed=4, moves=12), unit="paper", rate_hz=100, seed=4)
    run.truth.calibration.save(folder / "cal.json")
    imucal.write(run.recording, folder / "control.csv")
    return folder


def test_the_residual_on_the_control_recording_is_that_of_evaluate(files, capsys):
    arguments = ["export", str(files / "cal.json"), "--control", str(files / "control.csv")]
    calibration, control = imucal.Calibration.load(files / "cal.json"), imucal.read(files / "control.csv")
    full = imucal.evaluate(calibration, control).figures.gravity_direction_rms_deg
    for name in ("px4", "fusion"):
        json_file = files / f"{name}.json"
        assert main([*arguments, "--to", name, "-o", str(files / name), "--json", str(json_file)]) == 0
        document = json.loads(json_file.read_text())
        found = document["control_set"]
        assert found["full"]["gravity_direction_rms_deg"] == full
        err = capsys.readouterr().err
        assert "control set, as exported" in err
        assert all(f"not exported to {name}: {loss}" in err for loss in document["lost"])
        if name == "px4":
            assert document["lost"]
            assert found["exported"]["gravity_direction_rms_deg"] > 10 * full
            assert found["exported"]["gravity_norm_rms_mps2"] > 3 * found["full"]["gravity_norm_rms_mps2"]
        else:
            assert not document["lost"]
            assert found["exported"] == found["full"]


def test_the_findings_and_the_verdict_on_the_control_recording_are_those_of_evaluate(tmp_path, capsys):
    run, other = (
        imucal.simulate(imucal.Program.random(seed=4, moves=12), unit=unit, rate_hz=100, seed=4).recording
        for unit in ("paper", "random:paper:7")
    )
    imucal.write(run, tmp_path / "run.csv")
    imucal.write(other, tmp_path / "other.csv")
    imucal.calibrate(imucal.read(tmp_path / "run.csv")).calibration.save(tmp_path / "cal.json")
    command = ["export", str(tmp_path / "cal.json"), "--to", "px4", "-o", str(tmp_path / "px4.params")]
    json_file = tmp_path / "export.json"
    for control, verdict, code in (("run", "good", "seen_by_the_fit"), ("other", "poor", "large_residuals")):
        given = ["--control", str(tmp_path / f"{control}.csv"), "--json", str(json_file)]
        assert main([*command, *given]) == 0
        err = capsys.readouterr().err
        assert f"verdict on the control set: {verdict}" in err and f"[{code}]" in err
        found = json.loads(json_file.read_text())["control_set"]
        judged = imucal.evaluate(
            imucal.Calibration.load(tmp_path / "cal.json"), imucal.read(tmp_path / f"{control}.csv")
        )
        assert found["verdict"] == judged.verdict == verdict
        assert [finding["code"] for finding in found["findings"]] == [f.code for f in judged.findings]


def test_the_frame_of_kalibr_costs_nothing(files):
    calibration, control = imucal.Calibration.load(files / "cal.json"), imucal.read(files / "control.csv")
    residual = imucal.export(calibration, "kalibr").residual(control).to_dict()
    for figure, value in residual["full"].items():
        assert residual["exported"][figure] == pytest.approx(value, rel=1e-6)


def test_figures_that_are_poor_are_said(files, tmp_path, capsys):
    unit = imucal.Calibration.load(files / "cal.json")
    poor = {
        "chi2_per_dof": 400.0,
        "gravity_norm_rms_mps2": 0.01,
        "gravity_direction_rms_deg": 1.0,
        "rests": 20,
        "moves": 19,
    }
    dataclasses.replace(unit, control_set=poor).save(tmp_path / "poor.json")
    said = "warning: this calibration is poor: control set: residuals are 20 times what noise explains"
    for path, is_said in ((files / "cal.json", False), (tmp_path / "poor.json", True)):
        assert main(["export", str(path), "--to", "c-header", "-o", str(tmp_path / "cal.h")]) == 0
        assert (said in capsys.readouterr().err) is is_said
    # A file states the same reason with its code. It is said once.
    stated = f"{imucal.Calibration.load(tmp_path / 'poor.json').judged[1][0]} [large_residuals]"
    twice = dataclasses.replace(unit, control_set=poor, verdict="poor", reasons=(stated,))
    assert twice.judged == ("poor", (stated,))


def test_the_file_is_printed_without_a_name(files, capsys):
    assert main(["export", str(files / "cal.json"), "--to", "ros"]) == 0
    out, err = capsys.readouterr()
    assert list(yaml.safe_load(out)) == ["SM", "bias"]
    assert "not exported to ros: misalignment of the gyroscope" in err


def test_noise_is_that_of_the_corrected_recording(files, tmp_path):
    # The unit reads its rates 3 % wrong on y, and its noise with them.
    unit = imucal.Calibration.load(files / "cal.json")
    still = imucal.simulate(imucal.Static(60), unit="paper", rate_hz=100, seed=5).recording
    imucal.write(still, tmp_path / "still.csv")
    arguments = ["export", str(files / "cal.json"), "--noise", str(tmp_path / "still.csv")]
    assert main([*arguments, "--to", "gazebo", "-o", str(tmp_path / "imu.sdf")]) == 0
    found = ElementTree.parse(tmp_path / "imu.sdf").findtext("angular_velocity/y/noise/stddev")
    corrected = unit.apply_recording(still).angular_rate[:, 1]
    assert float(found) == pytest.approx(np.diff(corrected).std() / 2**0.5, rel=0.02)
    raw_scatter = np.diff(still.angular_rate[:, 1]).std() / 2**0.5
    assert float(found) != pytest.approx(raw_scatter, rel=0.02)


def test_formats_are_listed(files, tmp_path, capsys):
    assert main(["export", "--list", "--json", str(tmp_path / "formats.json")]) == 0
    listed = json.loads((tmp_path / "formats.json").read_text())["formats"]
    assert [form["name"] for form in listed] == list(FORMATS)
    out = capsys.readouterr().out
    assert all(name in out for name in FORMATS)


def test_the_names_of_a_header_are_chosen(files, tmp_path, capsys):
    said = tmp_path / "said.json"
    arguments = ["--to", "c-header", "--name", "gimbal", "-o", str(tmp_path / "unit.h"), "--json", str(said)]
    assert main(["export", str(files / "cal.json"), *arguments]) == 0
    text = (tmp_path / "unit.h").read_text()
    assert "imucal_" not in text and "int gimbal_correct_f64(" in text and "by gimbal_correct_f64" in text
    assert "by gimbal_correct_f64" in json.loads(said.read_text())["formula"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "--list"),
        (["--to", "px5"], "no format 'px5'"),
        (["--to", "gazebo"], "--noise"),
        (["--to", "ros", "--json", "-"], "-o FILE"),
        (["--to", "ros", "--name", "b"], "ros files contain no names with a prefix: remove --name"),
        (["--to", "c-header", "--name", "2b"], "'2b' cannot start a C name"),
    ],
)
def test_wrong_commands_are_told_the_way_out(files, capsys, arguments, message):
    calibration = [str(files / "cal.json")] if arguments else []
    assert main(["export", *calibration, *arguments]) == 1
    assert message in capsys.readouterr().err


# --- the page -------------------------------------------------------------------------------------


def test_the_page_has_the_table_of_the_code():
    page = (ROOT / "docs/export.md").read_text(encoding="utf-8")
    assert formats_markdown() in page, "put formats_markdown() of imucal.export into docs/export.md"


def test_any_file_name_leaves_the_xml_well_formed():
    from xml.etree import ElementTree

    from imucal.exporting.format import xml_comment

    text = xml_comment(["made from run---7--b.csv", "and --"], "<sdf/>")
    assert ElementTree.fromstring(text).tag == "sdf"
