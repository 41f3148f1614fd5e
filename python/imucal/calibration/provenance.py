"""Origin of a calibration: which unit, which files, which version, when and by whom."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from imucal.document.name import require_name
from imucal.document.source import Source

__all__ = ["Imported", "Provenance", "require_serial_number"]


@dataclass(frozen=True)
class Imported:
    """Origin of a calibration that was read from files of another program.

    format    name of the format in `imucal import --from`
    program   the program that wrote the files
    formula   correction that the other program computes
    files     the files
    missing   parts that the files do not state: "covariance", "temperature", "noise", "gravity", or a sensor
              or parameter such as "gyroscope", "accel_bias" or "gyro_scale". The calibration has the values
              of a perfect sensor for a missing parameter
    notes     further remarks about the file
    """

    format: str
    program: str
    formula: str
    files: tuple[Source, ...] = ()
    missing: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def lacks(self, parameter: str) -> bool:
        """Whether the files do not state this parameter, such as accel_bias_x or gyro_sensitivity_xy."""
        sensor, _, rest = parameter.partition("_")
        if not rest.startswith(("bias_", "sensitivity_")):
            return False
        on_diagonal = rest[-1] == rest[-2]
        kind = "bias" if rest.startswith("bias_") else "scale" if on_diagonal else "misalignment"
        triad = {"accel": "accelerometer", "gyro": "gyroscope"}.get(sensor, "")
        return triad in self.missing or f"{sensor}_{kind}" in self.missing


@dataclass(frozen=True)
class Provenance:
    """Origin of a calibration.

    files           files of the calibration recordings. If a calibration of the accelerometer was a prior,
                    the files of its recordings are included
    control_files   files of the control recordings
    imucal_version  version of the package that made the calibration
    date            ISO 8601, UTC
    operator        name of the person who made the calibration
    imported        origin of a calibration of another program, or None
    composed_of     files of the two calibrations from which this one was composed; empty if it was not
                    composed
    """

    files: tuple[Source, ...] = ()
    control_files: tuple[Source, ...] = ()
    imucal_version: str = ""
    date: str = ""
    operator: str = ""
    imported: Imported | None = None
    composed_of: tuple[Source, ...] = ()

    def seen_in(self, sources: Iterable[Source]) -> list[Source]:
        """The files among `sources` that have the same bytes as a file of the calibration recordings."""
        hashes = {source.sha256 for source in self.files}
        return [source for source in sources if source.sha256 in hashes]


def require_serial_number(serial_number: str | None) -> None:
    """Raise InputError for a serial number that cannot be a name in files, file names and tables."""
    if serial_number is not None:
        require_name(serial_number, "the serial number")
