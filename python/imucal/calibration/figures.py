"""Figures of a calibration on a set of recordings: their text, and when they make a verdict poor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from imucal.document.plain import plain

__all__ = ["Figures", "figures_text", "poor_figures", "saved_reasons"]

# Largest chi2 per degree of freedom of a good verdict: residuals of 10 times the noise. Beyond it, model
# errors instead of noise dominate the result.
POOR_CHI2_PER_DOF: Final = 100.0

# Figure: its words and its unit.
FIGURE_TEXT: Final = {
    "gravity_norm_rms_mps2": ("|f| - g", "m/s^2 rms"),
    "gravity_direction_rms_deg": ("gravity direction per move", "deg rms"),
    "chi2_per_dof": ("chi2 per degree of freedom", ""),
}


@dataclass(frozen=True, slots=True)
class Figures:
    """Figures of a calibration on a set of recordings.

    chi2_per_dof               chi2 of the residuals at the rests and after the moves, by their noise, per
                               degree of freedom; None if samples could not be corrected
    gravity_norm_rms_mps2      rms of the norm of gravity at a rest minus local gravity, m/s^2
    gravity_direction_rms_deg  rms angle between the gravity direction that the gyroscope propagates over a
                               move and the direction measured after it, deg
    rests, moves               numbers of rests and moves that are used
    """

    chi2_per_dof: float | None
    gravity_norm_rms_mps2: float | None
    gravity_direction_rms_deg: float | None
    rests: int
    moves: int


def figures_text(figures: object) -> str:
    """The figures in words, with their units.

    figures   Figures, HeldOut, or a mapping from a file
    """
    fields = plain(figures)
    parts = [
        f"{words} {fields[name]:.4g} {unit}".rstrip()
        for name, (words, unit) in FIGURE_TEXT.items()
        if fields.get(name) is not None
    ]
    return ", ".join(parts)


def poor_figures(name: str, figures: Figures, not_corrected: str = "") -> list[str]:
    """Reasons why these figures make a verdict poor; empty if they do not.

    name           the set of recordings: "calibration set" or "control set"
    not_corrected  which samples could not be corrected and why, if known
    """
    if not figures.moves:
        return [
            f"{name}: {figures.rests} usable rests and no usable move: the gyroscope is not judged, "
            "record rests in different poses with moves between them"
        ]
    chi2 = figures.chi2_per_dof
    if chi2 is None:
        why = not_corrected or "some of its samples have no correction"
        return [f"{name}: chi2 per degree of freedom has no value, nothing is judged: {why}"]
    if chi2 <= POOR_CHI2_PER_DOF:
        return []
    other = (
        ", or the calibration is another unit's, or the recording is in wrong units"
        if name == "control set"
        else ""
    )
    return [
        f"{name}: residuals are {chi2**0.5:.3g} times what noise explains (more than "
        f"{POOR_CHI2_PER_DOF**0.5:.3g}): the linear model does not describe this unit or this motion{other}"
    ]


def saved_reasons(
    calibration_set: Mapping[str, Any] | None, control_set: Mapping[str, Any] | None
) -> list[str]:
    """Reasons why the figures of a calibration file make its verdict poor; empty if they do not."""
    return [
        reason
        for name, fields in (("calibration set", calibration_set), ("control set", control_set))
        if fields is not None and (figures := _complete(fields)) is not None
        for reason in poor_figures(name, figures)
    ]


def _complete(fields: Mapping[str, Any]) -> Figures | None:
    """The figures of a file; None if one is missing or not a number, as in files of other programs."""
    needed = ("rests", "moves", "chi2_per_dof")
    if not all(name in fields and isinstance(fields[name], (int, float, type(None))) for name in needed):
        return None
    return Figures(fields["chi2_per_dof"], None, None, fields["rests"] or 0, fields["moves"] or 0)
