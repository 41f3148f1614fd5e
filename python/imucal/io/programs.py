"""Programs and apps that are recognised by the header of their files, with units from their manuals."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

__all__ = ["Program", "program_of"]


class Program(NamedTuple):
    """A program, and the units according to its manual.

    name         name of the program in messages
    accel, gyro  units of the sensors, as suffixes of canonical names; "" for a missing sensor or a unit that
                 is not fixed
    times        units of time columns whose names do not state them, by name in lower case
    is_corrected whether the program has applied its own calibration to the samples
    time         name, in lower case, of the only column with the times of the samples, if the program also
                 writes less exact times
    unused       start of the names, in lower case, of columns that the operating system has corrected
    axes         value of the option `axes` that corrects the signs of the samples; None if they are right
    """

    name: str
    accel: str
    gyro: str
    times: dict[str, str]
    is_corrected: bool = False
    time: str | None = None
    unused: str | None = None
    axes: str | None = None


def program_of(names: Sequence[str], preamble: Sequence[str]) -> Program | None:
    """The program that wrote the file, or None if the header does not identify it."""
    low = {name.strip().lower() for name in names}
    text = "\n".join(preamble).lower()
    if {"acc_x", "gyr_x"} <= low and ("sampletimefine" in low or "packetcounter" in low):
        # Two programs use the same column names for different units: Movella DOT for deg/s and 1 us, and MT
        # Manager for rad/s and 100 us.
        if "devicetag" in text or "outputrate" in text or "xsens dot" in text or "movella dot" in text:
            return Program("Movella DOT", "mps2", "dps", {"sampletimefine": "us"})
        # MT Manager and the programs for MTw write comments above the header.
        if text.startswith("//"):
            return Program("Xsens MT Manager", "mps2", "radps", {"sampletimefine": "100us"})
        return None
    # SensorLog writes the units of its columns in CSV, accelerometerAccelerationX(G), but not in JSON. Other
    # programs put its messages into objects of their own: payload.accelerometerAccelerationX.
    of_sensorlog = {re.sub(r"\(.*\)$", "", name.rpartition(".")[2]): name for name in low}
    if "accelerometeraccelerationx" in of_sensorlog:
        # In SensorLog's files, loggingTime is the time at which a row was written, columns whose names start
        # with motion contain samples that Core Motion has corrected, and the accelerometer reads -1 g on the
        # axis that points up, as everywhere on iOS.
        time = of_sensorlog.get("accelerometertimestamp_sincereboot")
        return Program(
            "SensorLog",
            "g",
            "radps",
            {time: "s"} if time else {},
            time=time,
            unused="motion",
            axes="accel=-x,-y,-z",
        )
    if "seconds_elapsed" in low and {"x", "y", "z"} <= low:
        return Program("Sensor Logger", "", "radps", {"time": "ns"})
    is_combined = {"gyro_rad[0]", "accelerometer_m_s2[0]"} <= low
    if is_combined or {"device_id", "error_count", "x", "y", "z"} <= low:
        # ulog2csv writes the PX4 topics sensor_combined, sensor_accel and sensor_gyro with these column
        # names.
        return Program("PX4", "mps2", "radps", {"timestamp": "us", "timestamp_sample": "us"}, is_combined)
    if {"ax", "gx", "imu_degc"} <= low:
        return Program("OpenLog Artemis", "mg", "dps", {"micros": "us"})
    if any("[x8004]" in name for name in low) and any("[x8005]" in name for name in low):
        # 8004 and 8005 are the descriptors of scaled accelerometer and gyroscope data in the MIP protocol.
        return Program("MicroStrain SensorConnect", "g", "radps", {"gps tow": "s"})
    if {"gfx", "gfy", "gfz"} <= low and "time" in low:
        return Program("Physics Toolbox", "g", "radps", {"time": "s"})
    is_ros = any("angular_velocity" in name for name in low) and any(
        "linear_acceleration" in name for name in low
    )
    if is_ros:
        return Program("ROS", "mps2", "radps", {})
    if "actigraph" in text:
        return Program("ActiGraph", "g", "dps", {})
    return None
