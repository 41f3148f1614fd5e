"""Verdicts on a production line for good units and hidden faults: `make stand`, to docs/results/stand.md.

Every unit is processed by the installed command: run, control run, verdict, export. Unit, stand, programs,
noise, and the size and time of the fault are drawn for each seed.
"""

import argparse
import json
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from rich.progress import track

from answers import KeptAnswer, commit, plain, publish
from imucal.stand.faults import FAULTS, PLAY_DEG, RANGE_SHARE, SLIP_DEG

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs/results/stand.md"
COMMAND = Path(sys.executable).with_name("imucal")
GOOD = "none"
SPEED = 100.0
FIRST_SEED = 101
# Reason that must be reported for each hidden fault.
NAMES = {"slip": "mount_slip", "loose-mount": "loose_mount", "clipping": "clipping", "dead-axis": "dead_axis"}
SIZES = {
    GOOD: "",
    "slip": f"{SLIP_DEG[0]:g} to {SLIP_DEG[1]:g} deg about a random axis, once in each run",
    "loose-mount": f"{PLAY_DEG:g} deg (1 sigma) about each motor's axis, drawn again for every move",
    "clipping": f"range of the gyroscope at {RANGE_SHARE[0]:g} to {RANGE_SHARE[1]:g} of the highest rate",
    "dead-axis": "one of six, constant or with noise only",
}


@dataclass(frozen=True)
class Trial:
    """One unit on the line."""

    exit_code: int
    verdict: str
    reasons: tuple[str, ...]
    exported: bool


def trial(case: tuple[str, int], speed: float) -> Trial:
    fault, seed = case
    with tempfile.TemporaryDirectory() as folder:
        given = ["--driver", "simulated", "--speed", str(speed), "--unit", f"random:bmi088:{seed}"]
        given += ["--stand", f"cheap:{seed}", "--seed", str(seed), "--control-seed", str(1000 + seed)]
        given += ["--fault-seed", str(seed), "--export", "c-header", "-o", folder, "--json", "-"]
        if fault != GOOD:
            given += ["--fault", fault]
        done = subprocess.run([COMMAND, "stand", "calibrate", *given], capture_output=True, text=True)
        if not done.stdout:
            raise RuntimeError(f"{fault}, seed {seed}: {done.stderr}")
        document = json.loads(done.stdout)
        exported = [Path(item["output"]).is_file() for item in document["exports"]]
    reasons = tuple(dict.fromkeys(reason["code"] for reason in document["reasons"]))
    return Trial(done.returncode, document["verdict"], reasons, bool(exported) and all(exported))


def row(fault: str, trials: list[Trial]) -> str:
    passed = sum(t.exit_code == 0 and t.verdict == "passed" and t.exported for t in trials)
    failed = sum(t.exit_code == 2 and t.verdict == "failed" for t in trials)
    named = sum(t.reasons[:1] == (NAMES.get(fault),) for t in trials)
    others = Counter(reason for t in trials for reason in t.reasons if reason != NAMES.get(fault))
    besides = ", ".join(f"{reason} {count}" for reason, count in sorted(others.items())) or "nothing"
    first = str(named) if fault in NAMES else "-"
    return f"| {fault} | {SIZES[fault]} | {len(trials)} | {passed} | {failed} | {first} | {besides} |"


def page(found: dict[str, list[Trial]], seeds: int, speed: float) -> str:
    rows = "\n".join(row(fault, trials) for fault, trials in found.items())
    return f"""# Production line

This page, written by `make stand`, reports the verdicts of `imucal stand calibrate` for good units and
for hidden faults on a simulated stand. Each row has {seeds} seeds, with `--speed {speed:g}`. The units
are drawn from the tolerances of the BMI088 datasheet. Each is on a different cheap stand with errors of
mount, tilt, axis angles, flexure and vibration, and with 12-bit encoders with eccentricity, backlash and
a time offset. The sampling rate is 200 Hz, and program and control program are random. The faults are
known to the simulation only. [Faults of a stand](stand-driver.md) reports faults of the controller and of
its connection.

| hidden fault | size | units | passed, exported | failed | named first | named besides |
|---|---|---|---|---|---|---|
{rows}

A slip appears as a step between the attitude of the unit at rest and the angles of the motors, and play
as a scatter of their difference from rest to rest. Neither can be detected without encoders or a
controller that reports its angles. The checks of the recording refuse a saturated sensor and an axis with
a constant value. An axis that contains only noise is detected by its lack of response to the motion.
"""


def calls() -> dict[str, Callable[[tuple[str, int]], Trial]]:
    """The function of all units, which takes a fault and a seed."""
    return {"units": partial(trial, speed=SPEED)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--speed", type=float, default=SPEED)
    # Several runs at once, because a run in real time mostly waits.
    parser.add_argument("--at-once", type=int, default=4)
    given = parser.parse_args()
    began_at = commit()
    seeds = range(FIRST_SEED, FIRST_SEED + given.seeds)
    cases = [(fault, seed) for fault in (GOOD, *FAULTS) for seed in seeds]
    with ThreadPoolExecutor(given.at_once) as pool:
        done = pool.map(partial(trial, speed=given.speed), cases)
        trials = list(track(done, "units", total=len(cases)))
    found: dict[str, list[Trial]] = {}
    for (fault, _), one in zip(cases, trials, strict=True):
        found.setdefault(fault, []).append(one)
    PAGE.write_text(page(found, given.seeds, given.speed), encoding="utf-8")
    rows = [KeptAnswer("units", plain(case), plain(one)) for case, one in zip(cases, trials, strict=True)]
    publish(PAGE, "stand", rows, began_at)
    print(f"{PAGE.relative_to(ROOT)}: {len(trials)} units")


if __name__ == "__main__":
    main()
