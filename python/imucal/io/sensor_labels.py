"""Labels of sensors, in names of files and in columns with the sensor of each row, such as `gyroscope`."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

from imucal.io.column_words import is_of_other, role_of, words_of
from imucal.io.unit_words import split_unit

__all__ = ["may_name_sensors", "only_triple", "sensor_of_file", "sensor_of_label"]

# Maximum number of different labels in a column that names the sensor of each row.
MOST_SENSORS: Final = 40
# Labels of one letter that name sensors: accelerometer, gyroscope, magnetometer. If a column contains other
# labels of one letter, its letters are no sensors, for example the poses A to G.
LETTERS: Final = {"a", "g", "m"}
# Words in names of files, also without a separator: AccData.csv.
GYRO_FILE: Final = r"(?i)gyr|angular|rotation.?rate|omega"
ACCEL_FILE: Final = r"(?i)acc(?!ura|um|ess)|g-?force|specific"
OTHER_FILE: Final = r"(?i)linear|gravity|angular.?acc|user|mag|orient|baro|without"
WITH_GRAVITY: Final = r"(?i)(?:with|including|incl|plus)[\W_]*gravity"
# Names of the axes in columns of one sensor, each with the names of a fourth column that excludes a sensor.
AXES: Final = (("xyz", "w"), ("012", "3"), ("123", "04"))


def sensor_of_label(label: str) -> str:
    """The sensor that a label names: "accel", "gyro", "other" for another quantity, or "" for none or both.

    The last part of a path, such as `accel` in `home/imu/accel`, has precedence over the other parts.
    """
    for part in (re.split(r"[./:]", label)[-1], label):
        if re.search(ACCEL_FILE, part) and re.search(GYRO_FILE, part):
            return ""
        bare, unit = split_unit(part)
        words = [word for word in words_of(bare) if not re.fullmatch(r"[xyz]|\d+", word)]
        role = role_of(["x", *words], "", unit)
        if role is not None and role[0] in ("accel", "gyro"):
            return role[0]
        if is_of_other(words) or "vector" in words:
            return "other"
    return sensor_of_file(label)


def sensor_of_file(name: str) -> str:
    """The sensor that the name of a file names, as in `sensor_of_label`."""
    if re.search(OTHER_FILE, re.sub(WITH_GRAVITY, "", name)):
        return "other"
    is_accel, is_gyro = (re.search(words, name) is not None for words in (ACCEL_FILE, GYRO_FILE))
    return "" if is_accel == is_gyro else "accel" if is_accel else "gyro"


def may_name_sensors(labels: Sequence[str]) -> bool:
    """Whether the different labels of a column can name sensors."""
    letters = {label.strip().lower() for label in labels if len(label.strip()) == 1}
    return len(labels) <= MOST_SENSORS and letters <= LETTERS


def only_triple(names: Sequence[str]) -> tuple[str, str, str] | None:
    """The only three columns whose names differ by the axis alone, such as payload.x or value0, or None."""
    stems: dict[str, dict[str, str]] = {}
    for name in names:
        match = re.fullmatch(r"(.*?)[\W_]*([wxyz]|\d+)[\])]?", split_unit(name)[0].strip(), re.IGNORECASE)
        if match is not None:
            stems.setdefault(match[1].lower(), {})[match[2].lower()] = name
    found = [
        (axes[own[0]], axes[own[1]], axes[own[2]])
        for axes in stems.values()
        for own, fourth in AXES
        if axes.keys() >= set(own) and axes.keys().isdisjoint(fourth)
    ]
    return found[0] if len(found) == 1 else None
