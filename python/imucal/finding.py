"""Findings: the faults that the checks of a recording report."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any, Literal

__all__ = ["Finding", "Place"]


@dataclass(frozen=True)
class Place:
    """A range of samples, both ends included."""

    first_sample: int
    last_sample: int
    start_s: float
    end_s: float


@dataclass(frozen=True)
class Finding:
    """A fault of a recording.

    `code` is a stable identifier for scripts. The `severity` "error" means that a calibration from this
    recording would be wrong and is refused. `columns` is empty if the fault concerns the whole recording.
    `place` is the range of the affected samples, and `count` the number of affected samples or other items,
    such as axes or files. `value`, in `unit`, is the measured value that revealed the fault.
    """

    code: str
    severity: Literal["warning", "error"]
    recording: str
    columns: tuple[str, ...]
    place: Place | None
    count: int
    value: float
    unit: str
    message: str
    way_out: str

    def __str__(self) -> str:
        return f"{self.recording}: {self.message} [{self.code}]: {self.way_out}"

    @property
    def line(self) -> str:
        """The finding as a line of a summary or report, with its severity."""
        return f"{self.severity}: {self}"

    def to_dict(self) -> dict[str, Any]:
        """The fields as a dictionary that JSON can hold; numbers that are not finite become None."""
        place = None if self.place is None else _finite(asdict(self.place))
        return {**_finite(asdict(self)), "columns": list(self.columns), "place": place}


def _finite(fields: dict[str, Any]) -> dict[str, Any]:
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in fields.items()
    }
