"""Many contaminated runs of one kind: RMSE over the bound of what is left, and what was named."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

import imucal
from accuracy.band import BESIDE_GATE, one_sided, root_mean_square_error
from accuracy.bound import PARAMETERS, bound
from accuracy.faults import contaminated
from accuracy.naming import Named, score
from accuracy.scene import PAPER
from gate import Gate

Calibrate = Callable[[imucal.Recording], imucal.CalibrationResult]
WITHIN = 1.15
RECALL = 0.95
FALSE = 0.01


@dataclass(frozen=True)
class Spoilt:
    """One contaminated run; without a result `refused` says why.

    bound  covariance at the bound of the rests and moves that are left, (21, 21)
    """

    error: np.ndarray | None
    bound: np.ndarray
    named: Named | None
    refused: str = ""


def calibrate(recording: imucal.Recording) -> imucal.CalibrationResult:
    return imucal.calibrate(recording, joint=True, exclude_saturated=True)


def spoilt(name: str, seed: int, by: Calibrate = calibrate) -> Spoilt:
    """One run with the fault `name`, calibrated `by` an estimator."""
    case = contaminated(name, seed)
    lost = [(one.start_s, one.end_s) for one in case.bad if one.of == "move" and one.to_see]
    least = bound(case.truth, PAPER.sample_noise, rests=case.rests, lost=lost)
    try:
        result = by(case.recording)
    except imucal.ImucalError as error:
        return Spoilt(None, least, None, str(error))
    values = np.array([parameter.value for parameter in result.parameters[:PARAMETERS]])
    true = np.array([parameter.value for parameter in case.truth.calibration.parameters])
    return Spoilt(values - true, least, score(result, case.bad))


@dataclass(frozen=True)
class Contamination:
    """All runs with one fault.

    ratio, pooled                RMSE over the bound, (21,) and of all parameters together
    ratio_error, pooled_error    Monte Carlo error of a perfect estimator's
    worst_run                    the largest root mean square over the parameters of error / bound
    """

    name: str
    runs: int
    refused: tuple[str, ...]
    ratio: np.ndarray
    ratio_error: float
    pooled: float
    pooled_error: float
    worst_run: float
    named: Named

    @staticmethod
    def of(name: str, runs: Sequence[Spoilt]) -> "Contamination":
        done = [run for run in runs if run.error is not None and run.named is not None]
        refused = tuple(run.refused for run in runs if run.error is None)
        error = np.array([run.error for run in done]).reshape(-1, PARAMETERS)
        least = np.array([np.sqrt(np.diag(run.bound)) for run in done]).reshape(-1, PARAMETERS)
        if not done:
            nothing = np.full(PARAMETERS, np.nan), np.nan, np.nan, np.nan, np.nan, Named(0, 0, 0, 0)
            return Contamination(name, len(runs), refused, *nothing)
        squares = ((error / least) ** 2).mean(axis=1)
        # Parameters of one run are correlated: the variance of their mean square is 2 sum of r^2 / 21^2.
        tied = np.mean([np.mean((r.bound / np.outer(s, s)) ** 2) for r, s in zip(done, least, strict=True)])
        return Contamination(
            name,
            len(runs),
            refused,
            np.sqrt((error**2).mean(axis=0) / (least**2).mean(axis=0)),
            root_mean_square_error(len(done)),
            float(np.sqrt(squares.mean())),
            float(np.sqrt(tied)) * root_mean_square_error(len(done)),
            float(np.sqrt(squares.max())),
            Named(*(sum(getattr(r.named, f) for r in done) for f in ("bad", "found", "good", "false"))),
        )

    @property
    def recall(self) -> float:
        return self.named.found / self.named.bad if self.named.bad else np.nan

    @property
    def false(self) -> float:
        return self.named.false / self.named.good if self.named.good else np.nan

    def gates(self) -> list[Gate]:
        worst = int(np.argmax(self.ratio))
        each = WITHIN * (1.0 + one_sided(BESIDE_GATE / PARAMETERS) * self.ratio_error)
        together = WITHIN * (1.0 + one_sided(BESIDE_GATE) * self.pooled_error)
        refused = len(self.refused)
        named = self.named
        gates = [
            Gate(f"{self.name}: runs without a result", "0", str(refused), refused == 0),
            Gate(
                f"{self.name}: RMSE / bound, all parameters",
                f"at most {together:.3f} ({WITHIN} and chance)",
                f"{self.pooled:.3f} ± {self.pooled_error:.3f}",
                self.pooled <= together,
            ),
            Gate(
                f"{self.name}: RMSE / bound, each parameter",
                f"at most {each:.3f} ({WITHIN} and chance)",
                f"worst {self.ratio[worst]:.3f} ± {self.ratio_error:.3f}",
                bool(self.ratio[worst] <= each),
            ),
            Gate(
                f"{self.name}: good rests and moves named",
                f"at most {100 * FALSE:.0f} %",
                f"{100 * self.false:.2f} % ({named.false}/{named.good})",
                self.false <= FALSE,
            ),
        ]
        if named.bad:
            found = f"{100 * self.recall:.1f} % ({named.found}/{named.bad})"
            aim = f"at least {100 * RECALL:.0f} %"
            gates.append(Gate(f"{self.name}: bad ones named", aim, found, self.recall >= RECALL))
        return gates
