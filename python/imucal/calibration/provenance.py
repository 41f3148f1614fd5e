"""Origin of a calibration: which unit, which files, which version, when and by whom."""

from __future__ import annotations

from dataclasses import dataclass

from imucal.document.name import require_name
from imucal.document.source import Source

__all__ = ["Provenance", "require_serial_number"]


@dataclass(frozen=True)
class Provenance:
    """Origin of a calibration.

    files           files of the calibration recordings
    control_files   files of the control recordings
    imucal_version  version of the package that made the calibration
    date            ISO 8601, UTC
    operator        who made it
    """

    files: tuple[Source, ...] = ()
    control_files: tuple[Source, ...] = ()
    imucal_version: str = ""
    date: str = ""
    operator: str = ""


def require_serial_number(serial_number: str | None) -> None:
    """Raise InputError for a serial number that is no name, as it appears in file names and tables."""
    if serial_number is not None:
        require_name(serial_number, "the serial number")
