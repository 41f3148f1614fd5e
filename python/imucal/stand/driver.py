"""Interfaces of a run: the driver that moves a stand, and the source of the unit's samples."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Protocol, TypeAlias

from imucal.arrays import FloatArray
from imucal.stand.journal import Logged

__all__ = ["Driver", "Event", "Position", "Progress", "Source", "Status"]

# Host time, s, and the angles of the three motors, deg.
Position: TypeAlias = tuple[float, float, float, float]


@dataclass(frozen=True)
class Progress:
    """Progress of a run.

    It consists of the number of completed steps, and of the position, deg, that the controller reports when
    all motors are at zero.
    """

    steps_done: int
    zero_deg: tuple[float, float, float]


@dataclass(frozen=True)
class Event:
    """An event of a run for the journal and the operator; `code` is a stable identifier."""

    code: str
    message: str


@dataclass(frozen=True)
class Status:
    """State of a driver.

    state    moving; holding, while a pose is held; finished, after all steps; or failed
    step     current step of the program, from 0
    code     stable identifier of the cause of a failure
    message  information for the operator; for a failure, cause and remedy
    """

    state: Literal["moving", "holding", "finished", "failed"]
    step: int
    code: str = ""
    message: str = ""


class Driver(Protocol):
    """Runs a program on a stand. At the start of the program all motors are at zero.

    Only `start` may block. The recorder calls `poll` about fifty times a second.
    """

    def start(self) -> None:
        """Connect to the stand. Raises ImucalError if the stand does not answer correctly."""

    def poll(self) -> Status:
        """Do the work that is due, without blocking, and return the state of the stand."""

    def observe(self, samples: FloatArray) -> None:
        """Receive new samples of the unit, (N, columns of the source). Drivers with encoders ignore them."""

    def positions(self) -> Sequence[Position]:
        """Readings of the motor angles since the last call."""

    def events(self) -> Sequence[Event]:
        """Events since the last call."""

    def progress(self) -> Progress | None:
        """The progress from which the run can be resumed; None if it cannot be resumed."""

    def close(self) -> None:
        """Stop the stand if it moves, and disconnect. Must not raise."""


class Source(Protocol):
    """A stream of samples of a unit.

    columns  canonical column names of a sample (see imucal.io)
    """

    columns: tuple[str, ...]

    def start(self) -> None:
        """Connect to the unit. Raises ImucalError if the connection fails."""

    def read(self, wait_s: float) -> FloatArray:
        """Samples since the last call, (N, columns). Waits at most `wait_s` seconds for the first sample."""

    def arrivals(self) -> FloatArray:
        """Host time of arrival of each sample of the last `read`, (N,), s."""

    def events(self) -> Sequence[Event]:
        """Events since the last call."""

    def resume_after(self, logged: Logged) -> None:
        """Continue the time stamps of the interrupted run `logged`. Raises InputError if not supported."""

    def counts(self) -> dict[str, int]:
        """Counts of received, lost and damaged data by stable names, such as packets_damaged."""

    def close(self) -> None:
        """Disconnect from the unit. Must not raise."""
