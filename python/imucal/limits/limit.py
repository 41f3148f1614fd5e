"""A single limit: on a parameter, on a group of parameters, or on a figure of a set of recordings."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

from imucal.calibration.calibration import Calibration
from imucal.calibration.triad import Parameter
from imucal.errors import InputError
from imucal.limits.judgement import Check

__all__ = ["COUNTS", "FIGURES", "FigureLimit", "ParameterLimit"]

# Figures of merit that can have a maximum, with their units. The figures in `COUNTS` can have a minimum.
FIGURE_UNITS: Final = {
    "chi2_per_dof": "",
    "gravity_norm_rms_mps2": "m/s^2",
    "gravity_direction_rms_deg": "deg",
}
COUNTS: Final = ("rests", "moves")
# Figures that may have a limit, by set of recordings.
FIGURES: Final[dict[str, tuple[str, ...]]] = {
    "calibration_set": (*FIGURE_UNITS, *COUNTS),
    "control_set": (*FIGURE_UNITS, *COUNTS),
    "held_out": ("gravity_direction_rms_deg",),
}
# For each set of recordings, the reason that a failed check states if this set is missing.
MISSING: Final = {
    "calibration_set": "the calibration has no figures of its calibration recordings",
    "control_set": "there is no control recording: give one with --control",
    "held_out": "there is no held-out figure (calibration files have none): give --folds to calibrate",
}


@dataclass(frozen=True)
class ParameterLimit:
    """A range, a maximum standard deviation, or both, for a parameter or a group of parameters.

    name       a parameter, such as gyro_bias_x; `*` matches any part without an underscore: gyro_bias_*
    unit       unit of the numbers; a parameter in another unit fails the limit
    low, high  minimum and maximum; either both are given or neither
    """

    name: str
    unit: str
    low: float | None = None
    high: float | None = None
    max_std: float | None = None

    def __post_init__(self) -> None:
        if (self.low is None) != (self.high is None):
            raise InputError(f"the limit of {self.name} has only one end of its range: give min and max")
        if self.low is None and self.max_std is None:
            raise InputError(
                f"the limit of {self.name} has neither a range nor max_std: give min and max, or max_std"
            )
        if self.low is not None and self.high is not None and not self.low < self.high:
            raise InputError(
                f"the limit of {self.name} has min {self.low} and max {self.high}: min must be less than max"
            )
        if self.max_std is not None and not self.max_std > 0:
            raise InputError(f"the limit of {self.name} has max_std {self.max_std}: it must be positive")

    def covers(self, name: str) -> bool:
        """Whether this limit applies to the parameter with this name."""
        # For example, gyro_bias_* matches gyro_bias_x but not gyro_bias_temperature_x.
        return re.fullmatch(re.escape(self.name).replace(r"\*", "[^_]+"), name) is not None

    def checks(self, calibration: Calibration) -> list[Check]:
        """The checks of all parameters to which the limit applies."""
        covered = [parameter for parameter in calibration.parameters if self.covers(parameter.name)]
        if not covered:
            carried = ", ".join(values.name for values in calibration.effects) or "none"
            problem = (
                f"the calibration has no parameter {self.name} (frame {calibration.frame}, effects {carried})"
            )
            most = self.max_std if self.low is None else self.high
            return [Check(self.name, None, self.low, most, self.unit, problem=problem)]
        return [check for parameter in covered for check in self._of(parameter)]

    def _of(self, parameter: Parameter) -> list[Check]:
        name, std = parameter.name, parameter.std
        same_unit = parameter.unit == self.unit
        other_unit = "" if same_unit else f"{name} is in {parameter.unit}, its limit in {self.unit}"
        checks = []
        if self.low is not None:
            checks.append(
                Check(name, parameter.value, self.low, self.high, parameter.unit, std, problem=other_unit)
            )
        if self.max_std is not None:
            problem = other_unit or (f"the std of {name} is not known" if std is None else "")
            checks.append(Check(f"std of {name}", std, None, self.max_std, parameter.unit, problem=problem))
        return checks


@dataclass(frozen=True)
class FigureLimit:
    """A maximum figure of merit on a set of recordings, or a minimum number of rests or moves in this set.

    of      "calibration_set", "control_set" or "held_out"
    figure  one of `FIGURES[of]`
    limit   the minimum for "rests" and "moves", the maximum for all others
    """

    of: str
    figure: str
    limit: float

    def __post_init__(self) -> None:
        if self.figure not in FIGURES.get(self.of, ()):
            raise InputError(f"{self.of} has no figure {self.figure} that a limit could be for")
        if not (math.isfinite(self.limit) and self.limit > 0):
            raise InputError(f"the limit of {self.of} {self.figure} is {self.limit}: it must be positive")
        if self.figure in COUNTS and self.limit != int(self.limit):
            raise InputError(
                f"the limit of {self.of} {self.figure} is {self.limit}: a whole number is needed"
            )

    def check(self, figures: Mapping[str, Any] | None) -> Check:
        """The check of the limit on `figures`, which is None if the set of recordings is missing."""
        value = None if figures is None else figures.get(self.figure)
        exists = isinstance(value, (int, float)) and not isinstance(value, bool)
        what = f"{self.of} {self.figure}"
        problem = MISSING[self.of] if figures is None else "" if exists else f"{what} does not exist"
        low, high = (self.limit, None) if self.figure in COUNTS else (None, self.limit)
        number = float(value) if exists and value is not None else None
        unit = FIGURE_UNITS.get(self.figure, "")
        return Check(what, number, low, high, unit, problem=problem)
