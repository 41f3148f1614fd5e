"""Recording of a run: the driver moves the stand, and samples go to a journal and a recording.

    done = record(driver, source, "run.csv", steps=len(program.steps))
    done.state, done.samples

When a run ends for any reason, the recording contains all samples received so far. After a crash, the journal
in the same folder contains these samples.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from imucal.document.plain import plain
from imucal.errors import ImucalError, InputError
from imucal.io.canonical import require_ending
from imucal.limits.limit import ParameterLimit
from imucal.stand.clock import SYSTEM_CLOCK, Clock
from imucal.stand.driver import Driver, Event, Progress as StepProgress, Source, Status
from imucal.stand.journal import Journal, Logged, read_journal
from imucal.stand.progress import Progress, Prospect
from imucal.stand.recovery import write_recording

__all__ = ["Done", "Moment", "journal_of", "record"]

# Interval between two flushes of the journal to disk, s.
SYNC_S: Final = 0.5
# Longest wait for samples in one iteration, s.
WAIT_S: Final = 0.02
# Time without samples after which the unit counts as lost, s.
SILENT_S: Final = 10.0
# Time after the end of the program, s, during which delayed samples are still read.
TAIL_S: Final = 0.2
# States of a run that ended as intended.
GOOD: Final = ("completed", "target_reached")


@dataclass(frozen=True)
class Moment:
    """The state of a run in progress; `acknowledged` samples are on disk and survive a crash."""

    status: Status
    steps: int
    samples: int
    acknowledged: int
    arrival_rate_hz: float
    prospect: Prospect
    counts: Mapping[str, int]


@dataclass(frozen=True)
class Done:
    """The result of a run.

    state      completed, target_reached, unit_silent, or the code of the driver's failure
    message    cause and remedy; empty if the run was completed
    step       last step of the program that was started, from 0
    steps      number of steps of the program
    samples    number of samples in `output`
    output     path of the recording, None if there are no samples
    counts     counts of received, lost and damaged data, by stable names
    events     events of the run
    prospect   rests, coverage of directions, and standard deviations that a calibration from the run would
               have
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
        """Whether the run was completed or reached its targets."""
        return self.state in GOOD

    def to_dict(self) -> dict[str, Any]:
        """The document of `imucal stand run --json`."""
        document: dict[str, Any] = plain(self)
        return document


def journal_of(output: str | os.PathLike[str]) -> Path:
    """Path of the journal of a run, next to its output file."""
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
    resume: Logged | None = None,
    clock: Clock = SYSTEM_CLOCK,
) -> Done:
    """Run a program and write the recording, .csv or .parquet.

    steps     number of steps of the program
    about     further fields for the header of the journal
    targets   largest permitted standard deviations of parameters. The run ends early when a calibration from
              the samples received so far would have smaller standard deviations
    watch     function that is called with the state of the run in every iteration
    silent_s  time without samples, s, after which the unit counts as lost
    resume    contents of the journal of an interrupted run, which is continued

    Raises ImucalError if driver or source cannot start, or if the disk fails. The journal is removed when
    `output` has been written. After an interrupt or a failure the journal remains, and the error message
    contains the command that recovers the samples.
    """
    require_ending(output)
    path = journal_of(output)
    if resume is not None:
        _require_columns(resume, source)
        source.resume_after(resume)
    with (
        Journal(path, source.columns, about or {}) if resume is None else Journal.continued(resume)
    ) as journal:
        run = _Run(driver, source, journal, steps, targets, watch, silent_s, clock)
        try:
            try:
                run.execute()
            finally:
                driver.close()
                source.close()
            journal.sync()
        except BaseException as error:
            if journal.written == 0 and resume is None:
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


def _require_columns(resume: Logged, source: Source) -> None:
    if resume.columns != source.columns:
        raise InputError(
            f"{resume.path} has the columns {', '.join(resume.columns)}, but the unit sends "
            f"{', '.join(source.columns)}: give the options of the interrupted run"
        )


def _recoverable(error: ImucalError, samples: str, output: str | os.PathLike[str]) -> ImucalError:
    """The error, with a message that also contains the command to recover the samples of the run."""
    journal = journal_of(output)
    return type(error)(
        f"{error}; {samples} are safe in {journal}: after solving the problem (for a full disk: make room), "
        f"write the recording with `imucal stand recover {journal} -o {os.fspath(output)}`",
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
        self.progressed: StepProgress | None = None
        self.synced_s = self.last_sample_s = self.clock.now_s()

    def execute(self) -> None:
        """Run until the program is complete, the targets are reached, or a failure occurs."""
        self.source.start()
        self.driver.start()
        self.last_sample_s = self.clock.now_s()
        while not self.state:
            self.read_samples()
            self.status = self.driver.poll()
            self.log_events()
            # The samples are evaluated during the run only for a live view or for targets, because the
            # evaluation uses up to a fifth of a processor.
            if self.watch is not None or self.targets:
                self.progress.update()
            self.update_state()
            if self.watch is not None:
                self.watch(self.moment())
        # Samples that were still being transmitted when the motors stopped are read now.
        tail_s = self.clock.now_s() + TAIL_S
        while self.clock.now_s() < tail_s:
            self.read_samples()
        self.log_events()
        self.progress.update(wait=True)
        if self.state == "completed" and self.targets and not self.progress.prospect.reaches(self.targets):
            message = (
                "the program ended before the targets for the standard deviations were reached: make it "
                "longer"
            )
            self.log(Event("target_missed", message))

    def read_samples(self) -> None:
        """Move samples to the journal, and flush it from time to time."""
        rows = self.source.read(WAIT_S)
        now_s = self.clock.now_s()
        if len(rows):
            self.last_sample_s = now_s
            self.journal.samples(rows, self.source.arrivals())
            self.progress.add(rows)
            self.driver.observe(rows)
        if now_s - self.synced_s >= SYNC_S:
            self.acknowledged = self.journal.sync()
            self.synced_s = now_s

    def log_events(self) -> None:
        """Write positions and events to the journal."""
        self.journal.positions(self.driver.positions())
        progress = self.driver.progress()
        if progress is not None and progress != self.progressed:
            self.progressed = progress
            self.journal.progress(progress.steps_done, progress.zero_deg)
        for event in (*self.driver.events(), *self.source.events()):
            self.log(event)

    def log(self, event: Event) -> None:
        self.journal.event(self.clock.now_s(), event.code, event.message)

    def update_state(self) -> None:
        """Set `state` and `message` if the run is over."""
        silent_s = self.clock.now_s() - self.last_sample_s
        if self.status.state == "failed":
            self.state, self.message = self.status.code, self.status.message
        elif self.status.state == "finished":
            self.state = "completed"
        elif silent_s > self.silent_s:
            self.state = "unit_silent"
            self.message = (
                f"the unit has sent no sample for {silent_s:.0f} s: check its supply, its cable, the baud "
                "rate, and that the columns or the packet file match the data it sends"
            )
        elif self.status.state == "holding" and self.progress.prospect.reaches(self.targets):
            self.state = "target_reached"
        if self.state not in ("", "completed"):
            self.log(Event(self.state, self.message))

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
