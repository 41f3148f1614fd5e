"""A sign of life while a command works."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress, TaskID

__all__ = ["Stage", "working"]

# What is done sooner needs no sign.
PATIENCE_S = 1.0


class Stage:
    """What a command is at; without a terminal nothing is shown."""

    def __init__(self, progress: Progress | None = None, task: TaskID | None = None) -> None:
        self._progress, self._task = progress, task

    def __call__(self, name: str) -> None:
        """Go on to another stage."""
        if self._progress is not None and self._task is not None:
            self._progress.update(self._task, description=name)

    def step(self) -> None:
        """One of the steps is done."""
        if self._progress is not None and self._task is not None:
            self._progress.advance(self._task)


@contextmanager
def working(stage: str, steps: int | None = None) -> Iterator[Stage]:
    """Show on a terminal's standard error what takes longer than a second; it vanishes when done.

    The stage and the time spent in it; with `steps` also how many of them are done, and the time left.
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
    patience = threading.Timer(PATIENCE_S, progress.start)
    patience.daemon = True
    patience.start()
    try:
        yield Stage(progress, task)
    finally:
        patience.cancel()
        # It may be starting at this very moment.
        patience.join()
        if progress.live.is_started:
            progress.stop()
