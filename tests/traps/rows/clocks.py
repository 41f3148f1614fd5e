"""Traps of time stamps: bursts, late stamps, coarse stamps, and copies of rows."""

import numpy as np

from changes import changed, rows, time
from recordings import calibrating
from trap import good, incomplete, poor, refused


def sawtooth(size, short_s):
    """Bursts: one step in `size` is short, the others are longer than the mean of 10 ms."""

    def stamp(t):
        k = np.arange(len(t))
        long_s = (size * 0.01 - short_s) / (size - 1)
        return k // size * size * 0.01 + np.where(
            k % size == size - 1, (size - 2) * long_s + short_s, k % size * long_s
        )

    return stamp


def late(every, delay_s):
    def stamp(t):
        return t + np.where(np.arange(len(t)) % every == 40, delay_s, 0.0)

    return stamp


def packets(size):
    def stamp(t):
        k = np.arange(len(t))
        return k // size * size * 0.01 + k % size * 1e-4

    return stamp


BURSTS = (
    *(
        calibrating(
            "samples come in bursts",
            f"one step in {size} is {1e3 * short_s:g} ms",
            time(sawtooth(size, short_s)),
            good(r"clock_irregular.*rate.hz.(100|99\.99\d*|100\.0\d*)\b"),
            incomplete(r"clock_irregular.*rate.hz.(100|99\.99\d*|100\.0\d*)\b"),
            poor(),
            refused("clock_irregular"),
        )
        for size, short_s in ((6, 1e-3), (8, 5e-4), (9, 5e-4))
    ),
    *(
        calibrating(
            "samples come in bursts",
            f"packets of {size} samples",
            time(packets(size)),
            refused(r"bursts of \d+ samples.*rate.hz.(100|99\.9\d*|100\.0\d*)\b"),
        )
        for size in (4, 10, 32)
    ),
)


def paused(stamp, pause_s):
    """Arrival times of a logger that pauses three times."""

    def paused_stamp(t):
        packet = np.arange(len(t)) // 16
        return stamp(t) + pause_s * sum(packet >= packet[-1] * k // 4 for k in (1, 2, 3))

    return paused_stamp


def tenths(t):
    return np.floor(t * 10 + 1e-6) / 10


PAUSES = tuple(
    calibrating(
        "samples come in bursts, and the logger pauses",
        f"{name}, three pauses of {pause_s:g} s",
        time(paused(stamp, pause_s)),
        refused(r"bursts of 1[06] samples.*rate.hz.RATE.*at least 3 pauses"),
    )
    for name, stamp in (("packets of 16", packets(16)), ("clock of 10 Hz", tenths))
    for pause_s in (0.4, 2.5)
)

LATE = tuple(
    calibrating(
        "samples are stamped late",
        f"one of {every}, {1e3 * delay_s:g} ms",
        time(late(every, delay_s)),
        good("stamped late"),
        incomplete("stamped late"),
    )
    for every, delay_s in ((90, 0.007), (300, 0.009), (100, 0.0095))
)

COARSE = tuple(
    calibrating(
        "two samples have one time stamp",
        f"clock of {rate_hz} Hz",
        time(lambda t, rate_hz=rate_hz: np.floor(t * rate_hz + 1e-6) / rate_hz),
        refused("samples_duplicated.*(rate.hz|finer resolution)"),
        refused("clock_irregular"),
    )
    for rate_hz in (50, 25, 64)
)


def doubled(n):
    return np.sort(np.r_[np.arange(n), np.arange(n)])


COPIES = (
    calibrating(
        "samples are written twice",
        "all, with their time stamps",
        rows(doubled),
        good("exact copies"),
        incomplete("exact copies"),
    ),
    calibrating(
        "samples are written twice",
        "other values to one stamp in ten",
        lambda r: changed(r, time_s=np.where(np.arange(len(r)) % 10 == 5, r.time_s - 0.01, r.time_s)),
        refused("samples_duplicated"),
    ),
)

TRAPS = (*BURSTS, *PAUSES, *LATE, *COARSE, *COPIES)
