"""The motion that would decide between effects that a recording cannot tell apart."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from imucal.document import plain
from imucal.effects import catalogue

__all__ = ["next_motion"]


def next_motion(path: Sequence[str], rivals: Sequence[str]) -> dict[str, Any]:
    """What to record next, in words, and a program that the stand can run."""
    from imucal.motion import SCHEMA, Program

    effects = {effect.name: effect for effect in catalogue()}
    words = []
    for name in path:
        for alias in effects[name].aliases if name in effects else ():
            if alias.name in rivals:
                words.append(f"{name} and {alias.name} are told apart by {alias.told_apart_by}")
    for rival in rivals:
        for alias in effects[rival].aliases if rival in effects else ():
            if alias.name in path and not any(rival in text for text in words):
                words.append(f"{alias.name} and {rival} are told apart by {alias.told_apart_by}")
    if not words:
        words.append("record longer and with other turns: twice the moves, at other rates and of both signs")
    program = Program.random(seed=2, moves=90)
    return {"description": "; ".join(words), "program": {"schema": SCHEMA, **plain(program.to_dict())}}
