"""A progress display on the terminal while a command works."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

__all__ = ["Stage", "working"]

# The display appears after this time, s.
DELAY_S = 1.0
PATIENCE_S = 1.0


class Stage:
    """The current stage of a command, for the display; does nothing without a terminal."""

    def __init__(self, progress: Progress | None = None, task: TaskID | None = None) -> None:
        self._progress, self._task = progress, task

    def __call__(self, name: str) -> None:
        """Show the name of the next stage."""
        if self._progress is not None and self._task is not None:
            self._progress.update(self._task, description=name)

    def step(self) -> None:
        """Count one step as done."""
        if self._progress is not None and self._task is not None:
            self._progress.advance(self._task)


@contextmanager
def working(stage: str, steps: int | None = None) -> Iterator[Stage]:
    """Show a progress display on standard error while the work takes longer than `DELAY_S`.

    The display shows the stage and the elapsed time, and with `steps` also the number of steps done and the
    remaining time. Nothing is shown without a terminal.
    """
    if not sys.stderr.isatty():
        yield Stage()
        return
    import threading

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
    if steps is not None:
        columns += [MofNCompleteColumn(), Remaining(), TextColumn("left")]
    progress = Progress(*columns, console=Console(stderr=True), transient=True)
    task = progress.add_task(stage, total=steps)
    timer = threading.Timer(DELAY_S, progress.start)
    timer.daemon = True
    timer.start()
    try:
        yield Stage(progress, task)
    finally:
        timer.cancel()
        # The timer may be starting the display right now.
        timer.join()
        if progress.live.is_started:
            progress.stop()
