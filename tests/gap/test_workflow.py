"""From a gap to the effect, what it is worth, and the motion that decides: the workflow of `imucal gap`."""

from __future__ import annotations

import dataclasses
import json
import re

import numpy as np
import pytest

import imucal
from gap_runs import CATALOGUE, CONTROL_SEED, RATE_HZ, RUN_SEED, pair, simulated
from imucal.report import write_gap_page

pytestmark = pytest.mark.slow

NEXT_SEED = 21


def channel(gap, name, axis=None):
    return next(row for row in gap.where["channels"] if (row["channel"], row["axis"]) == (name, axis))


def slow_errors(recording, truth):
    """Rms error of rate and force, averaged over 1 s."""
    errors = np.hstack(
        (recording.angular_rate - truth.angular_rate, recording.specific_force - truth.specific_force)
    )
    width = round(RATE_HZ)
    means = errors[: len(errors) // width * width].reshape(-1, width, 6).mean(axis=1)
    return {
        "angular_rate_rms_radps": np.sqrt(np.mean(means[:, :3] ** 2)),
        "specific_force_rms_mps2": np.sqrt(np.mean(means[:, 3:] ** 2)),
    }


def test_where_it_disagrees_in_units_of_noise_and_in_si_units():
    true = 1.5e-4
    run, control = pair(effects={"gyro_g_sensitivity": np.diag([true, 0.0, 0.0]).ravel().tolist()})
    gap = imucal.find_gap(run, control=control)
    row = channel(gap, "rest_rate", "x")
    assert row["stands_out"]
    assert [r["axis"] for r in gap.where["channels"] if r["channel"] == "rest_rate" and r["stands_out"]] == [
        "x"
    ]
    # The bias takes up the mean over the rests, as far as moves let it; noise adds 2 % of the squares.
    up = np.array([rest.mean_specific_force for rest in gap.fits["before"].rests])[:, 0]
    assert row["rms"] == pytest.approx(true * np.std(up), rel=0.15)
    assert row["times_noise"] == pytest.approx(row["rms"] / row["noise_rms"], rel=0.02)
    assert row["times_noise_after"] == pytest.approx(1.0, abs=0.35)
    goes_with = [d for d in gap.where["depends"] if (d["channel"], d["axis"]) == ("rest_rate", "x")]
    assert goes_with[0]["on"] == "gravity"
    assert goes_with[0]["share"] > 0.9
    assert gap.to_dict()["where"] == json.loads(json.dumps(gap.where))


def test_a_dependence_on_time_is_found_in_time_stamps_that_count_from_1970():
    effects = {"gyro_bias_warmup": [3e-3, -2e-3, 1e-3]}
    run = simulated(RUN_SEED, effects=effects).recording
    later = dataclasses.replace(run, time_s=run.time_s + 1.7e9)
    found = [imucal.find_gap(each, candidates=["gyro_bias_warmup"]) for each in (run, later)]
    rates, rates_later = (
        {
            d["axis"]: d["share"]
            for d in gap.where["depends"]
            if (d["channel"], d["on"]) == ("rest_rate", "time")
        }
        for gap in found
    )
    assert rates.keys() == {"x", "y", "z"}
    # A double has a resolution of 2.4e-7 s at these time stamps.
    assert rates_later == pytest.approx(rates, rel=1e-5)


def test_what_acts_in_moves_alone_disagrees_there_alone():
    run, control = pair(effects={"accel_lever_arm": "typical"})
    gap = imucal.find_gap(run, control=control)
    assert {row["channel"] for row in gap.where["channels"] if row["stands_out"]} == {"move_force"}
    # The same is left as in a unit without the effect: in moves that is 1.2 times the noise, because
    # residuals of 3.5e-3 m/s^2 there do not depend on noise.
    plain_run, plain_control = pair()
    plain = imucal.find_gap(plain_run, control=plain_control, candidates=["accel_lever_arm"])
    for axis in "xyz":
        left = channel(gap, "move_force", axis)["times_noise_after"]
        assert left == pytest.approx(channel(plain, "move_force", axis)["times_noise"], abs=0.1)
        assert left < 1.3
    assert gap.where["rests"] == []


def test_the_axis_that_bad_moves_share_is_named():
    # At 15 deg/s the effect is below the noise of a move, at 25 deg/s some of these moves show it.
    steps = [*imucal.Program.random(seed=5, moves=30, max_rate_dps=15.0).steps]
    for sign in (1.0, -1.0) * 8:
        steps += [imucal.Step((0.0, 0.0, 170.0 * sign), 2.0, 3.0), imucal.Step((40.0, 55.0, 0.0), 8.0, 3.0)]
    run = simulated(
        RUN_SEED, imucal.Program(tuple(steps)), effects={"gyro_scale_quadratic": [0.0, 0.0, 1e-3]}
    ).recording
    where = imucal.find_gap(run, candidates=["gyro_scale_quadratic"]).where
    assert where["moves"]
    assert where["turns_about"] == "z"


def test_an_effect_of_the_stand_has_a_page_too(tmp_path):
    run = imucal.simulate(
        "random", seed=RUN_SEED, rate_hz=RATE_HZ, effects={"encoder_eccentricity": "typical"}
    ).recording
    gap = imucal.find_gap(run)
    assert [effect["name"] for effect in gap.effects] == ["encoder_eccentricity"]
    # No correction of the signals takes it away, nor has to.
    assert all(row["times_noise_after"] is None for row in gap.where["channels"])
    write_gap_page(tmp_path / "gap.html", gap)
    assert "encoder_eccentricity" in (tmp_path / "gap.html").read_text()


def test_nothing_stands_out_where_nothing_is_hidden():
    run, control = pair()
    gap = imucal.find_gap(run, control=control)
    assert not any(row["stands_out"] for row in gap.where["channels"])
    assert (gap.where["rests"], gap.where["moves"], gap.where["depends"]) == ([], [], [])
    assert gap.corrected_error is None


def worth(name, values, figure, seed, simulate=simulated):
    """What is claimed of a corrected control run, and by which factor its true error shrinks."""
    run = simulate(2 * seed, effects={name: values}).recording
    control = simulate(2 * seed + 1, effects={name: values})
    gap = imucal.find_gap(run, control=control.recording, candidates=CATALOGUE)
    assert [effect["name"] for effect in gap.effects] == [name]
    before, after = (
        slow_errors(calibration.apply_recording(control.recording), control.truth)[figure]
        for calibration in (gap.fits["before"].calibration, gap.calibration)
    )
    claimed = gap.corrected_error[figure]
    assert claimed["factor"] == pytest.approx(claimed["before"] / claimed["after"])
    return claimed, before / after


@pytest.mark.parametrize(
    ("name", "figure"),
    [
        ("gyro_g_sensitivity", "angular_rate_rms_radps"),
        ("gyro_scale_quadratic", "angular_rate_rms_radps"),
        ("accel_lever_arm", "specific_force_rms_mps2"),
    ],
)
def test_the_error_of_corrected_signals_shrinks_as_claimed(name, figure):
    for seed in (1, 2, 3):
        claimed, true = worth(name, "typical", figure, seed)
        assert true > 1.5
        assert claimed["factor"] == pytest.approx(true, rel=0.1)


def with_encoders(seed, **arguments):
    return imucal.simulate("random", seed=seed, rate_hz=RATE_HZ, **arguments)


# Fifteen numbers of which the recording hardly shows some, a fifth of what is typical.
FAINT = (2.2e-5 * np.array([1, -1, 1, 1, -1, -1, 1, 1, -1, -1, -1, 1, 1, -1, 1])).tolist()


@pytest.mark.parametrize(
    ("name", "values", "simulate", "seeds", "width"),
    [
        # Noise of the control run over 1 s, and of its estimate, leave 4 % to chance.
        ("accel_scale_quadratic", "typical", simulated, range(1, 9), 1.2),
        # Here what is left after it is half noise, half errors of a few parameters: 15 %.
        ("accel_cross_axis_quadratic", FAINT, with_encoders, range(1, 9), 2.0),
    ],
)
def test_where_chance_decides_the_claim_is_right_on_average_and_its_interval_holds(
    name, values, simulate, seeds, width
):
    found = [worth(name, values, "specific_force_rms_mps2", seed, simulate) for seed in seeds]
    ratios = [claimed["factor"] / true for claimed, true in found]
    assert np.exp(np.mean(np.log(ratios))) == pytest.approx(1.0, abs=0.1)
    held = [claimed["factor_low"] <= true <= claimed["factor_high"] for claimed, true in found]
    # Of eight intervals of 95 % three fail once in two hundred times.
    assert sum(held) >= len(held) - 2
    assert np.median([claimed["factor_high"] / claimed["factor_low"] for claimed, _ in found]) < width


def test_the_improved_calibration_is_what_apply_uses(command, tmp_path):
    effects = {"gyro_g_sensitivity": "typical"}
    run, control = simulated(RUN_SEED, effects=effects), simulated(CONTROL_SEED, effects=effects)
    for name, made in (("run", run), ("control", control)):
        imucal.write(made.recording, tmp_path / f"{name}.csv")
    files = (tmp_path / "run.csv", "--control", tmp_path / "control.csv")
    command("calibrate", *files, "-o", tmp_path / "plain.json")
    done = command("gap", *files, "-o", tmp_path / "improved.json", "--json", "-")
    assert done.returncode == 0, done.stderr
    assert "residuals: rate at rest about" in done.stderr
    assert "gyro_g_sensitivity" in done.stderr
    errors = {}
    for name in ("plain", "improved"):
        applied = tmp_path / f"{name}.csv"
        command("apply", tmp_path / f"{name}.json", tmp_path / "control.csv", "-o", applied)
        errors[name] = slow_errors(imucal.read(applied), control.truth)
    for figure, claimed in json.loads(done.stdout)["corrected_error"].items():
        true = errors["plain"][figure] / errors["improved"][figure]
        assert claimed["before"] / claimed["after"] == pytest.approx(true, rel=0.1)


def test_without_a_control_record_rests_and_moves_are_held_out():
    run, _ = pair(effects={"accel_scale_quadratic": "typical"})
    gap = imucal.find_gap(run)
    assert [effect["name"] for effect in gap.effects] == ["accel_scale_quadratic"]
    # It shows in the rests alone.
    assert gap.gap["metric"] == "held_out_gravity_norm_rms_mps2"
    assert gap.gap["closed"] > 0.9
    held_out = gap.held_out
    assert held_out["after"]["gravity_norm_rms_mps2"] < 0.2 * held_out["before"]["gravity_norm_rms_mps2"]
    assert "held-out rests and moves" in gap.summary()
    assert "no control recording was given" in gap.summary()


def test_the_finding_is_one_sentence():
    run, control = pair(effects={"gyro_g_sensitivity": "typical"})
    gap = imucal.find_gap(run, control=control)
    headline = gap.summary().splitlines()[1]
    assert headline.startswith("gyro_g_sensitivity (largest parameter 0.10")
    assert (
        "deg/s per g) explains 100 % of the gap; control gravity direction error per move: 0.14 -> 0.0"
        in headline
    )
    assert "averaged over 1 s: rate 0.095 -> 0.018 deg/s" in gap.summary()


@pytest.mark.parametrize("delay_s", [3e-3, 5e-3])
def test_a_long_delay_is_accepted(delay_s):
    run, control = pair(effects={"gyro_time_offset": delay_s})
    gap = imucal.find_gap(run, control=control)
    assert [effect["name"] for effect in gap.effects] == ["gyro_time_offset"]
    # It is the same at both ends of a move: what it explains is in between.
    assert " % of the excess of force during moves along " in gap.summary().splitlines()[1]


def test_a_large_effect_does_not_hide_how_small_others_would_be_seen():
    run, control = pair(effects={"accel_scale_quadratic": "typical"})
    clean, clean_control = pair()
    hidden = imucal.find_gap(run, control=control).smallest_visible
    nothing = imucal.find_gap(clean, control=clean_control).smallest_visible
    for name in ("accel_scale_cubic", "accel_bias_drift", "gyro_g_sensitivity"):
        assert hidden[name]["value"] < 1.7 * nothing[name]["value"]


def test_a_large_effect_is_told_from_what_resembles_it():
    run, control = pair(effects={"accel_scale_quadratic": [1e-3, 3e-3, 2e-3]})
    gap = imucal.find_gap(run, control=control)
    assert (gap.verdict, [effect["name"] for effect in gap.effects]) == ("named", ["accel_scale_quadratic"])


def test_an_effect_of_a_fifth_of_the_force_is_named_and_taken_away():
    run, control = pair(effects={"accel_scale_quadratic": [0.02, 0.02, 0.02]})
    gap = imucal.find_gap(run, control=control)
    assert [effect["name"] for effect in gap.effects] == ["accel_scale_quadratic"]
    assert (
        gap.control_set["before"]["gravity_norm_rms_mps2"]
        > 100 * gap.control_set["after"]["gravity_norm_rms_mps2"]
    )


def test_effects_that_the_control_run_cannot_bear_are_a_verdict():
    # Half of the force: near -1 g two forces have the same reading, so the effect cannot be taken away from
    # some samples of the control run. Another effect that explains a part of it is not named instead.
    run, control = pair(effects={"accel_scale_quadratic": [0.05, 0.05, 0.05]})
    gap = imucal.find_gap(run, control=control)
    assert (gap.verdict, gap.effects) == ("unknown", ())
    assert "too large to be removed" in gap.remainder.description
    assert "record more" not in gap.summary()


def test_a_run_by_hand_beside_one_on_a_stand_is_told_from_it():
    # Between them they scatter by less than a hand alone.
    drift = {"accel_bias_drift": [2e-5, 3e-5, -2e-5]}
    hand = imucal.Tumble(RUN_SEED, poses=46, hold_s=5.0, move_s=2.0)
    stand = imucal.Program.random(seed=CONTROL_SEED, moves=120)
    runs = [
        simulated(seed, motion, effects=drift).recording
        for seed, motion in ((RUN_SEED, hand), (CONTROL_SEED, stand))
    ]
    gap = imucal.find_gap(runs, control=simulated(NEXT_SEED, effects=drift).recording)
    assert (gap.verdict, [effect["name"] for effect in gap.effects]) == ("named", ["accel_bias_drift"])
    assert any("the unit was translated during the moves" in note for note in gap.notes)


def test_a_short_run_with_a_plain_effect_is_not_called_complete():
    run, control = (
        simulated(
            seed, imucal.Program.random(seed=seed, moves=16), effects={"gyro_time_offset": 6e-4}
        ).recording
        for seed in (RUN_SEED, CONTROL_SEED)
    )
    gap = imucal.find_gap(run, control=control)
    assert [effect["name"] for effect in gap.effects] == ["gyro_time_offset"]


def test_an_effect_is_explained_for_these_recordings(command, tmp_path):
    run, control = pair(effects={"gyro_g_sensitivity": "typical"})
    for recording, file in ((run, "run"), (control, "control")):
        imucal.write(recording, tmp_path / f"{file}.csv")
    files = (tmp_path / "run.csv", "--control", tmp_path / "control.csv")
    done = command("gap", *files, "--explain", "gyro_g_sensitivity")
    assert "gyro_g_sensitivity (gyroscope): " in done.stdout
    assert re.search(r"rate at rest about [xyz] [\d.]+ x noise", done.stdout)
    assert "result: added to the model" in done.stdout
    gap = imucal.find_gap(run, control=control)
    assert "detection limit in these recordings" in "\n".join(gap.explain("accel_scale_quadratic"))
    needs = "not observable in these recordings: it needs a temp_degc column"
    assert needs in "\n".join(gap.explain("gyro_bias_temperature"))


AMBIGUOUS = [
    # What a temperature that only rises cannot tell from time.
    ("gyro_bias_temperature", "typical", {"temperature": "warmup:25:40:100"}),
    ("accel_bias_temperature", "typical", {"temperature": "warmup:25:40:100"}),
    # A small effect and few rests: with 4e-4 these rests alone distinguish it from accel_scale_quadratic.
    ("accel_scale_asymmetry", [2.8e-4, -2.8e-4, 1.4e-4], {}),
]


@pytest.mark.parametrize(("name", "values", "arguments"), AMBIGUOUS)
def test_the_advised_motion_decides(name, values, arguments, command, tmp_path):
    run, control = pair(effects={name: values}, **arguments)
    for recording, file in ((run, "run"), (control, "control")):
        imucal.write(recording, tmp_path / f"{file}.csv")
    program = tmp_path / "next.json"
    done = command(
        "gap",
        tmp_path / "run.csv",
        "--control",
        tmp_path / "control.csv",
        "--next",
        program,
        "--json",
        tmp_path / "gap.json",
    )
    assert done.returncode == 0, done.stderr
    found = json.loads((tmp_path / "gap.json").read_text())
    assert found["verdict"] == "ambiguous"
    assert name in [found["effects"][0]["name"], *found["ambiguous_with"]]
    advice = found["next_motion"]
    assert advice["chi2_predicted"] > 30 > advice["chi2_now"]
    numbers = "typical" if values == "typical" else ",".join(map(str, values))
    further = tmp_path / "next.csv"
    options = (
        "--effect",
        f"{name}={numbers}",
        "--rate-hz",
        RATE_HZ,
        "--seed",
        NEXT_SEED,
        *advice["simulate"],
    )
    made = command("simulate", program, *options, "-o", further)
    assert made.returncode == 0, made.stderr
    both = [run, dataclasses.replace(imucal.read(further), stand_rad=None)]
    gap = imucal.find_gap(both, control=control)
    assert (gap.verdict, [effect["name"] for effect in gap.effects]) == ("named", [name])


def test_a_motion_is_advised_whatever_holes_the_temperature_has():
    def run(seed):
        recording = simulated(seed, effects={"accel_bias_drift": [4e-5, 3e-5, -3e-5]}).recording
        degc = 20.0 + 0.01 * recording.time_s
        degc[::50] = np.nan
        return dataclasses.replace(recording, temperature_degc=degc)

    gap = imucal.find_gap(run(RUN_SEED), control=run(CONTROL_SEED))
    assert gap.verdict == "ambiguous", gap.summary()
    assert gap.next_motion is not None


def test_no_program_is_written_where_nothing_has_to_be_decided(command, tmp_path):
    run, _ = pair()
    imucal.write(run, tmp_path / "run.csv")
    done = command("gap", tmp_path / "run.csv", "--next", tmp_path / "next.json")
    assert "is not written" in done.stdout
    assert not (tmp_path / "next.json").exists()


def test_the_demo_hides_an_effect_finds_and_reveals_it(command, tmp_path):
    done = command("demo", "gap", "--seed", 7, "-o", tmp_path / "d")
    assert done.returncode == 0, done.stderr
    truth = json.loads((tmp_path / "d/truth.json").read_text())
    name = truth["effects"][0]["name"]
    *_, revealed, by_hand = done.stdout.splitlines()
    assert revealed.startswith(f"the truth: {name}, ")
    assert ": found, all parameters within" in revealed
    assert f"{name} (largest parameter " in done.stdout.split("the truth")[0]
    again = command(
        *by_hand.partition("imucal ")[2].replace("improved.json", str(tmp_path / "i.json")).split()
    )
    assert f"{name} (largest parameter " in again.stdout


def test_stages_are_told():
    run, _ = pair(effects={"gyro_g_sensitivity": "typical"})
    stages = []
    imucal.find_gap(run, stage=stages.append)
    assert stages[0] == "fitting without effects"
    assert any(stage.startswith("scoring ") for stage in stages)
    assert "fitting with gyro_g_sensitivity" in stages


def test_nothing_is_complete_that_the_control_run_contradicts():
    run, control = pair()
    other = simulated(CONTROL_SEED, unit="random:bmi088:3").recording
    gap = imucal.find_gap(run, control=other, candidates=["accel_lever_arm"])
    assert gap.verdict == "unknown"
    assert "another unit's, or the recording is in wrong units" in gap.summary().splitlines()[1]
    assert gap.summary().count("another unit's") == 1
    in_degrees = dataclasses.replace(control, angular_rate=np.degrees(control.angular_rate) / 10)
    assert imucal.find_gap(run, control=in_degrees, candidates=["accel_lever_arm"]).verdict == "unknown"


def test_an_effect_that_a_strange_control_run_does_not_confirm_is_not_named():
    run = simulated(RUN_SEED, effects={"gyro_g_sensitivity": "typical"}).recording
    other = simulated(CONTROL_SEED, unit="random:bmi088:3").recording
    gap = imucal.find_gap(run, control=other, candidates=["gyro_g_sensitivity"])
    assert (gap.verdict, gap.effects) == ("unknown", ())
    assert any("gyro_g_sensitivity was selected but rejected" in note for note in gap.notes)


def test_what_helps_a_control_run_that_does_not_fit_stays_named_and_it_is_said():
    values = [1e-3, -6e-4, 2e-4, 0.0, 1.5e-3, -3e-4, 4e-4, 0.0, -8e-4]
    run, control = pair(effects={"gyro_g_sensitivity": values})
    control = dataclasses.replace(control, specific_force=1.0012 * control.specific_force)
    gap = imucal.find_gap(run, control=control, candidates=["gyro_g_sensitivity"])
    assert gap.verdict == "named"
    assert gap.gap["after"] < 0.8 * gap.gap["before"]
    assert "control set: residuals are" in gap.summary()


def test_a_delay_beyond_the_search_is_not_nothing():
    # Twelve moves with residuals of degrees: with more moves, the search for laws takes twice as long.
    run, control = (
        simulated(
            seed, imucal.Program.random(seed=seed, moves=12), effects={"gyro_time_offset": [0.06]}
        ).recording
        for seed in (RUN_SEED, CONTROL_SEED)
    )
    assert imucal.find_gap(run, control=control).verdict == "unknown"
    assert imucal.find_gap(run).verdict == "unknown"


def test_what_a_refit_changes_of_a_given_calibration_is_not_the_effects():
    run, control = pair(effects={"gyro_g_sensitivity": "typical"})
    fresh = imucal.calibrate(run).calibration
    moved = dataclasses.replace(
        fresh,
        accelerometer=dataclasses.replace(fresh.accelerometer, bias=fresh.accelerometer.bias + 0.02),
        gyroscope=dataclasses.replace(fresh.gyroscope, bias=fresh.gyroscope.bias + 0.02),
    )
    search = {"candidates": ["gyro_g_sensitivity"], "control": control}
    plain, fits, misfits = (
        imucal.find_gap(run, calibration=given, **search) for given in (None, fresh, moved)
    )
    assert plain.gap["refitted"] is None
    assert misfits.gap["before"] > 20 * misfits.gap["refitted"]
    assert misfits.gap["refitted"] == pytest.approx(plain.gap["before"])
    # The finding is the effect's alone.
    assert misfits.summary().splitlines()[1] == plain.summary().splitlines()[1]
    words = "the given calibration does not fit the control recordings"
    assert words in misfits.summary()
    assert words not in fits.summary()
    without_control = imucal.find_gap(run, calibration=moved, candidates=["gyro_g_sensitivity"])
    assert "the given calibration does not fit these recordings" in without_control.summary()


def test_a_given_calibration_in_another_frame_makes_no_difference():
    run, control = pair(effects={"gyro_g_sensitivity": "typical"})
    symmetric = imucal.calibrate(run).calibration
    triangular = imucal.calibrate(run, frame="triangular").calibration
    search = {"candidates": ["gyro_g_sensitivity"], "control": control}
    found = [imucal.find_gap(run, calibration=given, **search) for given in (symmetric, triangular)]
    assert (found[0].verdict, found[1].verdict) == ("named", "named")
    assert found[1].gap["before"] == pytest.approx(found[0].gap["before"], rel=1e-6)
    nonlinear = dataclasses.replace(
        triangular,
        effects=(imucal.EffectValues("gyro_scale_cubic", [1e-3, 2e-3, 3e-3]),),
        covariance=None,
        covariance_names=(),
    )
    with pytest.raises(imucal.InputError, match="gyro_scale_cubic is defined along the axes"):
        imucal.find_gap(run, control=control, calibration=nonlinear)


def test_a_given_calibration_of_other_units_is_refused():
    run, control = pair()
    in_counts = dataclasses.replace(imucal.calibrate(run).calibration, gyro_unit="lsb")
    with pytest.raises(imucal.InputError, match="the calibration expects lsb"):
        imucal.find_gap(run, control=control, calibration=in_counts)


def test_an_effect_of_ones_own_is_explained_and_may_be_looked_for_alone():
    per_axis = tuple(imucal.EffectParameter(axis, "rad/s/(m/s^2)", 1e-4) for axis in "xyz")
    own = imucal.UserEffect(
        "own", "gyroscope", per_axis, lambda state: state.specific_force[:, :, None] * np.eye(3)
    )
    run, _ = pair()
    gap = imucal.find_gap(run, candidates=["own"], user_effects=[own])
    assert set(gap.smallest_visible) == {"own"}
    assert "own is not present above its detection limit" in gap.summary()
    explained = gap.explain("own")
    assert explained[0] == "own (gyroscope): a user-defined effect, typical size 0.056 deg/s per g"
    assert any("detection limit in these recordings" in line for line in explained)
    with pytest.raises(imucal.InputError, match="there is no effect 'owm'"):
        imucal.find_gap(run, candidates=["owm"], user_effects=[own])


@pytest.mark.parametrize(
    ("candidates", "message"), [([], "candidates is empty"), ("accel_lever_arm", "is the string")]
)
def test_candidates_are_a_list_of_names(candidates, message):
    with pytest.raises(imucal.InputError, match=message):
        imucal.find_gap([], candidates=candidates)


def test_what_was_asked_for_and_cannot_be_seen_is_said():
    gap = imucal.find_gap(pair()[0], candidates=["gyro_bias_temperature"])
    shown = gap.summary()
    assert "none of the tested effects is observable in these recordings" in shown
    assert (
        "gyro_bias_temperature was requested but is not observable in these recordings: it needs a temp_"
        in shown
    )


def test_the_name_to_explain_is_checked_before_the_search(command):
    done = command("gap", "not-read.csv", "--explain", "gyro_g_sensitivty")
    assert done.returncode == 1
    assert "is it gyro_g_sensitivity" in done.stderr
