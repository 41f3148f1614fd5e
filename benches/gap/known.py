"""Known effects beside unknown and random ones, two sessions, and effects that cancel; see `analytic`.

The recordings of these families are not made by the product's simulator.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

import imucal
from gap.analytic import DEG, Error, G, Motion, Sensors, heading, measured, random_motion, walk
from gap.case import Answer, Case, Sealed, generator
from gap.scene import Scene

Random = np.random.Generator
GROUPS: Final = ("known + unknown", "known + random", "two sessions", "cancelling")


@dataclass(frozen=True)
class Errors:
    """Errors of both sensors, drawn for one recording."""

    rate: tuple[Error, ...] = ()
    force: tuple[Error, ...] = ()


@dataclass(frozen=True)
class Session:
    """What differs from one recording to the next."""

    force_bias: np.ndarray = field(default_factory=lambda: np.zeros(3))
    rate_bias: np.ndarray = field(default_factory=lambda: np.zeros(3))
    force_scale: float = 0.0
    rate_scale: float = 0.0
    temperature_degc: float | None = None


@dataclass(frozen=True)
class AnalyticCase(Case):
    """A case whose recordings come from `analytic`.

    errors    makes the errors of one recording; what varies from run to run is drawn from its argument
    sessions  of the recording and of the control recording
    """

    errors: Callable[[Random], Errors] = field(default=lambda _: Errors(), repr=False)
    sessions: tuple[Session, Session] = field(default=(Session(), Session()), repr=False)

    def pose(self) -> tuple[imucal.Recording, imucal.Recording, Sealed]:
        """The recording, the control recording, and the sealed answer."""
        unit = Sensors.random(np.random.default_rng([self.seed, 7]))
        runs = []
        for session, seed, name in zip(
            self.sessions, (self.seed, self.control_seed), ("measured", "control"), strict=True
        ):
            random = np.random.default_rng([seed, 8])
            own = replace(
                unit,
                force_matrix=unit.force_matrix * (1.0 + session.force_scale),
                rate_matrix=unit.rate_matrix * (1.0 + session.rate_scale),
                force_bias=unit.force_bias + session.force_bias,
                rate_bias=unit.rate_bias + session.rate_bias,
            )
            errors = self.errors(random)
            runs.append(
                measured(
                    own, random_motion(random), random, rate_error=errors.rate, force_error=errors.force,
                    temperature_degc=session.temperature_degc, name=name,
                )
            )  # fmt: skip
        return runs[0], runs[1], Sealed(self.answer, Scene())


def accel_quadratic(random: Random) -> tuple[imucal.EffectValues, Errors]:
    """0.5 to 1.5 % per g."""
    k = random.uniform(0.005, 0.015) / G * signs(random)
    values = imucal.EffectValues("accel_scale_quadratic", k)
    return values, Errors(force=(lambda motion: k * motion.force**2,))


def gyro_cubic(random: Random) -> tuple[imucal.EffectValues, Errors]:
    """1 to 4 % at 120 deg/s."""
    k = random.uniform(0.01, 0.04) / (120.0 * DEG) ** 2 * signs(random)
    return imucal.EffectValues("gyro_scale_cubic", k), Errors(rate=(lambda motion: k * motion.rate**3,))


def g_sensitivity(random: Random) -> tuple[imucal.EffectValues, Errors]:
    """0.05 to 0.15 deg/s per g."""
    matrix = random.normal(size=(3, 3))
    matrix *= random.uniform(0.05, 0.15) * DEG / G * 3.0 / np.linalg.norm(matrix)
    values = imucal.EffectValues("gyro_g_sensitivity", matrix.ravel())
    return values, Errors(rate=(lambda motion: motion.force @ matrix.T,))


def signs(random: Random) -> np.ndarray:
    """Three factors of either sign, 0.5 to 1."""
    return random.uniform(0.5, 1.0, size=3) * random.choice([-1.0, 1.0], size=3)


KNOWN: Final = {
    "accelerometer quadratic": accel_quadratic,
    "gyroscope cubic": gyro_cubic,
    "g-sensitivity": g_sensitivity,
}


def switching(random: Random) -> Error:
    """A load that switches on and off."""
    size, period_s = random.normal(size=3) * 0.05 * DEG, random.uniform(40.0, 90.0)
    phase = random.uniform()
    return lambda motion: np.where(((motion.time_s / period_s + phase) % 1.0 < 0.5)[:, None], size, 0.0)


def swinging(random: Random) -> Error:
    """A bias that swings slowly."""
    size, period_s = random.normal(size=3) * 0.03 * DEG, random.uniform(60.0, 150.0)
    phase = random.uniform(0.0, 2.0 * np.pi)
    return lambda motion: size * np.sin(2.0 * np.pi * motion.time_s / period_s + phase)[:, None]


UNKNOWN: Final[dict[str, Callable[[Random], Error]]] = {
    "heading": lambda random: heading(random, random.uniform(0.03, 0.08) * DEG),
    "switching": switching,
    "swinging": swinging,
}


def known_and_unknown(runs: int) -> Iterator[Case]:
    """A known effect beside a gyroscope bias that no effect describes."""
    for name, make in KNOWN.items():
        for label, make_unknown in UNKNOWN.items():
            if (name, label) == ("g-sensitivity", "heading"):
                # The vertical part of a field that turns with the heading looks like a g-sensitivity.
                continue
            for index in range(runs):
                random = generator("known + unknown", name, label, index)
                values, known = make(random)
                unknown = make_unknown(random)
                errors = replace(known, rate=(*known.rate, unknown))
                answer = Answer((values,), ("named", "ambiguous"), block="gyroscope bias")
                yield AnalyticCase(
                    "known + unknown", f"{name}, {label}", index, Scene(), answer,
                    errors=lambda _, errors=errors: errors,
                )  # fmt: skip


def known_and_random(runs: int) -> Iterator[Case]:
    """A known effect beside a random walk of the gyroscope's bias of 1 to 3 mdeg/s/sqrt(s)."""
    for name, make in KNOWN.items():
        for index in range(runs):
            random = generator("known + random", name, index)
            values, known = make(random)
            size = random.uniform(1e-3, 3e-3) * DEG

            def errors(random: Random, known: Errors = known, size: float = size) -> Errors:
                return replace(known, rate=(*known.rate, walk(random, size)))

            answer = Answer((values,), ("named", "ambiguous"), block="gyroscope bias")
            yield AnalyticCase("known + random", name, index, Scene(), answer, errors=errors)


def two_sessions(runs: int) -> Iterator[Case]:
    """Two sessions at temperatures 10 to 30 K apart, of which the recordings know or not."""
    for label in ("recorded", "not recorded"):
        for index in range(runs):
            random = generator("two sessions", label, index)
            change_k = random.uniform(10.0, 30.0) * random.choice([-1.0, 1.0])
            is_known = label == "recorded"
            second = Session(
                force_bias=random.normal(size=3) * 0.2e-3 * G * change_k,
                rate_bias=random.normal(size=3) * 0.015 * DEG * change_k,
                force_scale=random.normal() * 2e-5 * change_k if index % 2 else 0.0,
                rate_scale=random.normal() * 3e-5 * change_k if index % 2 else 0.0,
                temperature_degc=25.0 + change_k if is_known else None,
            )
            first = Session(temperature_degc=25.0 if is_known else None)
            yield AnalyticCase(
                "two sessions", f"temperature {label}", index, Scene(), Answer(verdicts=("unknown",)),
                sessions=(first, second),
            )  # fmt: skip


def cancelling(runs: int) -> Iterator[Case]:
    """Two effects of one sensor that cancel in a part of the range."""
    for index in range(runs):
        random = generator("cancelling", index)
        size, peak = random.uniform(0.005, 0.02) * signs(random), 120.0 * DEG
        quadratic, asymmetry = size / peak, -size * random.uniform(0.7, 1.3)
        effects = (
            imucal.EffectValues("gyro_scale_quadratic", quadratic),
            imucal.EffectValues("gyro_scale_asymmetry", asymmetry),
        )

        def both(motion: Motion, a: np.ndarray = quadratic, b: np.ndarray = asymmetry) -> np.ndarray:
            return a * motion.rate**2 + b * np.abs(motion.rate)

        yield AnalyticCase(
            "cancelling", "quadratic, asymmetry", index, Scene(), Answer(effects),
            errors=lambda _, both=both: Errors(rate=(both,)),
        )  # fmt: skip
