"""JSON documents with several tables, several devices, and lists that are no samples."""

import json

import numpy as np
import pytest

import imucal
from export_files import FORCE, NS, RATE, ROWS, TIME_S, write

SAMPLES = list(zip(TIME_S.tolist(), FORCE.tolist(), RATE.tolist(), strict=True))
WIDE = [{"time (s)": t, "acc (m/s^2)": f, "gyro (rad/s)": w} for t, f, w in SAMPLES]
NAMES = [f"accel_{a}_mps2" for a in "xyz"] + [f"gyro_{a}_radps" for a in "xyz"]
CANONICAL = {"time_s": TIME_S.tolist()} | dict(zip(NAMES, np.hstack([FORCE, RATE]).T.tolist(), strict=True))


def read(tmp_path, document, **options):
    lines = [json.dumps(own) for own in document] if isinstance(document, tuple) else json.dumps(document)
    return imucal.read(write(tmp_path, "run.json", lines), **options)


def check(recording):
    assert len(recording) == ROWS
    np.testing.assert_allclose(recording.specific_force, FORCE, atol=1e-12)
    np.testing.assert_allclose(recording.angular_rate, RATE, atol=1e-12)


def columns(time_s, values, unit):
    return {"time (s)": time_s.tolist()} | {
        f"{axis} ({unit})": own for axis, own in zip("xyz", values.T.tolist(), strict=True)
    }


@pytest.mark.parametrize("rows", [ROWS, ROWS - 20])
@pytest.mark.parametrize("late_s", [0.0, 0.4])
def test_columns_of_each_sensor_have_their_own_clock(tmp_path, rows, late_s):
    # The force is a linear function of time, so that interpolation gives it exactly.
    force = TIME_S[:, None] * [0.0, 0.1, 0.2] + [0.0, 0.0, 9.81]
    rate = (TIME_S + late_s)[:rows, None] * [0.01, 0.02, 0.03]
    document = {
        "accelerometer": columns(TIME_S, force, "m/s^2"),
        "gyroscope": columns(TIME_S[:rows] + late_s, rate, "rad/s"),
    }
    recording = read(tmp_path, document)
    assert recording.sensors == ("accelerometer", "gyroscope")
    np.testing.assert_allclose(
        recording.specific_force[:, 1] / 0.1, recording.angular_rate[:, 0] / 0.01, atol=1e-6
    )
    assert len(recording) == pytest.approx(min(ROWS - 100 * late_s, rows), abs=1)


def test_members_of_each_sensor_have_their_own_clock(tmp_path):
    rate = (TIME_S + 0.4)[:, None] * [0.01, 0.02, 0.03]
    force = TIME_S[:, None] * [0.0, 0.1, 0.2] + [0.0, 0.0, 9.81]
    document = [
        {
            "acc_mps2": {"t": t} | dict(zip("xyz", f, strict=True)),
            "gyro_radps": {"t": t + 0.4} | dict(zip("xyz", w, strict=True)),
        }
        for t, f, w in zip(TIME_S.tolist(), force.tolist(), rate.tolist(), strict=True)
    ]
    recording = read(tmp_path, document)
    np.testing.assert_allclose(
        recording.specific_force[:, 1] / 0.1, recording.angular_rate[:, 0] / 0.01, atol=1e-6
    )
    assert [own.code for own in recording.findings].count("lines_left_out") == 0


def test_columns_of_several_units_are_refused(tmp_path):
    short = {name: own[:-10] for name, own in CANONICAL.items()}
    for first, second in ((CANONICAL, CANONICAL), (short, CANONICAL)):
        with pytest.raises(imucal.InputError, match=r"2 tables hold a recording .*\(left\).*\(right\)"):
            read(tmp_path, {"left": first, "right": second})


def test_columns_of_one_table_have_one_length(tmp_path):
    with pytest.raises(
        imucal.FormatError, match=r"run.json: the lists .* different lengths \(time_s: 3\d\d, "
    ):
        read(tmp_path, CANONICAL | {"gyro_x_radps": CANONICAL["gyro_x_radps"][:-1]})
    check(read(tmp_path, CANONICAL | {"offsets": [1, 2, 3, 4], "label": ["a"] * ROWS}))
    check(read(tmp_path, {"device": {"offsets": [1, 2, 3, 4], "steps": [1, 2, 3, 4, 5]}, "data": CANONICAL}))


def test_rows_of_pandas_are_in_the_order_of_their_labels(tmp_path):
    units = {name: own for name, own in CANONICAL.items() if name != "time_s"}
    document = {name: {str(at): own[at] for at in range(ROWS)} for name, own in units.items()}
    shuffled = json.loads(json.dumps(document, sort_keys=True))
    assert list(shuffled["accel_x_mps2"])[:3] == ["0", "1", "10"]
    check(read(tmp_path, shuffled, rate_hz=100.0))
    del shuffled["gyro_z_radps"]["7"]
    with pytest.raises(imucal.FormatError, match=r"run.json: the column 'gyro_z_radps' has other row labels"):
        read(tmp_path, shuffled, rate_hz=100.0)


@pytest.mark.parametrize("orient", ["columns", "index"])
def test_row_labels_that_are_times(tmp_path, orient):
    ms = [str(ns // 10**6) for ns in NS.tolist()]
    if orient == "columns":
        document = {
            f"{name} {axis} ({unit})": dict(zip(ms, values[:, at].tolist(), strict=True))
            for name, unit, values in (("acc", "m/s^2", FORCE), ("gyro", "rad/s", RATE))
            for at, axis in enumerate("xyz")
        }
    else:
        document = {
            label: {name: own for name, own in row.items() if name != "time (s)"}
            for label, row in zip(ms, WIDE, strict=True)
        }
    recording = read(tmp_path, document)
    check(recording)
    np.testing.assert_allclose(np.diff(recording.time_s), np.diff(TIME_S), atol=2e-3)


def test_samples_under_keys(tmp_path):
    check(read(tmp_path, {"imu": {f"-N{at:04d}": row for at, row in enumerate(WIDE)}}))
    check(read(tmp_path, {str(at): row for at, row in reversed(list(enumerate(WIDE)))}))
    lines = tuple({f"2026-01-01T12:00:{at / 100:06.3f}Z": row} for at, row in enumerate(WIDE))
    with pytest.raises(imucal.FormatError, match=r"run.json: the objects have more than 500 different names"):
        read(tmp_path, lines)


def messages(device, offset_ns):
    payload = [
        {"name": name, "time": ns + offset_ns, "values": dict(zip("xyz", own, strict=True))}
        for ns, (_, f, w) in zip(NS.tolist(), SAMPLES, strict=True)
        for name, own in (("accelerometer", f), ("gyroscope", w))
    ]
    return [
        {"messageId": at, **device, "payload": payload[at : at + 50]} for at in range(0, len(payload), 50)
    ]


@pytest.mark.parametrize("offset_ns", [3_000_000, 10**11])
@pytest.mark.parametrize("member", ["deviceId", "sessionId", "device"])
def test_messages_of_several_devices_are_refused(tmp_path, offset_ns, member):
    a, b = (
        messages({member: {"id": of} if member == "device" else of}, offset)
        for of, offset in (("A", 0), ("B", offset_ns))
    )
    check(read(tmp_path, tuple(a), gyro_unit="rad/s"))
    mixed = [own for pair in zip(a, b, strict=True) for own in pair] if offset_ns < 10**9 else a + b
    with pytest.raises(imucal.FormatError, match=rf"of 2 devices or sessions \({member}.*: A, B\): write"):
        read(tmp_path, tuple(mixed), gyro_unit="rad/s")


@pytest.mark.parametrize("member", [{}, {"id": "A"}, {"name": "left"}, {"trial": 1}])
def test_lists_that_overlap_in_time_are_not_joined(tmp_path, member):
    other = [row | {"time (s)": row["time (s)"] + 0.003} for row in WIDE]
    document = [
        member | {"samples": WIDE},
        {name: f"{own}2" for name, own in member.items()} | {"samples": other},
    ]
    with pytest.raises(imucal.FormatError, match="the lists 'samples' of several objects overlap in time"):
        read(tmp_path, {"devices": document})
    check(
        read(tmp_path, {"parts": [member | {"samples": WIDE[at : at + 100]} for at in range(0, ROWS, 100)]})
    )


def test_blocks_of_several_devices_are_refused(tmp_path):
    rows = [
        row | {"device": device, "time (s)": row["time (s)"] + start_s}
        for device, start_s in (("left", 0.0), ("right", 60.0))
        for row in WIDE
    ]
    with pytest.raises(imucal.FormatError, match=r"of 2 devices or sessions \(device: left, right\)"):
        read(tmp_path, rows)
    check(read(tmp_path, [row | {"serial": at} for at, row in enumerate(WIDE)]))


def listed(values):
    return [
        {"t": ns} | dict(zip("xyz", own, strict=True))
        for ns, own in zip(NS.tolist(), values.tolist(), strict=True)
    ]


def test_lists_of_sensors_with_the_name_beside_the_list(tmp_path):
    document = [
        {"name": "acc", "unit": "m/s^2", "data": listed(FORCE)},
        {"name": "gyro", "unit": "rad/s", "data": listed(RATE)},
    ]
    check(read(tmp_path, document))
    check(read(tmp_path, {"sensors": document}))


@pytest.mark.parametrize("order", ["blocks", "alternating"])
def test_codes_of_sensors_are_refused(tmp_path, order):
    rows = [
        {"type": code, "timestamp": ns, "values": own}
        for code, values in ((1, FORCE), (4, RATE))
        for ns, own in zip(NS.tolist(), values.tolist(), strict=True)
    ]
    if order == "alternating":
        rows = [row for pair in zip(rows[:ROWS], rows[ROWS:], strict=True) for row in pair]
    path = write(tmp_path, "accelerometer_gyroscope.json", json.dumps(rows))
    with pytest.raises(imucal.FormatError, match=r"'type' names 2 kinds of samples \(1, 4\)"):
        imucal.read(path, gyro_unit="rad/s")


def test_lists_that_are_no_samples(tmp_path):
    tagged = [row | {"tags": [{"id": 1}] if at == 50 else []} for at, row in enumerate(WIDE)]
    check(read(tmp_path, tagged))
    check(read(tmp_path, [row | {"tags": [{"id": 1, "v": 2, "w": 3}]} for row in WIDE]))
    check(read(tmp_path, {"events": [{"name": "start", "t": 0.0}], "samples": WIDE}))
    named = [
        {"sensor": name, "t": ns, **dict(zip("xyz", own, strict=True))}
        for ns, (_, f, w) in zip(NS.tolist(), SAMPLES, strict=True)
        for name, own in (("accelerometer", f), ("gyroscope", w))
    ]
    described = [{"name": "accelerometer", "rate": 100}, {"name": "gyroscope", "rate": 100}]
    check(read(tmp_path, {"sensors": described, "samples": named}, gyro_unit="rad/s"))


def test_an_empty_entry_of_a_list_is_counted(tmp_path):
    recording = read(tmp_path, [WIDE[0], None, *WIDE[1:]])
    check(recording)
    assert "lines_left_out" in [own.code for own in recording.findings]


def test_objects_without_the_name_of_a_sensor_are_counted(tmp_path):
    rows = [
        {"sensor": name, "t": ns, **dict(zip("xyz", own, strict=True))}
        for ns, (_, f, w) in zip(NS.tolist(), SAMPLES, strict=True)
        for name, own in (("accelerometer", f), ("gyroscope", w))
    ]
    recording = read(tmp_path, [*rows, {"battery": 97}], gyro_unit="rad/s")
    check(recording)
    assert (
        "1 objects without the name of a sensor"
        in [f for f in recording.findings if f.count == 1][-1].message
    )


def test_one_sensor_and_a_table_that_is_not_known(tmp_path):
    angles = [{"t": ns, "roll": 0.1, "pitch": 0.2, "yaw": 0.3} for ns in NS.tolist()]
    document = {"accelerometer": listed(FORCE), "rotation": angles}
    messages = [own.message for own in read(tmp_path, document).findings]
    assert any(
        "only the accelerometer was found in the tables accelerometer, rotation" in own for own in messages
    )
    recording = read(tmp_path, document | {"rotation": []})
    assert recording.sensors == ("accelerometer",) and len(recording) == ROWS


def test_lists_in_deep_messages(tmp_path):
    samples = [dict(zip("xyz", own, strict=True)) for own in FORCE.tolist()]
    messages = [{"acc": {"Timestamp": at, "Array": samples[at : at + 4]}} for at in range(0, ROWS, 4)]
    document = {"data": messages}
    recording = read(tmp_path, document, rate_hz=100.0)
    np.testing.assert_allclose(recording.specific_force, FORCE, atol=1e-12)


@pytest.mark.parametrize("size", [3, 10])
@pytest.mark.parametrize("form", ["vectors", "axes"])
def test_batches_of_samples_in_an_object_are_refused(tmp_path, size, form):
    lines = []
    for at in range(0, ROWS, size):
        part = slice(at, at + size)
        own = {"accel_mps2": FORCE[part].tolist(), "gyro_radps": RATE[part].tolist()}
        if form == "axes":
            own = {name: values[part] for name, values in CANONICAL.items() if name != "time_s"}
        lines.append({"time_s": at / 100} | own)
    with pytest.raises(imucal.FormatError, match=r"run.json: the member 'accel\w+' .* write one object per"):
        read(tmp_path, tuple(lines))


def test_columns_of_a_sensor_in_a_list_are_refused(tmp_path):
    document = [
        {"sensor": name, "t": NS.tolist()} | dict(zip("xyz", values.T.tolist(), strict=True))
        for name, values in (("acc", FORCE), ("gyro", RATE))
    ]
    with pytest.raises(imucal.FormatError, match="'t' of an object is a list with several samples"):
        read(tmp_path, document)


def test_tables_with_a_header_row(tmp_path):
    table = np.column_stack(list(CANONICAL.values())).tolist()
    check(read(tmp_path, [list(CANONICAL), *table]))
    check(
        read(
            tmp_path,
            {"results": [{"series": [{"name": "imu", "columns": list(CANONICAL), "values": table}]}]},
        )
    )
    with pytest.raises(imucal.FormatError, match="without samples in a known form"):
        read(tmp_path, table)


def test_a_list_per_axis_is_refused(tmp_path):
    document = {
        f"{name}{axis}": [{"ts": at, "value": own} for at, own in enumerate(column)]
        for name, values in (("accel", FORCE), ("gyro", RATE))
        for axis, column in zip("XYZ", values.T.tolist(), strict=True)
    }
    with pytest.raises(imucal.FormatError, match=r"no list of objects has the three axes .*\(accelX, accelY"):
        read(tmp_path, document)
