"""What the columns of a file with names of its own may be: the way out of an error, for a person to judge.

Time (ms), Acc X (g), ..., Gyr Z (deg/s)  ->  --columns 'time_ms=Time (ms),accel_x_g=Acc X (g),...'
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Final

from imucal.io.vocabulary import is_canonical

__all__ = ["columns_suggested"]

TIME: Final = re.compile(r"^(t|time|times|timestamp|stamp|ts|sec|seconds|elapsed)(?![a-z])", re.IGNORECASE)
TRIADS: Final = {
    "accel": re.compile(r"^(a|f|acc\w*?|specific[ _]force|linear[ _]?acc\w*?)[ _.\[(-]*([xyz])(?![a-z])"),
    "gyro": re.compile(r"^(g|w|gyr\w*?|omega|ang\w*?[ _](?:rate|vel)\w*?|rot\w*?)[ _.\[(-]*([xyz])(?![a-z])"),
}
# The first that stands in the name; the last is what most files have that do not say.
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
        # "radps" ends with "dps".
        ("radps", "rad"),
        ("mdps", "mdps|mdeg"),
        ("dps", "deg|dps|°"),
        ("radps", ""),
    ),
}


def columns_suggested(names: Iterable[str]) -> str:
    """A sentence with the option that may name the columns; empty if nothing is known of some of them."""
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
    """What a column is, and its canonical name: ("accel_x", "accel_x_g")."""
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
