"""Figures of merit of a calibration on a set of recordings, and their criterion for the verdict `poor`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import imucal._core as _core
from imucal.calibration.parameter_text import Units
from imucal.document.plain import plain
from imucal.units import datasheet, significant

__all__ = ["FIGURE_TEXT", "Figures", "figures_text", "poor_figures", "saved_reasons"]

# Name of each figure of merit in texts, and the unit of its field.
FIGURE_TEXT: Final = {
    "gravity_norm_rms_mps2": ("gravity norm error", "m/s^2"),
    "gravity_direction_rms_deg": ("gravity direction error per move", "deg"),
    "chi2_per_dof": ("chi2 per degree of freedom", ""),
}


@dataclass(frozen=True, slots=True)
class Figures:
    """Figures of merit of a calibration on a set of recordings.

    chi2_per_dof               chi2 per degree of freedom of the residuals at the rests and after the moves;
                               1 is expected from noise alone. None if samples could not be corrected
    gravity_norm_rms_mps2      rms difference between the norm of gravity measured at the rests and local
                               gravity, m/s^2
    gravity_direction_rms_deg  rms angle between the gravity direction that the gyroscope propagates over a
                               move and the direction measured after the move, deg
    rests, moves               numbers of rests and moves that are used; an accelerometer alone has no moves
    """

    chi2_per_dof: float | None
    gravity_norm_rms_mps2: float | None
    gravity_direction_rms_deg: float | None
    rests: int
    moves: int


def figures_text(figures: object, units: Units = datasheet) -> str:
    """The figures of merit as text, with their names and units.

    figures   Figures, HeldOut (figures of a cross-validation), or a mapping from a file
    """
    fields = plain(figures)
    parts = []
    for name, (words, unit) in FIGURE_TEXT.items():
        if fields.get(name) is not None:
            scale = units(name, unit)
            value = significant(scale.shown(fields[name]), 3)
            parts.append(f"{words} {value} {scale.unit}{' rms' if unit else ''}".rstrip())
    return ", ".join(parts)


def poor_figures(name: str, figures: Figures, *, has_gyroscope: bool = True) -> list[str]:
    """Reasons why these figures of merit give the verdict `poor`; empty if they do not.

    name           the set of recordings: "calibration set" or "control set"
    has_gyroscope  whether the set must contain moves; an accelerometer alone has no moves
    """
    rests, moves = _count(figures.rests), _count(figures.moves)
    reason = _core.poor_figures(name, rests, moves, figures.chi2_per_dof, has_gyroscope)
    return [] if reason is None else [reason]


def _count(number: float) -> int:
    """Convert a number of rests or moves to an integer.

    It is 0 for an invalid number, which a file of another program may contain.
    """
    return int(number) if math.isfinite(number) and number > 0 else 0


def saved_reasons(
    calibration_set: Mapping[str, Any] | None,
    control_set: Mapping[str, Any] | None,
    *,
    has_gyroscope: bool = True,
) -> list[str]:
    """Reasons for the verdict `poor` from the figures of merit in a calibration file; may be empty."""
    return [
        reason
        for name, fields in (("calibration set", calibration_set), ("control set", control_set))
        if fields is not None and (figures := _complete(fields)) is not None
        for reason in poor_figures(name, figures, has_gyroscope=has_gyroscope)
    ]


def _complete(fields: Mapping[str, Any]) -> Figures | None:
    """The figures of merit in a file; None if a needed figure is missing or not a number."""
    needed = ("rests", "moves", "chi2_per_dof")
    if not all(name in fields and isinstance(fields[name], (int, float, type(None))) for name in needed):
        return None
    return Figures(fields["chi2_per_dof"], None, None, fields["rests"] or 0, fields["moves"] or 0)
