"""Predicted standard deviations, over the errors of calibrations of simulated runs."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

import imucal
from imucal.motion import Motion
from imucal.stand_limits import NAMED

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
    """Motions of one calibration, and what is predicted of them."""

    name: str
    motions: tuple[Motion, ...]
    sigma: np.ndarray
    in_hand: bool = False

    def errors(self, seed: int) -> tuple[np.ndarray, np.ndarray, bool]:
        """Error and stated standard deviation of each parameter, and whether all rests were found."""
        runs = [
            imucal.simulate(self._held(motion), seed=10 * seed + k, rate_hz=RATE_HZ)
            for k, motion in enumerate(self.motions)
        ]
        # In a hand there are no encoders.
        records = [
            dataclasses.replace(run.recording, stand_rad=None) if self.in_hand else run.recording
            for run in runs
        ]
        result = imucal.calibrate(records)
        truth = {p.name: p.value for p in runs[0].truth.calibration.parameters}
        planned = sum(len(run.truth.rests) for run in runs)
        error = np.array([p.value - truth[p.name] for p in result.parameters])
        return error, np.array([p.std for p in result.parameters]), len(result.rests) == planned

    def _held(self, motion: Motion) -> Motion:
        if self.in_hand and isinstance(motion, imucal.Program):
            return imucal.Program(motion.steps, imucal.Stand(tremor_deg=HAND_TREMOR_DEG, tremor_seed=1))
        return motion


def cases() -> list[Case]:
    """The paper's programs, optimal ones on several stands, and runs by hand."""
    grid, random = (planned(name) for name in ("grid", "random"))
    by_hand = {
        "by hand": imucal.Tumble(1),
        "by hand that trembles": imucal.Tumble(1, tremor_deg=HAND_TREMOR_DEG),
    }
    # The simulated hand needs no time to settle: all of each rest counts.
    card = planned("optimal", stand=dataclasses.replace(NAMED["hand"], settle_s=0.0), minutes=4.0)
    return [
        Case("random", (random.motion,), _sigma(random)),
        Case("grid and random", (grid.motion, random.motion), _together(grid.motion, random.motion)),
        *(
            Case(f"optimal: {name}", (plan.motion,), _sigma(plan))
            for name, plan in {
                "coarse targets": planned("optimal", targets=COARSE),
                "fine targets": planned("optimal", targets=FINE),
                "2 min": planned("optimal", minutes=2.0),
                "two-axis stand, 3 min": planned("optimal", stand="two-axis", minutes=3.0),
                "slow stand with end stops, 4 min": planned("optimal", stand=SLOW, minutes=4.0),
            }.items()
        ),
        *(Case(name, (motion,), _sigma(planned(motion))) for name, motion in by_hand.items()),
        Case("card of poses, 4 min, by a hand that trembles", (card.motion,), _sigma(card), in_hand=True),
    ]


def planned(kind: str | Motion, **options: object) -> imucal.Plan:
    return imucal.plan(kind, rate_hz=RATE_HZ, detection_limits=False, **options)  # type: ignore[arg-type]


def _sigma(plan: imucal.Plan) -> np.ndarray:
    return np.array([parameter.std for parameter in plan.parameters])


def _together(*motions: Motion) -> np.ndarray:
    """Of one calibration of several recordings, which `imucal.plan` has for the paper's programs alone."""
    from imucal import _core
    from imucal.plan import CoreSensors
    from imucal.recording import STANDARD_GRAVITY_MPS2
    from imucal.unit import unit_of

    sensors = CoreSensors(unit_of("paper"), RATE_HZ, STANDARD_GRAVITY_MPS2, (), 0.0)
    return np.array(_core.predict_sigma(sensors, [motion.in_si() for motion in motions], 1.0, 0.0, False)[0])


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
        error, stated = (np.array([run[k] for run in found]) for k in (0, 1))
        return Agreement(
            case.name,
            minutes,
            len(found),
            np.sqrt((error**2).mean(axis=0)) / case.sigma,
            np.sqrt((stated**2).mean(axis=0)) / case.sigma,
            sum(run[2] for run in found),
        )

    @property
    def chance(self) -> float:
        """Standard deviation of each ratio by chance."""
        return 1.0 / np.sqrt(2.0 * self.runs)

    @property
    def worst(self) -> float:
        """The ratio that is furthest from one."""
        return float(self.ratio[np.argmax(np.abs(self.ratio - 1.0))])
