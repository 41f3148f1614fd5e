"""Linear propagation of the covariance to a calibration that is a function of another calibration.

    p' = F(p),    covariance' = J covariance J^T,    J = dF/dp

p are the parameters of the given calibration. p' are the parameters of the calibration that F returns.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.calibration.calibration import Calibration
from imucal.calibration.model import SensorModel
from imucal.calibration.triad import ACCEL_ENTRIES, GYRO_ENTRIES, Triad
from imucal.effects.effect import EffectValues

__all__ = ["jacobian", "known_covariance", "values_of", "with_values"]

# Step of the central difference in an entry of a sensitivity matrix, relative to the largest entry of the
# matrix. The function F that is differentiated is smooth in the sensitivities, so the relative error of the
# derivative is about 1e-9. F is linear in all other parameters, so their step has no effect on the
# derivative.
STEP: Final = 1e-4


def values_of(model: SensorModel) -> FloatArray:
    """The values of all parameters of a model, in the order of `model.parameters`."""
    return np.array([parameter.value for parameter in model.parameters])


def with_values(model: SensorModel, values: FloatArray) -> SensorModel:
    """The model with new values of its parameters, in the order of `model.parameters`."""
    remaining = iter(values.tolist())

    def triad(entries: tuple[str, ...], symmetric: bool) -> Triad:
        bias = np.array([next(remaining) for _ in range(3)])
        matrix = np.zeros((3, 3))
        for entry in entries:
            row, column = ("xyz".index(axis) for axis in entry)
            matrix[row, column] = next(remaining)
            if symmetric:
                matrix[column, row] = matrix[row, column]
        return Triad(matrix, bias)

    accelerometer = triad(ACCEL_ENTRIES[model.frame], model.frame == "symmetric")
    gyroscope = None if model.gyroscope is None else triad(GYRO_ENTRIES, False)
    effects = [
        EffectValues(
            effect.name,
            np.array([next(remaining) for _ in effect.values]),
            None if effect.shape is None else next(remaining),
        )
        for effect in model.effects
    ]
    return SensorModel(
        accelerometer,
        gyroscope,
        model.frame,
        model.accel_unit,
        model.gyro_unit,
        model.gravity_mps2,
        tuple(effects),
        model.user_effects,
        model.axes,
    )


def jacobian(function: Callable[[SensorModel], SensorModel], model: SensorModel) -> FloatArray:
    """Derivative of the parameters of `function(model)` with respect to the parameters of `model`."""
    values = values_of(model)
    columns = []
    sizes = {
        sensor: np.abs(triad.sensitivity).max()
        for sensor, triad in (("accel", model.accelerometer), ("gyro", model.gyroscope))
        if triad is not None
    }
    for k, parameter in enumerate(model.parameters):
        sensor, _, rest = parameter.name.partition("_")
        in_sensitivity = rest.startswith("sensitivity_")
        # The step of all other parameters is half of their value. A larger step could make the shape (time
        # constant) of an effect negative.
        step = STEP * sizes[sensor] if in_sensitivity else abs(parameter.value) / 2 or 1e-3
        up, down = values.copy(), values.copy()
        up[k] += step
        down[k] -= step
        change = values_of(function(with_values(model, up))) - values_of(function(with_values(model, down)))
        columns.append(change / (up[k] - down[k]))
    return np.column_stack(columns)


def known_covariance(calibration: Calibration) -> FloatArray | None:
    """The covariance of all parameters; None if it is incomplete.

    Time constants of effects may be missing in the covariance of the file. The result then has zeros in their
    rows and columns.
    """
    if calibration.covariance is None:
        return None
    names = [parameter.name for parameter in calibration.parameters]
    shapes = {
        f"{values.name}_{shape.name}"
        for values in calibration.effects
        if (shape := calibration.definition(values).shape) is not None
    }
    if not set(names) - shapes <= set(calibration.covariance_names):
        return None
    index = {name: k for k, name in enumerate(calibration.covariance_names)}
    known = [k for k, name in enumerate(names) if name in index]
    places = [index[names[k]] for k in known]
    full = np.zeros((len(names), len(names)))
    full[np.ix_(known, known)] = calibration.covariance[np.ix_(places, places)]
    return full
