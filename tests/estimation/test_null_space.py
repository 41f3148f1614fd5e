"""What words call undetermined is what the null space leaves open: NumPy, finite differences, true motion."""

import itertools
import re

import numpy as np
import pytest

import imucal
from imucal import Program, Step

G_MPS2 = 9.80665
RATE_HZ = 100
PAIRS = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)]
ACCELEROMETER = [
    *(f"bias {axis}" for axis in "xyz"),
    *(f"scale {axis}" for axis in "xyz"),
    *(f"misalignment {pair}" for pair in ("xy", "xz", "yz")),
]
GYROSCOPE = [f"scale {i}" if i == j else f"misalignment {i}{j}" for i in "xyz" for j in "xyz"]
NAMES = [f"accelerometer {name}" for name in ACCELEROMETER] + [f"gyroscope {name}" for name in GYROSCOPE]
# model.md (12)
REST_ERROR_MPS2, MOVE_ERROR_RAD, LARGEST_SHIFT, FARTHEST = 0.005, 0.0035, 0.01, 0.1


def rotations(vectors):
    """Rodrigues' formula for each rotation vector, rad."""
    angle = np.maximum(np.linalg.norm(vectors, axis=1), 1e-12)[:, None, None]
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    cross = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
    return np.eye(3) + np.sin(angle) / angle * cross + (1 - np.cos(angle)) / angle**2 * cross @ cross


def product(matrices):
    while len(matrices) > 1:
        if len(matrices) % 2:
            matrices = np.concatenate([matrices, np.eye(3)[None]])
        matrices = matrices[::2] @ matrices[1::2]
    return matrices[0]


class Model:
    """|f| at the rests and gravity after each move as functions of 18 parameters, at the truth of a run."""

    def __init__(self, truth):
        unit, time_s = truth.calibration, truth.time_s
        spans = [(np.searchsorted(time_s, start), np.searchsorted(time_s, end)) for start, end in truth.rests]
        middles = [(first + end) // 2 for first, end in spans]
        self.seen_force = truth.specific_force[middles] @ unit.accelerometer.sensitivity.T
        self.seen_force += unit.accelerometer.bias
        rate = truth.angular_rate @ unit.gyroscope.sensitivity.T
        moves = [slice(before[1] - 1, after[0] + 1) for before, after in itertools.pairwise(spans)]
        self.moves = [(rate[move], np.diff(time_s[move])[:, None]) for move in moves]
        entries = [unit.accelerometer.sensitivity[pair] for pair in PAIRS]
        self.true = np.concatenate([unit.accelerometer.bias, entries, unit.gyroscope.sensitivity.ravel()])

    def __call__(self, parameters):
        sensitivity = np.zeros((3, 3))
        for (i, j), entry in zip(PAIRS, parameters[3:9], strict=True):
            sensitivity[i, j] = sensitivity[j, i] = entry
        force = np.linalg.solve(sensitivity, (self.seen_force - parameters[:3]).T).T
        norm = np.linalg.norm(force, axis=1)
        up = force / norm[:, None]
        gyroscope = parameters[9:].reshape(3, 3)
        carried = [
            product(rotations((rate[1:] + rate[:-1]) / 2 * dt @ np.linalg.inv(gyroscope).T)).T @ before
            - after
            for (rate, dt), before, after in zip(self.moves, up, up[1:], strict=False)
        ]
        return np.concatenate([norm / REST_ERROR_MPS2, np.ravel(carried) / MOVE_ERROR_RAD])

    def design(self):
        """Over errors of real units, for a hundredth of each parameter's size."""
        size = np.array([G_MPS2] * 3 + [1.0] * 15)
        steps = 1e-5 * np.diag(size)
        columns = [(self(self.true + step) - self(self.true - step)) / 2e-5 for step in steps]
        return LARGEST_SHIFT * np.stack(columns, axis=1)


def null_space(design):
    _, values, rows = np.linalg.svd(design, full_matrices=True)
    values = np.append(values, np.zeros(len(rows) - len(values)))
    return rows[values < 1e-7 * values[0]]


def undetermined(design):
    """What errors of real units may move by more than a hundredth: model.md (12)."""
    loosest = np.eye(18) * (LARGEST_SHIFT / FARTHEST) ** 2
    variance = np.diag(np.linalg.inv(design.T @ design + loosest))
    return [name for name, v in zip(NAMES, variance, strict=True) if v > 1]


def named(words):
    found = re.findall(r"do not determine the (\w+)'s ([^:]*):", words)
    return [f"{sensor} {name}" for sensor, names in found for name in names.split(", ")]


def traded(words):
    """Groups of parameters with fewer observable combinations than members, and how many there are."""
    members = r"((?:accelerometer|gyroscope)[^;:]*)"
    group = rf"only (\d+) independent combinations? of {members} (?:is|are) observable"
    return [(set(re.split(", | and ", members)), int(count)) for count, members in re.findall(group, words)]


def refusal(recordings):
    with pytest.raises(imucal.NotEnoughMotionError) as caught:
        imucal.calibrate(recordings)
    return str(caught.value)


def program(*turns_deg, move_s=1.0):
    steps = [Step((0.0, 0.0, 0.0), 1.0, 2.0), *(Step(turn, move_s, 2.0) for turn in turns_deg)]
    return Program(tuple(steps))


def within(deg, heading_deg):
    """Thirty poses whose inner two motors stay within `deg`."""
    poses = np.random.default_rng(3).uniform(-1, 1, (30, 3)) * [deg, deg, heading_deg]
    return program(*map(tuple, np.diff(poses, axis=0).tolist()), move_s=2.0)


EXACT = {
    "turns about x": program(*[(40.0, 0.0, 0.0)] * 18),
    "turns about y": program(*[(0.0, 40.0, 0.0)] * 18),
    "turns about the vertical": program(*[(0.0, 0.0, 40.0)] * 18),
    "turns about level z": program((90.0, 0.0, 0.0), *[(0.0, 0.0, 40.0)] * 18),
    "two faces, turns about y": program(*[(0.0, 180.0, 0.0), (0.0, -180.0, 0.0)] * 10, move_s=2.0),
    "all alike": program(*[(360.0, 0.0, 0.0), (0.0, 360.0, 0.0), (0.0, 0.0, 90.0)] * 6, move_s=3.0),
}
NEARLY = {
    "two faces": program(*[(180.0, 0.0, 90.0), (-180.0, 0.0, 90.0)] * 10, move_s=2.0),
    "within 10 deg": within(10.0, 10.0),
    "within 5 deg, any heading": within(5.0, 180.0),
    "six rests": Program.random(seed=1, moves=5, hold_s=2.0),
}


@pytest.mark.parametrize("name", EXACT)
@pytest.mark.parametrize("seed", [1, 2])
def test_words_name_the_null_space(name, seed):
    run = imucal.simulate(EXACT[name], rate_hz=RATE_HZ, seed=seed)
    design = Model(run.truth).design()
    words = refusal(run.recording)
    open_directions = null_space(design)
    assert len(open_directions) >= 7
    parts = dict(zip(NAMES, (open_directions**2).sum(axis=0), strict=True))
    # The unit's bias tilts gravity: its share of 0.002 in a direction is not the motion's.
    assert named(words) == [name for name, part in parts.items() if part > 0.01]
    assert named(words) == undetermined(design)
    # Every direction is open by itself or in a group.
    groups = traded(words)
    in_groups = set().union(*(members for members, _ in groups))
    assert in_groups == {name for name, part in parts.items() if 0.01 < part < 0.95}
    of_groups = sum(len(members) - count for members, count in groups)
    assert len(named(words)) - len(in_groups) + of_groups == len(open_directions)


@pytest.mark.parametrize("name", NEARLY)
@pytest.mark.parametrize("seed", [1, 2])
def test_words_name_what_errors_of_real_units_would_move(name, seed):
    run = imucal.simulate(NEARLY[name], rate_hz=RATE_HZ, seed=seed)
    assert named(refusal(run.recording)) == undetermined(Model(run.truth).design())


def test_nothing_is_undetermined_by_the_paper_run():
    run = imucal.simulate(Program.random(seed=1), rate_hz=RATE_HZ, seed=1)
    assert undetermined(Model(run.truth).design()) == []
    imucal.calibrate(run.recording)


def test_traded_off_pairs():
    """An axis that stays level: the tilt of the others against it looks like a tilt of the gyroscope."""
    words = refusal(imucal.simulate(EXACT["turns about y"], rate_hz=RATE_HZ, seed=1).recording)
    assert traded(words) == [
        ({"accelerometer misalignment xy", "gyroscope misalignment xy"}, 1),
        ({"accelerometer misalignment yz", "gyroscope misalignment zy"}, 1),
    ]
    assert "add rests with y up and with y down" in words
    assert "add moves of 90 deg or more about x and z" in words


# --- no moves, dead sensors ---


@pytest.fixture(scope="module")
def run():
    return imucal.simulate(Program.random(seed=1, moves=30, hold_s=2.0), rate_hz=RATE_HZ, seed=1)


def changed(recording, *, force=None, rate=None, counts=False):
    force = recording.specific_force if force is None else force
    rate = recording.angular_rate if rate is None else rate
    units = {"accel_unit": "lsb", "gyro_unit": "lsb"} if counts else {}
    if counts:
        force, rate = np.round(1000 * force), np.round(5000 * rate)
    return imucal.Recording(recording.time_s, force, rate, name="changed", **units)


def noise(recording, sigma, mean=(0.0, 0.0, 0.0)):
    return np.random.default_rng(0).normal(mean, sigma, (len(recording), 3))


def test_rests_without_moves():
    """Each rest a recording of its own."""
    run = imucal.simulate(Program.random(seed=1, moves=20, hold_s=6.0), rate_hz=RATE_HZ, seed=1)
    r = run.recording
    parts = []
    for index, (start, end) in enumerate(run.truth.rests):
        rows = (r.time_s >= start) & (r.time_s <= end)
        parts.append(
            imucal.Recording(r.time_s[rows], r.specific_force[rows], r.angular_rate[rows], name=f"{index}")
        )
    words = refusal(parts)
    assert named(words) == NAMES[9:]
    assert "at least 5 between different poses are needed" in words


@pytest.mark.parametrize("counts", [False, True])
def test_a_gyroscope_that_only_makes_noise(run, counts):
    """Its readings less the bias are zero, so all nine entries of what they are multiplied with are open."""
    silent = changed(run.recording, rate=noise(run.recording, 0.004, 0.01), counts=counts)
    words = refusal(silent)
    assert named(words) == NAMES[9:]
    assert "the gyroscope reads no more than noise" in words


@pytest.mark.parametrize("counts", [False, True])
def test_an_accelerometer_that_only_makes_noise(run, counts):
    """Without gravity there is nothing to judge the gyroscope by."""
    force = noise(run.recording, 0.012, (0.0, 0.0, 9.8))
    words = refusal(changed(run.recording, force=force, counts=counts))
    assert named(words) == NAMES
    assert counts or "the accelerometer readings are the same at all of them" in words


@pytest.mark.parametrize(("dead", "expected"), [("gyroscope", NAMES[9:]), ("accelerometer", NAMES)])
def test_a_sensor_that_stands_still(run, dead, expected):
    zero = np.zeros((len(run.recording), 3))
    stuck = {"rate": zero} if dead == "gyroscope" else {"force": zero + np.array([0.0, 0.0, 9.8])}
    with pytest.raises(imucal.InputError, match="stuck_axis") as caught:
        imucal.calibrate(changed(run.recording, **stuck))
    assert named(str(caught.value)) == expected
