"""Predicted standard deviations, over the errors of calibrations of simulated runs."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np

import imucal
from imucal.planning.plan import CoreSensors
from imucal.rig.motion import Motion
from imucal.rig.stand_limits import NAMED
from imucal.rig.unit import unit_of
from imucal.units import STANDARD_GRAVITY_MPS2

RATE_HZ = 100.0
HAND_TREMOR_DEG = 0.05
# What the worst of each group is to reach; fine is about what the paper's two programs reach together.
COARSE = {
    "accel_sensitivity": "50 ppm",
    "accel_bias": "50 ug",
    "gyro_sensitivity": 2e-4,
    "gyro_bias": 5e-5,
}
FINE = {
    "accel_sensitivity": "11 ppm",
    "accel_bias": "10 ug",
    "gyro_sensitivity": 1.3e-4,
    "gyro_bias": 2.8e-5,
}
SLOW = imucal.StandLimits(
    (
        imucal.AxisLimits(60.0, 120.0, range_deg=(-170.0, 170.0)),
        imucal.AxisLimits(60.0, 120.0, range_deg=(-95.0, 95.0)),
        imucal.AxisLimits(60.0, 120.0, cable_wrap_deg=400.0),
    )
)


@dataclass(frozen=True)
class Case:
    """Motions of one calibration.

    tremor_deg  of the hand that holds the unit; each run has its own tremor, and a tumble its own poses
    """

    name: str
    motions: tuple[Motion, ...]
    tremor_deg: float = 0.0

    def errors(self, seed: int) -> tuple[np.ndarray, np.ndarray, bool]:
        """Error and stated standard deviation over the predicted one, and whether all rests were found."""
        motions = [self._by_hand(motion, seed) for motion in self.motions]
        runs = [imucal.simulate(m, seed=10 * seed + k, rate_hz=RATE_HZ) for k, m in enumerate(motions)]
        # In a hand there are no encoders.
        records = [
            dataclasses.replace(run.recording, stand_rad=None) if self.tremor_deg else run.recording
            for run in runs
        ]
        result = imucal.calibrate(records)
        truth = {p.name: p.value for p in runs[0].truth.calibration.parameters}
        rests = sum(len(run.truth.rests) for run in runs)
        error = np.array([p.value - truth[p.name] for p in result.parameters])
        sigma = predicted(motions, in_hand=self.tremor_deg > 0)
        return error / sigma, np.array([p.std for p in result.parameters]) / sigma, len(result.rests) == rests

    def _by_hand(self, motion: Motion, seed: int) -> Motion:
        if isinstance(motion, imucal.Tumble):
            return dataclasses.replace(motion, seed=seed, tremor_deg=self.tremor_deg)
        if isinstance(motion, imucal.Program) and self.tremor_deg:
            return imucal.Program(motion.steps, imucal.Stand(tremor_deg=self.tremor_deg, tremor_seed=seed))
        return motion


def predicted(motions: list[Motion], *, in_hand: bool) -> np.ndarray:
    """Standard deviations of one calibration of all these motions."""
    import imucal._core as _core

    # The tremor is no part of the plan.
    still = [
        imucal.Program(m.steps)
        if isinstance(m, imucal.Program)
        else dataclasses.replace(m, tremor_deg=0.0)
        if isinstance(m, imucal.Tumble)
        else m
        for m in motions
    ]
    sensors = CoreSensors(unit_of("paper"), RATE_HZ, STANDARD_GRAVITY_MPS2, (), 0.0, "full", (), ())
    return np.array(_core.predict_sigma(sensors, [m.in_si() for m in still], 1.0, 0.0, in_hand)[0])


# The paper's programs, optimal ones on several stands, and runs by hand: motions, and the tremor in deg.
PROGRAMS: Final[dict[str, tuple[Callable[[], tuple[Motion, ...]], float]]] = {
    "random": (lambda: (imucal.Program.random(seed=1),), 0.0),
    "grid and random": (lambda: (imucal.Program.grid(), imucal.Program.random(seed=1)), 0.0),
    "optimal: coarse targets": (lambda: _optimal(targets=COARSE), 0.0),
    "optimal: fine targets": (lambda: _optimal(targets=FINE), 0.0),
    "optimal: 2 min": (lambda: _optimal(minutes=2.0), 0.0),
    "optimal: two-axis stand, 3 min": (lambda: _optimal(stand="two-axis", minutes=3.0), 0.0),
    "optimal: slow stand with end stops, 4 min": (lambda: _optimal(stand=SLOW, minutes=4.0), 0.0),
    "by hand": (lambda: (imucal.Tumble(1),), 0.0),
    "by hand that trembles": (lambda: (imucal.Tumble(1),), HAND_TREMOR_DEG),
    "card of poses, 4 min, by a hand that trembles": (
        # The simulated hand needs no time to settle: all of each rest counts.
        lambda: _optimal(stand=dataclasses.replace(NAMED["hand"], settle_s=0.0), minutes=4.0),
        HAND_TREMOR_DEG,
    ),
}


@cache
def case_of(name: str) -> Case:
    """The case of a program; the search for an optimal one takes seconds."""
    motions, tremor_deg = PROGRAMS[name]
    return Case(name, motions(), tremor_deg)


def errors_of(name: str, seed: int) -> tuple[np.ndarray, np.ndarray, bool]:
    """`Case.errors` of a program by its name."""
    return case_of(name).errors(seed)


def _optimal(**options: object) -> tuple[Motion, ...]:
    return (planned("optimal", **options).motion,)


def planned(kind: str | Motion, **options: object) -> imucal.Plan:
    return imucal.plan(kind, rate_hz=RATE_HZ, detection_limits=False, **options)  # type: ignore[arg-type]


@dataclass(frozen=True)
class Agreement:
    """Rms error over predicted standard deviation."""

    name: str
    minutes: float
    runs: int
    ratio: np.ndarray
    stated: np.ndarray
    complete: int

    @staticmethod
    def of(case: Case, minutes: float, found: list[tuple[np.ndarray, np.ndarray, bool]]) -> Agreement:
        error, stated = (np.sqrt(np.mean([run[k] ** 2 for run in found], axis=0)) for k in (0, 1))
        return Agreement(case.name, minutes, len(found), error, stated, sum(run[2] for run in found))

    @property
    def chance(self) -> float:
        """Standard deviation of each ratio by chance."""
        return 1.0 / np.sqrt(2.0 * self.runs)

    @property
    def worst(self) -> float:
        """The ratio that is furthest from one."""
        return float(self.ratio[np.argmax(np.abs(self.ratio - 1.0))])
