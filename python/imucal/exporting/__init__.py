"""Export of calibrations to other programs: firmware, autopilots, estimators and simulators.

    exported = imucal.export(calibration, "px4")
    exported.save("unit-0042.params")
    exported.lost                      # parts of the calibration that the format cannot represent
    exported.residual(control)         # evaluation on a control recording, with and without these parts

The header of every file states the correction formula with its direction, the units, and the parts of the
calibration that the file does not contain.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import imucal._core as _core
from imucal.calibration.calibration import Calibration
from imucal.calibration.figures import figures_text
from imucal.document.atomic import write_atomically, write_text
from imucal.errors import InputError
from imucal.estimation.evaluate import Evaluation, evaluate
from imucal.exporting.ardupilot import ARDUPILOT
from imucal.exporting.basalt import BASALT
from imucal.exporting.blob import BLOB, C_LOADER
from imucal.exporting.board_rotation import board_rotation
from imucal.exporting.c_header import C_HEADER
from imucal.exporting.format import Format, header, require_sensors_of, require_si
from imucal.exporting.fusion import FUSION
from imucal.exporting.gazebo import GAZEBO
from imucal.exporting.inav import ACCEL_LSB_PER_G, GYRO_LSB_PER_DPS, INAV
from imucal.exporting.kalibr import KALIBR, KALIBR_IMU
from imucal.exporting.matlab import MATLAB
from imucal.exporting.model import along_columns, axes_note
from imucal.exporting.openvins import OPENVINS
from imucal.exporting.px4 import PX4
from imucal.exporting.realsense import REALSENSE, REALSENSE_TABLE
from imucal.exporting.ros import ROS
from imucal.exporting.rust import RUST
from imucal.recording.axes import UNCHANGED, Axes
from imucal.recording.recording import Recording, as_recordings

if TYPE_CHECKING:
    from imucal.noise_analysis.noise import NoiseResult

__all__ = ["FORMATS", "Export", "Format", "Residual", "export", "find_format", "formats_markdown"]

FORMATS: Final[dict[str, Format]] = {
    form.name: form
    for form in (
        C_HEADER,
        BLOB,
        C_LOADER,
        RUST,
        MATLAB,
        KALIBR,
        KALIBR_IMU,
        OPENVINS,
        BASALT,
        ROS,
        PX4,
        ARDUPILOT,
        INAV,
        FUSION,
        REALSENSE,
        REALSENSE_TABLE,
        GAZEBO,
    )
}

# Figures of merit that are compared between the exported model and the whole calibration.
COST: Final = ("gravity_direction_rms_deg", "gravity_norm_rms_mps2")


@dataclass(frozen=True, eq=False)
class Residual:
    """Evaluation of control recordings with the whole calibration, and with the exported part of it.

    full        evaluation of the whole calibration
    exported    evaluation of `Export.same_as`, the model that the other program applies
    """

    full: Evaluation
    exported: Evaluation

    def to_dict(self) -> dict[str, Any]:
        """The figures of both evaluations, with the findings and the verdict on the whole calibration.

        The figures are the rms errors of the gravity direction per move, deg, and of |f|, m/s^2.
        """
        figures = {
            name: {figure: getattr(judged.figures, figure) for figure in COST}
            for name, judged in (("full", self.full), ("exported", self.exported))
        }
        return {
            **figures,
            "verdict": self.full.verdict,
            "reasons": list(self.full.reasons),
            "findings": [finding.to_dict() for finding in self.full.findings],
        }

    def summary(self) -> str:
        """The contents of `to_dict` as text: a line for each evaluation and finding, and the verdict.

        The verdict is that on the whole calibration. The parts that the format omits increase only the
        residuals in the evaluation of the exported part.
        """
        figures = [
            f"control set, {name}: "
            + figures_text({figure: getattr(judged.figures, figure) for figure in COST})
            for name, judged in (("whole calibration", self.full), ("as exported", self.exported))
        ]
        findings = [finding.line for finding in self.full.findings]
        verdict = "; ".join((f"verdict on the control set: {self.full.verdict}", *self.full.reasons))
        return "\n".join([*figures, *findings, verdict])


@dataclass(frozen=True, eq=False)
class Export:
    """A calibration written in the format of another program.

    form          the format
    text          contents of the file; for a binary file, its header, which the file does not contain
    binary        contents of a binary file, None for a text
    lost          description of each part of the calibration that the file does not contain
    same_as       calibration whose correction equals the one that the other program computes from the file;
                  None for a format that describes noise only
    calibration   the exported calibration
    """

    form: Format
    text: str
    lost: tuple[str, ...]
    same_as: Calibration | None
    calibration: Calibration
    binary: bytes | None = None

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the file atomically. Raises InputError if it cannot be written."""
        if self.binary is None:
            write_text(path, self.text)
            return
        with write_atomically(path) as file:
            file.write(self.binary)

    def residual(
        self, control: Recording | Sequence[Recording], *, min_rest_s: float = _core.MIN_REST_S
    ) -> Residual | None:
        """Evaluate the whole calibration and its exported part on control recordings of the same unit.

        min_rest_s   shortest rest, s, that the rest detection accepts

        Returns None for a format that describes noise only. Raises the errors of `imucal.evaluate`.
        """
        if self.same_as is None:
            return None
        back = str(Axes.parse(self.calibration.axes).inverse)
        in_columns = [recording.with_axes(back) for recording in as_recordings(control)]
        return Residual(
            evaluate(self.calibration, control, min_rest_s=min_rest_s),
            evaluate(self.same_as, in_columns, min_rest_s=min_rest_s),
        )


def export(
    calibration: Calibration,
    format: str,
    *,
    noise: NoiseResult | None = None,
    name: str | None = None,
    board_orientation: int | str | None = None,
    accel_lsb_per_g: float | None = None,
    gyro_lsb_per_dps: float | None = None,
    body_axes: str | None = None,
) -> Export:
    """Write the calibration in `format`, one of the names in `FORMATS`.

    noise   noise figures of a recording at rest, corrected by this calibration; the formats kalibr-imu and
            gazebo require them, openvins contains them if given, and the other formats ignore them
    name    prefix of all C names in the formats c-header (default "imucal") and fusion (default: no prefix).
            Two units in one program need two prefixes.
    board_orientation   ardupilot: AHRS_ORIENTATION of the log that was calibrated, a number or the angles
                        "ROLL,PITCH,YAW" in deg. ArduPilot applies its parameters before this rotation and
                        logs samples after it. Default: no rotation.
    accel_lsb_per_g, gyro_lsb_per_dps   inav: resolution of the sensor's driver, counts per g and per deg/s.
                        blob: resolution of the sensor, if the calibration is in SI units and the firmware has
                        raw samples in counts
    body_axes   blob: axes of the corrected samples in terms of the body frame, such as "x,-y,-z"

    Raises InputError for an unknown format, for an accelerometer alone if the format needs both sensors, for
    a calibration of raw counts if the other program only corrects SI units, for left-handed sensor axes or a
    large rotation between the sensors if the format cannot represent them, for left-handed `body_axes`, for
    raw counts whose resolution differs from that of inav, for missing noise figures, and for an option that
    has no valid value or that the format does not use.
    """
    form = find_format(format)
    if name is not None:
        if form.named is None:
            raise InputError(f"{form.name} files contain no names with a prefix: remove --name")
        form = form.named(name)
    if board_orientation is not None:
        if form.oriented is None:
            raise InputError(f"{form.name} has no board orientation: remove --board-orientation")
        form = form.oriented(board_rotation(board_orientation))
    if accel_lsb_per_g is not None or gyro_lsb_per_dps is not None:
        if form.scaled is None:
            raise InputError(
                f"{form.name} does not use the resolution: remove --accel-lsb-per-g and --gyro-lsb-per-dps"
            )
        if form.name == BLOB.name and None in (accel_lsb_per_g, gyro_lsb_per_dps):
            raise InputError(f"{form.name} needs both --accel-lsb-per-g and --gyro-lsb-per-dps")
        form = form.scaled(
            ACCEL_LSB_PER_G if accel_lsb_per_g is None else accel_lsb_per_g,
            GYRO_LSB_PER_DPS if gyro_lsb_per_dps is None else gyro_lsb_per_dps,
        )
    if body_axes is not None:
        if form.along is None:
            raise InputError(f"{form.name} has no axes of the corrected samples: remove --body-axes")
        form = form.along(body_axes)
    require_si(calibration, form)
    able = [each.name for each in FORMATS.values() if not each.needs_gyroscope]
    require_sensors_of(calibration, form, able)
    if form.needs_noise and noise is None:
        raise InputError(
            f"{form.name} needs noise figures, which a calibration does not contain: give a recording of the "
            "unit at rest (--noise REC)"
        )
    try:
        written = form.write(along_columns(calibration), noise)
    except InputError:
        # A format without a field for a rotation cannot represent the axis remapping of the recordings. Its
        # body frame must then be along the axes before the remapping. This is only possible if the remapping
        # is the same for both sensors.
        axes = Axes.parse(calibration.axes)
        if calibration.axes == UNCHANGED or not axes.are_alike:
            raise
        written = form.write(along_columns(calibration, with_body=True), noise)
    if calibration.axes != UNCHANGED:
        written = replace(written, notes=(*written.notes, axes_note(calibration)))
    return Export(
        form,
        form.layout(header(calibration, form, written), written.body),
        written.lost,
        written.same_as,
        calibration,
        written.binary,
    )


def find_format(name: str) -> Format:
    """The format of this name. Raises InputError, listing all names, if there is none."""
    if name not in FORMATS:
        raise InputError(f"there is no format {name!r}: give one of {', '.join(FORMATS)}")
    return FORMATS[name]


def formats_markdown() -> str:
    """The table of all formats for docs/export.md, as Markdown."""
    rows = [
        f"| `{form.name}` | {form.title} (`{form.suffix}`) | {form.includes} | {form.omits} | "
        f"{'yes' if form.takes_counts else 'no'} | {form.source} |"
        for form in FORMATS.values()
    ]
    heads = ("`--to`", "file", "includes", "omits", "raw counts", "source of the formula")
    return "\n".join([f"| {' | '.join(heads)} |", "|---" * len(heads) + "|", *rows])
