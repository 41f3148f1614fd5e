"""Drift of units that were calibrated on several dates: slopes, joint tests, steps, and ageing.

    y_it = value_i + slope_i t + e_it

y_it is the measurement of unit i at time t, and e_it the noise of this measurement. value_i and slope_i are
estimated for each unit. The variance of e_it is the stated variance plus an excess variance, which is
estimated from repeated calibrations of the fleet.

Shifts common to all units of a station, on all days or on one day, are removed first. A unit is reported as
drifting if its p-value is significant among the p-values of all units (false discovery rate of Benjamini and
Hochberg).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.document.plain import without_nan
from imucal.errors import InputError
from imucal.fleet.measurements import Measurements
from imucal.fleet.statistics.ageing import Ageing, ageing_of
from imucal.fleet.statistics.columns import Columns, columns_of
from imucal.fleet.statistics.scipy_part import scipy_part
from imucal.fleet.statistics.shifts import Shift, common_shifts
from imucal.fleet.statistics.slopes import Slopes, slopes_of
from imucal.fleet.statistics.units_of_fleet import usable

__all__ = ["DriftResult", "ParameterDrift", "UnitDrift", "drift"]

SCHEMA: Final = "imucal.fleet-drift/1"
# False discovery rate: expected share of false alarms among the units that are reported as drifting.
FALSE_DISCOVERIES: Final = 0.002
# A parameter of a drifting unit is reported if its p-value, corrected for the number of parameters, is below
# this threshold.
NAMED_BELOW: Final = 0.01
# A step is reported instead of a slope if the chi2 of the fit with a slope exceeds the chi2 of the fit with a
# step by at least this number.
STEP_IS_BETTER: Final = 6.0


@dataclass(frozen=True)
class ParameterDrift:
    """The drift of one parameter of one unit.

    name, unit               name and unit of the parameter
    change, change_std       last value minus first value, and the standard deviation of this difference
    slope, slope_std         change per month of 30.4 days, and its standard deviation
    p_value                  p-value of the slope or of the step, corrected for the number of parameters and
                             steps
    step, step_date          size of the step and date of the first value after it, if a step explains the
                             values better than a slope; None otherwise
    dates, values, sigmas    the measurements, after subtraction of the shifts of stations
    """

    name: str
    unit: str
    change: float
    change_std: float
    slope: float
    slope_std: float
    p_value: float
    step: float | None
    step_date: str | None
    dates: tuple[str, ...]
    values: tuple[float, ...]
    sigmas: tuple[float, ...]


@dataclass(frozen=True)
class UnitDrift:
    """The drift of one unit.

    serial, station, batch   serial number, station and batch of the first calibration
    dates         number of calibrations with a date
    days          number of days from the first to the last calibration
    chi2, dof     chi2 and its degrees of freedom in the joint test that all slopes are zero; chi2 is None
                  without covariances of the calibrations
    p_value       combined p-value of the joint test and of the single parameters
    q_value       smallest false discovery rate at which the unit is reported
    is_drifting   whether q_value is at most 0.2 %
    parameters    significant parameters, the most significant first; all parameters if a single unit was
                  requested
    """

    serial: str
    station: str
    batch: str
    dates: int
    days: float
    chi2: float | None
    dof: int
    p_value: float
    q_value: float
    is_drifting: bool
    parameters: tuple[ParameterDrift, ...]


@dataclass(frozen=True)
class DriftResult:
    """Drift of a fleet.

    units     units with two or more dates, the most significant first
    single    number of units with one date
    poor      number of calibrations omitted because they are poor
    ageing    mean slope of each parameter over all units, and by batch, station and temperature
    shifts    common shifts of stations that were removed
    """

    units: tuple[UnitDrift, ...]
    single: int
    poor: int
    ageing: tuple[Ageing, ...]
    shifts: tuple[Shift, ...]

    @property
    def drifting(self) -> tuple[UnitDrift, ...]:
        """The units that drift."""
        return tuple(unit for unit in self.units if unit.is_drifting)

    def to_dict(self) -> dict[str, Any]:
        """The JSON document of `imucal fleet drift --json`."""
        return {"schema": SCHEMA, **without_nan(self)}


def drift(measurements: Measurements, serial: str | None = None) -> DriftResult:
    """The drift of all units, or of one unit; the false discovery rate is always controlled over all units.

    Raises InputError if no unit has two dates, and for a serial number with fewer than two dates.
    """
    kept, poor = usable(measurements)
    dated = kept.in_order_of_time()
    columns = columns_of(dated, figures=False) if len(dated) else None
    if columns is None or not columns.names:
        raise InputError(
            "no unit has a date and a parameter with a standard deviation, so drift cannot be tested"
        )
    shifts = common_shifts(dated, columns)
    slopes = slopes_of(dated, columns, columns.values - shifts.added)
    if not len(slopes.first):
        raise InputError(
            f"none of {len(np.unique(dated.serials))} units was calibrated on two dates, which a test of "
            "drift needs"
        )
    if serial is not None and serial not in dated.serials[slopes.first]:
        count = int((dated.serials == serial).sum())
        raise InputError(
            f"unit {serial!r} has {count} usable calibrations with a date: a drift needs two dates"
        )
    q_values = scipy_part("stats").false_discovery_control(slopes.p_values)
    units = [
        _unit(dated, columns, shifts.added, slopes, unit, float(q_values[unit]), serial is not None)
        for unit in np.argsort(slopes.p_values, kind="stable").tolist()
        if serial is None or dated.serials[slopes.first[unit]] == serial
    ]
    single = len(np.unique(dated.serials)) - len(slopes.first)
    return DriftResult(tuple(units), single, poor, ageing_of(dated, columns, slopes), shifts.found)


def _unit(
    dated: Measurements,
    columns: Columns,
    added: FloatArray,
    slopes: Slopes,
    unit: int,
    q_value: float,
    with_all: bool,
) -> UnitDrift:
    rows = slopes.rows[unit]
    first = slopes.first[unit]
    is_drifting = q_value <= FALSE_DISCOVERIES
    days = float((dated.dates[rows[-1]] - dated.dates[rows[0]]) / np.timedelta64(1, "s")) / 86400.0
    parameters = [
        _parameter(dated, columns, added, slopes, unit, column)
        for column in range(len(columns.names))
        if np.isfinite(slopes.slopes[unit, column])
        and (with_all or (is_drifting and slopes.parameter_p[unit, column] <= NAMED_BELOW))
    ]
    return UnitDrift(
        str(dated.serials[first]),
        str(dated.stations[first]),
        str(dated.batches[first]),
        len(rows),
        days,
        None if slopes.chi2 is None else float(slopes.chi2[unit]),
        int(slopes.dof[unit]),
        float(slopes.p_values[unit]),
        q_value,
        is_drifting,
        tuple(sorted(parameters, key=lambda parameter: parameter.p_value)),
    )


def _parameter(
    dated: Measurements, columns: Columns, added: FloatArray, slopes: Slopes, unit: int, column: int
) -> ParameterDrift:
    rows = slopes.rows[unit]
    rows = rows[np.isfinite(columns.values[rows, column])]
    values = columns.values[rows, column] - added[rows, column]
    variances = columns.variances[rows, column]
    slope, slope_std = float(slopes.slopes[unit, column]), float(slopes.stds[unit, column])
    step, step_row = _step(dated, rows, values, variances, slope, slope_std)
    return ParameterDrift(
        columns.names[column],
        columns.units[column],
        float(values[-1] - values[0]),
        float(np.sqrt(variances[0] + variances[-1])),
        slope,
        slope_std,
        float(slopes.parameter_p[unit, column]),
        step,
        None if step_row is None else str(np.datetime_as_string(dated.dates[step_row])),
        tuple(np.datetime_as_string(dated.dates[rows]).tolist()),
        tuple(values.tolist()),
        tuple(np.sqrt(variances).tolist()),
    )


def _step(
    dated: Measurements,
    rows: np.ndarray,
    values: FloatArray,
    variances: FloatArray,
    slope: float,
    slope_std: float,
) -> tuple[float | None, int | None]:
    """Size of the best step and first row after the step; None if a slope explains the values better."""
    best: tuple[float, float, int] | None = None
    for at in range(1, len(rows)):
        before, after = 1.0 / variances[:at], 1.0 / variances[at:]
        step = float((after * values[at:]).sum() / after.sum() - (before * values[:at]).sum() / before.sum())
        explained = step**2 / (1.0 / before.sum() + 1.0 / after.sum())
        if dated.dates[rows[at]] > dated.dates[rows[at - 1]] and (best is None or explained > best[0]):
            best = explained, step, int(rows[at])
    if best is None or len(rows) < 3 or best[0] < (slope / slope_std) ** 2 + STEP_IS_BETTER:
        return None, None
    return best[1], best[2]
