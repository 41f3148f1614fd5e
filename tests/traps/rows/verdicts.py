"""Traps of the verdict: what the model lacks, and calibrations that do not belong to a recording."""

from dataclasses import replace

import numpy as np

import imucal
from changes import changed, stand_run
from recordings import calibrating, same
from trap import Question, Trap, good, incomplete, poor, refused

# Sizes of typical effects of sensors, which a linear model lacks, and the kind of residual that shows them.
LACKING = (
    ("gyro_g_sensitivity", np.full(9, np.radians(0.1) / 9.80665), "gravity direction after the moves"),
    (
        "gyro_g_sensitivity",
        np.radians([0.2, 0, 0, 0, -0.2, 0, 0, 0, 0.2]) / 9.80665,
        "mean rates at the rests",
    ),
    ("accel_scale_quadratic", [1e-3, -8e-4, 6e-4], "norm of gravity at the rests"),
    ("accel_scale_cubic", [3e-5, -3e-5, 2e-5], "norm of gravity at the rests"),
    ("gyro_scale_quadratic", [5e-3, 5e-3, -5e-3], "gravity direction after the moves"),
    ("gyro_bias_drift", [1e-4, -1e-4, 5e-5], "mean rates|gravity direction"),
    ("accel_bias_drift", [4e-4, -2e-4, 2e-4], "norm of gravity at the rests"),
)


def lacking(name, values, says, unit="paper"):
    program = imucal.Program.random(seed=1, moves=30, hold_s=2.0)
    run = imucal.simulate(program, unit=unit, rate_hz=100, seed=1, effects={name: np.asarray(values, float)})
    return run, says


def with_effect(k, name, values, says):
    def run():
        return lacking(name, values, says)[0]

    return calibrating(
        "the unit has an effect that the model lacks",
        f"{name}, case {k + 1}",
        same,
        incomplete(says),
        poor(),
        run=run,
    )


def with_the_effect(k, name, values, says):
    def run():
        return lacking(name, values, says)[0]

    return calibrating(
        "the effect is in the model",
        f"{name}, case {k + 1}",
        same,
        good(),
        run=run,
        effects=[name],
    )


def clean(unit, seed):
    def run():
        return stand_run(seed, unit)

    return calibrating("nothing is missing", f"{unit}, seed {seed}", same, good(), run=run)


def evaluating(name, change, *right):
    """Evaluates a changed calibration on a control run of its unit."""

    def make(folder):
        calibration = imucal.calibrate(changed(stand_run(1).recording)).calibration
        change(calibration).save(folder / "cal.json")
        imucal.write(changed(stand_run(2).recording), folder / "control.parquet")
        words = ["evaluate", str(folder / "cal.json"), str(folder / "control.parquet")]

        def call():
            loaded = imucal.Calibration.load(folder / "cal.json")
            return imucal.evaluate(loaded, imucal.read(folder / "control.parquet"))

        return Question(words, call)

    return Trap("a calibration is not that of the unit", name, make, right)


def with_gyroscope(change, bias=0.0):
    """The calibration with another gyroscope, without its covariance, which would contradict it."""

    def changed_calibration(calibration):
        triad = imucal.Triad(change(calibration.gyroscope.sensitivity), calibration.gyroscope.bias + bias)
        return replace(
            calibration,
            gyroscope=triad,
            covariance=None,
            covariance_names=(),
            fit={},
            verdict=None,
            reasons=(),
        )

    return changed_calibration


def turned(angle_deg):
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    return lambda matrix: matrix @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


NOT_OF_THE_UNIT = (
    evaluating("its own control run", lambda calibration: calibration, good()),
    *(
        evaluating(
            f"sensitivity of the gyroscope times {factor:g}",
            with_gyroscope(lambda matrix, factor=factor: factor * matrix),
            incomplete("gravity direction"),
            poor(),
            refused("sensitivity|gyro|scale"),
        )
        for factor in (1.003, 0.98, 1.1, 3.0, 0.4)
    ),
    *(
        evaluating(
            f"gyroscope rotated by {angle:g} deg",
            with_gyroscope(turned(angle)),
            incomplete("gravity direction"),
            poor(),
            refused("."),
        )
        for angle in (1.0, 10.0)
    ),
    *(
        evaluating(
            f"bias of the gyroscope off by {np.degrees(bias):.2g} deg/s",
            with_gyroscope(lambda matrix: matrix, bias),
            incomplete("gravity direction"),
            poor(),
        )
        for bias in (0.005, 0.05)
    ),
)

TRAPS = (
    *(with_effect(k, *case) for k, case in enumerate(LACKING)),
    *(with_the_effect(k, *case) for k, case in enumerate(LACKING[:3])),
    *(clean(unit, seed) for unit in ("paper", "bmi088", "mpu6050", "lsm6dso") for seed in (21, 22)),
    *NOT_OF_THE_UNIT,
)
