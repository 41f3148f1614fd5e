"""Builds the warnings of readers that concern a whole file, such as skipped lines or a missing sensor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from imucal.finding import Finding

__all__ = ["corrected_by_px4", "damaged", "lines_left_out", "one_sensor", "remark"]


def remark(file: str, code: str, message: str, way_out: str) -> Finding:
    """A finding of severity warning about the whole file."""
    return Finding(code, "warning", file, (), None, 1, 1.0, "1", message, way_out)


def lines_left_out(file: str, parts: Sequence[str], count: int) -> Finding:
    """The warning that reports the number of skipped lines of a text; `parts` describe the kinds of lines."""
    return replace(
        remark(
            file,
            "lines_left_out",
            f"left out: {', '.join(parts)}",
            "check that no samples are lost there, or remove these lines from the file",
        ),
        count=count,
    )


def one_sensor(file: str, sensor: str, others: Sequence[str]) -> Finding:
    """The warning for a file with the columns of one sensor only.

    others   names of the columns that do not belong to a sensor
    """
    missing = {"accelerometer": "gyroscope", "gyroscope": "accelerometer"}[sensor]
    kept = f" (other columns: {', '.join(others)})" if others else ""
    return remark(
        file,
        "sensor_missing",
        f"there are no columns of a {missing}{kept}: this is a recording of the {sensor} alone".replace(
            "a accel", "an accel"
        ),
        f"if the file has a {missing}, name its columns with --columns".replace("a accel", "an accel"),
    )


def damaged(file: str) -> Finding:
    """The warning for a log with damaged parts that were skipped."""
    return remark(
        file,
        "file_damaged",
        "the log is damaged; unreadable parts were skipped",
        "check the recording for gaps in time, or download the log again",
    )


def corrected_by_px4(file: str) -> Finding:
    """The warning for samples of the PX4 topic `sensor_combined`, read from a ULog or from its CSV export."""
    return remark(
        file,
        "already_corrected",
        "PX4 has applied its calibration parameters (CAL_*, TC_*) to sensor_combined",
        "a calibration of this recording adds to these parameters and does not replace them; for a "
        "calibration that replaces them, log sensor_accel and sensor_gyro",
    )
