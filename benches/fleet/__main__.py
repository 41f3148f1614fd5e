"""A simulated fleet, its speed, its store and its kills: `make fleet`, to docs/results/fleet.md.

Parts that take long are given by --parts; the figures of the others stay as they are in the file of --log.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import imucal
from fleet.kills import UNITS, killed
from fleet.page import page
from fleet.planted import found_of, table_of
from fleet.poisoned import poisoned
from fleet.simulated import write
from fleet.speed import rates
from fleet.storage import stored

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs/results/fleet.md"
PARTS = ("planted", "speed", "storage", "poisoned", "kills")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--parts", default=",".join(PARTS))
    parser.add_argument("--units", type=int, default=2000)
    parser.add_argument("--timed", type=int, default=800, help="large recordings of each way")
    parser.add_argument("--rows", type=int, default=100_000)
    parser.add_argument(
        "--kills", type=int, nargs=3, default=(50, 20, 5), help="parents, workers, schedulers"
    )
    parser.add_argument("--log", type=Path, default=Path(tempfile.gettempdir()) / "imucal-fleet.json")
    parser.add_argument("--folder", type=Path, help="folder of the recordings; temporary if not given")
    given = parser.parse_args()
    log = json.loads(given.log.read_text()) if given.log.exists() else {}
    with tempfile.TemporaryDirectory() as temporary:
        folder = given.folder or Path(temporary)
        for part in given.parts.split(","):
            load = os.getloadavg()[0]
            started = time.monotonic()
            log[part] = globals()[f"_{part}"](given, folder / part)
            log[part] |= {"load": load, "took_s": time.monotonic() - started}
            given.log.write_text(json.dumps(log))
            print(f"{part}: {time.monotonic() - started:.0f} s", flush=True)
    if set(PARTS) <= set(log):
        PAGE.write_text(page(log, UNITS), encoding="utf-8")
        print(f"{PAGE.relative_to(ROOT)}")


def _planted(given: argparse.Namespace, folder: Path) -> dict[str, object]:
    truth = write(folder, given.units)
    store = folder / "units.sqlite"
    for old in folder.glob("units.sqlite*"):
        old.unlink()
    before = os.environ.get("PYTHONPATH")
    start_files = os.pathsep.join([str(folder / "sitecustomize"), *([before] if before else [])])
    words = [sys.executable, "-m", "imucal", "fleet", "run", str(store), str(folder / "manifest.csv")]
    runs = []
    for _ in range(2):
        done = subprocess.run(
            [*words, "--json", "-"],
            env=os.environ | {"PYTHONPATH": start_files},
            capture_output=True,
            text=True,
        )
        if not done.stdout:
            sys.exit(done.stderr)
        runs.append(json.loads(done.stdout))
    rows = found_of(imucal.Fleet(store), truth.__dict__)
    return {
        "units": given.units,
        "runs": runs,
        "table": table_of(rows),
        "false": sum(row.false for row in rows),
        "missed": sum(row.planted - row.found for row in rows),
    }


def _speed(given: argparse.Namespace, folder: Path) -> dict[str, object]:
    found = {}
    # Tiny recordings take so little time that the start of the processes would count with fewer of them.
    for name, units in (("tiny", given.timed * 5 // 2), ("large", given.timed)):
        size, ways = rates(folder, units, large=name == "large")
        found[name] = {"size": size, "units": units, "ways": ways}
    return {"rates": found, "processors": len(os.sched_getaffinity(0))}


def _storage(given: argparse.Namespace, folder: Path) -> dict[str, object]:
    return dict(stored(folder, given.rows).__dict__)


def _poisoned(given: argparse.Namespace, folder: Path) -> dict[str, object]:
    return dict(poisoned(folder, given.units // 2).__dict__)


def _kills(given: argparse.Namespace, folder: Path) -> dict[str, object]:
    parents, workers, schedulers = given.kills
    rows = killed(folder, parents=parents, workers=workers, schedulers=schedulers)
    return {"rows": [row.__dict__ for row in rows]}


if __name__ == "__main__":
    main()
