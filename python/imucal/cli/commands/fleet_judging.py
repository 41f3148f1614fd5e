"""`imucal fleet drift`, `spc` and `outliers`: changes over time, shifts of stations, and outlying units."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

from imucal.cli.fleet_selection import CsvPath, Selection, StorePath, selection_options, store_of, write_table
from imucal.cli.options import JsonPath
from imucal.cli.output import Output
from imucal.cli.parameters import argument, option
from imucal.errors import InputError

if TYPE_CHECKING:
    from imucal.fleet.statistics.shifts import Shift

__all__ = ["drift", "outliers", "spc"]

# Maximum number of lines of a table in the terminal. --json and --csv contain all lines.
MOST_LINES = 30


@selection_options
def drift(
    store: StorePath,
    serial: Annotated[str | None, argument(metavar="[SERIAL]", help="Serial number of one unit.")] = None,
    all_units: Annotated[bool, option("--all", help="Test all units; show which parameters age.")] = False,
    csv: CsvPath = None,
    json: JsonPath = None,
    selection: Selection = Selection(),  # noqa: B008
) -> None:
    """Test whether parameters change with the calibration date, for one unit or for all units.

    A unit is reported if its p-value is significant among the p-values of all units, with a false discovery
    rate of 0.2 %. Shifts that all units of a station have in common on a day are subtracted first.

    Example: imucal fleet drift units.sqlite --all --since 2026-01-01 --csv drift.csv
    """
    fleet = store_of(store, csv=csv, json=json)
    if (serial is None) != all_units:
        raise InputError("give the serial number of one unit, or --all")
    result = fleet.drift(serial, **selection.given)
    units = result.units if serial is not None else result.drifting
    headings = (
        "serial number",
        "parameter",
        "unit",
        "dates",
        "change",
        "slope/month",
        "1 sigma",
        "q",
        "kind",
    )
    rows = [
        (unit.serial, p.name, p.unit, unit.dates, p.change, p.slope, p.slope_std, unit.q_value, _kind(p))
        for unit in units
        for p in unit.parameters
    ]
    write_table(csv, headings, rows)
    out = Output(json)
    out.document(result.to_dict() | _verdict(bool(result.drifting)))
    _table(out, headings, rows)
    if serial is not None:
        unit = result.units[0]
        joint = "" if unit.chi2 is None else f", chi2 {unit.chi2:.4g} with {unit.dof} degrees of freedom"
        out.line(
            f"{unit.serial}: {unit.dates} dates in {unit.days:.0f} days{joint}; false discovery rate among "
            f"all units {unit.q_value:.2g}"
        )
    else:
        for row in result.ageing:
            if row.is_significant:
                group = "all units" if row.by == "all" else f"{row.by} {row.group}"
                out.line(
                    f"ages: {row.name}, {group}: {row.slope:.3g} +- {row.std:.2g}{_unit(row.unit)} per "
                    f"month, over {row.units} units"
                )
        _shifts(out, result.shifts)
        out.line(f"{result.single} units have one date, {result.poor} poor calibrations are left out")
    count = len(result.drifting)
    out.verdict(*_ending(count, f"{count} of {len(result.units)} units drift"))


@selection_options
def spc(
    store: StorePath,
    csv: CsvPath = None,
    json: JsonPath = None,
    selection: Selection = Selection(),  # noqa: B008
) -> None:
    """Draw control charts of each station, and find shifts common to the units of a station.

    The measurement noise of each unit is subtracted from the moving ranges. The values of a chart are tested
    by the rules of the Western Electric handbook and by a moving average (EWMA). The verdict depends only on
    shifts of a station, or of a station on one day, that are significant over all charts together.

    Example: imucal fleet spc units.sqlite --station north --csv signals.csv
    """
    fleet = store_of(store, csv=csv, json=json)
    result = fleet.spc(**selection.given)
    write_table(
        csv,
        ("station", "parameter", "rule", "serial number", "date", "z"),
        [(c.station, c.name, s.rule, s.serial, s.date, s.z) for c in result.charts for s in c.signals],
    )
    out = Output(json)
    out.document(result.to_dict() | _verdict(bool(result.shifts)))
    headings = ("station", "parameter", "units", "centre", "spread", "noise", "signals", "unit")
    rows = [
        (c.station or "-", c.name, c.units, c.centre, c.spread, c.noise, len(c.signals), c.unit)
        for c in result.charts
    ]
    _table(out, headings, rows)
    _shifts(out, result.shifts)
    count = len(result.shifted)
    out.verdict(*_ending(count, f"{count} shift{'' if count == 1 else 's'} of a station"))


@selection_options
def outliers(
    store: StorePath,
    csv: CsvPath = None,
    json: JsonPath = None,
    selection: Selection = Selection(),  # noqa: B008
) -> None:
    """Find odd units by their robust distance from all others, and name the parameter that deviates most.

    The distance is computed from all parameters and figures of merit, and from the covariance of each unit's
    measurement. A shift that all units of a station have in common on a day belongs to the station and is
    subtracted first.

    Example: imucal fleet outliers units.sqlite --batch 2026-11 --csv odd.csv
    """
    fleet = store_of(store, csv=csv, json=json)
    result = fleet.outliers(**selection.given)
    headings = (
        "serial number",
        "station",
        "date",
        "distance",
        "q",
        "decides",
        "z",
        "value",
        "expected",
        "unit",
    )
    rows = [
        (u.serial, u.station, u.date, u.distance, u.q_value, d.name, d.z, d.value, d.expected, d.unit)
        for u in result.units
        for d in u.decides[:1]
    ]
    write_table(csv, headings, rows)
    out = Output(json)
    out.document(result.to_dict() | _verdict(bool(result.odd)))
    _table(out, headings, rows[: max(len(result.odd), 5)])
    _shifts(out, result.shifts)
    out.line(f"{result.poor} poor calibrations are left out")
    count = len(result.odd)
    out.verdict(*_ending(count, f"{count} of {len(result.units)} units are odd"))


def _unit(unit: str) -> str:
    return "" if unit == "1" else f" {unit}"


def _kind(parameter: Any) -> str:
    return "slope" if parameter.step is None else f"step before {parameter.step_date}"


def _verdict(has_alarm: bool) -> dict[str, str]:
    return {"verdict": "poor" if has_alarm else "good"}


def _ending(count: int, words: str) -> tuple[str, list[str]]:
    return ("poor", [words]) if count else ("good", [words])


def _shifts(out: Output, shifts: tuple[Shift, ...]) -> None:
    for shift in shifts[:MOST_LINES]:
        day = f" on {shift.day}" if shift.day else ""
        out.line(
            f"station {shift.station or '-'}{day} is shifted: {shift.name} by {shift.shift:.3g} +- "
            f"{shift.std:.2g}{_unit(shift.unit)} over {shift.units} calibrations"
        )


def _table(out: Output, headings: tuple[str, ...], rows: list[tuple[Any, ...]]) -> None:
    if rows:
        out.table(headings, [[_cell(value) for value in row] for row in rows[:MOST_LINES]])
    if len(rows) > MOST_LINES:
        out.line(f"and {len(rows) - MOST_LINES} more lines, see --csv or --json")


def _cell(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
