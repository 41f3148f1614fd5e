"""Recordings of units whose sensors remember the temperature: a lag, a lead, or a hysteresis of a bias.

The truth is made by `analytic` and by the operators here, without the product's simulator: the lag by
convolution of the temperature with an exponential, the hysteresis by relays. The part of the error that is no
straight line in the temperature is scaled so that it changes chi2 of the recording, after the base parameters
and such a line are fitted, as an effect of five times the detection limit does, or of 20 times in a strong
family.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

import imucal
from gap.analytic import RATE_HZ, Motion, Sensors, measured, random_motion
from gap.case import generator
from gap.law_cases import size_of_columns, std_of_first, vector

__all__ = ["CLEAN", "FAMILIES", "Memory", "pose"]

Random = np.random.Generator
# Steps of the temperatures at which relays switch, K, and number of samples between two states of the relays.
RELAY_STEP_K: Final = 0.02
RELAY_SAMPLES: Final = 10


@dataclass(frozen=True)
class Memory:
    """The truth: sensor, names of effects that are right, the error of a temperature column, and tau.

    `tau_bound_s` is the smallest standard deviation of tau that the recording permits. The size of the error
    is `times` that of an effect of five times the detection limit.
    """

    sensor: str
    names: frozenset[str]
    history: Callable[[np.ndarray], np.ndarray]
    size: np.ndarray
    slope: np.ndarray
    tau_s: float | None = None
    tau_bound_s: float | None = None
    times: float = 1.0


def behind(degc: np.ndarray, tau_s: float) -> np.ndarray:
    """The temperature of a body behind `degc`, which was constant for long before the first sample."""
    kernel = np.exp(-np.arange(round(12.0 * tau_s * RATE_HZ)) / (RATE_HZ * tau_s))
    padded = np.concatenate((np.full(len(kernel), degc[0]), degc))
    length = 1 << int(np.ceil(np.log2(len(padded) + len(kernel))))
    product = np.fft.rfft(padded, length) * np.fft.rfft(kernel / kernel.sum(), length)
    behind_it: np.ndarray = np.fft.irfft(product, length)[len(kernel) : len(padded)]
    return behind_it


def of_relays(degc: np.ndarray, widths_k: np.ndarray) -> np.ndarray:
    """The loop between heating and cooling, 1 to -1: relays at all temperatures, each with a width."""
    brief = degc[::RELAY_SAMPLES]
    middles = np.arange(brief.min() - 4.0, brief.max() + 4.0, RELAY_STEP_K)
    on, off = (middles[:, None] + side * widths_k for side in (1.0, -1.0))
    state = np.where(brief[0] > middles[:, None] + 0.0 * widths_k, 1.0, -1.0)
    loop = np.empty(len(brief))
    start = RELAY_STEP_K / 2.0 * state.sum(axis=0) - brief[0]
    for k, now in enumerate(brief):
        state[now > on] = 1.0
        state[now < off] = -1.0
        loop[k] = np.mean((now + start - RELAY_STEP_K / 2.0 * state.sum(axis=0)) / widths_k)
    return np.interp(np.arange(len(degc)), np.arange(len(brief)) * RELAY_SAMPLES, loop)


def sensor_of(random: Random) -> str:
    return str(random.choice(["gyroscope", "accelerometer"]))


def name_of(sensor: str, kind: str) -> str:
    return f"{'gyro' if sensor == 'gyroscope' else 'accel'}_bias_temperature_{kind}"


def lag(random: Random) -> Memory:
    """The sensor follows its thermometer with 12 to 40 s."""
    tau_s, sensor, size = float(random.uniform(12.0, 40.0)), sensor_of(random), vector(random)
    names = frozenset({name_of(sensor, "lag")})
    return Memory(sensor, names, lambda degc: behind(degc, tau_s) - degc, size, size, tau_s)


def lead(random: Random) -> Memory:
    """A part of the bias responds to the temperature at once and fades within 12 to 40 s."""
    own = lag(random)
    return replace(own, size=-own.size, slope=0.3 * own.slope)


def hysteresis(random: Random) -> Memory:
    """Heating and cooling are apart, and after a reversal of 0.8 to 2.4 K the branch is the other one."""
    sensor, widths = sensor_of(random), random.uniform(0.4, 1.2, size=4)
    names = frozenset({name_of(sensor, "hysteresis")})
    return Memory(sensor, names, lambda degc: of_relays(degc, widths), vector(random), 0.05 * vector(random))


def rate(random: Random) -> Memory:
    """A temperature gradient changes the bias."""
    sensor = sensor_of(random)
    names = frozenset({name_of(sensor, "rate")})
    slope = 0.05 * vector(random)
    return Memory(sensor, names, lambda degc: RATE_HZ * np.gradient(degc), vector(random), slope)


FAMILIES: Final[dict[str, Callable[[Random], Memory]]] = {
    "lag": lag,
    "lead": lead,
    "rate": rate,
    "hysteresis": hysteresis,
    "strong lag": lambda random: replace(lag(random), times=4.0),
    "strong lead": lambda random: replace(lead(random), times=4.0),
}
# Families without a memory, and the degree of the polynomial in the temperature.
CLEAN: Final = {
    "clean": 0,
    "line in the temperature": 1,
    "quadratic in the temperature": 2,
    "cubic in the temperature": 3,
}
# Temperature difference at which all powers of a polynomial contribute equally, K.
BEND_K: Final = 10.0


def profile(random: Random, time_s: np.ndarray) -> np.ndarray:
    """Heating and cooling of 15 to 30 K in two cycles, with faster swings of 2 to 5 K."""
    span, swing = random.uniform(15.0, 30.0), random.uniform(2.0, 5.0)
    slow, fast = time_s[-1] / random.uniform(1.7, 2.3), time_s[-1] / random.uniform(5.0, 9.0)
    phases = random.uniform(0.0, 2.0 * np.pi, size=2)
    return np.asarray(
        28.0
        + 0.5 * span * np.sin(2.0 * np.pi * time_s / slow + phases[0])
        + swing * np.sin(2.0 * np.pi * time_s / fast + phases[1])
    )


def record(
    unit: Sensors,
    motion: Motion,
    degc: np.ndarray,
    random: Random,
    error: np.ndarray | None,
    sensor: str,
    name: str,
) -> imucal.Recording:
    given = () if error is None else (lambda _: error,)
    is_rate = sensor == "gyroscope"
    return measured(
        unit, motion, random, rate_error=given if is_rate else (), force_error=() if is_rate else given,
        temperature_degc=degc, name=name,
    )  # fmt: skip


def size_of(truth: Memory, history: np.ndarray, degc: np.ndarray, ideal: imucal.Recording) -> float:
    """The size of a history of five times the detection limit beside a line in the temperature."""
    own = history[:, None] * truth.size
    line = (degc - degc.mean())[:, None, None] * np.eye(3)
    columns = np.concatenate((own[:, :, None], line), axis=2)
    return size_of_columns(truth.sensor, (1e-3, 1e-3, 1e-3, 1e-3), columns, ideal)


def bound_of_tau(
    truth: Memory, tau_s: float, size: float, degc: np.ndarray, ideal: imucal.Recording
) -> float:
    """The Cramér-Rao bound of tau beside the coefficients of the lag and of the temperature."""
    step_s = 0.01 * tau_s
    by_tau = (behind(degc, tau_s + step_s) - behind(degc, tau_s - step_s)) / (2.0 * step_s)
    own = size * by_tau[:, None, None] * truth.size[:, None]
    others = [each[:, None, None] * np.eye(3) for each in (truth.history(degc), degc - degc.mean())]
    return std_of_first(truth.sensor, (1e-3,) * 7, np.concatenate((own, *others), axis=2), ideal)


def pose(
    family: str, index: int
) -> tuple[imucal.Recording, imucal.Recording, Memory | None, list[imucal.Recording]]:
    """Recording, control recording, truth, and both recordings without the error."""
    random = generator("thermal", family, index)
    truth = FAMILIES[family](random) if family in FAMILIES else None
    unit = Sensors.random(random)
    ideal = Sensors(np.eye(3), np.zeros(3), np.eye(3), np.zeros(3))
    seeds = [int(seed) for seed in random.integers(1 << 40, size=2)]
    motions = [random_motion(random) for _ in seeds]
    degc = [profile(random, motion.time_s) for motion in motions]
    sensor = truth.sensor if truth is not None else sensor_of(random)
    errors: list[np.ndarray | None] = [None, None]
    if truth is not None:
        histories = [truth.history(own) for own in degc]
        blank = record(ideal, motions[0], degc[0], np.random.default_rng(seeds[0]), None, sensor, "ideal")
        size = truth.times * size_of(truth, histories[0], degc[0], blank)
        if truth.tau_s is not None:
            truth = replace(truth, tau_bound_s=bound_of_tau(truth, truth.tau_s, size, degc[0], blank))
        errors = [
            size * (history[:, None] * truth.size + (own - 28.0)[:, None] * truth.slope)
            for history, own in zip(histories, degc, strict=True)
        ]
    elif CLEAN[family]:
        size = BEND_K * (2e-4 if sensor == "gyroscope" else 2e-3)
        powers = [(power, size * vector(random)) for power in range(1, CLEAN[family] + 1)]
        errors = [
            np.sum([((own - 28.0) / BEND_K)[:, None] ** power * term for power, term in powers], axis=0)
            for own in degc
        ]
    made = []
    for own_errors in (errors, [None, None]):
        made += [
            record(unit, motion, own, np.random.default_rng(seed), error, sensor, name)
            for motion, own, seed, error, name in zip(
                motions, degc, seeds, own_errors, ("measured", "control"), strict=True
            )
        ]
    return made[0], made[1], truth, made[2:]
