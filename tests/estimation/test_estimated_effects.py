"""Effects estimated with the 21 parameters: every one comes back, and what data do not show is refused."""

import json

import numpy as np
import pytest

import imucal
from imucal.cli import main
from imucal.effects import catalogue

pytestmark = pytest.mark.slow

CYCLE = "cycle:10:50:300"
# Shows all but the square of the force; a stand that is crooked, as the encoders' effects need it along.
CROOKED = imucal.Stand(
    mount_rotation_deg=(1.0, -1.5, 2.0), base_tilt_deg=(0.5, -1.0), non_orthogonality_deg=(0.3, -0.2)
)


def typical(effect, count):
    """Numbers of ordinary size with both signs, as EffectValues."""
    values = [p.typical * (1.0, -0.7)[k % 2] for k, p in enumerate(effect.parameters[:count])]
    return imucal.EffectValues(effect.name, values, None if effect.shape is None else 80.0)


def quiet(name="paper"):
    """The unit with its parameters, and without noise and counts."""
    unit = imucal.Unit.named(name)
    sensors = {
        triad: imucal.Sensor(sensitivity=getattr(unit, triad).sensitivity, bias=getattr(unit, triad).bias)
        for triad in ("accelerometer", "gyroscope")
    }
    return imucal.Unit(**sensors)


def simulated(values, *, moves=46, rate_hz=1000, **options):
    program = imucal.Program.random(seed=1, moves=moves)
    options = {"unit": quiet(), "temperature": CYCLE, "stand": CROOKED, "seed": 1, **options}
    return imucal.simulate(program, effects=[values], rate_hz=rate_hz, **options)


# --- each alone, without noise --------------------------------------------------------------------

FORMS = [(effect, effect.plain) for effect in catalogue()]
FORMS += [(effect, count) for effect in catalogue() for count in effect.forms.values()]
NOT_DETERMINED = ("gyro_g2_sensitivity",)
DETERMINED = [form for form in FORMS if form[0].name not in NOT_DETERMINED]
# Samples per second at which the error of the finite steps is below the tolerance. The fits of time constants
# take longest, and their errors are the same at 250 and at 1000 samples per second.
STEPS_HZ = {"gyro_angular_acceleration": 1000} | {e.name: 250 for e in catalogue() if e.shape is not None}


def form_name(effect, count):
    return ":".join([effect.name, *(form for form, own in effect.forms.items() if own == count)])


@pytest.mark.parametrize(("effect", "count"), DETERMINED, ids=[form_name(*form) for form in DETERMINED])
def test_an_effect_comes_back(effect, count):
    truth = typical(effect, count)
    run = simulated(truth, rate_hz=STEPS_HZ.get(effect.name, 500))
    result = imucal.calibrate(run.recording, effects=[form_name(effect, count)])
    (found,) = result.calibration.effects
    values, expected = found.values, truth.values
    if effect.name == "earth_rate":
        # North is not known to gravity: the horizontal part has a size and no direction.
        values, expected = (np.array([np.hypot(v[0], v[1]), v[2]]) for v in (values, expected))
    assert np.abs(values - expected).max() < 1e-5 * np.abs(expected).max()
    if effect.shape is not None:
        assert found.shape == pytest.approx(truth.shape, rel=1e-5)
    # The triads come back with it.
    for ours, true in zip(result.parameters[:21], run.truth.calibration.parameters[:21], strict=True):
        size = 1.0 if "sensitivity" in ours.name else 0.1
        assert ours.value == pytest.approx(true.value, abs=1e-5 * size), ours.name


@pytest.mark.parametrize(
    ("form", "open_directions"),
    [("gyro_g2_sensitivity", "3 of 9"), ("gyro_g2_sensitivity:full", "3 of 18")],
)
def test_squares_of_gravity_and_a_bias_are_told_apart_by_no_rest(form, open_directions):
    """fx^2 + fy^2 + fz^2 is g^2 at every rest. The other directions are seen: 6 of 9, 15 of 18."""
    effect = imucal.effects.find("gyro_g2_sensitivity")
    with pytest.raises(imucal.NotEnoughMotionError) as caught:
        imucal.calibrate(simulated(typical(effect, 9)).recording, effects=[form])
    assert str(caught.value).startswith(f"{open_directions} directions of gyro_g2_sensitivity are not")
    assert "gyro_bias is told apart by forces far from g" in str(caught.value)


def test_what_is_seen_of_an_effect_comes_back_and_the_rest_is_as_uncertain_as_that_is_large():
    """Of each row of nine g^2-sensitivities the mean is a bias; the differences within the row are seen."""
    truth = typical(imucal.effects.find("gyro_g2_sensitivity"), 9)
    result = imucal.calibrate(simulated(truth).recording, effects=["gyro_g2_sensitivity:seen"])
    found, true = (np.reshape(v.values, (3, 3)) for v in (result.calibration.effects[0], truth))
    within = [rows - rows.mean(axis=1, keepdims=True) for rows in (found, true)]
    # Even rounding is a noise, and a prior of the typical size gives way to it by a part in 300.
    assert within[0] == pytest.approx(within[1], rel=0.01)
    # Half of the prior's variance or so is that of the mean: the width is that of what is seen.
    std = np.array([p.std for p in result.parameters[21:]])
    assert 0.2 < np.median(std) / np.sqrt(np.mean(within[1] ** 2)) < 2.0
    assert np.abs(found - true).max() < 4.0 * std.max()


# --- with noise -----------------------------------------------------------------------------------


def test_the_stated_sigmas_of_effects_hold():
    """Two effects at once, an ordinary sensor: errors over their sigmas are normal."""
    names = ["gyro_g_sensitivity", "accel_bias_temperature"]
    effects = [imucal.effects.find(name) for name in names]
    z = []
    for seed in range(1, 11):
        run = imucal.simulate(
            imucal.Program.random(seed=seed),
            unit="paper",
            rate_hz=100,
            seed=seed,
            temperature=CYCLE,
            effects=[typical(effect, effect.plain) for effect in effects],
        )
        result = imucal.calibrate(run.recording, effects=names)
        assert result.verdict == "good"
        pairs = zip(result.parameters, run.truth.calibration.parameters, strict=True)
        z.append([(ours.value - true.value) / ours.std for ours, true in pairs])
    z = np.array(z)
    assert z.shape == (10, 21 + 9 + 3)
    assert np.abs(z).max() < 5
    # 120 squares of the effects' own: their mean scatters by 0.13.
    assert (z[:, 21:] ** 2).mean() == pytest.approx(1, abs=0.5)


@pytest.fixture(scope="module")
def noisy():
    """A run of the paper's unit, noise and counts and all, without any effect."""
    program = imucal.Program.random(seed=3)
    return imucal.simulate(program, unit="paper", rate_hz=100, seed=3, temperature=CYCLE).recording


@pytest.fixture(scope="module")
def by_hand():
    return imucal.simulate("tumble", unit="mpu6050", rate_hz=100, seed=3, temperature=CYCLE).recording


@pytest.fixture(scope="module")
def in_place():
    """The moves of `by_hand` without translation, so that the force in the moves is that of gravity."""
    motion = imucal.Tumble(3, translation_mm=0.0)
    return imucal.simulate(motion, unit="mpu6050", rate_hz=100, seed=3, temperature=CYCLE).recording


# Estimated from the force inside the moves, which contains the acceleration of a hand as well.
FROM_FORCE_IN_MOVES = (
    "gyro_angular_acceleration",
    "gyro_time_offset",
    "accel_lever_arm",
    "accel_size_effect",
)
CASES = [(*form, motion) for form in FORMS for motion in ("noisy", "by_hand")]
CASES += [(*form, "in_place") for form in FORMS if form[0].name in FROM_FORCE_IN_MOVES]


@pytest.mark.parametrize(
    ("effect", "count", "motion"), CASES, ids=[f"{form_name(*case[:2])}-{case[2]}" for case in CASES]
)
def test_an_effect_that_is_not_there_is_small_or_refused(effect, count, motion, request):
    recording = request.getfixturevalue(motion)
    try:
        result = imucal.calibrate(recording, effects=[form_name(effect, count)])
    except imucal.ImucalError as error:
        reason = "directions of" if effect.name in NOT_DETERMINED else "has no stand_1"
        assert reason in str(error)
        assert effect.name in NOT_DETERMINED or (effect.sensor == "encoder" and motion == "by_hand")
        return
    assert result.fit.joint.termination == "converged"
    assert np.isfinite(result.calibration.covariance).all()
    assert all(p.std is not None and np.isfinite([p.value, p.std]).all() for p in result.parameters)
    # chi2 with that many degrees of freedom exceeds this once in a million.
    (effect_fit,) = result.fit.effects
    assert effect_fit.name == effect.name
    assert effect_fit.dof == count
    assert effect_fit.statistic < count + 7 * np.sqrt(2 * count) + 18
    if motion == "by_hand" and effect.name in FROM_FORCE_IN_MOVES:
        assert result.verdict == "incomplete"
        (reason,) = result.reasons
        assert "calibration set: residuals exceed their noise: specific force within the moves 5." in reason
    else:
        assert result.verdict == "good"


@pytest.mark.parametrize("seed", [3, 4, 6])
def test_an_absent_time_constant_has_its_prior(seed):
    """The recordings do not determine the time constant of a warm-up that is not there."""
    run = imucal.simulate("tumble", unit="mpu6050", rate_hz=100, seed=seed, temperature="cycle:10:50:200")
    result = imucal.calibrate(run.recording, effects=["gyro_bias_warmup"])
    assert result.verdict == "good", result.reasons
    assert result.fit.effects[0].statistic < 20


def test_g_sensitivity_in_a_trembling_hand():
    """The biases of the rests are shrunk towards their mean; the effect must not be shrunk with them."""
    signs = (1, -0.5, 0.3, 0.7, -1, 0.2, 0.4, 0.6, -0.8)
    effect = imucal.effects.find("gyro_g_sensitivity")
    sizes = tuple(p.typical * sign for p, sign in zip(effect.parameters, signs, strict=True))
    z = []
    for seed in range(1, 7):
        run = imucal.simulate(
            imucal.Tumble(seed, tremor_deg=0.1),
            unit="mpu6050",
            rate_hz=100,
            seed=seed,
            effects={"gyro_g_sensitivity": sizes},
        )
        result = imucal.calibrate(run.recording, effects=["gyro_g_sensitivity"])
        truth = {p.name: p.value for p in run.truth.calibration.parameters}
        z.append([(p.value - truth[p.name]) / p.std for p in result.parameters[21:]])
    # 54 squares: their mean scatters by 0.19 if they are independent; it was 11.
    assert np.mean(np.square(z)) < 2.0
    # No systematic error towards zero.
    assert abs(np.mean(np.array(z) * np.sign(signs))) < 0.5


# --- as people use it -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def two_runs(tmp_path_factory):
    """A run and a control run of a unit whose accelerometer's bias follows the temperature."""
    folder = tmp_path_factory.mktemp("runs")
    for seed, name in ((1, "run.parquet"), (2, "control.parquet")):
        run = imucal.simulate(
            "random", seed=seed, rate_hz=100, temperature=CYCLE, effects={"accel_bias_temperature": 1e-3}
        )
        imucal.write(run.recording, folder / name)
    return folder


def test_the_command_writes_judges_and_shows_effects(two_runs, tmp_path, capsys):
    run, control = str(two_runs / "run.parquet"), str(two_runs / "control.parquet")
    paths = {name: str(tmp_path / name) for name in ("cal.json", "result.json", "page.html", "judged.json")}
    arguments = ["calibrate", run, "--control", control, "--effect", "accel_bias_temperature:6"]
    outputs = ["-o", paths["cal.json"], "--json", paths["result.json"], "--report", paths["page.html"]]
    assert main([*arguments, *outputs]) == 0
    printed = capsys.readouterr().out
    assert "accel_bias_temperature_x_square" in printed
    assert "accel_bias_temperature: chi2 of its 6 parameters is" in printed
    result = json.loads((tmp_path / "result.json").read_text())
    named = {p["name"]: p for p in result["parameters"]}
    assert len(named) == 21 + 6
    for axis in "xyz":
        parameter = named[f"accel_bias_temperature_{axis}"]
        assert parameter["unit"] == "m/s^2/K"
        assert abs(parameter["value"] - 1e-3) < 4 * parameter["std"] < 2e-4
        assert named[f"accel_bias_temperature_{axis}_square"]["unit"] == "m/s^2/K^2"
    page = (tmp_path / "page.html").read_text()
    assert "accel_bias_temperature_z_square" in page
    assert "mg per K²" in page
    # The file carries the effect: judged and applied, it explains the control run and the plain one does not.
    assert main(["evaluate", paths["cal.json"], control, "--json", paths["judged.json"]]) == 0
    after = json.loads((tmp_path / "judged.json").read_text())["control_set"]["after"]
    assert after == result["control_set"]
    plain = imucal.calibrate(imucal.read(run), control=imucal.read(control)).control_set
    assert after["gravity_norm_rms_mps2"] < 0.2 * plain.gravity_norm_rms_mps2
    assert main(["apply", paths["cal.json"], control, "-o", str(tmp_path / "corrected.parquet")]) == 0
    assert "effects compensated: accel_bias_temperature" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--effect", "gyro_g_sensitivty"], "is it gyro_g_sensitivity"),
        (["--effect", "gyro_saturation"], "gyro_saturation is a fault"),
        (["--effect", "gyro_bias_drift:full"], "'gyro_bias_drift:full' is no form of gyro_bias_drift"),
        (["--effect", "gyro_bias_drift", "--effect", "gyro_bias_drift"], "is requested twice"),
        (["--effect", "gyro_bias_drift", "--frame", "triangular"], "leave frame at symmetric"),
    ],
)
def test_what_cannot_be_meant_is_refused(options, message, two_runs, capsys):
    assert main(["calibrate", str(two_runs / "run.parquet"), *options]) == 1
    assert message in capsys.readouterr().err


def test_effects_of_ones_own_need_the_symmetric_frame_too(two_runs):
    own = imucal.UserEffect(
        "own",
        "gyroscope",
        (imucal.EffectParameter("k", "1", 1.0),),
        lambda state: np.zeros((len(state.time_s), 3, 1)),
    )
    with pytest.raises(imucal.InputError, match="leave frame at symmetric"):
        imucal.calibrate(imucal.read(two_runs / "run.parquet"), effects=[own], frame="triangular")


def test_several_recordings_tell_more_of_an_effect_than_one(two_runs):
    recordings = [imucal.read(two_runs / name) for name in ("run.parquet", "control.parquet")]
    names = ["accel_bias_temperature", "gyro_scale_temperature"]
    alone = imucal.calibrate(recordings[0], effects=names)
    together = imucal.calibrate(recordings, effects=names)
    gain = [b.std / a.std for a, b in zip(alone.parameters, together.parameters, strict=True)]
    # Twice the rests and moves: sqrt(1 / 2) = 0.71, more or less, as the poses differ.
    assert np.median(gain) == pytest.approx(0.71, abs=0.1)
    assert together.verdict == "good"
    with pytest.raises(imucal.InputError, match=r"earth_rate needs the heading, .* give a single recording"):
        imucal.calibrate(recordings, effects=["earth_rate"])


def test_effects_of_an_own_kind_and_of_the_catalogue_together():
    supply = imucal.UserEffect(
        "gyro_scale_supply",
        "gyroscope",
        tuple(imucal.EffectParameter(axis, "1/V", 1e-3) for axis in "xyz"),
        lambda state: (
            (state.auxiliary["supply_v"] - 3.3)[:, None, None] * state.angular_rate[:, :, None] * np.eye(3)
        ),
    )
    true = {"gyro_scale_supply": [0.02, -0.01, 0.015], "gyro_g_sensitivity": 1e-4}
    run = imucal.simulate(
        imucal.Program.random(seed=1),
        unit=quiet(),
        rate_hz=200,
        effects=true,
        user_effects=[supply],
        auxiliary={"supply_v": lambda time_s: 3.3 + 0.2 * np.sin(time_s / 20.0)},
        seed=1,
    )
    result = imucal.calibrate(run.recording, effects=["gyro_g_sensitivity", supply], folds=3)
    found = {p.name: p.value for p in result.parameters[21:]}
    assert [found[f"gyro_scale_supply_{axis}"] for axis in "xyz"] == pytest.approx(
        true["gyro_scale_supply"], rel=1e-5
    )
    assert found["gyro_g_sensitivity_xy"] == pytest.approx(1e-4, rel=1e-5)
    assert result.held_out.gravity_direction_rms_deg < 1e-3
    assert [effect.name for effect in result.fit.effects] == ["gyro_g_sensitivity", "gyro_scale_supply"]
