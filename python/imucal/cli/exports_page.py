"""The section of docs/formats.md on files that are exported by programs of sensor makers and by apps."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

__all__ = ["EXPORTS", "Export", "exports_section"]

ALL_READ: Final = "all data are read"
ROUNDED: Final = "numbers have only the digits that are printed"
OTHERS: Final = "other columns are not read"


@dataclass(frozen=True)
class Export:
    """A kind of file that a maker's program or an app exports.

    name     maker, program and kind of file
    choose   the kind of export that the user must select in the program
    command  command with which imucal reads the file
    remarks  data that are not read, and remarks about the data
    """

    name: str
    choose: str
    command: str
    remarks: str


EXPORTS: Final = (
    Export(
        "phyphox, CSV (tabulator)",
        choose=(
            "an experiment with accelerometer (with g) and gyroscope; Export Data > CSV (Tabulator, decimal "
            "point)"
        ),
        command="imucal convert 'Raw Data.csv' -o rec.csv",
        remarks="all data are read; the experiment `Acceleration (without g)` cannot be used",
    ),
    Export(
        "phyphox, CSV (semicolon, decimal comma)",
        choose="as for CSV (tabulator), but with Export Data > CSV (Semicolon, decimal comma)",
        command="imucal convert 'Raw Data.csv' -o rec.csv",
        remarks=ALL_READ,
    ),
    Export(
        "phyphox, zip",
        choose="as for CSV, with one file per sensor",
        command="imucal convert phone.zip -o rec.csv",
        remarks="sensors with different time stamps are resampled",
    ),
    Export(
        "Sensor Logger, zip",
        choose="Total Acceleration and Gyroscope; Export > Zipped CSV",
        command="imucal convert 2026-01-01.zip -o rec.csv",
        remarks=(
            "`TotalAcceleration.csv` has gravity, `Accelerometer.csv` does not and is ignored; on iOS, "
            "switch on `Standardise Units & Frames`"
        ),
    ),
    Export(
        "Sensor Logger, JSON",
        choose="Total Acceleration and Gyroscope; Export > JSON",
        command="imucal convert 2026-01-01.json -o rec.csv",
        remarks="as for the zip",
    ),
    Export(
        "Sensor Logger, SQLite",
        choose="Total Acceleration and Gyroscope; Export > SQLite",
        command="imucal convert 2026-01-01.sqlite -o rec.csv",
        remarks="as for the zip",
    ),
    Export(
        "Edge Impulse, JSON",
        choose="download the sample in the data acquisition format, as JSON",
        command="imucal convert sample.json -o rec.csv",
        remarks="the time follows from `interval_ms`; the signature is not verified",
    ),
    Export(
        "Physics Toolbox Sensor Suite",
        choose="Multi Record with g-Force Meter and Gyroscope",
        command="imucal convert multi.csv -o rec.csv",
        remarks="ax, ay, az are without gravity and are ignored; gFx, gFy, gFz are read, in g",
    ),
    Export(
        "AndroSensor",
        choose="Accelerometer and Gyroscope; time since start in ms",
        command="imucal convert sensor.csv -o rec.csv",
        remarks="GRAVITY and LINEAR ACCELERATION are ignored",
    ),
    Export(
        "Xsens MT Manager, ASCII export",
        choose="Acceleration, Rate of Turn and Sample Time Fine",
        command="imucal convert MT_0388.txt -o rec.csv",
        remarks=(
            "FreeAcc (without gravity), magnetometer and orientation are not read. Leave the rate of turn in "
            "rad/s, because the header does not state its unit"
        ),
    ),
    Export(
        "Movella DOT (Xsens DOT), CSV",
        choose="a measurement mode with Acc and Gyr, such as Rate quantities",
        command="imucal convert dot.csv -o rec.csv",
        remarks="modes with FreeAcc only cannot be used",
    ),
    Export(
        "Shimmer Consensys, CSV (calibrated)",
        choose="Calibrated; one accelerometer (low noise or wide range) and the gyroscope",
        command="imucal convert shimmer.csv -o rec.csv",
        remarks="Consensys has applied its calibration; a new calibration is valid only for such data",
    ),
    Export(
        "ST MEMS Studio and Unico",
        choose="save the accelerometer and gyroscope as text",
        command="imucal convert log.txt --rate-hz 100 -o rec.csv",
        remarks="the files contain no time, so give --rate-hz",
    ),
    Export(
        "ST BLE Sensor app",
        choose="log to CSV, one file per feature",
        command="imucal convert Accelerometer.csv Gyroscope.csv --time-unit ms -o rec.csv",
        remarks="the date is not read, because its resolution is only the transmission interval",
    ),
    Export(
        "WitMotion, text record",
        choose="record as text (.txt or .csv)",
        command="imucal convert data.txt -o rec.csv",
        remarks=(
            "the angles and the magnetic field are not read; the chip time is read if the record has no "
            "other time"
        ),
    ),
    Export(
        "WitMotion, binary packets",
        choose="save packets of acceleration (0x51), angular rate (0x52) and, if possible, time (0x50)",
        command="imucal convert wt901.bin --rate-hz 100 -o rec.csv",
        remarks="the angles and the magnetic field are not read; the ranges have to be 16 g and 2000 deg/s",
    ),
    Export(
        "x-io x-IMU3, CSV folder",
        choose="convert the data log to CSV files with the x-IMU3 GUI",
        command="imucal convert x-IMU3 -o rec.csv",
        remarks="only Inertial.csv is read",
    ),
    Export(
        "x-io NGIMU, sensors.csv",
        choose="convert the SD card file with the NGIMU software",
        command="imucal convert sensors.csv -o rec.csv",
        remarks="magnetometer and barometer are not read",
    ),
    Export(
        "VectorNav, ASCII output",
        choose="the asynchronous output VNYMR, VNIMU, VNQMR or VNMAR",
        command="imucal convert vn.txt --rate-hz 100 -o rec.csv",
        remarks=f"the sentences contain no time, so give --rate-hz; {ROUNDED}",
    ),
    Export(
        "Arduino serial plotter",
        choose="save the serial output of a sketch that prints the time and samples in a unit or in counts",
        command=(
            "imucal convert plotter.txt --columns "
            "time_s=t,accel_x_mps2=ax,accel_y_mps2=ay,accel_z_mps2=az,"
            "gyro_x_radps=gx,gyro_y_radps=gy,gyro_z_radps=gz -o rec.csv"
        ),
        remarks=ROUNDED,
    ),
    Export(
        "MbientLab MetaBase",
        choose="Accelerometer and Gyroscope; both CSV files",
        command="imucal convert Accelerometer.csv Gyroscope.csv -o rec.csv",
        remarks=(
            "the elapsed time is not read, because it starts at another instant in each file; epoch (ms) is "
            "read"
        ),
    ),
    Export(
        "SensorLog (iOS)",
        choose="CSV with accelerometer and gyroscope",
        command=(
            "imucal convert log.csv --columns 'time_s=accelerometerTimestamp_sinceReboot(s),...' "
            "--axes accel=-x,-y,-z -o rec.csv"
        ),
        remarks=(
            "without options, an error message gives the complete command line; iOS reverses the sign of the "
            "accelerometer (at rest it reads -1 g on the axis that points up), and `--axes` corrects it; the "
            "columns `motion...` are not read, because iOS has corrected them"
        ),
    ),
    Export(
        "ROS 1, rostopic echo -p",
        choose="rostopic echo -p /imu/data > imu.csv; give the bag itself if possible",
        command="imucal convert imu.csv -o rec.csv",
        remarks=OTHERS,
    ),
    Export(
        "PlotJuggler, CSV export",
        choose="angular_velocity and linear_acceleration of one sensor_msgs/Imu topic",
        command="imucal convert pj.csv -o rec.csv",
        remarks="the time stamps have a resolution of 1 us; give the bag itself if possible",
    ),
    Export(
        "ActiGraph, IMU CSV",
        choose="export the IMU data of ActiLife as CSV, with time stamps",
        command="imucal convert acti.csv -o rec.csv",
        remarks="the magnetometer is not read",
    ),
    Export(
        "Axivity AX6, OmGui CSV",
        choose="export resampled CSV with accelerometer (g) and gyroscope (d/s)",
        command="imucal convert ax6.csv -o rec.csv",
        remarks="OmGui resamples, which smooths the noise",
    ),
    Export(
        "ACEINNA NavView and OpenIMU",
        choose="log the message z1 or s1",
        command="imucal convert openimu.csv -o rec.csv",
        remarks="the magnetometer is not read",
    ),
    Export(
        "SBG Systems, sbgCenter export",
        choose="text export of IMU data with the line of units",
        command="imucal convert imu.txt -o rec.csv",
        remarks="the status is not read",
    ),
    Export(
        "Betaflight, blackbox_decode",
        choose="blackbox_decode --unit-rotation deg/s --unit-acceleration g LOG00001.BFL",
        command="imucal convert LOG00001.01.csv -o rec.csv",
        remarks=(
            "all data are read; Betaflight has filtered both sensors and rotated their axes; a log itself "
            "(.BFL, .BBL) is not read, and the error message names blackbox_decode"
        ),
    ),
    Export(
        "RealSense, rs-convert",
        choose=(
            "rs-convert -i recording.bag -v d435i for a recording with Accel and Gyro; the .bag file itself "
            "is read as well"
        ),
        command="imucal convert d435i_120000_imu_pose.csv -o rec.csv",
        remarks=(
            "accelerometer and gyroscope have two rates and are resampled; the SDK applies the calibration "
            "that is stored in the camera, unless motion correction is switched off"
        ),
    ),
    Export(
        "GoPro, telemetry extractor CSV",
        choose="one CSV per stream (ACCL, GYRO)",
        command="imucal convert Accelerometer.csv Gyroscope.csv --time-unit ms -o rec.csv",
        remarks=(
            "the axes keep the names of the header (z, x, y); if a header names only the first of the three "
            "columns, as in `Accelerometer [m/s2]`, `1`, `2`, the columns are read as x, y, z in this order"
        ),
    ),
    Export(
        "Variense VMU931 and other loggers of one file per sensor",
        choose="one text file per sensor, with time and units in the header",
        command="imucal convert acc.txt gyro.txt -o rec.csv",
        remarks="sensors with different time stamps are resampled",
    ),
    Export(
        "MATLAB, writetimetable",
        choose=(
            "writetimetable(tt, 'run.csv') for a timetable, which .mat files hold as an object that is not "
            "read"
        ),
        command="imucal convert run.csv --columns time_s=Time -o rec.csv",
        remarks=(
            "the time stamps have only the digits of the time format; for microseconds, set tt.Time.Format = "
            "'dd-MMM-yyyy HH:mm:ss.SSSSSS'"
        ),
    ),
    Export(
        "Adafruit's Arduino examples (MPU6050, LSM6DS, BNO055), serial monitor",
        choose="save the serial output; print more digits than two (`Serial.print(value, 5)`)",
        command="imucal convert serial.txt --rate-hz 100 -o rec.csv",
        remarks=f"the programs print no time, so give --rate-hz; {ROUNDED}",
    ),
    Export(
        "SparkFun ICM-20948 examples, serial monitor",
        choose="save the scaled output, `Scaled. Acc (mg) [ ... ], Gyr (DPS) [ ... ]`",
        command="imucal convert serial.txt --rate-hz 100 -o rec.csv",
        remarks=f"the programs print no time, so give --rate-hz; {ROUNDED}",
    ),
    Export(
        "SparkFun OpenLog Artemis",
        choose="log the IMU with the date and time, or with micros",
        command="imucal convert dataLog00001.TXT -o rec.csv",
        remarks=f"the magnetometer is not read; {ROUNDED}",
    ),
    Export(
        "MicroStrain SensorConnect",
        choose="export as CSV: Scaled Accelerometer (0x8004), Scaled Gyroscope (0x8005) and GPS TOW",
        command="imucal convert imu.csv -o rec.csv",
        remarks="other quantities are not read",
    ),
    Export(
        "Xsens MTw and Awinda, ASCII export",
        choose="Acceleration, Rate of Turn and Sample Time Fine",
        command="imucal convert MT_01.txt -o rec.csv",
        remarks="as for MT Manager",
    ),
    Export(
        "ShimmerCapture, older exports",
        choose="calibrated data, with a line CAL and a line of units below the header",
        command="imucal convert shimmer.csv -o rec.csv",
        remarks="the program has applied its calibration; a new calibration is valid only for such data",
    ),
    Export(
        "phyphox, CSV in German, and apps in other languages",
        choose=("as for CSV (tabulator), with German, French, Spanish, Italian, Portuguese or Dutch names"),
        command="imucal convert 'Raw Data.csv' -o rec.csv",
        remarks=ALL_READ,
    ),
    Export(
        "ST DATALOG2, one CSV file per sensor",
        choose="convert the acquisition to CSV with the tools of the SDK",
        command="imucal convert lsm6dsv16x_acc.csv lsm6dsv16x_gyro.csv -o rec.csv",
        remarks="sensors with different time stamps are resampled",
    ),
    Export(
        "Parquet and data frames of other programs",
        choose="names of the columns with sensor, axis and unit, such as `accel x (mg)`",
        command="imucal convert run.parquet -o rec.csv",
        remarks=OTHERS,
    ),
    Export(
        "PX4, ulog2csv",
        choose="ulog2csv -m sensor_accel,sensor_gyro flight.ulg; give the log itself if possible",
        command="imucal convert flight_sensor_accel_0.csv flight_sensor_gyro_0.csv -o rec.csv",
        remarks=(
            "the temperature is not read; PX4 has applied its calibration to `sensor_combined`, which is "
            "read with a warning"
        ),
    ),
    Export(
        "ROS 1, rosbag_to_csv",
        choose="the topic of sensor_msgs/Imu; give the bag itself if possible",
        command="imucal convert imu.csv -o rec.csv",
        remarks=(
            "the time stamps are those of the messages and not the times of receipt; their seconds and "
            "nanoseconds are two columns (`secs` and `nsecs`, in ROS 2 `sec` and `nanosec`)"
        ),
    ),
    Export(
        "WitMotion, CSV of the phone app",
        choose="record as CSV",
        command="imucal convert data.csv -o rec.csv",
        remarks="the angles and the magnetic field are not read",
    ),
)

HEAD: Final = """\
## Makers and apps

The table lists the exports that imucal reads, sorted by maker or app, and the settings to choose in the
program. If the header gives sensor, axis and unit of every column, the file is read without options, and
a warning states the unit of each column. If the header gives no unit, the error message shows
the values in each possible unit, and the option `--columns` for the most likely unit.

Units in headers may be spelled in many ways: m/s^2, m/s² or m/s/s, cm/s² or Gal, mm/s², ft/s², g, mg, µg;
rad/s, mrad/s, deg/s, °/s or dps, mdps, °/min, °/h or dph, rpm, gon/s; s, ms, us, ns. A header with another
unit, such as ticks or rps, is an error and is never taken for a header without units. Words with two
meanings are not read: grad/s is gon/s in English and deg/s in German.
"""

FOOT: Final = """\
In all text files the header must be one of the first 50 lines. Comments (`#`, `%`, `//`), a `sep=` line
and free text may precede the header, and the line after the header may give the units. Fields are
separated by tab, semicolon, comma or spaces; numbers have a decimal point or a decimal comma. The
encoding may be UTF-8 or UTF-16, and files may be compressed with gzip or be in a zip archive. Dates are
written as 2026-01-31 12:00:00.123 (also with `/`, `.`, `T`, a colon or comma before the fraction, a
zone), 31-Jan-2026 12:00:00.123, Jan 31, 2026 12:00:00 PM, 31.01.2026 12:00:00.123, 20260131T120000.123,
2026_01_31_12_00_00.123, or as a time of day, 12:00:00.123 or 00:12.3 (minutes and seconds). Lines of
text, incomplete lines, rows without values and exact copies of rows are left out, and a warning gives the
number of each. A file is refused if most of its lines are text, or if more than 1 % are garbled.

Some files must be converted first: save a sheet of a spreadsheet (.xlsx, .xls, .ods, .numbers) as CSV,
write a timetable or table of a .mat file with `writetimetable` or `writetable`, and convert a Betaflight
log with `blackbox_decode`.
"""


def exports_section() -> Iterator[str]:
    """The lines of the section on exports of other programs, as Markdown."""
    yield HEAD
    yield "| export | choose | command | data that are not read, and remarks |"
    yield "|---|---|---|---|"
    for row in sorted(EXPORTS, key=lambda row: row.name.casefold()):
        yield f"| {row.name} | {row.choose} | `{row.command}` | {row.remarks} |"
    yield ""
    yield FOOT
