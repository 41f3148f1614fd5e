"""Estimates of parameters with a prior (held parameters, model.md (40)), and the effect of the priors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING, Any, Final

from imucal.estimation.rests import of_library

if TYPE_CHECKING:
    import imucal._core as _core

__all__ = ["HeldParameter", "PriorShare", "Priors"]

# A note lists each parameter that is not held itself, but has more than this share of its variance from the
# priors of held parameters.
NOTED_SHARE: Final = 0.1
SOURCES: Final = {"given": "given", "unit": "of the unit's profile", "default": "default for MEMS sensors"}


@dataclass(frozen=True, slots=True)
class HeldParameter:
    """The prior of a held parameter, and the estimate of this parameter, in the symmetric body frame.

    name           such as accel_misalignment_xy: accel_ or gyro_, then bias, scale or misalignment, then the
                   axes
    unit           the raw unit for a bias, 1 for a scale relative to its nominal value, rad for misalignment
    prior_value    mean of the prior
    prior_sigma    standard deviation of the prior
    prior_source   origin of `prior_sigma`: "given", "unit" (the unit's profile) or "default"
    estimate       estimate from recordings and prior
    sigma          standard deviation of the estimate
    prior_share    share of the variance of the estimate that comes from the priors; 1 if the recordings
                   contain no information about the parameter
    contradiction  difference between the prior value and the estimate from the recordings, in standard
                   deviations of this difference; None if the recordings determine the parameter less
                   accurately than the spread of MEMS sensors
    """

    name: str
    unit: str
    prior_value: float
    prior_sigma: float
    prior_source: str
    estimate: float
    sigma: float
    prior_share: float
    contradiction: float | None

    @property
    def group(self) -> str:
        """The name of the parameter without its axes, such as accel_misalignment."""
        return self.name.rpartition("_")[0]


@dataclass(frozen=True, slots=True)
class PriorShare:
    """Share of the variance of a parameter that comes from the priors of held parameters."""

    name: str
    share: float


@dataclass(frozen=True, slots=True)
class Priors:
    """The priors of an estimation, and their contributions to its uncertainty.

    model                  "full", "orthogonal" or "bias"
    held                   the held parameters
    shares                 for each parameter of the calibration, the share of its variance that comes from
                           the priors
    gravity_direction_deg  error of a measured gravity direction due to the uncertainty of the priors, deg (1
                           sigma)
    rotation_deg           error of a measured rotation by 90 deg due to the uncertainty of the priors, deg (1
                           sigma); None without a gyroscope
    """

    model: str
    held: tuple[HeldParameter, ...]
    shares: tuple[PriorShare, ...]
    gravity_direction_deg: float
    rotation_deg: float | None

    @staticmethod
    def of_outcome(
        outcome: _core.Outcome, model: str, names: Sequence[str], raw_units: tuple[str, str]
    ) -> Priors | None:
        """The priors in an outcome of the compiled library; None if no parameter is held.

        names      names of all parameters
        raw_units  raw units of the accelerometer and of the gyroscope
        """
        if outcome.prior_cost is None:
            return None
        held = tuple(
            of_library(HeldParameter, {**fields, "unit": _unit(fields["name"], raw_units)})
            for fields in outcome.held
        )
        shares = zip(names, outcome.prior_shares, strict=True)
        return Priors(model, held, tuple(PriorShare(*share) for share in shares), **outcome.prior_cost)

    @property
    def notes(self) -> list[str]:
        """Sentences on the held parameters, and on the variances and errors that come from the priors."""

        def key(held: HeldParameter) -> tuple[Any, ...]:
            return held.group, held.prior_value, held.prior_sigma, held.prior_source, held.unit

        notes = []
        for (group, value, sigma, source, unit), members in groupby(self.held, key):
            own = list(members)
            axes = ", ".join(held.name.removeprefix(f"{group}_") for held in own)
            estimates = ", ".join(f"{held.estimate:.3g} +- {held.sigma:.2g}" for held in own)
            shares = [held.prior_share for held in own]
            low, high = f"{100 * min(shares):.0f}", f"{100 * max(shares):.0f}"
            share = low if low == high else f"{low} to {high}"
            suffix = "" if unit == "1" else f" {unit}"
            notes.append(
                f"{group} {axes} held by the prior {value:g} +- {sigma:.3g}{suffix} ({SOURCES[source]}): "
                f"estimated {estimates}{suffix}; {share} % of the variance comes from the prior"
            )
        names = {held.group.replace("misalignment", "sensitivity") for held in self.held}
        others = [
            f"{item.name} {100 * item.share:.0f} %"
            for item in self.shares
            if item.share > NOTED_SHARE and not self._is_held(item.name, names)
        ]
        if others:
            notes.append(
                f"share of the priors in the variance of parameters that are not held: {', '.join(others)}"
            )
        notes.append(
            f"the priors leave an error (1 sigma) of {self.gravity_direction_deg:.2g} deg in the direction "
            "of gravity"
            + (
                ""
                if self.rotation_deg is None
                else f" and of {self.rotation_deg:.2g} deg in a rotation by 90 deg"
            )
        )
        return notes

    @staticmethod
    def _is_held(name: str, groups: set[str]) -> bool:
        """Whether a parameter of the calibration belongs to one of the held groups."""
        group, _, axes = name.rpartition("_")
        if group.endswith("sensitivity"):
            scale = group.replace("sensitivity", "scale")
            return scale in groups if len(set(axes)) == 1 else group in groups
        return group in groups


def _unit(name: str, raw_units: tuple[str, str]) -> str:
    if "_bias_" in name:
        return raw_units[name.startswith("gyro")]
    return "1" if "_scale_" in name else "rad"
