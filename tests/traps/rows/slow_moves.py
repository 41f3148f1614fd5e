"""Traps of slow moves that begin and end smoothly: noise hides their first and last second."""

import numpy as np
from scipy.linalg import polar

import imucal
from imucal import Recording
from simulated_hand import ACCEL_BIAS, ACCEL_SENSITIVITY, GYRO_BIAS, GYRO_SENSITIVITY, Hand
from trap import Question, Trap, good, incomplete, poor

KIND = "moves begin and end too slowly to be seen"


def slow_run(move_s: float, hold_s: float, seed: int) -> Recording:
    """Seventeen rests at 100 Hz. The angle of a move first grows with the cube of the time."""
    unit, random = Hand(seed=seed, tremor_deg=0.0).hold(hold_s), np.random.default_rng(seed)
    for pose in range(16):
        # The first six poses have an axis vertical.
        up = np.roll([(-1.0) ** (pose // 3), 0.0, 0.0], pose) if pose < 6 else random.normal(size=3)
        unit.turn_to(up + random.normal(scale=0.1, size=3), move_s).hold(hold_s)
    rows = unit.rows()
    return Recording(1e-6 * rows[:, 0], rows[:, 1:4], rows[:, 4:], name="run")


def truth() -> dict[str, float]:
    """The true parameters in the frame in which the sensitivity of the accelerometer is symmetric."""
    rotation, symmetric = polar(ACCEL_SENSITIVITY, side="left")
    known = {}
    for sensor, bias, sensitivity in (
        ("accel", ACCEL_BIAS, symmetric),
        ("gyro", GYRO_BIAS, GYRO_SENSITIVITY @ rotation.T),
    ):
        for i, row in enumerate("xyz"):
            known[f"{sensor}_bias_{row}"] = bias[i]
            known |= {f"{sensor}_sensitivity_{row}{c}": sensitivity[i, j] for j, c in enumerate("xyz")}
    return known


def trap(move_s: float, hold_s: float, seed: int) -> Trap:
    def make(folder):
        path = folder / "run.parquet"
        imucal.write(slow_run(move_s, hold_s, seed), path)
        return Question(["calibrate", path], lambda: imucal.calibrate(imucal.read(path)), truth())

    name = f"moves of {move_s:g} s, rests of {hold_s:g} s, seed {seed}"
    # With moves of 20 s, the parts that noise hides are too long.
    right = (good(),) if move_s < 20.0 else (good(), incomplete(), poor())
    return Trap(KIND, name, make, right)


TRAPS = tuple(
    trap(move_s, hold_s, seed)
    for move_s in (2.0, 6.0, 9.0, 12.0, 20.0)
    for hold_s in (3.0, 6.0)
    for seed in (1, 2, 3)
)
