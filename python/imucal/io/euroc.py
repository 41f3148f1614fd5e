"""The IMU file of the EuRoC data sets (data.csv), in ns, rad/s and m/s^2.

The columns are #timestamp [ns], w_RS_S_x [rad s^-1], (y, z), a_RS_S_x [m s^-2], (y, z).
"""

from __future__ import annotations

import os

from imucal.errors import FormatError
from imucal.io.text import open_path, read_rows
from imucal.io.vocabulary import recording_from_table
from imucal.recording.recording import Recording

__all__ = ["is_euroc", "read_euroc"]

CANONICAL_NAME = {
    "timestamp [ns]": "time_ns",
    **{f"w_RS_S_{axis} [rad s^-1]": f"gyro_{axis}_radps" for axis in "xyz"},
    **{f"a_RS_S_{axis} [m s^-2]": f"accel_{axis}_mps2" for axis in "xyz"},
}


def is_euroc(header: list[str]) -> bool:
    """Whether the column names `header` are the names of a EuRoC IMU file."""
    return set(CANONICAL_NAME) <= set(header)


def read_euroc(path: str | os.PathLike[str]) -> Recording:
    """Read a EuRoC IMU file. Time is counted from the first sample."""
    text = open_path(path)
    names = text.layout.names or []
    missing = [name for name in CANONICAL_NAME if name not in names]
    if missing:
        raise FormatError(
            f"{text.name}: the EuRoC column '{missing[0]}' is missing; found: {', '.join(names)}"
        )
    table = read_rows(text, [CANONICAL_NAME.get(name, name) for name in names])
    return recording_from_table(table, text.sources)
