"""Gravity and the clock are the references of a calibration: their uncertainty enters that of the scales."""

import json
import re

import numpy as np
import pytest

import imucal
import imucal._core as _core

SEED = 5
GRAVITY_MPS2 = 9.80665
# Standard deviations from which the references of the simulated runs are drawn.
GRAVITY_SIGMA_MPS2, CLOCK_PPM = 0.02, 2000.0
COVERAGE_SEEDS = range(40)


def simulated(seed, **references):
    program = imucal.Program.random(seed=2, moves=20, hold_s=2.0)
    return imucal.simulate(program, seed=seed, rate_hz=50.0, **references)


@pytest.fixture(scope="module")
def run():
    return simulated(SEED).recording


def sigma(result, name):
    return next(parameter.std for parameter in result.parameters if parameter.name == name)


def value(result, name):
    return next(parameter.value for parameter in result.parameters if parameter.name == name)


def test_gravity_and_clock_enter_what_they_scale(run):
    exact = imucal.calibrate(run)
    result = imucal.calibrate(run, gravity_sigma_mps2=GRAVITY_SIGMA_MPS2, clock_ppm=CLOCK_PPM)
    relative = {"accel_sensitivity": GRAVITY_SIGMA_MPS2 / GRAVITY_MPS2, "gyro_sensitivity": 1e-6 * CLOCK_PPM}
    for before, after in zip(exact.parameters, result.parameters, strict=True):
        added = relative.get(before.name.rsplit("_", 1)[0], 0.0) * abs(before.value)
        assert after.value == before.value
        assert after.std == pytest.approx(np.hypot(before.std, added), rel=1e-9)
    covariance, names = result.calibration.covariance, result.calibration.covariance_names
    for sensor in ("accel", "gyro"):
        x, y = (names.index(f"{sensor}_sensitivity_{axis}") for axis in ("xx", "yy"))
        assert covariance[x, y] / np.sqrt(covariance[x, x] * covariance[y, y]) > 0.9
    assert [d.code for d in result.diagnosis] == [d.code for d in exact.diagnosis]


def test_intervals_hold_the_scale_when_gravity_and_clock_are_drawn():
    random = np.random.default_rng(7)
    errors = []
    for seed in COVERAGE_SEEDS:
        true = GRAVITY_MPS2 + GRAVITY_SIGMA_MPS2 * random.normal()
        clock = 1e-6 * CLOCK_PPM * random.normal()
        simulation = simulated(seed, gravity_mps2=true, clock_rate_error=clock)
        result = imucal.calibrate(
            simulation.recording, gravity_sigma_mps2=GRAVITY_SIGMA_MPS2, clock_ppm=CLOCK_PPM
        )
        truth = {parameter.name: parameter.value for parameter in simulation.truth.calibration.parameters}
        errors.append([(p.value - truth[p.name]) / p.std for p in result.parameters])
    names = [parameter.name for parameter in result.parameters]
    errors = np.array(errors)
    scales = [k for k, name in enumerate(names) if name[-2:] in ("xx", "yy", "zz")]
    assert len(scales) == 6
    # The axes of one sensor share their error: 40 draws, of which 0.16 to 2 are outside 2 sigma on average.
    assert (np.abs(errors[:, scales]) > 2).mean(axis=0).max() <= 0.15
    assert np.abs(errors).max() < 5
    assert (errors[:, scales] ** 2).mean(axis=0) == pytest.approx(1.0, abs=0.6)


def test_latitude_and_height_give_normal_gravity(run):
    place = imucal.calibrate(run, latitude_deg=45.4, height_m=12.0)
    gravity = _core.gravity_mps2(45.4, 12.0)
    assert place.calibration.gravity_mps2 == gravity == pytest.approx(9.80652, abs=1e-5)
    plain = imucal.calibrate(run)
    name = "accel_sensitivity_xx"
    assert value(place, name) * gravity == pytest.approx(value(plain, name) * GRAVITY_MPS2, rel=1e-7)
    without_height = imucal.calibrate(run, latitude_deg=45.4)
    assert sigma(plain, name) < sigma(place, name) < sigma(without_height, name)
    known = imucal.calibrate(run, latitude_deg=45.4, height_m=12.0, gravity_sigma_mps2=1e-5)
    assert sigma(known, name) < sigma(place, name)


def test_the_result_says_what_the_sigmas_do_not_contain(run):
    said = imucal.calibrate(run).summary()
    assert re.search(r"standard gravity 9\.80665 m/s\^2 is assumed.*-0\.43 to \+0\.28 %.*--latitude", said)
    assert re.search(r"clock.*20 to 100 ppm.*--clock-ppm", said)
    given = imucal.calibrate(run, gravity_mps2=9.81, clock_ppm=50.0).summary()
    assert re.search(r"9\.81 m/s\^2 is taken as exact.*102 ppm.*--gravity-sigma", given)
    assert "clock" not in given
    known = imucal.calibrate(run, latitude_deg=45.0, height_m=0.0, clock_ppm=50.0)
    assert "--gravity" not in known.summary()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"latitude_deg": 91.0}, "latitude_deg is 91"),
        ({"latitude_deg": float("nan")}, "latitude_deg is nan"),
        ({"latitude_deg": 45.0, "height_m": 1e5}, "height_m is 100000"),
        ({"height_m": 100.0}, "without latitude_deg"),
        ({"latitude_deg": 45.0, "gravity_mps2": 9.8}, "give gravity if known"),
        ({"gravity_sigma_mps2": -0.1}, "gravity_sigma_mps2 = -0.1"),
        ({"gravity_sigma_mps2": "0.1"}, "a number is needed"),
        ({"clock_ppm": float("inf")}, "clock_ppm = inf"),
        ({"clock_ppm": True}, "a number is needed"),
    ],
)
def test_references_that_cannot_be_are_refused(run, arguments, message):
    with pytest.raises(imucal.InputError, match=message):
        imucal.calibrate(run, **arguments)


def test_the_file_keeps_the_references(run, tmp_path):
    result = imucal.calibrate(run, latitude_deg=-33.9, height_m=50.0, clock_ppm=20.0)
    path = tmp_path / "cal.json"
    result.calibration.save(path)
    assert imucal.Calibration.load(path).references == result.calibration.references
    document = json.loads(path.read_text())
    assert document["references"] == {
        "gravity_from": "latitude",
        "gravity_sigma_mps2": pytest.approx(5e-4),
        "clock_ppm": 20.0,
        "latitude_deg": -33.9,
        "height_m": 50.0,
    }
    for name, wrong, message in (
        ("latitude_deg", -30.0, "gives 9.79"),
        ("latitude_deg", 91.0, "latitude_deg is 91"),
        ("clock_ppm", -1.0, "clock_ppm is -1"),
        ("gravity_from", "nobody", "gravity_from"),
    ):
        spoilt = {**document, "references": {**document["references"], name: wrong}}
        path.write_text(json.dumps(spoilt))
        with pytest.raises(imucal.FormatError, match=message):
            imucal.Calibration.load(path)
    del document["references"]
    path.write_text(json.dumps(document))
    assert imucal.Calibration.load(path).references.gravity_sigma_mps2 is None


def test_the_command_takes_the_references(run, command, tmp_path):
    recording, path = tmp_path / "run.csv", tmp_path / "cal.json"
    imucal.write(run, recording)
    place = ("--latitude", "60", "--height", "100", "--clock-ppm", "100")
    done = command("calibrate", recording, *place, "-o", path)
    assert done.returncode == 0, done.stderr
    assert "is assumed" not in done.stdout
    assert json.loads(path.read_text())["gravity_mps2"] == _core.gravity_mps2(60.0, 100.0)
    done = command("calibrate", recording, "--gravity", "9.8", "--latitude", "60")
    assert done.returncode == 1
    assert "give gravity if known" in done.stderr


def test_a_wrong_rate_is_a_gain_that_all_gyroscope_axes_share():
    run = imucal.simulate("random", unit="ideal", effects={}, seed=1, rate_hz=100.0).recording
    noise = np.random.default_rng(1)

    def made(factor):
        return imucal.Recording(
            np.array(run.time_s) * factor,
            run.specific_force + 0.01 * noise.normal(size=(len(run), 3)),
            run.angular_rate + 1e-3 * noise.normal(size=(len(run), 3)),
        )

    assert not [f for f in imucal.calibrate(made(1.0)).findings if f.code == "gyro_common_gain"]
    (finding,) = [f for f in imucal.calibrate(made(1.02)).findings if f.code == "gyro_common_gain"]
    assert finding.severity == "warning"
    assert finding.value == pytest.approx(1.02, abs=1e-3)
    # The way out, followed: with the right time stamps the gain is 1.
    assert "time stamps that are 2.0 % too long" in finding.way_out
    mended = imucal.calibrate(made(1.02 / finding.value))
    assert not [f for f in mended.findings if f.code == "gyro_common_gain"]


def test_uncertain_references_do_not_excuse_a_control_recording():
    recording, other = simulated(SEED).recording, simulated(SEED + 1).recording
    exact = imucal.calibrate(recording, control=other)
    uncertain = imucal.calibrate(recording, control=other, gravity_sigma_mps2=0.05, clock_ppm=1e4)
    assert uncertain.control.to_dict()["rests"] == exact.control.to_dict()["rests"]
    assert (uncertain.verdict, exact.verdict) == ("good", "good")
    for ours, theirs in zip(uncertain.control.residuals, exact.control.residuals, strict=True):
        assert ours.ratio == pytest.approx(theirs.ratio, rel=1e-6)
