"""Reads recordings with one text file per sensor, which phone apps write: two files, a folder, or a zip.

The files have separate time stamps, and both sensors are resampled to one clock as described in `streams`.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from imucal.document.source import File, is_folder, open_file, open_large
from imucal.errors import FormatError, InputError
from imucal.io.alone import alone, recording_of_any_text
from imucal.io.header import layout_header
from imucal.io.joined import joined
from imucal.io.json_in_text import refuse_json
from imucal.io.packed import TEXT_ENDINGS, ZIP, Archive
from imucal.io.remarks import remark
from imucal.io.sensor import Sensor, Units, has_gravity, sensor_in_name, sensor_of, units_given
from imucal.io.text import Text, head_of, open_path, open_text
from imucal.recording.recording import Recording

__all__ = ["are_pair", "read_folder", "read_pair", "recording_of_texts"]


def read_pair(
    first_path: str | os.PathLike[str],
    second_path: str | os.PathLike[str],
    *,
    rate_hz: float | None = None,
    time_unit: str | None = None,
    accel_unit: str | None = None,
    gyro_unit: str | None = None,
) -> Recording:
    """Read two text files, one per sensor.

    If the files do not identify the sensors, the first file is the accelerometer.

    rate_hz     sampling rate, Hz; the time stamps are then not read, and the samples of both files are taken
                together in their order
    time_unit   s, ms, us or ns
    accel_unit  m/s^2, g, mg or lsb
    gyro_unit   rad/s, deg/s, mdeg/s or lsb

    A unit is needed only if the header does not state it. If the header contradicts a given unit, InputError
    is raised.
    """
    units = units_given(time_unit, accel_unit, gyro_unit, rate_hz)
    for path in (first_path, second_path):
        refuse_json(path)
    sensors = [sensor_of(open_path(path)) for path in (first_path, second_path)]
    for sensor in sensors:
        _require_one(sensor)
    return joined(*_by_role(sensors), units, lambda: [sensor.text.sources[0] for sensor in sensors], rate_hz)


def read_folder(
    path: str | os.PathLike[str],
    *,
    columns: str | Sequence[str] | None = None,
    rate_hz: float | None = None,
    time_unit: str | None = None,
    accel_unit: str | None = None,
    gyro_unit: str | None = None,
) -> Recording:
    """Read the text files in a folder or a zip archive: one file with both sensors, or one file per sensor.

    If there is no file with the samples of the gyroscope, the recording contains only the accelerometer.

    The other arguments are those of `read_csv` and `read_pair`. Raises InputError for an argument that the
    files do not need.
    """
    units = units_given(time_unit, accel_unit, gyro_unit, rate_hz)
    return recording_of_texts(list(_texts(path)), Path(path).name, columns, rate_hz, units)


def recording_of_texts(
    texts: Sequence[Text],
    name: str,
    columns: str | Sequence[str] | None,
    rate_hz: float | None,
    units: Units,
) -> Recording:
    """The recording in several texts: one text with both sensors, or one text per sensor.

    name     name of the file or folder that contains the texts, for messages

    The other arguments are those of `read_folder`.
    """
    if len(texts) == 1:
        return recording_of_any_text(texts[0], columns, rate_hz, units)
    both = [text for text in texts if _has_both(text)]
    sensors, refused = _sensors(texts)
    accels, gyros = ([sensor for sensor in sensors if sensor.what == what] for what in ("accel", "gyro"))
    singles = [sensor.text for sensor in (*accels, *gyros)]
    if gyros and any(map(has_gravity, accels)):
        # Sensor Logger writes one table per sensor of the phone, and one table with both sensors of a watch,
        # whose acceleration is without gravity.
        without = [text for text in both if not has_gravity(_accelerometer(text))]
        both = [text for text in both if text not in without]
    else:
        without, singles = [], []
    if len(both) == 1:
        recording = recording_of_any_text(both[0], columns, rate_hz, units)
        return _with_unread(recording, name, [*without, *singles])
    if len(both) > 1:
        raise InputError(f"{name}: {len(both)} tables hold a recording ({_listed(both)}): {_one_of(both)}")
    if columns is not None:
        raise InputError(
            f"{name}: no file contains both sensors, and columns (--columns) names the columns of one table: "
            "leave the option out; to replace the time stamps of both sensors, give rate_hz (--rate-hz) alone"
        )
    for what, found in (("accel", accels), ("gyro", gyros)):
        if not found and what in refused:
            raise refused[what]
    if accels and not gyros:
        return alone(_chosen(name, accels, "accelerometer", texts), units, rate_hz)
    accel = _chosen(name, accels, "accelerometer", texts)
    gyro = _chosen(name, gyros, "gyroscope", texts)
    recording = joined(
        accel,
        gyro,
        units,
        lambda: list(dict.fromkeys([*accel.text.sources, *gyro.text.sources])),
        rate_hz,
    )
    return _with_unread(recording, name, without)


def are_pair(paths: Sequence[str | os.PathLike[str]]) -> bool:
    """Whether the headers of two files identify them as accelerometer and gyroscope of one recording."""
    roles = []
    for path in paths:
        try:
            head, layout = head_of(path)
            sensor = sensor_of(Text(Path(path).name, head, layout, ()))
        except (FormatError, InputError):
            return False
        roles.append(sensor.what)
    return sorted(roles) == ["accel", "gyro"]


def _texts(path: str | os.PathLike[str]) -> Iterator[Text]:
    """The text files in a folder or an archive that have rows of numbers."""
    files: Iterator[File]
    source = None if is_folder(path) else open_large(path)
    if source is None:
        inside = sorted(p for p in Path(path).iterdir() if p.is_file() and not p.name.startswith("."))
        files = (open_file(p) for p in inside if p.name.lower().endswith(TEXT_ENDINGS) and p.stat().st_size)
    else:
        archive = Archive(path)
        files = (File(Path(member).name, archive.read(member), source) for member in archive.texts())
    for file in files:
        if not file.content.startswith(ZIP) and file.content.strip():
            try:
                yield open_text(file)
            except FormatError:
                continue


def _sensors(texts: Sequence[Text]) -> tuple[list[Sensor], dict[str, FormatError]]:
    """The texts with the three columns of one sensor.

    Also returns the error for a text whose name or label names a sensor ("accel", "gyro"), but whose columns
    do not.
    """
    sensors, refused = [], {}
    for text in texts:
        try:
            sensors.append(sensor_of(text))
        except FormatError as error:
            if not _has_both(text):
                refused[sensor_in_name(text)] = error
    return sensors, refused


def _accelerometer(text: Text) -> Sensor:
    """The accelerometer in a text with both sensors."""
    header = layout_header(text.layout)
    return Sensor(text, header, header.accel[0], "accel")


def _with_unread(recording: Recording, name: str, texts: Sequence[Text]) -> Recording:
    """The recording with a warning about tables that contain other samples of the same sensors."""
    if not texts:
        return recording
    warning = remark(
        name,
        "tables_not_read",
        f"not read, although there are samples of an accelerometer or a gyroscope: {_listed(texts)}; "
        f"read: {recording.name}",
        "to read them instead, write them to a separate file",
    )
    return replace(recording, findings=(*recording.findings, warning))


def _has_both(text: Text) -> bool:
    header = layout_header(text.layout)
    return bool(text.layout.first and header.accel and header.gyro)


def _by_role(sensors: Sequence[Sensor]) -> tuple[Sensor, Sensor]:
    first, second = sensors
    roles = (first.what, second.what)
    if roles in (("gyro", "accel"), ("gyro", ""), ("", "accel")):
        return second, first
    if first.what in ("accel", "") and second.what in ("gyro", ""):
        return first, second
    raise FormatError(
        f"{first.text.name} holds {_sensor_name(first.what)}, {second.text.name} "
        f"{_sensor_name(second.what)}: give an accelerometer with gravity and a gyroscope"
    )


def _sensor_name(what: str) -> str:
    known = {"accel": "an accelerometer", "gyro": "a gyroscope", "other": "another quantity"}
    return known.get(what, "an unnamed sensor")


def _require_one(sensor: Sensor) -> None:
    """Raises InputError if the file has the columns of several sensors of this kind."""
    header = sensor.header
    found = {"accel": header.accel, "gyro": header.gyro}.get(sensor.what, [])
    found = found or [triad for triad, _ in header.plain]
    if len(found) > 1:
        raise InputError(
            f"{sensor.text.name}: there are the columns of {len(found)} sensors of one kind "
            f"({', '.join(triad.columns[0] for triad in found)}, ...): leave out the columns of all but one"
        )


def _chosen(name: str, sensors: list[Sensor], what: str, texts: Sequence[Text]) -> Sensor:
    """The file among `sensors` that is read for the sensor `what`.

    If there are several files, the choice is narrowed in three steps: to files whose acceleration includes
    gravity, to files without "uncal" in the name, and to files with "total" or "gravity" in the name (an
    accelerometer is named so only if it includes gravity). A step that would
    leave no file is skipped.
    """
    if what == "accelerometer" and len(sensors) > 1:
        with_gravity = [sensor for sensor in sensors if has_gravity(sensor)]
        sensors = with_gravity or sensors
    if len(sensors) > 1:
        named = [s for s in sensors if "uncal" not in s.text.label.lower()]
        total = [s for s in named if re.search(r"(?i)total|gravity", s.text.label)]
        sensors = total or named or sensors
    if len(sensors) == 1:
        _require_one(sensors[0])
        return sensors[0]
    if not sensors:
        raise FormatError(f"{name}: no file with the {what}; found: {_listed(texts)}: export it too")
    listed = ", ".join(sensor.text.name for sensor in sensors)
    way_out = _one_of([sensor.text for sensor in sensors])
    raise InputError(f"{name}: {len(sensors)} tables hold the {what} ({listed}): {way_out}")


def _one_of(texts: Sequence[Text]) -> str:
    """The way out if several texts hold the same sensor."""
    if all(text.label == text.name for text in texts):
        return "give the files of one recording, unpacked"
    return "write the samples of one unit to a file"


def _listed(texts: Sequence[Text]) -> str:
    return ", ".join(text.name for text in texts) or "no text files"
