"""Fits effects, one at a time, to the recordings of a unit, for the search over all units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from imucal.arrays import FloatArray
from imucal.effects.table import find
from imucal.errors import ImucalError
from imucal.estimation.calibrate import calibrate
from imucal.io import read

__all__ = ["Fitted", "UnitFiles", "fitted_effects"]


@dataclass(frozen=True)
class UnitFiles:
    """The recordings of a unit, with the arguments for reading and calibrating them.

    read, calibrate   arguments of `imucal.read` and `imucal.calibrate`
    """

    serial: str
    files: tuple[str, ...]
    read: Mapping[str, Any] = field(default_factory=dict)
    calibrate: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Fitted:
    """Values (k,) and covariance (k, k) of the parameters of one effect in one unit."""

    values: FloatArray
    covariance: FloatArray


def fitted_effects(
    unit: UnitFiles, effects: Sequence[str], beside: Sequence[str] = ()
) -> tuple[str, dict[str, Fitted], str]:
    """Fit each effect to the recordings of a unit.

    Returns the serial number, the fits of the effects that the recordings determine, and an error message.
    The message is empty if at least one effect is determined.

    beside   effects that are estimated together with each of `effects`
    """
    found: dict[str, Fitted] = {}
    try:
        recordings = [read(path, **unit.read) for path in unit.files]
    except ImucalError as error:
        return unit.serial, found, str(error)
    error_of_all = ""
    for name in effects:
        try:
            result = calibrate(recordings, **{**unit.calibrate, "effects": [*beside, name]})
        except ImucalError as error:
            # The recordings do not determine this effect, or lack a column on which the effect depends.
            error_of_all = str(error)
            continue
        fitted = _fitted(result.calibration, name)
        if fitted is not None:
            found[name] = fitted
    return unit.serial, found, "" if found else error_of_all


def _fitted(calibration: Any, effect: str) -> Fitted | None:
    """The fitted linear parameters of an effect; None if the fit gives no covariance for them."""
    wanted = [f"{effect}_{parameter.name}" for parameter in find(effect).parameters]
    place = {name: index for index, name in enumerate(calibration.covariance_names)}
    own = [parameter for parameter in calibration.parameters if parameter.name in wanted]
    own = [parameter for parameter in own if parameter.name in place and parameter.std]
    if not own or calibration.covariance is None:
        return None
    rows = [place[parameter.name] for parameter in own]
    covariance = calibration.covariance[np.ix_(rows, rows)]
    return Fitted(np.array([parameter.value for parameter in own]), np.asarray(covariance))
