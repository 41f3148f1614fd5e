"""Driver for a hand-held unit, which tells a person the next pose and detects held poses from the samples.

A pose is defined by the body direction that points up, because the rotation about the vertical is hard to
control by hand. A pose is complete when the unit has moved since the previous pose, is within 25 deg of the
requested direction, and has been at rest for the hold time of the program. Uncalibrated sensors with errors
of a few per cent are sufficiently accurate for this test.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.errors import InputError
from imucal.rig.motion import Program
from imucal.simulation.simulate import simulate
from imucal.stand.driver import Event, Position, Progress, Status
from imucal.stand.stream import TICKS_PER_S

__all__ = ["ManualDriver", "pose_text", "ups_of"]

# A pose counts as reached if the measured up direction is within this angle of the requested one, deg.
NEAR_DEG: Final = 25.0
# Averaging time of the samples for the detection of rest, s.
BIN_S: Final = 0.2
# First condition for rest: the up directions, averaged over intervals of `BIN_S`, deviate from their mean by
# at most this angle, deg.
STILL_DEG: Final = 2.0
# Second condition for rest: the angular rates, averaged over intervals of `BIN_S`, deviate from their mean by
# at most this share of the largest range (maximum minus minimum) of such averages in an earlier move.
STILL_SHARE: Final = 0.15
# A pose is described by a single body axis, such as `+x up`, if that axis is within this angle of the
# vertical, deg.
ALONE_DEG: Final = 12.0


class ManualDriver:
    """Guides a person through the poses of a program; `columns` are the columns of the unit's samples."""

    def __init__(self, program: Program, columns: Sequence[str]) -> None:
        self._holds = [(up, step.hold_s) for up, step in zip(ups_of(program), program.steps, strict=True)]
        time = next((i for i, name in enumerate(columns) if name in TICKS_PER_S), None)
        triads = [
            [i for i, n in enumerate(columns) if n.startswith(f"{t}_{a}_")]
            for t in ("accel", "gyro")
            for a in "xyz"
        ]
        if time is None or any(len(found) != 1 for found in triads):
            raise InputError(
                f"the unit sends {', '.join(columns)}: a time, accel_x to z and gyro_x to z are needed"
            )
        self._ticks_per_s = TICKS_PER_S[columns[time]]
        self._picked = [time, *(found[0] for found in triads)]
        self._window = np.zeros((0, 7))
        self._rates_span = 0.0
        self._step = 0
        self._moved = True
        self._still = False
        self._off_deg = 180.0

    def start(self) -> None:
        """Does nothing, because a person needs no connection."""

    def poll(self) -> Status:
        """The requested pose, and the angle of the unit from it."""
        if self._step == len(self._holds):
            return Status("finished", len(self._holds) - 1)
        up, hold_s = self._holds[self._step]
        near = self._off_deg <= NEAR_DEG
        what = (
            f"hold it still for {hold_s:.0f} s" if near else f"turn the unit, {self._off_deg:.0f} deg to go"
        )
        if near and not self._moved:
            what = "move the unit away and back first"
        message = f"{pose_text(up)}: {what}"
        return Status("holding" if near and self._still else "moving", self._step, message=message)

    def observe(self, samples: FloatArray) -> None:
        """Update the state of the current pose with new samples."""
        rows = samples[:, self._picked].copy()
        rows[:, 0] /= self._ticks_per_s
        # Samples are split into short pieces, because after a delay many samples can arrive at once and may
        # contain a whole hold.
        pieces = np.flatnonzero(np.diff(rows[:, 0] // BIN_S)) + 1
        for piece in np.split(rows, pieces):
            if len(piece) and self._step < len(self._holds):
                self._observe(piece)

    def _observe(self, rows: FloatArray) -> None:
        self._window = np.concatenate([self._window, rows])
        up, hold_s = self._holds[self._step]
        now_s = self._window[-1, 0]
        self._window = self._window[self._window[:, 0] > now_s - hold_s - BIN_S]
        mean = self._window[self._window[:, 0] > now_s - BIN_S, 1:4].mean(axis=0)
        self._off_deg = _angle_deg(mean, up)
        self._still = self._is_still(hold_s)
        self._moved = self._is_moving() or self._moved
        if self._still and self._moved and self._off_deg <= NEAR_DEG:
            self._step += 1
            self._moved = False
            self._window = self._window[-1:]

    def positions(self) -> Sequence[Position]:
        """Empty, because there are no encoders."""
        return ()

    def events(self) -> Sequence[Event]:
        """Empty, because events report faults of a controller, and a hand-held unit has no controller."""
        return ()

    def progress(self) -> Progress | None:
        """None, because the run cannot be resumed."""
        return None

    def close(self) -> None:
        """Does nothing, because there are no motors."""

    def _bins(self) -> FloatArray:
        """Means of the latest samples over intervals of `BIN_S`, (B, 6): specific force, angular rate."""
        number = ((self._window[:, 0] - self._window[0, 0]) / BIN_S).astype(int)
        counts = np.bincount(number)
        sums = np.stack([np.bincount(number, column) for column in self._window[:, 1:].T], axis=1)
        means: FloatArray = sums[counts > 0] / counts[counts > 0, None]
        return means

    def _is_still(self, hold_s: float) -> bool:
        if self._window[-1, 0] - self._window[0, 0] < hold_s:
            return False
        bins = self._bins()
        mean = bins.mean(axis=0)
        strays = max(_angle_deg(row[:3], mean[:3]) for row in bins) > STILL_DEG
        rates = float(np.abs(bins[:, 3:] - mean[3:]).max())
        return not strays and (self._rates_span == 0.0 or rates <= STILL_SHARE * self._rates_span)

    def _is_moving(self) -> bool:
        """Whether the unit rotates.

        The up direction must change, or the range of the averaged rates must exceed half of the largest range
        that these rates had in a move.
        """
        bins = self._bins()
        span = float(np.ptp(bins[:, 3:], axis=0).max())
        turned = max(_angle_deg(row[:3], bins[0, :3]) for row in bins) > 2 * STILL_DEG
        if turned:
            self._rates_span = max(self._rates_span, span)
        return turned or (self._rates_span > 0.0 and span > 0.5 * self._rates_span)


def pose_text(up: FloatArray) -> str:
    """A pose in words: `+x up`, or `up between +x and -z (0.71, 0.00, -0.71)`."""
    names = [f"{'+' if value >= 0 else '-'}{axis}" for axis, value in zip("xyz", up, strict=True)]
    order = np.argsort(-np.abs(up))
    if np.degrees(np.arccos(min(abs(up[order[0]]), 1.0))) <= ALONE_DEG:
        return f"{names[order[0]]} up"
    parts = [names[i] for i in order if abs(up[i]) > np.sin(np.radians(ALONE_DEG))]
    return f"up between {' and '.join(parts)} ({', '.join(f'{value:.2f}' for value in up)})"


def ups_of(program: Program) -> list[FloatArray]:
    """The body direction, unit vector (3,), that points up at the end of each step."""
    ends_s = np.cumsum([step.move_s + step.hold_s for step in program.steps])
    truth = simulate(program, unit="ideal", seed=0, rate_hz=50.0).truth
    rows = np.minimum(np.searchsorted(truth.time_s, ends_s - 1e-9), len(truth.time_s)) - 1
    return [force / np.linalg.norm(force) for force in truth.specific_force[rows]]


def _angle_deg(a: FloatArray, b: FloatArray) -> float:
    cosine = float(a @ b) / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-30)
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
