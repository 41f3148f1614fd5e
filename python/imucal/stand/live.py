"""The live view of a run in a terminal."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from rich.table import Table

    from imucal.stand.recorder import Moment

__all__ = ["live_view", "recoverable"]

# Interval between two updates of the view, s.
EVERY_S: Final = 0.2
# For each group of parameters, by the common prefix of their names: displayed name and unit. The view shows
# the largest predicted standard deviation of each group.
GROUPS: Final = {
    "accel_bias_": ("accelerometer bias", "m/s^2"),
    "accel_sensitivity_": ("accelerometer sensitivity", ""),
    "gyro_bias_": ("gyroscope bias", "rad/s"),
    "gyro_sensitivity_": ("gyroscope sensitivity", ""),
}


@contextmanager
def live_view(name: str, *, prints_steps: bool = False) -> Iterator[Callable[[Moment], None] | None]:
    """A context manager that yields a function; the function shows the state of a run.

    prints_steps  whether to print a line for each step if there is no terminal, for persons who need the
                  instructions. If it is false and there is no terminal, the context manager yields None
    """
    if not sys.stderr.isatty():
        yield _Steps().say if prints_steps else None
        return
    from rich.console import Console
    from rich.live import Live

    shown_s = 0.0
    with Live(console=Console(stderr=True), auto_refresh=False, transient=True) as live:

        def show(moment: Moment) -> None:
            nonlocal shown_s
            if time.monotonic() - shown_s >= EVERY_S:
                shown_s = time.monotonic()
                live.update(_table(name, moment), refresh=True)

        yield show


@contextmanager
def recoverable(output: Path) -> Iterator[None]:
    """On an interrupt or internal error inside the block, print the command that recovers the data."""
    from imucal.errors import ImucalError
    from imucal.stand.recorder import journal_of

    journal = journal_of(output)
    # A journal that existed before belongs to another run, and the error message of `Journal` already says
    # so.
    was_there = journal.exists()
    try:
        yield
    except ImucalError:
        # The message of this error already contains the command that recovers the data.
        raise
    except BaseException:
        if journal.exists() and not was_there:
            print(
                f"imucal: the recorded samples are in {journal}: imucal stand recover {journal} -o {output}",
                file=sys.stderr,
            )
        raise


class _Steps:
    """Prints a line at the start of each step of the program."""

    def __init__(self) -> None:
        self._step = -1

    def say(self, moment: Moment) -> None:
        if moment.status.step != self._step and moment.status.state != "finished":
            self._step = moment.status.step
            print(f"{self._step + 1} of {moment.steps}: {moment.status.message}", file=sys.stderr, flush=True)


def _table(name: str, moment: Moment) -> Table:
    from rich.table import Table

    table = Table(box=None, show_header=False, pad_edge=False)
    prospect = moment.prospect
    table.add_row(
        name,
        f"step {moment.status.step + 1} of {moment.steps}, {moment.status.state}: {moment.status.message}",
    )
    table.add_row(
        "samples",
        f"{moment.samples}, {moment.arrival_rate_hz:.0f} per second, {moment.acknowledged} on disk",
    )
    bad = {what: count for what, count in moment.counts.items() if count and what != "samples"}
    if bad:
        table.add_row("link", ", ".join(f"{what} {count}" for what, count in bad.items()))
    table.add_row(
        "rests",
        f"{prospect.rests}, covering {prospect.coverage:.0%} of all directions (within 30 deg of a rest)",
    )
    for prefix, (group, unit) in GROUPS.items():
        sigma = [std for parameter, std in prospect.sigma.items() if parameter.startswith(prefix)]
        known = [std for std in sigma if std is not None]
        text = f"{max(known):.1e} {unit}" if sigma and len(known) == len(sigma) else "not determined yet"
        table.add_row(f"{group}, predicted sigma", text)
    return table
