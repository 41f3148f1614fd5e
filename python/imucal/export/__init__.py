"""Calibrations for other programs: firmware, autopilots, estimators, simulators.

    exported = imucal.export(calibration, "px4")
    exported.save("unit-0042.params")
    exported.lost                      # what the format cannot carry
    exported.residual(control)         # and what that costs on a control recording

Every file starts with the formula by which it is applied, units and direction, and what is not in it.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from imucal.atomic import write_text
from imucal.calibration import Calibration
from imucal.errors import InputError
from imucal.evaluate import MIN_REST_S, Evaluation, evaluate, figures_text
from imucal.export.ardupilot import ARDUPILOT
from imucal.export.basalt import BASALT
from imucal.export.c_header import C_HEADER
from imucal.export.format import Format, header, require_si
from imucal.export.fusion import FUSION
from imucal.export.gazebo import GAZEBO
from imucal.export.kalibr import KALIBR, KALIBR_IMU
from imucal.export.matlab import MATLAB
from imucal.export.px4 import PX4
from imucal.export.realsense import REALSENSE
from imucal.export.ros import ROS
from imucal.export.rust import RUST
from imucal.plain import without_nan
from imucal.recording import Recording

if TYPE_CHECKING:
    from imucal.noise import NoiseResult

__all__ = ["FORMATS", "Export", "Format", "Residual", "export", "find_format", "formats_markdown"]

FORMATS: Final[dict[str, Format]] = {
    form.name: form
    for form in (
        C_HEADER,
        RUST,
        MATLAB,
        KALIBR,
        KALIBR_IMU,
        BASALT,
        ROS,
        PX4,
        ARDUPILOT,
        FUSION,
        REALSENSE,
        GAZEBO,
    )
}

# Figures of an evaluation that show what a format costs.
COST: Final = ("gravity_direction_rms_deg", "gravity_norm_rms_mps2")


@dataclass(frozen=True, eq=False)
class Residual:
    """A control recording under the whole calibration and under what the format carries of it."""

    full: Evaluation
    exported: Evaluation

    def to_dict(self) -> dict[str, Any]:
        """Gravity's direction per move, deg rms, and the error of its length, m/s^2 rms, of both."""
        return {
            name: {figure: without_nan(judged.figures[figure]) for figure in COST}
            for name, judged in (("full", self.full), ("exported", self.exported))
        }

    def summary(self) -> str:
        """The same in words, two lines."""
        return "\n".join(
            f"control set, {name}: " + figures_text({figure: judged.figures[figure] for figure in COST})
            for name, judged in (("whole calibration", self.full), ("as exported", self.exported))
        )


@dataclass(frozen=True, eq=False)
class Export:
    """A calibration in a format of another program.

    form      the format
    text      the file
    lost      what of the calibration is not in it, in words
    same_as   what the other program does with it, as a calibration; None if it corrects nothing
    """

    form: Format
    text: str
    lost: tuple[str, ...]
    same_as: Calibration | None
    calibration: Calibration

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the file, whole or not at all; InputError if it cannot be written."""
        write_text(path, self.text)

    def residual(
        self, control: Recording | Sequence[Recording], *, min_rest_s: float = MIN_REST_S
    ) -> Residual | None:
        """What the loss costs on recordings of the same unit; None if the format corrects nothing.

        Raises what `imucal.evaluate` raises.
        """
        if self.same_as is None:
            return None
        return Residual(
            evaluate(self.calibration, control, min_rest_s=min_rest_s),
            evaluate(self.same_as, control, min_rest_s=min_rest_s),
        )


def export(
    calibration: Calibration, format: str, *, noise: NoiseResult | None = None, name: str | None = None
) -> Export:
    """The calibration in `format`, a name of `FORMATS`.

    noise   figures of a recording at rest that the calibration has corrected, for kalibr-imu and gazebo
    name    how all names of a c-header start, "imucal" if not given, and those of fusion: two units in one
            program need two names

    Raises InputError for a format that is not known, for raw counts where the other program takes none, for
    left-handed axes, or a sensor turned against the other, where it has no place for them, for noise figures
    that are missing, and for a name that C cannot have or the format has no place for.
    """
    form = find_format(format)
    if name is not None:
        if form.named is None:
            raise InputError(f"the files of {form.name} have no names to choose: leave --name out")
        form = form.named(name)
    require_si(calibration, form)
    if form.needs_noise and noise is None:
        raise InputError(
            f"{form.name} is about noise, which a calibration does not know well: give the figures of a "
            "recording at rest (--noise REC)"
        )
    written = form.write(calibration, noise)
    return Export(
        form,
        form.layout(header(calibration, form, written), written.body),
        written.lost,
        written.same_as,
        calibration,
    )


def find_format(name: str) -> Format:
    """The format of this name; InputError, with all names, if there is none."""
    if name not in FORMATS:
        raise InputError(f"there is no format {name!r}: give one of {', '.join(FORMATS)}")
    return FORMATS[name]


def formats_markdown() -> str:
    """The table of all formats for docs/export.md."""
    rows = [
        f"| `{form.name}` | {form.title} (`{form.suffix}`) | {form.carries} | {form.loses} | "
        f"{'yes' if form.takes_counts else 'no'} | {form.source} |"
        for form in FORMATS.values()
    ]
    heads = ("`--to`", "what", "carries", "does not carry", "raw counts", "formula stands in")
    return "\n".join([f"| {' | '.join(heads)} |", "|---" * len(heads) + "|", *rows])
