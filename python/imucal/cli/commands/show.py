"""The command `imucal show`, which prints the contents of a calibration file."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from imucal.cli.options import JsonPath, UnitsOption, UnitSystem
from imucal.cli.output import Output, require_apart
from imucal.cli.parameters import argument

if TYPE_CHECKING:
    from imucal.calibration.calibration import Calibration

__all__ = ["show"]


def show(
    calibration: Annotated[Path, argument(metavar="CAL", help="Calibration file.")],
    units: UnitsOption = UnitSystem.datasheet,
    json: JsonPath = None,
) -> None:
    """Print the parameters of a calibration file, its verdict and its origin.

    Example: imucal show unit-0042.json
    """
    import imucal

    require_apart([calibration], {"--json": json})
    loaded = imucal.Calibration.load(calibration)
    out = Output(json, units)
    out.document(loaded.to_dict)
    for line in _origin(loaded):
        out.line(line)
    out.parameters(loaded.parameters)
    out.figures({"calibration set": loaded.calibration_set, "control set": loaded.control_set})
    for note in loaded.references.notes(loaded.gravity_mps2, has_gyroscope=loaded.gyroscope is not None):
        out.line(note)
    verdict, reasons = loaded.judged
    out.line("; ".join((f"verdict: {verdict}", *reasons)), verdict)


def _origin(loaded: Calibration) -> Iterator[str]:
    """Lines on the unit, the recordings, the effects and the temperature of a calibration."""
    gyroscope = f"gyroscope in {loaded.gyro_unit}" if loaded.gyroscope else "no gyroscope"
    yield (
        f"unit {loaded.serial_number or 'without a serial number'}: accelerometer in {loaded.accel_unit}, "
        f"{gyroscope}; body frame {loaded.frame}"
    )
    origin = loaded.provenance
    made_by = origin.imported.program if origin.imported else f"imucal {origin.imucal_version}"
    files = [source.path for source in (*origin.files, *origin.composed_of)]
    yield (
        f"made by {made_by}"
        + (f" on {origin.date}" if origin.date else "")
        + (f" from {', '.join(files)}" if files else "")
    )
    if loaded.effects:
        yield f"effects: {', '.join(effect.name for effect in loaded.effects)}"
    if loaded.temperature_range_degc is not None:
        lowest, highest = loaded.temperature_range_degc
        yield f"temperature of the recordings: {lowest:.1f} to {highest:.1f} degC"
