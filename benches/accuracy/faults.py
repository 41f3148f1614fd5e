"""Contaminated runs: the paper run with something wrong in it, and what is bad in it.

slip         the unit slips on its mount by 1 to 3 deg, within 50 ms at any time, and both sensors see it; in
             a move that is a turn like any other and harms nothing, in a rest the pose changes
nudge        in one rest the unit is pushed by 0.5 to 2 deg about each motor, within 0.2 s, and stays there
bad rests    two of 46: the mean force is off by 0.05 to 0.2 m/s^2 in any direction, or the unit creeps by 0.5
             to 1.5 deg about each motor over the whole rest, or is shaken (5 to 15 Hz, 0.1 to 0.5 deg)
bad moves    two of 45: a bump holds an axis of the gyroscope at its rail for 50 to 100 ms, or a glitch adds
             50 to 200 deg/s to an axis for 20 to 100 ms, or 0.1 to 0.3 s of samples are missing
heavy tails  white noise of Student's t with three degrees of freedom, of the datasheet's variance
clean        nothing
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

import imucal
from accuracy.naming import Bad
from accuracy.scene import PAPER
from imucal import Program, Recording, Stand, Step

RATE_HZ = PAPER.rate_hz
BAD_RESTS = 2
BAD_MOVES = 2
# A stretch in a move keeps away from its ends.
MARGIN_S = 0.3
RAIL_RADPS = np.radians(512.0)


@dataclass(frozen=True)
class Contaminated:
    """A run that is spoilt, and where.

    rests  start and end of the rests that are left, s
    """

    recording: Recording
    truth: imucal.Truth
    rests: list[tuple[float, float]]
    bad: list[Bad]


def slip(seed: int, random: np.random.Generator) -> Contaminated:
    program = Program.random(seed=seed)
    end_s = program.duration_s
    time_s = random.uniform(1.0, end_s - 1.0)
    turn_deg = random.uniform(1.0, 3.0) * _direction(random)
    stand = Stand(slip_deg=tuple(turn_deg.tolist()), slip_time_s=float(time_s))
    run = _simulate(replace(program, stand=stand), seed)
    stretch = time_s, time_s + 0.05
    in_rest = any(start < stretch[1] and end > stretch[0] for start, end in run.truth.rests)
    return _without(run, run.recording, [Bad("rest" if in_rest else "move", *stretch, to_see=in_rest)])


def nudge(seed: int, random: np.random.Generator) -> Contaminated:
    steps = list(Program.random(seed=seed).steps)
    # The first step is the hold at the start.
    number = int(random.integers(1, len(steps)))
    hit = steps[number]
    before_s = random.uniform(0.5, hit.hold_s - 0.7)
    push = Step(_turn(random, 0.5, 2.0), 0.2, hit.hold_s - 0.2 - before_s)
    steps[number : number + 1] = [Step(hit.turn_deg, hit.move_s, before_s), push]
    run = _simulate(Program(tuple(steps)), seed)
    # The halves of the rest do not count as left: an estimator may leave both out.
    halves = run.truth.rests[number : number + 2]
    spoilt = _without(run, run.recording, [Bad("rest", halves[0][1], halves[1][0])])
    return replace(spoilt, rests=[rest for rest in run.truth.rests if rest not in halves])


def bad_rests(seed: int, random: np.random.Generator) -> Contaminated:
    steps = list(Program.random(seed=seed).steps)
    # The first step is the hold at the start.
    numbers = 1 + random.choice(len(steps) - 1, BAD_RESTS, replace=False)
    kinds = random.choice(["offset", "creep", "shaken"], BAD_RESTS)
    plain = _simulate(Program(tuple(steps)), seed).truth.rests
    stretches = [plain[number] for number in numbers]
    for number in sorted(numbers[kinds == "creep"], reverse=True):
        hit = steps[number]
        creep = Step(_turn(random, 0.5, 1.5), hit.hold_s, 0.0)
        steps[number : number + 1] = [Step(hit.turn_deg, hit.move_s, 0.0), creep]
    run = _simulate(Program(tuple(steps)), seed)
    force, rate = run.recording.specific_force.copy(), run.recording.angular_rate.copy()
    for kind, stretch in zip(kinds, stretches, strict=True):
        inside = _samples(run, stretch)
        if kind == "offset":
            force[inside] += random.uniform(0.05, 0.2) * _direction(random)
        if kind == "shaken":
            added_force, added_rate = _shaking(run, inside, random)
            force[inside] += added_force
            rate[inside] += added_rate
    return _without(run, _changed(run, force, rate), [Bad("rest", *stretch) for stretch in stretches])


def bad_moves(seed: int, random: np.random.Generator) -> Contaminated:
    run = PAPER.run(seed)
    rate = run.recording.angular_rate.copy()
    keep = np.ones(len(rate), dtype=bool)
    bad = []
    for number in random.choice(len(run.truth.rests) - 1, BAD_MOVES, replace=False):
        move = run.truth.rests[number][1] + MARGIN_S, run.truth.rests[number + 1][0] - MARGIN_S
        kind = random.choice(["rail", "glitch", "missing"])
        longest_s = {"rail": (0.05, 0.1), "glitch": (0.02, 0.1), "missing": (0.1, 0.3)}[kind]
        duration_s = random.uniform(*longest_s)
        start_s = random.uniform(move[0], move[1] - duration_s)
        stretch = start_s, start_s + duration_s
        inside, axis = _samples(run, stretch), random.integers(3)
        sign = random.choice([-1.0, 1.0])
        if kind == "rail":
            rate[inside, axis] = sign * RAIL_RADPS
        if kind == "glitch":
            rate[inside, axis] += sign * np.radians(random.uniform(50.0, 200.0))
        if kind == "missing":
            keep &= ~inside
        bad.append(Bad("move", *stretch))
    return _without(run, _changed(run, run.recording.specific_force, rate, keep), bad)


def heavy_tails(seed: int, random: np.random.Generator) -> Contaminated:
    unit = PAPER.unit
    names = ("accelerometer", "gyroscope")
    silent = {n: replace(getattr(unit, n), noise_density=0.0, lsb=None, bits=None) for n in names}
    run = imucal.simulate("random", seed=seed, unit=replace(unit, **silent), rate_hz=RATE_HZ)
    columns = []
    for name, exact in zip(names, (run.recording.specific_force, run.recording.angular_rate), strict=True):
        sensor = getattr(unit, name)
        # Student's t with three degrees of freedom has variance 3.
        noise = random.standard_t(3, size=exact.shape) / np.sqrt(3.0)
        noisy = exact + sensor.noise_density * np.sqrt(RATE_HZ) * noise
        columns.append(np.round(noisy / sensor.lsb) * sensor.lsb)
    return _without(run, _changed(run, *columns), [])


def clean(seed: int, random: np.random.Generator) -> Contaminated:
    del random
    run = PAPER.run(seed)
    return _without(run, run.recording, [])


FAULTS: dict[str, Callable[[int, np.random.Generator], Contaminated]] = {
    "clean": clean,
    "slip": slip,
    "nudge": nudge,
    "bad rests": bad_rests,
    "bad moves": bad_moves,
    "heavy tails": heavy_tails,
}


def contaminated(name: str, seed: int) -> Contaminated:
    """The run `seed` with this fault; the fault has a stream of its own."""
    return FAULTS[name](seed, np.random.default_rng([seed, list(FAULTS).index(name)]))


def _simulate(program: Program, seed: int) -> imucal.Simulation:
    return imucal.simulate(program, seed=seed, unit=PAPER.unit, rate_hz=RATE_HZ)


def _without(run: imucal.Simulation, recording: Recording, bad: list[Bad]) -> Contaminated:
    rests = [r for r in run.truth.rests if not any(one.of == "rest" and one.touches(*r) for one in bad)]
    return Contaminated(recording, run.truth, rests, bad)


def _changed(
    run: imucal.Simulation, force: np.ndarray, rate: np.ndarray, keep: np.ndarray | slice = slice(None)
) -> Recording:
    return Recording(run.recording.time_s[keep], force[keep], rate[keep], name="contaminated")


def _samples(run: imucal.Simulation, stretch: tuple[float, float]) -> np.ndarray:
    return (run.truth.time_s >= stretch[0]) & (run.truth.time_s <= stretch[1])


def _direction(random: np.random.Generator) -> np.ndarray:
    vector = random.normal(size=3)
    return vector / np.linalg.norm(vector)


def _turn(random: np.random.Generator, least_deg: float, most_deg: float) -> tuple[float, float, float]:
    """A turn of each motor, either way."""
    return tuple((random.choice([-1.0, 1.0], 3) * random.uniform(least_deg, most_deg, 3)).tolist())


def _shaking(
    run: imucal.Simulation, inside: np.ndarray, random: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """What a small turn d = a sin(s) n to and fro adds: f x d to the force, its derivative to the rate."""
    unit = run.truth.calibration
    axis, hz = _direction(random), random.uniform(5.0, 15.0)
    angle_rad = np.radians(random.uniform(0.1, 0.5))
    phase = 2 * np.pi * hz * (run.truth.time_s[inside] - run.truth.time_s[inside][0])
    turn = angle_rad * np.sin(phase)[:, None] * axis
    rate = angle_rad * 2 * np.pi * hz * np.cos(phase)[:, None] * axis
    force = np.cross(run.truth.specific_force[inside], turn)
    return force @ unit.accelerometer.sensitivity.T, rate @ unit.gyroscope.sensitivity.T
