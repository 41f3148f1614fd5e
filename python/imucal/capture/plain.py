"""The view of a capture as lines of text, for pipes, logs, screen readers, and simple terminals."""

from __future__ import annotations

import queue
import sys
import threading
from collections.abc import Callable
from typing import Final

from imucal.capture.events import Event
from imucal.capture.loop import Command

__all__ = ["RINGING", "PlainView", "line_of"]

# For each kind of event, the first word of the line that reports an event of this kind.
WORDS: Final = {
    "next": "NEXT",
    "hold": "HOLD",
    "taken": "TAKEN",
    "refused": "NOT TAKEN",
    "warning": "WARNING",
    "info": "NOTE",
    "finished": "FINISHED",
}
# Commands that a person types, followed by Enter.
TYPED: Final[dict[str, Command]] = {"u": "undo", "undo": "undo", "q": "finish", "finish": "finish"}
# Kinds of events that ring the bell, because the person looks at the unit and not at the terminal.
RINGING: Final = ("taken", "finished")


def line_of(event: Event) -> str:
    """An event as a line of text: time since the first sample, kind and text."""
    return f"[{event.time_s:7.2f} s] {WORDS[event.kind]}: {event.text}"


class PlainView:
    """Prints each event, and reads commands from a terminal.

    write  function that prints a line
    ring   function that rings the bell of the terminal
    """

    def __init__(self, write: Callable[[str], None], ring: Callable[[], None]) -> None:
        self._write, self._ring = write, ring

    def say(self, event: Event) -> None:
        """Print an event, and ring the bell for events of the kinds in `RINGING`."""
        self._write(line_of(event))
        if event.kind in RINGING:
            self._ring()

    def read_commands(self, commands: queue.SimpleQueue[Command]) -> None:
        """Read commands in a thread, if standard input is a terminal."""
        if sys.stdin is None or not sys.stdin.isatty():
            return
        self._write("type u and Enter to drop the last pose, q and Enter to end; Ctrl-C interrupts")
        threading.Thread(target=_read, args=(commands,), daemon=True).start()


def _read(commands: queue.SimpleQueue[Command]) -> None:
    for line in sys.stdin:
        command = TYPED.get(line.strip().lower())
        if command is not None:
            commands.put(command)
