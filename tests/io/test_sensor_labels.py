"""Labels and names of sensors: rotations, gravity, poses, watches, and columns that name only the axis."""

import csv
import json

import numpy as np
import pytest

import imucal
from export_files import FORCE, NS, RATE, ROWS, TIME_S, G

LINEAR = FORCE - FORCE.mean(axis=0)
# Components of a rotation vector or quaternion.
TURNED = np.sin(np.column_stack([TIME_S, 2 * TIME_S, 3 * TIME_S])) / 2


def listed(values, axes="xyz", **more):
    """One object per sample."""
    return [
        more | {"timestamp": ns} | dict(zip(axes, row, strict=True))
        for ns, row in zip(NS.tolist(), np.asarray(values).tolist(), strict=True)
    ]


def mixed(sensors, key="sensor"):
    """The objects of several sensors in the order of time, each with the label of its sensor."""
    rows = [row for label, values in sensors.items() for row in listed(values, **{key: label})]
    return sorted(rows, key=lambda row: row["timestamp"])


def members(**sensors):
    """One object per sample, with one member per sensor."""
    return [
        {"t": t}
        | {name: dict(zip("xyzw", values[at].tolist(), strict=False)) for name, values in sensors.items()}
        for at, t in enumerate(TIME_S.tolist())
    ]


def document(folder, value, name="run.json"):
    path = folder / name
    path.write_text(json.dumps(value))
    return path


def table(folder, rows, name="run.csv"):
    path = folder / name
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return path


def check(recording):
    assert len(recording) == ROWS
    np.testing.assert_allclose(recording.specific_force, FORCE, atol=1e-9)
    np.testing.assert_allclose(recording.angular_rate, RATE, atol=1e-9)


def message(path, **options):
    with pytest.raises(imucal.ImucalError) as caught:
        imucal.read(path, **options)
    return str(caught.value)


def followed(path):
    """The recording that follows from the proposal in the error."""
    said = message(path)
    return imucal.read(path, columns=said.partition("--columns '")[2].partition("'")[0])


# Rotations


@pytest.mark.parametrize(
    "other",
    [
        "rotation_vector",
        "android.sensor.game_rotation_vector",
        "GeoMag Rotation Vector Non-wakeup",
        "rotation",
        "heart_rate",
        "angular_acceleration",
        "gravity",
        "gravityAcceleration",
        "LINEAR_ACCELERATION",
        "accuracy",
    ],
)
@pytest.mark.parametrize("form", ["json", "csv"])
def test_other_sensors_are_neither_gyroscope_nor_accelerometer(tmp_path, form, other):
    write = document if form == "json" else table
    near = FORCE + 0.05 if "ravity" in other else TURNED
    rows = mixed({other: near, "android.sensor.accelerometer": FORCE, "android.sensor.gyroscope": RATE})
    check(imucal.read(write(tmp_path, rows, f"both.{form}"), gyro_unit="rad/s"))
    if "ravity" not in other and "LINEAR" not in other:
        alone = write(tmp_path, mixed({other: near, "accelerometer": FORCE}), f"accel.{form}")
        assert imucal.read(alone).angular_rate is None
    if "ravity" in other:
        without = write(tmp_path, mixed({other: near, "gyroscope": RATE}), f"gyro.{form}")
        assert "no file with the accelerometer" in message(without, gyro_unit="rad/s")


def test_a_rotation_is_proposed_as_gyroscope_only_if_it_is_a_rate(tmp_path):
    turned = np.column_stack([TURNED, np.ones(ROWS)])
    for quaternion in ("rotation", "gyro"):
        path = document(tmp_path, members(acceleration=FORCE, **{quaternion: turned}))
        assert f"={quaternion}.x" not in message(path)
    both = members(acceleration=FORCE, rotation=TURNED, rotationRate=RATE)
    check(followed(document(tmp_path, both)))
    named = [{f"rotation.{a} (rad/s)": w for a, w in zip("xyz", row, strict=True)} for row in RATE.tolist()]
    rows = [row | own for row, own in zip(members(acceleration=FORCE), named, strict=True)]
    check(followed(document(tmp_path, rows)))


# Gravity


def test_acceleration_that_includes_gravity_is_the_accelerometer(tmp_path):
    sensors = {"acceleration": LINEAR, "accelerationIncludingGravity": FORCE, "rotationRate": RATE}
    wide = document(tmp_path, members(**sensors))
    check(followed(wide))
    assert "Safari on iOS" in message(wide) and "--axes accel=-x,-y,-z" in message(wide)
    remark = [
        {"time (s)": t}
        | {f"Acc {a} (with gravity)": f for a, f in zip("xyz", force, strict=True)}
        | {f"Gyr {a}": w for a, w in zip("xyz", rate, strict=True)}
        for t, force, rate in zip(TIME_S.tolist(), FORCE.tolist(), RATE.tolist(), strict=True)
    ]
    check(followed(table(tmp_path, remark, "remark.csv")))
    lists = document(tmp_path, {name: listed(values) for name, values in sensors.items()})
    check(imucal.read(lists, gyro_unit="rad/s"))
    check(imucal.read(table(tmp_path, mixed(sensors)), gyro_unit="rad/s"))


# Labels that name no sensor


@pytest.mark.parametrize("labels", ["ABCDEFG", ["rest", "rotation", "acc", "gyro"], "AG"])
def test_labels_in_a_table_with_both_sensors_are_no_sensors(tmp_path, labels):
    names = ["time_s", *(f"accel_{a}_mps2" for a in "xyz"), *(f"gyro_{a}_radps" for a in "xyz")]
    samples = np.column_stack([TIME_S, FORCE, RATE]).tolist()
    rows = [
        dict(zip(names, row, strict=True)) | {"label": labels[at * len(labels) // ROWS]}
        for at, row in enumerate(samples)
    ]
    check(imucal.read(table(tmp_path, rows)))
    check(imucal.read(document(tmp_path, rows)))


def test_sensors_may_have_columns_of_their_own(tmp_path):
    rows = [
        {"sensor": sensor, "timestamp": ns + late}
        | {f"{letter}{a}": v for a, v in zip("xyz", row, strict=True)}
        for ns, *own in zip(NS.tolist(), FORCE.tolist(), RATE.tolist(), strict=True)
        for sensor, letter, late, row in zip(("acc", "gyro"), "ag", (0, 4 * 10**6), own, strict=True)
    ]
    recording = imucal.read(document(tmp_path, rows), gyro_unit="rad/s")
    assert len(recording) >= ROWS - 2 and recording.sensors == ("accelerometer", "gyroscope")
    np.testing.assert_allclose(recording.specific_force[:, 2].mean(), FORCE[:, 2].mean(), atol=0.01)


def test_letters_name_sensors_only_if_no_other_letter_does_not(tmp_path):
    check(imucal.read(table(tmp_path, mixed({"A": FORCE, "G": RATE, "M": TURNED})), gyro_unit="rad/s"))
    rows = [row | {"pose": "ABCDEFG"[at * 7 // ROWS]} for at, row in enumerate(listed(FORCE))]
    recording = imucal.read(table(tmp_path, rows, "accelerometer.csv"))
    assert len(recording) == ROWS and recording.sensors == ("accelerometer",)


# A table with both sensors beside tables with one sensor each


def test_a_table_without_gravity_does_not_replace_the_sensors(tmp_path):
    watch = [
        {"seconds_elapsed": t, "time": ns}
        | {f"rotationRate{a}": w for a, w in zip("XYZ", rate, strict=True)}
        | {f"acceleration{a}": f for a, f in zip("XYZ", force, strict=True)}
        for t, ns, rate, force in zip(
            TIME_S.tolist(), NS.tolist(), (2 * RATE).tolist(), LINEAR.tolist(), strict=True
        )
    ]
    phone = {"TotalAcceleration": FORCE, "Gyroscope": RATE, "Accelerometer": LINEAR}
    lists = {name: listed(values) for name, values in phone.items()} | {"WristMotion": watch}
    recording = imucal.read(document(tmp_path, lists), gyro_unit="rad/s")
    check(recording)
    (left,) = [finding for finding in recording.findings if finding.code == "tables_not_read"]
    assert "(WristMotion)" in left.message and "(Gyroscope)" in left.message


def test_sensors_beside_a_table_with_both_are_reported(tmp_path):
    names = [*(f"accel_{a}_mps2" for a in "xyz"), *(f"gyro_{a}_radps" for a in "xyz")]
    samples = np.column_stack([FORCE, RATE])
    imu = [
        {"time_s": t} | dict(zip(names, row, strict=True))
        for t, row in zip(TIME_S.tolist(), samples.tolist(), strict=True)
    ]
    lists = {"imu": imu, "accelerometer": listed(FORCE + 1), "gyroscope": listed(RATE + 1)}
    recording = imucal.read(document(tmp_path, lists))
    check(recording)
    (left,) = [finding for finding in recording.findings if finding.code == "tables_not_read"]
    assert "(accelerometer)" in left.message and "(gyroscope)" in left.message


# Columns that name only the axis


@pytest.mark.parametrize(
    ("axes", "labels"),
    [
        (("payload.x", "payload.y", "payload.z"), ("home/imu/accel", "home/imu/gyro")),
        (("value0", "value1", "value2"), ("ACCELEROMETER", "GYROSCOPE")),
        (("v_x", "v_y", "v_z"), ("ICM4x6xx Accelerometer Non-wakeup", "ICM4x6xx Gyroscope Non-wakeup")),
        (("vector.x", "vector.y", "vector.z"), ("linear_motion/acceleration", "angular_velocity")),
        (("data[1]", "data[2]", "data[3]"), ("debug/accel", "debug/gyro")),
    ],
)
def test_the_only_three_columns_with_axes_belong_to_the_label(tmp_path, axes, labels):
    rows = [
        {"topic": label, "timestamp": ns, "accuracy": 3} | dict(zip(axes, row, strict=True))
        for ns, *own in zip(NS.tolist(), FORCE.tolist(), RATE.tolist(), strict=True)
        for label, row in zip(labels, own, strict=True)
    ]
    check(imucal.read(table(tmp_path, rows), gyro_unit="rad/s"))
    check(imucal.read(document(tmp_path, rows), gyro_unit="rad/s"))
    # With six columns it is not known which three are the samples.
    uncalibrated = [row | {f"bias {name}": 0.0 for name in axes} for row in rows]
    said = message(table(tmp_path, uncalibrated, "six.csv"), gyro_unit="rad/s")
    assert f"({labels[0]}): the columns timestamp, accuracy, " in said and "write one row per sample" in said


def test_a_labelled_sensor_without_axes_is_not_called_missing(tmp_path):
    angles = listed(RATE, axes=("alpha", "beta", "gamma"))
    path = document(tmp_path, {"accelerometer": listed(FORCE), "rotationRate": angles})
    assert "(rotationRate): the columns timestamp, alpha, beta, gamma do not state" in message(path)


def test_one_row_per_axis_is_refused(tmp_path):
    names = [
        (f"{sensor}_{axis}", values[:, at])
        for sensor, values in (("accel", FORCE), ("gyro", RATE))
        for at, axis in enumerate("xyz")
    ]
    rows = [
        {"time_s": t, "field": name, "value": own[at]}
        for at, t in enumerate(TIME_S.tolist())
        for name, own in names
    ]
    assert "write one row per sample, with the axes in the columns" in message(table(tmp_path, rows))


def test_a_label_that_names_both_sensors_names_neither(tmp_path):
    rows = [*listed(FORCE), *listed(RATE)]
    path = document(tmp_path, {"accelerometer_and_gyroscope": rows, "magnetometer": listed(TURNED)})
    for options in ({}, {"gyro_unit": "rad/s"}):
        assert "no file with the accelerometer" in message(path, **options)


def test_rows_below_the_header_of_another_sensor_are_refused(tmp_path):
    header = [["UncalAccel", "timeMillis", *(f"UncalAccel{a}Mps2" for a in "XYZ")]]
    header += [["UncalGyro", "timeMillis", *(f"UncalGyro{a}RadPerSec" for a in "XYZ")]]
    rows = [
        [own[0], ns // 10**6, *values]
        for ns, *both in zip(NS.tolist(), FORCE.tolist(), RATE.tolist(), strict=True)
        for own, values in zip(header, both, strict=True)
    ]
    path = tmp_path / "log.txt"
    path.write_text("".join(f"# {','.join(own)}\n" for own in header))
    with path.open("a", newline="") as file:
        csv.writer(file).writerows(rows)
    said = message(path)
    assert "(UncalAccel)" in said and "write the rows of each sensor, with their own header" in said
    for own in header:
        with (tmp_path / f"{own[0]}.csv").open("w", newline="") as file:
            csv.writer(file).writerows([own, *(row for row in rows if row[0] == own[0])])
    recording = imucal.read(tmp_path / "UncalAccel.csv", tmp_path / "UncalGyro.csv")
    np.testing.assert_allclose(recording.specific_force, FORCE, atol=1e-9)
    np.testing.assert_allclose(recording.angular_rate, RATE, atol=1e-9)


# SensorLog


@pytest.mark.parametrize("outer", ["", "payload."])
def test_sensorlog_in_json_has_the_sign_of_ios(tmp_path, outer):
    rows = []
    for at, (force, rate) in enumerate(zip((-FORCE / G).tolist(), RATE.tolist(), strict=True)):
        row = {"loggingTime": f"2026-01-01T12:00:{at * 0.001 + 1:06.3f}Z"}
        row |= {"accelerometerTimestamp_sinceReboot": 5000 + TIME_S[at]}
        row |= {f"accelerometerAcceleration{a}": f"{f:.12f}" for a, f in zip("XYZ", force, strict=True)}
        row |= {f"motionRotationRate{a}": 0.5 for a in "XYZ"}
        row |= {f"gyroRotation{a}": f"{w:.12f}" for a, w in zip("XYZ", rate, strict=True)}
        rows.append({"payload": row} if outer else row)
    path = document(tmp_path, rows)
    said = message(path)
    assert "sign of iOS" in said and "--axes accel=-x,-y,-z" in said
    columns = said.partition("--columns '")[2].partition("'")[0]
    assert (
        columns.startswith(f"time_s={outer}accelerometerTimestamp_sinceReboot,") and "motion" not in columns
    )
    recording = imucal.read(path, columns=columns, axes="accel=-x,-y,-z")
    check(recording)
    np.testing.assert_allclose(recording.time_s - recording.time_s[0], TIME_S, atol=1e-6)
