"""The moves of a recording, block by block: how they turn, and means over the blocks."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

import imucal._core as _core
from imucal.arrays import as_rows
from imucal.recording.recording import Recording

if TYPE_CHECKING:
    from imucal.arrays import FloatArray, SampleArray

__all__ = ["LEAST_CHANGE_K", "Paths", "Placed", "means_of"]

# Means of the force inside the moves.
BLOCK_S: Final = 0.04
# A temperature that changes by less says nothing.
LEAST_CHANGE_K: Final = 0.5

# Place of a rest or a move in the result, and the rest or move.
Placed: TypeAlias = tuple[int, Any]


class Paths:
    """The moves of one recording, block by block, one after the other.

    moves         place in the result and move, M of them
    rotation      from the body at the end of each move to the body at its start, (M, 3, 3)
    turns         the same as rotation vectors, rad, (M, 3)
    since_s       time from the start of the move to the end of each of the B blocks
    length_s      of the blocks
    edges         two, from the body at the start and at the end of each block to the body at the start of the
                  move, (B, 3, 3)
    middle        the same in the middle of each block
    rate, force   means over the blocks, (B, 3)
    acceleration  of the rate, (B, 3)
    """

    def __init__(self, corrected: Recording, moves: list[Placed]) -> None:
        time_s, rate = corrected.time_s, as_rows(corrected.angular_rate, "angular_rate", 3)
        self.moves = moves
        ends, quaternions = [], []
        for _, move in moves:
            first, last = move.first, move.last
            step = max(2, round(BLOCK_S * (last - first) / (time_s[last] - time_s[first])))
            at = [*range(first, last - step + 1, step), last]
            span = slice(first, last + 1)
            ends.append(at)
            quaternions.append(_core.attitudes(time_s[span], rate[span], [k - first for k in at]))
        # At the edges of the blocks and, between them, in their middles.
        wxyz = np.concatenate(quaternions)
        both = _matrices(wxyz)
        counts = np.array([len(at) - 1 for at in ends])
        last_edge = np.cumsum(2 * counts + 1) - 1
        in_middle = np.concatenate([np.arange(1, 2 * n, 2) for n in counts])
        in_middle += np.repeat(last_edge - 2 * counts, counts)
        self.rotation, self.turns = both[last_edge], _vectors(wxyz[last_edge])
        self.edges, self.middle = (both[in_middle - 1], both[in_middle + 1]), both[in_middle]
        self._first = np.cumsum(counts) - counts
        self._move = np.repeat(np.arange(len(moves)), counts)

        start = np.concatenate([at[:-1] for at in ends])
        end = np.concatenate([at[1:] for at in ends])
        self._start_s, self.length_s = time_s[start], time_s[end] - time_s[start]
        self.since_s = time_s[end] - self._start_s[self._first][self._move]
        blocks = np.column_stack([start, end])
        # A trapezoid is what the samples have with half of the steps on either side, but at its ends.
        half_s = np.concatenate([[0.0], 0.5 * np.diff(time_s), [0.0]])[:, None]
        before_s, weights_s = half_s[:-1], half_s[:-1] + half_s[1:]

        def mean(values: SampleArray) -> FloatArray:
            area = _sums_of(values * weights_s, blocks)
            area += values[end] * before_s[end] - values[start] * before_s[start]
            area /= self.length_s[:, None]
            return area

        self.rate, self.force = mean(rate), mean(corrected.specific_force)
        self.acceleration = (rate[end] - rate[start]) / self.length_s[:, None]
        given = corrected.temperature_degc
        self._temperature: FloatArray | None = None
        if given is not None and np.ptp(given) >= LEAST_CHANGE_K:
            self._temperature = given[start] - given.mean()

    def up(self, before: FloatArray) -> FloatArray:
        """Mean over each block of a direction that is `before`, (M, 3), at the start of the moves, (B, 3)."""
        own = before[self._move]
        first, middle, last = (
            np.einsum("bji,bj->bi", m, own) for m in (self.edges[0], self.middle, self.edges[1])
        )
        mean: FloatArray = (first + 4.0 * middle + last) / 6.0
        return mean

    def driven(self) -> dict[str, FloatArray]:
        """What errors of the rate turn the ends by: name -> (M, 3, p), each column one kind of error."""
        to_end = np.einsum("bji,bjk->bik", self.rotation[self._move], self.middle)
        to_end *= self.length_s[:, None, None]
        rate_squared, size = self.rate**2, np.abs(self.rate)
        of_block = {
            "time": to_end * self._start_s[:, None, None],
            "gravity": np.einsum("bij,bk->bijk", to_end, self.force).reshape(-1, 3, 9),
            "rate_squared": to_end * rate_squared[:, None],
            "sign_of_the_rate": to_end * size[:, None],
        }
        if self._temperature is not None:
            of_block["temperature"] = to_end * self._temperature[:, None, None]
        return {name: np.add.reduceat(values, self._first) for name, values in of_block.items()}


def _sums_of(values: FloatArray, spans: NDArray[np.int64]) -> FloatArray:
    """Sums of rows over spans [first, end) in rising order, which do not overlap."""
    at = spans.ravel()
    # The last span may end with the rows.
    sums: FloatArray = np.add.reduceat(values, at[: -1 if at[-1] == len(values) else None])[::2]
    return sums


def means_of(values: SampleArray, spans: NDArray[np.int64]) -> FloatArray:
    """Means of rows over such spans."""
    return _sums_of(as_rows(values, "values", values.shape[1]), spans) / np.diff(spans)


def _matrices(wxyz: FloatArray) -> FloatArray:
    """Of quaternions, (n, 4), to (n, 3, 3)."""
    w, x, y, z = wxyz.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def _vectors(wxyz: FloatArray) -> FloatArray:
    """Of quaternions, (n, 4), to rotation vectors of half a turn at most, rad, (n, 3)."""
    w, xyz = np.abs(wxyz[:, 0]), np.copysign(1.0, wxyz[:, :1]) * wxyz[:, 1:]
    sine = np.linalg.norm(xyz, axis=1)
    share = np.divide(2.0 * np.arctan2(sine, w), sine, out=np.full(len(w), 2.0), where=sine > 0.0)
    vectors: FloatArray = xyz * share[:, None]
    return vectors
