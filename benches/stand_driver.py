"""Faults of a stand with a GRBL controller: `make stand-driver`, to docs/results/stand-driver.md.

The scenarios are those of tests/fixtures/stand_scenarios.py: on the imitation in virtual time, and with
GRBL_SIM on compiled firmware in real time (several paths are separated by colons). Seeds are in the names of
the scenarios.
"""

import argparse
import os
import tempfile
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from functools import partial
from pathlib import Path

from grbl_controller import Controller
from grbl_firmware import on_firmware
from stand_scenarios import AT_REST_DEG, IN_MOVES_DEG, SCENARIOS, SILENT_S, run
from virtual_clock import VirtualClock

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs/results/stand-driver.md"
IMITATION = "imitation"
# Step of virtual time, s.
STEP_S = 0.005


def on_imitation(scenario, folder):
    clock = VirtualClock(STEP_S)

    def serve(devices):
        clock.devices += devices
        return nullcontext()

    controller = Controller(acceleration=(500.0,) * 3, **scenario.controller)
    return run(scenario, folder, clock, controller, serve)


def ran_on(where, name):
    """A row of the table, and whether a rule was broken; None if the simulator cannot do this."""
    with tempfile.TemporaryDirectory() as folder:
        scenario = SCENARIOS[name]
        if where == IMITATION:
            ran = on_imitation(scenario, Path(folder))
        else:
            ran = on_firmware(where, scenario, Path(folder))
    if ran is None:
        return f"| {name} | not possible | | | | |", False
    counts = {}
    for event in ran.events:
        counts[event["code"]] = counts.get(event["code"], 0) + 1
    said = ", ".join(code if count == 1 else f"{code} {count}" for code, count in counts.items())
    rest, move = ("" if x is None else f"{x:.2f}" for x in (ran.rest_deg, ran.move_deg))
    # The angles of a run that is not completed are not judged.
    if ran.state != "completed":
        rest = move = ""
    broken = "; ".join(ran.faults) or "none"
    row = f"| {name} | {ran.state} | {said} | {rest} | {move} | {broken} |"
    print(row, flush=True)
    return row, bool(ran.faults)


def table(where, at_once, log, names):
    """Rows of the scenarios; those in the log are not run again, and new ones are added to it."""
    title = Path(where).name
    known = {}
    if log is not None and log.exists():
        for line in log.read_text(encoding="utf-8").splitlines():
            of, scenario, broken, row = line.split("\t")
            known.update({scenario: (row, broken == "True")} if of == title else {})
    left = [scenario for scenario in names if scenario not in known]
    with ProcessPoolExecutor(at_once) as pool:
        for scenario, (row, broken) in zip(left, pool.map(partial(ran_on, where), left), strict=True):
            known[scenario] = (row, broken)
            if log is not None:
                with log.open("a", encoding="utf-8") as lines:
                    lines.write(f"{title}\t{scenario}\t{broken}\t{row}\n")
    return [known[scenario] for scenario in SCENARIOS if scenario in known]


def page(tables):
    parts = []
    for title, rows in tables.items():
        done = [row for row, _ in rows if "| not possible |" not in row]
        broken = sum(bad for _, bad in rows)
        parts.append(
            f"## {title}\n\n{len(done)} scenarios, rules broken in {broken}.\n\n"
            "| fault | ended as | events | at rest, deg | in moves, deg | rules broken |\n"
            "|---|---|---|---|---|---|\n" + "\n".join(row for row, _ in rows)
        )
    tables_text = "\n\n".join(parts)
    return f"""# Faults of a stand

This page, written by `make stand-driver`, reports what the driver `grbl` does in each of {len(SCENARIOS)}
faults. A rule is broken if the motors move after an alarm or after their position was lost, if they leave
the path of the program (and so if they pass a target), if a run ends as completed with angles that are off
by more than {AT_REST_DEG:g} deg at rest or {IN_MOVES_DEG:g} deg in moves, if a run waits longer than
{SILENT_S:g} s without a word, or if it ends in another state than expected. The program has five poses, with
moves at up to 60 deg/s. The imitation runs in virtual time. Firmware is compiled for the computer and runs
in real time. Its simulator ran on one processor, and the driver on another one with the priority of real-time
processes (`chrt -r 2`). Other programs kept both processors busy during the runs. The simulators were changed
to follow real time ([Checked on firmware](../stand.md#faults-during-a-run)).

{tables_text}
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--at-once", type=int, default=1, help="simulators of firmware at once")
    parser.add_argument("--log", type=Path, help="file of rows, with which an interrupted run is resumed")
    parser.add_argument("--firmware", nargs="*", default=[""], help="beginnings of the names run on firmware")
    given = parser.parse_args()
    tables = {"Imitation of GRBL 1.1": table(IMITATION, 2, given.log, SCENARIOS)}
    for path in filter(None, os.environ.get("GRBL_SIM", "").split(":")):
        # The name of the file tells which firmware it is.
        names = [name for name in SCENARIOS if name.startswith(tuple(given.firmware))]
        tables[f"Firmware: {Path(path).name}"] = table(path, given.at_once, given.log, names)
    PAGE.write_text(page(tables), encoding="utf-8")
    print(PAGE.relative_to(ROOT))


if __name__ == "__main__":
    main()
