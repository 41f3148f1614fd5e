"""Lines with the three axes of one sensor, as the examples of Adafruit's Arduino libraries print them.

    Acceleration X: 0.04, Y: 0.11, Z: 9.79 m/s^2
    Rotation X: 0.01, Y: -0.02, Z: 0.00 rad/s
    Temperature: 27.63 degC

The lines of all sensors make a block, which is one sample.
"""

from __future__ import annotations

import re
from collections import Counter
from typing import Final

__all__ = ["are_blocks", "rows_of_blocks"]

_NUMBER: Final = r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"
# The name of a sensor, its axes, and the unit.
VECTOR: Final = re.compile(
    rf"^\s*([A-Za-z][\w .]*?)\s*X\s*[:=]\s*{_NUMBER}\s*,?\s*Y\s*[:=]\s*{_NUMBER}\s*,?\s*Z\s*[:=]\s*{_NUMBER}"
    r"\s*([^\d\s,;:=][^\d,;:=]{0,20}\d?)?\s*$"
)
TEMPERATURE: Final = re.compile(
    rf"^\s*(Temp\w*)\s*[:=]?\s*{_NUMBER}\s*(?:deg|°)?\s*(C|F|K)\s*$", re.IGNORECASE
)


def are_blocks(start: bytes) -> bool:
    """Whether at least two sensors occur twice in the lines of a text with three axes each."""
    lines = start.decode(errors="replace").splitlines()[:100]
    labels = Counter(match[1].strip() for line in lines if (match := VECTOR.match(line)))
    return sum(count > 1 for count in labels.values()) > 1


def rows_of_blocks(lines: list[str]) -> tuple[list[str], int]:
    """A header line and a row for each complete block, and the number of lines that are in none."""
    blocks: list[dict[str, str]] = [{}]
    sizes: list[int] = [0]
    other = 0
    for line in lines:
        cells = _cells(line)
        if not cells:
            other += bool(line.strip())
            continue
        if not blocks[-1].keys().isdisjoint(cells):
            blocks.append({})
            sizes.append(0)
        blocks[-1].update(cells)
        sizes[-1] += 1
    names = Counter(tuple(block) for block in blocks).most_common(1)[0][0]
    # The first block can begin in the middle, and is then in another order.
    rows = [",".join(block[name] for name in names) for block in blocks if block.keys() == set(names)]
    other += sum(size for block, size in zip(blocks, sizes, strict=True) if block.keys() != set(names))
    return [",".join(names), *rows], other


def _cells(line: str) -> dict[str, str]:
    """The numbers of a line by column name; empty for a line of another kind."""
    match = VECTOR.match(line)
    if match is not None:
        label, unit = match[1].strip(), (match[5] or "").strip()
        shown = f" ({unit})" if unit else ""
        return {f"{label} {axis}{shown}": match[2 + i] for i, axis in enumerate("XYZ")}
    match = TEMPERATURE.match(line)
    return {} if match is None else {f"{match[1]} (deg{match[3].upper()})": match[2]}
