"""Data for continuing an interrupted run: journal, program, and a clock that continues the run's clock."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from typing import Any, Final

from imucal.errors import InputError
from imucal.rig.motion import Program, Step
from imucal.stand.clock import SYSTEM_CLOCK, Clock, Item
from imucal.stand.driver import Progress
from imucal.stand.journal import Logged, read_journal

__all__ = ["Interrupted", "interrupted_in", "program_from"]

ENDING: Final = ".journal"
# The monotonic clock of a computer starts again when the computer restarts. The computer counts as restarted
# since the interruption if the elapsed times by this clock and by the time of day differ by more than this
# number, s.
RESTARTED_S: Final = 5.0


@dataclass(frozen=True)
class Interrupted:
    """An interrupted run.

    logged  contents of the journal
    output  path of the recording
    about   data that the interrupted command stored: its name, options and programs
    clock   clock that continues the clock of the run
    """

    logged: Logged
    output: Path
    about: Mapping[str, Any]
    clock: Clock

    @property
    def progress(self) -> Progress:
        """Number of completed steps, and the zero of the motors."""
        return Progress(self.logged.steps_done, self.logged.zero_deg or (0.0, 0.0, 0.0))


def interrupted_in(path: str | os.PathLike[str]) -> Interrupted:
    """The interrupted run of the only journal in a folder, or of a given journal.

    Raises InputError if there is no journal or more than one, or if the run cannot be resumed.
    """
    given = Path(path)
    found = sorted(given.glob(f"*{ENDING}")) if given.is_dir() else [given]
    if len(found) != 1:
        what = "no journal" if not found else f"{len(found)} journals ({', '.join(p.name for p in found)})"
        raise InputError(f"{given} has {what}: give the folder of one interrupted run, or its journal")
    logged = read_journal(found[0])
    about = logged.header.get("resume")
    if not isinstance(about, Mapping):
        raise InputError(
            f"{found[0]} does not say how its run is continued: save its samples with `imucal stand recover "
            f"{found[0]} -o FILE`"
        )
    if logged.zero_deg is None:
        raise InputError(
            f"{found[0]} does not contain the motor positions: the run was interrupted before it began, or "
            "is not one of a GRBL stand. Save its samples, if it has any, with `imucal stand recover "
            f"{found[0]} -o FILE`, and run the program again"
        )
    return Interrupted(logged, Path(str(found[0]).removesuffix(ENDING)), about, _clock_after(logged))


def program_from(steps: Any) -> Program:
    """The program from its steps in a journal."""
    return Program(tuple(Step(tuple(step["turn_deg"]), step["move_s"], step["hold_s"]) for step in steps))


def _clock_after(logged: Logged) -> Clock:
    """The clock for the continuation of a run.

    It is the clock of the computer. If the computer has restarted since the interruption, this clock is
    shifted so that it continues the clock of the run. The time of day gives the duration of the interruption.
    """
    last_s = max([*logged.host_s[-1:].tolist(), *logged.positions[-1:, 0].tolist()], default=0.0)
    now_s = last_s + max(time.time() - Path(logged.path).stat().st_mtime, 0.0)
    shift_s = now_s - SYSTEM_CLOCK.now_s()
    return SYSTEM_CLOCK if abs(shift_s) < RESTARTED_S else _Shifted(shift_s)


@dataclass(frozen=True)
class _Shifted:
    """The clock of the computer, shifted by a constant."""

    shift_s: float

    def now_s(self) -> float:
        return SYSTEM_CLOCK.now_s() + self.shift_s

    def sleep(self, duration_s: float) -> None:
        SYSTEM_CLOCK.sleep(duration_s)

    def next_item(self, queue: SimpleQueue[Item], wait_s: float) -> Item:
        return SYSTEM_CLOCK.next_item(queue, wait_s)

    def start_work(self, thread: Thread) -> None:
        SYSTEM_CLOCK.start_work(thread)
