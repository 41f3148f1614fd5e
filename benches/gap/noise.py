"""Clean runs: nothing is missing, whatever the noise is."""

import dataclasses
from collections.abc import Callable, Iterator
from functools import cache
from typing import Final

import numpy as np

import imucal
from gap.case import Answer, Case, generator
from gap.scene import RATE_HZ, Scene
from gap.sizes import DEG, G
from imucal.rig.unit import unit_of

Random = np.random.Generator
QUIET: Final = Answer(verdicts=("nothing_missing",))
# Noise that wanders is not white: to say so is right, to name an effect is not.
WANDERING: Final = Answer(verdicts=("nothing_missing", "stochastic"))
LOUD: Final = Answer(verdicts=("nothing_missing", "data_fault"), fault="noise_grows_in_motion")


@cache
def paper_unit() -> imucal.Unit:
    """The paper's unit. Its file is read once, not for each of the thousands of cases."""
    return unit_of("paper")


def paper(
    *, accelerometer: dict[str, object] | None = None, gyroscope: dict[str, object] | None = None
) -> imucal.Unit:
    """The paper's unit with other noise or converters."""
    unit = paper_unit()
    return dataclasses.replace(
        unit,
        accelerometer=dataclasses.replace(unit.accelerometer, **(accelerometer or {})),
        gyroscope=dataclasses.replace(unit.gyroscope, **(gyroscope or {})),
    )


def sample_noise() -> dict[str, float]:
    """Standard deviation of one sample of the paper's unit."""
    unit = paper_unit()
    return {
        "accelerometer": unit.accelerometer.noise_density * np.sqrt(RATE_HZ),
        "gyroscope": unit.gyroscope.noise_density * np.sqrt(RATE_HZ),
    }


def loud_in_motion() -> Scene:
    return Scene(unit=paper(accelerometer={"noise_in_motion": 2.0}, gyroscope={"noise_in_motion": 2.0}))


def flicker() -> Scene:
    """As good consumer sensors: an Allan deviation that is flat at 3 deg/h and 20 ug."""
    floor = np.sqrt(2.0 * np.log(2.0) / np.pi)
    return Scene(
        unit=paper(
            accelerometer={"bias_instability": 20e-6 * G / floor},
            gyroscope={"bias_instability": 3.0 / 3600.0 * DEG / floor},
        )
    )


def outliers() -> Scene:
    """One sample of a thousand jumps by twenty standard deviations."""

    def make(std: float) -> Callable[[imucal.State, Random], np.ndarray]:
        def spikes(state: imucal.State, random: Random) -> np.ndarray:
            hit = random.uniform(size=(len(state.time_s), 1)) < 1e-3
            return hit * random.normal(scale=20.0 * std, size=(len(state.time_s), 3))

        return spikes

    return Scene(noise_like=tuple((sensor, make(std)) for sensor, std in sample_noise().items()))


def heavy_tails() -> Scene:
    """Student's t with three degrees of freedom instead of most of the normal noise."""

    def make(std: float) -> Callable[[imucal.State, Random], np.ndarray]:
        return lambda state, random: std / np.sqrt(3.0) * random.standard_t(3.0, size=(len(state.time_s), 3))

    return Scene(noise_like=tuple((sensor, make(std)) for sensor, std in sample_noise().items()))


def loud_axis() -> Scene:
    """The z axes are three times as noisy as the others."""

    def make(std: float) -> Callable[[imucal.State, Random], np.ndarray]:
        wide = np.array([0.0, 0.0, np.sqrt(8.0) * std])
        return lambda state, random: wide * random.normal(size=(len(state.time_s), 3))

    return Scene(noise_like=tuple((sensor, make(std)) for sensor, std in sample_noise().items()))


def coarse_counts() -> Scene:
    """Counts of one and a half standard deviations."""
    std = sample_noise()
    return Scene(
        unit=paper(
            accelerometer={"lsb": 1.5 * std["accelerometer"], "bits": 16},
            gyroscope={"lsb": 1.5 * std["gyroscope"], "bits": 16},
        )
    )


def shaking_stand() -> Scene:
    """Vibration while the motors turn: true motion, that the sampling cannot follow."""
    return Scene(stand=imucal.Stand(vibration_deg=0.01, vibration_mm=0.02, vibration_hz=37.0))


KINDS: Final[dict[str, tuple[Callable[[], Scene], Answer]]] = {
    "white": (Scene, QUIET),
    "twice as loud in motion": (loud_in_motion, LOUD),
    "flicker": (flicker, WANDERING),
    "outliers": (outliers, QUIET),
    "heavy tails": (heavy_tails, QUIET),
    "filter-coloured": (lambda: Scene(filter_hz=15.0), QUIET),
    "coarse counts": (coarse_counts, QUIET),
    "a loud axis": (loud_axis, QUIET),
    "stand that shakes": (shaking_stand, QUIET),
}
# White noise in all the kinds of data that there are.
DATA: Final = ("A", "AT", "A'", "A'T", "C", "CT")


def clean(white: int, others: int) -> Iterator[Case]:
    """White noise in every kind of data, and the other kinds of noise in rests and moves."""
    for number, data in enumerate(DATA):
        for index in range(white // len(DATA) + (number < white % len(DATA))):
            unit = "paper" if index % 2 == 0 else f"random:paper:{generator('unit', index).integers(2**31)}"
            yield Case("clean", "white", index, Scene(data, unit=unit), QUIET, level=data)
    for label, (make, answer) in KINDS.items():
        if label == "white":
            continue
        for index in range(others):
            yield Case("clean", label, index, make(), answer)
