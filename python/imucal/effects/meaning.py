"""Description of each effect of the catalogue: the error it adds, its usual cause, and the remedy."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

__all__ = ["Meaning", "meaning_of"]


@dataclass(frozen=True)
class Meaning:
    """An effect in words.

    what    the error that it adds to the sensor
    cause   the usual cause in a MEMS sensor or its mount
    remedy  what a user can do about the effect
    """

    what: str
    cause: str
    remedy: str


_THERMAL_CAUSE: Final = (
    "Dimensions, stiffness and electronics of the sensor change with temperature, and the compensation on "
    "the chip removes only a part of these changes."
)
_THERMAL_REMEDY: Final = (
    "Keep it in the calibration and give the temperature of every sample to the correction. Calibrate over "
    "the temperatures of use: the correction is not reliable beyond them."
)
_HISTORY_CAUSE: Final = (
    "The thermometer is not at the sensing element, so its reading lags while the temperature changes, or "
    "stress in the package and the solder relaxes slowly."
)
_HISTORY_REMEDY: Final = (
    "Record heating and cooling at the rates of use. The correction needs the temperature of the whole "
    "recording, not of single samples. Without a correction, change the temperature more slowly."
)
_WARMUP_CAUSE: Final = "The unit heats itself and its package relaxes after power-on."
_WARMUP_REMEDY: Final = (
    "Let the unit warm up before use and calibration, or keep the effect and start the time at power-on. If "
    "the temperature was recorded, an effect of the temperature describes the cause better."
)
_DRIFT_CAUSE: Final = (
    "Self-heating, a change of the room temperature, or slow relaxation of stress in the package."
)
_DRIFT_REMEDY: Final = (
    "Record the temperature. If the temperature explains the drift, the correction is valid for other "
    "recordings. A drift with time alone describes this recording only."
)
_ENCODER_REMEDY: Final = (
    "It is an error of the stand, not of the unit, so the calibration of the sensors does not contain it. "
    "Repair the stand, or keep the effect in the model of the stand."
)

MEANINGS: Final[dict[str, Meaning]] = {
    "gyro_g_sensitivity": Meaning(
        what=(
            "The gyroscope's bias depends linearly on the specific force, so the rate of a unit at rest "
            "differs between poses."
        ),
        cause=(
            "Gravity and acceleration displace the vibrating mass, because its suspension is not perfectly "
            "symmetric."
        ),
        remedy=(
            "Keep it in the calibration and correct the rate with the force of the same sample. Mount the "
            "unit on dampers if vibration is strong, because the correction needs forces within the "
            "bandwidth."
        ),
    ),
    "gyro_g2_sensitivity": Meaning(
        what=(
            "The gyroscope's bias depends on products of specific force components, so vibration shifts its "
            "mean."
        ),
        cause=(
            "Nonlinear displacement of the vibrating mass, and rectification of vibration by the electronics."
        ),
        remedy=(
            "Keep it in the calibration; damp the mount if the unit vibrates, because vibration beyond the "
            "bandwidth is rectified but not measured."
        ),
    ),
    "gyro_scale_g_sensitivity": Meaning(
        what="The gyroscope's scale depends on the specific force along its axis.",
        cause="Force changes the gap between the drive electrodes or between the readout electrodes.",
        remedy="Keep it in the calibration if the unit rotates under load; it is small in most uses.",
    ),
    "gyro_scale_quadratic": Meaning(
        what=(
            "The gyroscope's error grows with the square of the rate, with the same sign for both directions."
        ),
        cause=(
            "An asymmetric readout: both directions of rotation have slightly different scales that change "
            "with the rate."
        ),
        remedy="Keep it in the calibration, and calibrate up to the largest rate of use.",
    ),
    "gyro_scale_cubic": Meaning(
        what="The gyroscope's scale changes with the magnitude of the rate.",
        cause=(
            "The readout saturates gradually towards the end of the range, or its force feedback is "
            "nonlinear."
        ),
        remedy=(
            "Keep it in the calibration, calibrate up to the largest rate of use, or select a larger range "
            "of the sensor."
        ),
    ),
    "gyro_scale_asymmetry": Meaning(
        what="The gyroscope's scale differs between the two directions of rotation.",
        cause=(
            "Two halves of the readout electronics with unequal gains, such as those of a demodulator or "
            "converter."
        ),
        remedy="Keep it in the calibration, and include rotations in both directions in every calibration.",
    ),
    "gyro_cross_axis_quadratic": Meaning(
        what="Simultaneous rotation about two axes causes an error of the third axis.",
        cause="Coriolis and centrifugal forces couple the axes of a vibrating mass that all three share.",
        remedy="Keep it in the calibration if the unit rotates about several axes at once.",
    ),
    "accel_scale_quadratic": Meaning(
        what=(
            "The accelerometer's error grows with the square of the force along its axis; vibration shifts "
            "its mean."
        ),
        cause=(
            "The gap between the electrodes changes with the deflection of the mass, more to one side than "
            "to the other."
        ),
        remedy=(
            "Keep it in the calibration. Under vibration the mean reading shifts by the parameter times the "
            "mean square of the force, so damp the mount if the vibration is beyond the bandwidth."
        ),
    ),
    "accel_scale_cubic": Meaning(
        what="The accelerometer's scale changes with the magnitude of the force.",
        cause="The spring or the electrostatic readout is nonlinear at large deflections.",
        remedy=(
            "Keep it in the calibration. Gravity alone determines it only up to 1 g. For larger forces, use "
            "a centrifuge or a shaker."
        ),
    ),
    "accel_scale_asymmetry": Meaning(
        what="The accelerometer's scale differs between the two signs of the force.",
        cause="Unequal electrodes or amplifiers for the two directions of deflection.",
        remedy="Keep it in the calibration, and include poses with each axis up and down.",
    ),
    "accel_cross_axis_quadratic": Meaning(
        what="Forces along other axes cause an error that grows with products of the forces.",
        cause="A mass that all axes share, or suspension that twists under a force across it.",
        remedy=(
            "Keep it in the calibration only if the poses come from a stand with known angles, which "
            "separates it from the other nonlinear terms."
        ),
    ),
    "gyro_bias_temperature": Meaning(
        what="The gyroscope's bias depends on the temperature.",
        cause=_THERMAL_CAUSE,
        remedy=_THERMAL_REMEDY,
    ),
    "gyro_scale_temperature": Meaning(
        what="The gyroscope's scale depends on the temperature.",
        cause=_THERMAL_CAUSE,
        remedy=_THERMAL_REMEDY,
    ),
    "accel_bias_temperature": Meaning(
        what="The accelerometer's bias depends on the temperature.",
        cause=_THERMAL_CAUSE,
        remedy=_THERMAL_REMEDY,
    ),
    "accel_scale_temperature": Meaning(
        what="The accelerometer's scale depends on the temperature.",
        cause=_THERMAL_CAUSE,
        remedy=_THERMAL_REMEDY,
    ),
    "gyro_bias_drift": Meaning(
        what="The gyroscope's bias changes at a constant rate in time.",
        cause=_DRIFT_CAUSE,
        remedy=_DRIFT_REMEDY,
    ),
    "gyro_scale_drift": Meaning(
        what="The gyroscope's scale changes at a constant rate in time.",
        cause=_DRIFT_CAUSE,
        remedy=_DRIFT_REMEDY,
    ),
    "accel_bias_drift": Meaning(
        what="The accelerometer's bias changes at a constant rate in time.",
        cause=_DRIFT_CAUSE,
        remedy=_DRIFT_REMEDY,
    ),
    "gyro_bias_warmup": Meaning(
        what="The gyroscope's bias approaches its final value exponentially after power-on.",
        cause=_WARMUP_CAUSE,
        remedy=_WARMUP_REMEDY,
    ),
    "accel_bias_warmup": Meaning(
        what="The accelerometer's bias approaches its final value exponentially after power-on.",
        cause=_WARMUP_CAUSE,
        remedy=_WARMUP_REMEDY,
    ),
    "gyro_angular_acceleration": Meaning(
        what="The gyroscope's error is proportional to the angular acceleration.",
        cause=(
            "The phase delay of the gyroscope's filter, or angular acceleration that displaces the mass "
            "directly."
        ),
        remedy=(
            "Check the delay and the low-pass filter of the gyroscope first: a delay also causes an error "
            "proportional to the angular acceleration, with the same factor on each axis."
        ),
    ),
    "gyro_time_offset": Meaning(
        what="The gyroscope's samples are older or newer than those of the accelerometer.",
        cause="Different filters of the two sensors, or time stamps that are given when a sample is read.",
        remedy=(
            "Shift the time stamps of the gyroscope by the parameter, and give both sensors the same filter "
            "and the time stamps of one clock."
        ),
    ),
    "earth_rate": Meaning(
        what="The gyroscope measures the rotation of the Earth, 15 deg/h.",
        cause=(
            "It is a true rate and not an error, but the model assumes that a unit at rest does not rotate."
        ),
        remedy=(
            "Include it in the calibration of gyroscopes whose noise is well below 15 deg/h; navigation "
            "corrects it by the latitude and the heading."
        ),
    ),
    "accel_lever_arm": Meaning(
        what=(
            "The accelerometer is not at the point about which the unit rotates, so it measures centripetal "
            "and tangential forces."
        ),
        cause=(
            "The distance of the accelerometer from the axes of the stand, or from the origin of the body "
            "frame."
        ),
        remedy=(
            "It is a property of the mounting. Keep the lever arm in the calibration, or use it to transform "
            "the force to the origin of the body frame."
        ),
    ),
    "accel_size_effect": Meaning(
        what="The three axes of the accelerometer measure at different points.",
        cause="Three separate sensing elements, millimetres apart in the package.",
        remedy=(
            "Keep it in the calibration if the unit rotates fast; the distances should agree with the size "
            "of the package."
        ),
    ),
    "encoder_eccentricity": Meaning(
        what="The angles of a motor have an error that repeats with every revolution.",
        cause="The scale or the magnet of the encoder is not centred on the axis.",
        remedy=_ENCODER_REMEDY,
    ),
    "encoder_time_offset": Meaning(
        what="The angles of the motors are older or newer than the samples of the unit.",
        cause="The delay of the bus on which the encoders are read.",
        remedy=_ENCODER_REMEDY,
    ),
    "encoder_backlash": Meaning(
        what="A motor stops at a different angle if it reaches the position from the other direction.",
        cause="Looseness (play) of the gears between the encoder and the platform.",
        remedy=_ENCODER_REMEDY,
    ),
    **{
        f"{sensor}_bias_temperature_{form}": Meaning(
            what=f"The {name}'s bias depends {on}.",
            cause=_HISTORY_CAUSE,
            remedy=_HISTORY_REMEDY,
        )
        for sensor, name in (("gyro", "gyroscope"), ("accel", "accelerometer"))
        for form, on in (
            ("rate", "on how fast the temperature changes"),
            ("lag", "on a temperature that follows the measured temperature with a time constant"),
            ("hysteresis", "on whether the unit is heating or cooling"),
        )
    },
}


def meaning_of(name: str) -> Meaning | None:
    """The description of an effect of the catalogue; None for any other effect."""
    return MEANINGS.get(name)
