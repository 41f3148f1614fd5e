"""Control charts of the units of a station in order of time, with limits that include measurement noise.

    z_i = (y_i - centre) / sqrt(spread^2 + sigma_i^2)      spread^2 = (moving range estimate)^2 - noise^2

y_i is measurement i, sigma_i its standard deviation, and z_i the normalised deviation from the centre line of
the chart. `spread` is the standard deviation of the true values, and noise^2 is the median of sigma_i^2.

A chart shows the single values and their exponentially weighted moving average (EWMA), both with limits. The
four rules of the Western Electric handbook (1956) are applied to the values. They give false alarms at a
known rate per chart, so many charts give many false alarms. The alarms of the result are therefore only
shifts of a station that are significant over all charts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.document.plain import without_nan
from imucal.errors import InputError
from imucal.fleet.measurements import Measurements
from imucal.fleet.statistics.columns import columns_of
from imucal.fleet.statistics.scipy_part import scipy_part
from imucal.fleet.statistics.shifts import Shift, common_shifts
from imucal.fleet.statistics.units_of_fleet import first_of_each_unit, usable

__all__ = ["Chart", "Signal", "SpcResult", "control_chart", "spc"]

SCHEMA: Final = "imucal.fleet-spc/1"
# Weight of a new value in the EWMA, and limits of the EWMA in standard deviations (NIST/SEMATECH e-Handbook,
# section 6.3.2.4).
EWMA_WEIGHT: Final = 0.2
EWMA_LIMIT: Final = 3.0
# Median range of two standard normal values. It converts a median moving range to a standard deviation.
MEDIAN_RANGE_OF_TWO: Final = 0.9538725524
# Minimum number of units of a chart.
FEWEST_UNITS: Final = 10
# Rules by name. (m, n, k) means: of n consecutive values, m deviate by more than k standard deviations to one
# side.
RULES: Final = {
    "beyond_3_sigma": (1, 1, 3.0),
    "2_of_3_beyond_2_sigma": (2, 3, 2.0),
    "4_of_5_beyond_1_sigma": (4, 5, 1.0),
    "8_on_one_side": (8, 8, 0.0),
}


@dataclass(frozen=True)
class Signal:
    """A violated rule of a control chart, with index, serial number and date of the violating value."""

    rule: str
    index: int
    serial: str
    date: str
    z: float


@dataclass(frozen=True, eq=False)
class Chart:
    """The control chart of one parameter or figure of merit at one station.

    station        name of the station
    name, unit     name and unit of the parameter or figure of merit
    units          number of units
    centre         median of the values
    spread         standard deviation of the true values of the units: the estimate from the moving ranges
                   with the measurement noise subtracted
    noise          rms of the standard deviations of the measurements; the spread is computed with their
                   median
    signals        violated rules, in order of time
    serials, dates serial numbers and dates of the units
    values         measured values. For each value, `limits` is 3 standard deviations, computed from the
                   spread of the units and the measurement noise of this value
    ewma           exponentially weighted moving average of z, with the limits `ewma_limits`
    """

    station: str
    name: str
    unit: str
    units: int
    centre: float
    spread: float
    noise: float
    signals: tuple[Signal, ...]
    serials: tuple[str, ...]
    dates: tuple[str, ...]
    values: FloatArray
    limits: FloatArray
    ewma: FloatArray
    ewma_limits: FloatArray


@dataclass(frozen=True, eq=False)
class SpcResult:
    """Control charts of all parameters and figures of merit at all stations.

    units    number of units; the first calibration of each unit is used
    poor     number of calibrations omitted because they are poor
    shifts   shifts of a station, or of a station on one day, which are the alarms
    charts   one chart for each station and each parameter or figure of merit
    """

    units: int
    poor: int
    shifts: tuple[Shift, ...]
    charts: tuple[Chart, ...]

    @property
    def shifted(self) -> tuple[tuple[str, str], ...]:
        """Station and day of each shift, the most significant first; the day is empty for all days."""
        return tuple(dict.fromkeys((shift.station, shift.day) for shift in self.shifts))

    def to_dict(self) -> dict[str, Any]:
        """The JSON document of `imucal fleet spc --json`. It does not contain the measured values."""
        charts = [
            {name: getattr(chart, name) for name in ("station", "name", "unit", "units", "centre")}
            | {"spread": chart.spread, "noise": chart.noise, "signals": chart.signals}
            for chart in self.charts
        ]
        fields = {"units": self.units, "poor": self.poor, "shifts": self.shifts, "charts": charts}
        return {"schema": SCHEMA, **without_nan(fields)}


def spc(measurements: Measurements, *, station: str | None = None) -> SpcResult:
    """Control charts of the first calibration of each unit, and shifts of stations over all calibrations.

    station   if given, only charts of this station are computed

    Raises InputError if there are fewer than ten units.
    """
    kept, poor = usable(measurements)
    dated = kept.in_order_of_time()
    if len(np.unique(dated.serials)) < FEWEST_UNITS:
        raise InputError(
            f"{len(np.unique(dated.serials))} units have a date: control charts need {FEWEST_UNITS}; give "
            "dates in the manifest, or by {date} in --names"
        )
    shifts = common_shifts(dated, columns_of(dated)).found
    first, _ = first_of_each_unit(dated)
    columns = columns_of(first)
    stations = np.unique(first.stations).tolist() if station is None else [station]
    if station is not None and station not in first.stations:
        raise InputError(
            f"there is no station {station!r}: give one of {', '.join(np.unique(first.stations))}"
        )
    serials, dates = first.serials.astype(object), np.datetime_as_string(first.dates).astype(object)
    charts = []
    for name in stations:
        rows = np.flatnonzero(first.stations == name)
        for column, (quantity, unit) in enumerate(zip(columns.names, columns.units, strict=True)):
            known = rows[np.isfinite(columns.values[rows, column])]
            if len(known) >= FEWEST_UNITS:
                charts.append(
                    control_chart(
                        columns.values[known, column],
                        np.sqrt(columns.variances[known, column]),
                        serials=serials[known].tolist(),
                        dates=dates[known].tolist(),
                        station=name,
                        name=quantity,
                        unit=unit,
                    )
                )
    return SpcResult(len(first), poor, shifts, tuple(charts))


def control_chart(
    values: FloatArray,
    sigmas: FloatArray,
    *,
    serials: Sequence[str] = (),
    dates: Sequence[str] = (),
    station: str = "",
    name: str = "",
    unit: str = "",
) -> Chart:
    """The control chart of values that are in order of time, with their standard deviations."""
    centre = float(np.median(values))
    moving = float(np.median(np.abs(np.diff(values)))) / MEDIAN_RANGE_OF_TWO
    variance = max(moving**2 - float(np.median(sigmas**2)), 0.0)
    std = np.sqrt(variance + sigmas**2)
    z = np.divide(values - centre, std, out=np.zeros_like(values), where=std > 0)
    ewma, limits = _ewma(z)
    serials = serials or [""] * len(values)
    dates = dates or [""] * len(values)
    signals = [
        Signal(rule, index, serials[index], dates[index], float(z[index]))
        for rule, index in [*_western_electric(z), *(("ewma", k) for k in _entered(np.abs(ewma) > limits))]
    ]
    return Chart(
        station,
        name,
        unit,
        len(values),
        centre,
        float(np.sqrt(variance)),
        float(np.sqrt((sigmas**2).mean())),
        tuple(sorted(signals, key=lambda signal: signal.index)),
        tuple(serials),
        tuple(dates),
        values,
        3.0 * std,
        ewma,
        limits,
    )


def _western_electric(z: FloatArray) -> list[tuple[str, int]]:
    """Pairs of a violated rule and the index of the value that violates it."""
    found = []
    for rule, (needed, window, beyond) in RULES.items():
        for side in (1.0, -1.0):
            outside = side * z > beyond
            counts = np.convolve(outside, np.ones(window), "full")[: len(z)]
            found += [(rule, index) for index in np.flatnonzero(outside & (counts >= needed)).tolist()]
    return found


def _ewma(z: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The exponentially weighted moving average, starting from zero, and its widening control limits."""
    signal: Any = scipy_part("signal")
    moving = signal.lfilter([EWMA_WEIGHT], [1.0, EWMA_WEIGHT - 1.0], z)
    steps = np.arange(1, len(z) + 1)
    remaining = 1.0 - (1.0 - EWMA_WEIGHT) ** (2 * steps)
    return moving, EWMA_LIMIT * np.sqrt(EWMA_WEIGHT / (2.0 - EWMA_WEIGHT) * remaining)


def _entered(outside: np.ndarray) -> list[int]:
    """Indices of the first value of each sequence of consecutive values outside the limits."""
    before = np.concatenate([[False], outside[:-1]])
    return [int(index) for index in np.flatnonzero(outside & ~before)]
