"""The formats that can be read, with their descriptions for `imucal convert --list` and docs/formats.md."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

from imucal.recording.recording import Recording

__all__ = ["FORMATS", "Format"]


@dataclass(frozen=True)
class Format:
    """A file format; one row of the catalogue.

    reader    module of this folder and its function that reads a recording; the module is loaded when it is
              first needed, because a command reads files of one format
    title     name of the format in texts for people
    files     number of files that together contain one recording
    extra     optional extra of the package that the format needs, or None
    known_by  how a file of this format is recognised
    reads     data that the reader takes from a file
    units     units of the data, and where they are defined
    time      origin of the time stamps
    options   keyword arguments of the reader
    example   files and options of an `imucal convert` command
    in_pieces  module and function that reads a recording in pieces, with the same options; None if files can
              only be read as a whole
    isolated  whether the file is read in a child process with limited memory and time, because the library
              for the format does not verify the lengths and offsets in a file
    """

    reader: str
    title: str
    files: int
    extra: str | None
    known_by: str
    reads: str
    units: str
    time: str
    options: tuple[str, ...]
    example: str
    in_pieces: str | None = None
    isolated: bool = False

    def read(self, *paths: Any, **options: Any) -> Recording:
        """Read a recording; the keyword arguments are the options of the format."""
        recording: Recording = _function(self.reader)(*paths, **options)
        return recording

    def pieces(self, *paths: Any, **options: Any) -> Iterator[Recording]:
        """Read a recording in pieces, or in one piece if files can only be read as a whole."""
        if self.in_pieces is None:
            yield self.read(*paths, **options)
        else:
            yield from _function(self.in_pieces)(*paths, **options)


def _function(name: str) -> Any:
    """A function of this folder; `name` is its module and its name, such as `canonical.read_csv`."""
    module, _, function = name.partition(".")
    return getattr(importlib.import_module(f"imucal.io.{module}"), function)


NAMED_UNITS = (
    "the unit in each column name: mps2, cmps2, mmps2, ftps2, g, mg, ug or lsb for the accelerometer; radps, "
    "mradps, dps, mdps, dpmin (deg/min), dph (deg/h), rpm, gonps or lsb for the gyroscope; degc, k, degf or "
    "lsb for the temperature; rad or deg for stand angles"
)
NAMED_TIME = (
    "time_s is used unchanged; time_ms, time_us and time_ns are relative to the first sample; without a time "
    "column, give --rate-hz"
)
DATED_TIME = (
    "time_s is used unchanged; time_ms, time_us, time_ns and dates with a time of day are relative to the "
    "first sample; without a time column, give --rate-hz"
)
NAMED_ARRAYS = "arrays with canonical names (see Arrays with names)"
IMU_MESSAGES = (
    "the fields linear_acceleration and angular_velocity of sensor_msgs/Imu messages; --topic selects one of "
    "several topics, or two topics as ACCEL,GYRO if each sensor has a separate topic"
)
ROS_UNITS = "m/s^2 and rad/s, as defined in <https://docs.ros.org/en/jazzy/p/sensor_msgs/msg/Imu.html>"
ROS_TIME = (
    "header.stamp, relative to the first sample; with --receive-time, the times at which the bag received "
    "the messages"
)
OWN_CLOCKS = "if the sensors have different time stamps, they are resampled to one clock, with a warning"

CUT_OFF = "a truncated log is read up to its last complete message"

FORMATS: Final[dict[str, Format]] = {
    "csv": Format(
        "canonical.read_csv",
        title="CSV with a header",
        files=1,
        extra=None,
        known_by="a header in one of the first 50 lines",
        reads=(
            "columns with canonical names, and all other numeric columns as auxiliary inputs; --columns "
            "canonical=name assigns canonical names to other column names, which is not necessary if the "
            "header gives sensor, axis and unit of each column"
        ),
        units=NAMED_UNITS,
        time=DATED_TIME,
        options=("columns", "rate_hz"),
        example=(
            "other.csv --columns "
            "time_ms=t,accel_x_g=ax,accel_y_g=ay,accel_z_g=az,gyro_x_dps=gx,gyro_y_dps=gy,gyro_z_dps=gz"
        ),
        in_pieces="pieces.csv_pieces",
    ),
    "parquet": Format(
        "canonical.read_parquet",
        title="Parquet",
        files=1,
        extra=None,
        known_by="content, or .parquet",
        reads="the same columns as the format csv",
        units=NAMED_UNITS,
        time=DATED_TIME,
        options=("columns", "rate_hz"),
        example="run.parquet",
        in_pieces="pieces.parquet_pieces",
    ),
    "columns": Format(
        "columns.read_columns",
        title="Text without a canonical header",
        files=1,
        extra=None,
        known_by="--columns",
        reads=(
            "columns of numbers, separated by tab, semicolon, comma or spaces, with the names that --columns "
            "gives in order; the name - skips a column; if the file has a header, the names must agree with "
            "it"
        ),
        units=NAMED_UNITS,
        time=NAMED_TIME,
        options=("columns", "rate_hz", "skip_rows"),
        example=(
            "log.txt --columns accel_x_g,accel_y_g,accel_z_g,gyro_x_dps,gyro_y_dps,gyro_z_dps,- --rate-hz 100"
        ),
    ),
    "imu_tk": Format(
        "imu_tk.read_imu_tk",
        title="imu_tk pair",
        files=2,
        extra=None,
        known_by="two files without a header",
        reads=(
            "two text files, first that of the accelerometer and then that of the gyroscope, each with the "
            "columns time, x, y, z; sensors with different time stamps are resampled"
        ),
        units="raw counts, or SI units with --accel-unit m/s^2 and --gyro-unit rad/s",
        time="the first column, in s or in the unit of --time-unit",
        options=("time_unit", "accel_unit", "gyro_unit"),
        example="acc.mat gyro.mat",
    ),
    "pair": Format(
        "sensor_files.read_pair",
        title="one text file per sensor",
        files=2,
        extra=None,
        known_by="two files with headers",
        reads="two text files in any order; each file contains time, x, y and z of one sensor",
        units=(
            "from the headers, otherwise from --accel-unit (m/s^2, cm/s^2, mm/s^2, ft/s^2, g, mg, ug, lsb) "
            "and --gyro-unit (rad/s, mrad/s, deg/s, mdeg/s, deg/min, deg/h, rpm, gon/s, lsb)"
        ),
        time=(
            f"time stamps since 1970 if both files have them, otherwise the time column; {OWN_CLOCKS}; with "
            "--rate-hz the time stamps are not read, and the samples of both files are taken together in "
            "their order"
        ),
        options=("rate_hz", "time_unit", "accel_unit", "gyro_unit"),
        example="Accelerometer.csv Gyroscope.csv",
    ),
    "folder": Format(
        "sensor_files.read_folder",
        title="folder or zip of text files",
        files=1,
        extra=None,
        known_by="a folder or zip archive with .csv or .txt files",
        reads=(
            "either one text file that contains both sensors (only one file may contain both), or one file "
            "per sensor, as in the format `pair`; other files are ignored"
        ),
        units="as in the formats csv and pair",
        time=f"as in the formats csv and pair; {OWN_CLOCKS}",
        options=("columns", "rate_hz", "time_unit", "accel_unit", "gyro_unit"),
        example="phone.zip",
    ),
    "rows": Format(
        "sensor_rows.read_sensor_rows",
        title="one sensor per row",
        files=1,
        extra=None,
        known_by="a column that names the sensor of each row, such as accelerometer or gyroscope",
        reads=(
            "the rows of the accelerometer and those of the gyroscope, each as a text table in the format "
            "`pair`; rows of other sensors are ignored"
        ),
        units="as in the format pair",
        time=f"as in the format pair; {OWN_CLOCKS}",
        options=("rate_hz", "time_unit", "accel_unit", "gyro_unit"),
        example="sensors.csv",
    ),
    "json": Format(
        "json_text.read_json",
        title="JSON and JSON Lines",
        files=1,
        extra=None,
        known_by="content that starts with { or [",
        reads=(
            "a list of objects, or one object per line, whose members are the columns (a member of a member "
            "is called outer.inner, the numbers of a list of three are called outer.x, outer.y and outer.z); "
            "one list of objects per sensor, or a member that names the sensor of each object; one list of "
            "numbers per column, also with an object per sensor; files of Edge Impulse"
        ),
        units="as in the formats csv and pair, and in a member unit beside the axes",
        time=f"as in the formats csv and pair; interval_ms in files of Edge Impulse; {OWN_CLOCKS}",
        options=("columns", "rate_hz", "time_unit", "accel_unit", "gyro_unit"),
        example="recording.json",
    ),
    "sqlite": Format(
        "sqlite_tables.read_sqlite",
        title="SQLite",
        files=1,
        extra=None,
        known_by="content, if it is no ROS 2 bag",
        reads=(
            "one table that contains both sensors, one table per sensor, whose name is that of the sensor, "
            "or one table with a column that names the sensor of each row; other tables are ignored, and "
            "views are read only if no table contains a sensor"
        ),
        units="as in the formats csv and pair",
        time=f"as in the formats csv and pair; {OWN_CLOCKS}",
        options=("columns", "rate_hz", "time_unit", "accel_unit", "gyro_unit"),
        example="recording.sqlite",
    ),
    "labels": Format(
        "sentences.read_labels",
        title="label:value lines",
        files=1,
        extra=None,
        known_by="lines such as ax:0.01 ay:0.02 az:9.81, or ACCEL: X=0.01 Y=0.02 Z=9.81",
        reads=(
            "the values, with the labels as column names of the format csv; if each line contains the three "
            "axes of one sensor, the lines of all sensors together are one sample; lines with other labels "
            "are skipped, with a warning"
        ),
        units=NAMED_UNITS,
        time=DATED_TIME,
        options=("columns", "rate_hz"),
        example=(
            "plotter.txt --columns "
            "time_s=t,accel_x_mps2=ax,accel_y_mps2=ay,accel_z_mps2=az,gyro_x_radps=gx,gyro_y_radps=gy,gyro_z_radps=gz"
        ),
    ),
    "vectornav": Format(
        "sentences.read_vectornav",
        title="sentences of VectorNav, and others like NMEA 0183",
        files=1,
        extra=None,
        known_by="sentences $VNYMR, $VNIMU, $VNQMR or $VNMAR; other sentences with check sums",
        reads=(
            "acceleration and angular rate, and the temperature in $VNIMU; for other sentences, --columns "
            "names every field, starting with the name of the sentence; sentences with a wrong check sum are "
            "skipped, with a warning"
        ),
        units=(
            "m/s^2, rad/s and degC, as in the VN-100 user manual; for other sentences the units in --columns"
        ),
        time="sentences of VectorNav contain no time, so give --rate-hz",
        options=("columns", "rate_hz"),
        example="imu.txt --rate-hz 100",
    ),
    "witmotion": Format(
        "witmotion.read_witmotion",
        title="WitMotion binary packets",
        files=1,
        extra=None,
        known_by="packets 0x51 and 0x52 with valid check sums, or packets 0x61",
        reads=(
            "acceleration, angular rate and temperature; packets with a wrong check sum are skipped; packets "
            "0x61 (Bluetooth and SD-card models) contain acceleration and angular rate, and no check sum"
        ),
        units="raw counts of the ranges 16 g and 2000 deg/s (WT901 series), converted to m/s^2 and rad/s",
        time=(
            "time packets (0x50), or the time in packets 0x61 of an SD card, relative to the first sample; "
            "without a time, give --rate-hz"
        ),
        options=("rate_hz",),
        example="wt901.bin --rate-hz 100",
    ),
    "euroc": Format(
        "euroc.read_euroc",
        title="EuRoC",
        files=1,
        extra=None,
        known_by="its header",
        reads="the file data.csv of the IMU in a data set in the ASL format",
        units="rad/s and m/s^2, as in the header of the file",
        time="time stamps in ns, relative to the first sample",
        options=(),
        example="data.csv",
    ),
    "realsense": Format(
        "realsense.read_realsense",
        title="RealSense CSV",
        files=1,
        extra=None,
        known_by="its header",
        reads="the streams Accel and Gyro of a file that rs-convert or rs-data-collect has written",
        units="m/s^2 and rad/s, as defined in <https://dev.intelrealsense.com/docs/rs-motion>",
        time=f"the hardware clock, whose unit (ms or us) follows from the host clock; {OWN_CLOCKS}",
        options=(),
        example="d435i_imu_pose.csv",
    ),
    "rosbag": Format(
        "ros.read_rosbag",
        title="ROS 1 and ROS 2 bags",
        files=1,
        extra="ros",
        known_by="content (.bag, .db3), or a folder with metadata.yaml",
        reads=IMU_MESSAGES,
        units=ROS_UNITS,
        time=f"{ROS_TIME}; {OWN_CLOCKS}",
        options=("topic", "receive_time"),
        example="drive.bag --topic /imu/data",
        isolated=True,
    ),
    "mcap": Format(
        "ros.read_mcap",
        title="MCAP",
        files=1,
        extra="ros",
        known_by="content",
        reads=f"{IMU_MESSAGES}; messages may be serialised as in ROS 1 or as in ROS 2",
        units=ROS_UNITS,
        time=f"{ROS_TIME}; {OWN_CLOCKS}",
        options=("topic", "receive_time"),
        example="drive.mcap --topic /imu/data",
        isolated=True,
    ),
    "ulog": Format(
        "ulog.read_ulog",
        title="PX4 ULog",
        files=1,
        extra="px4",
        known_by="content",
        reads=(
            "uncorrected samples and temperature of sensor_accel and sensor_gyro; or, with a warning of "
            "imucal, samples of sensor_combined, to which PX4 has already applied its calibration "
            "parameters; "
            f"{CUT_OFF}"
        ),
        units=(
            "m/s^2, rad/s and degC, as defined in <https://docs.px4.io/main/en/msg_docs/SensorAccel> and "
            "similar pages"
        ),
        time=f"timestamp_sample, or timestamp if it is missing, relative to the first sample; {OWN_CLOCKS}",
        options=("topic", "instance"),
        example="flight.ulg --topic sensor_accel --instance 0",
        isolated=True,
    ),
    "dataflash": Format(
        "dataflash.read_dataflash",
        title="ArduPilot dataflash",
        files=1,
        extra="ardupilot",
        known_by="content",
        reads=(
            "IMU messages with temperature, or ACC and GYR messages with the sampling rates of the sensors; "
            f"ArduPilot has applied its calibration parameters to the samples (with a warning); {CUT_OFF}"
        ),
        units=(
            "m/s/s, rad/s and degC, as stated in the log (FMTU) and in "
            "<https://ardupilot.org/copter/docs/logmessages.html>"
        ),
        time=(
            "TimeUS of IMU messages, SampleUS of ACC and GYR messages, relative to the first sample; "
            f"{OWN_CLOCKS}"
        ),
        options=("topic", "instance"),
        example="flight.bin --topic IMU --instance 0",
        isolated=True,
    ),
    "matlab": Format(
        "matlab.read_matlab",
        title="MATLAB .mat, all versions",
        files=1,
        extra="matlab",
        known_by="content; for version 4 also .mat",
        reads=f"{NAMED_ARRAYS}; a struct is a group of arrays; tables and objects cannot be read",
        units=NAMED_UNITS,
        time=NAMED_TIME,
        options=("columns", "group", "rate_hz"),
        example="run.mat --columns time_s=imu.t,accel_mps2=imu.acc,gyro_dps=imu.gyr",
        isolated=True,
    ),
    "hdf5": Format(
        "hdf5.read_hdf5",
        title="HDF5",
        files=1,
        extra="hdf5",
        known_by="content",
        reads=f"{NAMED_ARRAYS}; each field of a compound data set is an array",
        units=NAMED_UNITS,
        time=NAMED_TIME,
        options=("columns", "group", "rate_hz"),
        example="run.h5 --group unit_1",
        isolated=True,
    ),
    "numpy": Format(
        "numpy_files.read_numpy",
        title="NumPy .npz and .npy",
        files=1,
        extra=None,
        known_by="content",
        reads=f"{NAMED_ARRAYS}; each field of a structured array is an array; pickled objects cannot be read",
        units=NAMED_UNITS,
        time=NAMED_TIME,
        options=("columns", "group", "rate_hz"),
        example="run.npz",
    ),
}
