"""A simulated stand with a unit, in real time or faster. One object is both driver and source."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.errors import InputError
from imucal.io.vocabulary import column_names
from imucal.rig.motion import Program
from imucal.stand.clock import SYSTEM_CLOCK, Clock
from imucal.stand.driver import Event, Position, Progress, Status
from imucal.stand.faults import SimulatedUnit
from imucal.stand.journal import Logged

__all__ = ["SimulatedStand"]

# Pause between two checks of the clock, s.
PAUSE_S: Final = 0.002


class SimulatedStand:
    """Runs a program with a simulated unit; used as the driver and as the source of a recording.

    speed   speed relative to real time; the samples do not depend on it
    seed    seed of the noise

    The encoder readings are columns of the samples: stand_1_deg, stand_2_deg, stand_3_deg.
    """

    def __init__(
        self,
        program: Program,
        unit: SimulatedUnit,
        *,
        seed: int,
        speed: float = 1.0,
        clock: Clock = SYSTEM_CLOCK,
    ) -> None:
        if not (np.isfinite(speed) and speed > 0):
            raise InputError(f"speed is {speed}: give a positive number, 1 is real time")
        recording = unit.run(program, seed)
        named = [
            (name.replace("_rad", "_deg"), np.degrees(values))
            if name.startswith("stand_")
            else (name, values)
            for name, values in column_names(recording)
        ]
        self.columns = tuple(name for name, _ in named)
        self._rows = np.column_stack([values for _, values in named])
        self._time_s = recording.time_s
        self._speed, self._clock = speed, clock
        lengths_s = [(step.move_s, step.hold_s) for step in program.steps]
        self._ends_s = np.cumsum(lengths_s)
        self._started_s: float | None = None
        self._given = 0
        self._arrivals: FloatArray = np.zeros(0)

    def start(self) -> None:
        """Start the common clock of the stand and the unit; a second call does nothing."""
        if self._started_s is None:
            self._started_s = self._clock.now_s()

    def read(self, wait_s: float) -> FloatArray:
        """Samples up to the current time that have not been read yet, (N, columns)."""
        until_s = self._clock.now_s() + wait_s
        while True:
            end = int(np.searchsorted(self._time_s, self._now_s(), side="right"))
            if end > self._given or self._clock.now_s() >= until_s:
                break
            self._clock.sleep(PAUSE_S)
        rows: FloatArray = self._rows[self._given : max(end, self._given)]
        started_s = 0.0 if self._started_s is None else self._started_s
        self._arrivals = started_s + self._time_s[self._given : max(end, self._given)] / self._speed
        self._given += len(rows)
        return rows

    def arrivals(self) -> FloatArray:
        """Host time at which each sample of the last `read` was taken, (N,), s."""
        return self._arrivals

    def poll(self) -> Status:
        """The state of the stand at this time: moving or holding; finished once the last sample is read."""
        now_s = self._now_s()
        phase = int(np.searchsorted(self._ends_s, now_s, side="right"))
        if phase >= len(self._ends_s):
            last = len(self._ends_s) // 2 - 1
            return Status("finished" if self._given == len(self._rows) else "holding", last)
        return Status("holding" if phase % 2 else "moving", phase // 2)

    def observe(self, samples: FloatArray) -> None:
        """Does nothing, because the motion depends on time only."""

    def positions(self) -> Sequence[Position]:
        """Empty, because encoder readings are columns of the samples."""
        return ()

    def events(self) -> Sequence[Event]:
        """No events."""
        return ()

    def progress(self) -> Progress | None:
        """None, because the run cannot be resumed."""
        return None

    def counts(self) -> dict[str, int]:
        """Number of samples read."""
        return {"samples": self._given}

    def resume_after(self, logged: Logged) -> None:
        """Raises InputError, because a simulated run can be repeated instead."""
        raise InputError("a simulated run cannot be resumed: run it again")

    def close(self) -> None:
        """Stop sending samples."""
        self._rows = self._rows[: self._given]
        self._time_s = self._time_s[: self._given]

    def _now_s(self) -> float:
        return 0.0 if self._started_s is None else (self._clock.now_s() - self._started_s) * self._speed
