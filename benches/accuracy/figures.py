"""Many runs of one scene in numbers, parameter by parameter."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from accuracy.band import BESIDE, BESIDE_GATE, binomial, one_sided, root_mean_square_error, two_sided
from accuracy.bound import PARAMETERS
from accuracy.scene import Scene
from accuracy.trial import Estimate, Trial
from gate import Gate

# Multiples of sigma and the probability within.
LEVELS = {"68 %": (1.0, 0.682689), "95 %": (1.959964, 0.95), "99.7 %": (2.967738, 0.997)}
WITHIN = 1.05
BIAS = 0.1
EFFICIENCY = 0.98


class Figures:
    """One estimator in all runs of a scene; arrays are (21,).

    rmse, stated, bound  root mean squares over the runs: of the error, of the stated sigma, of the bound's
    bias                 mean error in stated sigmas
    inside               level -> share of the runs with the truth in the stated interval
    """

    def __init__(self, estimates: Sequence[Estimate], bound: np.ndarray) -> None:
        self.runs = len(estimates)
        self.error = np.array([estimate.error for estimate in estimates])
        self.std = np.array([estimate.std for estimate in estimates])
        self.rmse, self.stated, self.bound = (
            np.sqrt((v**2).mean(axis=0)) for v in (self.error, self.std, bound)
        )
        self.bias = self.error.mean(axis=0) / self.stated
        score = np.abs(self.error / self.std)
        self.inside = {level: (score <= sigmas).mean(axis=0) for level, (sigmas, _) in LEVELS.items()}

    @property
    def ratio(self) -> np.ndarray:
        return self.rmse / self.bound

    def ratio_limit(self, beside: float) -> float:
        return WITHIN * (1.0 + one_sided(beside) * root_mean_square_error(self.runs))

    def bias_limit(self, beside: float) -> float:
        return BIAS + two_sided(beside) / float(np.sqrt(self.runs))

    def band(self, level: str, beside: float) -> tuple[float, float]:
        return binomial(self.runs, LEVELS[level][1], beside)

    def outside(self, level: str, beside: float) -> np.ndarray:
        """Which parameters' coverage is outside the band."""
        low, high = self.band(level, beside)
        return (self.inside[level] < low) | (self.inside[level] > high)


@dataclass(frozen=True)
class SceneFigures:
    """All runs of a scene: the joint fit and the two-stage one."""

    scene: Scene
    trials: Sequence[Trial]

    @cached_property
    def bound(self) -> np.ndarray:
        return np.array([trial.bound for trial in self.trials])

    @cached_property
    def joint(self) -> Figures:
        return Figures([trial.joint for trial in self.trials], self.bound)

    @cached_property
    def two_stage(self) -> Figures:
        return Figures([trial.two_stage for trial in self.trials], self.bound)

    @property
    def chi2(self) -> float:
        """Mean of the reduced chi2 of the joint fit by the weights of noise alone."""
        return float(np.mean([trial.joint.chi2_per_dof for trial in self.trials]))

    @property
    def chi2_error(self) -> float:
        """Standard deviation of that mean if noise is all there is."""
        variances = [2.0 / trial.joint.dof for trial in self.trials]
        return float(np.sqrt(np.mean(variances) / len(self.trials)))

    @property
    def efficiency(self) -> tuple[float, float]:
        """Bound over mean square error, over all parameters, and its Monte Carlo error."""
        square, error = _mean_square(self.joint.error / self.bound)
        return 1.0 / square, error / square**2

    @property
    def mean_square_score(self) -> tuple[float, float]:
        """Mean of (error / stated sigma)^2 over all parameters, and its error: 1 if the sigmas are true."""
        return _mean_square(self.joint.error / self.joint.std)

    @property
    def coverage_outside(self) -> tuple[int, int]:
        """How many coverages are outside the band of one figure, and of the whole table."""
        counts = len(LEVELS) * PARAMETERS
        of_one = sum(int(self.joint.outside(level, BESIDE).sum()) for level in LEVELS)
        of_all = sum(int(self.joint.outside(level, BESIDE_GATE / counts).sum()) for level in LEVELS)
        return of_one, of_all

    def gates(self) -> list[Gate]:
        name, joint = self.scene.name, self.joint
        bias_limit = joint.bias_limit(BESIDE_GATE / PARAMETERS)
        _, of_all = self.coverage_outside
        off = two_sided(BESIDE_GATE) * self.chi2_error
        return [
            *(self._bound_gates() if self.scene.has_bound else []),
            Gate(
                f"{name}: bias, each parameter",
                f"at most {bias_limit:.3f} σ ({BIAS:g} σ and chance)",
                f"worst {np.abs(joint.bias).max():.3f} ± {1 / np.sqrt(joint.runs):.3f}",
                bool(np.abs(joint.bias).max() <= bias_limit),
            ),
            Gate(
                f"{name}: coverages outside the band of all",
                "0",
                f"{of_all} of {len(LEVELS) * PARAMETERS}",
                of_all == 0,
            ),
            Gate(
                f"{name}: mean of the reduced chi2",
                f"1.00 ± {off:.4f}",
                f"{self.chi2:.4f}",
                abs(self.chi2 - 1.0) <= off,
            ),
        ]

    def _bound_gates(self) -> list[Gate]:
        name, joint = self.scene.name, self.joint
        ratio_limit = joint.ratio_limit(BESIDE_GATE / PARAMETERS)
        share, error = self.efficiency
        share_limit = EFFICIENCY - one_sided(BESIDE_GATE) * error
        return [
            Gate(
                f"{name}: RMSE / bound, each parameter",
                f"at most {ratio_limit:.3f} ({WITHIN} and chance)",
                f"worst {joint.ratio.max():.3f} ± {root_mean_square_error(joint.runs):.3f}",
                bool(joint.ratio.max() <= ratio_limit),
            ),
            Gate(
                f"{name}: efficiency",
                f"at least {share_limit:.3f} ({EFFICIENCY} and chance)",
                f"{share:.4f} ± {error:.4f}",
                share >= share_limit,
            ),
        ]


def _mean_square(scores: np.ndarray) -> tuple[float, float]:
    """Mean square, and its error: parameters of one run hang together, runs do not."""
    of_run = (scores**2).mean(axis=1)
    return float(of_run.mean()), float(of_run.std(ddof=1) / np.sqrt(len(of_run)))
