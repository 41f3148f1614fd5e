"""The search for the missing effect, through the public API and the command.

`unit_of` is used, because the public API has no function that gives a unit by its name.
"""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import imucal
from gap_runs import CATALOGUE
from imucal.rig.unit import unit_of

PADOVA_MPS2 = 9.81744
MPU9150 = "accel_x_mps2,accel_y_mps2,accel_z_mps2,gyro_x_radps,gyro_y_radps,gyro_z_radps"
COUNTS = "accel_x_lsb,accel_y_lsb,accel_z_lsb,gyro_x_lsb,gyro_y_lsb,gyro_z_lsb"
# Named seeds of the runs and of their controls.
RUN_SEED, CONTROL_SEED = 11, 12


def hidden(seed=RUN_SEED, **arguments):
    return imucal.simulate("random", seed=seed, rate_hz=100.0, **arguments).recording


@pytest.mark.slow
def test_a_real_unit_is_named_and_its_gap_shrinks(data_file, tmp_path, command):
    files = [data_file(f"xsens_mti/xsens_{sensor}.mat") for sensor in ("acc", "gyro")]
    done = command(
        "gap",
        *files,
        "--format",
        "imu_tk",
        "--gravity",
        PADOVA_MPS2,
        "--json",
        "-",
        "-o",
        tmp_path / "i.json",
    )
    gap = json.loads(done.stdout)
    assert gap["schema"] == "imucal.gap/1"
    assert gap["verdict"] == "named"
    assert [effect["name"] for effect in gap["effects"]] == ["gyro_g_sensitivity"]
    assert gap["gap"]["after"] < 0.175 < 0.4 < gap["gap"]["before"]
    carried = imucal.Calibration.load(tmp_path / "i.json").effects
    assert [values.name for values in carried] == ["gyro_g_sensitivity"]


@pytest.mark.parametrize(
    ("unit", "verdict", "not_there"),
    [
        # Something turns with gravity at twice the Earth's rate.
        ("imu0", "unknown", "the Earth's rate is 0.004178 deg/s"),
        # The bias wanders, and a drift does not say where to.
        ("imu1", "stochastic", "gyro_bias_drift fits these recordings"),
    ],
)
def test_a_real_unit_is_given_no_effect_that_does_not_predict(data_file, unit, verdict, not_there):
    rec = imucal.read(data_file(f"mpu9150/{unit}.log"), columns=MPU9150, rate_hz=100.0)
    gap = imucal.find_gap(rec)
    assert (gap.verdict, gap.effects) == (verdict, ())
    assert not_there in "\n".join(gap.notes)
    assert gap.gap["before"] == gap.gap["after"]


@pytest.mark.slow
def test_what_turns_three_times_as_fast_as_the_earth_is_not_it_and_one_search_says_so():
    program = imucal.Program.random(seed=4, moves=40, hold_s=8.0, move_s=2.0)
    run = imucal.simulate(program, rate_hz=100.0, seed=5, effects={"earth_rate": [1.6e-4, 0.0, 1.4e-4]})
    stages = []
    gap = imucal.find_gap(run.recording, candidates=CATALOGUE, stage=stages.append)
    assert "earth_rate" not in [effect["name"] for effect in gap.effects]
    assert any(note.startswith("earth_rate fits these recordings with 0.012") for note in gap.notes)
    assert sum(stage.startswith("scoring") for stage in stages) == 1
    assert not any("earth_rate" in stage for stage in stages)


def test_a_real_unit_whose_gyroscope_clips_is_a_fault(data_file):
    path = data_file("mpu6050/example_data_calibration.csv")
    rec = imucal.read(path, columns=COUNTS, rate_hz=100.0, skip_rows=5)
    gap = imucal.find_gap(rec)
    assert gap.verdict == "data_fault"
    assert "gyro_saturation" in [effect["name"] for effect in gap.effects]


def test_nothing_is_missing_where_nothing_is_hidden():
    gap = imucal.find_gap(hidden(), control=hidden(CONTROL_SEED))
    assert gap.verdict == "nothing_missing"
    assert gap.effects == ()
    # 46 norms and 90 components of directions: chi2 per degree of freedom scatters by 0.12 about one.
    assert gap.gap["before"] == gap.gap["after"] == pytest.approx(1.0, abs=0.36)
    # The tables of detection limits, and of effects that are not observable.
    assert gap.smallest_visible["gyro_g_sensitivity"]["unit"] == "rad/s/(m/s^2)"
    assert {"gyro_bias_temperature"} <= {item["name"] for item in gap.not_observable}


@pytest.mark.slow
def test_nothing_is_missing_in_many_noisy_moves():
    # Residuals and their derivatives inside the moves must not share the noise of the same samples.
    unit = unit_of("paper")
    loud = replace(unit.accelerometer, noise_density=3.0 * unit.accelerometer.noise_density)
    motion = imucal.Program.random(seed=RUN_SEED, moves=150, hold_s=3.0)
    run = imucal.simulate(motion, seed=RUN_SEED, unit=replace(unit, accelerometer=loud), rate_hz=100.0)
    assert imucal.find_gap(run.recording).verdict == "nothing_missing"


@pytest.mark.slow
@pytest.mark.parametrize("name", ["gyro_g_sensitivity", "accel_scale_quadratic", "accel_lever_arm"])
def test_what_is_hidden_is_named_added_and_gone(name):
    effect = imucal.effects.find(name)
    values = [
        p.typical * sign
        for p, sign in zip(effect.parameters[: effect.plain], [1, -0.7, 0.4] * 3, strict=False)
    ]
    given = {"effects": {name: values}}
    gap = imucal.find_gap(hidden(**given), control=hidden(CONTROL_SEED, **given))
    assert gap.verdict == "named"
    assert [found["name"] for found in gap.effects] == [name]
    for parameter, value in zip(gap.effects[0]["parameters"], values, strict=True):
        assert abs(parameter["value"] - value) < 5 * parameter["std"]
    # What acts only inside the moves does not show from rest to rest, where the control record judges.
    if name != "accel_lever_arm":
        assert gap.gap["closed"] > 0.9
    assert gap.gap["after"] <= gap.gap["before"] * 1.005


def test_faults_of_the_data_come_before_effects():
    gap = imucal.find_gap(hidden(effects={"gyro_saturation": 1.5}))
    assert gap.verdict == "data_fault"
    assert "gyro_saturation" in [effect["name"] for effect in gap.effects]
    assert gap.calibration is None


@pytest.mark.slow
def test_an_effect_of_ones_own_is_found_by_its_name_and_removed():
    per_volt = tuple(imucal.EffectParameter(axis, "rad/s/V", 1e-3) for axis in "xyz")
    supply = imucal.UserEffect(
        "gyro_bias_supply",
        "gyroscope",
        per_volt,
        lambda state: (state.auxiliary["supply_v"] - 3.3)[:, None, None] * np.eye(3),
    )
    truth = [1e-2, -5e-3, 8e-3]

    def run(seed):
        return imucal.simulate(
            "random",
            seed=seed,
            rate_hz=100.0,
            effects={"gyro_bias_supply": truth},
            user_effects=[supply],
            auxiliary={"supply_v": lambda time_s: 3.3 + 0.2 * np.sin(time_s / 20.0)},
        ).recording

    gap = imucal.find_gap(run(RUN_SEED), control=run(CONTROL_SEED), user_effects=[supply])
    assert gap.verdict == "named"
    assert [effect["name"] for effect in gap.effects] == ["gyro_bias_supply"]
    for parameter, value in zip(gap.effects[0]["parameters"], truth, strict=True):
        assert abs(parameter["value"] - value) < 5 * parameter["std"]
    # 46 norms and 90 components of directions: chi2 per degree of freedom scatters by 0.12 about one.
    assert gap.gap["before"] > 2.0
    assert gap.gap["after"] == pytest.approx(1.0, abs=0.36)
    # Without the definition among the candidates it is nobody else's.
    blind = imucal.find_gap(run(RUN_SEED), control=run(CONTROL_SEED))
    assert blind.verdict != "nothing_missing"


@pytest.mark.slow
def test_what_the_finding_says_can_be_read():
    effects = {"gyro_g_sensitivity": 1e-4}
    gap = imucal.find_gap(hidden(effects=effects), control=hidden(CONTROL_SEED, effects=effects))
    assert "gyro_g_sensitivity" in gap.summary()
    assert gap.to_dict()["provenance"]["imucal_version"] == imucal.__version__
    explained = "\n".join(gap.explain("earth_rate"))
    assert "detection limit in these recordings" in explained
    with pytest.raises(imucal.InputError, match="gyro_g_sensitivity"):
        gap.explain("gyro_g_sensitivty")


@pytest.mark.slow
def test_an_effect_is_named_of_which_a_stand_shows_some_directions():
    """Three of nine g^2-sensitivities are a bias; the others are seen, five times what just is."""
    random = np.random.default_rng(1)
    own = [imucal.EffectValues("gyro_g2_sensitivity", random.normal(scale=1e-5, size=9))]
    run, control = (hidden(seed, effects=own) for seed in (RUN_SEED, CONTROL_SEED))
    gap = imucal.find_gap(run, control=control)
    assert gap.verdict == "named"
    assert [effect["name"] for effect in gap.effects] == ["gyro_g2_sensitivity"]


@pytest.mark.slow
def test_sensors_that_contradict_the_stand_say_that_it_is_the_stand():
    """Encoders that lag look like a gyroscope that leads, and the accelerometer says that it does not."""
    others = [effect.name for effect in imucal.effects.catalogue() if effect.name != "encoder_time_offset"]
    own = [imucal.EffectValues("encoder_time_offset", [1e-3])]
    stand = imucal.Stand(encoder_noise_deg=0.005)
    run, control = (hidden(seed, effects=own, stand=stand) for seed in (RUN_SEED, CONTROL_SEED))
    gap = imucal.find_gap(run, control=control, candidates=others)
    assert gap.verdict == "unknown"
    assert gap.generic["block"] == "encoder"


def test_a_bias_that_switches_is_no_rest_that_turns():
    """A supply that sags at a third of the rests: so many are not left out as slow turns."""

    def sag(state):
        return ((state.time_s / 60.0) % 1.0 < 0.35)[:, None, None] * np.ones((1, 3, 1))

    one = (imucal.EffectParameter("sag", "rad/s", 1e-3),)
    bias = imucal.UserEffect("sag", "gyroscope", one, sag)
    own = [imucal.EffectValues("sag", [1.5e-3])]
    run, control = (hidden(seed, effects=own, user_effects=[bias]) for seed in (RUN_SEED, CONTROL_SEED))
    gap = imucal.find_gap(run, control=control)
    assert gap.verdict in ("unknown", "stochastic")
    assert gap.generic["block"] == "gyro_bias"
