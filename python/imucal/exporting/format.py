"""Export formats of other programs, and the header that describes the contents of each file."""

from __future__ import annotations

import json
import re
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

from imucal.document.json_document import to_json
from imucal.document.name import shown
from imucal.errors import InputError

if TYPE_CHECKING:
    from imucal.arrays import FloatArray
    from imucal.calibration.calibration import Calibration
    from imucal.noise_analysis.noise import NoiseResult

__all__ = [
    "SI",
    "Format",
    "Layout",
    "Written",
    "block_comment",
    "header",
    "in_json",
    "line_comments",
    "number",
    "require_sensors_of",
    "require_si",
    "xml_comment",
]

WIDTH: Final = 100
SI: Final = "m/s^2 and rad/s"

# Function that combines the lines of a header and the body into the text of a file.
Layout: TypeAlias = Callable[[Sequence[str], str], str]


@dataclass(frozen=True)
class Written:
    """The body of a file, and the part of the calibration that it represents.

    lost       for each part of the calibration that the file does not contain, a description with its size
    same_as    calibration whose correction equals the one that the other program computes from the file; None
               for a format that describes noise only
    frame      body frame of the corrected samples
    notes      further information for the user of the file
    binary     contents of a binary file, for which `body` is empty; None for a text file
    raw_units  units of the raw samples, if they are not those of the calibration
    """

    body: str
    lost: tuple[str, ...]
    same_as: Calibration | None
    frame: str
    notes: tuple[str, ...] = ()
    binary: bytes | None = None
    raw_units: str | None = None


@dataclass(frozen=True)
class Format:
    """An export format.

    name         value of `imucal export --to`
    title        short description of the file
    suffix       file name extension
    formula      correction that the other program computes
    source       source file or documentation of the other program that states the formula
    units        units of the corrected samples
    includes, omits  parts of a calibration that a file contains, and parts that it does not contain, for the
                     table of formats
    layout       function that combines the header and the body of a file
    write        function that makes the body of a file from a calibration and noise figures
    takes_counts     whether calibrations of raw counts can be written
    needs_noise      whether noise figures of a recording at rest are required
    needs_gyroscope  whether both sensors are required, so that an accelerometer alone cannot be exported
    named            function that returns the format with a prefix for its C names; None if its files contain
                     no C names
    oriented         function that returns the format for recordings rotated by a board rotation (3, 3); None
                     if the format has no such option
    scaled           function that returns the format for a resolution, counts per g and per deg/s; None if
                     the format has no such option
    along            function that returns the format for corrected samples along other axes; None if the
                     format has no such option
    is_binary        whether the file is binary. Such a file contains no header; the header is only part of
                     the output of the export
    """

    name: str
    title: str
    suffix: str
    formula: str
    source: str
    units: str
    includes: str
    omits: str
    layout: Layout
    write: Callable[[Calibration, NoiseResult | None], Written]
    takes_counts: bool = False
    needs_noise: bool = False
    needs_gyroscope: bool = True
    named: Callable[[str], Format] | None = None
    oriented: Callable[[FloatArray], Format] | None = None
    scaled: Callable[[float, float], Format] | None = None
    along: Callable[[str], Format] | None = None
    is_binary: bool = False


def header(calibration: Calibration, form: Format, written: Written) -> list[str]:
    """The header lines of a file: title, provenance, formula, units, body frame, notes, omitted parts."""
    made = calibration.provenance
    unit = f"unit {calibration.serial_number}" if calibration.serial_number else "a unit"
    files = ", ".join(source.path for source in made.files)
    imported, composed = made.imported, ", then ".join(source.path for source in made.composed_of)
    if imported is not None:
        files = f"{', '.join(source.path for source in imported.files)} of {imported.program}"
    elif composed:
        files = f"{composed}, applied one after the other"
    lines = [
        f"{form.title}, written by imucal",
        f"Calibration of {unit}"
        + (f", made {made.date}" if made.date else "")
        + (f" by imucal {made.imucal_version}" if made.imucal_version else "")
        + (f" from {files}" if files else ""),
        f"Apply: {form.formula}",
        _units(calibration, form, written.raw_units),
        f"Body frame: {written.frame}",
        *written.notes,
        *(f"Not exported: {loss}" for loss in written.lost),
        *([] if written.lost else ["Not exported: nothing, this file contains the whole correction"]),
    ]
    # Lines are escaped, because the name of a file in the header may contain a line separator, which would
    # end a comment in YAML or Rust.
    return [shown(line) for line in lines]


def _units(calibration: Calibration, form: Format, raw: str | None) -> str:
    if calibration.gyroscope is None:
        corrected = form.units.replace(" and rad/s", "").replace(" and deg/s", "")
        return (
            f"Units: raw samples in {calibration.accel_unit} (accelerometer alone), corrected in {corrected}"
        )
    raw = raw or f"{calibration.accel_unit} and {calibration.gyro_unit}"
    return f"Units: raw samples in {raw}, corrected samples in {form.units}"


def line_comments(mark: str) -> Layout:
    """A layout whose header is a block of line comments that start with `mark`."""

    def layout(lines: Sequence[str], body: str) -> str:
        return "\n".join([*(f"{mark} {line}" for line in _wrapped(lines)), body])

    return layout


def block_comment(lines: Sequence[str], body: str) -> str:
    """The header as one C comment, followed by the body."""
    # A file name in the header must not end the comment.
    kept = [line.replace("*/", "* /") for line in _wrapped(lines)]
    return "\n".join(["/*", *(f" * {line}" for line in kept), " */", body])


def xml_comment(lines: Sequence[str], body: str) -> str:
    """The header as one XML comment, followed by the body."""
    # XML comments must not contain two consecutive hyphens, which file names may have.
    kept = [re.sub("-(?=-)", "- ", line) for line in _wrapped(lines)]
    return "\n".join(["<!--", *(f"  {line}" for line in kept), "-->", body])


def in_json(lines: Sequence[str], body: str) -> str:
    """The header as the last field, `imucal`, of the JSON object in `body`, because JSON has no comments."""
    return to_json({**json.loads(body), "imucal": list(lines)}) + "\n"


def number(value: float, *, single: bool = False) -> str:
    """The shortest decimal that is parsed to the same float64, or with `single` to the same float32."""
    if not single:
        return repr(float(value))
    return str(np.float32(value))


def require_sensors_of(calibration: Calibration, form: Format, able: Sequence[str]) -> None:
    """Raises InputError for an accelerometer alone if the format needs both sensors.

    able   names of the formats that can be written for an accelerometer alone
    """
    if calibration.gyroscope is None and form.needs_gyroscope:
        raise InputError(
            f"{form.name} needs both sensors, and this calibration has no gyroscope [sensor_missing]: "
            f"calibrate both, or export the accelerometer to {', '.join(able)}"
        )


def require_si(calibration: Calibration, form: Format) -> None:
    """Raises InputError for a calibration of raw counts if the other program only corrects SI units."""
    counts = [
        sensor
        for sensor, unit in (("accelerometer", calibration.accel_unit), ("gyroscope", calibration.gyro_unit))
        if unit == "lsb"
    ]
    if counts and not form.takes_counts:
        raise InputError(
            f"the {' and the '.join(counts)} of this calibration {'is' if len(counts) == 1 else 'are'} in "
            f"raw counts, but {form.name} only corrects samples in SI units: calibrate a recording in SI "
            "units (accel_x_mps2, ...), or export to c-header, rust, fusion or matlab"
        )


def _wrapped(lines: Sequence[str]) -> list[str]:
    return [
        part
        for line in lines
        for part in textwrap.wrap(line, WIDTH, subsequent_indent="  ", break_long_words=False) or [""]
    ]
