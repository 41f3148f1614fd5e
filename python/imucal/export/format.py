"""What a format of another program is, and how a file of it says what stands in it."""

from __future__ import annotations

import json
import re
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, TypeAlias

import numpy as np

from imucal.document import to_json
from imucal.errors import InputError

if TYPE_CHECKING:
    from imucal.calibration import Calibration
    from imucal.noise import NoiseResult

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
    "require_si",
    "xml_comment",
]

WIDTH: Final = 100
SI: Final = "m/s^2 and rad/s"

# Puts the lines of a header and the body of a file together.
Layout: TypeAlias = Callable[[Sequence[str], str], str]


@dataclass(frozen=True)
class Written:
    """The body of a file, and what has become of the calibration.

    lost       what is not in the file, in words, with its size; empty if nothing is lost
    same_as    what the other program does with the file, as a calibration; None if it corrects nothing
    frame      the body frame of what it corrects
    notes      what its user has to know besides
    """

    body: str
    lost: tuple[str, ...]
    same_as: Calibration | None
    frame: str
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Format:
    """One format.

    name         as `imucal export --to` takes it
    title        what it is for
    suffix       of a file's name
    formula      what the other program computes
    source       where its own code or documentation says so
    units        of the corrected samples
    carries, loses   of a calibration, for the table of formats
    layout       where the header stands
    write        makes the body
    takes_counts     a calibration of raw counts can be written
    needs_noise      figures of a recording at rest are needed
    named            the format with names that start with a prefix; None if its files have no names to choose
    """

    name: str
    title: str
    suffix: str
    formula: str
    source: str
    units: str
    carries: str
    loses: str
    layout: Layout
    write: Callable[[Calibration, NoiseResult | None], Written]
    takes_counts: bool = False
    needs_noise: bool = False
    named: Callable[[str], Format] | None = None


def header(calibration: Calibration, form: Format, written: Written) -> list[str]:
    """The lines that every file starts with."""
    made = calibration.provenance
    unit = f"unit {calibration.serial_number}" if calibration.serial_number else "a unit"
    files = ", ".join(source.path for source in made.files)
    return [
        f"{form.title}, written by imucal",
        f"Calibration of {unit}"
        + (f", made {made.date}" if made.date else "")
        + (f" by imucal {made.imucal_version}" if made.imucal_version else "")
        + (f" from {files}" if files else ""),
        f"Apply: {form.formula}",
        f"Units: raw samples in {calibration.accel_unit} and {calibration.gyro_unit}, "
        f"corrected ones in {form.units}",
        f"Body frame: {written.frame}",
        *written.notes,
        *(f"Not carried: {loss}" for loss in written.lost),
        *([] if written.lost else ["Not carried: nothing, this is the whole correction"]),
    ]


def line_comments(mark: str) -> Layout:
    """A header of comments of one line each."""

    def layout(lines: Sequence[str], body: str) -> str:
        return "\n".join([*(f"{mark} {line}" for line in _wrapped(lines)), body])

    return layout


def block_comment(lines: Sequence[str], body: str) -> str:
    """A header in one comment of C."""
    # A file's name must not end the comment.
    kept = [line.replace("*/", "* /") for line in _wrapped(lines)]
    return "\n".join(["/*", *(f" * {line}" for line in kept), " */", body])


def xml_comment(lines: Sequence[str], body: str) -> str:
    """A header in one comment of XML."""
    # Two hyphens in a row, of a file's name say, must not stand in one.
    kept = [re.sub("-(?=-)", "- ", line) for line in _wrapped(lines)]
    return "\n".join(["<!--", *(f"  {line}" for line in kept), "-->", body])


def in_json(lines: Sequence[str], body: str) -> str:
    """JSON has no comments: the header is a field of its own, the last one."""
    return to_json({**json.loads(body), "imucal": list(lines)}) + "\n"


def number(value: float, single: bool = False) -> str:
    """The shortest digits that give the same number back; of float32 if the other program keeps such ones."""
    if not single:
        return repr(float(value))
    return str(np.float32(value))


def require_si(calibration: Calibration, form: Format) -> None:
    """Refuse a calibration of raw counts where the other program corrects SI units, with InputError."""
    counts = [
        sensor
        for sensor, unit in (("accelerometer", calibration.accel_unit), ("gyroscope", calibration.gyro_unit))
        if unit == "lsb"
    ]
    if counts and not form.takes_counts:
        raise InputError(
            f"the {' and the '.join(counts)} of this calibration {'is' if len(counts) == 1 else 'are'} in "
            f"raw counts, and {form.name} corrects samples that are in SI units already: calibrate a "
            "recording in SI units (accel_x_mps2, ...), or export to c-header, rust, fusion or matlab"
        )


def _wrapped(lines: Sequence[str]) -> list[str]:
    return [
        part
        for line in lines
        for part in textwrap.wrap(line, WIDTH, subsequent_indent="  ", break_long_words=False) or [""]
    ]
