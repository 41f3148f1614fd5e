"""Traps and clean runs: `make traps`, to docs/results/traps.md.

Every row of the table of traps (tests/traps) is asked by command. Clean runs in five conditions must be good:
a tool that refuses everything would pass the first table. Two other programs are asked the same rows.
"""

import os

# One thread per process, because two processes share the machine.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS"):
    os.environ[variable] = "1"

import argparse
import dataclasses
import subprocess
import tempfile
from collections import Counter, defaultdict
from functools import partial
from pathlib import Path

import numpy as np
from rich.progress import track

import comparison
import imucal
from changes import truth_of
from engine import add_arguments, engine_of
from imucal.rig.motion import Tumble
from imucal.rig.unit import Unit
from rows import TRAPS
from sections import write_section
from trap import WITHIN_SIGMAS, answer_by_command
from trap_peers import MOST_FORCE_MG, MOST_RATE_DPS, PEERS, outcome_of

ROOT = Path(__file__).parent.parent
PAGE = ROOT / "docs/results/traps.md"
OUTCOMES = ("refused", "poor", "incomplete", "good", "wrong")
PEER_OUTCOMES = ("right", "wrong", "refused", "not readable")
# Runs of each condition, and the first of their seeds.
CLEAN_RUNS = 100
FIRST_SEED = 1000


def unit(profile, seed):
    """A unit drawn from a datasheet's tolerances that has biases, gains, misalignments and noise only."""
    return dataclasses.replace(Unit.random(profile, seed), effects=())


def stand(seed, profile="bmi088", **options):
    program = imucal.Program.random(seed=seed, moves=30, hold_s=2.0)
    return imucal.simulate(program, seed=seed, unit=unit(profile, seed), **{"rate_hz": 200.0, **options})


def hand(seed):
    """With the tremor of a hand, and poses in a cube of 20 mm."""
    motion = Tumble(seed=seed, poses=24, hold_s=3.0, tremor_deg=0.1, translation_mm=20.0)
    return imucal.simulate(motion, seed=seed, unit=unit("bmi088", seed), rate_hz=200.0)


CONDITIONS = {
    "on the stand, BMI088 at 200 Hz": stand,
    "by hand, BMI088 at 200 Hz": hand,
    "on the stand at 50 Hz": partial(stand, rate_hz=50.0),
    "coarse counts: MPU-6050": partial(stand, profile="mpu6050"),
    "temperature cycle of 30 degC": partial(stand, temperature="cycle:10:40:120"),
}


def asked(number):
    """Outcome of a row by its number in the table, whether it is right, and the outcomes of the peers."""
    trap = TRAPS[number]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        question = trap.make(folder)
        by_peer = {peer: outcome_of(peer, trap, question) for peer in PEERS}
        observed = answer_by_command(question, folder)
    return observed.outcome, observed.is_right(trap), by_peer


def trap_table(engine):
    by_kind = defaultdict(Counter)
    by_program = {"imucal": Counter(), **{peer: Counter() for peer in PEERS}}
    wrong = []
    answers = engine.map(asked, range(len(TRAPS)), name="rows")
    for trap, (outcome, is_right, by_peer) in zip(TRAPS, track(answers, "Traps", len(TRAPS)), strict=True):
        refused = outcome == "refused" and not is_right
        own = "refused" if refused else "right" if is_right else "wrong"
        for program, found in {"imucal": own, **by_peer}.items():
            by_program[program][found] += 1
        by_kind[trap.kind][outcome] += 1
        if not is_right:
            wrong.append(f"{trap.kind}, {trap.name}: {outcome}, not {' or '.join(map(str, trap.right))}")
    rows = [
        f"| {kind} | {sum(counts.values())} | "
        + " | ".join(str(counts[name] or "") for name in OUTCOMES)
        + " |"
        for kind, counts in sorted(by_kind.items())
    ]
    total = sum(by_kind.values(), Counter())
    rows.append(f"| **all** | {len(TRAPS)} | " + " | ".join(str(total[name]) for name in OUTCOMES) + " |")
    table = "\n".join(["| kind | rows | " + " | ".join(OUTCOMES) + " |", "|---|" + "---:|" * 6, *rows])
    peer_rows = [
        f"| {peer} | " + " | ".join(str(counts[name]) for name in PEER_OUTCOMES) + " |"
        for peer, counts in by_program.items()
    ]
    head = "| program | " + " | ".join(PEER_OUTCOMES) + " |"
    return table, wrong, "\n".join([head, "|---|" + "---:|" * len(PEER_OUTCOMES), *peer_rows])


def clean(condition, seed):
    """Verdict of a clean run, and the errors of its parameters in standard deviations."""
    run = CONDITIONS[condition](seed)
    try:
        result = imucal.calibrate(run.recording)
    except imucal.ImucalError:
        return "refused", []
    truth = truth_of(run)
    # With a bias instability the bias is not constant, and its true mean is not that of the unit.
    parameters = [p for p in result.parameters if p.std and not p.name.startswith("gyro_bias")]
    return str(result.verdict), [abs(p.value - truth[p.name]) / p.std for p in parameters]


def calls():
    """The function of each condition without a trap, which takes a seed."""
    return {condition: partial(clean, condition) for condition in CONDITIONS}


def clean_table(engine):
    rows = []
    for condition in CONDITIONS:
        seeds = range(FIRST_SEED, FIRST_SEED + CLEAN_RUNS)
        runs = engine.map(calls()[condition], seeds, name=condition)
        found = list(track(runs, condition, total=CLEAN_RUNS))
        verdicts = Counter(verdict for verdict, _ in found)
        errors = np.array([error for _, errors in found for error in errors])
        shown = " | ".join(str(verdicts[name]) for name in ("good", "incomplete", "poor", "refused"))
        inside = 100.0 * np.mean(errors < 1.96)
        rows.append(f"| {condition} | {CLEAN_RUNS} | {shown} | {inside:.1f} % | {errors.max():.1f} |")
        print(rows[-1], flush=True)
    head = "| condition | runs | good | incomplete | poor | refused | within 1.96 sigma | worst, sigma |"
    return "\n".join([head, "|---|" + "---:|" * 7, *rows])


def main():
    arguments = argparse.ArgumentParser(description=__doc__)
    add_arguments(arguments)
    given = arguments.parse_args()
    # Not the folder of the workspace, so that its build is not touched.
    os.environ["CARGO_TARGET_DIR"] = str(ROOT / "target" / "peers")
    subprocess.run(["cargo", "build", "--quiet", "--release"], cwd=comparison.PEER, check=True)
    with engine_of(given, "traps") as engine:
        write_section(
            PAGE,
            "Traps",
            "Clean runs",
            f"Seeds {FIRST_SEED} to {FIRST_SEED + CLEAN_RUNS - 1} of each condition; errors of all "
            f"parameters but the biases of the gyroscope.\n\n{clean_table(engine)}",
        )
        table, wrong, peers = trap_table(engine)
    told = "\n".join(f"- {row}" for row in wrong) or "Every row has an outcome that is right."
    write_section(
        PAGE,
        "Traps",
        "Rows by kind and outcome",
        f"{len(TRAPS)} inputs that easily give a wrong result. Wrong: a usable result with a parameter more "
        f"than {WITHIN_SIGMAS:g} stated standard deviations from the truth.\n\n{table}\n\n{told}",
    )
    write_section(
        PAGE,
        "Traps",
        "Other programs",
        f"""The same {len(TRAPS)} rows. Right: one of the right outcomes of the row; a result counts as
right only if all its parameters are within {WITHIN_SIGMAS:g} of its own stated standard deviations. Wrong:
any other result. Refused: no result where one is right. Not readable: the row asks for something else than a
calibration of one recording, or the program cannot read the file.

{peers}

The SciPy program has the model of imucal without its checks, and gets the columns of the file as arrays.
imu-calib gets them, too, if they are in SI units, g or deg/s. It states no standard deviations, so its
results are right up to an error of {MOST_FORCE_MG:g} mg at rest and of {MOST_RATE_DPS:g} deg/s at 100 deg/s
(rms per axis).""",
    )
    engine.publish(PAGE)


if __name__ == "__main__":
    main()
