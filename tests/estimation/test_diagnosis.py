"""What a calibration tells badly is said, and `inspect` predicts how well it will tell the rest."""

import json
import re

import numpy as np
import pytest
from scipy.stats import chi2, kstest

import imucal
from imucal import Program, Tumble

RATE_HZ = 100
G_MPS2 = 9.80665


def paper_run(seed=1, **options):
    return imucal.simulate(Program.random(seed=seed, **options), rate_hz=RATE_HZ, seed=seed)


def predicted_over_stated(recording, result, **options):
    inspection = imucal.inspect(recording, **options)
    assert [p.name for p in inspection.predicted_sigma] == [p.name for p in result.parameters[:21]]
    assert [p.unit for p in inspection.predicted_sigma] == [p.unit for p in result.parameters[:21]]
    return np.array(
        [p.std / q.std for p, q in zip(inspection.predicted_sigma, result.parameters, strict=False)]
    )


# --- traded off, flat ---


def test_a_good_run_has_nothing_to_say():
    result = imucal.calibrate(paper_run().recording)
    assert result.diagnosis == ()
    assert result.to_dict()["diagnosis"] == []


def test_parameters_that_are_known_only_together():
    """The bend of a scale and the scale itself: at rest |f| is never beyond g."""
    result = imucal.calibrate(paper_run().recording, effects=["accel_scale_cubic"])
    covariance = result.calibration.covariance
    sigma = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(sigma, sigma)
    names = result.calibration.covariance_names
    pairs = {
        (names[i], names[j]): correlation[i, j]
        for i, j in zip(*np.nonzero(np.triu(np.abs(correlation) > 0.95, 1)), strict=True)
    }
    assert len(pairs) == 3
    assert {item.parameters: item.value for item in result.diagnosis} == pytest.approx(pairs)
    for item in result.diagnosis:
        assert item.code == "traded_off"
        assert item.way_out == "accel_scale_cubic needs rests every 15 deg, weakly"
        assert f"{item.message}: {item.way_out}" in result.notes
    assert json.loads(json.dumps(result.to_dict()))["diagnosis"][0]["code"] == "traded_off"


def test_an_effect_that_the_run_does_not_show():
    """A unit that has long been warm has no warm-up: its size is zero within its standard deviation."""
    warm = imucal.simulate(
        Program.random(seed=2, moves=20, hold_s=2.0), unit="mpu6050", rate_hz=RATE_HZ, seed=2
    )
    result = imucal.calibrate(warm.recording, effects=["gyro_bias_warmup"])
    assert result.verdict == "good"
    sizes = [p for p in result.parameters if p.name.startswith("gyro_bias_warmup_") and p.name[-1] in "xyz"]
    assert len(sizes) == 3
    assert all(abs(size.value) < 4 * size.std for size in sizes)


# --- how well noise explains the fit ---


def test_chi2_of_the_fit_and_of_each_rest_and_move():
    """In a simulation noise is all there is: every probability is as likely as any other."""
    p_values = {"fit": [], "rests": [], "moves": []}
    for seed in range(6):
        result = imucal.calibrate(paper_run(seed, hold_s=2.0).recording)
        whole = result.fit.noise_alone
        # A norm and three rates for each rest, two directions for each move.
        assert whole.degrees_of_freedom == 4 * len(result.rests) + 2 * len(result.moves) - 21
        assert whole.p_value == pytest.approx(chi2.sf(whole.chi2, whole.degrees_of_freedom), rel=1e-6)
        p_values["fit"].append(whole.p_value)
        for name, freedom in (("rests", 4), ("moves", 2)):
            for item in getattr(result, name):
                assert item.degrees_of_freedom == freedom
                assert item.p_value == pytest.approx(chi2.sf(item.chi2, freedom), rel=1e-6)
                p_values[name].append(item.p_value)
    for name, values in p_values.items():
        assert kstest(values, "uniform").pvalue > 1e-3, name
    assert "the probability of a larger chi2 from noise alone is" in result.summary()


def test_a_nudged_rest_has_a_small_probability():
    """Too little to be left out, too much for chance."""
    recording = paper_run().recording
    rest = imucal.calibrate(recording).rests[20]
    force = recording.specific_force.copy()
    force[rest.first : rest.end] *= 1 + 4 * rest.norm_sigma_mps2 / G_MPS2
    nudged = imucal.Recording(recording.time_s, force, recording.angular_rate, name="nudged")
    result = imucal.calibrate(nudged)
    assert result.rests[20].excluded is None
    assert result.rests[20].chi2 > rest.chi2 + 5
    assert result.rests[20].p_value < 0.01 < rest.p_value


# --- predicted standard deviations ---


MOTIONS = {"stand": Program.random(seed=1), "hand": Tumble(seed=1, tremor_deg=0.05)}


@pytest.mark.parametrize("motion", MOTIONS)
def test_predicted_sigmas_are_those_that_a_fit_states(motion):
    recording = imucal.simulate(MOTIONS[motion], unit="paper", rate_hz=RATE_HZ, seed=1).recording
    ratio = predicted_over_stated(recording, imucal.calibrate(recording))
    assert ratio == pytest.approx(1, abs=0.15)
    assert np.median(ratio) == pytest.approx(1, abs=0.05)


@pytest.mark.parametrize("motion", MOTIONS)
def test_predicted_sigmas_of_nominal_sensors_are_exact(motion):
    """The prediction is that of the joint fit at nominal sensors, so only the errors of these remain."""
    unit = imucal.Unit.named("paper")
    nominal = imucal.Unit(
        imucal.Sensor(noise_density=unit.accelerometer.noise_density),
        imucal.Sensor(noise_density=unit.gyroscope.noise_density),
    )
    recording = imucal.simulate(MOTIONS[motion], unit=nominal, rate_hz=RATE_HZ, seed=1).recording
    result = imucal.calibrate(recording)
    assert result.fit.joint.inflation == 1.0
    assert predicted_over_stated(recording, result) == pytest.approx(1, abs=2e-3)


def test_predicted_sigmas_in_counts():
    """Without nominal sensitivities they come from the recording itself, to some per cent."""
    r = paper_run().recording
    counts = imucal.Recording(
        r.time_s,
        np.round(1000 * r.specific_force + 5000),
        np.round(50000 * r.angular_rate - 3000),
        accel_unit="lsb",
        gyro_unit="lsb",
        name="counts",
    )
    assert predicted_over_stated(counts, imucal.calibrate(counts)) == pytest.approx(1, abs=0.2)


def test_predicted_sigmas_of_a_real_recording(data_file):
    """The moves of this unit scatter by more than noise; by how much, its fit alone can tell."""
    names = [
        f"{sensor}_{axis}_{unit}" for sensor, unit in (("accel", "mps2"), ("gyro", "radps")) for axis in "xyz"
    ]
    for unit in (0, 1):
        recording = imucal.read(data_file(f"mpu9150/imu{unit}.log"), columns=",".join(names), rate_hz=100)
        result = imucal.calibrate(recording)
        assert result.fit.accelerometer.inflation == 1
        ratio = predicted_over_stated(recording, result)
        assert ratio[:9] == pytest.approx(1, abs=0.2)
        widened = result.fit.gyroscope.inflation
        assert 1.2 < widened < 2
        assert ratio[12:] * widened == pytest.approx(1, abs=0.25)


def test_what_is_not_determined_has_no_predicted_sigma():
    """Turned about a level axis only: the same names as the error, the others with their sigmas."""
    level = Program(tuple(imucal.Step((0.0, 40.0, 0.0), 1.0, 2.0) for _ in range(18)))
    recording = imucal.simulate(level, rate_hz=RATE_HZ, seed=1).recording
    inspection = imucal.inspect(recording)
    with pytest.raises(imucal.NotEnoughMotionError) as caught:
        imucal.calibrate(recording)
    assert inspection.missing == str(caught.value)
    unknown = {p.name for p in inspection.predicted_sigma if p.std is None}
    assert unknown == {
        *("accel_bias_y", "accel_sensitivity_yy", "accel_sensitivity_xy", "accel_sensitivity_yz"),
        *(f"gyro_sensitivity_{i}{j}" for i in "xyz" for j in "xz"),
        *("gyro_sensitivity_xy", "gyro_sensitivity_zy"),
    }
    known = [p.std for p in inspection.predicted_sigma if p.std is not None]
    assert min(known) > 0
    assert max(known) < 0.05


@pytest.mark.slow
def test_inspect_shows_predicted_sigmas(command, tmp_path):
    imucal.write(paper_run(moves=20, hold_s=2.0).recording, tmp_path / "run.csv")
    done = command("inspect", tmp_path / "run.csv", "--json", tmp_path / "seen.json")
    assert done.returncode == 0, done.stderr
    assert "predicted 1 sigma" in done.stdout
    (seen,) = json.loads((tmp_path / "seen.json").read_text())["recordings"]
    assert len(seen["predicted_sigma"]) == 21
    first = seen["predicted_sigma"][0]
    assert (first["name"], first["unit"]) == ("accel_bias_x", "m/s^2")
    assert 1e-4 < first["std"] < 1e-2
    milli_g = first["std"] / 9.80665e-3
    assert f"accel_bias_x {milli_g:.2g} mg" in " ".join(done.stdout.split())


@pytest.mark.slow
@pytest.mark.parametrize(("poses", "seed"), [(4, 1), (5, 4), (6, 3)])
def test_inspect_predicts_nothing_for_what_it_says_is_missing(poses, seed, command, tmp_path):
    motion = imucal.Tumble(seed, poses=poses, hold_s=3, move_s=2)
    run = imucal.simulate(motion, seed=seed, unit="random:bmi088:3", rate_hz=100).recording
    seen = imucal.inspect(run)
    named = re.search(r"accelerometer's ([^:]*):", seen.missing).group(1).split(", ")
    open_ = [p.name for p in seen.predicted_sigma if p.std is None]
    assert sum(name.startswith("accel") for name in open_) == len(named)
    imucal.write(run, tmp_path / "run.csv")
    done = command("inspect", tmp_path / "run.csv")
    assert done.returncode == 2
    assert done.stdout.count("not determined  ") == len(open_)
