"""Figures of a calibration on a set of recordings: their text, and when they make a verdict poor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

__all__ = ["figures_text", "poor_figures", "saved_reasons", "used_of"]

# Largest chi2 per degree of freedom of a good verdict: residuals of 10 times the noise. Beyond it, model
# errors instead of noise dominate the result.
POOR_CHI2_PER_DOF: Final = 100.0

# Figure: its words and its unit.
FIGURE_TEXT: Final = {
    "gravity_norm_rms_mps2": ("|f| - g", "m/s^2 rms"),
    "gravity_direction_rms_deg": ("gravity direction per move", "deg rms"),
    "chi2_per_dof": ("chi2 per degree of freedom", ""),
}


def figures_text(figures: Mapping[str, Any]) -> str:
    """The figures in words, with their units."""
    parts = [
        f"{words} {figures[name]:.4g} {unit}".rstrip()
        for name, (words, unit) in FIGURE_TEXT.items()
        if figures.get(name) is not None
    ]
    return ", ".join(parts)


def used_of(items: Sequence[Mapping[str, Any]]) -> str:
    """How many rests or moves are used, of how many."""
    return f"{sum(item['excluded'] is None for item in items)} of {len(items)}"


def poor_figures(name: str, figures: Mapping[str, Any], not_corrected: str = "") -> list[str]:
    """Reasons why these figures make a verdict poor; empty if they do not.

    name           the set of recordings: "calibration set" or "control set"
    not_corrected  which samples could not be corrected and why, if known
    """
    if not figures["moves"]:
        return [
            f"{name}: {figures['rests']} usable rests and no usable move: the gyroscope is not judged, "
            "record rests in different poses with moves between them"
        ]
    chi2 = figures["chi2_per_dof"]
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
    needed = ("rests", "moves", "chi2_per_dof")
    # A file written by another program may lack figures or hold other types.
    return [
        reason
        for name, figures in (("calibration set", calibration_set), ("control set", control_set))
        if figures is not None
        and all(name in figures and isinstance(figures[name], (int, float, type(None))) for name in needed)
        for reason in poor_figures(name, figures)
    ]
