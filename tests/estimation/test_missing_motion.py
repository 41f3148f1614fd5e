"""Motion that does not determine every parameter: the error names what is missing, as the null space does."""

import re

import numpy as np
import pytest

import imucal

G_MPS2 = 9.80665
RATE_HZ = 100
HOLD_S, TURN_S = 2.0, 1.0
NOISE = (np.radians(0.025) * RATE_HZ**0.5, 126e-6 * G_MPS2 * RATE_HZ**0.5)  # the paper's sensors
AXES = np.eye(3)
BIASES = [f"bias {axis}" for axis in "xyz"]
SCALES = [f"scale {axis}" for axis in "xyz"]
ACCELEROMETER = [*BIASES, *SCALES, *(f"misalignment {pair}" for pair in ("xy", "xz", "yz"))]
GYROSCOPE = [f"scale {i}" if i == j else f"misalignment {i}{j}" for i in "xyz" for j in "xyz"]


def rotation(vector):
    """Rodrigues' formula, rad."""
    angle = np.linalg.norm(vector)
    if angle == 0:
        return np.eye(3)
    x, y, z = np.asarray(vector) / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def motion(turns_deg, start=AXES):
    """Rests, and between them turns about body axes, R <- R exp(turn); time, rate and force."""
    attitude, steps, held = np.array(start), int(TURN_S * RATE_HZ), int(HOLD_S * RATE_HZ)
    share = np.arange(steps) / steps
    done = share - np.sin(2 * np.pi * share) / (2 * np.pi)
    speed = (1 - np.cos(2 * np.pi * share)) / TURN_S
    rate, force = [np.zeros((held, 3))], [np.tile(attitude[2] * G_MPS2, (held, 1))]
    for turn in np.radians(turns_deg):
        rate += [speed[:, None] * turn, np.zeros((held, 3))]
        force.append(np.array([(attitude @ rotation(turn * part))[2] * G_MPS2 for part in done]))
        attitude = attitude @ rotation(turn)
        force.append(np.tile(attitude[2] * G_MPS2, (held, 1)))
    rate, force = np.concatenate(rate), np.concatenate(force)
    return np.arange(len(rate)) / RATE_HZ, rate, force


@pytest.fixture(scope="module")
def unit():
    program = imucal.Program((imucal.Step((0, 0, 0), 0, 1),))
    return imucal.simulate(program, rate_hz=10, seed=0).truth.calibration


@pytest.fixture
def recorded_motion(measured, unit):
    def record(time_s, rate, force, seed=0):
        return measured(unit, time_s, rate, force, sigma=NOISE, seed=seed, name=f"run-{seed}")

    return record


@pytest.fixture
def recorded(recorded_motion):
    return lambda turns_deg, start=AXES, seed=0: recorded_motion(*motion(turns_deg, start), seed)


@pytest.fixture(scope="module")
def tilts():
    """Eight attitudes, all different."""
    return [rotation(vector) for vector in np.random.default_rng(3).uniform(-3, 3, (8, 3))]


def refusal(recordings):
    """The message without the offer of a model of fewer parameters."""
    with pytest.raises(imucal.NotEnoughMotionError) as caught:
        imucal.calibrate(recordings)
    return str(caught.value).partition(". Without more motion")[0]


def named(message, sensor):
    """The parameters that the message says are not determined."""
    return message.split(f"do not determine the {sensor}'s ")[1].split(":")[0].split(", ")


def null_space(design, names):
    """The parameters that take part in the null space of a Jacobian."""
    _, values, rows = np.linalg.svd(design, full_matrices=True)
    values = np.append(values, np.zeros(len(rows) - len(values)))
    null = rows[values < 1e-9 * values[0]]
    return [name for name, weight in zip(names, (null**2).sum(axis=0), strict=True) if weight > 1e-6]


def accelerometer_design(turns_deg, start=AXES):
    """Rows of d|f|/d(parameters) at the rests, for a unit with T = I: model.md (5)."""
    attitudes = [start]
    for turn in np.radians(turns_deg):
        attitudes.append(attitudes[-1] @ rotation(turn))
    up = np.array([attitude[2] for attitude in attitudes])
    cross = 2 * up[:, [0, 0, 1]] * up[:, [1, 2, 2]]
    return -np.hstack([up / G_MPS2, up**2, cross])


def gyroscope_design(turns, tilts):
    """Change of gravity after each turn, from each tilt, with each of the nine entries; by differences."""

    def after(sensitivity):
        inverse = np.linalg.inv(sensitivity)
        return np.concatenate([rotation(inverse @ turn).T @ tilt[2] for tilt in tilts for turn in turns])

    step = 1e-5
    change = [step * np.eye(9)[k].reshape(3, 3) for k in range(9)]
    return np.stack([(after(AXES + c) - after(AXES - c)) / (2 * step) for c in change], axis=1)


# --- the accelerometer ---


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_turns_about_one_axis_leave_it_level(recorded, axis):
    """The axis lies level at the start, and stays so."""
    start = rotation(np.radians(90) * AXES[0]) if axis == 2 else AXES
    turns = [37 * AXES[axis]] * 20
    message = refusal(recorded(turns, start))
    name = "xyz"[axis]
    others = [pair for pair in ("xy", "xz", "yz") if name in pair]
    expected = [f"bias {name}", f"scale {name}", *(f"misalignment {pair}" for pair in others)]
    assert named(message, "accelerometer") == expected
    assert message.count("within 40 deg of vertical") == 1
    assert f"no rest with {name} within 40 deg of vertical (closest 8" in message
    assert f"add rests with {name} up and with {name} down" in message
    assert expected == null_space(accelerometer_design(turns, start), ACCELEROMETER)


def test_y_within_15_deg_of_the_level_is_not_enough(recorded):
    turns = [(0, 40, 0), (8, 0, 0), (0, 30, 0), (-16, 0, 0), (0, 50, 0), (8, 0, 0)] * 4
    message = refusal(recorded(turns))
    assert "scale y" in message
    assert "no rest with y within 40 deg of vertical" in message


def test_two_faces(recorded):
    """The moves see more than the rests: the level bias that a turn over does not take along."""
    message = refusal(recorded([(180, 0, 0)] * 14))
    seen_by_rests = set(null_space(accelerometer_design([(180, 0, 0)] * 14), ACCELEROMETER))
    assert set(named(message, "accelerometer")) <= seen_by_rests
    assert {"scale x", "scale y", "bias x"} <= set(named(message, "accelerometer"))
    assert "no rest with x within 40 deg of vertical" in message
    assert "no rest with y within 40 deg of vertical" in message


def test_the_moves_determine_what_six_faces_leave_open(recorded, unit):
    turns = [(90, 0, 0)] * 4 + [(0, 90, 0)] * 4 + [(90, 0, 0), (0, 0, 90), (0, 0, 90), (0, 0, 90)]
    open_to_rests = null_space(accelerometer_design(turns), ACCELEROMETER)
    assert open_to_rests == ["misalignment xy", "misalignment xz", "misalignment yz"]
    result = imucal.calibrate(recorded(turns))
    for found, true in zip(result.parameters, unit.parameters, strict=True):
        assert abs(found.value - true.value) < 4.5 * found.std, found.name


def test_six_faces_with_few_turns_leave_the_misalignment_open(recorded):
    turns = [(90, 0, 0), (90, 0, 0), (90, 0, 0), (0, 0, 90), (0, 0, 180), (0, 0, 90)]
    message = refusal(recorded(turns))
    open_to_rests = null_space(accelerometer_design(turns), ACCELEROMETER)
    assert named(message, "accelerometer") == ["misalignment xz"]
    assert set(named(message, "accelerometer")) <= set(open_to_rests)
    assert "add rests with edges and corners up, or roll the unit over its faces" in message


def test_three_poses(recorded):
    turns = [(90, 0, 0), (-90, 0, 0), (0, 90, 0), (0, -90, 0)] * 4
    message = refusal(recorded(turns))
    assert named(message, "accelerometer") == null_space(accelerometer_design(turns), ACCELEROMETER)


@pytest.mark.parametrize(
    "turns",
    [
        pytest.param([(0, 0, 90)] * 14, id="one face"),
        pytest.param([(5, 0, 0), (-5, 5, 0), (0, -5, 90), (5, 5, 0), (-5, -5, 45)] * 3, id="within 10 deg"),
    ],
)
def test_rests_that_are_nearly_alike(recorded, turns):
    message = refusal(recorded(turns))
    open_entries = named(message, "accelerometer")
    assert {"scale x", "scale y", "bias x", "bias y"} <= set(open_entries)
    for name in "xy":
        closest = re.search(rf"no rest with {name} within 40 deg of vertical \(closest (\d+) deg\)", message)
        assert int(closest[1]) >= 77


@pytest.mark.parametrize("seed", range(4))
def test_no_rest_at_all(recorded_motion, seed):
    """A unit that tumbles all the time has no rest, however evenly it turns for a while."""
    random = np.random.default_rng(seed)
    time_s = np.arange(30 * RATE_HZ) / RATE_HZ
    hertz, phase = random.uniform(0.3, 1, (3, 4)), random.uniform(0, 2 * np.pi, (3, 4))
    rate = np.radians(60) * np.sin(2 * np.pi * hertz * time_s[:, None, None] + phase).sum(axis=-1)
    attitude, force = AXES, []
    for turn in rate / RATE_HZ:
        force.append(attitude[2] * G_MPS2)
        attitude = attitude @ rotation(turn)
    with pytest.raises(imucal.NotEnoughMotionError, match="no rest of 1 s or more in 3000 samples: hold"):
        imucal.calibrate(recorded_motion(time_s, rate, np.array(force)))


# --- the gyroscope: enough poses, by starting each recording in another one ---


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_moves_about_one_axis_only(recorded, tilts, axis):
    turn = 60 * AXES[axis]
    message = refusal([recorded([turn] * 5, tilt, seed) for seed, tilt in enumerate(tilts)])
    expected = null_space(gyroscope_design([np.radians(turn)], tilts), GYROSCOPE)
    assert named(message, "gyroscope") == expected
    assert len(expected) == 6
    idle = " and ".join(name for name in "xyz" if name != "xyz"[axis])
    assert message.endswith(
        f"hardly any rotation about body {idle}: add moves of 90 deg or more about {idle}"
    )


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_no_move_about_one_axis(recorded, tilts, axis):
    first, second = np.delete(60 * AXES, axis, axis=0)
    turns = [first, second, first + second, -first, first - second]
    message = refusal([recorded(turns, tilt, seed) for seed, tilt in enumerate(tilts)])
    expected = null_space(gyroscope_design(np.radians(turns), tilts), GYROSCOPE)
    assert named(message, "gyroscope") == expected
    assert len(expected) == 3
    name = "xyz"[axis]
    assert message.endswith(
        f"hardly any rotation about body {name}: add moves of 90 deg or more about {name}"
    )


def test_poses_without_moves(recorded):
    starts = np.random.default_rng(5).uniform(-3, 3, (16, 3))
    runs = [recorded([(0, 0, 0)] * 2, rotation(vector), seed) for seed, vector in enumerate(starts)]
    message = refusal(runs)
    assert named(message, "gyroscope") == GYROSCOPE
    assert "at least 5 between different poses are needed" in message


# --- whatever the motion ---


@pytest.mark.parametrize("seed", range(8))
def test_a_few_random_poses_give_a_sound_result_or_none(recorded, unit, seed):
    """From 3 to 14 rests: an error in words, or numbers that are true within their sigmas."""
    turns = np.random.default_rng(seed).uniform(-180, 180, (13, 3))
    ended = {}
    for count in range(2, 14):
        try:
            result = imucal.calibrate(recorded(turns[:count], seed=seed))
        except imucal.NotEnoughMotionError as error:
            ended[count] = "refused"
            assert "not determine" in str(error)
            continue
        ended[count] = "calibrated"
        for ours, true in zip(result.parameters, unit.parameters, strict=True):
            assert abs(ours.value - true.value) < 6 * ours.std
            assert 0 < ours.std < 0.1
    assert ended[2] == ended[4] == "refused"
    assert ended[13] == "calibrated"
