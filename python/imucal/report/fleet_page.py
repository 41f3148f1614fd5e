"""The report of a fleet: yield, parameters over time, and sections on outlying, drifting and poor units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

import imucal.plot.fleet as plot
from imucal.errors import InputError
from imucal.fleet.statistics.shifts import days_of
from imucal.plot.style import shown_unit
from imucal.report.page import Shown, Tab, Verdict, write_page
from imucal.report.tables import heading, item_list, paragraph, rounded_to, shown_name, table
from imucal.report.unit_section import unit_section
from imucal.units import Scale, datasheet

if TYPE_CHECKING:
    from imucal.fleet.fleet import Fleet
    from imucal.fleet.measurements import Measurements
    from imucal.fleet.statistics.capability import CapabilityResult
    from imucal.fleet.statistics.drift import DriftResult
    from imucal.fleet.statistics.outliers import OutlierResult
    from imucal.fleet.statistics.spc import SpcResult
    from imucal.fleet.statistics.spread import Spread
    from imucal.limits.limits import Limits

__all__ = ["write_fleet_page"]

# Maximum number of units of each kind (outlying, drifting, poor) that have a section.
MOST_UNITS: Final = 20


def write_fleet_page(
    path: str | Path,
    fleet: Fleet,
    *,
    limits: Limits | None = None,
    title: str = "Fleet",
    reload_s: float | None = None,
    **selection: str | None,
) -> None:
    """Write the report of a store. The size of the report hardly depends on the number of units.

    path       the HTML file
    limits     limits for the capability indices
    reload_s   time, s, after which the browser loads the page again, or None
    selection  selection of units, as in `Fleet.measurements`

    Raises ImucalError if plotly is not installed, and InputError for a store without a calibration.
    """
    measured = fleet.measurements(covariances=False, **selection)
    if not len(measured):
        raise InputError(f"{fleet.path} has no selected calibration: there is nothing to report")
    counts, failures = fleet.count(**selection), fleet.failures(**selection)
    same = fleet.same_recordings(**selection)
    capability = _or_reason(lambda: fleet.capability(limits, **selection))
    spc = _or_reason(lambda: fleet.spc(**selection))
    odd = _or_reason(lambda: fleet.outliers(**selection))
    drift = _or_reason(lambda: fleet.drift(**selection))
    shown = _shown(measured, odd, drift)
    tabs = (
        Tab("Yield", tuple(_yield(measured, counts, failures, same))),
        Tab("Parameters", tuple(_parameters(measured, capability, spc))),
        Tab("Odd units", tuple(_odd(odd, shown))),
        Tab("Drift", tuple(_drift(drift, shown))),
        Tab("Units", tuple(_units(measured, shown, odd))),
    )
    write_page(path, title, tabs, _verdict(counts, same, spc, odd, drift), compressed=True, reload_s=reload_s)


def _or_reason(compute: Any) -> Any:
    """The result of `compute`, or a text with the reason if the fleet is too small for this statistic."""
    try:
        return compute()
    except InputError as error:
        return str(error)


def _verdict(
    counts: Mapping[str, int],
    same: Sequence[Sequence[str]],
    spc: SpcResult | str,
    odd: OutlierResult | str,
    drift: DriftResult | str,
) -> Verdict:
    total = sum(counts.values())
    passed = counts.get("good", 0) + counts.get("incomplete", 0)
    alarms = [
        *(
            []
            if not same
            else [_counted(len(same), "recording", "recordings") + " under several serial numbers"]
        ),
        *(
            []
            if isinstance(spc, str) or not spc.shifted
            else [_counted(len(spc.shifted), "shift of a station", "shifts of stations")]
        ),
        *([] if isinstance(odd, str) or not odd.odd else [_counted(len(odd.odd), "odd unit", "odd units")]),
        *(
            []
            if isinstance(drift, str) or not drift.drifting
            else [_counted(len(drift.drifting), "drifting unit", "drifting units")]
        ),
    ]
    sentence = f"{passed} of {total} calibrations pass ({100 * passed / total:.1f} %)"
    tests = {"shifts of stations": spc, "odd units": odd, "drift": drift}
    untested = [name for name, result in tests.items() if isinstance(result, str)]
    detail = "; ".join(alarms) or "no alarm"
    if untested:
        detail += f"; not tested: {', '.join(untested)} (the tabs give the reasons)"
    return Verdict("poor" if alarms else "good" if passed == total else "incomplete", sentence, detail)


def _counted(count: int, one: str, several: str) -> str:
    return f"{count} {one if count == 1 else several}"


def _yield(
    measured: Measurements,
    counts: Mapping[str, int],
    failures: Mapping[str, int],
    same: Sequence[Sequence[str]],
) -> list[Shown | str]:
    edges, bins = _bins(measured)
    content: list[Shown | str] = []
    if len(edges):
        of_bin = {
            name: np.bincount(bins[(measured.verdicts == name) & (bins >= 0)], minlength=len(edges)).tolist()
            for name in ("good", "incomplete", "poor")
        }
        content.append(
            Shown("yield", plot.yield_over_time(edges, of_bin), "Calibrations by date and verdict.")
        )
    total = sum(counts.values())
    rows = [[name, str(count), f"{100 * count / total:.2f}"] for name, count in sorted(counts.items())]
    content += [heading("Verdicts"), table(["verdict", "calibrations", "%"], rows)]
    stations = [
        [str(station) or "-", str(int(own.sum())), f"{100 * (measured.verdicts[own] != 'poor').mean():.2f}"]
        for station in np.unique(measured.stations)
        for own in (measured.stations == station,)
    ]
    content += [heading("Stations"), table(["station", "with a result", "% not poor"], stations)]
    if failures:
        rows = [[code, str(count)] for code, count in failures.items()]
        content += [heading("Without a result"), table(["reason", "calibrations"], rows)]
    if same:
        content += [
            heading("The same recording under several serial numbers"),
            item_list([" and ".join(serials) for serials in same]),
        ]
    return content


def _parameters(
    measured: Measurements, capability: CapabilityResult | str, spc: SpcResult | str
) -> list[Shown | str]:
    content: list[Shown | str] = []
    if isinstance(spc, str):
        content.append(paragraph(spc))
    elif spc.shifts:
        content += [
            heading("Shifts that all units of a station have in common"),
            item_list(
                [
                    f"station {s.station or '-'}{f' on {s.day}' if s.day else ''}: {s.name} by "
                    f"{s.shift:.3g} ± {s.std:.2g} {s.unit} over {s.units} calibrations"
                    for s in spc.shifts
                ]
            ),
        ]
    if isinstance(capability, str):
        return [*content, paragraph(capability)]
    rows = []
    for row in capability.rows:
        scale = datasheet(row.name, row.unit)
        rows.append(
            [
                shown_name(row.name, scale),
                *(["-"] * 3 if row.spread is None else _of_spread(row.spread, scale)),
                *_indices(row.indices),
                "-" if row.out_true is None else f"{100 * row.out_true:.2g}",
                shown_unit(scale.unit) or "1",
            ]
        )
    content.append(table(["", "mean", "spread", "noise", "Cpk", "Ppk", "% out", "unit"], rows))
    content.append(
        paragraph(
            "The spread is that of the true values: the measurement noise of each unit is subtracted. % out "
            "is the share of true values outside the limits."
        )
    )
    edges, bins = _bins(measured)
    # Only the first limit of each parameter is drawn, although a parameter may have several limits.
    drawn: dict[str, Any] = {}
    for row in capability.rows:
        drawn.setdefault(row.name, row)
    for row in drawn.values():
        if row.spread is not None and len(edges):
            column = measured.names.index(row.name)
            scale = datasheet(row.name, row.unit)
            values = scale.factor * (measured.values_si[:, column] - scale.zero)
            quantiles = _quantiles(measured, values, bins, len(edges))
            limits = [None if limit is None else scale.shown(limit) for limit in (row.low, row.high)]
            figure = plot.over_time(
                edges, quantiles, scale.shown(row.spread.mean), (limits[0], limits[1]), scale.unit
            )
            name = shown_name(row.name, scale)
            content.append(
                Shown(f"time-{row.name}", figure, f"{name}: median and middle 90 % of the units by date.")
            )
    return content


def _of_spread(spread: Spread, scale: Scale) -> list[str]:
    """Mean, spread and noise as text.

    The mean is rounded to the second significant digit of its standard deviation. Spread and noise are
    rounded to two significant digits.
    """
    stds = [scale.factor * std for std in (spread.mean_std, spread.spread, spread.noise)]
    shown = [scale.shown(spread.mean), *stds[1:]]
    return [rounded_to(value, std) for value, std in zip(shown, stds, strict=True)]


def _indices(indices: Any) -> list[str]:
    return ["-", "-"] if indices is None else [f"{indices.cpk.value:.2f}", f"{indices.ppk.value:.2f}"]


def _odd(odd: OutlierResult | str, shown: Sequence[str]) -> list[Shown | str]:
    if isinstance(odd, str):
        return [paragraph(odd)]
    units = odd.units[: max(len(odd.odd), 5)][:MOST_UNITS]
    rows = [
        [u.serial, u.station or "-", f"{u.distance:.1f}", f"{u.q_value:.2g}", d.name, f"{d.z:+.1f}"]
        for u in units
        for d in u.decides[:1]
    ]
    return [
        paragraph(
            f"{len(odd.odd)} of {len(odd.units)} units are outliers, with a false discovery rate of 0.2 %. "
            "The distance from the fleet is over all parameters and figures of merit, in standard "
            "deviations. The parameter that contributes most is listed with its own deviation."
        ),
        _linked(table(["unit", "station", "distance", "q", "decides", "z"], rows), shown),
    ]


def _drift(drift: DriftResult | str, shown: Sequence[str]) -> list[Shown | str]:
    if isinstance(drift, str):
        return [paragraph(drift)]
    rows = [
        [u.serial, str(u.dates), p.name, f"{p.change:.3g}", f"{p.slope:.3g} ± {p.slope_std:.2g}", p.unit]
        for u in drift.drifting[:MOST_UNITS]
        for p in u.parameters[:1]
    ]
    ages = [
        f"{row.name}, {'all units' if row.by == 'all' else f'{row.by} {row.group}'}: {row.slope:.3g} ± "
        f"{row.std:.2g} {row.unit} per month"
        for row in drift.ageing
        if row.is_significant
    ]
    return [
        paragraph(f"{len(drift.drifting)} of {len(drift.units)} units with several dates drift."),
        *(
            [_linked(table(["unit", "dates", "", "change", "per month", "unit"], rows), shown)]
            if rows
            else []
        ),
        *([heading("What ages"), item_list(ages)] if ages else []),
    ]


def _units(measured: Measurements, shown: Sequence[str], odd: OutlierResult | str) -> list[Shown | str]:
    distances = {} if isinstance(odd, str) else {unit.serial: unit for unit in odd.units}
    return [
        paragraph(
            "Outlying, drifting and poor units. `imucal fleet certificate STORE SERIAL` writes the page of "
            "any unit."
        ),
        *(unit_section(measured, serial, distances.get(serial)) for serial in shown),
    ]


def _shown(measured: Measurements, odd: OutlierResult | str, drift: DriftResult | str) -> list[str]:
    """Serial numbers of the outlying, drifting and poor units, which have a section in the report."""
    poor = np.unique(measured.serials[measured.verdicts == "poor"]).tolist()
    return list(
        dict.fromkeys(
            [
                *(
                    []
                    if isinstance(odd, str)
                    else [u.serial for u in odd.units[: max(len(odd.odd), 5)]][:MOST_UNITS]
                ),
                *([] if isinstance(drift, str) else [u.serial for u in drift.drifting[:MOST_UNITS]]),
                *poor[:MOST_UNITS],
            ]
        )
    )


def _linked(html: str, shown: Sequence[str]) -> str:
    """The table `html`, in which the serial numbers of the units `shown` link to their sections."""
    for serial in shown:
        cell = escape(serial).replace("_", "_<wbr>")
        link = f'<a href="#unit-{escape(serial)}">{cell}</a>'
        html = html.replace(f"<th scope=row>{cell}</th>", f"<th scope=row>{link}</th>")
    return html


def _bins(measured: Measurements) -> tuple[list[str], np.ndarray]:
    """First day of each time bin, and the index of the bin of each measurement (-1 without a date)."""
    days = days_of(measured)
    known = days != ""
    bins = np.full(len(days), -1)
    if not known.any():
        return [], bins
    numbers = days[known].astype("datetime64[D]").astype(int)
    width = max(-(-(int(numbers.max() - numbers.min()) + 1) // plot.MOST_BINS), 1)
    bins[known] = (numbers - numbers.min()) // width
    first = numbers.min() + width * np.arange(bins.max() + 1)
    return np.datetime_as_string(first.astype("datetime64[D]")).tolist(), bins


def _quantiles(
    measured: Measurements, values: np.ndarray, bins: np.ndarray, count: int
) -> dict[str, np.ndarray]:
    """5 %, 50 % and 95 % quantiles of the values in each bin, for each of the four largest stations."""
    stations, sizes = np.unique(measured.stations, return_counts=True)
    found = {}
    for station in sorted(stations[np.argsort(-sizes)][:4].tolist()):
        rows = (
            (measured.stations == station) & (bins >= 0) & np.isfinite(values) & (measured.verdicts != "poor")
        )
        table_of = np.full((count, 3), np.nan)
        order = np.argsort(bins[rows], kind="stable")
        own, own_bins = values[rows][order], bins[rows][order]
        for part in np.split(np.arange(len(own)), np.flatnonzero(np.diff(own_bins)) + 1) if len(own) else ():
            table_of[own_bins[part[0]]] = np.quantile(own[part], (0.05, 0.5, 0.95))
        found[station] = table_of
    return found
