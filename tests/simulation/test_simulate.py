"""The simulation as people use it: motions, effects, faults, places, temperatures, by API and by command.

Fields of effects, the reference temperature and the number of threads are taken from `imucal._core` and
`imucal.simulation.setup`, because the public API neither evaluates a field nor sets threads.
"""

import dataclasses
import json
import math

import numpy as np
import pytest

import imucal
import imucal._core as _core
from imucal.cli import main
from imucal.document.json_document import write_json
from imucal.effects import catalogue
from imucal.effects.disturbance import disturbances
from imucal.rig.temperature import REFERENCE_DEGC
from imucal.simulation.setup import DISTURB

G = 9.80665
DEG = math.pi / 180
PROGRAM = imucal.Program.random(seed=3, moves=6, hold_s=1.0)
EFFECTS = [effect.name for effect in catalogue()]
DISTURBANCES = [row.name for row in disturbances()]
WARM = "warmup:20:45:30"


def simulate(motion=PROGRAM, **options):
    options = {"unit": "ideal", "rate_hz": 100, "seed": 5, **options}
    return imucal.simulate(motion, **options)


# --- effects --------------------------------------------------------------------------------------


# A delay is the rate of another instant, which a state does not contain.
STATES = [e for e in catalogue() if e.sensor != "encoder" and e.name != "gyro_time_offset"]


@pytest.mark.parametrize("effect", STATES, ids=lambda e: e.name)
def test_an_effect_adds_its_field_to_the_truth(effect):
    """The field comes from the catalogue by another way: at the true state, a column for each parameter."""
    values = np.array([(-1) ** i * p.typical for i, p in enumerate(effect.parameters)])
    shape = None if effect.shape is None else 20.0
    given = {"values": values, "shape": shape}
    run = simulate(effects={effect.name: given}, temperature=WARM)
    truth = run.truth
    state = imucal.State(
        truth.angular_rate,
        truth.specific_force,
        truth.time_s,
        truth.angular_acceleration,
        truth.temperature_degc,
        {},
        truth.rotation_wxyz,
    )
    added = _core.effect_field(effect.name, shape, state)[:, :, : len(values)] @ values
    assert np.abs(added).max() > 0
    measured, true = (
        (run.recording.specific_force, truth.specific_force)
        if effect.sensor == "accelerometer"
        else (run.recording.angular_rate, truth.angular_rate)
    )
    np.testing.assert_allclose(measured - true, added, rtol=1e-9, atol=1e-13 * np.abs(true).max() + 1e-15)
    names = [p.name for p in truth.calibration.parameters[21:]]
    assert names[: len(values)] == [f"{effect.name}_{p.name}" for p in effect.parameters]


@pytest.mark.parametrize("samples", [1, 7, -3])
def test_a_delay_is_the_rate_of_another_instant(samples):
    run = simulate(effects={"gyro_time_offset": [samples / 100]})
    rate, true = run.recording.angular_rate, run.truth.angular_rate
    # Before the start of the motion, the rate is that at the start.
    late, early = (rate[samples:], true[:-samples]) if samples > 0 else (rate[:samples], true[-samples:])
    np.testing.assert_allclose(late, early, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", [e.name for e in catalogue() if e.sensor == "encoder"])
def test_an_encoder_effect_is_in_the_encoders_alone(name):
    plain, run = simulate(), simulate(effects={name: "typical"})
    assert (run.recording.stand_rad != plain.recording.stand_rad).any()
    assert (run.recording.angular_rate == plain.recording.angular_rate).all()


@pytest.mark.parametrize("name", [*EFFECTS, *DISTURBANCES])
def test_every_name_is_taken_by_the_command_and_shows(name, tmp_path, capsys):
    options = ["--hold-s", "2", "--unit", "mpu6050", "--seed", "4", "--rate-hz", "100", "--temperature", WARM]
    for output, effect in (("plain.parquet", []), ("run.parquet", ["--effect", f"{name}=typical"])):
        arguments = ["simulate", "random", "--moves", "3", *options, *effect, "-o", str(tmp_path / output)]
        # A range of 2 g or 250 deg/s is beyond what three moves reach.
        if effect and name.endswith("_saturation"):
            arguments[arguments.index(f"{name}=typical")] = f"{name}=0.5"
        assert main(arguments) == 0, capsys.readouterr().err
    plain, run = (imucal.read(tmp_path / name) for name in ("plain.parquet", "run.parquet"))
    columns = ("time_s", "specific_force", "angular_rate", "stand_rad")
    assert any(not np.array_equal(getattr(plain, column), getattr(run, column)) for column in columns)


def test_numbers_of_an_effect_are_given_in_several_ways():
    runs = [
        simulate(effects={"gyro_bias_warmup": {"values": [0.01, 0.01, 0.01], "shape": 20.0}}),
        simulate(effects={"gyro_bias_warmup": {"values": 0.01, "shape": 20}}),
        simulate(effects=[imucal.EffectValues("gyro_bias_warmup", np.full(3, 0.01), 20.0)]),
        simulate(
            effects={"gyro_bias_warmup": imucal.EffectValues("gyro_bias_warmup", np.full(3, 0.01), 20.0)}
        ),
    ]
    for run in runs[1:]:
        assert (run.recording.angular_rate == runs[0].recording.angular_rate).all()
    bias = runs[0].recording.angular_rate - runs[0].truth.angular_rate
    np.testing.assert_allclose(bias[:, 0], 0.01 * np.exp(-runs[0].truth.time_s / 20), atol=1e-15)


def test_a_given_effect_replaces_that_of_the_unit():
    run = simulate(unit="random:mpu6050:3", effects={"gyro_g_sensitivity": 0.0, "gyro_bias_temperature": 0.0})
    effects = {effect.name: effect.values for effect in run.truth.setup.all_effects}
    assert (effects["gyro_g_sensitivity"] == 0).all()
    assert (effects["accel_bias_temperature"] != 0).all()


def test_faults_are_as_large_as_given():
    still = imucal.Static(duration_s=100.0)
    lossy = simulate(still, unit="paper", effects={"samples_missing": 0.1}).recording
    assert len(lossy) == pytest.approx(9000, abs=4 * 30)
    twice = simulate(still, unit="mpu6050", effects={"samples_duplicated": 0.1}).recording
    repeats = (np.diff(np.hstack([twice.angular_rate, twice.specific_force]), axis=0) == 0).all(axis=1).sum()
    assert repeats == pytest.approx(1000, abs=4 * 30)
    clipped = simulate(effects={"gyro_saturation": 1.0}).recording.angular_rate
    assert clipped.max() == pytest.approx(1.0, abs=1e-8)
    assert clipped.min() == -1.0
    noisy = simulate(unit="mpu6050", effects={"noise_grows_in_motion": 3.0})
    noise = noisy.recording.angular_rate - noisy.truth.angular_rate
    resting = np.zeros(len(noise), dtype=bool)
    for start_s, end_s in noisy.truth.rests:
        resting |= (noisy.truth.time_s >= start_s) & (noisy.truth.time_s <= end_s)
    assert noise[~resting].std() / noise[resting].std() == pytest.approx(3.0, rel=0.1)
    slow = simulate(clock_rate_error=0.01)
    assert slow.truth.rests[1][0] == pytest.approx(PROGRAM.steps[0].hold_s * 1.01 + 2.0 * 1.01)


def test_a_random_walk_grows_with_time():
    still = imucal.Static(duration_s=100.0)
    ends = [
        simulate(still, rate_hz=10, effects={"gyro_bias_random_walk": [1e-3, 2e-3, 0.0]}, seed=seed)
        .recording.angular_rate[-1]
        for seed in range(200)
    ]  # fmt: skip
    # K sqrt(t); 200 draws tell a standard deviation to 5 %.
    assert np.std(ends, axis=0) == pytest.approx([1e-2, 2e-2, 0.0], rel=0.2)


def test_a_filter_takes_noise_away_and_averaging_its_share():
    still = imucal.Static(duration_s=100.0)
    plain = simulate(still, unit="bmi088", effects={})
    filtered = simulate(still, unit="bmi088", filter_hz=10.0)
    averaged = simulate(still, unit="bmi088", averaging=True)
    std = [run.recording.angular_rate.std() for run in (plain, filtered, averaged)]
    assert std[1] < 0.8 * std[0]
    # The mean of white noise over an interval has the spread of a point sample of the same density.
    assert std[2] == pytest.approx(std[0], rel=0.1)
    run = simulate(still, unit="bmi088", filter_hz="datasheet", rate_hz=400)
    assert run.truth.setup.unit.gyroscope.filter_hz == 523


# --- the user's own effects -----------------------------------------------------------------------


def supply_effect():
    per_volt = tuple(imucal.EffectParameter(axis, "rad/s/V", 1e-3) for axis in "xyz")

    def field(state):
        return (state.auxiliary["supply_v"] - 3.3)[:, None, None] * np.eye(3)

    return imucal.UserEffect("gyro_bias_supply", "gyroscope", per_volt, field)


def supply_v(time_s):
    return 3.3 - 0.01 * np.sin(time_s)


def test_a_users_effect_is_added_and_its_column_recorded(tmp_path):
    options = {"user_effects": [supply_effect()], "auxiliary": {"supply_v": supply_v}}
    run = simulate(effects={"gyro_bias_supply": [0.1, 0.2, -0.3], "samples_missing": 0.05}, **options)
    rec = run.recording
    np.testing.assert_allclose(rec.auxiliary["supply_v"], supply_v(rec.time_s), atol=1e-12)
    expected = np.outer(supply_v(rec.time_s) - 3.3, [0.1, 0.2, -0.3])
    np.testing.assert_allclose(rec.angular_rate - run.truth.angular_rate, expected, atol=1e-12)
    assert (rec.specific_force == run.truth.specific_force).all()
    assert run.truth.calibration.parameters[-1].name == "gyro_bias_supply_z"

    write_json(run.truth.to_dict(), tmp_path / "truth.json")
    again = imucal.repeat(tmp_path / "truth.json", **options)
    assert (again.recording.angular_rate == rec.angular_rate).all()
    with pytest.raises(imucal.InputError, match=r"definition of the effect gyro_bias_supply .* user_effects"):
        imucal.repeat(tmp_path / "truth.json")


def test_a_users_effect_goes_through_the_sensitivity():
    options = {"user_effects": [supply_effect()], "auxiliary": {"supply_v": np.full(2000, 4.3)}}
    still = imucal.Static(duration_s=10.0)
    runs = [
        simulate(still, unit="paper", rate_hz=200, effects=e, **options)
        for e in ({}, {"gyro_bias_supply": 0.1})
    ]
    change = (runs[1].recording.angular_rate - runs[0].recording.angular_rate).mean(axis=0)
    sensitivity = runs[0].truth.calibration.gyroscope.sensitivity
    assert change == pytest.approx(sensitivity @ [0.1, 0.1, 0.1], abs=1e-4)


def test_an_auxiliary_column_needs_a_value_for_each_sample():
    with pytest.raises(imucal.InputError, match=r"supply_v.* has 3 rows but 1000 are needed"):
        simulate(imucal.Static(duration_s=10.0), auxiliary={"supply_v": [1, 2, 3]})


# --- place and temperature ------------------------------------------------------------------------


def test_latitude_gives_gravity_and_the_earths_rate():
    # Normal gravity of WGS 84 at the equator and the poles (NIMA TR8350.2, Table 3.4).
    still = imucal.Static(duration_s=1.0)
    for latitude_deg, gravity_mps2 in ((0.0, 9.7803253359), (90.0, 9.8321849378)):
        run = simulate(still, latitude_deg=latitude_deg)
        assert run.truth.setup.gravity_mps2 == pytest.approx(gravity_mps2, abs=1e-9)
        assert np.linalg.norm(run.recording.angular_rate[0]) == pytest.approx(7.292115e-5, rel=1e-7)
        assert run.truth.calibration.gravity_mps2 == run.truth.setup.gravity_mps2
    # Free air: about -0.3086 mGal/m.
    high = simulate(still, latitude_deg=45.0, height_m=1000.0).truth.setup.gravity_mps2
    low = simulate(still, latitude_deg=45.0).truth.setup.gravity_mps2
    assert high - low == pytest.approx(-3.086e-3, rel=1e-2)
    north, up = 7.292115e-5 * math.cos(60 * DEG), 7.292115e-5 * math.sin(60 * DEG)
    rate = simulate(still, latitude_deg=60.0, gravity_mps2=9.82)
    assert rate.recording.angular_rate[0] == pytest.approx([north, 0, up], abs=1e-12)
    assert rate.recording.specific_force[0] == pytest.approx([0, 0, 9.82])


def test_temperature_profiles(tmp_path):
    still = imucal.Static(duration_s=100.0)
    assert simulate(still).recording.temperature_degc is None
    # An effect that needs it has it recorded.
    assert simulate(still, effects={"gyro_bias_temperature": 1e-4}).recording.temperature_degc[0] == 25.0
    time_s = simulate(still).recording.time_s
    (tmp_path / "t.csv").write_text("time_s,temp_degc\n0,20\n50,30\n100,10\n")
    for given, expected in (
        (31, np.full_like(time_s, 31.0)),
        ("31.5", np.full_like(time_s, 31.5)),
        (imucal.Temperature.constant(31.5), np.full_like(time_s, 31.5)),
        ("warmup:20:45:30", 45 - 25 * np.exp(-time_s / 30)),
        ("cycle:10:50:80", np.interp(time_s, [0, 40, 80], [10, 50, 10])),
        (tmp_path / "t.csv", np.interp(time_s, [0, 50, 100], [20, 30, 10])),
    ):
        run = simulate(still, temperature=given)
        np.testing.assert_allclose(run.recording.temperature_degc, expected, atol=2e-3)
    assert _core.REFERENCE_TEMPERATURE_DEGC == REFERENCE_DEGC


# --- motions --------------------------------------------------------------------------------------


def test_a_tumble_rests_and_moves():
    run = simulate("tumble")
    assert len(run.truth.rests) == 40
    assert run.recording.stand_rad is None
    start_s, end_s = run.truth.rests[3]
    inside = (run.truth.time_s > start_s) & (run.truth.time_s < end_s)
    assert (run.truth.angular_rate[inside] == 0).all()
    assert np.linalg.norm(run.truth.specific_force[inside], axis=1) == pytest.approx(G)
    moved = simulate(imucal.Tumble(5, translation_mm=0.0))
    assert np.linalg.norm(moved.truth.specific_force, axis=1) == pytest.approx(G)
    trembling = simulate(imucal.Tumble(5, tremor_deg=0.1))
    assert (trembling.truth.angular_rate[inside] != 0).any()


def test_static_stays_as_it_is_put():
    half = math.sqrt(0.5)
    run = simulate(imucal.Static(10.0, (half, half, 0.0, 0.0)))
    assert len(run.recording) == 1000
    assert run.truth.rests == ((0.0, 10.0),)
    # Turned by 90 deg about x: the body's y axis points up.
    assert run.recording.specific_force[0] == pytest.approx([0, G, 0], abs=1e-12)


def test_a_stand_is_drawn_read_and_part_of_a_program(tmp_path):
    stand = imucal.Stand.cheap(4)
    assert stand.to_dict()["mount_rotation_deg"] == imucal.Stand.cheap(4).to_dict()["mount_rotation_deg"]
    stand.write(tmp_path / "stand.json")
    program = dataclasses.replace(PROGRAM, stand=stand)
    program.write(tmp_path / "program.json")
    runs = [
        simulate(PROGRAM, stand=stand),
        simulate(PROGRAM, stand="cheap:4"),
        simulate(PROGRAM, stand=tmp_path / "stand.json"),
        simulate(program),
        simulate(tmp_path / "program.json"),
    ]
    for run in runs[1:]:
        assert (run.recording.stand_rad == runs[0].recording.stand_rad).all()
        assert (run.recording.angular_rate == runs[0].recording.angular_rate).all()
    perfect = simulate(PROGRAM)
    assert (perfect.recording.stand_rad != runs[0].recording.stand_rad).any()
    assert (perfect.recording.specific_force != runs[0].recording.specific_force).any()


def test_a_rest_that_is_not_still_trembles_on_a_stand_and_in_a_hand():
    for motion in (PROGRAM, imucal.Tumble(5)):
        run = simulate(motion, effects={"rest_not_still": 2e-3})
        start_s, end_s = run.truth.rests[1]
        inside = (run.truth.time_s > start_s) & (run.truth.time_s < end_s)
        up = run.truth.specific_force[inside] / G
        assert 2e-4 < up.std(axis=0).max() < 6e-3
        assert (run.truth.angular_rate[inside] != 0).all()


def test_a_slip_turns_the_unit_and_not_the_encoders():
    plain, run = simulate(), simulate(effects={"mount_slip": 0.02})
    stand = run.truth.setup.motion.stand
    # The middle of the third turn of six: holds of 1 s, turns of 2 s.
    assert stand.slip_time_s == pytest.approx(1 + 2 * 3 + 1)
    assert (run.recording.stand_rad == plain.recording.stand_rad).all()
    angle = 2 * np.arccos(
        np.abs((run.truth.rotation_wxyz * plain.truth.rotation_wxyz).sum(axis=1)).clip(max=1)
    )
    assert angle[run.truth.time_s < stand.slip_time_s].max() < 1e-7
    assert angle[run.truth.time_s > stand.slip_time_s + 0.06] == pytest.approx(0.02)


def test_cheap_stands_scatter_as_they_say():
    stands = [imucal.Stand.cheap(seed) for seed in range(500)]
    for field, std in (("mount_rotation_deg", 1.0), ("base_tilt_deg", 0.5), ("non_orthogonality_deg", 0.5)):
        drawn = np.array([getattr(stand, field) for stand in stands])
        assert drawn.std(axis=0) == pytest.approx([std] * drawn.shape[1], rel=4 / math.sqrt(1000))
    assert {e.name for e in stands[0].encoder_effects} == {e for e in EFFECTS if e.startswith("encoder_")}
    eccentricity = np.array([stand.encoder_effects[0].values for stand in stands])
    assert eccentricity.std() == pytest.approx(0.02 * DEG, rel=0.1)


# --- the same again -------------------------------------------------------------------------------

FULL = [
    *("simulate", "random", "--moves", "5", "--unit", "random:mpu6050:2", "--stand", "cheap", "--seed", "9"),
    *("--effect", "gyro_bias_warmup=1e-3,0,0@50", "--effect", "samples_missing=0.01"),
    *("--effect", "clock_irregular=1e-5", "--latitude", "55.7", "--height", "150", "--temperature", WARM),
]


def test_the_same_command_writes_the_same_bytes_and_its_truth_repeats_it(tmp_path):
    for k in ("1", "2"):
        written = ["-o", f"{tmp_path}/{k}.csv", "--truth", f"{tmp_path}/{k}.json"]
        assert main([*FULL, *written, "--truth-samples", f"{tmp_path}/{k}.parquet"]) == 0
    names = ["csv", "json", "parquet"]
    first, second = ([(tmp_path / f"{k}.{name}").read_bytes() for name in names] for k in ("1", "2"))
    assert first == second
    again = ["-o", f"{tmp_path}/3.csv", "--truth", f"{tmp_path}/3.json"]
    assert main(["simulate", f"{tmp_path}/1.json", *again]) == 0
    assert [(tmp_path / f"3.{name}").read_bytes() for name in names[:2]] == first[:2]


def test_any_number_of_threads_gives_the_same_bytes():
    setup = simulate(unit="random:mpu6050:2", stand="cheap", temperature=WARM).truth.setup.for_core()

    class OnThreads:
        def __init__(self, threads):
            self.threads = threads

        def __getattr__(self, name):
            return getattr(setup, name)

    one, two = (_core.simulate(OnThreads(threads)) for threads in (1, 2))
    for column in ("time_s", "specific_force", "angular_rate", "stand_rad", "temperature_degc"):
        assert getattr(one, column).tobytes() == getattr(two, column).tobytes()


def test_the_truth_has_all_that_made_the_run(tmp_path):
    written = ["-o", f"{tmp_path}/run.parquet", "--truth", f"{tmp_path}/truth.json"]
    saved = ["--truth-samples", f"{tmp_path}/true.csv", "--save-unit", f"{tmp_path}/unit.json"]
    assert main([*FULL, *written, *saved]) == 0
    truth = json.loads((tmp_path / "truth.json").read_text())
    assert truth["schema"] == "imucal.truth/1"
    assert truth["gravity_mps2"] == truth["setup"]["gravity_mps2"]
    names = [effect["name"] for effect in truth["effects"]]
    assert {"earth_rate", "gyro_bias_warmup", "gyro_g_sensitivity", "encoder_backlash"} <= set(names)
    values = {p["name"]: p["value"] for p in truth["parameters"]}
    assert (values["gyro_bias_warmup_x"], values["gyro_bias_warmup_tau"]) == (1e-3, 50.0)
    assert values["earth_rate_z"] == pytest.approx(7.292115e-5 * math.sin(55.7 * DEG))
    assert len(truth["rests"]) == 6
    assert (truth["setup"]["seed"], truth["setup"]["missing_share"]) == (9, 0.01)
    unit = imucal.Unit.read(tmp_path / "unit.json")
    assert (unit.gyroscope.bias == truth["gyroscope"]["bias"]).all()

    rec, true = imucal.read(tmp_path / "run.parquet"), imucal.read(tmp_path / "true.csv")
    assert (rec.time_s == true.time_s).all()
    rotation = np.stack([true.auxiliary[f"rotation_{part}"] for part in "wxyz"], axis=1)
    assert np.linalg.norm(rotation, axis=1) == pytest.approx(1.0)
    assert "angular_acceleration_z_radps2" in true.auxiliary
    sensitivity, bias = np.array(truth["gyroscope"]["T"]), np.array(truth["gyroscope"]["bias"])
    corrected = (rec.angular_rate - bias) @ np.linalg.inv(sensitivity).T
    # What is left are noise of 0.005 deg/s/sqrt(Hz) at 200 Hz, and the effects.
    assert np.abs(corrected - true.angular_rate).max() < 0.2


def test_all_noise_and_faults_can_be_simulated():
    assert set(DISTURB) == set(DISTURBANCES)
