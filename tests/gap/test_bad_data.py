"""A search on recordings with holes, repeated samples and effects that are larger than the model expects."""

import dataclasses

import numpy as np
import pytest

import imucal
from gap_runs import CATALOGUE, CONTROL_SEED, RUN_SEED, pair, simulated

pytestmark = pytest.mark.slow

CYCLE = "cycle:10:40:320"


def changed(recording, **fields):
    columns = {
        name: getattr(recording, name)
        for name in ("time_s", "specific_force", "angular_rate", "temperature_degc", "stand_rad")
    }
    return imucal.Recording(**{**columns, "name": recording.name, **fields})


def in_a_move(run, k):
    """The middle of move k, as a sample."""
    return int(np.searchsorted(run.recording.time_s, (run.truth.rests[k][1] + run.truth.rests[k + 1][0]) / 2))


def test_recordings_may_have_one_name():
    program = imucal.Program.random(seed=5, moves=20)
    runs = [simulated(seed, program).recording for seed in (RUN_SEED, CONTROL_SEED)]
    same = [changed(run, name="run", stand_rad=None) for run in (runs[0], runs[1].between(0.0, 140.0))]
    gap = imucal.find_gap(same)
    assert gap.verdict == "nothing_missing"
    assert all(row["times_noise"] < 1.5 for row in gap.where["channels"])


def test_one_temperature_that_is_missing_is_said():
    recording, _ = pair(effects={"gyro_bias_temperature": "typical"}, temperature=CYCLE)
    assert [e["name"] for e in imucal.find_gap(recording).effects] == ["gyro_bias_temperature"]
    temperature = recording.temperature_degc.copy()
    temperature[12345] = np.nan
    holed = changed(recording, temperature_degc=temperature)
    gap = imucal.find_gap(holed, candidates=CATALOGUE)
    needs = {item["name"]: item["needs"] for item in gap.not_observable}
    assert needs["gyro_bias_temperature"].startswith("a temp_degc column without holes")
    with pytest.raises(imucal.InputError, match="samples without temperature: repair the temp_degc column"):
        imucal.calibrate(holed, effects=["gyro_bias_temperature"])


def test_an_angle_of_the_stand_that_is_missing_is_said():
    recording = dataclasses.replace(simulated(RUN_SEED)).recording
    stand = np.zeros((len(recording), 3))
    stand[777, 1] = np.nan
    gap = imucal.find_gap(changed(recording, stand_rad=stand))
    needs = {item["name"]: item["needs"] for item in gap.not_observable}
    assert "without holes" in needs["encoder_backlash"]


def test_a_repeated_sample_is_no_hand():
    recording, control = pair(effects={"accel_lever_arm": "typical"})
    rows = np.insert(np.arange(len(recording)), 4321, 4320)
    repeated = changed(
        recording,
        time_s=recording.time_s[rows],
        specific_force=recording.specific_force[rows],
        angular_rate=recording.angular_rate[rows],
    )
    gap = imucal.find_gap(repeated, control=control)
    assert [effect["name"] for effect in gap.effects] == ["accel_lever_arm"]
    corrected = gap.calibration.apply_recording(repeated)
    assert np.isfinite(corrected.specific_force).all()


@pytest.mark.parametrize("code", ["samples_missing", "samples_duplicated"])
def test_a_few_samples_that_disturb_nothing_are_a_warning(code):
    few, many = (simulated(RUN_SEED, effects={code: share}).recording for share in (3e-4, 5e-3))
    gap = imucal.find_gap(few)
    assert (gap.verdict, gap.effects) == ("nothing_missing", ())
    assert [finding.code for finding in gap.findings] == [code]
    assert f"warning: {gap.findings[0]}" in gap.summary()
    gap = imucal.find_gap(many)
    assert (gap.verdict, [effect["name"] for effect in gap.effects]) == ("data_fault", [code])
    assert f"warning: {gap.findings[0]}" in gap.summary()


def test_a_few_lost_samples_come_first_where_something_disagrees():
    recording, control = pair(effects={"samples_missing": 3e-4})
    of_another = changed(control, angular_rate=1.5 * control.angular_rate, stand_rad=None)
    gap = imucal.find_gap(recording, control=of_another)
    assert (gap.verdict, [effect["name"] for effect in gap.effects]) == ("data_fault", ["samples_missing"])
    assert "chi2" in gap.summary()


def test_the_heading_is_lost_behind_a_gap():
    run = simulated(RUN_SEED)
    middle = in_a_move(run, 10)
    kept = np.r_[0 : middle - 15, middle + 15 : len(run.recording)]
    recording = run.recording
    with_gap = changed(
        recording,
        time_s=recording.time_s[kept],
        specific_force=recording.specific_force[kept],
        angular_rate=recording.angular_rate[kept],
        stand_rad=None,
    )
    with pytest.raises(imucal.InputError, match="the heading, which is lost at"):
        imucal.calibrate(with_gap, effects=["earth_rate"])
    needs = {item["name"]: item["needs"] for item in imucal.find_gap(with_gap).not_observable}
    assert "the heading is lost" in needs["earth_rate"]


def test_a_large_effect_does_not_spoil_the_weights():
    values = 1.8e-3 * np.array([2.6, 0.1, 0.2, 0.8, -0.3, -1.0, 0.5, 0.0, 0.0])
    runs = [
        imucal.simulate(
            imucal.Program.random(seed=seed),
            unit="paper",
            effects=[imucal.EffectValues("gyro_g_sensitivity", values)],
            stand=imucal.Stand(mount_rotation_deg=(0.8, -1.1, 0.6), base_tilt_deg=(0.4, -0.3)),
            rate_hz=100,
            seed=seed,
        ).recording
        for seed in (RUN_SEED, CONTROL_SEED)
    ]
    gap = imucal.find_gap(runs[0], control=runs[1])
    assert (gap.verdict, [effect["name"] for effect in gap.effects]) == ("named", ["gyro_g_sensitivity"])


def test_noise_of_a_turned_gyroscope_is_that_of_its_body_axes():
    recording, _ = pair()
    plain = imucal.calibrate(recording).calibration.noise
    turn = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = changed(recording, angular_rate=recording.angular_rate @ turn.T)
    noise = imucal.calibrate(turned).calibration.noise
    names = [name for name in plain if "angular_rate" in name or name.startswith("gyro")]
    assert names
    for name in names:
        assert noise[name] == pytest.approx(plain[name], rel=0.1), name
