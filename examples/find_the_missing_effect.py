"""A gyroscope that feels force: find it, take it away, and see on another run what that is worth."""

from __future__ import annotations

import imucal

# What nobody knows: the gyroscope's bias moves with force.
SECRET = {"gyro_g_sensitivity": "typical"}

run = imucal.simulate("random", seed=11, rate_hz=100.0, effects=SECRET)
control = imucal.simulate("random", seed=12, rate_hz=100.0, effects=SECRET)

gap = imucal.find_gap(run.recording, control=control.recording)
print(gap.summary())

# Where it was: the channels that noise does not explain, and what they go with.
for row in gap.where["channels"]:
    if row["stands_out"]:
        change = f"{row['times_noise']:.1f} -> {row['times_noise_after']:.1f} times noise"
        print(f"{row['channel']} {row['axis']}: {change}")

# What it is worth, and what an effect that was not found would have looked like.
claimed = gap.corrected_error["angular_rate_rms_radps"]
print(f"claimed: {claimed['before'] / claimed['after']:.1f} times less error of the corrected rate")
print("\n".join(gap.explain("accel_scale_quadratic")))

gap.calibration.save("improved.json")
