"""Calibration from a table of mean readings."""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np

import imucal._core as _core
from imucal.calibration.triad import Parameter
from imucal.errors import InputError
from imucal.estimation.options import Options
from imucal.recording.means import Means
from imucal.recording.recording import Recording
from imucal.rig.unit import Unit, unit_of

__all__ = ["FromMeans", "calibrated_means", "rows_of_means"]


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
    """The means with standard deviations computed from the white noise of a unit."""
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
