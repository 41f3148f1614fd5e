"""Aims of a benchmark, and whether they are met."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Gate:
    """An aim: its description, the result, whether it is met, and the number of cases."""

    what: str
    aim: str
    found: str
    met: bool
    of: int = 0
