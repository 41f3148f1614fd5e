"""`imucal fleet list`, `show`, `query`, `export` and `merge`: reading and merging stores."""

from __future__ import annotations

import json as json_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from imucal.cli.fleet_selection import CsvPath, Selection, StorePath, selection_options, store_of, write_table
from imucal.cli.options import JsonPath, UnitsOption, UnitSystem, writing_option
from imucal.cli.output import Output
from imucal.cli.parameters import argument, option
from imucal.errors import InputError

if TYPE_CHECKING:
    from imucal.fleet.fleet import Fleet

__all__ = ["export", "list_units", "merge", "query", "show"]

SCHEMA: Final = "imucal.fleet-rows/1"
# Maximum number of lines of a table in the terminal. --json and --csv contain all lines.
MOST_LINES: Final = 50
LISTED: Final = (
    *("serial", "date", "station", "operator", "batch", "role", "verdict", "code", "message", "reasons"),
    *("gravity_direction_rms_deg", "chi2_per_dof", "control_gravity_direction_rms_deg", "stored_at"),
)
SHORT: Final = ("serial", "date", "station", "verdict", "code", "gravity_direction_rms_deg", "chi2_per_dof")


@selection_options
def list_units(
    store: StorePath,
    verdict: Annotated[
        str | None,
        option("--verdict", metavar="VERDICT", help="good, incomplete, poor, failed or poisoned."),
    ] = None,
    csv: CsvPath = None,
    json: JsonPath = None,
    selection: Selection = Selection(),  # noqa: B008
) -> None:
    """List the units of a store, also those without a result.

    Example: imucal fleet list units.sqlite --verdict poor --since 2026-11-01

    Example: imucal fleet list units.sqlite --json list.json --csv list.csv
    """
    fleet = store_of(store, csv=csv, json=json)
    chosen = selection.given | ({} if verdict is None else {"verdict": verdict})
    _write(fleet, *fleet.rows(LISTED, **chosen), csv=csv, json=json, short=SHORT)


def show(
    store: StorePath,
    serial: Annotated[str, argument(metavar="SERIAL", help="Serial number of the unit.")],
    output: Annotated[Path | None, writing_option("Calibration file to write, of the last result.")] = None,
    csv: CsvPath = None,
    units: UnitsOption = UnitSystem.datasheet,
    json: JsonPath = None,
) -> None:
    """Show all calibrations of a unit, or write its last calibration to a file.

    Example: imucal fleet show units.sqlite 0042 -o 0042.json
    """
    fleet = store_of(store, output=output, csv=csv, json=json)
    names, rows = fleet.rows(LISTED, serial=serial)
    if not rows:
        raise InputError(f"{store} has no unit {serial!r}: `imucal fleet list {store}` lists the units")
    out = _write(fleet, names, rows, csv=csv, json=json, short=SHORT, units=units)
    for row in (dict(zip(names, row, strict=True)) for row in rows):
        what = row["message"] or "; ".join(json_module.loads(row["reasons"] or "[]")) or "no reasons"
        out.line(f"{row['date'] or row['stored_at']}: {row['verdict']}: {what}")
    if any(row[names.index("verdict")] not in ("failed", "poisoned") for row in rows):
        calibration = fleet.calibration(serial)
        out.parameters(calibration.parameters)
        if output is not None:
            calibration.save(output)
            out.line(f"calibration written to {output}")
    elif output is not None:
        raise InputError(f"unit {serial} has no calibration to write")


def query(
    store: StorePath,
    sql: Annotated[str, argument(metavar="SQL", help="One SELECT; the view measurements has all rows.")],
    csv: CsvPath = None,
    json: JsonPath = None,
) -> None:
    """Query a store by SQL (read-only).

    Example: imucal fleet query units.sqlite "SELECT verdict, count(*) FROM measurements GROUP BY verdict"
    """
    fleet = store_of(store, csv=csv, json=json)
    names, rows = fleet.query(sql)
    _write(fleet, names, rows, csv=csv, json=json, short=names)


@selection_options
def export(
    store: StorePath,
    parquet: Annotated[Path, option("--parquet", metavar="PATH", help="Parquet file to write.")],
    json: JsonPath = None,
    selection: Selection = Selection(),  # noqa: B008
) -> None:
    """Write all units of a store to a Parquet file.

    Example: imucal fleet export units.sqlite --parquet units.parquet
    """
    fleet = store_of(store, parquet=parquet, json=json)
    rows = fleet.write_parquet(parquet, **selection.given)
    out = Output(json)
    out.document({"schema": "imucal.fleet-export/1", "verdict": None, "rows": rows, "output": str(parquet)})
    out.line(f"{parquet}: {rows} rows")


def merge(
    store: Annotated[Path, argument(metavar="STORE", help="Store to make, or to add to.")],
    others: Annotated[list[Path], argument(metavar="OTHER...", help="Stores of stations or parts.")],
    json: JsonPath = None,
) -> None:
    """Merge the stores of several stations, or of the parts of a run, into one.

    A row that is in several stores is copied once. The other stores are not changed.

    Example: imucal fleet merge all.sqlite units.sqlite
    """
    fleet = store_of(store, json=json)
    taken = fleet.merge(*others)
    counts = fleet.count()
    out = Output(json)
    document = {"schema": "imucal.fleet-merge/1", "verdict": None, "taken": taken, "verdicts": counts}
    out.document(document)
    out.line(f"{store}: {taken} rows taken, {sum(counts.values())} units now")


def _write(
    fleet: Fleet,
    names: list[str],
    rows: list[tuple[Any, ...]],
    *,
    csv: Path | None,
    json: str | None,
    short: tuple[str, ...] | list[str],
    units: UnitSystem = UnitSystem.datasheet,
) -> Output:
    """Write rows as CSV and as JSON, and print the columns `short` as a table."""
    readable = [tuple(_plain(value) for value in row) for row in rows]
    write_table(csv, names, readable)
    out = Output(json, units)
    if json is not None:
        items = [dict(zip(names, row, strict=True)) for row in readable]
        out.document({"schema": SCHEMA, "verdict": None, "store": str(fleet.path), "rows": items})
    places = [names.index(name) for name in short]
    lines = [["-" if row[place] is None else _cell(row[place]) for place in places] for row in readable]
    out.table([names[place] for place in places], lines[:MOST_LINES])
    if len(lines) > MOST_LINES:
        out.line(f"... {len(lines) - MOST_LINES} more of {len(lines)}; --csv or --json writes all")
    return out


def _plain(value: Any) -> Any:
    """A value of the store for text output. An array, stored as bytes, is replaced by its number of bytes."""
    return f"{len(value)} bytes" if isinstance(value, bytes) else value


def _cell(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
