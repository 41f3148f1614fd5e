"""Spellings of units in headers of text files, and the corresponding suffixes of canonical names."""

from __future__ import annotations

import re
from typing import Final

__all__ = ["split_unit", "unit_of"]

# Spellings of each unit after normalisation by `_plain`. The key is the quantity and the suffix of canonical
# names. The unit "lsb" is valid for both sensors.
_SPELLINGS: Final[dict[tuple[str, str], str]] = {
    ("time", "s"): "s sec secs second seconds",
    ("time", "ms"): "ms msec msecs millis millisecond milliseconds",
    ("time", "us"): "us usec usecs micros microsecond microseconds",
    ("time", "ns"): "ns nsec nsecs nanos nanosecond nanoseconds",
    ("accel", "mps2"): "m/s2 m/s/s ms-2 mps2 m/sec2 m/sec/sec meters/second2 meters/s2 metres/s2 mpers2",
    ("accel", "g"): "g gs g's gee gees gforce",
    ("accel", "mg"): "mg mgs milli-g millig",
    ("gyro", "radps"): "rad/s rads-1 radps rad/sec radians/s radians/sec radians/second radpers rads",
    (
        "gyro",
        "dps",
    ): "deg/s °/s º/s dps d/s deg/sec °/sec º/sec degs-1 °s-1 degrees/s degree/s degrees/sec degree/sec "
    "degrees/second degpers degs",
    ("gyro", "mdps"): "mdps mdeg/s m°/s mdegs-1",
    ("any", "lsb"): "lsb lsbs raw count counts adc digit digits",
    ("temp", "degc"): "°c ºc degc c celsius deg.c",
    ("temp", "k"): "k kelvin degk",
    ("temp", "degf"): "°f ºf degf f fahrenheit deg.f",
    ("angle", "deg"): "deg ° degree degrees",
    ("angle", "rad"): "rad radian radians",
    (
        "other",
        "ut",
    ): "ut utesla gauss ga mgauss nt t localflux local_flux hpa kpa pa mbar m km/h hz v mv % "
    "nounits unitless noname",
}
_UNIT: Final = {word: unit for unit, words in _SPELLINGS.items() for word in words.split()}
# Matches a unit in brackets anywhere in a name.
_BRACKETS: Final = r"[\[({]([^\[\](){}]*(?:\([^()]*\)[^\[\](){}]*)*)[\])}]"
# Matches a unit in the last words of a name, such as time_us, gyro_x_rad_per_s, "Gyr X deg/s".
_ENDING: Final = (
    r"(?i)[_ .]?(rad[_ ]?per[_ ]?s|rad/s(?:ec)?|radps|rad_s|mdps|mdeg/s|dps|deg/s(?:ec)?|deg[_ ]per[_ ]s|"
    r"deg_s|°/s|m/s[²2^]+|m/s/s|mps2|m_s2|(?<=[_ .xyz])(?:mps|mss)|"
    r"(?<=[_ .])(?:mg|g|lsb|raw|counts?|ms|us|µs|ns|s|"
    r"sec|secs|seconds|millis|micros|nanos|milliseconds|microseconds|nanoseconds))$"
)
_ENDING_UNIT: Final = {
    "mps": ("accel", "mps2"),
    "mss": ("accel", "mps2"),
    "m_s2": ("accel", "mps2"),
    "rad_s": ("gyro", "radps"),
    "deg_s": ("gyro", "dps"),
}


def unit_of(text: str) -> tuple[str, str] | None:
    """The quantity and the suffix of canonical names of a unit: ("accel", "mg") for "[mg]"; or None."""
    return _UNIT.get(_plain(text))


def split_unit(name: str) -> tuple[str, tuple[str, str] | None]:
    """A column name without the unit, and the quantity and suffix of the unit as from `unit_of`."""
    for match in reversed(list(re.finditer(_BRACKETS, name))):
        if (unit := unit_of(match[1])) is not None:
            return f"{name[: match.start()]} {name[match.end() :]}".strip(), unit
    ending = re.search(_ENDING, name.strip())
    if ending is not None:
        word = ending[1].lower()
        unit = _ENDING_UNIT.get(word) or unit_of(word.replace("per", "/").replace("_", "").replace(" ", ""))
        if unit is not None:
            return name.strip()[: ending.start()], unit
    return name, None


def _plain(text: str) -> str:
    text = text.strip().strip("[](){}").strip().lower()
    for old, new in (("µ", "u"), ("μ", "u"), ("²", "2"), ("⁻", "-"), ("¹", "1"), ("**", ""), ("\\", "")):
        text = text.replace(old, new)
    text = re.sub(r"[\s^*·()]", "", text)
    return text if text in _UNIT else re.sub(r"(?<=[a-z°])\.(?=[a-z])", "", text)
