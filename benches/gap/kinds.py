"""Which data show an effect.

A: rests and moves by hand. A': on a stand, so that the accelerometer counts within the moves, too. C: also
encoders. With T the temperature is recorded and changes.
"""

from pathlib import Path
from typing import Final

# The data in which an effect is hidden.
KINDS: Final = {
    "gyro_g_sensitivity": "A'",
    "gyro_g2_sensitivity": "A'",
    "gyro_scale_quadratic": "A'",
    "gyro_scale_cubic": "A'",
    "gyro_scale_asymmetry": "A'",
    "gyro_cross_axis_quadratic": "A'",
    "gyro_scale_g_sensitivity": "A'",
    "gyro_bias_temperature": "A'T",
    "gyro_scale_temperature": "A'T",
    "gyro_bias_drift": "A'",
    "gyro_bias_warmup": "A'",
    "gyro_scale_drift": "A'",
    "gyro_angular_acceleration": "A'",
    "gyro_time_offset": "A'",
    "earth_rate": "A'",
    "accel_scale_quadratic": "A'",
    "accel_scale_cubic": "A'",
    "accel_scale_asymmetry": "A'",
    "accel_cross_axis_quadratic": "C",
    "accel_bias_temperature": "A'T",
    "accel_scale_temperature": "A'T",
    "accel_bias_drift": "A'",
    "accel_bias_warmup": "A'",
    "accel_lever_arm": "A'",
    "accel_size_effect": "A'",
    "encoder_eccentricity": "C",
    "encoder_time_offset": "C",
    "encoder_backlash": "C",
}  # fmt: skip
# Effects that only the force inside moves shows.
ON_STAND: Final = ("gyro_time_offset", "accel_lever_arm", "accel_size_effect")
LIMITS: Final = Path(__file__).with_name("limits.json")


def shown(kind: str) -> list[str]:
    """Effects that data of this kind show."""
    return [
        name
        for name in KINDS
        if (kind == "C" or not name.startswith("encoder")) and (kind != "A" or name not in ON_STAND)
    ]
