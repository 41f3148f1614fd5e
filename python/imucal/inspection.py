"""What a recording is, what is wrong with it, and what it can determine."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from imucal.document import without_nan
from imucal.evaluate import MIN_REST_S
from imucal.finding import Finding
from imucal.recording import Recording

__all__ = ["Inspection", "inspect"]


@dataclass(frozen=True, eq=False)
class Inspection:
    """One recording, inspected.

    findings      everything the checks found; those of severity "error" stop a calibration
    rests         one mapping for each rest, in order of time
    threshold     how the rests were found: the threshold chosen and why; None without samples
    undetermined  what the motion does not determine, and what to add; empty if all is determined
    """

    name: str
    samples: int
    duration_s: float
    rate_hz: float
    accel_unit: str
    gyro_unit: str
    findings: tuple[Finding, ...]
    rests: tuple[Mapping[str, Any], ...]
    threshold: Mapping[str, Any] | None
    undetermined: tuple[str, ...]

    @property
    def usable(self) -> bool:
        """Whether a calibration would take this recording."""
        return all(finding.severity != "error" for finding in self.findings)

    def to_dict(self) -> dict[str, Any]:
        """One item of the document of `imucal inspect --json`."""
        document: dict[str, Any] = without_nan(self)
        return {**document, "usable": self.usable}


def inspect(recording: Recording, *, min_rest_s: float = MIN_REST_S) -> Inspection:
    """Check a recording, find its rests, and say what they determine; faults are findings, not errors."""
    from imucal import _core

    seen = _core.inspect(recording, min_rest_s=min_rest_s)
    return Inspection(
        name=recording.name,
        samples=len(recording),
        duration_s=recording.duration_s,
        rate_hz=recording.rate_hz,
        accel_unit=recording.accel_unit,
        gyro_unit=recording.gyro_unit,
        findings=tuple(seen["findings"]),
        rests=tuple(seen["rests"]),
        threshold=seen["threshold"],
        undetermined=tuple(seen["undetermined"]),
    )
