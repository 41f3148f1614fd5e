"""The result of `imucal.soak`: how the mean readings of a unit at rest depend on its temperature."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from imucal.arrays import FloatArray
from imucal.calibration.triad import Parameter
from imucal.document.plain import without_nan

__all__ = ["Soak", "SoakTerm", "SoakedSensor"]


@dataclass(frozen=True, eq=False)
class SoakTerm:
    """A term of the dependence on temperature.

    name        name of the effect, such as "gyro_bias_temperature_lag"
    formula     formula, where T0 is the reference temperature and s the direction of the temperature change
    parameters  values by name, such as x, y_square, and tau for a time constant
    std         standard deviation of each parameter, from the scatter of the readings about the model
    units       unit of each parameter
    """

    name: str
    formula: str
    parameters: dict[str, float]
    std: dict[str, float]
    units: dict[str, str]

    def to_dict(self) -> dict[str, Any]:
        """An item of `terms` of the JSON document."""
        return {
            "name": self.name,
            "formula": self.formula,
            "parameters": [
                {"name": name, "value": value, "std": self.std[name], "unit": self.units[name]}
                for name, value in self.parameters.items()
            ],
        }


@dataclass(frozen=True, eq=False)
class SoakedSensor:
    """How the mean reading of one sensor depends on temperature.

    sensor         "gyroscope" or "accelerometer"
    unit           "rad/s" or "m/s^2"
    terms          terms of the model, empty if the reading does not depend on temperature
    constant       (3,), the reading at the reference temperature
    mean           (N, 3), the mean reading in each of N epochs (consecutive parts of the recording)
    fitted         (N, 3), the reading that the model gives for each epoch
    cubic          (N, 3), the reading in each epoch according to a cubic polynomial in the temperature, which
                   is fitted for comparison
    held_out       (3,), rms residual of held-out epochs
    held_out_cubic (3,), rms residual of held-out epochs for the cubic polynomial
    """

    sensor: str
    unit: str
    terms: tuple[SoakTerm, ...]
    constant: FloatArray
    mean: FloatArray
    fitted: FloatArray
    cubic: FloatArray
    held_out: FloatArray
    held_out_cubic: FloatArray

    @property
    def described(self) -> str:
        """The names of the effects, such as "gyro_bias_temperature_lag with 2 time constants"."""
        counts = Counter(term.name for term in self.terms)
        return ", ".join(
            name if count == 1 else f"{name} with {count} time constants" for name, count in counts.items()
        )

    @property
    def parameters(self) -> Iterator[Parameter]:
        """The parameters of all terms. The names of the parameters of a second lag end in " (2)"."""
        names: Counter[str] = Counter()
        for term in self.terms:
            names[term.name] += 1
            number = f" ({names[term.name]})" if names[term.name] > 1 else ""
            for name, value in term.parameters.items():
                yield Parameter(f"{term.name}_{name}{number}", value, term.std[name], term.units[name])

    @property
    def left(self) -> FloatArray:
        """Rms residual of held-out epochs, divided by that of a cubic polynomial in temperature, (3,)."""
        left: FloatArray = self.held_out / self.held_out_cubic
        return left

    def to_dict(self) -> dict[str, Any]:
        """The fields of the JSON document."""
        return {
            "sensor": self.sensor,
            "unit": self.unit,
            "terms": [term.to_dict() for term in self.terms],
            "constant": self.constant.tolist(),
            "held_out_rms": self.held_out.tolist(),
            "held_out_rms_of_a_cubic": self.held_out_cubic.tolist(),
            "left_of_a_cubic": self.left.tolist(),
        }


@dataclass(frozen=True, eq=False)
class Soak:
    """The result of `imucal.soak`.

    time_s, temperature_degc  (N,), mean time and temperature of the epochs, see `SoakedSensor`
    """

    name: str
    time_s: FloatArray
    temperature_degc: FloatArray
    gyroscope: SoakedSensor
    accelerometer: SoakedSensor

    @property
    def sensors(self) -> tuple[SoakedSensor, SoakedSensor]:
        """Both sensors."""
        return self.gyroscope, self.accelerometer

    def to_dict(self) -> dict[str, Any]:
        """The JSON document."""
        low, high = float(self.temperature_degc.min()), float(self.temperature_degc.max())
        found: dict[str, Any] = without_nan(
            {
                "recording": self.name,
                "epochs": len(self.time_s),
                "temperature_range_degc": [low, high],
                "sensors": [sensor.to_dict() for sensor in self.sensors],
            }
        )
        return found
