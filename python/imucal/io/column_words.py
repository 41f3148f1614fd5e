"""Infers the quantity and the axis of a column from the words of its name."""

from __future__ import annotations

import re
from itertools import pairwise
from typing import Final
from unicodedata import combining, normalize

__all__ = [
    "NOT_TIME",
    "is_counted",
    "is_of_other",
    "is_remark",
    "is_time",
    "role_of",
    "time_unit_in",
    "without_gravity",
    "words_of",
    "words_of_unit",
]

# Words that name the accelerometer and the gyroscope.
ACCEL: Final = {
    *("a", "ac", "acc", "accel", "accl", "accelerometer", "acceleration", "accelerometers", "accels", "af"),
    *("specific", "gf", "gforce", "acce", "accs", "accelero", "totalacceleration"),
    # The word "acceleration" as apps translate it, without accents: German, Spanish, Italian, Portuguese,
    # Dutch. French has the English word.
    *("acel", "acelerometro", "accelerometro"),
    *("beschleunigung", "aceleracion", "accelerazione", "aceleracao", "versnelling"),
}
GYRO: Final = {
    *("g", "gy", "gyr", "gyro", "gyros", "gyroscope", "w", "omega", "angular", "rotation", "rate"),
    *("ang", "rot"),
    *("angvel", "anglvel", "angrate", "turnrate"),
    *("gir", "giro", "giros"),
    *("gyroskop", "drehrate", "winkelgeschwindigkeit", "giroscopio", "gyroscoop"),
}
# If a column name contains one of these words, the column belongs to neither the accelerometer (with gravity)
# nor the gyroscope.
OTHER: Final = {
    *("user", "free", "gravity", "grav", "mag", "magn", "magnet", "magnetic", "magnetometer"),
    *("quat", "euler"),
    *("quaternion", "roll", "pitch", "yaw", "orientation", "position", "pos", "std", "var", "cov"),
    *("covariance", "bias", "offset", "absolute", "abs", "norm", "delta", "earth", "world", "nav", "global"),
    *("status", "flag", "velocity", "inc", "dq", "dv", "angle", "temperature", "temp", "setpoint", "debug"),
    *("axisp", "axisi", "axisd", "axisf", "motor", "uncorrected", "north", "east", "down"),
    *("attitude", "dgyro", "not"),
    *("heart", "pulse", "breath", "breathing", "respiration", "respiratory"),
}
# Words of the gyroscope that also name an angle or a rotation vector. They need a unit of angular rate, or a
# word for a speed.
ANGLE_OR_RATE: Final = {"rotation", "ang"}
SPEED: Final = {"velocity", "vel", "speed", "spd"}
# Pairs of these words state that acceleration includes gravity, as in `accelerationIncludingGravity`.
INCLUDING: Final = {"with", "including", "incl", "inclusive", "plus"}
GRAVITY: Final = {"gravity", "grav"}
# Words that name acceleration without gravity.
LINEAR: Final = {
    *("linear", "lin", "linearacceleration", "linacc", "linaccel"),
    *("lineare", "lineaire", "lineal"),
}
# Words that name a time column.
TIME: Final = (
    r"^(t|time|times|timestamp|timestamps|stamp|ts|sec|secs|seconds|elapsed|epoch|unix|millis|micros|clock|"
    r"date|datetime|sampletimefine|chiptime|utc|hosttimestamp|nodetimestamp|cts|tow|gpstime|gpst|yyyy|uptime|"
    r"packettime|systime|timeus|timems|ustime|mstime|loggingtime|ms|us|ns|zeit|temps|tiempo|tempo|tijd)$"
)
# A column whose name contains one of these words is not a time column. A pair of columns with the seconds and
# the nanoseconds of a time stamp may have such names, but is used only if there is no other such pair.
NOT_TIME: Final = {"zone", "step", "delta", "dt", "diff", "ntp", "gps"}
# If the name of a time column ends with one of these words, its values are counts of ticks, frames or
# samples, or times in a unit that is not supported, such as hours.
COUNTED: Final = {
    *("tick", "ticks", "jiffies", "cycle", "cycles", "frame", "frames", "sample", "samples", "clk"),
    *("min", "mins", "minute", "minutes", "h", "hr", "hrs", "hour", "hours", "d", "day", "days"),
}
# Words in brackets that are remarks on a column and not units. Words for sensors and times in brackets also
# count as remarks.
REMARKS: Final = {
    *("x", "y", "z", "axis", "sensor", "body", "device", "frame", "imu", "board", "phone", "watch", "mems"),
    *("calibrated", "uncalibrated", "cal", "uncal", "calib", "corrected", "compensated", "filtered"),
    *("unfiltered", "with", "including", "incl", "total", "measured", "value", "data", "signed", "float"),
    *("since", "start", "boot", "local", "gmt", "system", "host", "relative", "left", "right"),
    *("low", "high", "wide", "noise", "range", "primary", "secondary", "main"),
}
# Matches one word of a column name: a sequence of capitals, a capitalised or lower-case word, or a number.
WORD: Final = r"[A-Z]+(?![a-z])|[A-Z]?[a-z']+|[A-Za-z]+|\d+|%"
# Matches names in which sensor and axis are one word: ax, gyroX, xAccel, ACCEL_XOUT, AcX, gFz, GForceX.
JOINED: Final = (
    r"^(?:(a|acc|accel|acel|ac|f|gf|gforce|g|gy|gyr|gyro|gir|giro|w|omega)([xyz])|"
    r"([xyz])[-_ ]?(acc|accel|accl|acel|gyro|gyr|giro|rate))$"
)


def words_of(name: str) -> list[str]:
    """The words of a name in lower case, without accents."""
    plain = "".join(c for c in normalize("NFKD", name) if not combining(c))
    return [word.lower() for word in re.findall(WORD, plain)]


def role_of(words: list[str], bare: str, unit: tuple[str, str] | None) -> tuple[str, str, str] | None:
    """Quantity and axis of a column, and the part of its name that is common to all three axes.

    The result is None if the words of the name do not state quantity and axis.

    words   words of the name without the unit
    bare    the name without the unit
    unit    quantity and unit in the name, as from `unit_words.split_unit`
    """
    of = unit[0] if unit else ""
    if of in ("time", "temp", "angle", "other"):
        return None
    joined = re.match(
        JOINED, re.sub(r"^[^a-z]+|[^a-z]+$", "", bare.lower().rpartition(".")[2].rpartition("/")[2])
    )
    if joined:
        word, axis = (joined[1], joined[2]) if joined[1] else (joined[4], joined[3])
        rest = bare.lower().replace(joined[0], "")
        words = [word, *words_of(rest)]
    else:
        axes = [word[0] for word in words if re.fullmatch(r"[xyz](out|axis)?(l|h)?", word)]
        if len(axes) != 1:
            return None
        axis = axes[0]
        words = [word for word in words if not re.fullmatch(r"[xyz](out|axis)?(l|h)?", word)]
    key = " ".join(words)
    if "force" in words and "g" in words:
        words = ["gforce", *(word for word in words if word not in ("g", "force"))]
    words = without_gravity(words)
    may_be_angle = of != "gyro" and SPEED.isdisjoint(words) and GYRO.intersection(words) <= ANGLE_OR_RATE
    if "velocity" in words and {"angular", "rotation"}.intersection(words):
        words = [word for word in words if word != "velocity"]
    if any(word in OTHER for word in words):
        return None
    if any(word in LINEAR for word in words):
        return ("linear", axis, key) if of != "gyro" else None
    if of == "accel" and words and words[-1] in ("g", "f"):
        return "accel", axis, key
    is_gyro = any(word in GYRO for word in words) and not any(word in ACCEL and word != "a" for word in words)
    is_accel = any(word in ACCEL for word in words) or (words[:1] == ["f"])
    if (is_gyro and may_be_angle) or (is_accel and "angular" in words and not is_gyro):
        return None
    if is_gyro and of != "accel":
        return "gyro", axis, key
    if is_accel and of != "gyro":
        return "accel", axis, key
    if all(word in ("axis", "value", "values", "data", "raw", "sensor") for word in words):
        return (f"plain-{of}" if of in ("accel", "gyro") else "plain"), axis, key
    return None


def words_of_unit(name: str) -> set[str]:
    """The words of a column name that name neither the sensor nor the axis, such as `left` in left_acc_x."""
    return {
        word
        for word in words_of(name)
        if word not in ACCEL | GYRO | LINEAR | SPEED | INCLUDING | GRAVITY and not re.match(JOINED, word)
    } - set("xyz")


def without_gravity(words: list[str]) -> list[str]:
    """The words without a pair that states that the acceleration includes gravity."""
    for at, (word, following) in enumerate(pairwise(words)):
        if word in INCLUDING and following in GRAVITY:
            return words[:at] + words[at + 2 :]
    return words


def is_of_other(words: list[str]) -> bool:
    """Whether any word names another quantity, such as a magnetic field, or acceleration without gravity."""
    return any(word in OTHER or word in LINEAR for word in without_gravity(words))


def is_remark(text: str) -> bool:
    """Whether a text in brackets is a remark on the column, such as (z-axis), [0] or [x8004], not a unit."""
    if re.fullmatch(r"\d|x[0-9A-Fa-f]{4}", text):
        return True
    sensors = {word for word in ACCEL | GYRO if len(word) > 3}
    return re.search(r"[/*^²°º%µ]", text) is None and all(
        word in REMARKS or word in sensors or word.isdigit() or re.match(TIME, word)
        for word in without_gravity(words_of(text))
    )


def is_counted(words: list[str]) -> bool:
    """Whether a time column contains counts, or times in a unit that is not supported.

    words   words of the column's name; the last word decides (`COUNTED`)
    """
    return bool(words) and words[-1] in COUNTED


def is_time(words: list[str], unit: tuple[str, str] | None) -> bool:
    """Whether the words of a column name, and its unit if it has one, are those of a time column."""
    if not words or (unit is not None and unit[0] != "time"):
        return False
    if words == ["gps", "tow"]:
        return True
    return any(re.match(TIME, word) for word in words) and not any(
        word in NOT_TIME or word in OTHER or (len(word) > 1 and (word in ACCEL or word in GYRO))
        for word in words
    )


def time_unit_in(words: list[str]) -> str | None:
    """The unit of time that a word of a column name states, or None."""
    for unit, spelled in (
        ("s", ("sec", "secs", "seconds")),
        ("ms", ("ms", "millis", "milliseconds", "timems", "mstime")),
        ("us", ("us", "micros", "microseconds", "timeus", "ustime")),
        ("ns", ("ns", "nanos", "nanoseconds")),
    ):
        if any(word in spelled for word in words):
            return unit
    return None
