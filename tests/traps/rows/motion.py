"""Traps of the motion: rests and moves that do not determine the parameters, disturbances, several units."""

import functools

import numpy as np

import imucal
from changes import (
    after_table_rest,
    changed,
    force,
    hand_run,
    poses_within,
    program,
    rate,
    rows,
    stand_run,
)
from imucal import Program, Step
from recordings import calibrating
from trap import good, incomplete, poor, refused

FEW_POSES = "the motion does not determine all parameters"
BOX = "a box rolled over its faces"
HELD = "parameters are held by a prior"
DISTURBED = "a rest is disturbed"
TABLE = "a rest on a table before a hand-held run"
UNITS = "several units are taken for one"


def without_turns(r):
    noise = np.random.default_rng(0).normal(scale=0.003, size=r.angular_rate.shape)
    return changed(r, angular_rate=noise)


UNDETERMINED = (
    calibrating(FEW_POSES, "one rest", program(((0.0, 0.0, 0.0), 1.0, 60.0)), refused("do not determine")),
    calibrating(
        FEW_POSES,
        "turns about a vertical axis",
        program(*[((0.0, 0.0, 20.0), 1.0, 2.0)] * 18),
        refused("no rest with x within 40 deg of vertical"),
    ),
    calibrating(
        FEW_POSES,
        "whole turns only",
        program(*[((360.0, 0.0, 0.0), 3.0, 2.0), ((0.0, 360.0, 0.0), 3.0, 2.0)] * 9),
        refused("add rests"),
    ),
    calibrating(
        FEW_POSES,
        "two faces",
        program(*[((0.0, 180.0, 90.0), 2.0, 2.0), ((0.0, -180.0, 90.0), 2.0, 2.0)] * 10),
        refused("rest"),
    ),
    calibrating(
        FEW_POSES,
        "about one axis",
        program(*[((0.0, 40.0, 0.0), 1.0, 2.0)] * 18),
        refused("about body|no rest"),
    ),
    *(
        calibrating(FEW_POSES, f"all poses within {deg:g} deg", poses_within(deg), refused("rest|determine"))
        for deg in (2.0, 10.0, 20.0)
    ),
    calibrating(FEW_POSES, "a gyroscope with noise only", without_turns, refused("no more than noise")),
)


# Turns of the motors over the six faces of a box, deg.
SIX_FACES = (
    ((0.5, -1.0, 1.0), 1.0, 3.0),
    ((90.8, 0.7, -1.2), 2.0, 3.0),
    ((-0.6, 1.2, 90.5), 2.0, 3.0),
    ((88.9, -0.9, 0.8), 2.0, 3.0),
    ((1.1, 90.6, -0.7), 2.0, 3.0),
    ((-0.8, 0.6, 89.2), 2.0, 3.0),
)

PRIORS = (
    calibrating(
        HELD, "six faces, all parameters", program(*SIX_FACES), refused("--model orthogonal|model='orth")
    ),
    calibrating(
        HELD,
        "six faces, biases and scales",
        program(*SIX_FACES),
        incomplete("have the default prior"),
        model="orthogonal",
    ),
    calibrating(
        HELD,
        "six faces, biases and scales, one rest less",
        program(*SIX_FACES[:5]),
        refused("determine"),
        model="orthogonal",
    ),
    calibrating(
        HELD,
        "a misalignment 5 deg off",
        changed,
        poor("contradict the prior of accel_misalignment_xy"),
        hold=["accel_misalignment_xy=0.0872665+-0.001"],
    ),
    calibrating(
        HELD,
        "a scale 2 % off",
        changed,
        poor("contradict the prior of gyro_scale_z"),
        hold=["gyro_scale_z=1.02+-1e-4"],
    ),
)


FACES = tuple((step.turn_deg, step.move_s, step.hold_s) for step in imucal.Program.faces().steps)


def pushed(rest, size):
    """A box rolled over its faces, with a force along x added during one rest, m/s^2."""

    def change(r):
        recording = program(*FACES)(r)
        values, start = recording.specific_force.copy(), 450 * rest
        values[start : start + 300, 0] += size
        return changed(recording, specific_force=values)

    return change


ON_FACES = (
    calibrating(BOX, "four turns about each axis", program(*FACES), good()),
    calibrating(BOX, "turns about two axes", program(*FACES[:9]), refused("do not determine")),
    # Without the rest that is wrong all parameters are determined.
    *(
        calibrating(BOX, f"rest {rest} pushed", pushed(rest, 0.5), good(), incomplete(), poor())
        for rest in (2, 6, 11)
    ),
)


def bump(axis, size, rest=11, seconds=0.3):
    """A decaying oscillation of 8 Hz in the accelerometer in the middle of a rest."""

    def change(r):
        values, start = r.specific_force.copy(), 400 * rest + 100
        t = np.arange(int(seconds * 100)) / 100
        values[start : start + t.size, axis] += size * np.exp(-t / 0.1) * np.sin(2 * np.pi * 8 * t)
        return changed(r, specific_force=values)

    return change


def bias_jump(share, size, axis=0):
    def change(r):
        values = r.angular_rate.copy()
        values[int((1 - share) * len(r)) :, axis] += size
        return changed(r, angular_rate=values)

    return change


def slip(deg, after=0.5):
    """The unit turns in its mount by an angle about z, at a rest; from then on both sensors are turned."""

    def change(r):
        c, s = np.cos(np.radians(deg)), np.sin(np.radians(deg))
        turn = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
        start = 400 * int(after * 30) + 100
        both = [values.copy() for values in (r.specific_force, r.angular_rate)]
        for values in both:
            values[start:] = values[start:] @ turn.T
        return changed(r, specific_force=both[0], angular_rate=both[1])

    return change


DISTURBANCES = (
    *(
        calibrating(DISTURBED, f"a knock of {size:g} m/s^2", bump(axis, size), good(), incomplete(), poor())
        for axis, size in ((0, 0.2), (1, 1.0), (2, 5.0))
    ),
    *(
        calibrating(
            DISTURBED,
            f"the gyroscope's bias jumps by {size:g} rad/s at {100 * (1 - share):.0f} % of the run",
            bias_jump(share, size),
            poor(),
            incomplete(),
            good(),
            changing=("gyro_bias",),
        )
        for share, size in ((0.3, 0.02), (0.45, 0.02), (0.5, 0.002), (0.5, 0.005), (0.2, 0.05))
    ),
    *(
        calibrating(
            DISTURBED,
            f"the unit slips by {deg:g} deg about z in its mount, and both sensors with it",
            slip(deg),
            good(),
            incomplete(),
            poor(),
        )
        for deg in (0.5, 2.0, 10.0)
    ),
)

TABLES = tuple(
    calibrating(
        TABLE,
        f"{duration_s:g} s, tremor {tremor_deg:g} deg",
        after_table_rest(2, duration_s),
        good(),
        incomplete(),
        run=functools.partial(hand_run, 2, tremor_deg),
    )
    for duration_s, tremor_deg in ((10.0, 0.5), (20.0, 0.3), (20.0, 0.5), (40.0, 0.4))
)

OTHERS = (
    calibrating(
        UNITS,
        "two runs of two units",
        lambda r: [same_name(r), stand_run(3, "ideal").recording],
        poor(),
        refused("unit"),
    ),
    calibrating(
        UNITS,
        "three runs, one of another unit",
        lambda r: [same_name(r), stand_run(2).recording, stand_run(3, "ideal").recording],
        poor(),
        refused("unit"),
    ),
    calibrating(
        UNITS,
        "a control run of another unit",
        changed,
        poor(),
        run=stand_run,
        control=lambda _: stand_run(3, "ideal").recording,
    ),
    calibrating(
        UNITS,
        "a control run of the unit with a gyroscope 1 % off",
        changed,
        poor(),
        incomplete(),
        control=lambda _: rate(lambda w: w * 1.01)(stand_run(2).recording),
    ),
    calibrating(
        UNITS,
        "a control run of the unit with an accelerometer 0.1 m/s^2 off",
        changed,
        poor(),
        incomplete(),
        control=lambda _: force(lambda f: f + np.array([0.1, 0.0, 0.0]))(stand_run(2).recording),
    ),
)

# Of the second recording, only a tenth; every other pose of the first one is kept.
SHORT = slice(0, 1600)
PART = (
    calibrating(
        UNITS,
        "a run, and a short run of another unit",
        lambda r: [same_name(r), rows(SHORT)(stand_run(3, "random:paper:7").recording)],
        good("recording_unused"),
        incomplete("recording_unused"),
        poor(),
        refused("unit"),
    ),
)


def about_one_axis(axis):
    """A control recording with half the scale of two gyroscope axes, turned about the third one only."""
    turns = (90, 90, 90, 90, -90, -90, -90, 45, 45, -90, -90, -90)
    steps = (Step([turn if k == axis else 0 for k in range(3)], 2.0, 3.0) for turn in turns)
    half = np.array([1.0 if k == axis else 0.5 for k in range(3)])
    control = imucal.simulate(Program(tuple(steps)), rate_hz=100, seed=5).recording
    return lambda _: rate(lambda w: w * half)(control)


CONTROLS = tuple(
    calibrating(
        "the control recording does not test every axis",
        f"turned about {'xyz'[axis]} only",
        changed,
        incomplete("axes_not_tested"),
        poor(),
        control=about_one_axis(axis),
    )
    for axis in range(3)
)


def late_gyroscope(samples):
    def change(r):
        return changed(
            r,
            time_s=r.time_s[samples:],
            specific_force=r.specific_force[samples:],
            angular_rate=r.angular_rate[:-samples],
        )

    return change


LATE = "the two sensors were not recorded together"
TOGETHER = (
    # The moves take a second, so half a second of each is seen together.
    calibrating(LATE, "the gyroscope is 0.5 s late", late_gyroscope(50), good()),
    calibrating(LATE, "the gyroscope is 0.8 s late", late_gyroscope(80), good("sensors_not_together")),
    calibrating(
        LATE, "the gyroscope is 3 s late", late_gyroscope(300), poor(), refused("gain"), refused("move")
    ),
    calibrating(
        LATE,
        "the gyroscope of another run",
        lambda r: changed(r, angular_rate=stand_run(2).recording.angular_rate),
        refused("sensors_not_together"),
    ),
)


def same_name(r):
    return changed(r, name="first")


TRAPS = (
    *UNDETERMINED,
    *PRIORS,
    *ON_FACES,
    *DISTURBANCES,
    *TABLES,
    *OTHERS,
    *PART,
    *CONTROLS,
    *TOGETHER,
)
