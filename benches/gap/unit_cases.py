"""Recordings of units with strong effects, with deterministic and random variations, and of two sessions.

No recording is made by the product's simulator; see `analytic`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

import imucal
from gap.analytic import DEG, Error, G, Motion, Sensors, measured, random_motion, stand_motion, walk
from gap.case import generator
from gap.known import signs

Random = np.random.Generator
PEAK: Final = 120.0 * DEG
# Nodes and weights of the mean over an exponential distribution (Gauss-Laguerre).
PAST, SHARES = np.polynomial.laguerre.laggauss(10)
STEP_S: Final = 1e-3


@dataclass(frozen=True)
class Truth:
    """What a unit has that the model with 21 parameters lacks.

    effects        names of the catalogue that describe it exactly; empty if there are none
    is_random      whether a bias walks randomly
    blocks         parts of the model in which an unknown remainder may be reported
    """

    effects: tuple[str, ...] = ()
    is_random: bool = False
    blocks: tuple[str, ...] = ()


@dataclass(frozen=True)
class Unit:
    """A unit: what it has, and the errors of one run as functions of the motion.

    rate, force    errors of the sensors, given the random numbers of the run
    noise          factors by which white noise in moves exceeds noise at rest: gyroscope, accelerometer
    flexure_rad    sag of the stand; None for a unit that is not on a stand
    columns        further columns of a run
    """

    truth: Truth
    rate: Callable[[Random], tuple[Error, ...]] = lambda _: ()
    force: Callable[[Random], tuple[Error, ...]] = lambda _: ()
    noise: tuple[float, float] = (1.0, 1.0)
    flexure_rad: float | None = None
    columns: Callable[[Motion, Random], dict[str, np.ndarray]] | None = None
    second: Callable[[Sensors], Sensors] = lambda unit: unit
    temperatures_degc: tuple[float | None, float | None] = (None, None)


def lever_arm(random: Random) -> Unit:
    """0.3 m between accelerometer and the centre of rotation."""
    arm = random.normal(size=3)
    arm *= 0.3 / np.linalg.norm(arm)

    def force(motion: Motion) -> np.ndarray:
        before, here, after = (motion.at(motion.time_s + k * STEP_S) for k in (-1, 0, 1))
        second = (after.apply(arm) - 2.0 * here.apply(arm) + before.apply(arm)) / STEP_S**2
        return np.asarray(here.inv().apply(second))

    return Unit(Truth(("accel_lever_arm",)), force=lambda _: (force,))


def gyro_cubic(random: Random) -> Unit:
    """4 to 9 % at 120 deg/s."""
    k = random.uniform(0.04, 0.09) / PEAK**2 * signs(random)
    return Unit(Truth(("gyro_scale_cubic",)), rate=lambda _: (lambda motion: k * motion.rate**3,))


def gyro_quadratic(random: Random) -> Unit:
    """15 to 21 % at 120 deg/s."""
    k = random.uniform(0.15, 0.21) / PEAK * signs(random)
    return Unit(Truth(("gyro_scale_quadratic",)), rate=lambda _: (lambda motion: k * motion.rate**2,))


def delay(random: Random) -> Unit:
    """The gyroscope is late by 20 to 30 ms."""
    tau_s = random.uniform(0.02, 0.03)

    def error(motion: Motion) -> np.ndarray:
        return motion.rate_at(motion.time_s - tau_s) - motion.rate

    return Unit(Truth(("gyro_time_offset",)), rate=lambda _: (error,))


def low_pass(random: Random) -> Unit:
    """A low-pass filter of the first order with 12 to 20 ms."""
    tau_s = random.uniform(0.012, 0.02)

    def error(motion: Motion) -> np.ndarray:
        past = [
            share * motion.rate_at(motion.time_s - tau_s * x) for x, share in zip(PAST, SHARES, strict=True)
        ]
        return np.asarray(np.sum(past, axis=0) - motion.rate)

    return Unit(Truth(("gyro_lag",)), rate=lambda _: (error,))


def accel_quadratic(random: Random) -> Unit:
    """1 to 3 % per g on all axes."""
    k = random.uniform(0.01, 0.03) / G * signs(random)
    return Unit(Truth(("accel_scale_quadratic",)), force=lambda _: (lambda motion: k * motion.force**2,))


def accel_quadratic_on_stand(random: Random) -> Unit:
    """2 % per g, the same on all axes, on a stand with encoders."""
    k = np.full(3, 0.02) / G
    unit = accel_quadratic(random)
    return replace(unit, flexure_rad=0.0, force=lambda _: (lambda motion: k * motion.force**2,))


def g_sensitivity(random: Random) -> Error:
    matrix = random.normal(size=(3, 3))
    matrix *= random.uniform(0.05, 0.15) * DEG / G * 3.0 / np.linalg.norm(matrix)
    return lambda motion: motion.force @ matrix.T


def switching(random: Random) -> Unit:
    """A motor that runs at times changes the gyroscope's bias by some 0.05 deg/s."""
    size = 0.05 * DEG * signs(random)

    def rate(random: Random) -> tuple[Error, ...]:
        on = _on(random)
        return (lambda motion: size * on(motion)[:, None],)

    return Unit(Truth(blocks=("gyro_bias",)), rate=rate)


def _on(random: Random) -> Callable[[Motion], np.ndarray]:
    """1 while a load is switched on, at irregular times; 0 otherwise."""
    ends = np.cumsum(random.uniform(15.0, 50.0, size=60))
    return lambda motion: (np.searchsorted(ends, motion.time_s) % 2).astype(float)


def switching_force(random: Random) -> Unit:
    """A fan that runs at times changes the accelerometer's bias by some 0.5 mg."""
    size = 0.5e-3 * G * signs(random)

    def force(random: Random) -> tuple[Error, ...]:
        on = _on(random)
        return (lambda motion: size * on(motion)[:, None],)

    return Unit(Truth(blocks=("accel_bias",)), force=force)


def swinging(random: Random) -> Unit:
    """The gyroscope's bias swings by some 0.04 deg/s with a period of 60 to 150 s."""
    size, period_s = 0.04 * DEG * signs(random), random.uniform(60.0, 150.0)

    def rate(random: Random) -> tuple[Error, ...]:
        phase = random.uniform(0.0, 2.0 * np.pi)
        return (lambda motion: size * np.sin(2.0 * np.pi * motion.time_s / period_s + phase)[:, None],)

    return Unit(Truth(blocks=("gyro_bias",)), rate=rate)


def supply(random: Random) -> Unit:
    """The gyroscope's bias follows a recorded supply voltage."""
    slope = 0.3 * DEG * signs(random)

    def columns(motion: Motion, random: Random) -> dict[str, np.ndarray]:
        load = np.sin(2 * np.pi * motion.time_s / random.uniform(40, 90) + random.uniform(0, 6.28)) > 0
        noise = random.normal(scale=0.003, size=len(load))
        return {"supply_v": 3.5 - 6e-4 * motion.time_s - 0.12 * load + noise}

    return Unit(Truth(("gyro_bias_supply_v",)), columns=columns, rate=lambda _: (Column("supply_v", slope),))


@dataclass(frozen=True)
class Column:
    """An error that follows a further column; the column is added when the run is made."""

    name: str
    slope: np.ndarray
    values: np.ndarray | None = None

    def __call__(self, motion: Motion) -> np.ndarray:
        assert self.values is not None
        return self.slope * (self.values[:, None] - 3.3)


def nonlinear_accelerometer(random: Random) -> Unit:
    """Integral nonlinearity: the reading errs by up to 2 mg, in waves of 0.6 to 1.2 g."""
    size, period = 2e-3 * G * signs(random), G * random.uniform(0.6, 1.2)
    phase = random.uniform(0.0, 2.0 * np.pi, size=3)
    error = lambda motion: size * np.sin(2.0 * np.pi * motion.force / period + phase)  # noqa: E731
    return Unit(Truth(blocks=("accel_bias", "accel_scale")), force=lambda _: (error,))


def nonlinear_gyroscope(random: Random) -> Unit:
    """Integral nonlinearity: a triangular error of up to 0.5 deg/s with a period of 40 to 90 deg/s."""
    size, period = 0.5 * DEG * signs(random), random.uniform(40.0, 90.0) * DEG

    def error(motion: Motion) -> np.ndarray:
        wave: np.ndarray = 2.0 * np.abs(2.0 * ((motion.rate / period + 0.25) % 1.0) - 1.0) - 1.0
        return size * wave

    return Unit(Truth(blocks=("gyro_bias", "gyro_scale")), rate=lambda _: (error,))


def flexing(random: Random) -> Unit:
    """A stand that sags by 0.1 deg with the pose."""
    return Unit(Truth(blocks=("encoder",)), flexure_rad=random.uniform(0.08, 0.15) * DEG)


def cubic_on_flexing(random: Random) -> Unit:
    unit, own = flexing(random), gyro_cubic(random)
    k = random.uniform(0.01, 0.04) / PEAK**2 * signs(random)
    rate = lambda motion: k * motion.rate**3  # noqa: E731
    return replace(unit, truth=Truth(own.truth.effects, blocks=("encoder",)), rate=lambda _: (rate,))


def g_sensitivity_on_flexing(random: Random) -> Unit:
    unit, own = flexing(random), g_sensitivity(random)
    return replace(unit, truth=Truth(("gyro_g_sensitivity",), blocks=("encoder",)), rate=lambda _: (own,))


def loud_gyroscope(random: Random) -> Unit:
    """The gyroscope is two to four times as loud in moves as at rest."""
    return Unit(Truth(blocks=("noise",)), noise=(random.uniform(2.0, 4.0), 1.0))


def loud_accelerometer(random: Random) -> Unit:
    return Unit(Truth(blocks=("noise",)), noise=(1.0, random.uniform(2.0, 4.0)))


def random_walk(random: Random) -> Unit:
    """The gyroscope's bias walks by 1 to 3 mdeg/s per root second."""
    size = random.uniform(1e-3, 3e-3) * DEG
    return Unit(Truth(is_random=True, blocks=("gyro_bias",)), rate=lambda run: (walk(run, size),))


def random_walk_force(random: Random) -> Unit:
    """The accelerometer's bias walks by 20 to 60 ug per root second."""
    size = random.uniform(20e-6, 60e-6) * G
    return Unit(Truth(is_random=True, blocks=("accel_bias",)), force=lambda run: (walk(run, size),))


def warm_and_cold(random: Random) -> Unit:
    """Sessions at two recorded temperatures, 10 to 30 K apart."""
    change_k = random.uniform(10.0, 30.0) * random.choice([-1.0, 1.0])
    force, rate = (
        random.normal(size=3) * 0.2e-3 * G * change_k,
        random.normal(size=3) * 0.015 * DEG * change_k,
    )
    moved = lambda unit: replace(unit, force_bias=unit.force_bias + force, rate_bias=unit.rate_bias + rate)  # noqa: E731
    return Unit(
        Truth(blocks=("temperature",)), second=moved, temperatures_degc=(25.0, 25.0 + float(change_k))
    )


def switched_on_again(random: Random) -> Unit:
    """Sessions at one temperature, between which the unit was switched off."""
    force, rate = random.normal(size=3) * 3e-3 * G, random.normal(size=3) * 0.1 * DEG
    moved = lambda unit: replace(unit, force_bias=unit.force_bias + force, rate_bias=unit.rate_bias + rate)  # noqa: E731
    return Unit(Truth(blocks=("switch-on",)), second=moved, temperatures_degc=(25.0, 25.0))


def moved_scales(random: Random) -> Unit:
    """Sessions between which biases and scales of both sensors moved."""
    force, rate = random.normal(size=3) * 3e-3 * G, random.normal(size=3) * 0.1 * DEG
    scales = random.uniform(5e-4, 2e-3, size=2) * random.choice([-1.0, 1.0], size=2)

    def moved(unit: Sensors) -> Sensors:
        return replace(
            unit,
            force_bias=unit.force_bias + force,
            rate_bias=unit.rate_bias + rate,
            force_matrix=unit.force_matrix * (1.0 + scales[0]),
            rate_matrix=unit.rate_matrix * (1.0 + scales[1]),
        )

    return Unit(Truth(blocks=("switch-on",)), second=moved, temperatures_degc=(25.0, 25.0))


STRONG: Final = {
    "lever arm of 0.3 m": lever_arm,
    "gyroscope cubic": gyro_cubic,
    "gyroscope quadratic": gyro_quadratic,
    "delay": delay,
    "low pass": low_pass,
    "accelerometer quadratic": accel_quadratic,
    "accelerometer quadratic on a stand": accel_quadratic_on_stand,
}
VARIATIONS: Final = {
    "gyroscope bias switches": switching,
    "accelerometer bias switches": switching_force,
    "gyroscope bias swings": swinging,
    "supply voltage": supply,
    "accelerometer nonlinearity": nonlinear_accelerometer,
    "gyroscope nonlinearity": nonlinear_gyroscope,
    "flexing stand": flexing,
    "cubic on a flexing stand": cubic_on_flexing,
    "g-sensitivity on a flexing stand": g_sensitivity_on_flexing,
    "gyroscope louder in moves": loud_gyroscope,
    "accelerometer louder in moves": loud_accelerometer,
    "random walk of the gyroscope": random_walk,
    "random walk of the accelerometer": random_walk_force,
}
SESSIONS: Final = {
    "two temperatures": warm_and_cold,
    "another switch-on": switched_on_again,
    "biases and scales moved": moved_scales,
}
FAMILIES: Final = {**STRONG, **VARIATIONS, **SESSIONS}


def pose(family: str, index: int) -> tuple[imucal.Recording, imucal.Recording, Truth]:
    """Recording, control recording and truth of a case."""
    random = generator("units", family, index)
    unit = FAMILIES[family](random)
    sensors = Sensors.random(random)
    runs = []
    for name, degc in zip(("measured", "control"), unit.temperatures_degc, strict=True):
        own = sensors if name == "measured" else unit.second(sensors)
        runs.append(_run(unit, own, np.random.default_rng(random.integers(1 << 40)), degc, name))
    return runs[0], runs[1], unit.truth


def _run(unit: Unit, sensors: Sensors, random: Random, degc: float | None, name: str) -> imucal.Recording:
    motion = random_motion(random) if unit.flexure_rad is None else stand_motion(random, unit.flexure_rad)
    columns = {} if unit.columns is None else unit.columns(motion, random)
    rate = tuple(
        replace(own, values=columns[own.name]) if isinstance(own, Column) else own
        for own in unit.rate(random)
    )
    made = measured(
        sensors, motion, random, rate_error=rate, force_error=unit.force(random), temperature_degc=degc,
        name=name, louder_in_moves=unit.noise,
    )  # fmt: skip
    return replace(made, auxiliary=columns) if columns else made
