"""Traps of recordings that are not independent: altered copies as control, and recordings given twice."""

from pathlib import Path

import imucal
from changes import stand_run, truth_of
from copies import ALTERATIONS, CONTROL_SEEDS, altered, with_knock
from imucal import Program
from recordings import calibrating, same
from trap import Question, Right, Trap, good, refused


def another():
    """The same program as that of the calibrated run, with other noise."""
    program = Program.random(seed=1, moves=30, hold_s=2.0)
    return same(imucal.simulate(program, unit="paper", rate_hz=100, seed=2).recording)


COPIES = tuple(
    calibrating(
        "the control recording is a copy",
        alteration,
        same,
        # Values in other units are refused for their units first.
        refused("accel_units" if alteration == "g and deg/s" else "control_not_independent"),
        control=lambda r, alteration=alteration: altered(r, alteration, 1),
    )
    for alteration in ALTERATIONS
)

TOGETHER = tuple(
    calibrating(
        "a recording is given twice",
        alteration,
        lambda r, alteration=alteration: [same(r), altered(r, alteration, 1)],
        refused("recordings_overlap"),
    )
    for alteration in ("half of it", "every second sample", "rounded to 4 decimals", "a gain of 1.001")
)

KNOCKED = tuple(
    calibrating(
        "an independent recording of the same motion",
        f"one knock in each, seed {seed}",
        lambda r, seed=seed: with_knock(r, seed),
        good(),
        control=lambda r, seed=seed: with_knock(another(), seed + CONTROL_SEEDS),
    )
    for seed in (10, 46)
)


def prior(name: str, calibrated: str, recording: str, *right: Right, control: str | None = None) -> Trap:
    """A trap whose prior (`--calibration`) is made from the file `calibrated` and used with `recording`.

    a and b are independent recordings of one unit; copy is a under another name.
    """

    def make(folder: Path) -> Question:
        for file, seed in (("a", 1), ("b", 2), ("copy", 1)):
            imucal.write(stand_run(seed).recording, folder / f"{file}.csv")
        paths = {file: folder / f"{file}.csv" for file in ("a", "b", "copy")}
        imucal.calibrate(imucal.read(paths[calibrated])).calibration.save(folder / "prior.json")
        words = ["calibrate", str(paths[recording]), "--calibration", str(folder / "prior.json")]
        words += [] if control is None else ["--control", str(paths[control])]

        def call():
            return imucal.calibrate(
                imucal.read(paths[recording]),
                calibration=imucal.Calibration.load(folder / "prior.json"),
                control=None if control is None else imucal.read(paths[control]),
            )

        return Question(words, call, truth_of(stand_run(1)))

    return Trap("the calibration given as a prior", name, make, right)


PRIORS = (
    prior("is of the same recording", "a", "a", refused("recordings_overlap")),
    prior("is of the same recording under another name", "a", "copy", refused("recordings_overlap")),
    prior("is of the control recording", "a", "b", refused("control_not_independent"), control="copy"),
    prior("is of another recording", "a", "b", good("prior with its covariance|accelerometer_of")),
)

INDEPENDENT = (
    calibrating(
        "an independent recording of the same motion",
        "as control",
        same,
        good(),
        control=lambda r: another(),
    ),
    calibrating(
        "an independent recording of the same motion",
        "calibrated together",
        lambda r: [same(r), another()],
        good(),
    ),
)

TRAPS = (*COPIES, *TOGETHER, *PRIORS, *INDEPENDENT, *KNOCKED)
