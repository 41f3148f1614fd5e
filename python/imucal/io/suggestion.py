"""A proposal for the option --columns, guessed from the column names of a file, as a hint in error messages.

Time (ms), Acc X (g), ..., Gyr Z (deg/s)  ->  --columns 'time_ms=Time (ms),accel_x_g=Acc X (g),...'
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Final

from imucal.io.names import is_canonical

__all__ = ["columns_suggested"]

TIME: Final = re.compile(r"^(t|time|times|timestamp|stamp|ts|sec|seconds|elapsed)(?![a-z])", re.IGNORECASE)
TRIADS: Final = {
    "accel": re.compile(r"^(a|f|acc\w*?|specific[ _]force|linear[ _]?acc\w*?)[ _.\[(-]*([xyz])(?![a-z])"),
    "gyro": re.compile(r"^(g|w|gyr\w*?|omega|ang\w*?[ _](?:rate|vel)\w*?|rot\w*?)[ _.\[(-]*([xyz])(?![a-z])"),
}
# Pattern of each unit in a column name, tried in this order; the last entry is the default.
UNITS: Final = {
    "time": (("ns", r"\bns\b|nano"), ("us", r"\b[uµμ]s\b|micro"), ("ms", r"\bms\b|milli"), ("s", "")),
    "accel": (
        ("lsb", "lsb|raw|count"),
        ("mps2", r"m/s|mps|m\.s|ms-2"),
        ("mg", r"\bmg\b"),
        ("g", r"\bg\b"),
        ("mps2", ""),
    ),
    "gyro": (
        ("lsb", "lsb|raw|count"),
        # "rad" comes before "dps" because "radps" contains both.
        ("radps", "rad"),
        ("mdps", "mdps|mdeg"),
        ("dps", "deg|dps|°"),
        ("radps", ""),
    ),
}


def columns_suggested(names: Iterable[str]) -> str:
    """A sentence that proposes the option --columns; empty if accelerometer and gyroscope are incomplete."""
    guessed: dict[str, str] = {}
    there = set()
    for name in names:
        role = _role(name)
        if role is None or "," in name or "=" in name or "'" in name:
            continue
        what, ours = role
        if what in there:
            return ""
        there.add(what)
        if not is_canonical(name):
            guessed[ours] = name
    if not guessed or not {f"{triad}_{axis}" for triad in TRIADS for axis in "xyz"} <= there:
        return ""
    pairs = ",".join(f"{ours}={theirs}" for ours, theirs in guessed.items())
    return f"If these are the columns and their units: --columns '{pairs}' (columns=...). "


def _role(name: str) -> tuple[str, str] | None:
    """Quantity and canonical name guessed for a column name: ("accel_x", "accel_x_g"); None if unknown."""
    plain = name.strip().lower()
    if TIME.match(plain):
        return "time", f"time_{_unit('time', plain)}"
    for triad, pattern in TRIADS.items():
        if (match := pattern.match(plain)) is not None:
            what = f"{triad}_{match[2]}"
            return what, f"{what}_{_unit(triad, plain[match.end() :])}"
    return None


def _unit(of: str, name: str) -> str:
    spaced = name.replace("_", " ")
    return next(unit for unit, pattern in UNITS[of] if re.search(pattern, spaced))
