"""What moves a stand, behind one interface, and what brings the samples of the unit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, TypeAlias

from imucal.arrays import FloatArray

__all__ = ["Driver", "Event", "Position", "Source", "Status"]

# The host's time, s, and the angles of the three motors, deg.
Position: TypeAlias = tuple[float, float, float, float]


@dataclass(frozen=True)
class Event:
    """What happened, for the journal and for people; `code` is a stable word."""

    code: str
    message: str


@dataclass(frozen=True)
class Status:
    """Where a driver is.

    state    moving or holding, finished (the program is through), or failed
    step     step of the program, from 0
    code     of a failure: a stable word
    message  what is to be known, of a failure the reason and the way out
    """

    state: Literal["moving", "holding", "finished", "failed"]
    step: int
    code: str = ""
    message: str = ""


class Driver(Protocol):
    """Takes a stand through a program, from all motors at zero.

    Nothing blocks but `start`: the recording calls `poll` some fifty times a second.
    """

    def start(self) -> None:
        """Come to terms with the stand; ImucalError if it does not answer as it should."""

    def poll(self) -> Status:
        """Do what is due, and say where the stand is."""

    def see(self, samples: FloatArray) -> None:
        """New samples of the unit, for a driver that goes by them; rows of the source's columns."""

    def positions(self) -> Sequence[Position]:
        """Readings of the motors' angles since the last call."""

    def events(self) -> Sequence[Event]:
        """What happened since the last call."""

    def close(self) -> None:
        """Bring the stand to a stop, if it moves, and let go of it. Must not fail."""


class Source(Protocol):
    """The samples of a unit as they arrive.

    columns  canonical names of the columns of a sample (imucal.io)
    """

    columns: tuple[str, ...]

    def start(self) -> None:
        """Begin; ImucalError if the unit cannot be heard."""

    def read(self, wait_s: float) -> FloatArray:
        """Samples since the last call, (N, columns); waits no longer than `wait_s` for the first."""

    def events(self) -> Sequence[Event]:
        """What happened since the last call."""

    def counts(self) -> dict[str, int]:
        """What arrived and what did not, by stable names, such as packets_damaged."""

    def close(self) -> None:
        """Let go of the unit. Must not fail."""
