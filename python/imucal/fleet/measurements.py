"""The measurements of a fleet as arrays: one row per calibration of a unit.

`Fleet.measurements` returns them from the store. They are the only input of the statistics of a fleet.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import FloatArray
from imucal.errors import InputError

__all__ = ["Measurements", "TextArray"]

TextArray = NDArray[np.str_]


@dataclass(frozen=True, eq=False, repr=False)
class Measurements:
    """n calibrations with p parameters. NaN stands for a number that a calibration does not have.

    serials       (n,) serial numbers; a unit that was measured several times has several rows
    dates         (n,) datetime64[s], UTC; NaT where not known
    stations      (n,) text, empty if not known; operators, batches, roles and verdicts have the same form
    names, units  names and units of the p parameters, such as gyro_bias_x and rad/s
    values_si     (n, p) values of the parameters, SI units
    sigmas_si     (n, p) standard deviations of the parameters, SI units
    covariances   (n, p, p), or None if they were not requested
    figures       one array (n,) for each figure of merit and for the temperature, by name:
                  gravity_direction_rms_deg, chi2_per_dof, temperature_degc, ...
    """

    serials: TextArray
    dates: NDArray[np.datetime64]
    stations: TextArray
    operators: TextArray
    batches: TextArray
    roles: TextArray
    verdicts: TextArray
    names: tuple[str, ...]
    units: tuple[str, ...]
    values_si: FloatArray
    sigmas_si: FloatArray
    covariances: FloatArray | None = None
    figures: Mapping[str, FloatArray] = field(default_factory=dict)

    def __post_init__(self) -> None:
        rows, columns = len(self.serials), len(self.names)
        shapes = {
            **{name: (getattr(self, name).shape, (rows,)) for name in PER_ROW},
            "units": ((len(self.units),), (columns,)),
            "values_si": (self.values_si.shape, (rows, columns)),
            "sigmas_si": (self.sigmas_si.shape, (rows, columns)),
            **{f"figures[{name!r}]": (each.shape, (rows,)) for name, each in self.figures.items()},
        }
        if self.covariances is not None:
            shapes["covariances"] = (self.covariances.shape, (rows, columns, columns))
        for name, (found, needed) in shapes.items():
            if found != needed:
                raise InputError(f"{name} has the shape {found}: {needed} is needed")

    def __len__(self) -> int:
        return len(self.serials)

    def __repr__(self) -> str:
        units = len(np.unique(self.serials))
        return f"Measurements({len(self)} of {units} units, {len(self.names)} parameters)"

    def where(self, rows: NDArray[Any]) -> Measurements:
        """The rows that a mask or indices select."""
        return replace(
            self,
            **{name: getattr(self, name)[rows] for name in PER_ROW},
            values_si=self.values_si[rows],
            sigmas_si=self.sigmas_si[rows],
            covariances=None if self.covariances is None else self.covariances[rows],
            figures={name: values[rows] for name, values in self.figures.items()},
        )

    def of_parameters(self, names: Sequence[str]) -> Measurements:
        """The measurements with only the parameters `names`. Raises InputError for an unknown name."""
        for name in names:
            if name not in self.names:
                raise InputError(f"no unit has a parameter {name!r}: give one of {', '.join(self.names)}")
        columns = np.array([self.names.index(name) for name in names], dtype=np.intp)
        return replace(
            self,
            names=tuple(names),
            units=tuple(self.units[column] for column in columns),
            values_si=self.values_si[:, columns],
            sigmas_si=self.sigmas_si[:, columns],
            covariances=None
            if self.covariances is None
            else self.covariances[:, columns[:, None], columns[None, :]],
        )

    def in_order_of_time(self) -> Measurements:
        """The rows in order of their dates.

        Rows with equal dates keep their order, and rows without a date are dropped.
        """
        dated = self.where(~np.isnat(self.dates))
        return dated.where(np.argsort(dated.dates, kind="stable"))


# Arrays of `Measurements` with one value per row. The arrays of values, standard deviations and covariances
# also have an axis of parameters, and `figures` is a dictionary of arrays.
PER_ROW = ("serials", "dates", "stations", "operators", "batches", "roles", "verdicts")
