"""A calibrated accelerometer as a prior for the calibration of the gyroscope of the same unit."""

from __future__ import annotations

from collections.abc import Sequence

from imucal.calibration.calibration import Calibration, require_calibration
from imucal.calibration.frame import in_frame
from imucal.calibration.triad import base_count
from imucal.errors import InputError
from imucal.recording.recording import Recording

__all__ = ["KnownAccelerometer", "known_accelerometer"]

# Type: the nine parameters of an accelerometer, and their covariance by rows.
KnownAccelerometer = tuple[list[float], list[list[float]]]


def known_accelerometer(calibration: Calibration, recordings: Sequence[Recording]) -> KnownAccelerometer:
    """The parameters of the accelerometer in the symmetric frame with their covariance.

    Raises InputError for a calibration without covariance, or with other units or axes than the recordings.
    """
    require_calibration(calibration)
    for recording in recordings:
        if recording.accel_unit != calibration.accel_unit:
            raise InputError(
                f"{recording.name}: the accelerometer is in {recording.accel_unit}, but the given "
                f"calibration expects {calibration.accel_unit}: give the recording in the same unit"
            )
        if recording.axes != calibration.axes:
            raise InputError(
                f"{recording.name} was read with axes={recording.axes!r}, but the given calibration was made "
                f"from recordings with axes={calibration.axes!r}: read the recording with "
                f"axes={calibration.axes!r}"
            )
    if calibration.effects:
        raise InputError(
            f"the given calibration has the effect {calibration.effects[0].name}, but effects of a known "
            "accelerometer are not supported: calibrate without effects, or estimate both sensors together"
        )
    symmetric = in_frame(calibration, "symmetric")
    count = base_count("symmetric", has_gyroscope=False)
    names = [parameter.name for parameter in symmetric.parameters[:count]]
    known = dict(zip(symmetric.covariance_names, range(len(symmetric.covariance_names)), strict=True))
    if symmetric.covariance is None or not set(names) <= known.keys():
        raise InputError(
            "the given calibration has no covariance of its accelerometer: give a calibration file of "
            "imucal calibrate"
        )
    rows = [known[name] for name in names]
    covariance = symmetric.covariance[rows][:, rows]
    return [parameter.value for parameter in symmetric.parameters[:count]], covariance.tolist()
