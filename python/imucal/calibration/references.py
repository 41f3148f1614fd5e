"""The references of a calibration, local gravity and the clock of the time stamps, and their uncertainty.

Every parameter is determined relative to gravity and to the time stamps. The data cannot reveal an error of
gravity or of the clock, because such an error changes all scales of a sensor by the same factor
(docs/model.md (38)).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal, cast, get_args

import numpy as np

import imucal._core as _core
from imucal.arrays import FloatArray
from imucal.errors import FormatError, InputError
from imucal.units import STANDARD_GRAVITY_MPS2

if TYPE_CHECKING:
    from imucal.document.json_document import Node

__all__ = ["References", "references_of"]

Origin = Literal["standard", "given", "latitude", "unknown"]

# Lowest and highest gravity on the surface of the Earth, m/s^2 (Hirt and others, Geophys. Res. Lett. 40,
# 2013, doi 10.1002/grl.50838).
ON_EARTH_MPS2: Final = (9.764, 9.834)
# Accepted heights above the ellipsoid, m, for normal gravity: from the Dead Sea to the highest summits.
HEIGHTS_M: Final = (-500.0, 9000.0)
LATITUDES_DEG: Final = (-90.0, 90.0)
# Accepted difference, m/s^2, between the gravity in a file and the normal gravity at the latitude and height
# in the file. It allows for rounding to seven digits.
GRAVITY_ROUNDING_MPS2: Final = 1e-6


@dataclass(frozen=True, slots=True)
class References:
    """Sources and standard deviations of local gravity and of the clock.

    gravity_from        "standard" (9.80665 m/s^2 was assumed), "given", "latitude" (normal gravity), or
                        "unknown" (a file of another program, which does not state it)
    gravity_sigma_mps2  standard deviation of local gravity, m/s^2; None if the covariance does not include it
    clock_ppm           standard deviation of the rate error of the clock, ppm; None if the covariance does
                        not include it
    latitude_deg, height_m   latitude and height for which normal gravity was computed; None if not given
    """

    gravity_from: Origin = "standard"
    gravity_sigma_mps2: float | None = None
    clock_ppm: float | None = None
    latitude_deg: float | None = None
    height_m: float | None = None

    def notes(self, gravity_mps2: float, *, has_gyroscope: bool = True) -> list[str]:
        """Sentences on the uncertainties that the standard deviations omit, and the options that add them.

        has_gyroscope  whether there is a gyroscope; an accelerometer alone does not depend on the clock
        """
        return [*self._of_gravity(gravity_mps2), *(self._of_clock() if has_gyroscope else [])]

    def covariance_of_base(self, gravity_mps2: float, values: FloatArray) -> FloatArray:
        """Covariance of the 21 biases and sensitivities due to the references (docs/model.md (38)).

        values   (21,) the parameters: accelerometer bias and sensitivity, gyroscope bias and sensitivity; or
                 the first nine for an accelerometer alone
        """
        by_gravity, by_clock = np.zeros(len(values)), np.zeros(len(values))
        by_gravity[3:9] = (self.gravity_sigma_mps2 or 0.0) / gravity_mps2 * values[3:9]
        by_clock[12:21] = 1e-6 * (self.clock_ppm or 0.0) * values[12:21]
        return np.outer(by_gravity, by_gravity) + np.outer(by_clock, by_clock)

    def _of_gravity(self, gravity_mps2: float) -> list[str]:
        if self.gravity_sigma_mps2 is not None:
            return []
        if self.gravity_from == "unknown":
            return [
                "the file of the other program does not state the gravity of its calibration: figures of "
                f"merit are computed with {gravity_mps2:.6g} m/s^2"
            ]
        if self.gravity_from == "given":
            ppm = 1e6 * 1e-3 / gravity_mps2
            return [
                f"local gravity {gravity_mps2:.6g} m/s^2 is taken as exact: an error of 0.001 m/s^2 changes "
                f"all accelerometer scales by {ppm:.0f} ppm; --gravity-sigma includes it in the standard "
                "deviations"
            ]
        least, most = (100.0 * (value / gravity_mps2 - 1.0) for value in ON_EARTH_MPS2)
        return [
            f"standard gravity {gravity_mps2:.6g} m/s^2 is assumed: on the Earth it is {ON_EARTH_MPS2[0]} to "
            f"{ON_EARTH_MPS2[1]} m/s^2, so all accelerometer scales may be wrong by the same {least:.2f} to "
            f"{most:+.2f} %, which is not in the standard deviations; give --latitude and --height, or "
            "--gravity and --gravity-sigma"
        ]

    def _of_clock(self) -> list[str]:
        if self.clock_ppm is not None:
            return []
        return [
            "the clock of the time stamps is taken as exact: a relative error of the clock is an equal error "
            "of all gyroscope scales, about 20 to 100 ppm for a quartz crystal and 1 to 2 % for the "
            "oscillator of a sensor; the standard deviations do not include it; --clock-ppm includes it"
        ]

    @staticmethod
    def of_file(node: Node) -> References:
        """Read the references in a calibration file. Older files and files of other programs may have none.

        Raises FormatError if gravity in the file differs from normal gravity at its latitude and height.
        """
        if "references" not in node.mapping():
            return References("given")
        section = node.get("references")

        def number(name: str, least: float = 0.0, most: float = math.inf) -> float | None:
            item = section.get(name)
            if item.value is None:
                return None
            value = item.number()
            if not least <= value <= most:
                raise FormatError(f"{node.file}: {item.path} is {value:g}, not from {least:g} to {most:g}")
            return value

        origin = section.get("gravity_from").text(get_args(Origin))
        references = References(
            cast(Origin, origin),
            number("gravity_sigma_mps2"),
            number("clock_ppm"),
            number("latitude_deg", *LATITUDES_DEG),
            number("height_m", *HEIGHTS_M),
        )
        if origin == "latitude":
            latitude = section.get("latitude_deg").number()
            gravity = float(_core.gravity_mps2(latitude, references.height_m or 0.0))
            given = node.get("gravity_mps2").number()
            if abs(gravity - given) > GRAVITY_ROUNDING_MPS2:
                raise FormatError(
                    f"{node.file}: $.gravity_mps2 is {given}, but $.references (place) gives "
                    f"{gravity:.7g}: correct the wrong one"
                )
        return references


def references_of(
    gravity_mps2: float | None,
    gravity_sigma_mps2: float | None,
    clock_ppm: float | None,
    latitude_deg: float | None,
    height_m: float | None,
) -> tuple[float, References]:
    """Derive local gravity, m/s^2, and the references from the arguments of `calibrate`.

    Raises InputError for arguments that contradict each other or lie outside their range.
    """
    sigma, clock = _number("gravity_sigma_mps2", gravity_sigma_mps2), _number("clock_ppm", clock_ppm)
    if latitude_deg is None:
        if height_m is not None:
            raise InputError(
                "height_m is given without latitude_deg, but gravity depends more on the latitude: give both"
            )
        if gravity_mps2 is not None:
            return float(gravity_mps2), References("given", sigma, clock)
        return STANDARD_GRAVITY_MPS2, References("standard", sigma, clock)
    if gravity_mps2 is not None:
        raise InputError(
            f"gravity_mps2 is {gravity_mps2} and latitude_deg is {latitude_deg}: give gravity if known, "
            "otherwise the place"
        )
    latitude = _within("latitude_deg", latitude_deg, LATITUDES_DEG)
    height = None if height_m is None else _within("height_m", height_m, HEIGHTS_M)
    if sigma is None:
        sigma = float(_core.normal_gravity_sigma_mps2(height is not None))
    gravity = float(_core.gravity_mps2(latitude, height or 0.0))
    return gravity, References("latitude", sigma, clock, latitude, height)


def _number(name: str, value: Any) -> float | None:
    """The argument `name` as a float, or None. The compiled library checks the range of the number."""
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise InputError(f"{name} is {value!r}: a number is needed")
    return float(value)


def _within(name: str, value: Any, limits: tuple[float, float]) -> float:
    number = _number(name, value)
    if number is None or math.isnan(number) or not limits[0] <= number <= limits[1]:
        raise InputError(f"{name} is {value!r}: from {limits[0]:g} to {limits[1]:g} is needed")
    return number
