"""Description of the remainder of a search (the residuals that the accepted effects do not explain)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import imucal._core as _core
import imucal.gap.notes as notes
from imucal.estimation.result import CalibrationResult
from imucal.gap.remainder import Remainder

__all__ = ["described"]

# If chi2 per degree of freedom of a calibration is larger than this number, the fit is poor. The compiled
# library uses the same threshold.
POOR_CHI2_PER_DOF: Final = 100.0

Described = tuple[Remainder, Mapping[str, Any] | None, list[str]]


def described(analysis: _core.GapAnalysis, after: CalibrationResult) -> Described:
    """The remainder; its pattern in the form of `Gap.generic`; and, as notes, the reasons for a poor fit."""
    found, search = analysis.remainder, analysis.search
    session, reasons = notes.session_of(analysis.session), notes.misfits(after)
    generic = notes.generic_of(search.generic)
    if generic is None and found.kind != "nothing":
        generic = notes.scatter_of(search.scattering_rests)
    if generic is None and found.pattern == "between_sessions" and session is not None:
        words = notes.session_in_words(session)
        # `chi2_per_dof_own` is chi2 per degree of freedom of the control recordings with biases fitted to
        # these recordings. If it is at most POOR_CHI2_PER_DOF, changed biases explain the poor fit, and the
        # other reasons for the poor fit are omitted.
        left = reasons if session.chi2_per_dof_own > POOR_CHI2_PER_DOF else []
        generic = {
            "block": found.block,
            "kernel": found.pattern,
            "description": "; ".join([words, *left]),
        }
        reasons = []
    if generic is None and found.pattern == "not_confirmed":
        generic = notes.not_confirmed_of(analysis)
    if generic is None and found.pattern == "contradiction" and reasons:
        generic, reasons = notes.contradiction_of(reasons), []
    if generic is None and found.pattern == "above_noise":
        generic = notes.above_noise_of(found, after)
    if generic is None:
        generic = notes.fault_of(found.pattern)
    description = None if generic is None else str(generic["description"])
    if session is not None and found.pattern != "between_sessions":
        reasons = [*reasons, notes.session_in_words(session)]
    remainder = Remainder(
        found.kind, found.block, found.pattern, description, found.p_value, found.matters, session
    )
    return remainder, generic, reasons
