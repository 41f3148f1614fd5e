"""A job: the recordings of one measurement of a unit, the options of its calibration, and its key.

    recording = hash(serial number, contents of the files)
    key       = hash(recording, options, version of imucal)

Jobs with equal keys have equal results, so a job whose key is in the store is not computed again.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime, timezone
from inspect import signature
from pathlib import Path
from typing import Any, Final

import imucal._core as _core
from imucal.document.name import require_name
from imucal.document.plain import plain
from imucal.document.source import is_folder, open_large
from imucal.errors import InputError
from imucal.estimation.calibrate import calibrate
from imucal.limits.limits import Limits
from imucal.rig.unit import Unit, unit_of

__all__ = [
    "UNREAD",
    "Job",
    "KeyedJob",
    "Options",
    "as_date",
    "hash_of",
    "keyed",
    "keyed_by",
    "path_text",
    "unread",
]

# Prefix of the key (identifier in the store) of a job whose files cannot be read. Such a key contains the
# paths instead of a hash.
UNREAD: Final = "unread:"
# Arguments of `calibrate` that cannot be options of a run, because each job sets its own control recordings
# and serial number, and all calibrations of a store have the default frame.
OF_A_JOB: Final = ("control", "serial_number", "frame")


@dataclass(frozen=True)
class Job:
    """One measurement of a unit.

    serial     serial number of the unit
    files      files of its calibration recordings
    control    files of its control recordings, which are used only for validation
    date       ISO 8601, or None if it is not known
    station, operator, batch, role   names from the manifest, or None
    """

    serial: str
    files: tuple[str, ...]
    control: tuple[str, ...] = ()
    date: str | None = None
    station: str | None = None
    operator: str | None = None
    batch: str | None = None
    role: str | None = None

    def __post_init__(self) -> None:
        require_name(self.serial, "the serial number")
        if not self.files:
            raise InputError(f"unit {self.serial}: no recording is given: give at least one file")
        for name in ("station", "operator", "batch", "role"):
            if getattr(self, name) is not None:
                require_name(getattr(self, name), f"unit {self.serial}: {name}")
        if self.date is not None:
            object.__setattr__(self, "date", as_date(self.date, f"unit {self.serial}: date"))


@dataclass(frozen=True)
class Options:
    """Options of a run, the same for all its jobs.

    read       arguments of `imucal.read`
    calibrate  arguments of `imucal.calibrate`, without those that each job sets
    limits     limits that decide the verdict, or None
    gap        whether to search each unit for an effect that its calibration does not include
    time_limit_s   time limit of one job, s, or None. It is not part of the key of a job, because it does not
                   change a result
    """

    read: Mapping[str, Any] = field(default_factory=dict)
    calibrate: Mapping[str, Any] = field(default_factory=dict)
    limits: Limits | None = None
    gap: bool = False
    time_limit_s: float | None = None

    def __post_init__(self) -> None:
        if self.time_limit_s is not None and not 0 < self.time_limit_s < float("inf"):
            raise InputError(f"time_limit_s is {self.time_limit_s:g}: give a positive number of seconds")
        wrong = [name for name in OF_A_JOB if name in self.calibrate]
        if wrong:
            raise InputError(f"{wrong[0]} is no option of a run of many units: leave it out")
        # Arguments that equal their defaults are removed, so that the key of a job does not depend on whether
        # a default is given explicitly.
        defaults = {name: of.default for name, of in signature(calibrate).parameters.items()}
        given = {
            name: value
            for name, value in self.calibrate.items()
            if value is not None
            and not (isinstance(value, (bool, float, str)) and value == defaults.get(name))
        }
        if "unit" in given:
            # The content of the unit's profile is stored instead of its path, because the file may be missing
            # on another machine.
            given["unit"] = unit_of(given["unit"])
        object.__setattr__(self, "calibrate", given)
        object.__setattr__(self, "read", {k: v for k, v in self.read.items() if v not in (None, False)})
        self.text  # noqa: B018 (raises for options that are no plain values)

    @property
    def text(self) -> str:
        """The options as canonical JSON. Raises InputError if an option is not a plain value."""
        document = {
            "read": plain(dict(self.read)),
            "calibrate": {
                name: plain(value.to_dict() if isinstance(value, Unit) else value)
                for name, value in self.calibrate.items()
            },
            "limits": None if self.limits is None else plain(self.limits.to_dict()),
            "gap": self.gap,
        }
        try:
            return json.dumps(document, sort_keys=True, separators=(",", ":"), allow_nan=False)
        except (TypeError, ValueError) as error:
            raise InputError(
                "the options of a run must be plain values (text, numbers, lists), so that a store can "
                f"compare them: {error}; for other options call imucal.calibrate for each unit"
            ) from None


@dataclass(frozen=True)
class KeyedJob:
    """A job with its hashes.

    recording  hash of the serial number and the contents of the files
    key        hash of `recording`, the options and the version of imucal
    hashes     SHA-256 of each file; the control recordings come last
    """

    job: Job
    recording: str
    key: str
    hashes: tuple[str, ...]

    def with_job(self, job: Job) -> KeyedJob:
        """A copy of this object with its `job` replaced; the hashes and the key are not changed."""
        return replace(self, job=job)


def keyed(job: Job, options: str) -> KeyedJob:
    """The job with its hashes and its key. Raises InputError or FormatError if a file cannot be read.

    options   canonical text of the options
    """
    return keyed_by(job, options, tuple(hash_of(path) for path in (*job.files, *job.control)))


def keyed_by(job: Job, options: str, hashes: tuple[str, ...]) -> KeyedJob:
    """The job with its key, computed from the known hashes of its files."""
    recording = _hash([job.serial, hashes[: len(job.files)], hashes[len(job.files) :]])
    return KeyedJob(job, recording, _hash([recording, options, str(_core.__version__)]), hashes)


def unread(job: Job, options: str) -> KeyedJob:
    """The keyed form of a job whose files cannot be read.

    It has no hashes, and its key consists of the serial number, the paths and the options.
    """
    place = UNREAD + "\0".join((job.serial, *job.files, "", *job.control, options))
    return KeyedJob(job, place, place, ())


def hash_of(path: str) -> str:
    """SHA-256 of a file, or of the names and contents of the files in a folder."""
    if not is_folder(path):
        return open_large(path).sha256
    inside = sorted(each for each in Path(path).rglob("*") if each.is_file())
    return _hash([[str(each.relative_to(path)), open_large(each).sha256] for each in inside])


def as_date(text: str, what: str) -> str:
    """Convert a date, or date and time, to ISO 8601, so that alphabetical order is the order in time.

    Raises InputError for any other text.

    A time with a zone is converted to UTC; a time without one is taken as UTC.
    """
    given = text.strip()
    try:
        moment = datetime.fromisoformat(given[:-1] + "+00:00" if given.endswith(("Z", "z")) else given)
    except ValueError:
        raise InputError(
            f"{what} is {text!r}: give a date such as 2026-11-26 or 2026-11-26T14:30:00"
        ) from None
    if len(given) == len("2026-11-26"):
        return moment.date().isoformat()
    if moment.tzinfo is not None:
        moment = moment.astimezone(timezone.utc).replace(tzinfo=None)
    return moment.isoformat(timespec="seconds")


def path_text(path: str | os.PathLike[str]) -> str:
    """The path to store. It is absolute, so that a run from another folder finds the file."""
    return os.path.abspath(path)  # noqa: PTH100 (Path.absolute keeps `..`)


def _hash(value: object) -> str:
    text = json.dumps(value, separators=(",", ":"), ensure_ascii=True)
    return hashlib.sha256(text.encode()).hexdigest()
