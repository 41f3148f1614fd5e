"""Where measurement and model disagree: by channel and axis, by rest and move, and what it goes with.

    rest_norm        |f| - g
    rest_rate        mean rate at rest, which is zero
    move_direction   u_after x R^T u_before, the turn about each body axis that the gyroscope misses
    move_force       f(t) - g R(t)^T u_before inside the moves, means over 40 ms

All of the corrected signals, in the body frame, beside what white noise of the sensors explains. What a
residual goes with is told by regression: -n ln(1 - share) is chi2 distributed where it goes with nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np

import imucal._core as _core
from imucal.calibration.correction import left_in_data
from imucal.gap.residuals import Channel, Item, Residuals

if TYPE_CHECKING:
    from imucal.estimation.result import CalibrationResult
    from imucal.recording.recording import Recording

__all__ = ["disagreement"]

# A channel, a rest or a move stands out where noise does as much less often than this in all of them.
CHANCE: Final = 1e-3
# Of what a channel goes with, so many are said, those that explain this share of its squares at least.
MOST_NAMED: Final = 3
LEAST_SHARE: Final = 0.1
# Turns are about an axis if this share of the squares of their rotation vectors is along it.
ABOUT_ONE_AXIS: Final = 0.8


def disagreement(
    before: CalibrationResult,
    after: CalibrationResult,
    recordings: Sequence[Recording],
    inside_moves: bool,
) -> dict[str, Any]:
    """Where `recordings` disagree with the calibration `before`, and what `after` leaves of it.

    inside_moves  whether the unit turns in one place, so that the force inside the moves is gravity
    """
    # What wanders by chance is what still does when the effects have joined: before, they are taken for it.
    wander = after.fit.bias_instability_radps
    left = Residuals(before, recordings, inside_moves, wander)
    right = left if after is before else Residuals(after, recordings, inside_moves, wander)
    explained = {(c.name, c.axis): c for c in right.channels()}
    # What depends on the heading, or acts on the stand, no correction of the signals takes away.
    unseen = bool(left_in_data(after.calibration))
    channels = left.channels()
    rows, depends = [], []
    for channel in channels:
        rest = explained.get((channel.name, channel.axis))
        row = _row(channel, CHANCE / len(channels))
        row["times_noise_after"] = None if unseen or rest is None else rest.times_noise
        rows.append(row)
        if row["stands_out"]:
            depends += list(_depends(channel))
    moves = list(_items(left.moves, "direction_error_deg"))
    return {
        "channels": rows,
        "depends": depends,
        "rests": list(_items(left.rests, "norm_error_mps2")),
        "moves": moves,
        "turns_about": _common_axis([left.turns[item["index"]] for item in moves]),
    }


def _row(channel: Channel, chance: float) -> dict[str, Any]:
    return {
        "channel": channel.name,
        "axis": channel.axis,
        "unit": channel.unit,
        "rms": float(np.sqrt(np.mean(channel.values**2))),
        "noise_rms": float(np.sqrt(np.mean(channel.sigma**2))),
        "times_noise": channel.times_noise,
        "stands_out": _p_value(channel.times_noise**2 * channel.items, channel.items) < chance,
    }


def _depends(channel: Channel) -> Iterator[dict[str, Any]]:
    """What a channel goes with, the largest share first."""
    found: list[dict[str, Any]] = []
    z = channel.values / channel.sigma
    z = z - z.mean()
    for on, columns in channel.inputs.items():
        a = columns / channel.sigma[:, None]
        a = a - a.mean(axis=0)
        basis, size, _ = np.linalg.svd(a, full_matrices=False)
        basis = basis[:, size > 1e-6 * max(size[0], 1e-300)]
        if not 0 < basis.shape[1] < len(z) - 2:
            continue
        share = float(np.sum((basis.T @ z) ** 2) / np.sum(z**2))
        # Blocks of one move share its error: what counts is the number of moves.
        statistic = -channel.items * np.log(max(1.0 - share, 1e-300))
        chance = _p_value(statistic, basis.shape[1])
        if chance < CHANCE and share > LEAST_SHARE:
            found.append(
                {
                    "channel": channel.name,
                    "axis": channel.axis,
                    "on": on,
                    "share": share,
                    "p_value": chance,
                }
            )
    yield from sorted(found, key=lambda row: -row["share"])[:MOST_NAMED]


def _items(items: Sequence[Item], key: str) -> Iterator[dict[str, Any]]:
    """Rests or moves that stand out."""
    for item in items:
        if _p_value(item.chi2, item.dof) < CHANCE / len(items):
            yield {
                "recording": item.recording,
                "index": item.index,
                "times_noise": float(np.sqrt(item.chi2 / item.dof)),
                key: item.error,
                "left_out": item.left_out,
            }


def _common_axis(turns: Sequence[Any]) -> str | None:
    """The body axis that all these turns are about, if there is one."""
    if not turns:
        return None
    squares = np.square(np.array(turns))
    shares = squares / squares.sum(axis=1, keepdims=True)
    axis = int(np.argmax(shares.mean(axis=0)))
    return "xyz"[axis] if np.all(shares[:, axis] > ABOUT_ONE_AXIS) else None


def _p_value(statistic: float, dof: int) -> float:
    return float(_core.chi2_p_value(statistic, dof))
