"""A sign of life while a command works."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

__all__ = ["working"]

# What is done sooner needs no sign.
PATIENCE_S = 1.0


@contextmanager
def working(stage: str, steps: int | None = None) -> Iterator[Callable[[], None]]:
    """Show on a terminal's standard error what takes longer than a second; it vanishes when done.

    The stage and the time spent in it; with `steps` also how many are done and the time left. What it gives
    is to be called after each step.
    """
    if not sys.stderr.isatty():
        yield _nothing
        return
    import threading

    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, TextColumn
    from rich.progress import TimeElapsedColumn as Elapsed
    from rich.progress import TimeRemainingColumn as Remaining

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
        yield lambda: progress.advance(task)
    finally:
        patience.cancel()
        # It may be starting at this very moment.
        patience.join()
        if progress.live.is_started:
            progress.stop()


def _nothing() -> None:
    pass
