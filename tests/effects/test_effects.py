"""Effects through Python: the catalogue, one's own, and that a correction takes away what a sensor added.

Fields of effects are evaluated through `imucal._core`, because the public API evaluates them only as part of
a correction.
"""

import dataclasses

import numpy as np
import pytest

import imucal
import imucal._core as _core
from imucal import effects
from imucal.effects.disturbance import disturbances
from imucal.effects.table import has_parameter

# Sampling of the true motion, and a unit in counts with axes that are far from perfect.
RATE_HZ = 1000.0
TIME_S = 50.0 + np.arange(2000) / RATE_HZ
ELAPSED_S = TIME_S - TIME_S[0]
TEMPERATURE_DEGC = 25 + 15 * np.sin(ELAPSED_S)
FORCE = np.column_stack(
    [4 + 5 * np.sin(2 * ELAPSED_S), 6 * np.cos(3 * ELAPSED_S), -5 + 4 * np.sin(ELAPSED_S + 1)]
)
SUPPLY_V = 3.3 + 0.2 * np.cos(5 * ELAPSED_S)
ACCELEROMETER = imucal.Triad(np.array([[410, 3, -2], [1, 405, 4], [-3, 2, 415.0]]), [33100, 33200, 32300])
GYROSCOPE = imucal.Triad(
    np.array([[4770, 90, -60], [-80, 4800, -30], [85, 35, 4750.0]]), [32777, 32459, 32511]
)


def steady_turn():
    """A rate that grows evenly in time: its differences are its derivative."""
    acceleration = np.array([2.0, -1.5, 1.0])
    return np.array([-2.0, 1.5, 0.5]) + ELAPSED_S[:, None] * acceleration, np.tile(
        acceleration, (len(TIME_S), 1)
    )


def swinging_turn(delay_s=0.0):
    """A rate of sines: amplitude rad/s, angular frequency rad/s; its differences are a little wrong."""
    amplitude, frequency = np.array([2.0, 1.5, 1.0]), np.array([3.0, 4.0, 5.0])
    phase = (ELAPSED_S[:, None] - delay_s) * frequency
    return amplitude * np.sin(phase), amplitude * frequency * np.cos(phase)


def true_state(turn=steady_turn):
    rate, acceleration = turn()
    return imucal.State(
        rate,
        FORCE,
        ELAPSED_S,
        angular_acceleration=acceleration,
        temperature_degc=TEMPERATURE_DEGC,
        auxiliary={"supply_v": SUPPLY_V},
    )


def typical(effect, size=1.0):
    """The effect with all its parameters at `size` times their typical size, in both signs."""
    signs = np.where(np.arange(len(effect.parameters)) % 3 == 1, -1.0, 1.0)
    values = size * signs * [parameter.typical for parameter in effect.parameters]
    return imucal.EffectValues(effect.name, values, effect.shape and effect.shape.typical / 50)


def unit(*values, user_effects=()):
    return imucal.Calibration(
        ACCELEROMETER,
        GYROSCOPE,
        accel_unit="lsb",
        gyro_unit="lsb",
        effects=values,
        user_effects=user_effects,
    )


def measured(calibration, state):
    """What the unit records in this state: T (true + field theta) + bias."""
    seen = {"gyroscope": state.angular_rate.copy(), "accelerometer": state.specific_force.copy()}
    for values in calibration.effects:
        effect = calibration.definition(values)
        field = (
            effect.columns(state)
            if isinstance(effect, imucal.UserEffect)
            else _core.effect_field(values.name, values.shape, state)
        )
        seen[effect.sensor] += field[:, :, : len(values.values)] @ values.values
    return imucal.Recording(
        TIME_S,
        seen["accelerometer"] @ ACCELEROMETER.sensitivity.T + ACCELEROMETER.bias,
        seen["gyroscope"] @ GYROSCOPE.sensitivity.T + GYROSCOPE.bias,
        temperature_degc=TEMPERATURE_DEGC,
        auxiliary={"supply_v": SUPPLY_V},
        accel_unit="lsb",
        gyro_unit="lsb",
        name="run",
    )


def error(corrected, state):
    """The largest error of a corrected recording in rate and in force."""
    return (
        np.abs(corrected.angular_rate - state.angular_rate).max(),
        np.abs(corrected.specific_force - state.specific_force).max(),
    )


CORRECTED = [
    effect for effect in effects.catalogue() if effect.sensor != "encoder" and "attitude" not in effect.needs
]
# A delay is exact only for a rate of another instant, so it has its own test.
BY_DERIVATIVE = [
    effect
    for effect in CORRECTED
    if "angular_acceleration" in effect.needs and effect.name != "gyro_time_offset"
]
name_of = pytest.mark.parametrize("effect", CORRECTED, ids=lambda effect: effect.name)


# --- the catalogue


def test_the_catalogue_is_the_one_of_the_library():
    rows = effects.catalogue()
    assert len(rows) >= 25
    assert len({row.name for row in rows}) == len(rows)
    row = effects.find("gyro_bias_temperature")
    assert (row.sensor, row.plain, len(row.parameters), row.needs) == ("gyroscope", 3, 9, ("temperature",))
    assert row.parameters[0] == imucal.EffectParameter("x", "rad/s/K", np.radians(0.015))
    assert row.aliases[0].name == "gyro_bias_drift"
    assert effects.find("accel_bias_warmup").shape == imucal.EffectParameter("tau", "s", 100.0)


def test_a_name_that_is_nearly_right_is_guessed():
    with pytest.raises(imucal.InputError, match="no effect 'gyro_g_sens': is it gyro_g_sensitivity"):
        effects.find("gyro_g_sens")
    with pytest.raises(imucal.InputError, match="no effect 'xyz': `imucal effects` lists them"):
        effects.find("xyz")
    with pytest.raises(imucal.InputError, match="gyro_saturation is a fault: it has no parameter"):
        effects.find("gyro_saturation")


def test_a_parameter_belongs_to_the_effect_whose_name_it_has():
    assert has_parameter("gyro_bias_temperature", "gyro_bias_temperature_x_square")
    assert has_parameter("gyro_bias_warmup", "gyro_bias_warmup_tau")
    # The name of an effect, and of a user-defined one, may be the start of another name.
    assert not has_parameter("gyro_bias_temperature", "gyro_bias_temperature_board_x")
    assert has_parameter("gyro_bias_temperature_board", "gyro_bias_temperature_board_x")


def test_disturbances_have_names_of_their_own():
    names = [row.name for row in disturbances()]
    assert len(set(names)) == len(names) == 10
    assert not {row.name for row in effects.catalogue()} & set(names)
    for row in disturbances():
        assert row.parameters and all(p.typical > 0 for p in row.parameters), row.name


def test_fields_are_those_of_the_formulas():
    state = true_state()
    field = _core.effect_field("gyro_g_sensitivity", None, state)
    assert field.shape == (len(TIME_S), 3, 9)
    matrix = np.arange(9.0).reshape(3, 3)
    np.testing.assert_allclose(field @ matrix.ravel(), FORCE @ matrix.T, rtol=1e-14, atol=1e-14)
    warmup = _core.effect_field("gyro_bias_warmup", 0.7, state)
    np.testing.assert_allclose(warmup, np.exp(-ELAPSED_S / 0.7)[:, None, None] * np.eye(3), rtol=1e-14)
    scale = _core.effect_field("accel_scale_temperature", None, state) @ np.arange(1.0, 10.0)
    d = (TEMPERATURE_DEGC - 25)[:, None]
    polynomial = d * [1, 2, 3] + d**2 * [4, 5, 6] + d**3 * [7, 8, 9]
    np.testing.assert_allclose(scale, polynomial * FORCE, rtol=1e-13, atol=1e-12)


def test_the_attitude_takes_the_world_to_the_body():
    # A quarter turn about z: the body's x axis points along the world's y axis.
    state = imucal.State(
        np.zeros((1, 3)), np.zeros((1, 3)), [0.0], rotation_wxyz=[[np.sqrt(0.5), 0, 0, np.sqrt(0.5)]]
    )
    field = _core.effect_field("earth_rate", None, state)[0]
    np.testing.assert_allclose(field @ [0, 1, 0], [1, 0, 0], atol=1e-15)
    assert not _core.effect_field("earth_rate", None, true_state()).any()


def test_what_encoders_read_wrong_depends_on_the_stand():
    state = imucal.State(
        np.zeros((1, 3)),
        np.zeros((1, 3)),
        [0.0],
        stand_rad=[[0.5, 1.0, 2.0]],
        stand_rate_radps=[[0.1, 0.0, -0.2]],
        stand_direction=[[1, 0, -1]],
    )
    eccentricity = _core.effect_field("encoder_eccentricity", None, state)[0] @ np.arange(1.0, 13.0)
    angle = np.array([0.5, 1.0, 2.0])
    once = [1, 3, 5] * np.sin(angle) + [2, 4, 6] * np.cos(angle)
    twice = [7, 9, 11] * np.sin(2 * angle) + [8, 10, 12] * np.cos(2 * angle)
    np.testing.assert_allclose(eccentricity, once + twice, rtol=1e-14)
    np.testing.assert_allclose(
        _core.effect_field("encoder_time_offset", None, state)[0] @ [2.0], [0.2, 0, -0.4], atol=1e-15
    )
    np.testing.assert_array_equal(
        _core.effect_field("encoder_backlash", None, state)[0] @ [1, 2, 3.0], [1, 0, -3]
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("gyro_x", None), '\'?"?gyro_x"? is not in the catalogue'),
        (("gyro_bias_warmup", None), "gyro_bias_warmup needs its tau, a positive number"),
        (("gyro_bias_drift", 1.0), "gyro_bias_drift has no shape"),
    ],
)
def test_wrong_fields_are_refused(arguments, message):
    with pytest.raises(imucal.InputError, match=message):
        _core.effect_field(*arguments, true_state())


def test_a_state_has_one_row_for_each_sample():
    with pytest.raises(imucal.InputError, match="angular_rate has 2 rows but 3 are needed"):
        imucal.State(np.zeros((2, 3)), np.zeros((3, 3)), np.zeros(3))
    with pytest.raises(imucal.InputError, match=r"auxiliary\['v'\] has 4 rows"):
        imucal.State(np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3), auxiliary={"v": np.zeros(4)})


# --- taken away


@name_of
@pytest.mark.parametrize("size", [0.3, 3.0])
def test_what_an_effect_adds_is_taken_away(effect, size):
    state = true_state()
    calibration = unit(typical(effect, size))
    recording = measured(calibration, state)
    plain = error(unit().apply_recording(recording), state)
    assert max(plain) > 1e-7, "the effect must be there to be taken away"
    corrected = calibration.apply_recording(recording)
    assert max(error(corrected, state)) < 1e-9
    assert (corrected.accel_unit, corrected.gyro_unit, corrected.name) == ("m/s^2", "rad/s", "run")
    np.testing.assert_array_equal(corrected.auxiliary["supply_v"], SUPPLY_V)


@pytest.mark.parametrize("effect", BY_DERIVATIVE, ids=lambda effect: effect.name)
def test_what_a_changing_acceleration_adds_is_taken_away_but_for_the_differences(effect):
    # Two errors of the derivative are left. Differences over 2 ms miss h^4 / 30 times the fifth derivative,
    # h^4 / 5 at both ends. And an error of the gyroscope that is proportional to the acceleration leaves its
    # square times the third.
    state = true_state(swinging_turn)
    calibration = unit(typical(effect))
    third, fifth = (2.0 * 3.0**n + 1.5 * 4.0**n + 5.0**n for n in (3, 5))
    size = np.abs(calibration.effects[0].values).sum()
    delay_s = size if effect.sensor == "gyroscope" else 0.0
    recording = measured(calibration, state)
    left = max(error(calibration.apply_recording(recording), state))
    assert left < 1.1 * size * (fifth / 5 * 0.002**4 + delay_s**2 * third)
    assert left < 1e-3 * max(error(unit().apply_recording(recording), state))


@pytest.mark.parametrize("delay_s", [2e-3, -10e-3, 25e-3])
def test_a_delay_is_taken_away_but_for_a_sixth_of_its_cube(delay_s):
    state = true_state(swinging_turn)
    delayed = dataclasses.replace(state, angular_rate=swinging_turn(delay_s)[0])
    recording = measured(unit(), delayed)
    calibration = unit(imucal.EffectValues("gyro_time_offset", [delay_s]))
    third, fifth = (2.0 * 3.0**n + 1.5 * 4.0**n + 5.0**n for n in (3, 5))
    left = max(error(calibration.apply_recording(recording), state))
    # The second term is the error of differences over 2 ms.
    assert left < 1.1 * (abs(delay_s) ** 3 / 6 * third + abs(delay_s) * fifth / 5 * 0.002**4)
    assert left < 0.01 * max(error(unit().apply_recording(recording), state))


def test_effects_of_all_kinds_are_taken_away_together():
    names = ["gyro_g_sensitivity", "gyro_scale_cubic", "gyro_bias_temperature", "accel_bias_warmup"]
    names += ["accel_scale_quadratic", "accel_lever_arm", "gyro_scale_drift"]
    calibration = unit(*(typical(effects.find(name)) for name in names))
    state = true_state()
    corrected = calibration.apply_recording(measured(calibration, state))
    assert max(error(corrected, state)) < 1e-9


def test_apply_takes_away_what_depends_on_rate_and_force_alone():
    state = true_state()
    calibration = unit(
        typical(effects.find("gyro_g_sensitivity")), typical(effects.find("accel_scale_cubic"))
    )
    recording = measured(calibration, state)
    rate, force = calibration.apply(recording.angular_rate, recording.specific_force)
    np.testing.assert_allclose(rate, state.angular_rate, atol=1e-9)
    np.testing.assert_allclose(force, state.specific_force, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("gyro_bias_drift", "depends on time: use apply_recording, .* has time_s"),
        ("accel_bias_temperature", "depends on temperature: use apply_recording, .* has temperature_degc"),
        ("accel_lever_arm", "depends on angular acceleration: use apply_recording, .* has time_s"),
    ],
)
def test_apply_says_which_column_is_needed(name, message):
    with pytest.raises(imucal.InputError, match=message):
        unit(typical(effects.find(name))).apply(FORCE, FORCE)


def test_a_recording_without_the_column_is_refused():
    calibration = unit(typical(effects.find("gyro_scale_temperature")))
    recording = dataclasses.replace(measured(calibration, true_state()), temperature_degc=None)
    with pytest.raises(
        imucal.InputError, match=r"run has no temperature_degc \(temp_degc in a file\) and gyro_sc"
    ):
        calibration.apply_recording(recording)
    calibration = unit(typical(effects.find("gyro_time_offset")))
    recording = measured(calibration, true_state())
    with pytest.raises(imucal.InputError, match="run has one sample and gyro_time_offset depends on angular"):
        calibration.apply_recording(recording.between(50.0, 50.0005))
    time_s = TIME_S.copy()
    time_s[7] = time_s[6] - 1e-4
    with pytest.raises(imucal.InputError, match="time_s decreases from sample 6 to 7"):
        calibration.apply_recording(dataclasses.replace(recording, time_s=time_s))


def test_the_earths_rate_stays_in_the_data_and_is_named():
    calibration = unit(typical(effects.find("earth_rate")), typical(effects.find("gyro_g_sensitivity")))
    recording = measured(calibration, true_state())
    assert calibration.left_in_data == ("earth_rate",)
    without_earth = unit(typical(effects.find("gyro_g_sensitivity")))
    assert without_earth.left_in_data == ()
    np.testing.assert_array_equal(
        calibration.apply_recording(recording).angular_rate,
        without_earth.apply_recording(recording).angular_rate,
    )
    calibration.apply(recording.angular_rate, recording.specific_force)


def test_what_cannot_be_undone_is_not_a_number():
    calibration = unit(imucal.EffectValues("gyro_scale_cubic", [1.0, 1.0, 1.0]))
    state = true_state()
    slow = (np.abs(state.angular_rate) < 0.2).all(axis=1)
    corrected = calibration.apply_recording(measured(calibration, state))
    fast = (np.abs(state.angular_rate) > 1.2).any(axis=1)
    assert fast.any() and np.isnan(corrected.angular_rate[fast]).all()
    assert np.allclose(corrected.angular_rate[slow], state.angular_rate[slow], atol=1e-9)


# --- one's own


def supply_field(state):
    return (state.auxiliary["supply_v"] - 3.3)[:, None, None] * np.eye(3)


PER_VOLT = tuple(imucal.EffectParameter(axis, "rad/s/V", 1e-3) for axis in "xyz")
SUPPLY = imucal.UserEffect("gyro_bias_supply", "gyroscope", PER_VOLT, supply_field)
# An accelerometer that feels the rate, and its own force: this one needs several passes.
RUB = imucal.UserEffect(
    "accel_rub",
    "accelerometer",
    (imucal.EffectParameter("c", "s", 1e-3), imucal.EffectParameter("k", "1", 1e-3)),
    lambda state: np.stack([np.abs(state.angular_rate), np.tanh(state.specific_force)], axis=2),
)


def test_a_users_effects_are_taken_away_beside_those_of_the_catalogue():
    calibration = unit(
        imucal.EffectValues("gyro_bias_supply", [0.01, -0.02, 0.03]),
        typical(effects.find("gyro_g_sensitivity")),
        typical(effects.find("accel_lever_arm")),
        imucal.EffectValues("accel_rub", [0.02, 0.05]),
        user_effects=[SUPPLY, RUB],
    )
    state = true_state()
    recording = measured(calibration, state)
    corrected = calibration.apply_recording(recording)
    assert error(corrected, state)[0] < 1e-9
    # The lever arm takes the derivative of a rate without the user's effects, whose 0.03 rad/s^2 would leave
    # 1e-3, but with the g-sensitivity: 0.06 m times 1.8e-4 times the 32 m/s^3 by which the force changes.
    assert error(corrected, state)[1] < 3.5e-4
    without_lever_arm = dataclasses.replace(
        calibration, effects=(*calibration.effects[:2], calibration.effects[3])
    )
    assert max(error(without_lever_arm.apply_recording(measured(without_lever_arm, state)), state)) < 1e-9


def test_a_users_effect_adds_its_field_times_its_values():
    values = imucal.EffectValues("gyro_bias_supply", [1.0, 2.0, 3.0])
    added = SUPPLY.at(true_state(), values)
    np.testing.assert_allclose(added, (SUPPLY_V - 3.3)[:, None] * [1, 2, 3], atol=1e-15)
    with pytest.raises(imucal.InputError, match="gyro_bias_supply has 3 parameters: 2 were given"):
        SUPPLY.at(true_state(), imucal.EffectValues("gyro_bias_supply", [1.0, 2.0]))


def test_missing_samples_stay_missing():
    calibration = unit(imucal.EffectValues("accel_rub", [0.02, 0.05]), user_effects=[RUB])
    state = true_state()
    recording = measured(calibration, state)
    force = recording.specific_force.copy()
    force[5] = np.nan
    corrected = calibration.apply_recording(dataclasses.replace(recording, specific_force=force))
    assert np.isnan(corrected.specific_force[5]).all()
    keep = np.arange(len(TIME_S)) != 5
    np.testing.assert_allclose(corrected.specific_force[keep], FORCE[keep], atol=1e-9)


@pytest.mark.parametrize(
    ("field", "message"),
    [
        (
            lambda state: np.zeros((3, 2)),
            r"field of own has the shape \(3, 2\), but \(2000, 3, 1\) is needed",
        ),
        (lambda state: np.full((2000, 3, 1), np.nan), "field of own is not finite at 2000 samples, first at"),
        (lambda state: state.auxiliary["vdd"], r"field of own needs 'vdd', .* columns \['supply_v'\]"),
        (lambda state: "text", "field of own cannot be evaluated"),
        (
            lambda state: 3 * state.angular_rate[:, :, None],
            "own cannot be corrected: at sample 0 the correction has not converged",
        ),
        (None, r"definition of the effect own is not in the file: pass it as user_effects=\[...\]"),
    ],
)
def test_a_field_that_cannot_be_used_is_named(field, message):
    own = imucal.UserEffect("own", "gyroscope", (imucal.EffectParameter("k", "1", 1.0),), field)
    calibration = unit(imucal.EffectValues("own", [1.0]), user_effects=[own])
    recording = measured(unit(), true_state())
    with pytest.raises(imucal.InputError, match=message):
        calibration.apply_recording(recording)
    with pytest.raises(
        imucal.InputError, match="own is a user-defined effect, whose function needs whole columns"
    ):
        calibration.apply(recording.angular_rate, recording.specific_force)


def test_what_is_no_effect_of_ones_own_is_named():
    own = imucal.UserEffect("own", "gyroscope", (imucal.EffectParameter("k", "1", 1.0),), None)
    recording = measured(unit(), true_state())
    with pytest.raises(imucal.InputError, match=r"'own' is no effect of your own: give a list of imucal\."):
        imucal.find_gap(recording, user_effects=["own"])
    with pytest.raises(imucal.InputError, match="the effect own is defined twice"):
        imucal.find_gap(recording, user_effects=[own, own])
    with pytest.raises(imucal.InputError, match="1 is no effect: give names of the catalogue, formulas, or"):
        imucal.calibrate(recording, effects=[1])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"name": "gyro_g_sensitivity"}, "the catalogue has an effect gyro_g_sensitivity already"),
        ({"name": "mount_slip"}, "the catalogue has an effect mount_slip already"),
        ({"name": "my effect"}, "'my effect' is not a valid name of an effect"),
        ({"sensor": "magnetometer"}, "sensor of own is 'magnetometer': give one of accelerometer, gyroscope"),
        ({"parameters": ()}, r"own has the parameters \[\]"),
        ({"parameters": PER_VOLT[:1] * 2}, r"own has the parameters \['x', 'x'\]"),
    ],
)
def test_a_users_effect_that_cannot_be_one_is_refused(changes, message):
    fields = {"name": "own", "sensor": "gyroscope", "parameters": PER_VOLT, "field": supply_field}
    with pytest.raises(imucal.InputError, match=message):
        imucal.UserEffect(**{**fields, **changes})


@pytest.mark.parametrize("typical_size", [0.0, -1.0, np.nan, np.inf])
def test_a_typical_size_is_positive(typical_size):
    with pytest.raises(imucal.InputError, match="typical size of parameter 'x' is"):
        imucal.EffectParameter("x", "1", typical_size)


@pytest.mark.parametrize(
    ("values", "shape", "message"),
    [
        ([1.0, np.inf], None, "values of own contain inf"),
        ([[1.0]], None, r"values of own has the shape \(1, 1\)"),
        ([1.0], 0.0, "shape of own is 0.0"),
        ([1.0], np.nan, "shape of own is nan"),
    ],
)
def test_numbers_that_cannot_be_an_effects_are_refused(values, shape, message):
    with pytest.raises(imucal.InputError, match=message):
        imucal.EffectValues("own", values, shape)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ([("gyro_x", [1.0], None)], "no effect 'gyro_x'"),
        ([("gyro_bias_drift", [1.0], None)], "gyro_bias_drift has 3 parameters: 1 were given"),
        ([("gyro_bias_temperature", [1.0], None)], "has 3, 6 or 9 parameters: 1 were given"),
        ([("gyro_bias_warmup", [1.0, 1, 1], None)], "gyro_bias_warmup needs its shape tau, s"),
        ([("gyro_bias_drift", [1.0, 1, 1], 2.0)], "gyro_bias_drift has no shape: 2.0 was given"),
        ([("gyro_bias_drift", [1.0, 1, 1], None)] * 2, "an effect occurs twice"),
        ([("gyro_bias", [1.0, 1, 1], None)], "two parameters have the name gyro_bias_x"),
    ],
)
def test_a_calibration_takes_effects_that_fit(values, message):
    own = imucal.UserEffect("gyro_bias", "gyroscope", PER_VOLT, supply_field)
    with pytest.raises(imucal.InputError, match=message):
        unit(*(imucal.EffectValues(*each) for each in values), user_effects=[own])


def test_a_calibration_carries_no_more_effects_than_the_library():
    many = [typical(effect) for effect in effects.catalogue() if effect.sensor != "encoder"]
    most = _core.MAX_EFFECTS
    own = imucal.EffectValues("gyro_bias_supply", [0.01, -0.02, 0.03])
    calibration = unit(*many[:most], own, user_effects=(SUPPLY,))
    message = f"a calibration can have at most {most} effects"
    with pytest.raises(imucal.InputError, match=f"{message}, but {most + 1} were given"):
        unit(*many[: most + 1])
    # The library takes as many, and refuses the next one.
    row = np.ones((1, 3))
    recording = imucal.Recording([0.0, 1.0], np.ones((2, 3)), np.ones((2, 3)), temperature_degc=[25.0, 26.0])
    _core.correct_recording(calibration.without_user_effects(), recording, None)
    object.__setattr__(calibration, "effects", tuple(many[: most + 1]))
    with pytest.raises(imucal.InputError, match=message):
        _core.correct(calibration, row, row)


def test_a_library_function_knows_the_catalogue_alone():
    calibration = unit(
        typical(effects.find("gyro_g_sensitivity")),
        imucal.EffectValues("gyro_bias_supply", [0.01, -0.02, 0.03]),
        user_effects=[SUPPLY],
    )
    plain = calibration.without_user_effects()
    assert [values.name for values in plain.effects] == ["gyro_g_sensitivity"]
    assert plain.user_effects == ()
    with pytest.raises(imucal.InputError, match='"gyro_bias_supply" is not in the catalogue'):
        _core.correct(calibration, FORCE, FORCE)
