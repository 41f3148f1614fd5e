"""JSON Lines whose objects differ, documents that are cut off, and encodings of JSON."""

import gzip
import json

import numpy as np
import pytest

import imucal
from export_files import FORCE, NS, RATE, ROWS, TIME_S, write

NAMES = ["time_s", *(f"accel_{a}_mps2" for a in "xyz"), *(f"gyro_{a}_radps" for a in "xyz")]
FLAT = [dict(zip(NAMES, row, strict=True)) for row in np.column_stack([TIME_S, FORCE, RATE]).tolist()]


def check(recording):
    assert len(recording) == ROWS
    np.testing.assert_allclose(recording.specific_force, FORCE, atol=1e-12)
    np.testing.assert_allclose(recording.angular_rate, RATE, atol=1e-12)


@pytest.mark.parametrize(
    "differ",
    [
        lambda at, row: row | ({"temp_degc": 25.0} if at % 10 == 0 else {}),
        lambda at, row: dict(reversed(row.items())) if at % 3 == 0 else row,
        lambda at, row: row | ({"state": "rest"} if at % 2 else {}),
    ],
    ids=["a member in some lines", "order of the members", "a text in some lines"],
)
def test_lines_with_other_members_are_not_left_out(tmp_path, differ):
    recording = imucal.read(write(tmp_path, "run.jsonl", [json.dumps(differ(*at)) for at in enumerate(FLAT)]))
    check(recording)
    assert not recording.findings


def test_a_missing_number_is_nan_and_the_other_numbers_are_kept(tmp_path):
    rows = [row | ({"accel_x_mps2": None} if at % 7 == 3 else {}) for at, row in enumerate(FLAT)]
    recording = imucal.read(write(tmp_path, "run.jsonl", [json.dumps(row) for row in rows]))
    assert len(recording) == ROWS
    np.testing.assert_array_equal(np.isnan(recording.specific_force[:, 0]), np.arange(ROWS) % 7 == 3)
    np.testing.assert_allclose(recording.angular_rate, RATE, atol=1e-12)


def test_lines_of_each_sensor_are_joined(tmp_path):
    lines = [
        json.dumps({name: own for name, own in row.items() if name[0] != other})
        for row in FLAT
        for other in "ga"
    ]
    check(imucal.read(write(tmp_path, "run.jsonl", lines)))


def test_lines_of_text_before_the_objects_are_counted(tmp_path):
    recording = imucal.read(write(tmp_path, "run.txt", ["Started", *map(json.dumps, FLAT)]))
    check(recording)
    (left,) = recording.findings
    assert (left.code, left.count) == ("lines_left_out", 1) and "'Started'" in left.message


def test_labels_that_only_look_like_json_stay_labels(tmp_path):
    lines = [json.dumps(row)[:-1] + ",}" for row in FLAT]
    check(imucal.read(write(tmp_path, "run.txt", lines)))


def test_a_line_separator_in_a_text_does_not_end_the_line(tmp_path):
    lines = [json.dumps(row | {"note": "a\u2028b"}, ensure_ascii=False) for row in FLAT]
    check(imucal.read(write(tmp_path, "run.jsonl", lines)))


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "gzip"])
@pytest.mark.parametrize("form", ["document", "lines"])
@pytest.mark.parametrize("options", [{}, {"format": "json"}])
def test_encodings(tmp_path, encoding, form, options):
    text = json.dumps(FLAT) if form == "document" else "\n".join(map(json.dumps, FLAT)) + "\n"
    content = gzip.compress(text.encode()) if encoding == "gzip" else text.encode(encoding)
    path = tmp_path / "run.json"
    path.write_bytes(content)
    check(imucal.read(path, **options))


def test_units_in_latin_1(tmp_path):
    rows = [
        {"t (s)": row["time_s"], "acc (m/s²)": f, "gyro (rad/s)": w}
        for row, f, w in zip(FLAT, FORCE.tolist(), RATE.tolist(), strict=True)
    ]
    path = tmp_path / "run.json"
    path.write_bytes(json.dumps(rows, ensure_ascii=False).encode("cp1252"))
    check(imucal.read(path))


def test_a_list_with_one_object_per_line_may_be_cut_in_the_last_line(tmp_path):
    text = "[\n" + ",\n".join(map(json.dumps, [*FLAT, FLAT[0]]))
    recording = imucal.read(write(tmp_path, "run.json", text[:-30]))
    check(recording)
    assert [own.code for own in recording.findings] == ["lines_left_out"]


def accel_and_gyro():
    own = [
        [
            {"t": ns, "x": x, "y": y, "z": z}
            for ns, (x, y, z) in zip(NS.tolist(), values.tolist(), strict=True)
        ]
        for values in (FORCE, RATE)
    ]
    return dict(zip(("accelerometer", "gyroscope"), own, strict=True))


@pytest.mark.parametrize("between", ["],\n{name}:[", "],{name}:[", "]\n,\n{name}:\n[\n"])
@pytest.mark.parametrize("lists", [{"left": FLAT, "right": FLAT}, accel_and_gyro()], ids=["units", "sensors"])
@pytest.mark.parametrize("options", [{}, {"format": "json"}])
def test_lists_of_a_cut_document_are_not_joined(tmp_path, between, lists, options):
    first, second = lists
    text = f'{{"{first}":[\n' + ",\n".join(map(json.dumps, lists[first])) + "\n"
    text += between.format(name=f'"{second}"') + "\n" + ",\n".join(map(json.dumps, lists[second])) + "\n"
    with pytest.raises(imucal.FormatError, match=r"gyroscope.json is no valid JSON .* cut off or damaged"):
        imucal.read(write(tmp_path, "gyroscope.json", text), **options)
    lines = ["[[", *(json.dumps(row) + "," for row in FLAT), "],[", *(json.dumps(row) + "," for row in FLAT)]
    with pytest.raises(imucal.FormatError, match="cut off or damaged"):
        imucal.read(write(tmp_path, "run.json", lines), **options)
