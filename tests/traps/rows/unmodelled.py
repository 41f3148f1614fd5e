"""Traps of the unit: effects that the model of a plain calibration lacks."""

import functools

import imucal
from imucal import EffectValues, Program
from recordings import calibrating, same
from trap import good, incomplete, poor, refused

KIND = "the unit has an effect that the model lacks"

# Values of each effect in SI units: a few times the typical size, above what the noise of a run hides.
VALUES = {
    "gyro_g_sensitivity": [3e-4, 0.0, 1e-4, 0.0, -2e-4, 0.0, 1e-4, 0.0, 3e-4],
    "gyro_scale_quadratic": [1e-3, -2e-3, 1e-3],
    "gyro_scale_cubic": [1e-3, 1e-3, -1e-3],
    "gyro_scale_asymmetry": [5e-3, -5e-3, 3e-3],
    "accel_scale_quadratic": [5e-4, -5e-4, 3e-4],
    "accel_scale_cubic": [1e-4, 5e-5, -1e-4],
    "accel_scale_asymmetry": [3e-3, -3e-3, 2e-3],
    "gyro_bias_drift": [2e-5, -1e-5, 2e-5],
    "gyro_scale_drift": [1e-4, -1e-4, 5e-5],
    "accel_bias_drift": [5e-4, -5e-4, 3e-4],
    "gyro_time_offset": [5e-3],
    "accel_lever_arm": [0.05, -0.03, 0.02],
}
NOISE = {
    "gyro_bias_random_walk": [2e-4] * 3,
    "accel_bias_random_walk": [3e-3] * 3,
    "rest_not_still": [2e-3],
    "clock_irregular": [2e-3],
}

# Beginnings of the names of parameters that are not constant with an effect.
CHANGES = {
    "gyro_bias_drift": ("gyro_bias",),
    "gyro_bias_random_walk": ("gyro_bias",),
    "gyro_scale_drift": ("gyro_sensitivity",),
    "accel_bias_drift": ("accel_bias",),
    "accel_bias_random_walk": ("accel_bias",),
}


@functools.cache
def run(name, factor):
    values = {**VALUES, **NOISE}[name]
    program = Program.random(seed=4, moves=30, hold_s=2.0)
    effect = EffectValues(name, [factor * value for value in values])
    return imucal.simulate(program, unit="paper", effects=[effect], rate_hz=100, seed=4)


def trap(name, factor):
    return calibrating(
        KIND,
        f"{name}, {factor:g} times",
        same,
        incomplete(),
        poor(),
        good(),
        refused("clock_irregular"),
        run=functools.partial(run, name, factor),
        changing=CHANGES.get(name, ()),
    )


TRAPS = tuple(
    trap(name, factor)
    for name in (*VALUES, *NOISE)
    for factor in (1.0, 0.2)
    # A fifth is hidden by the noise of this run, and resembles a bias: the residuals do not show it.
    if (name, factor) != ("accel_scale_asymmetry", 0.2)
)
