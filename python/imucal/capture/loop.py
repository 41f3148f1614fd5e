"""The main loop of a guided recording: writes the samples, passes them to the session, and reports events.

The session (`Session`) requests poses and decides which of them count.
"""

from __future__ import annotations

import math
import queue
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final, Literal, TypeAlias

import numpy as np

from imucal.capture.events import Event, Kind
from imucal.capture.file import CaptureFile
from imucal.capture.session import Session
from imucal.stand.clock import SYSTEM_CLOCK, Clock
from imucal.stand.stream import StreamSource

__all__ = ["Capture", "Command", "Ending"]

Command: TypeAlias = Literal["undo", "finish", "stop"]
# Ways in which a capture ends: all poses are recorded, the person ends or interrupts the recording, or the
# unit's data stream ends.
Ending: TypeAlias = Literal["finished", "ended_by_person", "stopped", "stream_ended"]

# Longest wait for samples in one iteration, s.
WAIT_S: Final = 0.05
# Number of rows that the session processes in one step. After each step, newly arrived rows are written to
# the file. At 100 Hz this number of rows is a third of a second.
ROWS_AT_ONCE: Final = 32
# Interval between two flushes to the disk, s.
SYNC_S: Final = 0.5
# Time without a sample after which a message says that the unit sends no data, s of the computer's clock.
SILENT_S: Final = 1.0
# Interval at which the message that the unit sends no data is repeated, s of the computer's clock.
SILENT_AGAIN_S: Final = 10.0
# Shortest time between two messages about damaged data, s of the computer's clock.
DAMAGED_AGAIN_S: Final = 2.0
UNIT_SILENT: Final = "check the cable, the supply and the connection of the unit"
# Names of the counters of damaged or lost data, each with the text that a message uses for these data.
DAMAGED: Final = {
    "lines_damaged": "lines do not have the expected columns",
    "packets_damaged": "packets are damaged",
    "messages_damaged": "messages cannot be read",
    "counters_not_finite": "time stamps are not numbers",
}


@dataclass
class Capture:
    """A guided recording in progress (a capture).

    say       function that is called with each event
    commands  queue of the commands that the person who holds the unit has given
    """

    source: StreamSource
    file: CaptureFile
    session: Session
    say: Callable[[Event], None]
    clock: Clock = SYSTEM_CLOCK
    commands: queue.SimpleQueue[Command] = field(default_factory=queue.SimpleQueue)

    def run(self) -> Ending:
        """Record until the capture ends, and return how it ended. Closes the source, but not the file."""
        try:
            if len(self.file.existing):
                self._tell(self.session.resume(self.file.existing))
            if self.session.done:
                return "finished"
            self.source.start()
            return self._record()
        finally:
            self.source.close()

    def _record(self) -> Ending:
        now_s = self.clock.now_s()
        self._heard_s, self._silent_said_s = now_s, math.inf
        self._synced_s = self._damaged_s = now_s
        self._damaged: dict[str, int] = {}
        self._received_s = self.session.snapshot.time_s
        # Rows that are in the file but have not been processed by the session.
        pending = np.zeros((0, len(self.session.samples.columns)))
        has_ended = False
        while True:
            rows = self.source.read(0.0 if len(pending) else WAIT_S)
            now_s = self.clock.now_s()
            if len(rows):
                # Rows are written to the file before the session processes them, because the session may
                # temporarily be slower than the unit.
                self.file.append(rows)
                self._received_s = float(self.session.samples.times_s(rows[-1:])[0])
                self._back(now_s)
                pending = np.concatenate([pending, rows])
            has_ended = self._link_events() or has_ended
            self._silence(now_s)
            self._damage(now_s)
            if now_s - self._synced_s >= SYNC_S:
                self.file.sync()
                self._synced_s = now_s
            self._tell(self.session.feed(pending[:ROWS_AT_ONCE]))
            pending = pending[ROWS_AT_ONCE:]
            if self.session.done:
                self.file.truncate(len(self.session.samples))
                return "finished"
            if has_ended and not len(pending):
                return "stream_ended"
            command = self._command()
            if command == "undo":
                self._undo()
                pending = pending[:0]
            elif command is not None:
                return "ended_by_person" if command == "finish" else "stopped"

    def _link_events(self) -> bool:
        """Report events of the connection to the unit. Returns whether the data stream has ended for good."""
        for event in self.source.events():
            if event.code == "unit_link_lost" and not self.source.comes_back:
                return True
            self._say("warning", event.code, _link_text(event.code, event.message))
        return False

    def _command(self) -> Command | None:
        try:
            return self.commands.get_nowait()
        except queue.Empty:
            return None

    def _undo(self) -> None:
        kept, events = self.session.undo()
        if any(event.code == "undone" for event in events):
            self.file.truncate(kept)
        self._tell(events)

    def _say(self, kind: Kind, code: str, text: str) -> None:
        self._tell([Event(self._received_s, kind, code, text)])

    def _tell(self, events: list[Event]) -> None:
        for event in events:
            self.say(event)

    def _silence(self, now_s: float) -> None:
        """Report if no samples arrive."""
        silent_s = now_s - self._heard_s
        due_s = SILENT_S if self._silent_said_s == math.inf else self._silent_said_s + SILENT_AGAIN_S
        if silent_s < due_s:
            return
        self._silent_said_s = silent_s
        if not self.source.counts()["samples"] and self.source.bytes_received:
            text = (
                "data arrive, but none can be decoded: check the baud rate, and that --columns or "
                f"--packet describes the data of the unit{_example(self.source)}"
            )
        elif not self.source.counts()["samples"]:
            text = f"no data yet: {self.source.hint or UNIT_SILENT}"
        else:
            text = f"no data for {silent_s:.0f} s: {UNIT_SILENT}"
        self._say("warning", "silent", text)

    def _back(self, now_s: float) -> None:
        silent_s = now_s - self._heard_s
        self._heard_s = now_s
        if self._silent_said_s != math.inf:
            self._silent_said_s = math.inf
            text = (
                f"data arrive again after a gap of {silent_s:.1f} s; the pose during the gap does not count"
            )
            self._say("info", "back", text)

    def _damage(self, now_s: float) -> None:
        """Report if data are damaged or lost."""
        counts = {name: count for name, count in self.source.counts().items() if name in DAMAGED}
        new = {name: count - self._damaged.get(name, 0) for name, count in counts.items()}
        worst = max(new, key=lambda name: new[name], default=None)
        if worst is None or new[worst] <= 0 or (now_s - self._damaged_s < DAMAGED_AGAIN_S and self._damaged):
            return
        self._damaged, self._damaged_s = counts, now_s
        text = (
            f"{new[worst]} {DAMAGED[worst]}: check the cable, the baud rate and the load of the computer"
            f"{_example(self.source) if worst == 'lines_damaged' else ''}"
        )
        self._say("warning", worst, text)


def _example(source: StreamSource) -> str:
    return f"; {source.remark}" if source.remark else ""


def _link_text(code: str, message: str) -> str:
    if code == "unit_link_lost":
        return (
            f"the connection to the unit is lost: {message}; recorded samples are kept: connect the unit "
            "again"
        )
    return message
