"""Texts that contain JSON but are neither a document nor JSON Lines."""

import gzip
import json

import numpy as np
import pytest

import imucal
from export_files import FORCE, NS, RATE, write

FORCES, RATES = (
    [
        {"timestamp": ns} | dict(zip("xyz", row, strict=True))
        for ns, row in zip(NS.tolist(), values.tolist(), strict=True)
    ]
    for values in (FORCE, RATE)
)


@pytest.mark.parametrize("form", ["document", "lines", "gzip", "csv"])
def test_two_files_in_json_are_refused_with_the_way_out(tmp_path, form):
    paths = []
    for name, rows in (("Accelerometer", FORCES), ("Gyroscope", RATES)):
        text = "\n".join(map(json.dumps, rows)) if form == "lines" else json.dumps(rows)
        paths.append(write(tmp_path, f"{name}.json", text))
    if form == "gzip":
        paths[1] = tmp_path / "Gyroscope.json.gz"
        paths[1].write_bytes(gzip.compress(json.dumps(RATES).encode()))
    if form == "csv":
        cells = [",".join(map(str, row.values())) for row in FORCES]
        paths[0] = write(tmp_path, "Accelerometer.csv", "timestamp,x,y,z", cells)
    with pytest.raises(imucal.FormatError, match=r"is JSON, .* as one list per sensor") as caught:
        imucal.read(*paths, gyro_unit="rad/s")
    assert len(str(caught.value)) < 250
    merged = json.dumps({"accelerometer": FORCES, "gyroscope": RATES})
    recording = imucal.read(write(tmp_path, "run.json", merged), gyro_unit="rad/s")
    np.testing.assert_allclose(recording.specific_force, FORCE, atol=1e-9)
    np.testing.assert_allclose(recording.angular_rate, RATE, atol=1e-9)


@pytest.mark.parametrize("prefix", ["12:00:00.{at:03d} -> ", "I ({at}) imu: ", "imu/{sensor} "])
def test_text_before_json_is_refused_with_the_way_out(tmp_path, prefix):
    lines = [
        prefix.format(at=at, sensor=sensor) + json.dumps(row)
        for at, both in enumerate(zip(FORCES, RATES, strict=True))
        for sensor, row in zip(("acc", "gyro"), both, strict=True)
    ]
    path = write(tmp_path, "log.txt", lines)
    with pytest.raises(imucal.FormatError, match=r"each line has text before its JSON") as caught:
        imucal.read(path)
    assert '{"sensor": "accelerometer", ...}' in str(caught.value) and "--columns" not in str(caught.value)
