"""Forms of JSON in which samples of several sensors, devices or units are easily mixed or lost."""

import json

import numpy as np
import pytest

import imucal
from export_files import DEG, FORCE, NS, RATE, ROWS, TIME_S, write

UNITS = {"accel_unit": "m/s^2", "gyro_unit": "rad/s"}
NAMES = ["time_s", *(f"accel_{a}_mps2" for a in "xyz"), *(f"gyro_{a}_radps" for a in "xyz")]
TABLE = np.column_stack([TIME_S, FORCE, RATE])
OBJECTS = [dict(zip(NAMES, row, strict=True)) for row in TABLE.tolist()]


def triples(values):
    return [dict(zip("xyz", row, strict=True)) for row in values.tolist()]


def columns_of(values, time_s=TIME_S, **more):
    return {"time_s": time_s.tolist(), **dict(zip("xyz", values.T.tolist(), strict=True)), **more}


def read(folder, document, **options):
    """The recording in a document, or in lines if `document` is a list of lines."""
    text = document if isinstance(document, (list, str)) else json.dumps(document)
    return imucal.read(write(folder, "run.json", text), **options)


def check(recording):
    np.testing.assert_allclose(recording.specific_force, FORCE, atol=1e-9)
    np.testing.assert_allclose(recording.angular_rate, RATE, atol=1e-9)
    np.testing.assert_allclose(recording.time_s - recording.time_s[0], TIME_S, atol=1e-6)


def test_lines_in_another_order_and_with_further_members_are_complete(tmp_path):
    others = [
        row | ({"temp_degc": 25.0} if at % 10 == 0 else {}) | ({"note": None} if at % 7 == 0 else {})
        for at, row in enumerate(OBJECTS)
    ]
    lines = [json.dumps(dict(reversed(row.items())) if at % 3 else row) for at, row in enumerate(others)]
    recording = read(tmp_path, lines)
    check(recording)
    assert not recording.findings


def test_lines_of_one_sensor_each_are_read(tmp_path):
    sensors = (NAMES[1:4], NAMES[4:])
    rows = [{name: row[name] for name in ("time_s", *own)} for row in OBJECTS for own in sensors]
    check(read(tmp_path, [json.dumps(row) for row in rows]))


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
@pytest.mark.parametrize("in_lines", [True, False])
def test_a_byte_order_mark_is_no_part_of_the_json(tmp_path, encoding, in_lines):
    text = [json.dumps(row) for row in OBJECTS] if in_lines else json.dumps(OBJECTS)
    check(imucal.read(write(tmp_path, "run.json", text, encoding=encoding)))


def test_columns_of_sensors_with_times_of_their_own_are_separate_tables(tmp_path):
    late_s = TIME_S + 0.404
    rate = np.stack([np.interp(late_s, TIME_S, axis) for axis in RATE.T], axis=1)
    document = {"accelerometer": columns_of(FORCE), "gyroscope": columns_of(rate, late_s)}
    recording = read(tmp_path, document, **UNITS)
    assert any(finding.code == "resampled" for finding in recording.findings)
    # The first common sample is at 0.404 to 0.41 s.
    at_s = recording.time_s - recording.time_s[0] + 0.407
    wanted = np.stack([np.interp(at_s, TIME_S, axis) for axis in RATE.T], axis=1)
    np.testing.assert_allclose(recording.angular_rate, wanted, atol=8e-3)
    shorter = {"accelerometer": columns_of(FORCE), "gyroscope": columns_of(rate[:-9], late_s[:-9])}
    assert read(tmp_path, shorter, **UNITS).angular_rate is not None
    check(read(tmp_path, {"accelerometer": columns_of(FORCE), "gyroscope": columns_of(RATE)}, **UNITS))


def test_columns_of_two_units_are_refused(tmp_path):
    unit = {"time_s": TIME_S.tolist(), "accel_mps2": FORCE.tolist(), "gyro_radps": RATE.tolist()}
    check(read(tmp_path, {"run": unit}))
    with pytest.raises(imucal.InputError, match=r"2 tables hold a recording .*\(left\).*\(right\)"):
        read(tmp_path, {"left": unit, "right": unit})


def test_columns_of_different_lengths_in_one_object_are_refused(tmp_path):
    document = {"log": columns_of(FORCE, gx=RATE[:-1, 0].tolist())}
    with pytest.raises(imucal.FormatError, match=r"columns of log have different lengths \(.*x 300.*gx 299"):
        read(tmp_path, document)


@pytest.mark.parametrize("member", ["deviceId", "sessionId"])
@pytest.mark.parametrize("step", [1, 3])
def test_messages_of_two_devices_are_refused(tmp_path, member, step):
    def message(at, origin):
        part = slice(at, at + 50)
        payload = [
            {"name": name, "time": ns, "values": values}
            for name, own in (("accelerometer", FORCE), ("gyroscope", RATE))
            for ns, values in zip(NS[part].tolist(), triples(own[part]), strict=True)
        ]
        return json.dumps({"messageId": at, member: origin, "payload": payload})

    messages = [message(at, "a") for at in range(0, ROWS, 50)]
    check(read(tmp_path, messages, **UNITS))
    others = [message(at, "b") for at in range(0, ROWS, 50)]
    mixed = [*messages[:step], *others, *messages[step:]]
    with pytest.raises(imucal.FormatError, match=rf"2 devices or recordings \({member}: a, b\)"):
        read(tmp_path, mixed, **UNITS)


def test_units_of_outer_members_and_of_members_are_those_of_the_axes(tmp_path):
    outer = [
        {"time_s": t, "accel_mps2": f, "gyro_dps": w}
        for t, f, w in zip(TIME_S.tolist(), FORCE.tolist(), triples(RATE / DEG), strict=True)
    ]
    stated = [
        {"time_s": t, "acc": f | {"unit": "m/s^2"}, "gyro": w | {"unit": "deg/s"}}
        for t, f, w in zip(TIME_S.tolist(), triples(FORCE), triples(RATE / DEG), strict=True)
    ]
    lists = {
        "acc": columns_of(FORCE, unit="m/s^2"),
        "gyro": columns_of(RATE / DEG, unit="deg/s"),
    }
    for document in (outer, stated):
        check(read(tmp_path, [json.dumps(row) for row in document]))
    check(read(tmp_path, lists))
    with pytest.raises(imucal.InputError, match="contradicts the given unit: it says dps"):
        read(tmp_path, lists, gyro_unit="rad/s")


def test_a_cut_document_is_read_only_if_it_has_one_list(tmp_path):
    lines = [json.dumps(row) + "," for row in OBJECTS]
    check(read(tmp_path, ['{"samples": [', *lines, lines[0][:30]]))
    with pytest.raises(imucal.FormatError, match="no valid JSON"):
        read(tmp_path, ['{"left": [', *lines, '], "right": [', *lines, lines[0][:30]])


def test_rows_that_pandas_labels_are_sorted_by_number(tmp_path):
    labels = sorted(map(str, range(ROWS)))
    document = {name: {at: own[int(at)] for at in labels} for name, own in zip(NAMES, TABLE.T, strict=True)}
    check(read(tmp_path, document))
    late = {
        name: {str(ns): value for ns, value in zip(NS, own, strict=True)} for name, own in document.items()
    }
    with pytest.raises(imucal.FormatError, match="labels of the rows of time_s are no numbers from 0 to 299"):
        read(
            tmp_path, {name: dict(zip(map(str, NS), own.values(), strict=True)) for name, own in late.items()}
        )


def test_time_stamps_as_names_are_refused(tmp_path):
    lines = [json.dumps({str(ns): {"ax": f[0]}}) for ns, f in zip(NS.tolist(), FORCE.tolist(), strict=True)]
    lines = [line.replace("ax", f"a{axis}") for line in lines for axis in "xyz"]
    many = [line.replace('"17', f'"{at}17') for at in range(2) for line in lines]
    with pytest.raises(imucal.FormatError, match=r"more than 500 different names.*time stamp as a member"):
        read(tmp_path, many)


def test_lists_that_hold_no_samples_are_left_out(tmp_path):
    tagged = [OBJECTS[0] | {"tags": [{"name": "start"}]}, None, *OBJECTS[1:]]
    check(read(tmp_path, json.dumps(tagged)))
    around = {"a": {"b": {"c": {"d": {"samples": OBJECTS}}}}, "sensors": [{"name": "acc"}, {"name": "gyro"}]}
    check(read(tmp_path, around))


@pytest.mark.parametrize(
    "sample",
    [
        {"time_s": 0.0, "acc": FORCE[:3].tolist(), "gyro": RATE[:3].tolist()},
        {"time_s": 0.0, "acc": FORCE[:9].tolist(), "gyro": RATE[:9].tolist()},
        {"time_s": 0.0, "acc_x": FORCE[:9, 0].tolist(), "acc_y": FORCE[:9, 1].tolist()},
    ],
)
def test_several_samples_in_one_object_are_refused(tmp_path, sample):
    with pytest.raises(imucal.FormatError, match=r"acc\w* of an object contains several samples: write one"):
        read(tmp_path, [json.dumps(sample)] * 20)
