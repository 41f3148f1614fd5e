"""Monte Carlo runs of a box on its faces: `make faces`, to docs/results/faces.md.

The unit rests on the six faces of a box alone, with turns of 90 deg between them. The rests do not determine
the misalignment of the accelerometer; rests and moves together do. On a stand the faces and turns are exact.
By hand, on a table, each pose deviates by some degrees, all axes turn at once, and times vary. Half of the
runs follow the routine of `imucal plan faces` from its start, the others turn about a random axis each time.
Every run has another unit, with misalignments of several degrees.
"""

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np

import imucal
from accuracy.band import binomial, root_mean_square_error
from accuracy.bound import PARAMETERS, Noise, bound
from accuracy.figures import LEVELS, Figures
from accuracy.trial import Estimate, estimate
from engine import add_arguments, engine_of

REPORT = Path(__file__).resolve().parent.parent / "docs" / "results" / "faces.md"
RUNS = 500
RATE_HZ = 100.0
# Spread of the units: one standard deviation of each scale error, misalignment in rad, and bias.
SCALE, MISALIGNMENT_RAD, ACCEL_BIAS_MPS2, GYRO_BIAS_RADPS = 0.03, 0.03, 0.3, 0.02
# By hand: one standard deviation of each angle of a pose, deg, and the range of the times, s.
POSE_DEG, MOVE_S, HOLD_S = 2.0, (1.0, 2.5), (2.5, 4.0)
# A run counts as determined by the limits of `imucal inspect`: if rests have errors of half a mg and moves
# have errors of 0.2 deg, every parameter has a standard deviation below this share of its size.
DETERMINED = 0.01
REST_ERROR_MPS2, MOVE_ERROR_RAD = 0.005, 0.0035
GRAVITY_MPS2 = 9.80665


@dataclass(frozen=True)
class Scene:
    """One condition: the number of rests, and whether the faces are imperfect."""

    rests: int
    by_hand: bool

    @property
    def name(self) -> str:
        return f"{self.rests} rests, {'by hand' if self.by_hand else 'stand'}"

    def run(self, seed: int) -> imucal.Simulation:
        random = np.random.default_rng((seed, self.rests, self.by_hand))
        turns = self._turns(random, seed)
        steps = self._by_hand(random, turns) if self.by_hand else self._exact(turns)
        unit = random_unit(random)
        return imucal.simulate(imucal.Program(tuple(steps)), seed=seed, unit=unit, rate_hz=RATE_HZ)

    def _turns(self, random: np.random.Generator, seed: int) -> np.ndarray:
        """Turns of the motors, deg: the routine for odd seeds, random turns of one motor for even ones."""
        if seed % 2:
            rounds = imucal.Program.faces(rounds=2).steps
            return np.array([step.turn_deg for step in rounds[1 : self.rests]])
        turns = np.zeros((self.rests - 1, 3))
        turns[np.arange(len(turns)), random.integers(3, size=len(turns))] = random.choice(
            [-90.0, 90.0], len(turns)
        )
        return turns

    def _exact(self, turns: np.ndarray) -> list[imucal.Step]:
        still = imucal.Step((0.0, 0.0, 0.0), 0.0, 3.0)
        return [still, *(imucal.Step(tuple(turn.tolist()), 1.5, 3.0) for turn in turns)]

    def _by_hand(self, random: np.random.Generator, turns: np.ndarray) -> list[imucal.Step]:
        poses = np.vstack([np.zeros(3), np.cumsum(turns, axis=0)])
        poses[1:] += random.normal(0.0, POSE_DEG, poses[1:].shape)
        moved = np.diff(np.vstack([np.zeros(3), poses]), axis=0)
        steps = []
        for turn in moved:
            move_s, hold_s = random.uniform(*MOVE_S), random.uniform(*HOLD_S)
            steps.append(imucal.Step(tuple(turn.tolist()), move_s, hold_s))
        return steps


def random_unit(random: np.random.Generator) -> imucal.Unit:
    """The noise of the paper's unit with random errors of both sensors."""
    paper = imucal.Unit.named("paper")
    skew = random.normal(0.0, MISALIGNMENT_RAD, (3, 3)) / np.sqrt(2.0)
    scale = np.diag(random.normal(1.0, SCALE, 3))
    accelerometer = scale + np.triu(skew, 1) + np.triu(skew, 1).T
    gyroscope = np.diag(random.normal(1.0, SCALE, 3)) + MISALIGNMENT_RAD * (1 - np.eye(3)) * random.normal(
        size=(3, 3)
    )
    return replace(
        paper,
        accelerometer=replace(
            paper.accelerometer, sensitivity=accelerometer, bias=random.normal(0.0, ACCEL_BIAS_MPS2, 3)
        ),
        gyroscope=replace(
            paper.gyroscope, sensitivity=gyroscope, bias=random.normal(0.0, GYRO_BIAS_RADPS, 3)
        ),
    )


@dataclass(frozen=True)
class Trial:
    """One run: the estimate, or None with the reason if it was refused, and the Cramér-Rao bound.

    share  largest standard deviation that errors of a real unit would cause, over its limit
    """

    seed: int
    estimate: Estimate | None
    reason: str
    verdict: str
    bound: np.ndarray
    share: float

    @property
    def is_determined(self) -> bool:
        """Whether the run determines all parameters by the limits of `imucal inspect`."""
        return self.share < 1.0


def _bound(truth: imucal.Truth, noise: Noise) -> np.ndarray:
    """Standard deviations at the Cramér-Rao bound; infinite if the run does not determine all parameters."""
    try:
        with np.errstate(invalid="ignore"):
            return np.sqrt(np.diag(bound(truth, noise)))
    except np.linalg.LinAlgError:
        return np.full(PARAMETERS, np.inf)


def share_of_limit(truth: imucal.Truth) -> float:
    """Largest standard deviation that errors of a real unit would cause, over the limit of its parameter."""
    held_s = np.mean([end - start for start, end in truth.rests])
    moved_s = np.mean([after[0] - before[1] for before, after in pairwise(truth.rests)])
    errors = Noise(REST_ERROR_MPS2 * np.sqrt(held_s * RATE_HZ), MOVE_ERROR_RAD * np.sqrt(RATE_HZ / moved_s))
    sizes = np.r_[np.full(3, GRAVITY_MPS2), np.ones(PARAMETERS - 3)]
    return float(np.max(_bound(truth, errors) / (DETERMINED * sizes)))


def trial(scene: Scene, seed: int) -> Trial:
    run = scene.run(seed)
    lowest = _bound(run.truth, Noise.of(run.truth.setup.unit, RATE_HZ))
    true = np.array([parameter.value for parameter in run.truth.calibration.parameters])
    try:
        result = imucal.calibrate(run.recording)
    except imucal.ImucalError as error:
        return Trial(seed, None, str(error), "refused", lowest, share_of_limit(run.truth))
    return Trial(seed, estimate(result, true), "", result.verdict, lowest, share_of_limit(run.truth))


@dataclass(frozen=True)
class SceneFigures:
    """All runs of a scene."""

    scene: Scene
    trials: Sequence[Trial]

    @property
    def determined(self) -> list[Trial]:
        return [trial for trial in self.trials if trial.is_determined]

    @property
    def refused(self) -> list[Trial]:
        return [trial for trial in self.determined if trial.estimate is None]

    @property
    def figures(self) -> Figures:
        pairs = [(trial.estimate, trial.bound) for trial in self.trials if trial.estimate is not None]
        return Figures([found for found, _ in pairs], np.array([lowest for _, lowest in pairs]))

    def row(self) -> str:
        figures = self.figures
        inside = figures.inside["95 %"]
        # Random turns differ from run to run, so errors are compared with the bound of their own run.
        ratio = np.sqrt(np.mean((figures.error / self._bounds) ** 2))
        good = sum(trial.verdict == "good" for trial in self.trials)
        return (
            f"| {self.scene.name} | {len(self.trials)} | {len(self.determined)} | {len(self.refused)} "
            f"| {good} | {inside.mean():.1%} | {inside.min():.1%} to {inside.max():.1%} | {ratio:.3f} "
            f"| {figures.ratio.max():.3f} |"
        )

    @property
    def _bounds(self) -> np.ndarray:
        return np.array([trial.bound for trial in self.trials if trial.estimate is not None])


def page(scenes: Sequence[SceneFigures]) -> str:
    runs = min(len(scene.trials) for scene in scenes)
    low, high = binomial(runs, LEVELS["95 %"][1], 0.01)
    rows = "\n".join(scene.row() for scene in scenes)
    refused = [_refusal(scene.scene, trial) for scene in scenes for trial in scene.refused]
    return f"""# Faces only

Written by `make faces`: seeds 1 to {runs} for each condition.

{__doc__.split(chr(10) * 2, 1)[1].strip()}

* determined: runs that determine all 21 parameters by the limits of `imucal inspect`, computed from the
  truth: if rests had errors of half a mg and moves errors of 0.2 deg, each standard deviation would be
  below {DETERMINED:.0%} of the size of the parameter.
* refused: runs among these that `imucal calibrate` refuses. The limits above are computed without the
  estimator, so a run close to them may be judged differently. Each such run is listed below the table.
* within 95 %: share of the stated 95 % intervals that contain the truth, over all parameters, and the
  smallest and the largest share of one parameter. For a perfect estimator 99 % of the shares of one
  parameter are between {low:.1%} and {high:.1%}.
* RMSE / bound: root mean square error over the Cramér-Rao bound, of all parameters, each run relative to
  its own bound, and the largest of one parameter, in which the runs with the largest bounds dominate. One
  standard deviation of the latter is {root_mean_square_error(runs):.3f}.

| condition | runs | determined | refused | good | within 95 % | of one parameter | RMSE / bound | largest |
|---|---:|---:|---:|---:|---:|---:|---:|---:|
{rows}

{"".join(refused) or "No run among these is refused."}
"""


def _refusal(scene: Scene, trial: Trial) -> str:
    missing = imucal.inspect(scene.run(trial.seed).recording).missing
    inspected = f"misses: {missing}" if missing else "**misses nothing**"
    return (
        f"* {scene.name}, seed {trial.seed}: by the truth, the least determined parameter reaches "
        f"{trial.share:.1%} of its limit; `imucal inspect` of the recording {inspected}\n"
    )


SCENES = tuple(Scene(rests, by_hand) for by_hand in (False, True) for rests in (12, 14, 19))


def calls() -> dict[str, Callable[[int], Trial]]:
    """The function of each condition, which takes a seed."""
    return {scene.name: partial(trial, scene) for scene in SCENES}


def main() -> int:
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("--runs", type=int, default=RUNS, help="seeds of each condition")
    add_arguments(arguments)
    given = arguments.parse_args()
    scenes = []
    with engine_of(given, "faces") as engine:
        for scene in SCENES:
            seeds = range(1, given.runs + 1)
            done = list(engine.map(calls()[scene.name], seeds, name=scene.name))
            scenes.append(SceneFigures(scene, done))
    text = page(scenes)
    print(text)
    if given.runs == RUNS:
        REPORT.write_text(text, encoding="utf-8")
        engine.publish(REPORT)
        print(f"written to {REPORT}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
