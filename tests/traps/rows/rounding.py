"""Traps of coarse converters: noise below the step, in counts, SI units, float32 and few decimals."""

import dataclasses
import functools

import numpy as np

import imucal
from changes import MOVES, Change, changed, coarse_run, stand_run, truth_of
from recordings import calibrating
from trap import good, incomplete, poor

NOISE_BELOW_STEP = "noise_below_lsb"
# Standard deviation of a sample of the simulated unit, rad/s and m/s^2.
NOISE = {"gyro": 3.1e-3, "accel": 8.8e-3}
COLUMN = {"gyro": "angular_rate", "accel": "specific_force"}
DEG = np.pi / 180


@functools.cache
def filtered_run(filter_hz):
    """Twenty poses by hand, with the noise of an LSM6DSO at ±2000 deg/s behind a low-pass filter."""
    unit = imucal.Unit.named("lsm6dso")
    bias = np.array([0.3, -0.41, 0.77]) * DEG
    gyroscope = imucal.Sensor(bias=bias, noise_density=unit.gyroscope.noise_density, lsb=0.07 * DEG, bits=16)
    motion = imucal.Tumble(seed=5, poses=20, hold_s=3.0, move_s=1.5)
    coarse = imucal.Unit(unit.accelerometer, gyroscope)
    return imucal.simulate(motion, seed=5, unit=coarse, rate_hz=100, filter_hz=filter_hz)


def to_steps(values: np.ndarray, step: float) -> np.ndarray:
    return np.rint(values / step) * step


def rounded(sensor: str, times_noise: float, axes: tuple[int, ...] = (0, 1, 2), finish=lambda v: v) -> Change:
    """A change that rounds axes to a step of so many sigma; `finish` changes the number format."""

    def change(recording):
        values = getattr(recording, COLUMN[sensor]).copy()
        values[:, axes] = to_steps(values[:, axes], times_noise * NOISE[sensor])
        return changed(recording, **{COLUMN[sensor]: finish(values)})

    return change


def in_counts(times_noise: float) -> Change:
    """Both sensors in counts, so that no unit hints at the step."""

    def change(recording):
        counts = {
            column: np.rint(getattr(recording, column) / (times_noise * NOISE[sensor]))
            for sensor, column in COLUMN.items()
        }
        return changed(recording, **counts, accel_unit="lsb", gyro_unit="lsb")

    return change


def in_lsb_truth(times_noise: float) -> dict[str, float]:
    truth = truth_of(stand_run())
    return {name: value / (times_noise * NOISE[name.split("_")[0]]) for name, value in truth.items()}


OF_ONE_SENSOR = tuple(
    calibrating(
        "noise below a step of the converter",
        f"{sensor}: step of {times_noise:g} sigma",
        rounded(sensor, times_noise),
        good(NOISE_BELOW_STEP),
        incomplete(NOISE_BELOW_STEP),
        # With a step of 16 sigma, the direction of gravity at a rest is known to half a degree.
        poor(NOISE_BELOW_STEP),
    )
    for sensor, steps in (("gyro", (4.0, 6.0, 9.0)), ("accel", (4.0, 8.0, 16.0)))
    for times_noise in steps
)

OF_ONE_AXIS = tuple(
    calibrating(
        "noise below a step of the converter",
        f"{sensor}_{'xyz'[axis]} alone: step of 6 sigma",
        rounded(sensor, 6.0, (axis,)),
        good(NOISE_BELOW_STEP),
        incomplete(NOISE_BELOW_STEP),
    )
    for sensor in ("gyro", "accel")
    for axis in range(3)
)

# The rate of these axes often changes by 1, 2 and 1 steps in three consecutive samples, as at a lost sample.
RATE_CHANGES_OF_SINGLE_STEPS = tuple(
    calibrating(
        "noise below a step of the converter",
        f"gyro axes {axes}: step of {times_noise:g} sigma",
        rounded("gyro", times_noise, axes),
        good(NOISE_BELOW_STEP),
        incomplete(NOISE_BELOW_STEP),
        poor(NOISE_BELOW_STEP),
    )
    for axes, times_noise in (((1,), 18.0), ((0, 1), 16.0), ((1, 2), 24.0))
)

# One axis of 8 bit, with a lost low byte, or printed with one decimal. The two fine axes determine the norm
# and the direction of gravity far better than the rounding error of the coarse axis, so its error must cancel
# between them.
OF_ONE_VERY_COARSE_AXIS = tuple(
    calibrating(
        "noise below a step of the converter",
        f"accel_{'xyz'[axis]} alone: step of {times_noise:g} sigma",
        rounded("accel", times_noise, (axis,)),
        good(NOISE_BELOW_STEP),
        incomplete(NOISE_BELOW_STEP),
    )
    for times_noise in (12.0, 18.0, 24.0, 30.0)
    for axis in range(3)
)

NUMBER_FORMATS = tuple(
    calibrating(
        "noise below a step of the converter",
        f"gyro: step of 6 sigma, {label}",
        rounded("gyro", 6.0, finish=finish),
        good(NOISE_BELOW_STEP),
        incomplete(NOISE_BELOW_STEP),
    )
    for label, finish in (
        ("float32", lambda v: v.astype(np.float32)),
        ("four decimals", lambda v: np.round(v, 4)),
    )
)

COUNTS = tuple(
    calibrating(
        "noise below a step of the converter",
        f"both sensors in counts, step of {times_noise:g} sigma",
        in_counts(times_noise),
        good(NOISE_BELOW_STEP),
        incomplete(NOISE_BELOW_STEP),
        truth=in_lsb_truth(times_noise),
    )
    for times_noise in (4.0, 7.0)
)

FINE = tuple(
    calibrating(
        f"noise {place} a step of the converter",
        f"{sensor}: step of {times_noise:g} sigma",
        rounded(sensor, times_noise),
        good("verdict"),
    )
    for place, steps in (("above", (0.2, 1.0)), ("near", (1.2, 1.35, 1.5, 1.65, 1.8, 2.0)))
    for sensor in ("gyro", "accel")
    for times_noise in steps
)


NEAR = tuple(
    calibrating(
        "noise near a step of the converter",
        f"both sensors: step of 1.5 sigma, seed {seed}",
        changed,
        good("verdict"),
        run=functools.partial(coarse_run, seed),
    )
    for seed in (13, 20, 36)
)

FILTERED = tuple(
    calibrating(
        "noise below a step of the converter",
        f"gyroscope at ±2000 deg/s behind a filter of {filter_hz:g} Hz",
        changed,
        good(NOISE_BELOW_STEP),
        incomplete(NOISE_BELOW_STEP),
        run=functools.partial(filtered_run, filter_hz),
    )
    for filter_hz in (5.0, 10.0)
)


@functools.cache
def eight_bit_run(seed):
    """Twenty poses by hand with an accelerometer of 8 bit, whose poses often read one level on an axis."""
    unit = imucal.Unit.random("lsm6dso", seed)
    accelerometer = dataclasses.replace(unit.accelerometer, lsb=9.80665 / 64, bits=8)
    motion = imucal.Tumble(seed=2 * seed, poses=20, hold_s=3.0, move_s=1.5)
    return imucal.simulate(
        motion, seed=2 * seed, unit=imucal.Unit(accelerometer, unit.gyroscope), rate_hz=100
    )


EIGHT_BIT = tuple(
    calibrating(
        "noise below a step of the converter",
        f"accelerometer of 8 bit, seed {seed}",
        changed,
        good(NOISE_BELOW_STEP),
        run=functools.partial(eight_bit_run, seed),
    )
    for seed in (4, 33, 51)
)


def lively_rests(sensor: str, times_noise: float, count: int) -> Change:
    """A change that gives some rests six times the noise before rounding, as if the table were shaken."""

    def change(recording):
        values = getattr(recording, COLUMN[sensor]).copy()
        random = np.random.default_rng(7)
        for _, start in MOVES[10 : 10 + count]:
            values[start : start + 300] += random.normal(0.0, 6 * NOISE[sensor], (300, 3))
        return changed(recording, **{COLUMN[sensor]: to_steps(values, times_noise * NOISE[sensor])})

    return change


LIVELY = tuple(
    calibrating(
        "noise below a step of the converter",
        f"{sensor}: step of {times_noise:g} sigma, {count} of 31 rests with six times the noise",
        lively_rests(sensor, times_noise, count),
        good(NOISE_BELOW_STEP),
        incomplete(NOISE_BELOW_STEP),
    )
    for sensor in ("gyro", "accel")
    for times_noise in (3.0, 4.0)
    for count in (1, 2, 8)
)

TRAPS = (
    *LIVELY,
    *EIGHT_BIT,
    *OF_ONE_SENSOR,
    *OF_ONE_AXIS,
    *RATE_CHANGES_OF_SINGLE_STEPS,
    *OF_ONE_VERY_COARSE_AXIS,
    *NUMBER_FORMATS,
    *COUNTS,
    *FINE,
    *NEAR,
    *FILTERED,
)
