"""Calibration of the jobs of one task, in a local process or a Dask worker."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from imucal.errors import FitError, FormatError, ImucalError, InputError, NotEnoughMotionError
from imucal.estimation.calibrate import calibrate
from imucal.fleet.job import Job, KeyedJob, Options, keyed, keyed_by, unread
from imucal.fleet.outcome import Outcome, measured_of
from imucal.io import files_per_recording, read
from imucal.recording.recording import Recording

__all__ = ["FILE_MISSING", "TIME_LIMIT", "Task", "failure_of"]

# Code of the failure of a job, by the class of the exception; used if neither the exception nor one of its
# findings has a code.
CODES = (
    (NotEnoughMotionError, "not_enough_motion"),
    (FormatError, "format"),
    (FitError, "fit_failed"),
    (InputError, "input"),
    (ImucalError, "no_result"),
    (MemoryError, "memory"),
)


FILE_MISSING: Final = "file_missing"
# Code of a job that exceeded the time limit.
TIME_LIMIT: Final = "time_limit"


@dataclass(frozen=True)
class Task:
    """Jobs that one process computes one after the other.

    A task contains the paths of the files, not their contents.

    If a job has no key yet, its key is computed in the process that reads the files of the job.
    """

    jobs: tuple[Job | KeyedJob, ...]
    options: Options

    def __len__(self) -> int:
        return len(self.jobs)

    def run(self) -> list[Outcome]:
        """Compute the outcome of each job. A failure is also an outcome, after which the next job follows.

        A job that exceeds the time limit ends the task, because the thread of the job cannot be ended.
        """
        limit_s = self.options.time_limit_s
        if limit_s is None:
            return [_outcome(job, self.options) for job in self.jobs]
        found: queue.SimpleQueue[Outcome] = queue.SimpleQueue()

        def compute() -> None:
            for job in self.jobs:
                found.put(_outcome(job, self.options))

        threading.Thread(target=compute, daemon=True).start()
        outcomes: list[Outcome] = []
        while len(outcomes) < len(self):
            try:
                outcomes.append(found.get(timeout=limit_s))
            except queue.Empty:
                message = (
                    f"the recording takes longer than the time limit of {limit_s:g} s: repair its file, or "
                    "give a larger --time-limit-s with --retry"
                )
                late = self.jobs[len(outcomes)]
                keyed_job = late if isinstance(late, KeyedJob) else unread(late, self.options.text)
                return [*outcomes, Outcome(keyed_job, "failed", TIME_LIMIT, message, limit_s)]
        return outcomes

    def is_stuck(self, answer: list[Outcome]) -> bool:
        """Whether the last job of the answer exceeded its time limit and is still running."""
        return bool(answer) and answer[-1].code == TIME_LIMIT


def failure_of(error: BaseException) -> tuple[str, str]:
    """Code and message of the error of a job."""
    findings = getattr(error, "findings", ())
    code = getattr(error, "code", None) or next((finding.code for finding in findings), None)
    if code is None:
        code = next((code for kind, code in CODES if isinstance(error, kind)), "bug")
    message = " ".join(str(error).split())
    if code == "bug":
        message = f"this is a bug of imucal, not an error in the data: {type(error).__name__}: {message}"
    if code == "memory":
        message = "not enough memory for this recording"
    return str(code), message


def _outcome(given: Job | KeyedJob, options: Options) -> Outcome:
    start_s = time.perf_counter()
    try:
        return _calibrated(given, options, start_s)
    except (KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:
        # BaseException is caught, because a panic of the compiled library is not an Exception.
        code, message = failure_of(error)
        job = given.job if isinstance(given, KeyedJob) else given
        if isinstance(error, InputError) and not all(
            Path(path).exists() for path in (*job.files, *job.control)
        ):
            code = FILE_MISSING
        return Outcome(_with_key(given, options), "failed", code, message, time.perf_counter() - start_s)


def _with_key(given: Job | KeyedJob, options: Options) -> KeyedJob:
    if isinstance(given, KeyedJob):
        return given
    try:
        return keyed(given, options.text)
    except ImucalError:
        return unread(given, options.text)


def _calibrated(given: Job | KeyedJob, options: Options, start_s: float) -> Outcome:
    job = given.job if isinstance(given, KeyedJob) else given
    unit_data, control = _read(job.files, options), _read(job.control, options)
    if isinstance(given, KeyedJob):
        keyed_job = given
        if changed := _changed(given, [*unit_data, *control]):
            return Outcome(given, "failed", "file_changed", changed, time.perf_counter() - start_s)
    else:
        keyed_job = _keyed_by_sources(job, options, [*unit_data, *control])
    result = calibrate(unit_data, control=control or None, serial_number=job.serial, **options.calibrate)
    if options.limits is not None:
        result = result.judged_by(options.limits)
    gap = None
    if options.gap:
        # Imported here, because processes of a run without --gap start faster without this import.
        from imucal.gap.find import find_gap

        same = ("gravity_mps2", "min_rest_s", "exclude_saturated", "model", "hold")
        arguments = {name: value for name, value in options.calibrate.items() if name in same}
        gap = find_gap(unit_data, control=control or None, calibration=result.calibration, **arguments)
    measured = measured_of(result, gap)
    return Outcome(keyed_job, result.verdict, None, None, time.perf_counter() - start_s, measured)


def _read(files: Sequence[str], options: Options) -> list[Recording]:
    """The recordings in these files. If each sensor has a separate file, files are read in pairs."""
    if not files:
        return []
    size = files_per_recording(options.read.get("format"), files)
    if len(files) % size:
        raise InputError(
            f"{len(files)} files given, but a recording consists of {size}: give them in pairs, "
            "accelerometer and gyroscope"
        )
    return [read(*files[start : start + size], **options.read) for start in range(0, len(files), size)]


def _keyed_by_sources(job: Job, options: Options, recordings: Sequence[Recording]) -> KeyedJob:
    """The job with the hashes of its files, which were computed during reading."""
    found = {source.path: source.sha256 for recording in recordings for source in recording.sources}
    files = (*job.files, *job.control)
    if not all(path in found for path in files):
        # If the job names a folder, `found` contains only the files in the folder, so the hash of the folder
        # is computed separately.
        return keyed(job, options.text)
    return keyed_by(job, options.text, tuple(found[path] for path in files))


def _changed(given: KeyedJob, recordings: Sequence[Recording]) -> str | None:
    """A message if a file has changed between hashing and reading; otherwise None."""
    hashes = dict(zip((*given.job.files, *given.job.control), given.hashes, strict=True))
    for recording in recordings:
        for source in recording.sources:
            if hashes.get(source.path, source.sha256) != source.sha256:
                return f"{source.path} was changed while it was being read: run again when it is complete"
    return None
