"""Rests of minutes: epochs of one pose, from which effects of the temperature are estimated."""

import json
import re

import numpy as np
import pytest

import imucal
from imucal.cli import main

EFFECTS = {
    "gyro_bias_temperature": (1.4e-4, -0.7e-4, 2.1e-4),
    "accel_bias_temperature": (1.4e-3, 0.7e-3, -1e-3),
}
SOAK_S = 900.0


def soak(seed, temperature, effects=EFFECTS, duration_s=SOAK_S):
    return imucal.simulate(
        imucal.Static(duration_s, (0.92, 0.2, -0.3, 0.1)),
        seed=seed,
        rate_hz=25,
        temperature=temperature,
        effects=effects,
    ).recording


@pytest.fixture(scope="module")
def run():
    return imucal.simulate("random", seed=4, rate_hz=100, temperature=25.0, effects=EFFECTS)


@pytest.fixture(scope="module")
def cycled():
    return soak(5, imucal.Temperature.cycle(10.0, 60.0, SOAK_S))


def test_a_soak_is_one_rest_with_its_epochs_counted(cycled):
    seen = imucal.inspect(cycled)
    (rest,) = seen.rests
    # 50 K up and down, 2 K an epoch.
    assert rest.epochs == 50 and rest.end_s - rest.start_s > 0.99 * SOAK_S
    assert seen.to_dict()["rests"][0]["epochs"] == 50
    assert "1 rest does not determine" in seen.missing


def test_a_rest_of_up_to_two_minutes_has_one_epoch(run):
    assert {rest.epochs for rest in imucal.inspect(run.recording).rests} == {1}
    # At 25 Hz noise interrupts the rest now and then. Parts of a long rest are joined, other rests are not.
    assert {rest.epochs for rest in imucal.inspect(soak(1, 25.0, {}, 119.0)).rests} == {1}
    (long,) = imucal.inspect(soak(1, 25.0, {}, 124.0)).rests
    assert long.epochs == 3


def test_effects_of_the_temperature_are_estimated_from_a_soak(run, cycled):
    result = imucal.calibrate([run.recording, cycled], effects=list(EFFECTS))
    assert result.verdict == "good", result.reasons
    truth = {p.name: p.value for p in run.truth.calibration.parameters}
    errors = np.array([(p.value - truth[p.name]) / p.std for p in result.parameters])
    assert np.abs(errors).max() < 5
    # The run has one temperature, so the soak determines the coefficients.
    found = {p.name: p for p in result.parameters}
    assert all(found[f"gyro_bias_temperature_{axis}"].std < 1e-6 for axis in "xyz")
    *rests, last = result.rests
    assert last.recording == cycled.name and last.epochs == 50 and last.excluded is None
    assert {rest.epochs for rest in rests} == {1}
    # Steps between epochs are no moves of the report.
    assert len(result.moves) == len(rests) - 1


def test_epochs_are_no_poses(run):
    """A soak at a constant temperature hardly adds information about sensitivities."""
    alone = imucal.calibrate(run.recording)
    beside = imucal.calibrate([run.recording, soak(6, 25.0)])
    assert beside.verdict == "good", beside.reasons
    assert beside.rests[-1].epochs == 15 and beside.rests[-1].excluded is None
    for before, after in zip(alone.parameters, beside.parameters, strict=True):
        if "sensitivity" in before.name:
            assert 0.8 * before.std < after.std < 1.05 * before.std, before.name
    with pytest.raises(imucal.NotEnoughMotionError, match="2 rests do not determine"):
        imucal.calibrate([soak(7, 25.0), soak(8, 25.0)])


def test_drift_that_the_model_lacks_is_reported(run, cycled):
    """Without the effects the verdict is not good, because the epochs differ by more than noise."""
    result = imucal.calibrate([run.recording, cycled])
    assert result.verdict != "good"


def test_gap_finds_the_temperature_in_a_soak():
    effects = {"gyro_bias_temperature": EFFECTS["gyro_bias_temperature"]}
    program = imucal.Program.random(seed=2, moves=24)
    run = imucal.simulate(program, seed=2, rate_hz=50, temperature=25.0, effects=effects).recording
    cycled = soak(3, imucal.Temperature.cycle(10.0, 40.0, 600.0), effects, 600.0)
    gap = imucal.find_gap([run, cycled])
    assert [effect["name"] for effect in gap.effects] == ["gyro_bias_temperature"], gap.summary()


def test_the_command_shows_the_epochs(cycled, tmp_path, capsys):
    path = tmp_path / "soak.parquet"
    imucal.write(cycled, path)
    assert main(["inspect", str(path), "--json", str(tmp_path / "seen.json")]) == 2
    shown = capsys.readouterr().out
    assert re.search(r"rest +from s +to s +duration s +epochs\n.*\n? *0 +.* 50", shown), shown
    assert "together count as one pose" in shown
    document = json.loads((tmp_path / "seen.json").read_text(encoding="utf-8"))
    assert document["recordings"][0]["rests"][0]["epochs"] == 50
