"""Selection of laws from whitened residuals (residuals divided by their standard deviation from noise).

The Jacobian columns of the base parameters and of the named effects are projected out of the residuals and of
the Jacobian columns of all candidates. The candidate with the largest log evidence is selected if it meets
three conditions. Its log evidence, minus the logarithm of the number of candidates, is at least `LEAST_NATS`.
No formula of another input variable explains the residuals equally well. Random halves of the rests and moves
select the same input variable (stability selection, Meinshausen and Buhlmann 2010).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.gap.laws.library import Form

__all__ = ["Columns", "Selected", "select", "settled"]

# Minimum log evidence of a law, nats, after subtraction of the logarithm of the number of candidates. 8 nats
# are odds of 3000 to 1. Effects of the catalogue have the same threshold: with less evidence, an effect is
# accepted only if it improves the prediction of unseen data.
LEAST_NATS: Final = 8.0
# Two forms count as equally good if their log evidence differs by at most this number, nats. 3 nats are odds
# of 20 to 1. Equally good forms with different input variables are rivals. Of equally good forms with the
# same input variable, the simplest is selected.
RIVAL_NATS: Final = 3.0
# Number of random halves of the rests and moves on which the selection is repeated. A law is accepted if the
# same sensor and input variable are selected in at least the share LEAST_STABLE of the halves.
HALVES: Final = 50
LEAST_STABLE: Final = 0.8
# In the random halves, only this number of candidates, those with the largest evidence, are compared.
FINALISTS: Final = 16
# Maximum number of laws that are selected.
MOST_LAWS: Final = 3
# The Jacobian columns of the model are projected out of the Jacobian columns of a form. If less than this
# share of the norm remains, the columns of the form are linear combinations of the columns of the model, and
# only rounding errors remain.
LEAST_LEFT: Final = 1e-3
SEED: Final = 20240


@dataclass(frozen=True, eq=False)
class Columns:
    """Whitened residuals, and the columns of their Jacobian for the model and for the candidate laws.

    residual      (m,)
    model         (m, n), base parameters and named effects
    groups, items (m,), kind of each residual, and the rest or move to which it belongs
    candidates    forms with their Jacobian columns, (m, p)
    """

    residual: FloatArray
    model: FloatArray
    groups: np.ndarray
    items: np.ndarray
    candidates: Sequence[tuple[Form, FloatArray]]


@dataclass(frozen=True)
class Selected:
    """A selected law.

    form     its formula
    nats     log evidence minus the logarithm of the number of candidates
    stable   share of the random halves of the rests and moves that select the same sensor and input variable
    """

    form: Form
    nats: float
    stable: float


def select(given: Columns) -> list[Selected]:
    """The laws that the residuals support, in the order of their selection."""
    chosen: list[Selected] = []
    model = given.model
    penalty = float(np.log(max(len(given.candidates), 1)))
    while len(chosen) < MOST_LAWS:
        weights = _weights(given, model)
        nats = _evidence(given, model, weights) - penalty
        best = int(np.argmax(nats)) if len(nats) else -1
        if best < 0 or not nats[best] > LEAST_NATS:
            break
        group = given.candidates[best][0].group
        same = [place for place, (form, _) in enumerate(given.candidates) if form.group == group]
        others = [place for place in range(len(nats)) if place not in set(same)]
        if others and nats[others].max() > nats[best] - RIVAL_NATS:
            break
        stable = _stability(given, model, weights, nats, group)
        if stable < LEAST_STABLE:
            break
        near = [place for place in same if nats[place] > nats[best] - RIVAL_NATS]
        pick = min(near, key=lambda place: (given.candidates[place][0].cost, -nats[place]))
        form, columns = given.candidates[pick]
        if any(own.form == form for own in chosen):
            break
        chosen.append(Selected(form, float(nats[pick]), stable))
        model = np.hstack([model, columns])
    return chosen


def settled(given: Columns, variants: Sequence[Sequence[int]]) -> list[int]:
    """For each law, the index of the candidate with the best constant, given the constants of the other laws.

    variants  for each law, the indices of the candidates that differ only in the constant
    """
    picks = [own[len(own) // 2] for own in variants]
    for place, own in enumerate(variants):
        others = [given.candidates[pick][1] for k, pick in enumerate(picks) if k != place]
        model = np.hstack([given.model, *others])
        nats = _evidence(given, model, _weights(given, model), own)
        picks[place] = own[int(np.argmax(nats))]
    return picks


def _weights(given: Columns, model: FloatArray) -> FloatArray:
    """Weight of each residual; less than 1 for kinds of residuals that scatter more than their noise."""
    weights = np.ones(len(given.residual))
    for _ in range(3):
        left = (
            given.residual
            - model @ np.linalg.lstsq(model * weights[:, None], given.residual * weights, rcond=None)[0]
        )
        for group in np.unique(given.groups):
            rows = given.groups == group
            weights[rows] = 1.0 / np.sqrt(max(1.0, float(np.mean(left[rows] ** 2))))
    return weights


def _evidence(
    given: Columns, model: FloatArray, weights: FloatArray, places: Sequence[int] | None = None
) -> FloatArray:
    """Log evidence of the model with each candidate in `places` (indices) relative to the model without it.

    The log evidence is maximised over the width of the prior.
    """
    q, _ = np.linalg.qr(_scaled(model * weights[:, None]))
    residual = given.residual * weights
    residual = residual - q @ (q.T @ residual)
    found = []
    for place in range(len(given.candidates)) if places is None else places:
        columns = _scaled(given.candidates[place][1] * weights[:, None])
        left = columns - q @ (q.T @ columns)
        u, s, _ = np.linalg.svd(left, full_matrices=False)
        found.append(
            _nats(float(np.sum((u[:, s > LEAST_LEFT].T @ residual) ** 2)), int((s > LEAST_LEFT).sum()))
        )
    return np.array(found)


def _nats(gain: float, rank: int) -> float:
    """Log Bayes factor of `rank` parameters that reduce chi2 by `gain`, maximised over the prior width."""
    if rank == 0 or gain <= rank:
        return 0.0
    return 0.5 * (gain - rank) - 0.5 * rank * float(np.log(gain / rank))


def _scaled(columns: FloatArray) -> FloatArray:
    scaled: FloatArray = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    return scaled


def _stability(
    given: Columns,
    model: FloatArray,
    weights: FloatArray,
    nats: FloatArray,
    group: tuple[str, tuple[str, ...]],
) -> float:
    """Share of random halves of the rests and moves in which the best form has this sensor and variables."""
    finalists = _finalists(given, nats)
    blocks = [_scaled(given.candidates[place][1] * weights[:, None]) for place in finalists]
    whole = np.hstack([_scaled(model * weights[:, None]), *blocks, (given.residual * weights)[:, None]])
    items = np.unique(given.items)
    grams = np.array([whole[given.items == item].T @ whole[given.items == item] for item in items])
    ends = model.shape[1] + np.cumsum([0, *(block.shape[1] for block in blocks)])
    random = np.random.default_rng(SEED)
    hits = 0
    for _ in range(HALVES):
        half = random.permutation(len(items))[: len(items) // 2]
        gram = grams[half].sum(axis=0)
        n = model.shape[1]
        inverse = np.linalg.pinv(gram[:n, :n], rcond=1e-10, hermitian=True)
        left = gram[n:, n:] - gram[n:, :n] @ inverse @ gram[:n, n:]
        scores = []
        for start, stop in zip(ends[:-1] - n, ends[1:] - n, strict=True):
            values, vectors = np.linalg.eigh(left[start:stop, start:stop])
            kept = values > LEAST_LEFT**2
            along = (vectors[:, kept].T @ left[start:stop, -1]) / np.sqrt(values[kept])
            scores.append(_nats(float(along @ along), int(kept.sum())))
        hits += given.candidates[finalists[int(np.argmax(scores))]][0].group == group
    return hits / HALVES


def _finalists(given: Columns, nats: FloatArray) -> list[int]:
    """The best candidates, at most three per group of forms with the same sensor and input variable."""
    chosen: list[int] = []
    for place in np.argsort(-nats):
        group = given.candidates[place][0].group
        if sum(given.candidates[other][0].group == group for other in chosen) < 3:
            chosen.append(int(place))
        if len(chosen) == FINALISTS:
            break
    return chosen
