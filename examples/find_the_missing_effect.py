"""Find the g-sensitivity of a simulated gyroscope, and report the improvement on a control recording."""

from __future__ import annotations

import imucal

# The hidden effect: the bias of the gyroscope depends on the specific force.
SECRET = {"gyro_g_sensitivity": "typical"}

run = imucal.simulate("random", seed=11, rate_hz=100.0, effects=SECRET)
control = imucal.simulate("random", seed=12, rate_hz=100.0, effects=SECRET)

gap = imucal.find_gap(run.recording, control=control.recording)
print(gap.summary())

# The kinds of residuals that exceed the noise, without and with the effect.
for row in gap.where["channels"]:
    if row["stands_out"]:
        change = f"{row['times_noise']:.1f} -> {row['times_noise_after']:.1f} x noise"
        print(f"{row['channel']} {row['axis']}: {change}")

# The predicted improvement, and the residuals that another effect would have caused.
claimed = gap.corrected_error["angular_rate_rms_radps"]
print(f"claimed: {claimed['before'] / claimed['after']:.1f} times smaller error of the corrected rate")
print("\n".join(gap.explain("accel_scale_quadratic")))

gap.calibration.save("improved.json")
