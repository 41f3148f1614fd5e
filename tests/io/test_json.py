"""Recordings in JSON, in the forms that loggers and libraries write."""

import json

import numpy as np
import pytest

import imucal
from export_files import DEG, FORCE, NS, RATE, ROWS, TIME_S, G, write

NAMES = ["time_s", *(f"accel_{a}_mps2" for a in "xyz"), *(f"gyro_{a}_radps" for a in "xyz")]
TABLE = np.column_stack([TIME_S, FORCE, RATE])
SAMPLES = list(zip(TIME_S.tolist(), FORCE.tolist(), RATE.tolist(), strict=True))
UNITS = ("time (s)", "acc (m/s^2)", "gyro (rad/s)")
NESTED = [
    dict(zip(UNITS, (t, *(dict(zip("xyz", own, strict=True)) for own in (f, w))), strict=True))
    for t, f, w in SAMPLES
]
LISTS = [
    dict(zip(UNITS, sample, strict=True)) | {"quaternion": [1, 0, 0, 0], "moving": True, "note": None}
    for sample in SAMPLES
]
COLUMNS = dict(zip(NAMES, TABLE.T.tolist(), strict=True))


def rows_of(values, **more):
    return [
        more | {"timestamp": ns, "x": x, "y": y, "z": z}
        for ns, (x, y, z) in zip(NS.tolist(), values.tolist(), strict=True)
    ]


FORMS = {
    "objects": [dict(zip(NAMES, row, strict=True)) for row in TABLE.tolist()],
    "objects in objects": NESTED,
    "lists of three in objects": LISTS,
    "in an envelope": {"device": {"id": 7}, "data": NESTED},
    "in messages": [{"id": at, "payload": NESTED[at : at + 50]} for at in range(0, ROWS, 50)],
    "columns": COLUMNS,
    "columns of triples": {
        "time (s)": TIME_S.tolist(), "acc (g)": (FORCE / G).tolist(), "gyro (dps)": (RATE / DEG).tolist()
    },
    "pandas, columns": {
        name: {str(at): value for at, value in enumerate(own)} for name, own in COLUMNS.items()
    },
    "pandas, split": {"columns": NAMES, "index": list(range(ROWS)), "data": TABLE.tolist()},
}  # fmt: skip


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("indent", [None, 2])
def test_a_document_is_read(tmp_path, form, indent):
    path = write(tmp_path, "run.json", json.dumps(FORMS[form], indent=indent))
    check(imucal.read(path))


@pytest.mark.parametrize(
    "form", ["objects", "objects in objects", "lists of three in objects", "in messages"]
)
def test_json_lines_are_read_and_broken_lines_counted(tmp_path, form):
    lines = [json.dumps(row) for row in FORMS[form]]
    check(imucal.read(write(tmp_path, "run.jsonl", lines)))
    recording = imucal.read(write(tmp_path, "cut.jsonl", [*lines, lines[0][:20]]))
    check(recording)
    if form != "objects":
        (left,) = [own for own in recording.findings if own.code == "lines_left_out"]
        assert left.count == 1 and f"line {len(lines) + 1}" in left.message


def test_sensors_named_in_each_object_or_by_their_list(tmp_path):
    accel, gyro = rows_of(FORCE), rows_of(RATE)
    mixed = [
        row
        for pair in zip(rows_of(FORCE, type="acc"), rows_of(RATE, type="gyro"), strict=True)
        for row in pair
    ]
    for document in (
        {"accelerometer": accel, "gyroscope": gyro, "magnetometer": rows_of(FORCE)},
        {"readings": mixed},
        mixed,
    ):
        path = write(tmp_path, "run.json", json.dumps(document))
        check(imucal.read(path, gyro_unit="rad/s"))
        with pytest.raises(imucal.FormatError, match=r"\(gyro\w*\): the header gives no unit"):
            imucal.read(path)


@pytest.mark.parametrize("form", ["nested", "named"])
def test_two_units_in_one_document_are_refused(tmp_path, form):
    document = {
        side: {"accelerometer": rows_of(FORCE + at), "gyroscope": rows_of(RATE + at)}
        for at, side in enumerate(("left", "right"))
    }
    if form == "named":
        document = [
            row | {"sensor": f"{side} {sensor}"}
            for side, sensors in document.items()
            for sensor, rows in sensors.items()
            for row in rows
        ]
    path = write(tmp_path, "run.json", json.dumps(document))
    with pytest.raises(imucal.InputError, match=r"2 tables hold the accelerometer .* of one unit"):
        imucal.read(path, gyro_unit="rad/s")


def test_one_sensor_alone(tmp_path):
    path = write(tmp_path, "run.json", json.dumps(rows_of(FORCE, sensor="Accelerometer")))
    recording = imucal.read(path)
    np.testing.assert_allclose(recording.specific_force, FORCE, atol=1e-12)
    assert recording.sensors == ("accelerometer",)


def test_names_without_units_are_asked_for_with_the_names_of_members(tmp_path):
    rows = [
        {"t": t, "acc": f, "gyro": w}
        for t, f, w in zip(TIME_S.tolist(), FORCE.tolist(), RATE.tolist(), strict=True)
    ]
    path = write(tmp_path, "run.json", json.dumps(rows))
    with pytest.raises(imucal.FormatError, match=r"'time_s=t,accel_x_mps2=acc\.x,.*gyro\.z'") as caught:
        imucal.read(path)
    columns = str(caught.value).partition("--columns '")[2].partition("'")[0]
    check(imucal.read(path, columns=columns))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{}", "without samples"),
        ('{"a": 1}', "without samples"),
        ("[1, 2, 3]", "without samples"),
        ("[{}, {}]", "without samples"),
        ("[[1, 2, 3], [4, 5, 6]]", "without samples"),
        ('{"a": [1, 2', "is no valid JSON"),
        ("[" * 100_000, "JSON"),
        ('{"a":' * 100_000, "JSON"),
        ('[{"x": 1, "y": 2, "z": 3}]', "the format could not be determined"),
    ],
)
def test_other_json_is_refused_by_name(tmp_path, content, message):
    with pytest.raises(imucal.FormatError, match=f"run.json.*{message}"):
        imucal.read(write(tmp_path, "run.json", content))


def check(recording):
    assert (recording.accel_unit, recording.gyro_unit, len(recording)) == ("m/s^2", "rad/s", ROWS)
    np.testing.assert_allclose(recording.time_s - recording.time_s[0], TIME_S, atol=1e-9)
    np.testing.assert_allclose(recording.specific_force, FORCE, atol=1e-12)
    np.testing.assert_allclose(recording.angular_rate, RATE, atol=1e-12)
