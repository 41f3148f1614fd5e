"""The section of docs/formats.md on files that vendors' programs export: settings, command, lost data."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

__all__ = ["EXPORTS", "Export", "exports_section"]

NOTHING: Final = "no data"
ROUNDED: Final = "digits beyond those that are printed"
OTHERS: Final = "the other columns"


@dataclass(frozen=True)
class Export:
    """An export of a maker's program or an app.

    name     maker, program and kind of file
    choose   export to choose in the program
    command  command with which imucal reads the file
    lost     data that the recording lacks, and remarks about the data
    """

    name: str
    choose: str
    command: str
    lost: str


EXPORTS: Final = (
    Export(
        "phyphox, CSV (tabulator)",
        "an experiment with accelerometer (with g) and gyroscope; Export Data > CSV (Tabulator, decimal "
        "point)",
        "imucal convert 'Raw Data.csv' -o rec.csv",
        "no data; the experiment `Acceleration (without g)` cannot be used",
    ),
    Export(
        "phyphox, CSV (semicolon, decimal comma)",
        "as for CSV (tabulator), but CSV (Semicolon, decimal comma)",
        "imucal convert 'Raw Data.csv' -o rec.csv",
        NOTHING,
    ),
    Export(
        "phyphox, zip",
        "as for CSV, with one file per sensor",
        "imucal convert phone.zip -o rec.csv",
        "sensors with different time stamps are resampled",
    ),
    Export(
        "Sensor Logger, zip",
        "Total Acceleration and Gyroscope; Export > Zipped CSV",
        "imucal convert 2026-01-01.zip -o rec.csv",
        "`TotalAcceleration.csv` has gravity, `Accelerometer.csv` does not and is ignored; on iOS, switch on "
        "`Standardise Units & Frames`",
    ),
    Export(
        "Physics Toolbox Sensor Suite",
        "Multi Record with g-Force Meter and Gyroscope",
        "imucal convert multi.csv -o rec.csv",
        "ax, ay, az are without gravity and are ignored; gFx, gFy, gFz are read, in g",
    ),
    Export(
        "AndroSensor",
        "Accelerometer and Gyroscope; time since start in ms",
        "imucal convert sensor.csv -o rec.csv",
        "GRAVITY and LINEAR ACCELERATION are ignored",
    ),
    Export(
        "Xsens MT Manager, ASCII export",
        "Acceleration, Rate of Turn and Sample Time Fine",
        "imucal convert MT_0388.txt -o rec.csv",
        "FreeAcc (without gravity), magnetometer and orientation. Leave the rate of turn in rad/s, because "
        "the header does not say its unit",
    ),
    Export(
        "Movella DOT (Xsens DOT), CSV",
        "a measurement mode with Acc and Gyr, such as Rate quantities",
        "imucal convert dot.csv -o rec.csv",
        "modes with FreeAcc only cannot be used",
    ),
    Export(
        "Shimmer Consensys, CSV (calibrated)",
        "Calibrated; one accelerometer (low noise or wide range) and the gyroscope",
        "imucal convert shimmer.csv -o rec.csv",
        "Consensys has applied its calibration; a new calibration is valid only for such data",
    ),
    Export(
        "ST MEMS Studio and Unico",
        "save the accelerometer and gyroscope as text",
        "imucal convert log.txt --rate-hz 100 -o rec.csv",
        "time, which these files do not have",
    ),
    Export(
        "ST BLE Sensor app",
        "log to CSV, one file per feature",
        "imucal convert Accelerometer.csv Gyroscope.csv --time-unit ms -o rec.csv",
        "the date, whose resolution is only the transmission interval",
    ),
    Export(
        "WitMotion, text record",
        "record as text (.txt or .csv)",
        "imucal convert data.txt -o rec.csv",
        "the angles and the magnetic field; the chip time is read if the record has no other",
    ),
    Export(
        "WitMotion, binary packets",
        "acceleration (0x51) and angular rate (0x52), at best with time (0x50), of a serial terminal",
        "imucal convert wt901.bin --rate-hz 100 -o rec.csv",
        "the angles and the magnetic field; the ranges have to be 16 g and 2000 deg/s",
    ),
    Export(
        "x-io x-IMU3, CSV folder",
        "convert the data log to CSV files with the x-IMU3 GUI",
        "imucal convert x-IMU3 -o rec.csv",
        "all files except Inertial.csv",
    ),
    Export(
        "x-io NGIMU, sensors.csv",
        "convert the SD card file with the NGIMU software",
        "imucal convert sensors.csv -o rec.csv",
        "magnetometer and barometer",
    ),
    Export(
        "VectorNav, ASCII output",
        "the asynchronous output VNYMR, VNIMU, VNQMR or VNMAR",
        "imucal convert vn.txt --rate-hz 100 -o rec.csv",
        f"time, which the sentences do not have; {ROUNDED}",
    ),
    Export(
        "Arduino serial plotter",
        "save the serial output; print time, units and counts as they are",
        "imucal convert plotter.txt --columns time_s=t,accel_x_mps2=ax,accel_y_mps2=ay,accel_z_mps2=az,"
        "gyro_x_radps=gx,gyro_y_radps=gy,gyro_z_radps=gz -o rec.csv",
        ROUNDED,
    ),
    Export(
        "MbientLab MetaBase",
        "Accelerometer and Gyroscope; both CSV files",
        "imucal convert Accelerometer.csv Gyroscope.csv -o rec.csv",
        "the elapsed time, which starts at another instant in each file; epoch (ms) is read",
    ),
    Export(
        "SensorLog (iOS)",
        "CSV with accelerometer and gyroscope",
        "imucal convert log.csv --columns 'time_s=accelerometerTimestamp_sinceReboot(s),...' -o rec.csv",
        "iOS reverses the sign of the accelerometer: a unit at rest reads -1 g on the axis that points up",
    ),
    Export(
        "ROS 1, rostopic echo -p",
        "rostopic echo -p /imu/data > imu.csv; give the bag itself if possible",
        "imucal convert imu.csv -o rec.csv",
        OTHERS,
    ),
    Export(
        "PlotJuggler, CSV export",
        "angular_velocity and linear_acceleration of one sensor_msgs/Imu topic",
        "imucal convert pj.csv -o rec.csv",
        "digits of the time stamps below 1 us; give the bag itself if possible",
    ),
    Export(
        "ActiGraph, IMU CSV",
        "export the IMU data of ActiLife as CSV, with time stamps",
        "imucal convert acti.csv -o rec.csv",
        "magnetometer",
    ),
    Export(
        "Axivity AX6, OmGui CSV",
        "export resampled CSV with accelerometer (g) and gyroscope (d/s)",
        "imucal convert ax6.csv -o rec.csv",
        "OmGui resamples, which smooths the noise",
    ),
    Export(
        "ACEINNA NavView and OpenIMU",
        "log the message z1 or s1",
        "imucal convert openimu.csv -o rec.csv",
        "magnetometer",
    ),
    Export(
        "SBG Systems, sbgCenter export",
        "text export of IMU data with the line of units",
        "imucal convert imu.txt -o rec.csv",
        "the status",
    ),
    Export(
        "Betaflight, blackbox_decode",
        "blackbox_decode --unit-rotation deg/s --unit-acceleration g LOG00001.BFL",
        "imucal convert LOG00001.01.csv -o rec.csv",
        "no data; Betaflight has filtered both sensors and rotated their axes; if a log (.BFL, .BBL) is "
        "given, the message gives this command",
    ),
    Export(
        "RealSense, rs-convert",
        "rs-convert -i recording.bag -v d435i for a recording with Accel and Gyro; the .bag file itself is "
        "read as well",
        "imucal convert d435i_120000_imu_pose.csv -o rec.csv",
        "accelerometer and gyroscope have two rates and are resampled; the SDK applies the calibration that "
        "is stored in the camera, unless motion correction is switched off",
    ),
    Export(
        "GoPro, telemetry extractor CSV",
        "one CSV per stream (ACCL, GYRO)",
        "imucal convert Accelerometer.csv Gyroscope.csv --time-unit ms -o rec.csv",
        "the axes keep the names of the header (z, x, y); versions that name only the first of the three "
        "columns, `Accelerometer [m/s2]`, `1`, `2`, are read as x, y, z in this order",
    ),
    Export(
        "Variense VMU931 and other loggers of one file per sensor",
        "one text file per sensor, with time and units in the header",
        "imucal convert acc.txt gyro.txt -o rec.csv",
        "sensors with different time stamps are resampled",
    ),
    Export(
        "MATLAB, writetimetable",
        "writetimetable(tt, 'run.csv') for a timetable, which .mat files hold as an object that is not read",
        "imucal convert run.csv --columns time_s=Time -o rec.csv",
        "digits beyond those of the time format: tt.Time.Format = 'dd-MMM-yyyy HH:mm:ss.SSSSSS'",
    ),
    Export(
        "Adafruit's Arduino examples (MPU6050, LSM6DS, BNO055), serial monitor",
        "save the serial output; print more digits than two (`Serial.print(value, 5)`)",
        "imucal convert serial.txt --rate-hz 100 -o rec.csv",
        f"time, which these programs do not print; {ROUNDED}",
    ),
    Export(
        "SparkFun ICM-20948 examples, serial monitor",
        "save the scaled output, `Scaled. Acc (mg) [ ... ], Gyr (DPS) [ ... ]`",
        "imucal convert serial.txt --rate-hz 100 -o rec.csv",
        f"time, which these programs do not print; {ROUNDED}",
    ),
    Export(
        "SparkFun OpenLog Artemis",
        "log the IMU with the date and time, or with micros",
        "imucal convert dataLog00001.TXT -o rec.csv",
        "magnetometer; digits beyond those that are printed",
    ),
    Export(
        "MicroStrain SensorConnect",
        "export as CSV: Scaled Accelerometer (0x8004), Scaled Gyroscope (0x8005) and GPS TOW",
        "imucal convert imu.csv -o rec.csv",
        "the other quantities",
    ),
    Export(
        "Xsens MTw and Awinda, ASCII export",
        "Acceleration, Rate of Turn and Sample Time Fine",
        "imucal convert MT_01.txt -o rec.csv",
        "as for MT Manager",
    ),
    Export(
        "ShimmerCapture, older exports",
        "calibrated data, with a line CAL and a line of units below the header",
        "imucal convert shimmer.csv -o rec.csv",
        "the program has applied its calibration; a new calibration is valid only for such data",
    ),
    Export(
        "phyphox, CSV in German, and apps in other languages",
        "as for CSV (tabulator); names of the columns in German, French, Spanish, Italian, Portuguese or "
        "Dutch",
        "imucal convert 'Raw Data.csv' -o rec.csv",
        NOTHING,
    ),
    Export(
        "ST DATALOG2, one CSV file per sensor",
        "convert the acquisition to CSV with the tools of the SDK",
        "imucal convert lsm6dsv16x_acc.csv lsm6dsv16x_gyro.csv -o rec.csv",
        "sensors with different time stamps are resampled",
    ),
    Export(
        "Parquet and data frames of other programs",
        "names of the columns with sensor, axis and unit, such as `accel x (mg)`",
        "imucal convert run.parquet -o rec.csv",
        OTHERS,
    ),
    Export(
        "PX4, ulog2csv",
        "ulog2csv -m sensor_accel,sensor_gyro flight.ulg; give the log itself if possible",
        "imucal convert flight_sensor_accel_0.csv flight_sensor_gyro_0.csv -o rec.csv",
        "temperature; PX4 has applied its calibration to `sensor_combined`, which is read with a warning",
    ),
    Export(
        "ROS 1, rosbag_to_csv",
        "the topic of sensor_msgs/Imu; give the bag itself if possible",
        "imucal convert imu.csv -o rec.csv",
        "the time of receipt, because the time stamps of the messages are read, whose seconds and "
        "nanoseconds are two columns (`secs` and `nsecs`, in ROS 2 `sec` and `nanosec`)",
    ),
    Export(
        "WitMotion, CSV of the phone app",
        "record as CSV",
        "imucal convert data.csv -o rec.csv",
        "the angles and the magnetic field",
    ),
)

HEAD: Final = """\
## Makers and apps

The table lists the exports that imucal reads, sorted by maker or app, and the settings to choose in the
program. If the header gives sensor, axis and unit of every column, the file is read without further
options, and a warning states the unit of each column. If the header gives no unit, the error message shows
the values in each possible unit, and the option `--columns` for the most likely unit.
"""

FOOT: Final = """\
In all text files the header must be one of the first 50 lines. Comments (`#`, `%`, `//`), a `sep=` line
and free text may precede the header, and the line after the header may give the units. Fields are
separated by tab, semicolon, comma or spaces; numbers have a decimal point or a decimal comma. The
encoding may be UTF-8 or UTF-16, and files may be compressed with gzip or be in a zip archive. Dates are
written as 2026-01-31 12:00:00.123 (also with `/`, `.`, `T`, a colon or comma before the fraction, a
zone), 31-Jan-2026 12:00:00.123, Jan 31, 2026 12:00:00 PM, 31.01.2026 12:00:00.123, 20260131T120000.123,
or as a time of day, 12:00:00.123 or 00:12.3 (minutes and seconds). Lines of text, incomplete lines, rows
without values and exact copies of rows are left out, and a warning gives the number of each. A file is
refused if most of its lines are text, or if more than 1 % are garbled.

Some files must be converted first: save a sheet of a spreadsheet (.xlsx, .xls, .ods, .numbers) as CSV,
write a timetable or table of a .mat file with `writetimetable` or `writetable`, and convert a Betaflight
log with `blackbox_decode`.
"""


def exports_section() -> Iterator[str]:
    """The lines of the section."""
    yield HEAD
    yield "| export | choose | command | lost, and what to know |"
    yield "|---|---|---|---|"
    for row in sorted(EXPORTS, key=lambda row: row.name.casefold()):
        yield f"| {row.name} | {row.choose} | `{row.command}` | {row.lost} |"
    yield ""
    yield FOOT
