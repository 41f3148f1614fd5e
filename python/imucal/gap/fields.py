"""Fields of the result of a search for effects: a base class that `text` can import without `Gap`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from imucal.calibration.calibration import Calibration
from imucal.effects.definition import UserEffect
from imucal.estimation.result import CalibrationResult
from imucal.finding import Finding
from imucal.gap.laws.law import Law
from imucal.gap.remainder import Remainder

__all__ = ["GapFields"]


@dataclass(frozen=True, eq=False, repr=False)
class GapFields:
    """Fields of a `Gap`. Their meaning is described in the docstring of `Gap`."""

    verdict: str
    effects: tuple[Mapping[str, Any], ...] = ()
    ambiguous_with: tuple[str, ...] = ()
    resembles: tuple[str, ...] = ()
    generic: Mapping[str, Any] | None = None
    remainder: Remainder | None = None
    laws: tuple[Law, ...] = ()
    not_observable: tuple[Mapping[str, str], ...] = ()
    smallest_visible: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    next_motion: Mapping[str, Any] | None = None
    gap: Mapping[str, Any] | None = None
    where: Mapping[str, Any] | None = None
    corrected_error: Mapping[str, Mapping[str, float]] | None = None
    traces: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    calibration_set: Mapping[str, Any] | None = None
    control_set: Mapping[str, Any] | None = None
    held_out: Mapping[str, Any] | None = None
    fits: Mapping[str, CalibrationResult] = field(default_factory=dict)
    calibration: Calibration | None = None
    ranking: tuple[Mapping[str, Any], ...] = ()
    findings: tuple[Finding, ...] = ()
    notes: tuple[str, ...] = ()
    user_effects: tuple[UserEffect, ...] = ()
    is_hand_moved: bool = False

    @property
    def has_effects(self) -> bool:
        """Whether effects or laws were added to the model; `effects` may also list faults of the data."""
        return bool(self.laws) or any(effect["parameters"] for effect in self.effects)
