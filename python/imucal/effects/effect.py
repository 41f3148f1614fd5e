"""Effects: systematic errors of a sensor beyond sensitivity and bias.

    measured = T (true + sum of Phi(state) theta) + bias          docs/model.md (15)

T is the sensitivity of the sensor. An effect has a name, a sensor, p parameters theta with units and typical
sizes, and a field Phi. At each sample, Phi is a matrix (3, p): the derivatives of the error that the effect
adds to the true rate or force, in the body frame, with respect to the parameters.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from imucal.arrays import FloatArray, as_rows
from imucal.errors import InputError

__all__ = ["Alias", "Effect", "EffectParameter", "EffectValues"]


@dataclass(frozen=True)
class EffectParameter:
    """A parameter of an effect: its name within the effect, SI unit, and typical size in a MEMS sensor."""

    name: str
    unit: str
    typical: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.typical) and self.typical > 0):
            raise InputError(
                f"the typical size of parameter {self.name!r} is {self.typical}: a positive number is needed"
            )


@dataclass(frozen=True)
class Alias:
    """Another effect with similar residuals, and the data that distinguish the two effects."""

    name: str
    told_apart_by: str


@dataclass(frozen=True)
class Effect:
    """One effect of the catalogue.

    sensor      "accelerometer", "gyroscope" or "encoder"
    parameters  the parameters, in the order of the columns of the field Phi
    plain       number of parameters of the plain form, which has only the first parameters of the effect. The
                full form has all parameters. The number of parameters of every form is a multiple of `plain`
    shape       the positive parameter on which the field depends nonlinearly, such as a time constant; None
                if the field is linear in all parameters
    needs       inputs of the field other than rate and force: "angular_acceleration", "attitude",
                "temperature", "time", ...
    formula     formula of the error that the effect adds, as text
    observable  the data in which the effect is observable
    aliases     other effects with similar residuals
    """

    name: str
    sensor: str
    parameters: tuple[EffectParameter, ...]
    plain: int
    shape: EffectParameter | None
    needs: tuple[str, ...]
    formula: str
    observable: str
    aliases: tuple[Alias, ...]

    @property
    def forms(self) -> dict[str, int]:
        """Number of parameters of each form except the plain form, such as {"6": 6, "full": 9}."""
        full = len(self.parameters)
        between = {str(count): count for count in range(2 * self.plain, full, self.plain)}
        return between | ({"full": full} if self.plain < full else {})


@dataclass(frozen=True, eq=False)
class EffectValues:
    """Values of an effect: `values` (p,) in the order of the parameters, and the value of the shape, or None.

    The shape is the parameter on which the field depends nonlinearly, such as a time constant.

    Raises InputError if a value is not finite, or if the shape is not positive.
    """

    name: str
    values: FloatArray
    shape: float | None = None

    def __post_init__(self) -> None:
        values = as_rows(self.values, f"the values of {self.name}")
        if not np.isfinite(values).all():
            raise InputError(
                f"the values of {self.name} contain {values[~np.isfinite(values)][0]}: finite numbers are "
                "needed"
            )
        if self.shape is not None and not (math.isfinite(self.shape) and self.shape > 0):
            raise InputError(f"the shape of {self.name} is {self.shape}: a positive number is needed")
        # The array is copied, so that a later change of the caller's array does not change a calibration.
        values = values.copy()
        values.flags.writeable = False
        object.__setattr__(self, "values", values)
