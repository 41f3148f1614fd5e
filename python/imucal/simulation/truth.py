"""The truth of a simulated run: the motion of the unit, its errors, and the setup of the run."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from imucal.arrays import FloatArray
from imucal.calibration.calibration import Calibration
from imucal.calibration.triad import Triad
from imucal.document.json_document import read_json
from imucal.recording.recording import Recording
from imucal.simulation.setup import Setup

__all__ = ["Truth"]

SCHEMA: Final = "imucal.truth/1"


@dataclass(frozen=True, eq=False)
class Truth:
    """The true motion, one row per sample of the recording, and the true calibration of the unit.

    calibration           triads and effects of the unit, without uncertainty
    setup                 the complete setup of the run
    time_s                (N,)    the time stamps of the recording
    specific_force        (N, 3)  in the body frame, m/s^2
    angular_rate          (N, 3)  in the body frame, rad/s
    angular_acceleration  (N, 3)  in the body frame, rad/s^2
    rotation_wxyz         (N, 4)  attitude, maps a vector from body to world
    temperature_degc      (N,)    degC
    rests                 start and end of each rest, s
    has_temperature       whether the recording has a temperature
    """

    calibration: Calibration
    setup: Setup
    time_s: FloatArray
    specific_force: FloatArray
    angular_rate: FloatArray
    angular_acceleration: FloatArray
    rotation_wxyz: FloatArray
    temperature_degc: FloatArray
    rests: tuple[tuple[float, float], ...]
    has_temperature: bool

    def to_dict(self) -> dict[str, Any]:
        """The document of `imucal simulate --truth`: the unit's parameters, the rests, and the setup."""
        unit = self.calibration.to_dict()
        fields = ("raw_units", "gravity_mps2", "accelerometer", "gyroscope", "effects", "parameters")
        return {
            "schema": SCHEMA,
            **{name: unit[name] for name in fields},
            "rests": [{"start_s": start, "end_s": end} for start, end in self.rests],
            "has_temperature": self.has_temperature,
            "setup": self.setup.to_dict(),
        }

    def samples(self) -> Recording:
        """True force, rate and temperature as a recording, with angular acceleration and attitude."""
        acceleration = zip("xyz", self.angular_acceleration.T, strict=True)
        rotation = zip("wxyz", self.rotation_wxyz.T, strict=True)
        return Recording(
            self.time_s,
            self.specific_force,
            self.angular_rate,
            temperature_degc=self.temperature_degc,
            auxiliary={
                **{f"angular_acceleration_{axis}_radps2": column for axis, column in acceleration},
                **{f"rotation_{part}": column for part, column in rotation},
            },
            name="truth",
        )

    def write_samples(self, path: str | os.PathLike[str]) -> None:
        """Write the truth of every sample as CSV or Parquet; `imucal.read` reads it."""
        from imucal.io import write

        write(self.samples(), path)


def is_truth(path: str | os.PathLike[str]) -> bool:
    """Whether the file at this path is a truth file."""
    if not Path(path).is_file():
        return False
    document = read_json(path).value
    return isinstance(document, dict) and document.get("schema") == SCHEMA


def truth_of(setup: Setup, core: Any, recording: Recording) -> Truth:
    """The truth of a run, from the result of the compiled library."""
    unit = setup.unit
    calibration = Calibration(
        Triad(unit.accelerometer.sensitivity, unit.accelerometer.bias),
        Triad(unit.gyroscope.sensitivity, unit.gyroscope.bias),
        gravity_mps2=setup.gravity_mps2,
        effects=(*setup.all_effects, *(values for _, values in setup.user_effects)),
        user_effects=tuple(effect for effect, _ in setup.user_effects),
    )
    return Truth(
        calibration,
        setup,
        core.time_s,
        core.true_specific_force,
        core.true_angular_rate,
        core.true_angular_acceleration,
        core.rotation_wxyz,
        core.temperature_degc,
        tuple((float(start), float(end)) for start, end in core.rests),
        recording.temperature_degc is not None,
    )
