"""The verdict on a unit of a production line, with a code for each reason.

dead_axis           the output of an axis is constant, or contains only noise, although the unit was moved
clipping            a sensor saturates during moves
mount_slip          the unit has slipped on its mount
loose_mount         the mount is loose, so the unit moves on it
poor_calibration    a figure of merit of the calibration run is poor, or too many rests or moves were rejected
                    as outliers
poor_control        a figure of merit of the control run is poor
incomplete_calibration, incomplete_control   residuals of the calibration or control run exceed their noise; a
                    reason only if the verdict `good` is required
limit               a limit of the limits file is exceeded
no_motion           all axes contain only noise, because the stand did not move or the data are frozen; no
                    result
stand_mismatch      the attitude differs by several degrees from the stand's angles, because of a motor or the
                    mount; no result
data_NAME           the check NAME has refused the recording
run_NAME            a run ended early with the state NAME; no result
not_determined      the run does not determine all parameters; no result
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Final

import numpy as np

import imucal._core as _core
from imucal.calibration.verdict import Verdict
from imucal.errors import FitError, InputError, NotEnoughMotionError
from imucal.estimation.calibrate import calibrate
from imucal.estimation.rests import FittedRest
from imucal.estimation.result import CalibrationResult
from imucal.finding import Finding
from imucal.limits.limits import Limits
from imucal.recording.recording import Recording, samples_of_both
from imucal.rig.motion import Program
from imucal.simulation.simulate import simulate

__all__ = ["Assessment", "Reason", "assess"]

# Codes of findings that indicate a fault of the unit, each with the code of the reason why the unit fails.
OF_THE_UNIT: Final = {
    "stuck_axis": "dead_axis",
    "accel_saturation": "clipping",
    "gyro_saturation": "clipping",
}
# An axis is dead if its standard deviation over the run is below this multiple of its noise. A working axis
# changes by hundreds of times its noise in moves.
DEAD_FACTOR: Final = 4.0
# The noise is estimated from the lower quartile of the absolute differences of consecutive samples. For a
# normal distribution this quartile is 0.3186 standard deviations of the differences.
QUIET_SHARE: Final = 0.25
QUIET_QUANTILE: Final = 0.3186
# If the attitude of the unit and the attitude from the stand's angles differ by more than this angle, deg, a
# motor is faulty or the unit came off its mount. GROSS_DEG is for calibrated samples, and larger than the
# attitude error due to any loose mount. GROSS_RAW_DEG is for raw samples, and larger than the attitude errors
# from raw samples.
GROSS_DEG: Final = 5.0
GROSS_RAW_DEG: Final = 15.0
MOTORS: Final = (
    "a motor may be stuck, lose steps, turn in the wrong direction, or be connected to the cable of another "
    "motor, or the unit came off its mount: turn each motor separately, fasten the unit, and record again"
)
# A program counts as exciting all axes of a sensor if the smallest eigenvalue of the covariance matrix of the
# sensor's true samples exceeds this share of the largest eigenvalue.
LEAST_EXCITATION: Final = 0.01
# Sampling rate of the simulation that evaluates the excitation, Hz.
IDEAL_HZ: Final = 50.0
AXES: Final = ("accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z")


@dataclass(frozen=True)
class Reason:
    """A reason why a unit does not pass; `code` is a stable identifier."""

    code: str
    message: str


@dataclass(frozen=True, eq=False)
class Assessment:
    """The evaluation of a unit's recordings.

    reasons  reasons why the unit does not pass, the most serious first; empty if it passes. A calibration
             with the verdict `incomplete` passes unless the verdict `good` is required
    judged   whether the unit was judged; False if the reasons concern the stand or the run (no result)
    result   the calibration, None if there is none
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
    require: Verdict = "incomplete",
) -> Assessment:
    """Calibrate a unit from its run, evaluate it on its control run, and name its faults.

    programs  program of the run and, if there is one, of the control run
    require   worst accepted verdict on the calibration
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
        rests = tuple(
            FittedRest(**asdict(rest), chi2=None, degrees_of_freedom=None, p_value=None)
            for rest in result.control.rests
        )
        found += _mount(replace(result, rests=rests), control)
    for finding in found:
        if finding.value > GROSS_DEG:
            message = (
                f"{finding.recording}: the attitude of the unit differs by {finding.value:.0f} deg from the "
                f"stand's angles; {MOTORS}"
            )
            return Assessment((Reason("stand_mismatch", message),), judged=False)
    reasons = [Reason(finding.code, str(finding)) for finding in found]
    if result.verdict == "poor" or (result.verdict == "incomplete" and require == "good"):
        for text in result.reasons:
            of = "control" if text.startswith("control") else "calibration"
            reasons.append(Reason(f"{result.verdict}_{of}", text))
    if limits is not None:
        result = result.judged_by(limits)
        reasons += [Reason("limit", text) for text in (result.judgement.reasons if result.judgement else ())]
    return Assessment(tuple(reasons), judged=True, result=result)


def _dead_axes(recording: Recording, program: Program) -> dict[int, Reason]:
    """Reasons for axes, 0 to 5, that output only noise although the program excites them."""
    columns = np.hstack(samples_of_both(recording)).astype(np.float64)
    if len(columns) < 2 or not np.isfinite(columns).all():
        return {}
    spread = np.std(columns, axis=0)
    # Differences of consecutive samples contain white noise but little motion. The lower quartile of the
    # differences occurs at rests, where the stand does not vibrate.
    quiet = np.quantile(np.abs(np.diff(columns, axis=0)), QUIET_SHARE, axis=0)
    noise = quiet / QUIET_QUANTILE / np.sqrt(2.0)
    dead = (spread <= DEAD_FACTOR * noise) & np.repeat(_excites(program), 3)
    return {
        int(axis): Reason(
            "dead_axis",
            f"{recording.name}: {AXES[axis]} has a standard deviation of {spread[axis]:.3g} over the run, "
            f"which is little more than its noise of {noise[axis]:.3g}, although every axis was excited",
        )
        for axis in np.flatnonzero(dead)
    }


def _not_moved(recording: Recording, dead: Sequence[int]) -> Reason | None:
    """The reason if the dead axes may be intact but were not moved; None if the axes are defective."""
    if len(dead) == len(AXES):
        return Reason(
            "no_motion",
            f"{recording.name}: all axes contain only noise, so the stand did not move, or the data of the "
            "unit are frozen: check that the motors are powered and turn, and that the unit sends new "
            "samples, and record again",
        )
    # A gyroscope axis may also have no signal because a motor is stuck. In this case the gravity directions
    # of the accelerometer disagree with the stand angles, unless the accelerometer itself is dead.
    mismatch_deg = None if min(dead) < 3 else _core.stand_mismatch_deg(recording)
    if mismatch_deg is not None and mismatch_deg > GROSS_RAW_DEG:
        axes = " and ".join(AXES[axis] for axis in dead)
        return Reason(
            "stand_mismatch",
            f"{recording.name}: {axes} did not turn, and the direction of gravity differs by "
            f"{mismatch_deg:.0f} deg from the stand's angles; {MOTORS}",
        )
    return None


def _excites(program: Program) -> list[bool]:
    """Whether a program excites all axes of accelerometer and gyroscope, however the unit is mounted."""
    ideal = simulate(program, unit="ideal", seed=0, rate_hz=IDEAL_HZ).recording
    spreads = [np.linalg.eigvalsh(np.cov(rows.T)) for rows in samples_of_both(ideal)]
    return [bool(least > LEAST_EXCITATION * most) for least, _, most in spreads]


def _mount(result: CalibrationResult, recording: Recording) -> list[Finding]:
    """Findings for a slip of the unit on its mount, or for a loose mount.

    A single slip is not reported as a loose mount.
    """
    rests = [
        (rest.first, rest.end, rest.start_s, rest.mean_specific_force, rest.excluded is None)
        for rest in result.rests
        if rest.recording == recording.name and rest.start_s is not None
    ]
    return _core.mount_faults(result.calibration.accelerometer, rests, recording)


def _refused(error: InputError) -> Assessment:
    """The assessment of refused recordings. The unit fails if it has a fault; otherwise it is not judged."""
    grave = [finding for finding in error.findings if finding.severity == "error"]
    unit = [Reason(OF_THE_UNIT[f.code], str(f)) for f in grave if f.code in OF_THE_UNIT]
    other = [Reason(f"data_{f.code}", str(f)) for f in grave if f.code not in OF_THE_UNIT]
    return Assessment((*unit, *(other or ([] if unit else [Reason("data", str(error))]))), judged=bool(unit))
