"""The command `imucal apply`, which corrects a recording by a calibration."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from imucal.cli.options import JsonPath, RecordingPath
from imucal.cli.output import Output, require_apart
from imucal.cli.parameters import argument
from imucal.cli.reading import Reading, reading_options
from imucal.cli.working import working

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from imucal.arrays import FloatArray
    from imucal.calibration.calibration import Calibration
    from imucal.recording.recording import Recording

__all__ = ["apply"]

# Codes of the findings that `apply` reports: units and time stamps of the input that are probably wrong. All
# other findings concern the suitability of a recording for a calibration.
REPORTED: Final = ("accel_units", "gyro_units", "time_not_increasing", "clock_rate")


@reading_options
def apply(
    calibration: Annotated[Path, argument(metavar="CAL", help="Calibration file.")],
    recording: Annotated[
        list[Path], argument(metavar="REC", help="The file, or the two files, of one recording.")
    ],
    output: RecordingPath,
    reading: Reading,
    json: JsonPath = None,
) -> None:
    """Correct a recording: the output has samples in SI units along the body frame, and all other columns.

    A warning is printed if units or time stamps of the recording look wrong.

    CSV and Parquet files are corrected in pieces, so that memory does not grow with the file. A calibration
    with a lever arm or a delay needs the derivative of the rate; the file is then corrected as a whole.

    Example: imucal apply unit-0042.json run.csv -o corrected.csv
    """
    import imucal
    from imucal.calibration.temperature import extrapolation
    from imucal.io import write_pieces

    require_apart([calibration, *recording], {"--output": output, "--json": json})
    unit = imucal.Calibration.load(calibration)

    def written(pieces: Iterator[Recording]) -> _Corrected:
        corrected = _Corrected(unit, pieces)
        write_pieces(corrected.whole, output)
        return corrected

    with working("correcting"):
        if unit.takes_pieces:
            corrected = reading.by_pieces(recording, written)
        else:
            corrected = written(iter([reading.one(recording)]))
    removed = [effect.name for effect in unit.effects if effect.name not in unit.left_in_data]
    beyond = extrapolation(unit, corrected.temperature_range_degc)
    warnings = [*corrected.warnings(), *([beyond] if beyond else [])]
    out = Output(json)
    out.document(
        {
            "output": str(output),
            "calibration": str(calibration),
            "samples": corrected.whole.samples,
            "effects": removed,
            "left_in_data": unit.left_in_data,
            "samples_lost": corrected.lost.count + corrected.no_temperature.count,
            "samples_without_temperature": corrected.no_temperature.count,
            "samples_missing": corrected.missing.count,
            "temperature_range_degc": corrected.temperature_range_degc,
            "warnings": warnings,
        }
    )
    out.line(f"{output}: {corrected.whole!r}")
    if removed:
        out.line(f"effects compensated: {', '.join(removed)}")
    if unit.left_in_data:
        out.line(f"not compensated, as they are no sensor errors: {', '.join(unit.left_in_data)}")
    for warning in warnings:
        out.line(f"warning: {warning}")


class _Empty:
    """Counts samples that lack a result for a certain reason, and stores the index of the first of them."""

    def __init__(self) -> None:
        self.count = 0
        self.first = 0

    def add(self, empty: npt.NDArray[np.bool_], before: int) -> None:
        """Count the samples of a piece that the mask `empty` marks.

        before   number of samples of the recording before this piece
        """
        if not self.count and empty.any():
            self.first = before + int(empty.argmax())
        self.count += int(empty.sum())

    def warning(self, reason: str) -> list[str]:
        """A list with the warning that the counted samples are empty; an empty list if the count is zero."""
        if not self.count:
            return []
        samples = "1 sample is" if self.count == 1 else f"{self.count} samples are"
        return [f"{samples} empty, first sample {self.first}: {reason}"]


class _Corrected:
    """Corrects the pieces of a recording, and counts the samples that cannot be corrected.

    findings        for each code of `REPORTED` (units and time stamps), the first finding, as text
    missing         samples whose rate or force is missing in the recording
    no_temperature  samples without a result because their temperature is missing
    lost            samples without a result for other reasons
    """

    def __init__(self, unit: Calibration, pieces: Iterator[Recording]) -> None:
        from imucal.io.pieces import Whole

        self.whole = Whole(self._each(unit, pieces))
        self.findings: dict[str, str] = {}
        self.missing, self.no_temperature, self.lost = _Empty(), _Empty(), _Empty()
        self.temperature_range_degc: tuple[float, float] | None = None
        self._unit = unit

    def warnings(self) -> list[str]:
        """Warnings about units, time stamps and empty samples."""
        too_large = "the effects are too large to be removed"
        if self.missing.count and not self._unit.takes_pieces:
            too_large += ", or the derivative of the rate is unknown next to missing samples"
        return [
            *self.findings.values(),
            *self.missing.warning("the rate or the force is not a number"),
            *self.no_temperature.warning("the temperature is not a number"),
            *self.lost.warning(too_large),
        ]

    def _each(self, unit: Calibration, pieces: Iterator[Recording]) -> Iterator[Recording]:
        import numpy as np

        from imucal.calibration.correction import empty_samples

        start_s: float | None = None
        last_s: float | None = None
        before = 0
        for raw in pieces:
            if start_s is None and len(raw):
                start_s = float(raw.time_s[0])
            if len(raw):
                self._check(raw if last_s is None else _after(last_s, raw, before))
                last_s = float(raw.time_s[-1])
            # If an effect needs the whole recording, the recording is one piece, and `apply_recording` does
            # not accept a start time.
            corrected = unit.apply_recording(raw, start_s=start_s if unit.takes_pieces else None)
            missing, lost = empty_samples(raw, corrected)
            no_temperature = np.zeros_like(lost)
            if raw.temperature_degc is not None:
                known = np.isfinite(raw.temperature_degc)
                if unit.temperature_effects:
                    no_temperature = lost & ~known
                self._see_temperature(raw.temperature_degc[known])
            self.missing.add(missing, before)
            self.no_temperature.add(no_temperature, before)
            self.lost.add(lost & ~no_temperature, before)
            before += len(raw)
            yield corrected

    def _check(self, raw: Recording) -> None:
        """Check a piece of the recording, and store the first finding of each code that `apply` reports."""
        import imucal._core as _core
        from imucal.units import STANDARD_GRAVITY_MPS2

        seen = _core.inspect(raw.without_copies(), STANDARD_GRAVITY_MPS2, _core.MIN_REST_S, grows=True)
        for finding in seen.findings:
            if finding.code in REPORTED:
                self.findings.setdefault(finding.code, str(finding))

    def _see_temperature(self, temperature_degc: FloatArray) -> None:
        if len(temperature_degc):
            low, high = self.temperature_range_degc or (float("inf"), float("-inf"))
            self.temperature_range_degc = (
                min(low, float(temperature_degc.min())),
                max(high, float(temperature_degc.max())),
            )


def _after(last_s: float, raw: Recording, before: int) -> Recording:
    """A piece of a recording for the checks, with an additional sample before its first sample.

    The additional sample repeats the first sample of the piece at the time `last_s`, so that the checks find
    a jump of the time between the pieces.

    last_s   last time stamp of the piece before, s
    before   number of samples of the recording before this piece
    """
    import numpy as np

    from imucal.recording.recording import Recording

    rows = np.arange(-1, len(raw)).clip(0)
    return Recording(
        np.append(last_s, raw.time_s),
        None if raw.specific_force is None else raw.specific_force[rows],
        None if raw.angular_rate is None else raw.angular_rate[rows],
        accel_unit=raw.accel_unit,
        gyro_unit=raw.gyro_unit,
        name=f"{raw.name}, from sample {before - 1}",
        column_units=raw.column_units,
    )
