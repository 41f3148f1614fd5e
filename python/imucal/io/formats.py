"""The formats that can be read, with their descriptions for `imucal convert --list` and docs/formats.md."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Final

from imucal.io.canonical import read_csv, read_parquet
from imucal.io.columns import read_columns
from imucal.io.dataflash import read_dataflash
from imucal.io.euroc import read_euroc
from imucal.io.hdf5 import read_hdf5
from imucal.io.imu_tk import read_imu_tk
from imucal.io.matlab import read_matlab
from imucal.io.numpy_files import read_numpy
from imucal.io.pieces import csv_pieces, parquet_pieces
from imucal.io.realsense import read_realsense
from imucal.io.ros import read_mcap, read_rosbag
from imucal.io.sensor_files import read_folder, read_pair
from imucal.io.sentences import read_labels, read_vectornav
from imucal.io.ulog import read_ulog
from imucal.io.witmotion import read_witmotion
from imucal.recording.recording import Recording

__all__ = ["FORMATS", "Format"]


@dataclass(frozen=True)
class Format:
    """A file format; one row of the catalogue.

    read      reads a recording; its keyword arguments are the options of the format
    title     name for people
    files     number of files of one recording
    extra     optional extra of the package that the format needs, or None
    known_by  how a file of this format is recognised
    reads     data that the reader takes from a file
    units     units of the data, and where they are defined
    time      origin of the time stamps
    options   keyword arguments of `read`
    example   files and options of an `imucal convert` command
    pieces    reads a recording in pieces, with the same options; None if files can only be read as a whole
    isolated  whether the file is read in a child process with limited memory and time, because the library
              for the format does not verify the lengths and offsets in a file
    """

    read: Callable[..., Recording]
    title: str
    files: int
    extra: str | None
    known_by: str
    reads: str
    units: str
    time: str
    options: tuple[str, ...]
    example: str
    pieces: Callable[..., Iterator[Recording]] | None = None
    isolated: bool = False


NAMED_UNITS = (
    "by the column names: accel mps2, g, mg, lsb; gyro radps, dps, mdps, lsb; "
    "temp degc, k, degf, lsb; stand rad, deg"
)
NAMED_TIME = "time_s unchanged; time_ms, time_us and time_ns counted from the first sample; or --rate-hz"
DATED_TIME = (
    "time_s unchanged; time_ms, time_us, time_ns and dates with a time of day counted from the first sample; "
    "or --rate-hz"
)
NAMED_ARRAYS = "arrays with canonical names, see below"
IMU_MESSAGES = (
    "sensor_msgs/Imu: linear_acceleration and angular_velocity; --topic if several topics contain it, two as "
    "ACCEL,GYRO if each sensor has its own topic"
)
ROS_UNITS = "m/s^2 and rad/s, by <https://docs.ros.org/en/jazzy/p/sensor_msgs/msg/Imu.html>"
ROS_TIME = (
    "header.stamp, counted from the first sample; --receive-time uses the time of receipt by the bag instead"
)
OWN_CLOCKS = "sensors with different time stamps are resampled to one clock, with a warning"

CUT_OFF = "a truncated log is read up to its last complete message"

FORMATS: Final[dict[str, Format]] = {
    "csv": Format(
        read_csv,
        "CSV with a header",
        1,
        None,
        "a header in one of the first 50 lines",
        "columns with canonical names, and other numeric columns as auxiliary inputs; columns with other "
        "names by --columns canonical=name, or without it if the header gives sensor, axis and unit of each",
        NAMED_UNITS,
        DATED_TIME,
        ("columns", "rate_hz"),
        "other.csv --columns time_ms=t,accel_x_g=ax,accel_y_g=ay,accel_z_g=az,"
        "gyro_x_dps=gx,gyro_y_dps=gy,gyro_z_dps=gz",
        csv_pieces,
    ),
    "parquet": Format(
        read_parquet,
        "Parquet",
        1,
        None,
        "content, or .parquet",
        "the same as csv",
        NAMED_UNITS,
        DATED_TIME,
        ("columns", "rate_hz"),
        "run.parquet",
        parquet_pieces,
    ),
    "columns": Format(
        read_columns,
        "Text without a canonical header",
        1,
        None,
        "--columns",
        "numbers separated by tab, semicolon, comma or spaces; a header is compared with the given names",
        NAMED_UNITS,
        NAMED_TIME,
        ("columns", "rate_hz", "skip_rows"),
        "log.txt --columns accel_x_g,accel_y_g,accel_z_g,gyro_x_dps,gyro_y_dps,gyro_z_dps,- --rate-hz 100",
    ),
    "imu_tk": Format(
        read_imu_tk,
        "imu_tk pair",
        2,
        None,
        "two files without a header",
        "two text files, accelerometer and gyroscope, with the columns time, x, y, z; other time stamps are "
        "resampled",
        "raw counts, or SI with --accel-unit m/s^2 and --gyro-unit rad/s",
        "the first column, in s or --time-unit",
        ("time_unit", "accel_unit", "gyro_unit"),
        "acc.mat gyro.mat",
    ),
    "pair": Format(
        read_pair,
        "one text file per sensor",
        2,
        None,
        "two files with headers",
        "two text files in any order, each with time, x, y, z of one sensor",
        "by the headers, else --accel-unit (m/s^2, g, mg, lsb) and --gyro-unit (rad/s, deg/s, mdeg/s, lsb)",
        f"stamps since 1970 if both have them, else the time column; {OWN_CLOCKS}",
        ("time_unit", "accel_unit", "gyro_unit"),
        "Accelerometer.csv Gyroscope.csv",
    ),
    "folder": Format(
        read_folder,
        "folder or zip of text files",
        1,
        None,
        "a folder or zip archive with .csv or .txt files",
        "the one text file with both sensors, or one file per sensor as for pair; other files are ignored",
        "as for csv and pair",
        f"as for csv and pair; {OWN_CLOCKS}",
        ("columns", "rate_hz", "time_unit", "accel_unit", "gyro_unit"),
        "phone.zip",
    ),
    "labels": Format(
        read_labels,
        "label:value lines",
        1,
        None,
        "lines such as ax:0.01 ay:0.02 az:9.81, or Accel X:0.01 Y:0.02 Z:9.81",
        "the labels as column names, as in csv; lines of several sensors with three axes each are one "
        "sample; lines with other labels are left out, with a warning",
        NAMED_UNITS,
        DATED_TIME,
        ("columns", "rate_hz"),
        "plotter.txt --columns time_s=t,accel_x_mps2=ax,accel_y_mps2=ay,accel_z_mps2=az,"
        "gyro_x_radps=gx,gyro_y_radps=gy,gyro_z_radps=gz",
    ),
    "vectornav": Format(
        read_vectornav,
        "sentences of VectorNav, and others like NMEA 0183",
        1,
        None,
        "sentences $VNYMR, $VNIMU, $VNQMR or $VNMAR; other sentences with check sums",
        "accelerations, rates, and the temperature of $VNIMU; sentences with a wrong check sum are left out, "
        "with a warning; --columns names every field of other sentences, the name of the sentence first",
        "m/s^2, rad/s and degC, by the VN-100 user manual; of other sentences by --columns",
        "none in the sentences of VectorNav: --rate-hz",
        ("columns", "rate_hz"),
        "imu.txt --rate-hz 100",
    ),
    "witmotion": Format(
        read_witmotion,
        "WitMotion binary packets",
        1,
        None,
        "packets 0x51 and 0x52 with valid check sums",
        "acceleration, angular rate and temperature; packets with a wrong check sum are left out",
        "counts of 16 g and 2000 deg/s, the ranges of the WT901 series, converted to m/s^2 and rad/s",
        "packets of time (0x50), counted from the first sample; or --rate-hz",
        ("rate_hz",),
        "wt901.bin --rate-hz 100",
    ),
    "euroc": Format(
        read_euroc,
        "EuRoC",
        1,
        None,
        "its header",
        "the IMU's data.csv of a data set in the ASL form",
        "rad/s and m/s^2, by the file's header",
        "ns, counted from the first sample",
        (),
        "data.csv",
    ),
    "realsense": Format(
        read_realsense,
        "RealSense CSV",
        1,
        None,
        "its header",
        "the streams Accel and Gyro of a file of rs-convert or rs-data-collect",
        "m/s^2 and rad/s, by <https://dev.intelrealsense.com/docs/rs-motion>",
        f"the hardware clock, in ms or us as the clock of the host shows; {OWN_CLOCKS}",
        (),
        "d435i_imu_pose.csv",
    ),
    "rosbag": Format(
        read_rosbag,
        "ROS 1 and ROS 2 bags",
        1,
        "ros",
        "content (.bag, .db3), or a folder with metadata.yaml",
        IMU_MESSAGES,
        ROS_UNITS,
        f"{ROS_TIME}; {OWN_CLOCKS}",
        ("topic", "receive_time"),
        "drive.bag --topic /imu/data",
        isolated=True,
    ),
    "mcap": Format(
        read_mcap,
        "MCAP",
        1,
        "ros",
        "content",
        f"{IMU_MESSAGES}; serialised as in ROS 1 or ROS 2",
        ROS_UNITS,
        f"{ROS_TIME}; {OWN_CLOCKS}",
        ("topic", "receive_time"),
        "drive.mcap --topic /imu/data",
        isolated=True,
    ),
    "ulog": Format(
        read_ulog,
        "PX4 ULog",
        1,
        "px4",
        "content",
        "sensor_accel with sensor_gyro, uncorrected, and their temperature; or sensor_combined, to which "
        f"PX4 has applied its calibration parameters (with a warning); {CUT_OFF}",
        "m/s^2, rad/s, degC, by <https://docs.px4.io/main/en/msg_docs/SensorAccel> and its like",
        f"timestamp_sample, else timestamp, counted from the first sample; {OWN_CLOCKS}",
        ("topic", "instance"),
        "flight.ulg --topic sensor_accel --instance 0",
        isolated=True,
    ),
    "dataflash": Format(
        read_dataflash,
        "ArduPilot dataflash",
        1,
        "ardupilot",
        "content",
        "IMU and its temperature, or ACC with GYR at the sensors' own rates; ArduPilot has applied its "
        f"calibration parameters (with a warning); {CUT_OFF}",
        "m/s/s, rad/s, degC, by the log itself (FMTU) and "
        "<https://ardupilot.org/copter/docs/logmessages.html>",
        f"TimeUS of IMU, SampleUS of ACC and GYR, counted from the first sample; {OWN_CLOCKS}",
        ("topic", "instance"),
        "flight.bin --topic IMU --instance 0",
        isolated=True,
    ),
    "matlab": Format(
        read_matlab,
        "MATLAB .mat, all versions",
        1,
        "matlab",
        "content; --format matlab for version 4",
        f"{NAMED_ARRAYS}; a struct is a group; no tables and no objects",
        NAMED_UNITS,
        NAMED_TIME,
        ("columns", "group", "rate_hz"),
        "run.mat --columns time_s=imu.t,accel_mps2=imu.acc,gyro_dps=imu.gyr",
        isolated=True,
    ),
    "hdf5": Format(
        read_hdf5,
        "HDF5",
        1,
        "hdf5",
        "content",
        f"{NAMED_ARRAYS}; compound data sets by their fields",
        NAMED_UNITS,
        NAMED_TIME,
        ("columns", "group", "rate_hz"),
        "run.h5 --group unit_1",
        isolated=True,
    ),
    "numpy": Format(
        read_numpy,
        "NumPy .npz and .npy",
        1,
        None,
        "content",
        f"{NAMED_ARRAYS}; structured arrays by their fields; no pickled objects",
        NAMED_UNITS,
        NAMED_TIME,
        ("columns", "group", "rate_hz"),
        "run.npz",
    ),
}
