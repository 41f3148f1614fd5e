"""What the commands of a fleet find of the faults that are planted in a simulated one.

    PYTHONPATH=benches python -m fleet.planted STORE FOLDER

STORE is the store of `imucal fleet run` over the manifest of `fleet.simulated` in FOLDER.
"""

import argparse
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import imucal

__all__ = ["Found", "found_of", "table_of"]


@dataclass(frozen=True)
class Found:
    """A kind of planted fault.

    planted, found, false   numbers of planted ones, of those that are found, and of false alarms
    detail                  what is found of it, in words
    """

    what: str
    command: str
    planted: int
    found: int
    false: int
    detail: str


def found_of(fleet: imucal.Fleet, truth: Mapping[str, Any]) -> list[Found]:
    """One row for each kind of planted fault."""
    drift = fleet.drift()
    drifting = {unit.serial: unit.parameters for unit in drift.drifting}
    right = [
        s for s in truth["drifting"] if s in drifting and drifting[s][0].name == truth["drift_parameter"]
    ]
    slopes = [drifting[serial][0].slope for serial in right]
    spc = fleet.spc()
    shifted = (truth["shifted"]["station"], truth["shifted"]["date"])
    false = sorted(set(drifting) - set(truth["drifting"]))
    on_that_day = sum(_was_measured(fleet, serial, *shifted) for serial in false)
    of_day = [shift for shift in spc.shifts if (shift.station, shift.day) == shifted]
    odd = {unit.serial: unit.decides[0] for unit in fleet.outliers().odd}
    decided = [serial for serial, name in truth["odd"].items() if serial in odd and odd[serial].name == name]
    rows = [
        Found(
            "drifting units",
            "drift",
            len(truth["drifting"]),
            len(right),
            len(false),
            f"{truth['drift_parameter']} is the most significant; mean slope "
            f"{1e3 * sum(slopes) / max(len(slopes), 1):.2f} mm/s² per month, planted "
            f"{1e3 * truth['drift_per_month']:.2f}; false alarms of units that were measured on the day of "
            f"the shifted station: {on_that_day}",
        ),
        Found(
            "station shifted on a day",
            "spc",
            1,
            int(shifted in spc.shifted),
            len(set(spc.shifted) - {shifted}),
            "; ".join(f"{s.name} {s.shift * 1e3:+.2f} ± {s.std * 1e3:.2f} mrad" for s in of_day)
            + f"; planted ±{truth['shifted']['deg'] * 17.4533:.2f} mrad",
        ),
        Found(
            "odd units",
            "outliers",
            len(truth["odd"]),
            len(set(odd) & set(truth["odd"])),
            len(set(odd) - set(truth["odd"])),
            f"the planted parameter decides in {len(decided)} of {len(truth['odd'])}",
        ),
    ]
    return [*rows, *_bad(fleet, truth)]


def _bad(fleet: imucal.Fleet, truth: Mapping[str, Any]) -> list[Found]:
    """Recordings without a result or with a poor verdict, and poisoned files."""
    _, failures = fleet.query(
        "SELECT serial, verdict, code FROM measurements WHERE verdict IN ('poor', 'failed', 'poisoned')"
    )
    verdicts = {serial: verdict for serial, verdict, _ in failures}
    codes = Counter(code or verdict for _, verdict, code in failures if verdict != "poisoned")
    poisoned = {serial for serial, verdict in verdicts.items() if verdict == "poisoned"}
    bad = {serial for serial, kind in truth["bad"].items() if kind != "poisoned"}
    return [
        Found(
            "bad recordings",
            "list",
            len(bad),
            len(bad & set(verdicts)),
            len(set(verdicts) - set(truth["bad"])),
            ", ".join(f"{code} {count}" for code, count in sorted(codes.items())),
        ),
        Found(
            "poisoned files",
            "list",
            len(truth["poisoned"]),
            len(poisoned & set(truth["poisoned"])),
            len(poisoned - set(truth["poisoned"])),
            "each is a row of its own, and all other units are done",
        ),
    ]


def _was_measured(fleet: imucal.Fleet, serial: str, station: str, day: str) -> bool:
    """Whether a unit was measured on this day on this station."""
    measured = fleet.measurements(serial=serial, station=station)
    return any(str(date).startswith(day) for date in measured.dates)


def table_of(rows: Sequence[Found]) -> str:
    """The rows as a table in Markdown."""
    lines = ["| planted | command | planted | found | false alarms | detail |", "|---|---|---|---|---|---|"]
    lines += [
        f"| {r.what} | `{r.command}` | {r.planted} | {r.found} | {r.false} | {r.detail} |" for r in rows
    ]
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("store", type=Path)
    parser.add_argument("folder", type=Path)
    given = parser.parse_args()
    truth = json.loads((given.folder / "truth.json").read_text(encoding="utf-8"))
    print(table_of(found_of(imucal.Fleet(given.store), truth)))


if __name__ == "__main__":
    main()
