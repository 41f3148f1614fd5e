"""The option `hold`: parameters held by a prior, for recordings that do not determine all parameters."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, TypeAlias

import numpy as np

from imucal.errors import InputError

if TYPE_CHECKING:
    from imucal.rig.unit import Unit

__all__ = ["Hold", "HoldTuple", "holds_of", "profile_of"]

# Type of the argument `hold`. It is one text or several texts of the form NAME, NAME=VALUE, NAME+-SIGMA or
# NAME=VALUE+-SIGMA. It may also be a mapping from each name to None, to a value, or to a pair of value and
# standard deviation. Each number of the pair may be None.
Hold: TypeAlias = "str | Sequence[str] | Mapping[str, float | tuple[float | None, float | None] | None]"
# Name, mean and standard deviation of a prior, as the compiled library expects them.
HoldTuple: TypeAlias = "tuple[str, float | None, float | None]"

NUMBER: Final = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
TEXT: Final = rf"\s*(\w+)\s*(?:=\s*({NUMBER}))?\s*(?:(?:\+-|±|\+/-)\s*({NUMBER}))?\s*"
FORM: Final = "give NAME, NAME=VALUE, or NAME=VALUE+-SIGMA, such as accel_misalignment=0+-0.005"


def holds_of(hold: Hold) -> tuple[HoldTuple, ...]:
    """The priors of the held parameters for the compiled library. Raises InputError for an invalid form."""
    if isinstance(hold, str):
        hold = [hold]
    if isinstance(hold, Mapping):
        return tuple(_of_mapping(name, given) for name, given in hold.items())
    found = []
    for text in hold:
        match = re.fullmatch(TEXT, text) if isinstance(text, str) else None
        if match is None:
            raise InputError(f"hold has {text!r}: {FORM}")
        name, value, sigma = match.groups()
        found.append((name, None if value is None else float(value), None if sigma is None else float(sigma)))
    return tuple(found)


def _of_mapping(name: str, given: Any) -> HoldTuple:
    value, sigma = given if isinstance(given, tuple) and len(given) == 2 else (given, None)
    for number in (value, sigma):
        if number is not None and (
            isinstance(number, bool) or not isinstance(number, (int, float, np.number))
        ):
            raise InputError(
                f"hold of {name!r} is {given!r}: give None, a value, or a pair of value and standard "
                "deviation"
            )
    return name, None if value is None else float(value), None if sigma is None else float(sigma)


def profile_of(unit: Unit | str | os.PathLike[str] | None) -> tuple[tuple[str, list[float]], ...]:
    """Standard deviation between units of each group of parameters, from the profile of `unit`.

    The result is for the symmetric frame. The profile states the standard deviation of the off-diagonal
    entries of the sensitivity in the frame of the sensor's package (its housing). In the symmetric frame, an
    off-diagonal entry of the accelerometer is the mean of the entries (i, j) and (j, i) in the frame of the
    package. Half of the difference of these two entries is added to the entry of the gyroscope.
    """
    if unit is None:
        return ()
    from imucal.rig.unit import unit_of

    spread = unit_of(unit).spread
    found = {name: np.atleast_1d(spread[name]).tolist() for name in spread if "misalignment" not in name}
    accel, gyro = (float(np.max(spread.get(f"{sensor}_misalignment", 0.0))) for sensor in ("accel", "gyro"))
    if accel:
        found["accel_misalignment"] = [accel / math.sqrt(2.0)]
    if gyro:
        found["gyro_misalignment"] = [math.hypot(gyro, accel / math.sqrt(2.0))]
    return tuple(found.items())
