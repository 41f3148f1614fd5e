"""Calibration from a table of mean readings."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

import imucal._core as _core
from imucal.calibration.triad import Parameter
from imucal.errors import InputError
from imucal.estimation.options import Options
from imucal.finding import Finding
from imucal.recording.means import Means
from imucal.recording.recording import Recording
from imucal.rig.unit import Unit, unit_of

__all__ = ["FromMeans", "calibrated_means", "rows_of_means", "without_repeated_rows"]

# Largest number of repeated rows whose row numbers are written in the warning.
ROWS_NAMED: Final = 8


@dataclass(frozen=True, slots=True)
class FromMeans:
    """Additional results of a calibration from a table of means.

    noise_from  origin of the noise of the means: "columns", "given", "unit" or "residuals"
    gyro_bias   mean reading of the gyroscope over all rests, x, y, z, with its standard deviation from the
                scatter between rests; empty without a gyroscope
    """

    noise_from: str
    gyro_bias: tuple[Parameter, ...]

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences on the origin of the noise and on the bias of the gyroscope."""
        of = {
            "columns": "the standard deviations in the table",
            "given": "the given standard deviation (--noise)",
            "unit": "the noise density of the unit's profile and the duration of each mean",
            "residuals": "the residuals of this fit, because it is not given",
        }
        notes = [f"the noise of the means is that of {of[self.noise_from]}"]
        notes += [
            f"{p.name} is {p.value:.6g} {p.unit}"
            + (f" ± {p.std:.2g}" if p.std is not None else "")
            + ": the mean reading at rest; scale and misalignment of the gyroscope need moves"
            for p in self.gyro_bias
        ]
        return tuple(notes)


def without_repeated_rows(means: Means) -> Means:
    """Remove exact copies of earlier rows from the means, and add a warning that lists the removed rows.

    The means of two rests differ in their noise, so equal rows are one rest that was written twice. Only
    means in coarse counts can be equal by chance. Their errors are then the same rounding errors, so the
    second row adds no information either.
    """
    columns = (means.specific_force, means.angular_rate, means.specific_force_std, means.duration_s)
    rows = np.column_stack([values for values in columns if values is not None])
    first: dict[bytes, int] = {}
    same_as = [first.setdefault(row.tobytes(), number) for number, row in enumerate(rows)]
    copies = [number for number, original in enumerate(same_as) if original != number]
    if not copies:
        return means
    kept = np.array([number for number, original in enumerate(same_as) if original == number])
    named = ", ".join(str(number + 1) for number in copies[:ROWS_NAMED])
    more = f" and {len(copies) - ROWS_NAMED} more" if len(copies) > ROWS_NAMED else ""
    warning = Finding(
        "samples_duplicated",
        "warning",
        means.name,
        (),
        None,
        len(copies),
        float(len(copies)),
        "rows",
        f"{len(copies)} of {len(rows)} rows are exact copies of an earlier row: {named}{more} (row 1 is the "
        f"first, and row {copies[0] + 1} is a copy of row {same_as[copies[0]] + 1}); they were left out, "
        "because a copy contains no new rest, and the rests are numbered without them",
        "give every rest once",
    )
    return replace(
        means,
        specific_force=means.specific_force[kept],
        angular_rate=None if means.angular_rate is None else means.angular_rate[kept],
        specific_force_std=None if means.specific_force_std is None else means.specific_force_std[kept],
        duration_s=None if means.duration_s is None else means.duration_s[kept],
        findings=(*means.findings, warning),
    )


def rows_of_means(means: Means) -> Recording:
    """The means of the accelerometer as a recording with one sample per row. The time is the row number."""
    return Recording(
        np.arange(len(means), dtype=np.float64),
        means.specific_force,
        accel_unit=means.accel_unit,
        name=means.name,
        sources=means.sources,
        findings=means.findings,
        axes=means.axes,
    )


def calibrated_means(
    means: Means,
    noise_mps2: float | None,
    unit: Unit | str | os.PathLike[str] | None,
    options: Options,
) -> tuple[FromMeans, _core.Outcome]:
    """Calibrate from a table of means in the compiled library, with the arguments of `calibrate`."""
    if means.specific_force_std is not None:
        if noise_mps2 is not None:
            raise InputError(
                f"{means.name} has the standard deviations of its means, and noise_mps2 is given: leave one "
                "out"
            )
        table, noise_from = means, "columns"
    elif noise_mps2 is not None:
        table, noise_from = means, "given"
    elif unit is not None:
        table, noise_from = _with_noise_of(means, unit_of(unit)), "unit"
    else:
        table, noise_from = means, "residuals"
    outcome, bias = _core.calibrate_means(table, noise_mps2, options)
    rates: tuple[Parameter, ...] = ()
    if bias is not None:
        rates = tuple(
            Parameter(f"gyro_bias_{axis}", value, std if np.isfinite(std) else None, means.gyro_unit)
            for axis, value, std in zip("xyz", *bias, strict=True)
        )
    return FromMeans(noise_from, rates), outcome


def _with_noise_of(means: Means, unit: Unit) -> Means:
    """Add standard deviations, computed from the white noise of `unit`, to the means."""
    if means.duration_s is None:
        raise InputError(
            f"{means.name} has no column duration_s, so the noise of a mean cannot be computed from the "
            "noise density of unit: add the averaging time of each mean, or give noise_mps2"
        )
    if means.accel_unit == "lsb":
        raise InputError(f"{means.name} is in counts and the profile of unit in SI units: give noise_mps2")
    std = unit.accelerometer.noise_density / np.sqrt(means.duration_s)
    return Means(
        specific_force=means.specific_force,
        angular_rate=means.angular_rate,
        specific_force_std=np.repeat(std[:, None], 3, axis=1),
        accel_unit=means.accel_unit,
        gyro_unit=means.gyro_unit,
        name=means.name,
    )
