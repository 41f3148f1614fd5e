"""The group of commands `imucal fleet`, for calibrations of many units in one store (an SQLite file)."""

from __future__ import annotations

from typing import Final

from imucal.cli.group import Commands, Lazy

__all__ = ["app"]

# Commands by module, each with its summary in the list of commands.
MODULES: Final = {
    "fleet_run": {
        "run": "Calibrate the recordings of many units into a store; only new recordings are processed."
    },
    "fleet_store": {
        "list": "List the units of a store, also those without a result.",
        "show": "Show all calibrations of a unit, or write its last calibration to a file.",
        "query": "Query a store by SQL (read-only).",
        "export": "Write all units of a store to a Parquet file.",
        "merge": "Merge the stores of several stations, or of the parts of a run, into one.",
    },
    "fleet_judging": {
        "drift": "Test whether parameters change with the calibration date, for one unit or for all units.",
        "spc": "Control charts by station, and shifts common to the units of a station.",
        "outliers": "Outliers among the units, with the parameter that deviates most.",
    },
    "fleet_quality": {
        "capability": "Capability indices against limits, with the measurement noise removed.",
        "grr": "Gauge study: repeatability and reproducibility of operators or stations.",
    },
    "fleet_gap": {"gap": "Search for a missing effect over all units together."},
    "fleet_pages": {
        "report": "Write one page about all units.",
        "certificate": "Write the certificate of a unit.",
    },
}
# Commands whose functions have another name, because the name of the command is a built-in of Python.
OTHER_NAMES: Final = {"list": "list_units"}

app = Commands(
    "fleet",
    {
        name: Lazy(f"imucal.cli.commands.{module}", OTHER_NAMES.get(name, name), summary)
        for module, summaries in MODULES.items()
        for name, summary in summaries.items()
    },
    help="Calibrate the recordings of many units into one store, and query the store.",
    epilog="Example: imucal fleet list units.sqlite",
)
