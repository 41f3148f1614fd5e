"""Skips the last line of a text if it is incomplete because the recording stopped while it was written."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from imucal.finding import Finding
from imucal.io.layout import Layout, is_value, split_line
from imucal.io.remarks import lines_left_out

__all__ = ["LastLine"]

# The last row is compared with this number of rows before it. The last row may have been cut off if its last
# field has fewer decimals than the last field of each of these rows.
COMPARED_ROWS: Final = 20


class LastLine:
    """The last line of a text, which is skipped if it is incomplete.

    A line without a line end is incomplete if it has too few fields, or if its last field has fewer decimals
    than the last fields of all compared rows.
    """

    def __init__(self, content: bytes, layout: Layout) -> None:
        self.end = len(content)
        self.cut = ""
        if content.endswith(b"\n") or not layout.first:
            return
        start = content.rfind(b"\n") + 1
        if start <= layout.start:
            return
        line = content[start:].decode(errors="replace")
        before = content[max(layout.start, start - (1 << 14)) : start].split(b"\n")[1:-1][-COMPARED_ROWS:]
        if line.strip() and _is_cut(line, [row.decode(errors="replace") for row in before], layout):
            self.end, self.cut = start, line.strip()

    def findings(self, file: str) -> tuple[Finding, ...]:
        """A warning if the last line was skipped."""
        left = [f"an incomplete last line ({self.cut[:40]!r})"]
        return (lines_left_out(file, left, 1),) if self.cut else ()


def _is_cut(line: str, before: Sequence[str], layout: Layout) -> bool:
    fields = split_line(line, layout.separator)
    rows = [split_line(row, layout.separator) for row in before if row.strip()]
    if not rows or any(len(row) != len(rows[0]) for row in rows):
        return False
    if len(fields) < len(rows[0]):
        return any(is_value(field, layout.decimal) for field in fields)
    if len(fields) > len(rows[0]):
        return False
    if not fields[-1] or not is_value(fields[-1], layout.decimal):
        return all(is_value(row[-1], layout.decimal) for row in rows)
    decimals = {len(row[-1].rpartition(layout.decimal)[2]) for row in rows if layout.decimal in row[-1]}
    return (
        len(rows) >= COMPARED_ROWS // 2
        and len(decimals) == 1
        and all(layout.decimal in row[-1] for row in rows)
        and len(fields[-1].rpartition(layout.decimal)[2]) < decimals.pop()
    )
