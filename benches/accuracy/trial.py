"""One run: simulated, calibrated in one fit and in two stages, compared with the truth."""

from dataclasses import dataclass

import numpy as np

import imucal
from accuracy.bound import PARAMETERS, bound
from accuracy.naming import is_named
from accuracy.scene import Scene


@dataclass(frozen=True)
class Estimate:
    """Error and stated standard deviation of each parameter, (21,); chi2 per degree of freedom."""

    error: np.ndarray
    std: np.ndarray
    chi2_per_dof: float
    dof: int


@dataclass(frozen=True)
class Trial:
    """A run, in which nothing is wrong.

    names  of the parameters
    bound  standard deviation of each parameter at the Cramér-Rao bound, (21,)
    named  how many rests and moves were left out or down-weighted
    """

    names: tuple[str, ...]
    joint: Estimate
    two_stage: Estimate
    bound: np.ndarray
    named: int


def trial(scene: Scene, seed: int) -> Trial:
    run = scene.run(seed)
    true = scene.true_parameters(run)
    joint = imucal.calibrate(run.recording, unit=scene.unit)
    two_stage = imucal.calibrate(run.recording, joint=False)
    covariance = bound(run.truth, scene.sample_noise, held=scene.held)
    return Trial(
        tuple(parameter.name for parameter in run.truth.calibration.parameters),
        estimate(joint, true),
        estimate(two_stage, true),
        np.sqrt(np.diag(covariance)),
        sum(map(is_named, (*joint.rests, *joint.moves))),
    )


def estimate(result: imucal.CalibrationResult, true: np.ndarray) -> Estimate:
    """A result against the truth; chi2 is that of the joint fit with nothing widened, NaN without one."""
    parameters = result.parameters[:PARAMETERS]
    test = result.fit.noise_alone
    dof = 0 if test is None else test.degrees_of_freedom or 0
    return Estimate(
        np.array([p.value for p in parameters]) - true,
        np.array([np.nan if p.std is None else p.std for p in parameters]),
        test.chi2 / dof if dof else np.nan,
        dof,
    )
