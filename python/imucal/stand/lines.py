"""A unit's lines of text: numbers in the order of a template, with a checksum if the template ends with `*`.

    time_us,accel_x_lsb,accel_y_lsb,accel_z_lsb,gyro_x_lsb,gyro_y_lsb,gyro_z_lsb,-,temp_degc*

`-` leaves a column out. The checksum is that of NMEA 0183: after `*` two hexadecimal digits, the exclusive or
of all characters before it, without a leading `$`.
"""

from __future__ import annotations

import re
from typing import Final

from imucal.errors import InputError
from imucal.io.columns import column_list
from imucal.io.vocabulary import SKIP

__all__ = ["LineDecoder"]

SEPARATOR: Final = re.compile(r"[,;\s]+")
# A line that never ends is none.
LONGEST: Final = 4096


class LineDecoder:
    """From bytes to rows of numbers, one for each line that is as the template says.

    columns  names of the columns that are kept
    """

    def __init__(self, template: str) -> None:
        self._has_checksum = template.rstrip().endswith("*")
        names = column_list(template.rstrip().removesuffix("*"))
        if not all(names):
            raise InputError(f"the columns {template!r} have an empty name: give - for one to leave out")
        self._kept = [i for i, name in enumerate(names) if name not in SKIP]
        self.columns = tuple(names[i] for i in self._kept)
        self.turns_over: tuple[float | None, ...] = (None,) * len(self.columns)
        self.damaged = 0
        self._width = len(names)
        self._left = b""
        self._is_first = True

    def feed(self, data: bytes) -> list[tuple[float, ...]]:
        """The rows of the lines that end with these bytes."""
        *lines, self._left = (self._left + data).split(b"\n")
        if len(self._left) > LONGEST:
            self._left = b""
            self.damaged += 1
        rows = []
        for line in lines:
            row = self._row(line.strip())
            if row is not None:
                rows.append(row)
            elif line.strip():
                # The first one may have begun before we listened.
                self.damaged += not self._is_first
            self._is_first = False
        return rows

    def counts(self) -> dict[str, int]:
        """What was no line of numbers."""
        return {"lines_damaged": self.damaged}

    def _row(self, line: bytes) -> tuple[float, ...] | None:
        if self._has_checksum:
            line, star, given = line.removeprefix(b"$").rpartition(b"*")
            checksum = 0
            for byte in line:
                checksum ^= byte
            if not star or given.upper() != f"{checksum:02X}".encode():
                return None
        try:
            cells = SEPARATOR.split(line.decode("ascii").strip())
            if len(cells) != self._width:
                return None
            return tuple(float(cells[i]) for i in self._kept)
        except ValueError:
            return None
