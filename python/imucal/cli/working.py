"""A progress display on the terminal while a command works."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

__all__ = ["Stage", "working"]

# Time after which the progress display appears, s. Commands that end earlier do not load the library rich.
DELAY_S = 1.0


class Stage:
    """The display of the current stage of a command on the terminal; does nothing without a terminal."""

    def __init__(self, name: str, steps: int | None = None) -> None:
        self._name, self._steps, self._done = name, steps, 0
        self._start_s = time.monotonic()
        self._shown: tuple[Progress, TaskID] | None = None
        self._lock = threading.Lock()

    def __call__(self, name: str) -> None:
        """Show the name of the next stage."""
        self._name = name
        self._update()

    def step(self) -> None:
        """Count one step as done."""
        self._done += 1
        self._update()

    def line(self, text: str) -> None:
        """Print a line on standard error, above the display."""
        with self._lock:
            if self._shown is not None:
                self._shown[0].console.print(text, markup=False, highlight=False, soft_wrap=True)
                return
        print(text, file=sys.stderr, flush=True)

    def show(self) -> None:
        """Start the display."""
        progress = _progress(self._steps is not None)
        with self._lock:
            self._shown = progress, progress.add_task(self._name, total=self._steps, completed=self._done)
            progress.tasks[0].start_time = self._start_s
        progress.start()

    def stop(self) -> None:
        """End the display, if it is shown."""
        if self._shown is not None:
            self._shown[0].stop()

    def _update(self) -> None:
        with self._lock:
            if self._shown is not None:
                progress, task = self._shown
                progress.update(task, description=self._name, completed=self._done)


@contextmanager
def working(stage: str, steps: int | None = None) -> Iterator[Stage]:
    """Show a progress display on standard error if the work takes longer than `DELAY_S` (1 s).

    The display shows the stage and the elapsed time, and with `steps` also the number of steps done and the
    remaining time. Nothing is shown without a terminal.
    """
    current = Stage(stage, steps)
    if not sys.stderr.isatty():
        yield current
        return
    timer = threading.Timer(DELAY_S, current.show)
    timer.daemon = True
    timer.start()
    try:
        yield current
    finally:
        timer.cancel()
        # The timer thread may just be starting the display. It must end before the display is stopped.
        timer.join()
        current.stop()


def _progress(has_steps: bool) -> Progress:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        ProgressColumn,
        TextColumn,
        TimeElapsedColumn as Elapsed,
        TimeRemainingColumn as Remaining,
    )

    columns: list[ProgressColumn] = [
        TextColumn("{task.description}"),
        BarColumn(pulse_style="cyan"),
        Elapsed(),
    ]
    if has_steps:
        columns += [MofNCompleteColumn(), Remaining(), TextColumn("left")]
    return Progress(*columns, console=Console(stderr=True), transient=True, get_time=time.monotonic)
