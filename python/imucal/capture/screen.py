"""The full-screen view of a capture in a terminal."""

from __future__ import annotations

import queue
import threading
from contextlib import suppress
from typing import Any, ClassVar, Final

from rich.table import Table
from rich.text import Text
from textual.app import App, ComposeResult
from textual.binding import Binding, BindingType
from textual.containers import Horizontal, Vertical
from textual.widgets import Footer, ProgressBar, RichLog, Static

from imucal.capture.drawing import draw
from imucal.capture.events import Event, Snapshot
from imucal.capture.loop import Capture, Ending
from imucal.capture.plain import RINGING, line_of
from imucal.io.extra import library

__all__ = ["CaptureScreen"]

# Interval between two updates of the screen, s.
EVERY_S: Final = 0.1
# Maximum time to wait for the end of the recording thread, s. The thread may first have to finish a
# computation with the recorded samples.
ENDS_WITHIN_S: Final = 30.0
# Colours of the large text, by the state of the recording.
COLOURS: Final = {"waiting": "white on dark_blue", "holding": "black on yellow", "taken": "black on green"}
# Colours of the messages, by kind.
MESSAGE_STYLES: Final = {
    "refused": "bold red",
    "warning": "bold yellow",
    "taken": "green",
    "finished": "bold green",
}
# Time for which the reason for the refusal of a pose is shown in large letters, s of the samples' time.
REFUSED_S: Final = 3.0
# Large text for a refused pose, by code of the refusal.
REFUSALS: Final = {
    "moved_too_early": "TOO EARLY",
    "repeated": "SAME POSE",
    "shaking": "SHAKING",
    "stays": "ROTATE",
    "too_fast": "TOO FAST",
    "accel_saturation": "CLIPPED",
    "gyro_saturation": "CLIPPED",
    "samples_missing": "DATA LOST",
    "silent": "NO DATA",
    "unit_link_lost": "UNPLUGGED",
}
# Font of the large text, a font of pyfiglet. Its letters are six lines high, which is readable from two
# metres.
FONT: Final = "big"


class CaptureScreen(App[None]):
    """Shows the instruction in large letters, the next pose, steadiness, predictions, and messages.

    ending  how the capture ended; None during the capture
    error   exception with which the capture ended, or None
    """

    CSS = """
    #large { height: 8; content-align: center middle; text-align: center; }
    #middle { height: 1fr; }
    #pose { width: 1fr; height: 1fr; border: round $primary; }
    #pose { content-align: center middle; text-align: center; }
    #right { width: 1fr; min-width: 60; }
    #numbers { height: auto; }
    #steadiness { margin: 0 1; }
    #messages { height: 1fr; border: round $primary; }
    """
    BINDINGS: ClassVar[list[BindingType]] = [
        ("u", "undo", "drop the last pose"),
        ("q", "finish", "end and calibrate"),
        # The library textual has its own binding of Ctrl+C, which it does not show in the footer. A binding
        # with priority replaces it.
        Binding("ctrl+c", "stop", "interrupt, to continue later", priority=True),
    ]
    ENABLE_COMMAND_PALETTE = False

    def __init__(self, capture: Capture) -> None:
        super().__init__()
        self._capture = capture
        self._events: queue.SimpleQueue[Event] = queue.SimpleQueue()
        self._refusal = Event(-REFUSED_S, "info", "", "")
        self._figlet: Any = library("pyfiglet", "capture", "Large letters")
        self.ending: Ending | None = None
        self.error: BaseException | None = None
        self._has_started, self._has_ended = False, threading.Event()
        capture.say = self._events.put

    def compose(self) -> ComposeResult:
        """The widgets of the screen."""
        yield Static(id="large")
        with Horizontal(id="middle"):
            yield Static(id="pose")
            with Vertical(id="right"):
                yield Static(id="numbers")
                yield ProgressBar(total=100, show_eta=False, id="steadiness")
                # The minimum width is set to 0, so that long lines are broken at the width of the panel.
                yield RichLog(id="messages", wrap=True, min_width=0)
        yield Footer()

    def on_mount(self) -> None:
        """Start the recording in a thread, and update the screen from time to time."""
        self.title = str(self._capture.file.path)
        self.set_interval(EVERY_S, self._update)
        self._has_started = True
        self.run_worker(self._record, thread=True, exit_on_error=False)

    def action_undo(self) -> None:
        """Drop the last pose."""
        self._capture.commands.put("undo")

    def action_finish(self) -> None:
        """End the recording, and calibrate."""
        self._capture.commands.put("finish")

    def action_stop(self) -> None:
        """Interrupt the recording; the same command can continue it later."""
        self._capture.commands.put("stop")

    def _record(self) -> None:
        try:
            self.ending = self._capture.run()
        except BaseException as error:
            self.error = error
        self._has_ended.set()
        # A RuntimeError means that a signal has already ended the screen.
        with suppress(RuntimeError):
            self.call_from_thread(self.exit)

    def stop_recording(self) -> None:
        """End the recording, and wait until its thread no longer writes to the file."""
        if self._has_started and not self._has_ended.is_set():
            self._capture.commands.put("stop")
            self._has_ended.wait(ENDS_WITHIN_S)

    def _update(self) -> None:
        snapshot = self._capture.session.snapshot
        messages = self.query_one("#messages", RichLog)
        while not self._events.empty():
            event = self._events.get_nowait()
            messages.write(Text(line_of(event), style=MESSAGE_STYLES.get(event.kind, "")))
            if event.kind in RINGING:
                self.bell()
            if event.code in REFUSALS:
                self._refusal = event
            elif event.kind in ("taken", "hold"):
                self._refusal = Event(-REFUSED_S, "info", "", "")
        self.query_one("#large", Static).update(self._large(snapshot))
        self.query_one("#pose", Static).update(self._pose(snapshot))
        self.query_one("#numbers", Static).update(_numbers(snapshot))
        self.query_one("#steadiness", ProgressBar).update(progress=100.0 * snapshot.steadiness)

    def _large(self, snapshot: Snapshot) -> Text:
        """The instruction in large letters."""
        words, style = (
            {
                "waiting": "ROTATE",
                "holding": f"HOLD {max(snapshot.hold_s - snapshot.held_s, 0.0):.0f}",
                "taken": f"TAKEN {snapshot.poses}",
                "finished": "DONE",
            }[snapshot.state],
            COLOURS.get(snapshot.state, "black on green"),
        )
        if not snapshot.samples:
            words = "NO DATA"
        if snapshot.time_s - self._refusal.time_s < REFUSED_S:
            words, style = REFUSALS[self._refusal.code], "white on red"
        size = self.query_one("#large", Static).size
        large = str(self._figlet.figlet_format(words, font=FONT, width=max(size.width, 20))).rstrip("\n")
        return Text(large, style=style, no_wrap=True)

    def _pose(self, snapshot: Snapshot) -> Text:
        """The drawing of the next pose with its description."""
        if snapshot.attitude is None:
            return Text("put the unit down" if snapshot.state == "finished" else "waiting for data")
        size = self.query_one("#pose", Static).size
        drawing = draw(snapshot.attitude, size.width, max(size.height - 2, 2))
        return Text.assemble((f"next: {snapshot.request}\n\n", "bold"), drawing)


def _numbers(snapshot: Snapshot) -> Table:
    """Table with the number of poses and the predicted standard deviations."""
    title = f"pose {snapshot.poses} of {snapshot.wanted}, {snapshot.samples} samples"
    table = Table(title=title, box=None, pad_edge=False, title_justify="left", title_style="bold")
    table.add_column("1 sigma")
    for name in ("before", "after the pose", "target"):
        table.add_column(name, justify="right")
    for row in snapshot.rows:
        table.add_row(row.group, row.before, row.after, row.target)
    table.add_row("steadiness", "", f"{100.0 * snapshot.steadiness:.0f} %", "")
    return table
