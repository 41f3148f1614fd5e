"""The verdict on a unit of the line, with reasons by name.

dead_axis           an axis does not feel: it stands at one value, or shows nothing but noise
clipping            a sensor is at the end of its range in the moves
mount_slip          the unit has slipped on its mount
loose_mount         the unit is loose on its mount
poor_calibration    figures of the run, or too many rests or moves that contradict the others
poor_control        figures of the control run
limit               a limit of the limits file is not kept
no_motion           no axis feels anything: the stand stood still, or the data are frozen: no result
stand_mismatch      the unit was far from where the stand's angles say, by a motor or its mount: no result
data_NAME           a check of the recording has refused it, by the name of the check
run_NAME            a run did not go to its end, by its state: no result
not_determined      the run does not determine the parameters: no result
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from imucal.errors import FitError, InputError, NotEnoughMotionError
from imucal.estimation.calibrate import calibrate
from imucal.estimation.result import CalibrationResult
from imucal.finding import Finding
from imucal.gap.rules import best_mount, loose_mounts, mount_slips, vertical
from imucal.limits.limits import Limits
from imucal.recording.recording import Recording
from imucal.rig.motion import Program
from imucal.simulation.simulate import simulate

__all__ = ["Assessment", "Reason", "assess"]

# Checks that speak of the unit, under the names of the line.
OF_THE_UNIT: Final = {
    "stuck_axis": "dead_axis",
    "accel_saturation": "clipping",
    "gyro_saturation": "clipping",
}
# An axis that feels changes in moves by hundreds of times its noise; one that does not changes by that alone.
FEELS: Final = 4.0
# Of the absolute values of normal numbers a quarter is below 0.3186.
QUIET_SHARE: Final = 0.25
QUIET_QUANTILE: Final = 0.3186
# More than any play: a motor is wrong, or the unit came off; and more than raw samples err.
GROSS_DEG: Final = 5.0
GROSS_RAW_DEG: Final = 15.0
MOTORS: Final = (
    "a motor may be stuck, lose steps, turn the wrong way round, or have its cables exchanged with those of "
    "another, or the unit came off its mount: turn each motor by itself, fasten the unit, and record again"
)
# The variance along the least excited direction, as a share of that along the most.
LEAST_SHARE: Final = 0.01
IDEAL_HZ: Final = 50.0
AXES: Final = ("accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z")


@dataclass(frozen=True)
class Reason:
    """Why a unit does not pass; `code` is a stable word."""

    code: str
    message: str


@dataclass(frozen=True, eq=False)
class Assessment:
    """What the recordings of a unit say.

    reasons  why it does not pass, the gravest first; empty for one that does
    judged   whether the reasons are the unit's (or its mount's); False if there is no result
    result   the calibration, None if the recordings give none
    """

    reasons: tuple[Reason, ...]
    judged: bool
    result: CalibrationResult | None = None


def assess(
    run: Recording,
    control: Recording | None,
    programs: Sequence[Program],
    *,
    gravity_mps2: float,
    serial_number: str | None = None,
    limits: Limits | None = None,
) -> Assessment:
    """Calibrate a unit from its run, judge it on its control run, and name what is wrong.

    programs  that of the run and, if there is one, that of the control run
    """
    recordings = [run, *([] if control is None else [control])]
    pairs = zip(recordings, programs, strict=False)
    for recording, program in pairs:
        dead = _dead_axes(recording, program)
        if dead:
            wrong = _not_moved(recording, list(dead))
            return Assessment((wrong,) if wrong else tuple(dead.values()), judged=wrong is None)
    try:
        result = calibrate(run, control=control, gravity_mps2=gravity_mps2, serial_number=serial_number)
    except InputError as error:
        return _refused(error)
    except (NotEnoughMotionError, FitError) as error:
        return Assessment((Reason("not_determined", str(error)),), judged=False)
    found = [*_mount(result, run)]
    if control is not None and result.control is not None:
        found += _mount(replace(result, rests=result.control.rests), control)
    for finding in found:
        if finding.value > GROSS_DEG:
            message = (
                f"{finding.recording}: the unit was {finding.value:.0f} deg from where the stand's angles "
                f"say; {MOTORS}"
            )
            return Assessment((Reason("stand_mismatch", message),), judged=False)
    reasons = [Reason(finding.code, str(finding)) for finding in found]
    for text in result.reasons:
        reasons.append(Reason("poor_control" if text.startswith("control") else "poor_calibration", text))
    if limits is not None:
        result = result.judged_by(limits)
        reasons += [Reason("limit", text) for text in (result.judgement.reasons if result.judgement else ())]
    return Assessment(tuple(reasons), judged=True, result=result)


def _dead_axes(recording: Recording, program: Program) -> dict[int, Reason]:
    """Axes, of the six, that show nothing but their own noise in a program that every axis must feel."""
    columns = np.hstack([recording.specific_force, recording.angular_rate]).astype(np.float64)
    if len(columns) < 2 or not np.isfinite(columns).all():
        return {}
    spread = np.std(columns, axis=0)
    # Motion is too slow to show in the difference of neighbours, white noise shows in full; the quiet quarter
    # is at rest, where the stand does not vibrate.
    quiet = np.quantile(np.abs(np.diff(columns, axis=0)), QUIET_SHARE, axis=0)
    noise = quiet / QUIET_QUANTILE / np.sqrt(2.0)
    dead = (spread <= FEELS * noise) & np.repeat(_excites(program), 3)
    return {
        int(axis): Reason(
            "dead_axis",
            f"{recording.name}: {AXES[axis]} changes by {spread[axis]:.3g} (1 sigma) over the run, little "
            f"more than its noise of {noise[axis]:.3g}, in a motion that every axis feels",
        )
        for axis in np.flatnonzero(dead)
    }


def _not_moved(recording: Recording, dead: Sequence[int]) -> Reason | None:
    """Why axes show nothing though they may be sound: they were not moved."""
    if len(dead) == len(AXES):
        return Reason(
            "no_motion",
            f"{recording.name}: no axis shows more than its noise: the stand did not move, or the data of "
            "the unit are frozen: see that the motors are powered and turn, and that the unit sends new "
            "samples, and record again",
        )
    # A motor that stands still keeps gyroscope axes still; the accelerometer knows, if it feels itself.
    missed_deg = None if min(dead) < 3 else _missed_deg(recording)
    if missed_deg is not None and missed_deg > GROSS_RAW_DEG:
        axes = " and ".join(AXES[axis] for axis in dead)
        return Reason(
            "stand_mismatch",
            f"{recording.name}: {axes} did not turn, and gravity misses the stand's angles by "
            f"{missed_deg:.0f} deg; {MOTORS}",
        )
    return None


def _missed_deg(recording: Recording) -> float | None:
    """How far gravity in raw samples is from where the stand's angles say, deg; None without angles."""
    if recording.stand_rad is None:
        return None
    known = np.isfinite(recording.stand_rad).all(axis=1)
    if not known.any():
        return None
    told = vertical(np.zeros(7), recording.stand_rad[known])
    force = recording.specific_force[known]
    up = force / np.maximum(np.linalg.norm(force, axis=1, keepdims=True), 1e-30)
    cosine = np.clip(np.sum(up * (told @ best_mount(told, up)), axis=1), -1.0, 1.0)
    # The median: in moves the force is not gravity alone.
    return float(np.degrees(np.median(np.arccos(cosine))))


def _excites(program: Program) -> list[bool]:
    """Whether a program moves the accelerometer and the gyroscope along every axis, however it is mounted."""
    ideal = simulate(program, unit="ideal", seed=0, rate_hz=IDEAL_HZ).recording
    spreads = [np.linalg.eigvalsh(np.cov(rows.T)) for rows in (ideal.specific_force, ideal.angular_rate)]
    return [bool(least > LEAST_SHARE * most) for least, _, most in spreads]


def _mount(result: CalibrationResult, recording: Recording) -> list[Finding]:
    """A slip, or play; a slip alone would pass for play, too."""
    return [*mount_slips(result, [recording])] or [*loose_mounts(result, [recording])]


def _refused(error: InputError) -> Assessment:
    """The checks of the recordings have refused them: for what the unit does, or for how it was recorded."""
    grave = [finding for finding in error.findings if finding.severity == "error"]
    unit = [Reason(OF_THE_UNIT[f.code], str(f)) for f in grave if f.code in OF_THE_UNIT]
    other = [Reason(f"data_{f.code}", str(f)) for f in grave if f.code not in OF_THE_UNIT]
    return Assessment((*unit, *(other or ([] if unit else [Reason("data", str(error))]))), judged=bool(unit))
