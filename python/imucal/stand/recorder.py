"""One run: the driver moves, the source brings samples, the journal keeps them, and a file comes out.

    done = record(driver, source, "run.csv", steps=len(program.steps))
    done.state, done.samples

Whatever ends a run, what had arrived is in the file; after a crash it is in the journal beside it.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from imucal.document.plain import plain
from imucal.errors import ImucalError
from imucal.io.canonical import require_ending
from imucal.limits.limits import ParameterLimit
from imucal.stand.clock import SYSTEM_CLOCK, Clock
from imucal.stand.driver import Driver, Event, Source, Status
from imucal.stand.journal import Journal, read_journal
from imucal.stand.progress import Progress, Prospect
from imucal.stand.recovery import write_recording

__all__ = ["Done", "Moment", "journal_of", "record"]

# How often the disk is asked, and how long one turn waits for samples.
SYNC_S: Final = 0.5
WAIT_S: Final = 0.02
SILENT_S: Final = 10.0
TAIL_S: Final = 0.2
GOOD: Final = ("completed", "target_reached")


@dataclass(frozen=True)
class Moment:
    """What there is to see of a run while it goes on."""

    status: Status
    steps: int
    samples: int
    acknowledged: int
    arrival_rate_hz: float
    prospect: Prospect
    counts: Mapping[str, int]


@dataclass(frozen=True)
class Done:
    """How a run ended.

    state      completed, target_reached, unit_silent, or the code of what made the driver fail
    message    why, and the way out; empty for a run that went to its end
    step       the last step of the program that was begun, from 0, of `steps`
    samples    how many are in `output`; None is written without any
    counts     what arrived and what did not
    prospect   what the samples promise
    """

    state: str
    message: str
    step: int
    steps: int
    samples: int
    output: str | None
    counts: Mapping[str, int] = field(default_factory=dict)
    events: tuple[Mapping[str, Any], ...] = ()
    prospect: Prospect = field(default_factory=Prospect)

    @property
    def good(self) -> bool:
        """Whether the run went as far as it should."""
        return self.state in GOOD

    def to_dict(self) -> dict[str, Any]:
        """The document of `imucal stand run --json`."""
        document: dict[str, Any] = plain(self)
        return document


def journal_of(output: str | os.PathLike[str]) -> Path:
    """The journal of a run, beside its file."""
    return Path(f"{os.fspath(output)}.journal")


def record(
    driver: Driver,
    source: Source,
    output: str | os.PathLike[str],
    *,
    steps: int,
    about: Mapping[str, Any] | None = None,
    targets: Sequence[ParameterLimit] = (),
    watch: Callable[[Moment], None] | None = None,
    silent_s: float = SILENT_S,
    clock: Clock = SYSTEM_CLOCK,
) -> Done:
    """Run a program to its end and write the recording, .csv or .parquet.

    steps     how many the program has
    about     what else the journal should say of the run
    targets   end early when every parameter is expected to be known so well
    watch     is told of every moment; `acknowledged` samples of it survive a crash
    silent_s  a unit that sends nothing for so long is lost

    Raises ImucalError if driver or source cannot start or the disk fails. The journal is removed once
    `output` is written, and stays after an interrupt or a failure, whose message says how it is used.
    """
    require_ending(output)
    path = journal_of(output)
    with Journal(path, source.columns, about or {}) as journal:
        run = _Run(driver, source, journal, steps, targets, watch, silent_s, clock)
        try:
            try:
                run.to_the_end()
            finally:
                driver.close()
                source.close()
            journal.sync()
        except BaseException as error:
            if journal.written == 0:
                path.unlink()
            elif isinstance(error, ImucalError):
                raise _recoverable(error, f"{journal.written} samples", output) from error
            raise
    logged = read_journal(path)
    if len(logged.samples):
        try:
            write_recording(logged, output)
        except ImucalError as error:
            raise _recoverable(error, f"all {len(logged.samples)} samples", output) from error
    path.unlink()
    return Done(
        run.state,
        run.message,
        run.status.step,
        steps,
        len(logged.samples),
        os.fspath(output) if len(logged.samples) else None,
        source.counts(),
        logged.events,
        run.progress.prospect,
    )


def _recoverable(error: ImucalError, samples: str, output: str | os.PathLike[str]) -> ImucalError:
    """The error of a run whose samples are kept, with the way to them."""
    journal = journal_of(output)
    return type(error)(
        f"{error}; {samples} are safe in {journal}: once that is mended (a full disk: make room), make the "
        f"recording of them with `imucal stand recover {journal} -o {os.fspath(output)}`",
        error.findings,
    )


class _Run:
    """The state of one run."""

    def __init__(
        self,
        driver: Driver,
        source: Source,
        journal: Journal,
        steps: int,
        targets: Sequence[ParameterLimit],
        watch: Callable[[Moment], None] | None,
        silent_s: float,
        clock: Clock,
    ) -> None:
        self.driver, self.source, self.journal = driver, source, journal
        self.steps, self.targets, self.watch, self.silent_s = steps, targets, watch, silent_s
        self.clock = clock
        self.progress = Progress(source.columns, clock)
        self.status = Status("moving", 0)
        self.state, self.message = "", ""
        self.acknowledged = 0
        self.synced_s = self.heard_s = self.clock.now_s()

    def to_the_end(self) -> None:
        """Until the program is through, a target is reached, or something fails."""
        self.source.start()
        self.driver.start()
        self.heard_s = self.clock.now_s()
        while not self.state:
            self.take()
            self.status = self.driver.poll()
            self.keep_what_happened()
            # It costs a fifth of a processor: for somebody who watches, or waits for a target.
            if self.watch is not None or self.targets:
                self.progress.look()
            self.judge()
            if self.watch is not None:
                self.watch(self.moment())
        # What was on its way when the motors stopped.
        tail_s = self.clock.now_s() + TAIL_S
        while self.clock.now_s() < tail_s:
            self.take()
        self.keep_what_happened()
        self.progress.look(finally_too=True)
        if self.state == "completed" and self.targets and not self.progress.prospect.reaches(self.targets):
            message = (
                "the program ended before the standard deviations asked for could be expected: make it longer"
            )
            self.keep(Event("target_missed", message))

    def take(self) -> None:
        """Samples into the journal, and from time to time onto the disk."""
        rows = self.source.read(WAIT_S)
        now_s = self.clock.now_s()
        if len(rows):
            self.heard_s = now_s
            self.journal.samples(rows, now_s)
            self.progress.see(rows)
            self.driver.see(rows)
        if now_s - self.synced_s >= SYNC_S:
            self.acknowledged = self.journal.sync()
            self.synced_s = now_s

    def keep_what_happened(self) -> None:
        """Positions and events into the journal."""
        self.journal.positions(self.driver.positions())
        for event in (*self.driver.events(), *self.source.events()):
            self.keep(event)

    def keep(self, event: Event) -> None:
        self.journal.event(self.clock.now_s(), event.code, event.message)

    def judge(self) -> None:
        """Whether the run is over, and why."""
        silent_s = self.clock.now_s() - self.heard_s
        if self.status.state == "failed":
            self.state, self.message = self.status.code, self.status.message
        elif self.status.state == "finished":
            self.state = "completed"
        elif silent_s > self.silent_s:
            self.state = "unit_silent"
            self.message = (
                f"the unit has sent no sample for {silent_s:.0f} s: check its supply, its cable, the baud "
                "rate, and that the columns or the packet file describe what it sends"
            )
        elif self.status.state == "holding" and self.progress.prospect.reaches(self.targets):
            self.state = "target_reached"
        if self.state not in ("", "completed"):
            self.keep(Event(self.state, self.message))

    def moment(self) -> Moment:
        return Moment(
            self.status,
            self.steps,
            self.journal.written,
            self.acknowledged,
            self.progress.arrival_rate_hz,
            self.progress.prospect,
            self.source.counts(),
        )
