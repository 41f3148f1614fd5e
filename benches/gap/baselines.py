"""The textbook ways to the same answer, on the same whitened residuals and the same library of columns.

    BIC             forward: the effect that lowers chi2 + p ln m most joins, until none lowers it
    LASSO           an L1 penalty on all columns at once, chosen by BIC along its path (LARS)
    fit everything  all columns at once; what stands out after Bonferroni's correction is named

Whatever they find is `named`: none has a way to say that it is nothing on the list, or one of two.
"""

import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

import imucal
from gap.said import Said
from imucal.estimation.options import Options
from imucal.units import STANDARD_GRAVITY_MPS2

FAMILY_ALPHA = 0.01
# Directions that the base model takes away all but this share of are not seen.
SEEN = 1e-6
LASSO = "LASSO"
OPTIONS = Options(gravity_mps2=STANDARD_GRAVITY_MPS2, min_rest_s=1.0)


@dataclass(frozen=True)
class Library:
    """Whitened residuals and columns, with what the base model explains taken out of both.

    rows  how many residuals there are
    """

    residual: np.ndarray
    columns: dict[str, np.ndarray]
    rows: int

    def brief(self) -> "Library":
        """The same squares and products in as many rows as there are columns."""
        names = list(self.columns)
        whole = np.linalg.qr(np.column_stack([*self.columns.values(), self.residual]), mode="r")
        ends = np.cumsum([self.columns[name].shape[1] for name in names])
        parts = np.split(whole[:, :-1], ends[:-1], axis=1)
        return Library(whole[:, -1], dict(zip(names, parts, strict=True)), self.rows)


def library(residual: np.ndarray, base: np.ndarray, columns: dict[str, np.ndarray]) -> Library:
    """Project the base parameters out; an orthonormal basis of what is left of each effect."""
    q, _ = np.linalg.qr(base)

    def rest(of: np.ndarray) -> np.ndarray:
        left: np.ndarray = of - q @ (q.T @ of)
        return left

    bases = {}
    for name, column in columns.items():
        scaled = column / np.maximum(np.linalg.norm(column, axis=0), 1e-300)
        u, s, _ = np.linalg.svd(rest(scaled), full_matrices=False)
        kept = u[:, s > SEEN**0.5]
        if kept.shape[1]:
            bases[name] = kept
    return Library(rest(residual), bases, len(residual))


def bic(data: Library) -> tuple[str, ...]:
    """Forward selection, an effect at a time."""
    chosen: list[str] = []
    left, best = dict(data.columns), float(data.residual @ data.residual)
    while left:
        scores = {}
        for name in left:
            model = np.hstack([data.columns[other] for other in (*chosen, name)])
            scores[name] = _chi2(data.residual, model) + np.log(data.rows) * model.shape[1]
        name = min(scores, key=scores.__getitem__)
        if scores[name] >= best:
            break
        best = scores[name]
        chosen.append(name)
        del left[name]
    return tuple(chosen)


def lasso(data: Library, most: int = 500) -> tuple[str, ...]:
    """All columns at once with an L1 penalty; effects in the order of what they explain.

    most  steps of the path
    """
    # Loaded here: it takes seconds, and nothing else needs it.
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.linear_model import LassoLarsIC

    names, columns = list(data.columns), np.hstack(list(data.columns.values()))
    owner = np.repeat(np.arange(len(names)), [data.columns[name].shape[1] for name in names])
    path = LassoLarsIC(criterion="bic", noise_variance=1.0, fit_intercept=False, max_iter=most)
    with warnings.catch_warnings():
        # Columns of similar forms are nearly dependent; the path goes on without one of them.
        warnings.simplefilter("ignore", ConvergenceWarning)
        fit = path.fit(columns, data.residual)
    power = {
        name: float(np.sum((columns[:, owner == i] @ fit.coef_[owner == i]) ** 2))
        for i, name in enumerate(names)
    }
    return tuple(sorted((name for name in names if power[name] > 0.0), key=lambda name: -power[name]))


def everything(data: Library) -> tuple[str, ...]:
    """One fit of all; the effects whose share stands out, the most certain first."""
    names, columns = list(data.columns), np.hstack(list(data.columns.values()))
    u, s, vt = np.linalg.svd(columns, full_matrices=False)
    kept = s > SEEN**0.5 * s[0]
    estimate = vt[kept].T @ ((u[:, kept].T @ data.residual) / s[kept])
    covariance = (vt[kept].T / s[kept] ** 2) @ vt[kept]
    found, start = {}, 0
    for name in names:
        mine = slice(start, start + data.columns[name].shape[1])
        start = mine.stop
        values, covered = estimate[mine], covariance[mine, mine]
        # Directions that others have as well have no covariance of their own: they are rounding.
        inverse = np.linalg.pinv(covered, rcond=SEEN, hermitian=True)
        rank = np.linalg.matrix_rank(covered, tol=SEEN * np.abs(covered).max(), hermitian=True)
        p_value = float(chi2.sf(values @ inverse @ values, rank))
        if p_value < FAMILY_ALPHA / len(names):
            found[name] = p_value
    return tuple(sorted(found, key=found.__getitem__))


def _chi2(residual: np.ndarray, model: np.ndarray) -> float:
    coefficients, *_ = np.linalg.lstsq(model, residual, rcond=None)
    left = residual - model @ coefficients
    return float(left @ left)


BASELINES: dict[str, Callable[[Library], tuple[str, ...]]] = {
    "BIC": bic, LASSO: lasso, "fit everything": everything,
}  # fmt: skip


def ask(measured: imucal.Recording, candidates: Sequence[str] | None = None) -> dict[str, Said]:
    """What the textbook ways say; empty if the library cannot make a design of this recording."""
    import imucal._core as _core

    wanted = candidates or [effect.name for effect in imucal.effects.catalogue()]
    start = time.perf_counter()
    try:
        design = _core.gap_design(
            [measured], OPTIONS, [(name, imucal.effects.find(name).plain) for name in wanted]
        )
    except imucal.ImucalError:
        return {}
    # An effect with a time constant stands there once for each of several: they are rivals like all others.
    named = {f"{name}@{place}": rows for place, (name, rows) in enumerate(design.effects)}
    data = library(design.residual, design.base, named)
    # Least squares are the same in a few rows; the penalty is chosen by a rule that counts them.
    brief = data.brief() if data.columns else data
    shared_s = time.perf_counter() - start
    answers = {}
    for way, choose in BASELINES.items():
        start = time.perf_counter()
        found = choose(data if way == LASSO else brief) if data.columns else ()
        names = tuple(dict.fromkeys(name.partition("@")[0] for name in found))
        verdict = "named" if names else "nothing_missing"
        answers[way] = Said(verdict, names, seconds=shared_s + time.perf_counter() - start)
    return answers
