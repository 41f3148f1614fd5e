"""Detection of tables that contain the samples of several units (IMUs), or of several sensors.

In such a table, a column names the unit of each row, for example by its address. If the table were read as
the recording of one unit, the samples and the sampling rate would be wrong. A column may also contain labels
that do not name a unit, such as classes of a motion. The rows are those of several units if

* the name of the column says that it names units or sessions, and it has several values, or
* each row has the sample of one sensor, and the labels name both sensors, or
* the samples of two consecutive rows differ more if the rows have different labels, or
* the time stamps decrease where the label changes, because one unit is written after the other.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import FloatArray
from imucal.errors import FormatError
from imucal.io.head import Head
from imucal.io.names import is_canonical, time_unit, triad_part
from imucal.io.sensor_labels import MOST_SENSORS, may_name_sensors, sensor_of_label
from imucal.io.text import Text

__all__ = ["refuse_interleaved"]

# Largest number of different labels in a column for the labels to count as names of units (IMUs).
MOST_UNITS: Final = 8
# A column can name units if the table has at least LEAST_ROWS rows, and if the label in at least the share
# LEAST_CHANGES of the rows differs from the label in the previous row.
LEAST_ROWS: Final = 40
LEAST_CHANGES: Final = 0.1
# The samples belong to several units if their median change from a row to a row with another label exceeds
# this multiple of the median change between successive samples with the same label.
CLEAR: Final = 5.0
# The samples also belong to several units if the time stamps decrease at more than this share of the changes
# of the label, and nowhere else. With two units that write packets of rows in turn, the share is one half.
LEAST_RESTARTS: Final = 0.3
# Names of columns whose cells name a unit.
UNIT_COLUMN: Final = (
    r"(?i)(ble[ _-]?)?(device|unit|imu|node|board|module|tracker|mac|serial|address)"
    r"[ _-]?(id|uid|uuid|mac|name|addr|address|serial|no|nr|number|key)?|"
    r"sensor[ _-]?(id|uid|uuid|mac|addr|address|serial|no|nr|number)"
)
# Names of columns whose cells name a session, which is a recording.
SESSION_COLUMN: Final = r"(?i)(session|recording)[ _-]?(id|uid|uuid|no|nr|number|name)?"
# Names of columns whose cells name the sensor of a row, if each row has the sample of one sensor.
SENSOR_COLUMN: Final = r"(?i)(sensor|sample|data)?[ _-]?(type|kind|source|channel|stream|topic|name)|sensor"
# Size of the end of a text in which names of units are searched, bytes. With the first rows, it shows units
# that were written one after the other.
LAST_BYTES: Final = 1 << 14


def refuse_interleaved(text: Text, names: Sequence[str], head: Head | None = None) -> None:
    """Raises FormatError if a column without a canonical name shows that the rows are from several units.

    names  names of the columns, canonical or not
    head   the first cells, if they are known
    """
    keys = text.layout.names or [str(index) for index in range(len(names))]
    others = [key for key, name in zip(keys, names, strict=False) if not is_canonical(name)]
    triads = {
        part: key for key, name in zip(keys, names, strict=False) if (part := triad_part(name)) is not None
    }
    if not others or not triads:
        return
    head = head or Head(text)
    sensors = {part[0] for part in triads}
    samples = np.column_stack(
        [head.numbers(key) for part, key in sorted(triads.items()) if part[0] == min(sensors)]
    )
    times = [key for key, name in zip(keys, names, strict=False) if time_unit(name) is not None]
    time = head.numbers(times[0]) if times else np.array([])
    for other in others:
        labels = head.cells.get(other, [])
        one_sensor = len(sensors) == 1
        named = _named(other, one_sensor=one_sensor)
        if not named and one_sensor and labels and sensor_of_label(labels[0]) == min(sensors):
            last = dict.fromkeys(_last_labels(text, other))
            of_last = set(map(sensor_of_label, last)) if may_name_sensors([*{*labels, *last}]) else set()
            named = "sensor" if of_last & {"accel", "gyro"} - sensors else ""
        if named:
            labels = [label for label in [*labels, *_last_labels(text, other)] if label]
            kinds = {label.strip().casefold() for label in labels}
            # A column with more values is for example a counter.
            is_divided = 2 <= len(kinds) <= min(MOST_SENSORS, len(labels) // 2)
        else:
            is_divided = len(labels) == len(samples) >= LEAST_ROWS and (
                _divide(labels, samples) or _restart(labels, time)
            )
        if is_divided:
            names_of = list({label.strip().casefold(): label for label in labels}.values())
            what = named or "unit"
            raise FormatError(
                f"{text.name}: each row belongs to one of {len(names_of)} {what}s, named in the column "
                f"{other!r} ({', '.join(names_of)[:60]}): write the rows of each {what} to a separate file; "
                f"if the column names no {what}, remove or rename it"
            )


def _named(column: str, *, one_sensor: bool) -> str:
    """What the cells of a column name by its name: "unit", "session" or "sensor"; otherwise "".

    one_sensor  whether the rows have the samples of one sensor only, so that each can be of another sensor
    """
    name = column.rpartition(".")[2].strip()
    if re.fullmatch(UNIT_COLUMN, name):
        return "unit"
    if re.fullmatch(SESSION_COLUMN, name):
        return "session"
    return "sensor" if one_sensor and re.fullmatch(SENSOR_COLUMN, name) else ""


def _last_labels(text: Text, column: str) -> list[str]:
    """The cells of a column in the last rows. They show units whose rows are not among the first rows."""
    rows = text.last_rows(LAST_BYTES).partition(b"\n")[2]
    return Head(Text(text.name, rows, text.layout._replace(start=0), ())).cells.get(column, [])


def _divide(labels: Sequence[str], samples: FloatArray) -> bool:
    kinds = set(labels)
    if not 2 <= len(kinds) <= MOST_UNITS:
        return False
    array = np.array(labels)
    is_change = _changes(labels)
    if is_change.mean() < LEAST_CHANGES:
        return False
    across = _sizes(samples)[is_change]
    within = np.concatenate([_sizes(samples[array == kind]) for kind in kinds])
    return bool(np.nanmedian(across) > CLEAR * np.nanmedian(within)) if len(within) else False


def _restart(labels: Sequence[str], time: FloatArray) -> bool:
    """Whether the time stamps decrease or repeat at many changes of the label, and only there."""
    if len(time) != len(labels) or not 2 <= len(set(labels)) <= MOST_UNITS:
        return False
    is_back, is_change = np.diff(time) <= 0, _changes(labels)
    return bool(is_back[is_change].mean() > LEAST_RESTARTS and not is_back[~is_change].any())


def _changes(labels: Sequence[str]) -> NDArray[np.bool_]:
    """Whether the label of each row differs from the label of the previous row."""
    array = np.array(labels)
    return np.asarray(array[1:] != array[:-1])


def _sizes(samples: FloatArray) -> FloatArray:
    """Magnitude of the difference between each sample and the previous sample."""
    return np.asarray(np.linalg.norm(np.diff(samples, axis=0), axis=1))
