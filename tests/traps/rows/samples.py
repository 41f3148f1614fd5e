"""Traps of single samples and of axes: dead, clipped, duplicated, lost, and impossible samples."""

import numpy as np

from changes import MOVES, changed, force, noise, put, rate, rows, time, with_new_time, without
from recordings import calibrating
from trap import good, incomplete, poor, refused

AXES = "xyz"


def one_in(every, first=70):
    return lambda n: np.setdiff1d(np.arange(n), np.arange(first, n, every))


def twice(every, first=50):
    return lambda n: np.sort(np.r_[np.arange(n), np.arange(first, n, every)])


NOT_FINITE = tuple(
    calibrating(
        "a sample that is not a number",
        f"{label} in {sensor}_{AXES[axis]}",
        on(put((100, axis), value)),
        right,
    )
    for sensor, on in (("accel", force), ("gyro", rate))
    for axis, value, label in ((0, np.nan, "NaN"), (2, np.inf, "infinity"))
    for right in [refused("non_finite")]
)

DEAD = tuple(
    calibrating(
        "an axis is dead",
        f"{sensor}_{AXES[axis]} is {value:g}",
        on(put((slice(None), axis), value)),
        refused("stuck_axis"),
    )
    for sensor, on in (("accel", force), ("gyro", rate))
    for axis in range(3)
    for value in (0.0, 0.01)
)

CLIPPED = (
    *(
        calibrating(
            "the range is exceeded",
            f"gyroscope cut off at {limit:g} rad/s",
            rate(lambda w, limit=limit: np.clip(w, -limit, limit)),
            refused("gyro_saturation"),
        )
        for limit in (1.0, 2.0, 3.0)
    ),
    *(
        calibrating(
            "the range is exceeded",
            f"gyroscope cut off at {limit:g} rad/s before its filter",
            rate(lambda w, limit=limit: noise(0.003)(np.clip(w, -limit, limit))),
            poor(),
            refused("gyro"),
        )
        for limit in (2.0, 3.0)
    ),
    *(
        calibrating(
            "the range is exceeded",
            f"accelerometer cut off at {limit:g} m/s^2 before its filter",
            force(lambda f, limit=limit: noise(0.01)(np.clip(f, -limit, limit))),
            poor(),
            incomplete(),
            refused("accel"),
        )
        for limit in (9.0, 9.5)
    ),
)

LOST = (
    *(
        calibrating(
            "samples are lost",
            f"one of {every}, with time stamps",
            rows(one_in(every)),
            good("samples_missing"),
            incomplete("samples_missing"),
        )
        for every in (101, 507)
    ),
    *(
        calibrating(
            "samples are lost",
            f"one of {every}, time from the sample number",
            with_new_time(rows(one_in(every))),
            poor(),
            incomplete(),
            refused("missing"),
        )
        for every in (20, 50, 100)
    ),
    calibrating(
        "samples are lost",
        "0.1 s of every move, time from the sample number",
        with_new_time(rows(without(*((a + 45, a + 55) for a, _ in MOVES)))),
        poor(),
    ),
    calibrating(
        "samples are lost",
        "every other move, with time stamps",
        rows(without(*MOVES[::2])),
        good("samples_missing"),
        incomplete("samples_missing"),
    ),
)

WRITTEN_TWICE = (
    *(
        calibrating(
            "samples are written twice",
            f"one of {every}, with their time stamps",
            rows(twice(every)),
            good("samples_duplicated"),
            refused("samples_duplicated"),
        )
        for every in (30, 100, 300)
    ),
    *(
        calibrating(
            "samples are written twice",
            f"one of {every}, time from the sample number",
            with_new_time(rows(twice(every))),
            poor(),
            refused("samples_duplicated"),
            good("samples_duplicated"),
        )
        for every in (5, 20)
    ),
)

CLOCK = (
    calibrating("the clock is wrong", "reversed", time(lambda t: t[::-1]), refused("time_not_increasing")),
    calibrating(
        "the clock is wrong",
        "counter of 16 bits in ms",
        time(lambda t: t % 65.536),
        refused("time_not_increasing"),
    ),
    calibrating("the clock is wrong", "ms as s", time(lambda t: t * 1e3), refused("clock_rate")),
    calibrating("the clock is wrong", "s as ns", time(lambda t: t * 1e-9), refused("clock_rate")),
    calibrating("the clock is wrong", "half the rate", time(lambda t: t * 2), refused("gyro_units")),
    calibrating("the clock is wrong", "1.5 times slow", time(lambda t: t * 1.5), refused("gyro_units")),
    calibrating(
        "the clock is wrong",
        "stamps on arrival, 6 ms of jitter",
        time(lambda t: np.sort(noise(0.006)(t))),
        refused("clock_irregular"),
    ),
    calibrating(
        "the clock is wrong",
        "packets of 16 samples",
        time(lambda t: np.arange(len(t)) // 16 * 0.16 + np.arange(len(t)) % 16 * 1e-4),
        refused("clock_irregular"),
    ),
    calibrating(
        "the clock is wrong",
        "float32 seconds since 1970",
        lambda r: changed(r, time_s=(r.time_s + 1.7e9).astype(np.float32)),
        refused("samples_duplicated"),
    ),
)

TRAPS = (*NOT_FINITE, *DEAD, *CLIPPED, *LOST, *WRITTEN_TWICE, *CLOCK)
