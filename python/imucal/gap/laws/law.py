"""A law: a formula that the recordings support and that no effect of the catalogue describes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

__all__ = ["Curve", "Law"]


@dataclass(frozen=True)
class Curve:
    """The error that a law of one variable describes, as a curve over the range that the recordings cover.

    variable  name of the variable in formulas
    at        values of the variable
    value     the error of the sensor minus its mean over this range, by axis, rad/s or m/s^2
    std       standard deviations of the error by axis, propagated from the parameters
    """

    variable: str
    at: tuple[float, ...]
    value: Mapping[str, tuple[float, ...]]
    std: Mapping[str, tuple[float, ...]]


@dataclass(frozen=True)
class Law:
    """A formula for residuals that no effect of the catalogue describes, with its evidence.

    name              name of the effect in the calibration
    formula           formula in the form of the option `--effect`
    sensor            "gyroscope" or "accelerometer"
    variables         variables on which the formula depends
    parameters        name, value, std and unit of each parameter
    log_bayes_factor  log Bayes factor, nats, minus the penalty for the number of candidates
    stability         share of random halves of the rests and moves for which a repeated selection gives the
                      sensor and variables of this law
    closed            share of the excess chi2 (chi2 beyond noise) that the law removes, for each kind of
                      residual on control or held-out data
    nearest           effects of the catalogue with the largest log Bayes factors in the search without laws
    curve             curve of the law; None if the law depends on several variables
    """

    name: str
    formula: str
    sensor: str
    variables: tuple[str, ...]
    parameters: tuple[Mapping[str, Any], ...]
    log_bayes_factor: float
    stability: float
    closed: Mapping[str, float | None]
    nearest: tuple[str, ...]
    curve: Curve | None

    def to_dict(self) -> dict[str, Any]:
        """An element of the field `laws` of the JSON document."""
        return asdict(self)
