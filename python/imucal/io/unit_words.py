"""Spellings of units in headers of text files, and the corresponding suffixes of canonical names.

The sizes of the units are in `imucal.units.COLUMN_UNITS`. A name may state a unit that is not supported, such
as inch/s². This unit then does not count as missing. `split_unread` returns its text, and the file is read
only if the user states the units of its columns.
"""

from __future__ import annotations

import re
from typing import Final

from imucal.io.column_words import is_of_other, is_remark, words_of

__all__ = ["split_unit", "split_unread", "unit_of"]


def _spelled(quantities: str, forms: str) -> str:
    """Each quantity in each form: "deg/s degps" from "deg" and "{}/s {}ps"."""
    return " ".join(form.format(quantity) for quantity in quantities.split() for form in forms.split())


_PER_S2: Final = (
    "{}/s2 {}/s/s {}s-2 {}ps2 {}pers2 {}/sec2 {}/sec/sec {}persec2 {}/second2 {}persecond2 {}/secondsquared "
    "{}persecondsquared"
)
_PER_S: Final = "{}/s {}/sec {}/second {}s-1 {}ps {}pers {}persec {}persecond"
_PER_MIN: Final = "{}/min {}/minute {}min-1 {}permin {}perminute"
_PER_H: Final = "{}/h {}/hr {}/hour {}h-1 {}ph {}perh {}perhr {}perhour"
_DEGREE: Final = "deg ° º degree degrees"

# Spellings of each unit after normalisation by `_plain`. The key is the quantity and the suffix of canonical
# names. The unit "lsb" is valid for both sensors. Words with several meanings are left out: "grad/s" is gon/s
# in English and deg/s in German, "rps" is rad/s or rev/s, and "dpm" is deg/min or 0.1 m.
_SPELLINGS: Final[dict[tuple[str, str], str]] = {
    ("time", "s"): "s sec secs second seconds",
    ("time", "ms"): "ms msec msecs millis millisecond milliseconds",
    ("time", "us"): "us usec usecs micros microsecond microseconds",
    ("time", "ns"): "ns nsec nsecs nanos nanosecond nanoseconds",
    ("accel", "mps2"): _spelled("m meter meters metre metres", _PER_S2) + " n/kg",
    ("accel", "cmps2"): _spelled("cm centimeter centimeters centimetre centimetres", _PER_S2) + " gal gals",
    ("accel", "mmps2"): _spelled("mm millimeter millimeters millimetre millimetres", _PER_S2),
    ("accel", "ftps2"): _spelled("ft foot feet", _PER_S2),
    ("accel", "g"): "g gs g's gee gees gforce",
    ("accel", "mg"): "mg mgs milli-g millig",
    ("accel", "ug"): "ug ugs micro-g microg",
    ("gyro", "radps"): _spelled("rad radian radians", _PER_S) + " rads",
    ("gyro", "mradps"): _spelled("mrad millirad milliradian milliradians", _PER_S),
    ("gyro", "dps"): _spelled(_DEGREE, _PER_S) + " dps d/s degs",
    ("gyro", "mdps"): _spelled("mdeg m° mº millidegree millidegrees", _PER_S) + " mdps",
    ("gyro", "dpmin"): _spelled(_DEGREE, _PER_MIN) + " dpmin",
    ("gyro", "dph"): _spelled(_DEGREE, _PER_H) + " dph",
    ("gyro", "rpm"): _spelled("rev r rot revolution revolutions rotations", _PER_MIN) + " rpm",
    ("gyro", "gonps"): _spelled("gon gons gradian gradians", _PER_S),
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
# Characters of units that have several forms, and the form that replaces them.
_CHARACTERS: Final = str.maketrans(
    {"µ": "u", "μ": "u", "²": "2", "⁻": "-", "¹": "1", "˚": "°", "∘": "°", "\\": None}
)
# Matches a text in brackets anywhere in a name.
_BRACKETS: Final = r"[\[({]([^\[\](){}]*(?:\([^()]*\)[^\[\](){}]*)*)[\])}]"
# Matches a unit in the last words of a name, such as time_us, gyro_x_rad_per_s, "Gyr X deg/s". In a name
# without a separator, such as AccXm/s2, the unit must follow the letter of an axis. Otherwise the end of
# km/s2 would match as m/s2.
_ENDING: Final = (
    r"(?i)(?:[_ .]|(?<=[xyz])|(?<![a-z\d]))("
    r"m?(?:rad|deg)[_ ]?per[_ ]?(?:s|sec|second)|deg[_ ]?per[_ ]?(?:h|hr|hour|min|minute)|"
    r"m?rad/s(?:ec)?|m?radps|m?rad_s|m?deg_s|m?(?:deg|°|º)/s(?:ec)?|"
    r"m?dps|(?:deg|°|º)/(?:h|hr|hour|min)|deg_h|deg_min|dph|dpmin|rpm|gon/s|gon_s|gonps|"
    r"(?:[cm]?m|ft)/s[²2^]+|(?:[cm]?m|ft)/s/s|(?:[cm]?m|ft)ps2|(?:[cm]?m|ft)_s2|(?<=[_ .xyz])(?:mps|mss)|"
    r"(?<=[_ .])(?:mg|ug|µg|g|gal|lsb|raw|counts?|ms|us|µs|ns|s|"
    r"sec|secs|seconds|millis|micros|nanos|milliseconds|microseconds|nanoseconds))$"
)
_ENDING_UNIT: Final = {"mps": ("accel", "mps2"), "mss": ("accel", "mps2")}
# Matches a number before a unit at the end of a name, as in "Gyr x 0.1 dps". A single digit does not match,
# because it is the number of a sensor.
_MULTIPLE: Final = r"(?<![A-Za-z\d.])(?:\d*\.\d+|[1-9]\d+)[_ ]?$"
# Matches the last words of a name that state a quantity per time, such as "inch/s²", or a unit with several
# meanings.
_UNREAD_ENDING: Final = (
    r"(?i)[_ .]((?:[\d.]+[_ ]?)?[^\s\d_./\[\](){}]+/(?:s|ms|sec|seconds?|h|hr|hours?|min|minutes?)"
    r"(?:\^?2|²|/s|/sec)?|[^\s_/\[\](){}]*[²⁻][^\s_/\[\](){}]*|rps|dpm|mgal|ugal)$"
)


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
        word, before = ending[1].lower(), name.strip()[: ending.start()]
        unit = _ENDING_UNIT.get(word) or unit_of(
            re.sub(r"([_ ]?per[_ ]?|_)(?=(s2?|sec|second|h|hr|hour|min|minute)$)", "/", word)
        )
        if unit is not None and re.search(_MULTIPLE, before) is None:
            return before, unit
    before, _, last = name.strip().rpartition(" ")
    if before and "⁻" in last and (unit := unit_of(last)) is not None:
        return before, unit
    return name, None


def split_unread(name: str) -> tuple[str, str]:
    """Split an unsupported unit from a column name. Returns name and unit: ("Acc x", "inch/s²").

    The unit is "" if the name has no text in the place of a unit. Remarks such as (with gravity), [x8004] and
    (z-axis) are no units. The function is only for names in which `split_unit` finds no unit.
    """
    for match in reversed(list(re.finditer(_BRACKETS, name))):
        text = match[1].strip()
        if text and not is_of_other(words_of(text)) and not is_remark(text):
            return f"{name[: match.start()]} {name[match.end() :]}".strip(), text
    plain = name.strip()
    for ending in (re.search(_UNREAD_ENDING, plain), re.search(_ENDING, plain)):
        if ending is None:
            continue
        number = re.search(_MULTIPLE, plain[: ending.start()])
        if number is not None or ending.re.pattern == _UNREAD_ENDING:
            start = ending.start() if number is None else number.start()
            return plain[:start].strip(), plain[start:].strip("_ .")
    return name, ""


def _plain(text: str) -> str:
    text = text.strip().strip("[](){}").strip().lower()
    text = text.translate(_CHARACTERS)
    text = re.sub(r"[\s^*·()]", "", text)
    return text if text in _UNIT else re.sub(r"(?<=[a-z°])\.(?=[a-z])", "", text)
