"""The exports of makers and apps in docs/formats.md, each on a file in the form of its description."""

import gzip
import re
import zipfile
from dataclasses import dataclass

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import imucal
from imucal.cli.exports_page import EXPORTS

ROWS, RATE_HZ = 300, 100.0
G, DEG = 9.80665, np.pi / 180
# Columns of sensor_msgs/Imu as text.
STAMP = ("header.stamp.sec", "header.stamp.nanosec")
OF_RATE, OF_FORCE = "angular_velocity", "linear_acceleration"
START_NS = 1_767_268_800_000_000_000  # 2026-01-01 12:00:00 UTC


def samples():
    """Time, force and rate of a unit that rests and turns; SI units."""
    noise = np.random.default_rng(3)
    time_s = np.arange(ROWS) / RATE_HZ
    force = np.array([0.4, -0.3, 9.78]) + noise.normal(scale=0.02, size=(ROWS, 3))
    rate = noise.normal(scale=1e-3, size=(ROWS, 3)) + np.outer(np.sin(time_s), [0.5, -0.3, 0.2])
    return time_s, force, rate


TIME_S, FORCE, RATE = samples()
NS = START_NS + np.round(TIME_S * 1e9).astype(np.int64)


def lines(*columns, separator=",", decimal="."):
    flat = [
        axis for column in columns for axis in (np.asarray(column).T if np.ndim(column) == 2 else [column])
    ]
    return [
        separator.join(str(cell).replace(".", decimal) for cell in row) for row in zip(*flat, strict=True)
    ]


def write(folder, name, *parts, end="\n", encoding="utf-8"):
    text = [line for part in parts for line in ([part] if isinstance(part, str) else part)]
    path = folder / name
    path.parent.mkdir(exist_ok=True, parents=True)
    path.write_bytes((end.join(text) + end).encode(encoding))
    return path


def zipped(folder, name):
    with zipfile.ZipFile(folder / name, "w") as archive:
        for path in sorted(folder.rglob("*.csv")):
            archive.write(path, path.relative_to(folder))
    return folder / name


@dataclass
class Made:
    """The arguments of `imucal.read`, and how many samples may be missing or resampled."""

    paths: list
    options: dict
    resampled: bool = False
    tolerance: float = 1e-9


SAMPLES = {}


def sample(name):
    def keep(make):
        SAMPLES[name] = make
        return make

    return keep


@sample("phyphox, CSV (tabulator)")
def phyphox_tab(folder):
    header = "\t".join(
        f'"{name}"'
        for name in (
            "Time (s)",
            *(f"Acceleration {a} (m/s^2)" for a in "xyz"),
            *(f"Gyroscope {a} (rad/s)" for a in "xyz"),
            "Absolute acceleration (m/s^2)",
        )
    )
    rows = lines(TIME_S, FORCE, RATE, np.linalg.norm(FORCE, axis=1), separator="\t")
    return Made([write(folder, "Raw Data.csv", header, rows)], {})


@sample("phyphox, CSV (semicolon, decimal comma)")
def phyphox_comma(folder):
    header = ";".join(
        f'"{name}"'
        for name in (
            "Time (s)",
            *(f"Acceleration {a} (m/s^2)" for a in "xyz"),
            *(f"Gyroscope {a} (rad/s)" for a in "xyz"),
        )
    )
    return Made([write(folder, "d.csv", header, lines(TIME_S, FORCE, RATE, separator=";", decimal=","))], {})


@sample("phyphox, zip")
def phyphox_zip(folder):
    write(
        folder,
        "Accelerometer.csv",
        ",".join(f'"{n}"' for n in ("Time (s)", "X (m/s^2)", "Y (m/s^2)", "Z (m/s^2)")),
        lines(TIME_S, FORCE),
    )
    write(
        folder,
        "Gyroscope.csv",
        ",".join(f'"{n}"' for n in ("Time (s)", "X (rad/s)", "Y (rad/s)", "Z (rad/s)")),
        lines(TIME_S, RATE),
    )
    write(folder, "meta/device.csv", '"property","value"', '"deviceModel","Pixel"')
    write(folder, "meta/time.csv", '"event","experiment time","system time"', '"START",0.0,1767268800.0')
    return Made([zipped(folder, "phone.zip")], {})


@sample("Sensor Logger, zip")
def sensor_logger(folder):
    elapsed = lines(NS, TIME_S)
    still = np.random.default_rng(1).normal(scale=0.02, size=(ROWS, 3))
    for name, values in (
        ("Accelerometer", still),
        ("Gravity", FORCE - still),
        ("TotalAcceleration", FORCE),
        ("Gyroscope", RATE),
        ("Magnetometer", 40 + still),
    ):
        rows = [f"{at},{row}" for at, row in zip(elapsed, lines(values[:, ::-1]), strict=True)]
        write(folder, f"{name}.csv", "time,seconds_elapsed,z,y,x", rows)
    write(
        folder,
        "Orientation.csv",
        "time,seconds_elapsed,yaw,qx,qz,roll,qw,qy,pitch",
        [f"{at},0,0,0,0,0,1,0" for at in elapsed],
    )
    write(folder, "Annotation.csv", "time,seconds_elapsed,text,millisecond_press_duration")
    write(
        folder,
        "Metadata.csv",
        "version,device name,recording epoch time,platform",
        "3,phone,1767268800000,android",
    )
    return Made([zipped(folder, "2026-01-01.zip")], {})


@sample("Physics Toolbox Sensor Suite")
def physics_toolbox(folder):
    header = "time,gFx,gFy,gFz,ax,ay,az,wx,wy,wz,p,Bx,By,Bz"
    rest = np.full((ROWS, 4), 0.25)
    return Made(
        [write(folder, "multi.csv", header, lines(TIME_S, FORCE / G, FORCE * 0, RATE, rest))],
        {},
        tolerance=1e-7,
    )


@sample("AndroSensor")
def androsensor(folder):
    names = [
        *(f"ACCELEROMETER {a} (m/s²)" for a in "XYZ"),
        *(f"GRAVITY {a} (m/s²)" for a in "XYZ"),
        *(f"LINEAR ACCELERATION {a} (m/s²)" for a in "XYZ"),
        *(f"GYROSCOPE {a} (rad/s)" for a in "XYZ"),
        *(f"MAGNETIC FIELD {a} (μT)" for a in "XYZ"),
        *("ORIENTATION Z (azimuth °)", "ORIENTATION X (pitch °)", "ORIENTATION Y (roll °)", "PROXIMITY (i)"),
        *("Time since start in ms ", "YYYY-MO-DD HH-MI-SS_SSS"),
    ]
    ms, nothing = np.round(TIME_S * 1000).astype(int), np.zeros((ROWS, 4))
    dates = colon_dates()
    rows = lines(FORCE, FORCE, FORCE * 0, RATE, FORCE, nothing, ms, dates, separator=";")
    return Made([write(folder, "sensor.csv", ";".join(names), rows)], {})


def colon_dates():
    return [f"2026-01-01 12:00:{int(at):02d}:{round(at * 1000) % 1000:03d}" for at in TIME_S]


@sample("Xsens MT Manager, ASCII export")
def mt_manager(folder):
    above = [
        "// General information:",
        "//  MT Manager version: 2022.0.0",
        "//  XDA version: 2022.0.0 build 7381",
        "// Device information:",
        "//  DeviceId: 03880011",
        "//  ProductCode: MTI-630-8A1G6",
        "// Device settings:",
        "//  Update Rate: 100.0Hz",
        "//  Filter Profile: General (50.1)",
    ]
    names = [
        "PacketCounter",
        "SampleTimeFine",
        *(f"Acc_{a}" for a in "XYZ"),
        *(f"FreeAcc_{a}" for a in "ENU"),
        *(f"Gyr_{a}" for a in "XYZ"),
        *(f"Mag_{a}" for a in "XYZ"),
        "Roll",
        "Pitch",
        "Yaw",
    ]
    ticks = 4_000_000 + np.round(TIME_S * 1e4).astype(int)
    rows = lines(np.arange(ROWS), ticks, FORCE, FORCE * 0, RATE, FORCE * 0, FORCE * 0, separator="\t")
    return Made([write(folder, "MT_0388.txt", above, "\t".join(names), rows, end="\r\n")], {})


@sample("Movella DOT (Xsens DOT), CSV")
def movella_dot(folder):
    above = [
        "sep=,",
        "DeviceTag:,DOT 1",
        "FirmwareVersion:,2.0.0",
        "AppVersion:,2021.0",
        "SyncStatus:,Unsynced",
        "OutputRate:,60Hz",
        "FilterProfile:,General",
        "Measurement Mode:,Rate quantities (with mag)",
        "StartTime:,2026-01-01_12-00-00",
        "© Movella Technologies B. V. 2005-2023",
        "",
    ]
    names = [
        "PacketCounter",
        "SampleTimeFine",
        *(f"Acc_{a}" for a in "XYZ"),
        *(f"Gyr_{a}" for a in "XYZ"),
        *(f"Mag_{a}" for a in "XYZ"),
    ]
    ticks = 1_500_000 + np.round(TIME_S * 1e6).astype(int)
    rows = lines(np.arange(ROWS), ticks, FORCE, RATE / DEG, FORCE * 0.1)
    return Made([write(folder, "dot.csv", above, ",".join(names), [row + "," for row in rows])], {})


@sample("Shimmer Consensys, CSV (calibrated)")
def shimmer(folder):
    unit = "Shimmer_5E4A_"
    names = [
        f"{unit}Timestamp_Unix_CAL",
        *(f"{unit}Accel_LN_{a}_CAL" for a in "XYZ"),
        *(f"{unit}Gyro_{a}_CAL" for a in "XYZ"),
        *(f"{unit}Mag_{a}_CAL" for a in "XYZ"),
    ]
    units = ["ms", *["m/(s^2)"] * 3, *["deg/s"] * 3, *["local_flux"] * 3]
    rows = lines(NS // 10**6, FORCE, RATE / DEG, FORCE, separator="\t")
    return Made(
        [
            write(
                folder,
                "shimmer.csv",
                '"sep=\t"',
                "\t".join(names) + "\t",
                "\t".join(units) + "\t",
                [row + "\t" for row in rows],
            )
        ],
        {},
    )


@sample("ST MEMS Studio and Unico")
def mems_studio(folder):
    names = [*(f"A_{a} [mg]" for a in "XYZ"), *(f"G_{a} [dps]" for a in "XYZ")]
    above = ["STEVAL-MKI109V3", "Datalog", ""]
    return Made(
        [
            write(
                folder,
                "log.txt",
                above,
                "\t".join(names),
                lines(FORCE / G * 1000, RATE / DEG, separator="\t"),
            )
        ],
        {"rate_hz": RATE_HZ},
    )


@sample("ST BLE Sensor app")
def st_ble(folder):
    files = []
    for name, unit, values in (("Accelerometer", "mg", FORCE / G * 1000), ("Gyroscope", "dps", RATE / DEG)):
        names = [
            "Date",
            "HostTimestamp",
            "NodeName",
            "NodeTimestamp",
            "RawData",
            *(f"{a} [{unit}]" for a in "XYZ"),
        ]
        dates = [f"01/01/2026 12:00:{at:06.3f}" for at in TIME_S]
        ms = np.round(TIME_S * 1000).astype(int)
        rows = [f"{d},{t},BCN-1,{t},4B6600,{row}" for d, t, row in zip(dates, ms, lines(values), strict=True)]
        files.append(write(folder, f"20260101_{name}.csv", ", ".join(names), rows))
    return Made(files, {"time_unit": "ms"})


@sample("WitMotion, text record")
def witmotion(folder):
    names = [
        "time",
        "DeviceName",
        "Chip Time()",
        *(f"Acceleration {a}(g)" for a in "XYZ"),
        *(f"Angular velocity {a}(°/s)" for a in "XYZ"),
        *(f"Angle {a}(°)" for a in "XYZ"),
        *(f"Magnetic field {a}(ʯt)" for a in "XYZ"),
        "Temperature(°C)",
    ]
    zero = np.zeros((ROWS, 3))
    rows = lines(
        colon_dates(),
        ["WT901BLE67(e4:2f)"] * ROWS,
        colon_dates(),
        FORCE / G,
        RATE / DEG,
        zero,
        zero,
        np.full(ROWS, 25.5),
        separator="\t",
    )
    return Made([write(folder, "data.txt", "\t".join(names), [row + "\t" for row in rows], end="\r\n")], {})


def packets(scale=1.0):
    made = b""
    for at, accel in enumerate(FORCE):
        second, ms = divmod(at * 10, 1000)
        words = (
            (0x50, np.frombuffer(bytes([26, 1, 31, 23, 59, 57 + second]) + ms.to_bytes(2, "little"), "<i2")),
            (0x51, [*np.round(accel / G / 16 * 32768 * scale), 2550]),
            (0x52, [*np.round(RATE[at] / DEG / 2000 * 32768), 0]),
            (0x53, [1, 2, 3, 4]),
        )
        for kind, values in words:
            body = bytes([0x55, kind]) + np.asarray(values, "<i2").tobytes()
            made += body + bytes([sum(body) & 0xFF])
    return made


@sample("WitMotion, binary packets")
def witmotion_packets(folder):
    path = folder / "wt901.bin"
    path.write_bytes(packets())
    return Made([path], {"rate_hz": RATE_HZ}, tolerance=3e-3)


@sample("x-io x-IMU3, CSV folder")
def ximu3(folder):
    us = 5_000_000 + np.round(TIME_S * 1e6).astype(int)
    inside = folder / "x-IMU3"
    names = [
        "Timestamp (us)",
        *(f"Gyroscope {a} (deg/s)" for a in "XYZ"),
        *(f"Accelerometer {a} (g)" for a in "XYZ"),
    ]
    write(inside, "Inertial.csv", ",".join(names), lines(us, RATE / DEG, FORCE / G))
    write(
        inside,
        "Magnetometer.csv",
        "Timestamp (us),Magnetometer X (a.u.),Magnetometer Y (a.u.),Magnetometer Z (a.u.)",
        lines(us[::5], FORCE[::5]),
    )
    write(inside, "Temperature.csv", "Timestamp (us),Temperature (degC)", lines(us[::20], np.full(15, 21.5)))
    write(
        inside,
        "Battery.csv",
        "Timestamp (us),Percentage (%),Voltage (V),Charging status ()",
        lines(us[::20], np.full((15, 3), 1.0)),
    )
    return Made([inside], {})


@sample("x-io NGIMU, sensors.csv")
def ngimu(folder):
    names = [
        "Time (s)",
        *(f"Gyroscope {a} (deg/s)" for a in "XYZ"),
        *(f"Accelerometer {a} (g)" for a in "XYZ"),
        *(f"Magnetometer {a} (uT)" for a in "XYZ"),
        "Barometer (hPa)",
    ]
    return Made(
        [write(folder, "sensors.csv", ",".join(names), lines(TIME_S, RATE / DEG, FORCE / G, FORCE, TIME_S))],
        {},
    )


@sample("VectorNav, ASCII output")
def vectornav(folder):
    made = []
    for force, rate in zip(FORCE, RATE, strict=True):
        body = (
            "VNYMR,+010.000,+001.000,-002.000,+00.2000,+00.1000,+00.4000,"
            + ",".join(f"{x:+.3f}" for x in force)
            + ","
            + ",".join(f"{x:+.6f}" for x in rate)
        )
        total = 0
        for byte in body.encode():
            total ^= byte
        made.append(f"${body}*{total:02X}")
    return Made([write(folder, "vn.txt", made, end="\r\n")], {"rate_hz": RATE_HZ}, tolerance=6e-4)


@sample("Arduino serial plotter")
def plotter(folder):
    labels = ["t", "ax", "ay", "az", "gx", "gy", "gz"]
    rows = [
        "\t".join(f"{n}:{x}" for n, x in zip(labels, row, strict=True))
        for row in np.column_stack([TIME_S, FORCE, RATE])
    ]
    columns = "time_s=t," + ",".join(f"accel_{a}_mps2=a{a},gyro_{a}_radps=g{a}" for a in "xyz")
    return Made([write(folder, "plotter.txt", "MPU6050 found", rows)], {"columns": columns})


@sample("MbientLab MetaBase")
def metabase(folder):
    files = []
    for name, unit, values, delay_ms in (
        ("Accelerometer", "g", FORCE / G, 0),
        ("Gyroscope", "deg/s", RATE / DEG, 0),
    ):
        header = f"epoch (ms),time (+00:00),elapsed (s),x-axis ({unit}),y-axis ({unit}),z-axis ({unit})"
        ms = NS // 10**6 + delay_ms
        dates = [f"2026-01-01T12:00:{at:06.3f}" for at in TIME_S]
        # Each file counts its own elapsed time.
        files.append(
            write(
                folder,
                f"MetaWear_C8_{name}_100.000Hz_1.5.0.csv",
                header,
                lines(ms, dates, TIME_S + 0.3 * len(files), values),
            )
        )
    return Made(files, {})


@sample("SensorLog (iOS)")
def sensorlog(folder):
    names = [
        "loggingTime(txt)",
        "loggingSample(N)",
        "accelerometerTimestamp_sinceReboot(s)",
        *(f"accelerometerAcceleration{a}(G)" for a in "XYZ"),
        "gyroTimestamp_sinceReboot(s)",
        *(f"gyroRotation{a}(rad/s)" for a in "XYZ"),
        *(f"motionUserAcceleration{a}(G)" for a in "XYZ"),
        *(f"motionRotationRate{a}(rad/s)" for a in "XYZ"),
    ]
    dates = [f"2026-01-01T12:00:{at:06.3f}+01:00" for at in TIME_S]
    rows = lines(dates, np.arange(ROWS), TIME_S + 5, FORCE / G, TIME_S + 5, RATE, FORCE * 0, RATE)
    columns = "time_s=accelerometerTimestamp_sinceReboot(s)," + ",".join(
        [
            *(f"accel_{a.lower()}_g=accelerometerAcceleration{a}(G)" for a in "XYZ"),
            *(f"gyro_{a.lower()}_radps=gyroRotation{a}(rad/s)" for a in "XYZ"),
        ]
    )
    return Made([write(folder, "log.csv", ",".join(names), rows)], {"columns": columns})


@sample("ROS 1, rostopic echo -p")
def rostopic(folder):
    names = [
        "%time",
        "field.header.seq",
        "field.header.stamp",
        "field.header.frame_id",
        *(f"field.orientation.{a}" for a in "xyzw"),
        *(f"field.orientation_covariance{i}" for i in range(9)),
        *(f"field.angular_velocity.{a}" for a in "xyz"),
        *(f"field.angular_velocity_covariance{i}" for i in range(9)),
        *(f"field.linear_acceleration.{a}" for a in "xyz"),
        *(f"field.linear_acceleration_covariance{i}" for i in range(9)),
    ]
    nine = np.zeros((ROWS, 9))
    rows = lines(NS, np.arange(ROWS), NS, ["imu_link"] * ROWS, nine[:, :4], nine, RATE, nine, FORCE, nine)
    return Made([write(folder, "imu.csv", ",".join(names), rows)], {})


@sample("PlotJuggler, CSV export")
def plotjuggler(folder):
    names = [
        "__time",
        *(f"/imu/data/angular_velocity/{a}" for a in "xyz"),
        *(f"/imu/data/linear_acceleration/{a}" for a in "xyz"),
        "/imu/data/header/seq",
    ]
    return Made(
        [write(folder, "pj.csv", ",".join(names), lines(NS / 1e9, RATE, FORCE, np.arange(ROWS)))],
        {},
        tolerance=1e-6,
    )


@sample("ActiGraph, IMU CSV")
def actigraph(folder):
    above = [
        "------------ Data File Created By ActiGraph Link ActiLife v6.13.4 Firmware v1.7.2 date format "
        "M/d/yyyy at 100 Hz -----------",
        "Serial Number: TAS1D48140206",
        "Start Time 12:00:00",
        "Start Date 1/1/2026",
        "Epoch Period (hh:mm:ss) 00:00:00",
        "Download Time 14:00:00",
        "Download Date 1/1/2026",
        "Current Memory Address: 0",
        "Current Battery Voltage: 4.21     Mode = 12",
        "--------------------------------------------------",
    ]
    names = [
        "Timestamp",
        *(f"Accelerometer {a}" for a in "XYZ"),
        "Temperature",
        *(f"Gyroscope {a}" for a in "XYZ"),
        *(f"Magnetometer {a}" for a in "XYZ"),
    ]
    dates = [f"2026-01-01T12:00:{at:010.7f}" for at in TIME_S]
    return Made(
        [
            write(
                folder,
                "acti.csv",
                above,
                ",".join(names),
                lines(dates, FORCE / G, np.full(ROWS, 25.1), RATE / DEG, FORCE),
            )
        ],
        {},
    )


@sample("Axivity AX6, OmGui CSV")
def axivity(folder):
    names = ["Time", *(f"Accel-{a} (g)" for a in "XYZ"), *(f"Gyro-{a} (d/s)" for a in "XYZ")]
    dates = [f"2026-01-01 12:00:{at:06.3f}" for at in TIME_S]
    return Made([write(folder, "ax6.csv", ",".join(names), lines(dates, FORCE / G, RATE / DEG))], {})


@sample("ACEINNA NavView and OpenIMU")
def aceinna(folder):
    names = [
        "time (s)",
        *(f"{a}Accel (m/s^2)" for a in "xyz"),
        *(f"{a}Rate (deg/s)" for a in "xyz"),
        *(f"{a}Mag (Gauss)" for a in "xyz"),
    ]
    return Made(
        [
            write(
                folder,
                "openimu.csv",
                "% OpenIMU300ZI data",
                ", ".join(names),
                lines(TIME_S, FORCE, RATE / DEG, FORCE, separator=", "),
            )
        ],
        {},
    )


@sample("SBG Systems, sbgCenter export")
def sbg(folder):
    names = [
        "timestamp",
        "status",
        *(f"accel{a}" for a in "XYZ"),
        *(f"gyro{a}" for a in "XYZ"),
        "temperature",
    ]
    units = ["(us)", "(na)", *["(m.s^-2)"] * 3, *["(rad.s^-1)"] * 3, "(degC)"]
    us = np.round(TIME_S * 1e6).astype(int)
    return Made(
        [
            write(
                folder,
                "imu.txt",
                "\t".join(names),
                "\t".join(units),
                lines(us, np.full(ROWS, 511), FORCE, RATE, np.full(ROWS, 30.5), separator="\t"),
            )
        ],
        {},
    )


@sample("Betaflight, blackbox_decode")
def betaflight(folder):
    names = [
        "loopIteration",
        "time (us)",
        *(f"axisP[{i}]" for i in range(3)),
        "vbatLatest (V)",
        *(f"gyroADC[{i}] (deg/s)" for i in range(3)),
        *(f"accSmooth[{i}] (g)" for i in range(3)),
        *(f"motor[{i}]" for i in range(4)),
        "flightModeFlags (flags)",
    ]
    us = np.round(TIME_S * 1e6).astype(int)
    rows = lines(
        np.arange(ROWS),
        us,
        np.zeros((ROWS, 3)),
        np.full(ROWS, 16.1),
        RATE / DEG,
        FORCE / G,
        np.zeros((ROWS, 4)),
        ["ARM|ANGLE"] * ROWS,
        separator=", ",
    )
    return Made([write(folder, "LOG00001.01.csv", ", ".join(names), rows)], {})


def realsense_lines(ticks_per_ms=1, step=1, late_ms=5.0):
    """Lines of rs-convert: the accelerometer has every `step`-th sample, the gyroscope is late."""
    head = "Stream Type,F#,HW Timestamp (ms),Backend Timestamp(ms),Host Timestamp(ms),3DOF_x,3DOF_y,3DOF_z"
    host = START_NS / 1e6 + TIME_S * 1000
    parts = []
    for kind, values, each, late in (("Accel", FORCE, step, 0.0), ("Gyro", RATE, 1, late_ms)):
        hardware = [f"{ticks_per_ms * (4e6 + stamp + late):.3f}" for stamp in TIME_S[::each] * 1000]
        rows = lines(
            [kind] * len(hardware),
            np.arange(len(hardware)),
            hardware,
            [f"{stamp:.3f}" for stamp in host[::each]],
            [f"{stamp + 1.5:.3f}" for stamp in host[::each]],
            values[::each],
        )
        parts += ["", "", head, *rows]
    return parts


@sample("RealSense, rs-convert")
def realsense(folder):
    return Made([write(folder, "d435i_120000_imu_pose.csv", realsense_lines())], {}, resampled=True)


@sample("GoPro, telemetry extractor CSV")
def gopro(folder):
    files = []
    for name, unit, values in (("Accelerometer", "m/s2", FORCE), ("Gyroscope", "rad/s", RATE)):
        names = ["cts", "date", *(f"{name} ({a}) [{unit}]" for a in "zxy"), "temperature [°C]"]
        dates = [f"2026-01-01T12:00:{at:06.3f}Z" for at in TIME_S]
        files.append(
            write(
                folder,
                f"GH010001_{name}.csv",
                ",".join(names),
                lines(TIME_S * 1000, dates, values[:, [2, 0, 1]], np.full(ROWS, 40.0)),
            )
        )
    return Made(files, {"time_unit": "ms"})


@sample("Variense VMU931 and other loggers of one file per sensor")
def vmu931(folder):
    ms = np.round(TIME_S * 1000).astype(int)
    accel = write(folder, "acc.txt", "time(ms),x(g),y(g),z(g)", lines(ms, FORCE / G))
    late = write(folder, "gyro.txt", "time(ms),x(deg/s),y(deg/s),z(deg/s)", lines(ms + 5, RATE / DEG))
    return Made([accel, late], {}, resampled=True)


@sample("MATLAB, writetimetable")
def timetable(folder):
    header = "Time,accel_x_mps2,accel_y_mps2,accel_z_mps2,gyro_x_radps,gyro_y_radps,gyro_z_radps"
    dates = [f"01-Jan-2026 12:00:{at:06.3f}" for at in TIME_S]
    return Made([write(folder, "run.csv", header, lines(dates, FORCE, RATE))], {"columns": "time_s=Time"})


@sample("Adafruit's Arduino examples (MPU6050, LSM6DS, BNO055), serial monitor")
def adafruit(folder):
    made = ["Adafruit MPU6050 test!", "MPU6050 Found!", ""]
    for force, rate in zip(FORCE, RATE, strict=True):
        made += [
            "Acceleration X: {:.5f}, Y: {:.5f}, Z: {:.5f} m/s^2".format(*force),
            "Rotation X: {:.5f}, Y: {:.5f}, Z: {:.5f} rad/s".format(*rate),
            "Temperature: 27.63 degC",
            "",
        ]
    return Made([write(folder, "serial.txt", made)], {"rate_hz": RATE_HZ}, tolerance=6e-6)


@sample("SparkFun ICM-20948 examples, serial monitor")
def sparkfun(folder):
    made = ["Initialization of the sensor returned: All is well."]
    for force, rate in zip(FORCE / G * 1000, RATE / DEG, strict=True):
        acc, gyr = (", ".join(f"{number:08.2f}" for number in axes) for axes in (force, rate))
        made.append(
            f"Scaled. Acc (mg) [ {acc} ], Gyr (DPS) [ {gyr} ], Mag (uT) [ 0001.00, 0002.00, 0003.00 ], "
            "Tmp (C) [ 0025.10 ]"
        )
    return Made([write(folder, "serial.txt", made)], {"rate_hz": RATE_HZ}, tolerance=1e-4)


@sample("SparkFun OpenLog Artemis")
def openlog_artemis(folder):
    names = [
        "rtcDate",
        "rtcTime",
        *(f"{what}{axis}" for what in "agm" for axis in "XYZ"),
        "imu_degC",
        "output_Hz",
    ]
    times = [f"12:00:{at:05.2f}" for at in TIME_S]
    rows = lines(
        ["01/01/2026"] * ROWS, times, FORCE / G * 1000, RATE / DEG, FORCE, np.full((ROWS, 2), [25.5, 100.2])
    )
    header = ",".join(names) + ","
    return Made([write(folder, "dataLog00001.TXT", header, [row + "," for row in rows])], {})


@sample("MicroStrain SensorConnect")
def microstrain(folder):
    names = [
        *("GPS TFlags", "GPS Week", "GPS TOW"),
        *(f"{a} Accel [x8004]" for a in "XYZ"),
        *(f"{a} Gyro [x8005]" for a in "XYZ"),
        *(f"{a} Delta Vel [x8008]" for a in "XYZ"),
    ]
    week = np.full((ROWS, 2), [7, 2200])
    rows = lines(week, 400_000 + TIME_S, FORCE / G, RATE, FORCE / G / 100)
    return Made([write(folder, "imu.csv", "DATA_START", ",".join(names), rows)], {})


@sample("Xsens MTw and Awinda, ASCII export")
def mtw(folder):
    above = ["// Start Time: Unknown", "// Update Rate: 100.0Hz", "// Firmware Version: 4.0.2"]
    names = [
        *("PacketCounter", "SampleTimeFine", "Year", "Month", "Day", "Second"),
        *(f"{what}_{a}" for what in ("Acc", "Gyr") for a in "XYZ"),
        *("Roll", "Pitch", "Yaw"),
    ]
    ticks = 4_000_000 + np.round(TIME_S * 1e4).astype(int)
    rows = lines(np.arange(ROWS), ticks, *[[""] * ROWS] * 4, FORCE, RATE, FORCE * 0, separator="\t")
    return Made([write(folder, "MT_01.txt", above, "\t".join(names), rows)], {})


@sample("ShimmerCapture, older exports")
def shimmer_capture(folder):
    names = [
        "Timestamp",
        *(f"Low Noise Accelerometer {a}" for a in "XYZ"),
        *(f"Gyroscope {a}" for a in "XYZ"),
    ]
    units = ["mSecs", *["m/(sec^2)*"] * 3, *["deg/sec*"] * 3]
    rows = lines(TIME_S * 1000, FORCE, RATE / DEG, separator="\t")
    above = ["\t".join(cells) for cells in (["Shimmer_1"] * 7, names, ["CAL"] * 7, units)]
    return Made([write(folder, "shimmer.csv", above, rows)], {})


@sample("phyphox, CSV in German, and apps in other languages")
def german(folder):
    names = [
        "Zeit (s)",
        *(f"Beschleunigung {a} (m/s^2)" for a in "xyz"),
        *(f"Gyroskop {a} (rad/s)" for a in "xyz"),
        *(f"Lineare Beschleunigung {a} (m/s^2)" for a in "xyz"),
    ]
    rows = lines(TIME_S, FORCE, RATE, FORCE * 0, separator="\t", decimal=",")
    return Made([write(folder, "Raw Data.csv", "\t".join(names), rows, encoding="utf-16", end="\r\n")], {})


@sample("ST DATALOG2, one CSV file per sensor")
def datalog2(folder):
    accel = write(folder, "lsm6dsv16x_acc.csv", "Time,A_x [g],A_y [g],A_z [g]", lines(TIME_S, FORCE / G))
    header = "Time,G_x [mdps],G_y [mdps],G_z [mdps]"
    return Made([accel, write(folder, "lsm6dsv16x_gyro.csv", header, lines(TIME_S, RATE / DEG * 1000))], {})


@sample("Parquet and data frames of other programs")
def other_parquet(folder):
    columns = {
        "time (ms)": TIME_S * 1000,
        **{f"accel {a} (mg)": FORCE[:, i] / G * 1000 for i, a in enumerate("xyz")},
        **{f"gyro {a} (deg/s)": RATE[:, i] / DEG for i, a in enumerate("xyz")},
        "battery": np.full(ROWS, 3.7),
    }
    pq.write_table(pa.table(columns), folder / "run.parquet")
    return Made([folder / "run.parquet"], {})


@sample("PX4, ulog2csv")
def ulog2csv(folder):
    us = 50_000_000 + np.round(TIME_S * 1e6).astype(int)
    names = [
        *("timestamp", "timestamp_sample", "device_id", "x", "y", "z", "temperature", "error_count"),
        *(f"clip_counter[{i}]" for i in range(3)),
        "samples",
    ]
    files = [
        write(
            folder,
            f"flight_sensor_{name}_0.csv",
            ",".join(names),
            lines(us, us, np.full(ROWS, 2_621_450), values, np.full(ROWS, 40.1), np.zeros((ROWS, 5), int)),
        )
        for name, values in (("accel", FORCE), ("gyro", RATE))
    ]
    return Made(files, {})


@sample("ROS 1, rosbag_to_csv")
def rosbag_to_csv(folder):
    names = [
        *("time", ".header.seq", ".header.stamp.secs", ".header.stamp.nsecs", ".header.frame_id"),
        *(f".angular_velocity.{a}" for a in "xyz"),
        *(f".linear_acceleration.{a}" for a in "xyz"),
    ]
    dates = [f"2026/01/01/12:00:{at:09.6f}" for at in TIME_S]
    rows = lines(dates, np.arange(ROWS), NS // 10**9, NS % 10**9, ["imu"] * ROWS, RATE, FORCE)
    return Made([write(folder, "imu.csv", ",".join(names), rows)], {})


@sample("WitMotion, CSV of the phone app")
def witmotion_app(folder):
    names = [
        *("time", "DeviceName"),
        *(f"Acc{a}(g)" for a in "XYZ"),
        *(f"As{a}(°/s)" for a in "XYZ"),
        *(f"Angle{a}(°)" for a in "XYZ"),
        *(f"H{a}(uT)" for a in "XYZ"),
        *("Q0()", "Q1()", "Q2()", "Q3()", "T(°C)", "Version()", "Battery level(%)"),
    ]
    rows = lines(
        *(colon_dates(), ["WT901BLE67"] * ROWS, FORCE / G, RATE / DEG, FORCE, FORCE),
        *(np.ones((ROWS, 4)), np.full(ROWS, 25.5), np.ones((ROWS, 2))),
    )
    return Made([write(folder, "data.csv", ",".join(names), rows)], {})


def test_every_export_of_the_page_has_a_sample_and_the_other_way_round():
    assert [export.name for export in EXPORTS] == list(SAMPLES)
    assert len(SAMPLES) >= 25


@pytest.mark.parametrize("name", SAMPLES)
def test_export_is_read(tmp_path, name):
    made = SAMPLES[name](tmp_path)
    recording = imucal.read(*made.paths, **made.options)
    assert (recording.accel_unit, recording.gyro_unit) == ("m/s^2", "rad/s")
    assert recording.rate_hz == pytest.approx(RATE_HZ, rel=1e-3)
    codes = {finding.code for finding in recording.findings}
    assert codes <= {"read_by_header", "lines_left_out", *(["resampled"] if made.resampled else [])}
    if made.resampled:
        between = (FORCE[:-1] + FORCE[1:]) / 2
        np.testing.assert_allclose(recording.specific_force, between, atol=1e-9)
        np.testing.assert_allclose(recording.angular_rate, RATE[:-1], atol=1e-9)
        return
    assert len(recording) == ROWS
    np.testing.assert_allclose(recording.time_s - recording.time_s[0], TIME_S, atol=2e-6)
    np.testing.assert_allclose(recording.specific_force, FORCE, atol=made.tolerance)
    np.testing.assert_allclose(recording.angular_rate, RATE, atol=made.tolerance)


@pytest.mark.parametrize("name", SAMPLES)
def test_export_is_read_by_the_command_of_the_page(tmp_path, name, monkeypatch):
    """The command has the options that the sample needs, and no other."""
    made = SAMPLES[name](tmp_path)
    command = next(export.command for export in EXPORTS if export.name == name)
    for option in made.options:
        assert f"--{option.replace('_', '-')}" in command
    assert command.count("--") == len(made.options)


def test_realsense_streams_have_two_rates_and_a_clock_in_ms_or_us(tmp_path):
    read = [
        imucal.read(write(tmp_path, "imu_pose.csv", realsense_lines(ticks, step=2, late_ms=0.0)))
        for ticks in (1, 1000)
    ]
    for recording in read:
        assert [finding.code for finding in recording.findings] == ["resampled"]
        assert recording.rate_hz == pytest.approx(RATE_HZ / 2)
        np.testing.assert_allclose(recording.specific_force, FORCE[2::2], atol=1e-12)
        averaged = (RATE[1:-2:2] + 2 * RATE[2:-1:2] + RATE[3::2]) / 4
        np.testing.assert_allclose(recording.angular_rate, averaged, atol=1e-9)
    np.testing.assert_array_equal(read[0].time_s, read[1].time_s)


def test_realsense_lines_that_are_cut_are_counted_and_other_clocks_refused(tmp_path):
    cut = realsense_lines()
    cut[-1] = cut[-1][:60]
    warning = imucal.read(write(tmp_path, "imu_pose.csv", cut)).findings[0]
    assert (warning.code, warning.count) == ("lines_left_out", 1)
    for lines_of, message in (
        (realsense_lines(60), "neither ms nor us"),
        ([line for line in realsense_lines() if not line.startswith("Gyro")], "no samples of the gyroscope"),
        ([line.replace("3DOF_y", "y") for line in realsense_lines()], "'3DOF_y'"),
        ([line[:60] if "Gyro,1" in line else line for line in realsense_lines()], "do not have 8 values"),
    ):
        with pytest.raises(imucal.FormatError, match=message):
            imucal.read(write(tmp_path, "imu_pose.csv", lines_of))


def test_a_betaflight_log_is_named_with_the_command_that_converts_it(tmp_path):
    path = tmp_path / "LOG00001.BFL"
    path.write_bytes(
        b"H Product:Blackbox flight data recorder by Nicholas Sherman\nH Data version:2\n\x00I\x01"
    )
    with pytest.raises(imucal.FormatError, match=r"blackbox_decode --unit-rotation deg/s .* LOG00001.BFL"):
        imucal.read(path)


def test_a_text_log_of_ardupilot_is_named_with_the_command_that_converts_it(tmp_path):
    above = ["FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns", "PARM, 333, INS_ACC_ID, 1.0, 0"]
    rows = [f"IMU, {50_000_000 + 10_000 * i}, 0, {row}" for i, row in enumerate(lines(RATE, FORCE))]
    with pytest.raises(imucal.FormatError, match=r"give the log itself \(.bin\), .*--types IMU 00000001.log"):
        imucal.read(write(tmp_path, "00000001.log", above, rows))


def test_columns_of_which_only_the_first_has_a_name_are_x_y_z(tmp_path):
    files = [
        write(
            tmp_path, f"GX01-{name}.csv", f'"cts","date","{name} [{unit}]","1","2","temperature [°C]"', rows
        )
        for name, unit, rows in (
            ("Accelerometer", "m/s2", lines(TIME_S * 1000, colon_dates(), FORCE, np.full(ROWS, 40.0))),
            ("Gyroscope", "rad/s", lines(TIME_S * 1000, colon_dates(), RATE, np.full(ROWS, 40.0))),
        )
    ]
    recording = imucal.read(*files)
    np.testing.assert_array_equal(recording.specific_force, FORCE)
    np.testing.assert_array_equal(recording.angular_rate, RATE)
    assert "from Accelerometer [m/s2], 1, 2" in recording.findings[0].message


def test_topic_sensor_combined_of_px4_is_read_by_its_names(tmp_path):
    names = [
        *("timestamp", *(f"gyro_rad[{i}]" for i in range(3)), "gyro_integral_dt"),
        *("accelerometer_timestamp_relative", *(f"accelerometer_m_s2[{i}]" for i in range(3))),
    ]
    us, none = 50_000_000 + np.round(TIME_S * 1e6).astype(int), np.zeros(ROWS, int)
    path = write(tmp_path, "a.csv", ",".join(names), lines(us, RATE, none, none, FORCE))
    recording = imucal.read(path)
    np.testing.assert_array_equal(recording.specific_force, FORCE)
    np.testing.assert_array_equal(recording.angular_rate, RATE)
    np.testing.assert_allclose(recording.time_s, TIME_S, atol=1e-9)


@pytest.mark.parametrize(
    "stamp",
    [
        ("header.stamp.secs", "header.stamp.nsecs"),
        ("header.stamp.sec", "header.stamp.nanosec"),
        ("/imu/header/stamp/sec", "/imu/header/stamp/nanosec"),
        ("header_stamp_sec", "header_stamp_nanosec"),
        ("sec", "nanosec"),
    ],
)
def test_seconds_and_nanoseconds_of_a_stamp_are_one_time(tmp_path, stamp):
    # The rows have the time of receipt as well, which is later and has jitter.
    names = ["Time", *stamp, *(f"{what}.{a}" for what in (OF_RATE, OF_FORCE) for a in "xyz")]
    jitter_s = np.random.default_rng(1).uniform(0.0, 5e-3, ROWS)
    rows = lines(NS / 1e9 + 0.02 + jitter_s, NS // 10**9, NS % 10**9, RATE, FORCE)
    recording = imucal.read(write(tmp_path, "a.csv", ",".join(names), rows))
    np.testing.assert_array_equal(recording.time_s, (NS - NS[0]) / 1e9)
    np.testing.assert_array_equal(recording.specific_force, FORCE)
    assert f"time_ns={stamp[0]} and {stamp[1]}" in recording.findings[0].message
    assert not recording.auxiliary


def test_stamps_that_the_driver_does_not_set_are_not_read(tmp_path):
    names = ["Time", *STAMP, *(f"{what}.{a}" for what in (OF_RATE, OF_FORCE) for a in "xyz")]
    none = np.zeros(ROWS, int)
    recording = imucal.read(
        write(tmp_path, "a.csv", ",".join(names), lines(NS / 1e9 + 0.001, none, none, RATE, FORCE))
    )
    assert recording.rate_hz == pytest.approx(RATE_HZ, rel=1e-3)
    assert "time_s=Time" in recording.findings[0].message


def test_a_stamp_that_is_not_a_whole_number_is_refused_with_its_line(tmp_path):
    names = [*STAMP, *(f"{what}.{a}" for what in (OF_RATE, OF_FORCE) for a in "xyz")]
    nanoseconds = (NS % 10**9).astype(float)
    nanoseconds[7] += 0.5
    path = write(tmp_path, "a.csv", ",".join(names), lines(NS // 10**9, nanoseconds, RATE, FORCE))
    with pytest.raises(imucal.FormatError, match="line 9: the seconds and nanoseconds"):
        imucal.read(path)


def imu_messages(nanoseconds, rows=ROWS):
    """The columns of `rows` messages of ROS, whose samples are those above, again and again."""
    columns = {STAMP[0]: nanoseconds // 10**9, STAMP[1]: nanoseconds % 10**9}
    for what, values in ((OF_RATE, RATE), (OF_FORCE, FORCE)):
        columns |= {f"{what}.{axis}": np.resize(values[:, i], rows) for i, axis in enumerate("xyz")}
    return columns


def test_stamp_in_two_columns_of_a_data_frame_and_of_a_parquet_file(tmp_path):
    frame = pa.table(imu_messages(NS))
    pq.write_table(frame, tmp_path / "a.parquet")
    for given in (frame, tmp_path / "a.parquet"):
        recording = imucal.read(given)
        np.testing.assert_array_equal(recording.time_s, (NS - NS[0]) / 1e9)
        np.testing.assert_array_equal(recording.specific_force, FORCE)
        np.testing.assert_array_equal(recording.angular_rate, RATE)
        assert f"time_ns={STAMP[0]} and {STAMP[1]}" in recording.findings[0].message
        assert not recording.auxiliary


def test_stamps_of_a_parquet_file_are_joined_in_every_part(tmp_path):
    # A Parquet file is read in parts of 65,536 rows.
    rows = 70_000
    stamps = START_NS + 2_500_000 * np.arange(rows)
    columns = imu_messages(stamps, rows)
    pq.write_table(pa.table(columns), tmp_path / "a.parquet")
    pieces = list(imucal.io.read_pieces(tmp_path / "a.parquet"))
    assert len(pieces) > 1
    times = [imucal.read(tmp_path / "a.parquet").time_s, np.concatenate([piece.time_s for piece in pieces])]
    for time_s in times:
        np.testing.assert_array_equal(time_s, (stamps - stamps[0]) / 1e9)
    columns[STAMP[1]] = columns[STAMP[1]].astype(float)
    columns[STAMP[1]][rows - 1] += 0.5
    pq.write_table(pa.table(columns), tmp_path / "a.parquet")
    with pytest.raises(imucal.FormatError, match=f"row {rows}: the seconds and nanoseconds"):
        imucal.read(tmp_path / "a.parquet")


def test_sensor_combined_of_px4_as_text_is_already_corrected(tmp_path):
    names = [
        "timestamp",
        *(f"gyro_rad[{i}]" for i in range(3)),
        *(f"accelerometer_m_s2[{i}]" for i in range(3)),
    ]
    us = 50_000_000 + np.round(TIME_S * 1e6).astype(int)
    path = write(tmp_path, "flight_sensor_combined_0.csv", ",".join(names), lines(us, RATE, FORCE))
    canonical = [*(f"gyro_{a}_radps" for a in "xyz"), *(f"accel_{a}_mps2" for a in "xyz")]
    given = ",".join(f"{ours}={theirs}" for ours, theirs in zip(["time_us", *canonical], names, strict=True))
    frame = pa.table(dict(zip(names, [us, *RATE.T, *FORCE.T], strict=True)))
    for recording in (imucal.read(path), imucal.read(path, columns=given), imucal.read(frame)):
        found = [finding for finding in recording.findings if finding.code == "already_corrected"]
        assert [finding.message for finding in found] == [
            "PX4 has applied its calibration parameters (CAL_*, TC_*) to sensor_combined"
        ]
    # sensor_accel and sensor_gyro are not corrected.
    files = SAMPLES["PX4, ulog2csv"](tmp_path).paths
    assert "already_corrected" not in {finding.code for finding in imucal.read(*files).findings}


def test_degrees_per_sec_are_a_unit(tmp_path):
    names = ["Time (sec)", *(f"Gyro {a} (°/sec)" for a in "XYZ"), *(f"Accel {a} (mg)" for a in "XYZ")]
    path = write(tmp_path, "adis.csv", ",".join(names), lines(TIME_S, RATE / DEG, FORCE / G * 1000))
    np.testing.assert_allclose(imucal.read(path).angular_rate, RATE, atol=1e-12)


def test_linear_acceleration_that_includes_gravity_is_offered_as_the_accelerometer(tmp_path):
    names = ["id", "timestamp", *(f"ang_vel_{a}" for a in "xyz"), *(f"lin_acc_{a}" for a in "xyz")]
    rows = [np.arange(ROWS), NS / 1e9, RATE]
    path = write(tmp_path, "imu.txt", "# " + " ".join(names), lines(*rows, FORCE, separator=" "))
    with pytest.raises(imucal.FormatError, match=r"--columns '([^']*)'") as caught:
        imucal.read(path)
    columns = re.search(r"--columns '([^']*)'", str(caught.value))[1]
    np.testing.assert_array_equal(imucal.read(path, columns=columns).specific_force, FORCE)
    still = FORCE - FORCE.mean(axis=0)
    path = write(tmp_path, "linear.txt", "# " + " ".join(names), lines(*rows, still, separator=" "))
    with pytest.raises(imucal.FormatError, match="without gravity"):
        imucal.read(path)


@pytest.mark.parametrize(
    ("above", "rate"),
    [("// Sample rate: 100.0Hz", "100"), ("#sps,125", "125"), ("// Update Rate: 60Hz", "60"), ("// x", "HZ")],
)
def test_the_advice_has_the_rate_that_stands_above_the_header(tmp_path, above, rate):
    names = ["Counter", *(f"{what}_{a}" for what in ("Acc", "Gyr") for a in "XYZ")]
    rows = lines(np.arange(ROWS), FORCE, RATE, separator="\t")
    with pytest.raises(imucal.FormatError, match=f"--rate-hz {rate} "):
        imucal.read(write(tmp_path, "MT.txt", above, "\t".join(names), rows))


@pytest.mark.parametrize("names", ["p q r", "roll_rate pitch_rate yaw_rate"])
def test_columns_of_rates_without_names_of_axes_are_offered(tmp_path, names):
    header = ["timestamps", *(f"acc_{a} (m/s2)" for a in "xyz"), *(f"{n} (deg/s)" for n in names.split())]
    path = write(tmp_path, "a.csv", ",".join(header), lines(1_767_268_800 + TIME_S, FORCE, RATE / DEG))
    with pytest.raises(imucal.FormatError, match=r"--columns '([^']*)'") as caught:
        imucal.read(path)
    recording = imucal.read(path, columns=re.search(r"--columns '([^']*)'", str(caught.value))[1])
    np.testing.assert_allclose(recording.angular_rate, RATE, atol=1e-12)
    assert recording.rate_hz == pytest.approx(RATE_HZ)


def test_columns_with_equal_names_are_named_in_their_order(tmp_path):
    path = write(tmp_path, "a.csv", "time,x,y,z,x,y,z", lines(TIME_S, FORCE, RATE))
    with pytest.raises(imucal.FormatError, match=r"x, y, z occur more than once .* --format columns"):
        imucal.read(path)
    columns = [
        "time_s",
        *(f"{what}_{a}_{unit}" for what, unit in (("accel", "mps2"), ("gyro", "radps")) for a in "xyz"),
    ]
    recording = imucal.read(path, columns=columns, format="columns")
    np.testing.assert_array_equal(recording.angular_rate, RATE)


def test_two_files_without_header_may_have_the_time_last(tmp_path):
    pair = [write(tmp_path, f"{n}.csv", lines(v, NS)) for n, v in (("accel", FORCE), ("gyro", RATE))]
    recording = imucal.read(*pair)
    np.testing.assert_array_equal(recording.specific_force, FORCE)
    assert [finding.code for finding in recording.findings] == ["counts_assumed"]
    in_units = imucal.read(*pair, accel_unit="m/s^2", gyro_unit="rad/s")
    np.testing.assert_array_equal(in_units.angular_rate, RATE)
    assert in_units.findings == ()
    np.testing.assert_allclose(in_units.time_s - in_units.time_s[0], TIME_S, atol=1e-6)


def test_packets_have_their_own_time_and_are_checked(tmp_path):
    content, path = packets(), tmp_path / "wt901.bin"
    path.write_bytes(content)
    recording = imucal.read(path)
    np.testing.assert_allclose(recording.time_s, TIME_S, atol=1e-9)
    np.testing.assert_array_equal(recording.temperature_degc, 25.5)
    spoilt = bytearray(content)
    spoilt[44 * 50 + 11 + 4] ^= 1
    path.write_bytes(bytes(spoilt[:-7]))
    again = imucal.read(path)
    assert len(again) == ROWS - 1
    np.testing.assert_allclose(np.delete(TIME_S, 50), again.time_s, atol=1e-9)
    path.write_bytes(packets(scale=4.0))
    with pytest.raises(imucal.FormatError, match="set the ranges to 16 g"):
        imucal.read(path)


@pytest.mark.parametrize("kind", ["gzip", "utf-16", "utf-16-le", "zip"])
def test_packed_and_encoded_texts(tmp_path, kind):
    path = phyphox_tab(tmp_path).paths[0]
    text = path.read_text()
    if kind == "gzip":
        path = tmp_path / "run.csv.gz"
        path.write_bytes(gzip.compress(text.encode()))
    elif kind == "zip":
        path = zipped(tmp_path, "run.zip")
    else:
        path.write_bytes(text.encode(kind))
    recording = imucal.read(path)
    np.testing.assert_allclose(recording.specific_force, FORCE, rtol=1e-12)
    assert len(recording.sources) == 1


def test_a_data_frame_is_read_by_names_with_units():
    dates = pa.array(NS.astype("datetime64[ns]"))
    frame = pa.table(
        {
            "timestamp": dates,
            **{f"acc_{a} [m/s^2]": FORCE[:, i] for i, a in enumerate("xyz")},
            **{f"gyr_{a} [rad/s]": RATE[:, i] for i, a in enumerate("xyz")},
        }
    )
    recording = imucal.read(frame)
    np.testing.assert_array_equal(recording.specific_force, FORCE)
    np.testing.assert_array_equal(recording.angular_rate, RATE)
    np.testing.assert_allclose(recording.time_s, TIME_S, atol=1e-9)
    bare = frame.rename_columns([name.partition(" ")[0] for name in frame.column_names])
    with pytest.raises(imucal.FormatError, match=r"--columns 'time_s=timestamp,accel_x_mps2=acc_x,.*gyr_z'"):
        imucal.read(bare)


def test_a_data_frame_given_as_times_is_named():
    frame = pa.table({"time_s": TIME_S, **{f"accel_{a}_mps2": FORCE[:, i] for i, a in enumerate("xyz")}})
    with pytest.raises(imucal.InputError, match=r"give one \(imucal.read converts a Table\)"):
        imucal.Recording(frame)


def test_a_time_column_alone_does_not_make_the_other_names_canonical(tmp_path):
    names = ["time_us", *(f"acc[{i}] (g)" for i in range(3)), *(f"gyro[{i}] (deg/s)" for i in range(3))]
    us = np.round(TIME_S * 1e6).astype(int)
    recording = imucal.read(write(tmp_path, "a.csv", ",".join(names), lines(us, FORCE / G, RATE / DEG)))
    np.testing.assert_allclose(recording.specific_force, FORCE, atol=1e-9)
    np.testing.assert_allclose(recording.time_s, TIME_S, atol=1e-9)


def test_what_cannot_be_read_is_named(tmp_path):
    units = "time(s),ax(ug),ay(ug),az(ug),gx(deg/h),gy(deg/h),gz(deg/h)"
    for name, content, message in (
        ("a.csv", [units, *lines(TIME_S, FORCE / G * 1e6, RATE / DEG * 3600)], r"not read \(ug, deg/h\)"),
        ("a.json", ['[{"sensor": "Accelerometer", "time": "1", "x": 0.1, "y": 0.1, "z": 9.8}]'], "is JSON"),
        (
            "long.csv",
            ["sensor,timestamp,x,y,z", *(f"{s},{i},1.5,2.5,3.5" for i in range(50) for s in ("ACC", "GYRO"))],
            r"one sensor, named in the column 'sensor' \(ACC, GYRO\)",
        ),
    ):
        with pytest.raises(imucal.FormatError, match=message):
            imucal.read(write(tmp_path, name, content))


def test_the_rate_is_asked_for_where_no_name_has_the_unit_of_the_time(tmp_path):
    """SampleTimeFine counts in 100 us."""
    names = ["SampleTimeFine", *(f"{what}_{a}" for what in ("Acc", "Gyr", "Acc2") for a in "XYZ")]
    ticks = np.round(TIME_S * 1e4).astype(int)
    path = write(
        tmp_path, "a.txt", "// x", "\t".join(names), lines(ticks, FORCE, RATE, FORCE, separator="\t")
    )
    with pytest.raises(imucal.FormatError, match="--rate-hz HZ") as caught:
        imucal.read(path)
    assert "=SampleTimeFine" not in str(caught.value)
