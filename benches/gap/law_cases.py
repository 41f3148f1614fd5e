"""Recordings with an error that no effect of the catalogue describes, as a law of an observed variable.

The truth is made by `analytic`, without the product's simulator. Each error is scaled so that it changes chi2
of the recording, after the base parameters are fitted, as an effect of five times the detection limit does.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

import imucal
import imucal._core as _core
from gap.analytic import DEG, RATE_HZ, G, Motion, Sensors, measured, random_motion
from gap.case import generator
from imucal.estimation.options import Options, UserField

Random = np.random.Generator
# Noncentrality of chi2 with one degree of freedom that 90 % power at a family-wise alpha of 0.01 among some
# 50 candidates needs.
NONCENTRALITY: Final = 27.0
TIMES: Final = 5.0
OPTIONS: Final = Options(gravity_mps2=G, min_rest_s=1.0)


@dataclass(frozen=True)
class Run:
    """A motion, with temperature and further columns."""

    motion: Motion
    columns: dict[str, np.ndarray]
    degc: np.ndarray | None = None


@dataclass(frozen=True)
class Law:
    """The truth: sensor, variables that are right for it, and the error of a run, (N, 3)."""

    sensor: str
    variables: frozenset[str]
    error: Callable[[Run], np.ndarray]


def vector(random: Random) -> np.ndarray:
    return random.uniform(0.5, 1.0, size=3) * random.choice([-1.0, 1.0], size=3)


def dead_zone(random: Random) -> Law:
    """Rates below 2 to 6 deg/s are partly lost."""
    edge, size = random.uniform(2.0, 6.0) * DEG, vector(random)
    return Law(
        "gyroscope",
        frozenset({"w"}),
        lambda run: (
            size * np.where(np.abs(run.motion.rate) < edge, run.motion.rate, edge * np.sign(run.motion.rate))
        ),
    )


def saturation(random: Random) -> Law:
    """Rates above 30 to 60 deg/s are compressed."""
    edge, size = random.uniform(30.0, 60.0) * DEG, np.abs(vector(random))

    def error(run: Run) -> np.ndarray:
        beyond = np.abs(run.motion.rate) - edge
        return -size * np.sign(run.motion.rate) * np.where(beyond > 0, beyond, 0.0)

    return Law("gyroscope", frozenset({"w"}), error)


def settling(random: Random) -> Law:
    """The bias returns after each stop, with 0.8 to 3 s."""
    tau_s, size = random.uniform(0.8, 3.0), vector(random)

    def error(run: Run) -> np.ndarray:
        level, after = np.empty(len(run.motion.time_s)), 1.0
        for k, at_rest in enumerate(run.motion.is_rest):
            after = after * (1.0 - 1.0 / (RATE_HZ * tau_s)) if at_rest else 1.0
            level[k] = after
        return size * level[:, None]

    return Law("gyroscope", frozenset({"rest_s"}), error)


def periodic(random: Random) -> Law:
    """The gyroscope's bias goes up and down one to four times per turn of a table."""
    times, phase, size = random.integers(1, 5), random.uniform(0, 2 * np.pi, 3), vector(random)
    return Law(
        "gyroscope",
        frozenset({"table_rad"}),
        lambda run: size * np.cos(times * run.columns["table_rad"][:, None] - phase),
    )


def cubic_temperature(random: Random) -> Law:
    size, degc = vector(random), random.uniform(28.0, 36.0)
    sensor = random.choice(["gyroscope", "accelerometer"])
    return Law(
        str(sensor), frozenset({"temp_degc"}), lambda run: size * (((run.degc - degc) / 10.0) ** 3)[:, None]
    )


def switching(random: Random) -> Law:
    """A bias that a fan beyond some speed causes."""
    size, edge = vector(random), random.uniform(1200.0, 2000.0)
    return Law(
        "gyroscope",
        frozenset({"fan_rpm"}),
        lambda run: np.where((run.columns["fan_rpm"] >= edge)[:, None], size, 0.0),
    )


def supply(random: Random) -> Law:
    size, sensor = vector(random), random.choice(["gyroscope", "accelerometer"])
    return Law(
        str(sensor), frozenset({"supply_v"}), lambda run: size * (run.columns["supply_v"][:, None] - 3.3)
    )


def nonlinearity(random: Random) -> Law:
    """Integral nonlinearity of the accelerometer's converter: one to two waves over 2 g."""
    period, phase, size = G * random.uniform(1.0, 2.0), random.uniform(0, 2 * np.pi, 3), vector(random)
    return Law(
        "accelerometer",
        frozenset({"f"}),
        lambda run: size * np.sin(2 * np.pi * run.motion.force / period + phase),
    )


FAMILIES: Final[dict[str, Callable[[Random], Law]]] = {
    "dead zone": dead_zone,
    "saturation": saturation,
    "settling after stops": settling,
    "periodic in an angle": periodic,
    "cubic in temperature": cubic_temperature,
    "switching by a column": switching,
    "auxiliary column": supply,
    "integral nonlinearity": nonlinearity,
}


def run_of(random: Random, family: str) -> Run:
    """One run with the columns that the family's unit records."""
    motion = random_motion(random)
    time_s, count = motion.time_s, len(motion.time_s)
    columns: dict[str, np.ndarray] = {}
    degc = None
    if family == "periodic in an angle":
        poses = np.where(motion.is_rest, 0, 1)
        moves = np.cumsum(np.diff(poses, prepend=0) == 1)
        turns = random.uniform(-1.5, 1.5, size=moves.max() + 1)
        share = np.convolve(poses, np.ones(1), "same")
        speed = turns[moves] * share * np.sin(np.pi * (time_s % 7.0 - 5.0) / 2.0).clip(0.0)
        columns["table_rad"] = np.cumsum(speed) / RATE_HZ * np.pi / 2.0 + random.uniform(-np.pi, np.pi)
    if family in ("cubic in temperature", "clean, temperature"):
        top = random.uniform(20.0, 30.0)
        degc = 20.0 + top * np.sin(np.pi * time_s / time_s[-1]) ** 2
    if family in ("switching by a column", "clean, columns"):
        steps = random.uniform(500.0, 3000.0, size=40)
        columns["fan_rpm"] = steps[(time_s / 11.0).astype(int) % 40] + random.normal(scale=20.0, size=count)
    if family in ("auxiliary column", "clean, columns"):
        load = np.sin(2 * np.pi * time_s / random.uniform(40, 90)) > random.uniform(-0.3, 0.3)
        columns["supply_v"] = 3.5 - 6e-4 * time_s - 0.12 * load + random.normal(scale=0.01, size=count)
    return Run(motion, columns, degc)


def record(
    unit: Sensors, run: Run, random: Random, law: Law | None, size: float, name: str
) -> imucal.Recording:
    """The recording of a run by a unit with the law of this size."""
    error = (lambda _: size * law.error(run),) if law is not None and size else ()
    is_rate = law is not None and law.sensor == "gyroscope"
    made = measured(
        unit, run.motion, random, rate_error=error if is_rate else (), force_error=() if is_rate else error,
        temperature_degc=run.degc, name=name,
    )  # fmt: skip
    return replace(made, auxiliary=run.columns) if run.columns else made


def size_of(law: Law, run: Run, recording: imucal.Recording) -> float:
    """The size of an error of five times the detection limit; `recording` is of an ideal unit without it."""
    field = law.error(run)
    typical = (1.0 / float(np.sqrt(np.mean(field**2))) * 1e-3,)
    return size_of_columns(law.sensor, typical, field[:, :, None], recording)


def size_of_columns(
    sensor: str, typical: tuple[float, ...], columns: np.ndarray, recording: imucal.Recording
) -> float:
    """The size of the first of `columns` (N, 3, p) with five times the detection limit of `recording`."""
    return TIMES * float(np.sqrt(NONCENTRALITY)) * std_of_first(sensor, typical, columns, recording)


def std_of_first(
    sensor: str, typical: tuple[float, ...], columns: np.ndarray, recording: imucal.Recording
) -> float:
    """The Cramér-Rao bound of the coefficient of the first of `columns` (N, 3, p), a standard deviation.

    The base parameters and the coefficients of the other columns are estimated, too.
    """
    given = UserField("truth", sensor, typical, (np.ascontiguousarray(columns),))
    design = _core.gap_design([recording], replace(OPTIONS, user_fields=(given,)), [])
    whitened = dict(design.effects)["truth"]
    others = np.hstack((design.base, whitened[:, 1:]))
    base, _ = np.linalg.qr(others / np.linalg.norm(others, axis=0))
    left = whitened[:, 0] - base @ (base.T @ whitened[:, 0])
    return float(1.0 / np.sqrt(left @ left))


def pose(
    family: str, index: int
) -> tuple[imucal.Recording, imucal.Recording, Law | None, list[imucal.Recording]]:
    """Recording, control recording, truth, and both recordings without the error."""
    random = generator("laws", family, index)
    law = FAMILIES[family](random) if family in FAMILIES else None
    unit = Sensors.random(random)
    ideal = Sensors(np.eye(3), np.zeros(3), np.eye(3), np.zeros(3))
    seeds = [int(seed) for seed in random.integers(1 << 40, size=2)]
    runs = [run_of(random, family) for _ in seeds]
    size = 0.0
    if law is not None:
        noise = np.random.default_rng(seeds[0])
        size = size_of(law, runs[0], record(ideal, runs[0], noise, None, 0.0, "ideal"))
    made = []
    for with_law in (size, 0.0):
        made += [
            record(unit, run, np.random.default_rng(seed), law, with_law, name)
            for run, seed, name in zip(runs, seeds, ("measured", "control"), strict=True)
        ]
    return made[0], made[1], law, made[2:]
