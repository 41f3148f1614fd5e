"""Rests and moves of a recording: their times, their residuals, and the reasons for exclusions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias, TypeVar

__all__ = ["FittedMove", "FittedRest", "Move", "Rest", "of_library", "used_of"]

# Type of a quantity with one value per axis. A value is None if a sample of the rest or move is missing.
Axes: TypeAlias = tuple[float | None, float | None, float | None]
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Rest:
    """One rest.

    recording            name of the recording
    first, end           index of the first sample of the rest, and index after its last sample
    start_s, end_s       times of the first and last sample of the rest, s; None in a table of means
    epochs               number of epochs, the parts of a long rest with a separate mean and temperature each;
                         1 if the rest is not split
    unsteadiness         variance of the samples of the rest divided by the noise variance (median over the
                         windows), or a measure of the drift of the mean force if this is larger; see (11) in
                         docs/model.md
    mean_specific_force  (3,) mean of the raw samples, in the raw unit
    mean_angular_rate    (3,) mean of the raw samples, in the raw unit
    norm_error_mps2      norm of the corrected specific force minus gravity, m/s^2
    norm_sigma_mps2      standard deviation of norm_error_mps2 from noise, m/s^2
    excluded             why the rest is not used; None if it is used
    """

    recording: str
    first: int
    end: int
    start_s: float | None
    end_s: float | None
    epochs: int
    unsteadiness: float | None
    mean_specific_force: Axes
    mean_angular_rate: Axes
    norm_error_mps2: float | None
    norm_sigma_mps2: float | None
    excluded: str | None

    @property
    def place(self) -> str:
        """A text that locates the rest: its start and end time, or its row in a table of means."""
        if self.start_s is None or self.end_s is None:
            return f"row {self.first + 1}"
        return f"{self.start_s:.2f} s to {self.end_s:.2f} s"


@dataclass(frozen=True, slots=True)
class Move:
    """One move from a rest to the next.

    recording            name of the recording
    from_rest, to_rest   indices of the rests before and after the move
    first, last          indices of the first and last sample of the move
    duration_s           time from the first to the last sample, s
    direction_error_deg  angle between the gravity direction propagated by the gyroscope over the move and the
                         direction measured after the move, deg
    direction_sigma_deg  standard deviation of direction_error_deg from noise, per axis, deg
    gravity_before, gravity_after   (3,) unit vectors of measured gravity at the two rests, body frame
    excluded             why the move is not used; None if it is used
    """

    recording: str
    from_rest: int
    to_rest: int
    first: int
    last: int
    duration_s: float
    direction_error_deg: float | None
    direction_sigma_deg: float | None
    gravity_before: Axes
    gravity_after: Axes
    excluded: str | None


@dataclass(frozen=True, slots=True)
class FittedRest(Rest):
    """One rest of a calibration recording.

    chi2, degrees_of_freedom   chi2 and degrees of freedom of the residuals of this rest in a fit without it;
                               None if the rest is excluded or there is no joint fit
    p_value                    probability of a larger chi2 under the null hypothesis of noise only
    """

    chi2: float | None
    degrees_of_freedom: int | None
    p_value: float | None


@dataclass(frozen=True, slots=True)
class FittedMove(Move):
    """One move of a calibration recording.

    chi2, degrees_of_freedom   chi2 and degrees of freedom of the residuals of this move in a fit without it;
                               None if the move is excluded or there is no joint fit
    p_value                    probability of a larger chi2 under the null hypothesis of noise only
    """

    chi2: float | None
    degrees_of_freedom: int | None
    p_value: float | None


def of_library(kind: type[T], fields: Mapping[str, Any]) -> T:
    """An instance of the frozen dataclass `kind` from the fields that the compiled library returns."""
    return kind(
        **{name: tuple(value) if isinstance(value, list) else value for name, value in fields.items()}
    )


def used_of(items: Sequence[Rest] | Sequence[Move]) -> str:
    """The number of used rests or moves and their total number, such as "12 of 14"."""
    return f"{sum(item.excluded is None for item in items)} of {len(items)}"
