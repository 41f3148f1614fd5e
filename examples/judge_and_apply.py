"""Judge a calibration on a control recording, which the fit does not use, and correct samples with it."""

import numpy as np

import imucal

run = imucal.simulate("random", seed=1).recording
control = imucal.simulate("random", seed=2).recording

result = imucal.calibrate(run, control=control)
before, after = result.control_before, result.control_set
print(f"gravity direction per move, uncalibrated: {before.gravity_direction_rms_deg:.3f} deg rms")
print(f"gravity direction per move, calibrated:   {after.gravity_direction_rms_deg:.3f} deg rms")
print(f"verdict: {result.verdict}")

# A later program needs only the file.
result.calibration.save("unit.json")
calibration = imucal.Calibration.load("unit.json")
rate, force = calibration.apply(control.angular_rate, control.specific_force)
first_second = control.time_s < 1.0
print(f"|f| at rest: {np.linalg.norm(force[first_second].mean(axis=0)):.4f} m/s^2")
