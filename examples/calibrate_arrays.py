"""Calibrate a recording that is already in memory as NumPy arrays."""

import numpy as np

import imucal


def my_recording() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Your own reader: time (N,) in s, specific force (N, 3) in m/s^2, angular rate (N, 3) in rad/s."""
    run = imucal.simulate("random", seed=7, gravity_mps2=9.8124).recording
    return run.time_s, run.specific_force, run.angular_rate


time_s, specific_force, angular_rate = my_recording()
recording = imucal.Recording(time_s, specific_force, angular_rate, name="bench 3, unit 42")

# All accelerometer scales are proportional to gravity, so give the local value.
try:
    result = imucal.calibrate(recording, gravity_mps2=9.8124, serial_number="42")
except imucal.ImucalError as error:
    # The message says what is wrong, where, and what to do about it.
    raise SystemExit(str(error)) from None

print(result.summary())
result.calibration.save("unit-0042.json")
