"""Traps of a unit at rest: bumps, warming up, gaps and late samples, and units that nobody gave."""

import functools
from pathlib import Path

import numpy as np

import imucal
from changes import changed, rows
from trap import Question, Right, Trap, good, poor, refused

RATE_HZ = 100.0
STEP = "the mean changes in a step"
# No step and no drift in the findings.
NEITHER = r"^(?!.*(\[step\]|\[drift\]))"


@functools.cache
def still(walk: float = 0.0, instability: float = 0.0, seed: int = 1, duration_s: float = 200.0):
    """A unit at rest; the accelerometer has ten times the noise of the gyroscope."""
    sensors = [
        imucal.Sensor(
            noise_density=size * 1e-4,
            bias_instability=size * instability,
            random_walk=np.full(3, size * walk),
        )
        for size in (10.0, 1.0)
    ]
    unit = imucal.Unit(*sensors)
    return imucal.simulate(imucal.Static(duration_s), unit=unit, rate_hz=RATE_HZ, seed=seed).recording


def resting(kind: str, name: str, change, *right: Right, of=still, **options) -> Trap:
    """A trap that identifies the noise of a changed recording at rest; options of `imucal.noise`."""

    def make(folder: Path) -> Question:
        path = folder / "still.parquet"
        imucal.write(change(of()), path)
        words = [f"--{key.replace('_', '-')}" for key in options]
        return Question(["noise", str(path), *words], lambda: imucal.noise(imucal.read(path), **options))

    return Trap(kind, name, make, right)


def plus(accel=(0.0, 0.0, 0.0), gyro=(0.0, 0.0, 0.0), shape=None):
    """A change that adds a shape, a function of time, to both sensors with these factors."""

    def change(r):
        values = shape(r.time_s)[:, None]
        return changed(
            r,
            specific_force=r.specific_force + values * np.array(accel),
            angular_rate=r.angular_rate + values * np.array(gyro),
        )

    return change


def step(at_s):
    return lambda t: (t >= at_s).astype(float)


def late(every, by_s):
    def change(r):
        time_s = r.time_s.copy()
        time_s[every // 2 :: every] += by_s
        return changed(r, time_s=time_s)

    return change


def in_unit(accel=1.0, gyro=1.0):
    return lambda r: changed(r, specific_force=r.specific_force * accel, angular_rate=r.angular_rate * gyro)


BUMPS = tuple(
    trap
    for name, accel, gyro, at_s in (
        ("accelerometer x", (0.02, 0, 0), (0, 0, 0), 61.2),
        ("accelerometer y and z, early", (0, -0.01, 0.03), (0, 0, 0), 27.7),
        ("gyroscope z, late", (0, 0, 0), (0, 0, 2e-3), 171.3),
        ("both sensors", (-0.05, 0, 0), (0, 1e-3, 0), 99.9),
        ("all axes", (0.02, 0.02, -0.02), (2e-3, -2e-3, 1e-3), 140.0),
    )
    for trap in (
        resting(
            "a bump is taken for a random walk",
            f"{name}, at {at_s} s",
            plus(accel, gyro, step(at_s)),
            poor(rf"\[step\].*{STEP}|{STEP}.*\[step\]"),
        ),
        resting(
            "a bump is taken for a random walk",
            f"{name}, cut",
            plus(accel, gyro, step(at_s)),
            good("steps_cut"),
            cut_steps=True,
        ),
    )
)

NO_BUMPS = (
    *(
        resting(
            "noise is taken for a bump",
            f"{name}, seed {seed}",
            lambda r: r,
            good(NEITHER),
            of=functools.partial(still, walk, instability, seed),
        )
        for name, walk, instability in (
            ("white", 0, 0),
            ("flicker", 0, 5e-5),
            ("walk", 2e-5, 0),
            ("strong walk", 2e-4, 0),
        )
        for seed in (11, 12)
    ),
    *(
        resting(
            "warming up is taken for a bump",
            f"time constant {constant_s} s",
            plus((0.05, 0, 0), (0, 4e-3, 0), lambda t, constant_s=constant_s: 1 - np.exp(-t / constant_s)),
            good(r"^(?!.*\[step\]).*\[drift\]"),
        )
        for constant_s in (30, 80, 250)
    ),
    resting(
        "warming up is taken for a bump",
        "a constant rate",
        plus((0, 0.03, 0), (3e-3, 0, 0), lambda t: t / t[-1]),
        good(r"^(?!.*\[step\]).*\[drift\]"),
    ),
)

GAPS = (
    resting(
        "samples of a unit at rest are lost",
        "one gap of a second",
        rows(lambda n: np.r_[0:6000, 6100:n]),
        good("recording_interrupted"),
    ),
    resting(
        "samples of a unit at rest are lost",
        "three gaps",
        rows(lambda n: np.r_[0:1500, 1510:9000, 9003:16000, 16900:n]),
        good("recording_interrupted"),
    ),
    resting(
        "samples of a unit at rest are lost",
        "one sample of 20000",
        rows(lambda n: np.delete(np.arange(n), 7000)),
        good(r"^(?!.*recording_interrupted)"),
    ),
    resting(
        "samples of a unit at rest are lost",
        "one in a hundred",
        rows(lambda n: np.delete(np.arange(n), np.arange(50, n, 100))),
        refused("longest part"),
    ),
    *(
        resting(
            "samples that arrive late are called missing",
            f"one in {every}, by {by_s} s",
            late(every, by_s),
            good(r"^(?!.*(samples_missing|recording_interrupted))"),
        )
        for every, by_s in ((80, 0.007), (333, 0.009), (1000, 0.0095))
    ),
)

UNITS = (
    resting(
        "rates at rest in another unit",
        "deg/s called rad/s",
        in_unit(gyro=57.29578),
        good("noise_implausible.*gyro_x_dps"),
    ),
    resting(
        "rates at rest in another unit",
        "the right unit",
        lambda r: r,
        good(r"^(?!.*implausible)"),
    ),
    resting(
        "rates at rest in another unit",
        "a bias of 70 deg/s",
        lambda r: changed(r, angular_rate=r.angular_rate + np.array([0, 1.22, 0])),
        good("bias_implausible"),
    ),
)

TRAPS = (*BUMPS, *NO_BUMPS, *GAPS, *UNITS)
