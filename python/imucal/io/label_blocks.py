"""Converts lines with the three axes of a sensor, as printed by examples of Arduino libraries, to a table.

The examples of Adafruit print one line per sensor. The lines of all sensors together form one sample:

    Acceleration X: 0.04, Y: 0.11, Z: 9.79 m/s^2    (or: ACCEL: X=0.04 Y=0.11 Z=9.79)
    Rotation X: 0.01, Y: -0.02, Z: 0.00 rad/s
    Temperature: 27.63 degC

The examples of SparkFun for the ICM-20948 print one line per sample:

    Scaled. Acc (mg) [ 00039.15, -0033.29, 00996.78 ], Gyr (DPS) [ 00000.04, -0000.16, -0000.03 ], ...
"""

from __future__ import annotations

import re
from collections import Counter
from typing import Final

__all__ = ["are_blocks", "rows_of_blocks"]

_NUMBER: Final = r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"
# Matches a line with the name of a sensor, its three axes, and the unit.
VECTOR: Final = re.compile(
    rf"^\s*([A-Za-z][\w .]*?)\s*(?:[:=|>-]+\s*)?\bX\s*[:=]\s*{_NUMBER}\s*,?\s*Y\s*[:=]\s*{_NUMBER}\s*,?"
    rf"\s*Z\s*[:=]\s*{_NUMBER}\s*([^\d\s,;:=][^\d,;:=]{{0,20}}\d?)?\s*$"
)
BRACKETS: Final = re.compile(
    rf"([A-Za-z][\w .]*?)\s*\(([^()\[\]]*)\)\s*\[\s*{_NUMBER}\s*,\s*{_NUMBER}\s*,\s*{_NUMBER}\s*\]"
)
TEMPERATURE: Final = re.compile(
    rf"^\s*(Temp\w*)\s*[:=]?\s*{_NUMBER}\s*(?:deg|°)?\s*(C|F|K)\s*$", re.IGNORECASE
)


def are_blocks(start: bytes) -> bool:
    """Whether each of two or more sensors occurs at least twice with its three axes in one line."""
    lines = start.decode(errors="replace").splitlines()[:100]
    labels = Counter(label for line in lines for label, _, _ in _vectors(line))
    return sum(count > 1 for count in labels.values()) > 1


def rows_of_blocks(lines: list[str]) -> tuple[list[str], int]:
    """Convert lines to a table: a header, and one row per complete block (the lines of one sample).

    Returns the lines of the table, and the number of lines outside complete blocks.
    """
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
    # The most frequent sequence of columns counts as a complete block. The first block may be incomplete,
    # because a log can start in the middle of a sample.
    rows = [",".join(block[name] for name in names) for block in blocks if block.keys() == set(names)]
    other += sum(size for block, size in zip(blocks, sizes, strict=True) if block.keys() != set(names))
    return [",".join(names), *rows], other


def _cells(line: str) -> dict[str, str]:
    """The numbers of a line by column name; empty for a line without the three axes of a sensor."""
    vectors = _vectors(line)
    if vectors:
        return {
            f"{label} {axis} ({unit})" if unit else f"{label} {axis}": number
            for label, unit, numbers in vectors
            for axis, number in zip("XYZ", numbers, strict=True)
        }
    match = TEMPERATURE.match(line)
    return {} if match is None else {f"{match[1]} (deg{match[3].upper()})": match[2]}


def _vectors(line: str) -> list[tuple[str, str, tuple[str, ...]]]:
    """Label, unit and the three numbers of each sensor in a line."""
    match = VECTOR.match(line)
    if match is not None:
        return [(match[1].strip(), (match[5] or "").strip(), match.groups()[1:4])]
    return [(found[1].strip(), found[2].strip(), found.groups()[2:5]) for found in BRACKETS.finditer(line)]
