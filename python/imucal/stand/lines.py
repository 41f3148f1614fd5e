"""Decoder for text lines: numbers in the order of a template, with a checksum if the template ends with `*`.

    time_us,accel_x_lsb,accel_y_lsb,accel_z_lsb,gyro_x_lsb,gyro_y_lsb,gyro_z_lsb,-,temp_degc*

`-` marks a number to ignore. The checksum has the form of NMEA 0183: `*` and two hexadecimal digits, the
exclusive or of all characters before the `*`, without a leading `$`.
"""

from __future__ import annotations

import re
from typing import Final

from imucal.errors import InputError
from imucal.io.mapping import column_list
from imucal.io.names import SKIP

__all__ = ["LineDecoder"]

SEPARATOR: Final = re.compile(r"[,;\s]+")
# Length above which text without a line end is discarded as damaged, characters.
LONGEST: Final = 4096
# Messages show at most this number of characters of a line.
LONGEST_SHOWN: Final = 60


class LineDecoder:
    """Decodes bytes to rows of numbers, one for each line that matches the template.

    columns     names of the columns that are not ignored
    is_checked  whether the lines have a checksum
    """

    def __init__(self, template: str) -> None:
        self.is_checked = template.rstrip().endswith("*")
        names = column_list(template.rstrip().removesuffix("*"))
        if not all(names):
            raise InputError(f"the columns {template!r} contain an empty name: give - for a column to ignore")
        self._kept = [i for i, name in enumerate(names) if name not in SKIP]
        self.columns = tuple(names[i] for i in self._kept)
        self.wraps_at: tuple[float | None, ...] = (None,) * len(self.columns)
        self.damaged = 0
        self.remark = ""
        self._width = len(names)
        self._left = b""
        self._is_first = True

    def feed(self, data: bytes) -> list[tuple[float, ...]]:
        """Append received bytes. Returns the rows of the lines that are now complete."""
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
                # The first line is not counted, because reading can start within a line.
                self.damaged += not self._is_first
                shown = line.strip()[:LONGEST_SHOWN].decode("ascii", "backslashreplace")
                self.remark = f"a line is not {self._width} numbers: {shown}"
            self._is_first = False
        return rows

    def counts(self) -> dict[str, int]:
        """Number of lines that did not match the template."""
        return {"lines_damaged": self.damaged}

    def _row(self, line: bytes) -> tuple[float, ...] | None:
        if self.is_checked:
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
