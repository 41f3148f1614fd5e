"""Calibration of the jobs of one task, in whatever process the task runs."""

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
from imucal.fleet.job import KeyedJob, Options
from imucal.fleet.outcome import Outcome, measured_of
from imucal.io import files_per_recording, read
from imucal.recording.recording import Recording

__all__ = ["TIME_LIMIT", "Task", "failure_of"]

# Code of an error without a finding.
CODES = (
    (NotEnoughMotionError, "not_enough_motion"),
    (FormatError, "format"),
    (FitError, "fit_failed"),
    (InputError, "input"),
    (ImucalError, "no_result"),
    (MemoryError, "memory"),
)


# Code of a recording that takes longer than the time limit.
TIME_LIMIT: Final = "time_limit"


@dataclass(frozen=True)
class Task:
    """Jobs that one process computes one after the other; their files travel as paths."""

    jobs: tuple[KeyedJob, ...]
    options: Options

    def __len__(self) -> int:
        return len(self.jobs)

    def run(self) -> list[Outcome]:
        """The outcome of each job; an error of a job is its outcome, and the next job follows.

        A job that takes longer than the time limit is the last one: its thread cannot be ended.
        """
        limit_s = self.options.time_limit_s
        if limit_s is None:
            return [_outcome(keyed, self.options) for keyed in self.jobs]
        found: queue.SimpleQueue[Outcome] = queue.SimpleQueue()

        def compute() -> None:
            for keyed in self.jobs:
                found.put(_outcome(keyed, self.options))

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
                return [*outcomes, Outcome(late, "failed", TIME_LIMIT, message, limit_s)]
        return outcomes

    def is_stuck(self, answer: list[Outcome]) -> bool:
        """Whether the last job of the answer is still being computed."""
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


def _outcome(keyed: KeyedJob, options: Options) -> Outcome:
    start_s = time.perf_counter()
    try:
        return _calibrated(keyed, options, start_s)
    except (KeyboardInterrupt, SystemExit):
        raise
    except BaseException as error:
        # A panic of the compiled library is a BaseException.
        code, message = failure_of(error)
        return Outcome(keyed, "failed", code, message, time.perf_counter() - start_s)


def _calibrated(keyed: KeyedJob, options: Options, start_s: float) -> Outcome:
    job = keyed.job
    try:
        unit_data, control = _read(job.files, options), _read(job.control, options)
    except InputError as error:
        gone = [path for path in (*job.files, *job.control) if not Path(path).exists()]
        if gone:
            return Outcome(keyed, "failed", "file_missing", str(error), time.perf_counter() - start_s)
        raise
    if changed := _changed(keyed, [*unit_data, *control]):
        return Outcome(keyed, "failed", "file_changed", changed, time.perf_counter() - start_s)
    result = calibrate(unit_data, control=control or None, serial_number=job.serial, **options.calibrate)
    if options.limits is not None:
        result = result.judged_by(options.limits)
    gap = None
    if options.gap:
        # Imported here, because a process of a fleet without --gap starts faster without it.
        from imucal.gap.find import find_gap

        same = ("gravity_mps2", "min_rest_s", "exclude_saturated", "model", "hold")
        given = {name: value for name, value in options.calibrate.items() if name in same}
        gap = find_gap(unit_data, control=control or None, calibration=result.calibration, **given)
    measured = measured_of(result, gap)
    return Outcome(keyed, result.verdict, None, None, time.perf_counter() - start_s, measured)


def _read(files: Sequence[str], options: Options) -> list[Recording]:
    """The recordings in these files; those with one file per sensor are taken in pairs."""
    if not files:
        return []
    size = files_per_recording(options.read.get("format"), files)
    if len(files) % size:
        raise InputError(
            f"{len(files)} files given, but a recording consists of {size}: give them in pairs, "
            "accelerometer "
            "and gyroscope"
        )
    return [read(*files[start : start + size], **options.read) for start in range(0, len(files), size)]


def _changed(keyed: KeyedJob, recordings: Sequence[Recording]) -> str | None:
    """The message if a file is another one than that which was hashed."""
    hashes = dict(zip((*keyed.job.files, *keyed.job.control), keyed.hashes, strict=True))
    for recording in recordings:
        for source in recording.sources:
            if hashes.get(source.path, source.sha256) != source.sha256:
                return f"{source.path} was changed while it was being read: run again when it is complete"
    return None
