"""Residuals of a sensor at rest as a function of temperature, for heating and cooling."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.gap.temperature_history import TemperatureHistory
from imucal.recording.recording import Recording, as_recordings, samples_of_both

if TYPE_CHECKING:
    from imucal.calibration.calibration import Calibration
    from imucal.gap.result import Gap

__all__ = ["TemperatureLoop", "temperature_loops"]

# Duration over which residuals at rest are averaged, s. The loop of a sensor needs at least LEAST_EPOCHS of
# these means. For the accelerometer, each rest needs at least LEAST_EPOCHS means.
EPOCH_S: Final = 10.0
LEAST_EPOCHS: Final = 8
SENSORS: Final = {"gyroscope": "gyro_bias_temperature", "accelerometer": "accel_bias_temperature"}


@dataclass(frozen=True, eq=False)
class TemperatureLoop:
    """Mean residuals of one sensor at rest, in order of time. Plotted over temperature, they may form a loop.

    sensor         "gyroscope" (residuals in rad/s) or "accelerometer" (in m/s^2)
    degc           (K,) temperature
    direction      (K,) 1 heating, -1 cooling, values in between while the temperature reverses
    before, after  (K, 3) mean residual without and with the effects; for the accelerometer, the mean over the
                   whole rest is subtracted
    """

    sensor: str
    degc: FloatArray
    direction: FloatArray
    before: FloatArray
    after: FloatArray


def temperature_loops(gap: Gap, recordings: Recording | Sequence[Recording]) -> tuple[TemperatureLoop, ...]:
    """The residuals of each sensor that has a temperature effect; empty if no sensor has one.

    Residuals of the accelerometer are relative to the mean over their rest, because the true force is not
    known. For the accelerometer, only rests with at least `LEAST_EPOCHS` means are therefore used.
    """
    named = [str(effect["name"]) for effect in gap.effects if effect["parameters"]]
    found = []
    for sensor, prefix in SENSORS.items():
        if not any(name.startswith(prefix) for name in named):
            continue
        before, after = (gap.fits[key].calibration for key in ("before", "after"))
        rows = [
            row
            for recording in as_recordings(recordings)
            if recording.temperature_degc is not None
            for row in _rows(gap, sensor, recording, (before, after))
        ]
        if len(rows) >= LEAST_EPOCHS:
            degc, direction, *residuals = (np.array(column) for column in zip(*rows, strict=True))
            found.append(TemperatureLoop(sensor, degc, direction, *residuals))
    return tuple(found)


def _rows(
    gap: Gap, sensor: str, recording: Recording, calibrations: tuple[Calibration, Calibration]
) -> Iterator[tuple[float, float, FloatArray, FloatArray]]:
    """For each mean over `EPOCH_S`: temperature, direction, and residuals without and with the effects."""
    degc = np.asarray(recording.temperature_degc, dtype=np.float64)
    direction = TemperatureHistory(recording.time_s, degc).direction
    place = 1 if sensor == "gyroscope" else 0
    corrected = [samples_of_both(own.apply_recording(recording))[place] for own in calibrations]
    for rest in gap.fits["after"].rests:
        if rest.recording != recording.name or rest.excluded is not None:
            continue
        duration_s = recording.time_s[rest.end - 1] - recording.time_s[rest.first]
        count = max(1, int(duration_s / EPOCH_S))
        if sensor == "accelerometer" and count < LEAST_EPOCHS:
            continue
        edges = np.linspace(rest.first, rest.end, count + 1).astype(int)
        means = [
            np.array([np.asarray(own[a:b]).mean(axis=0) for a, b in pairwise(edges)]) for own in corrected
        ]
        if sensor == "accelerometer":
            means = [own - own.mean(axis=0) for own in means]
        for k, (a, b) in enumerate(pairwise(edges)):
            yield float(degc[a:b].mean()), float(direction[a:b].mean()), means[0][k], means[1][k]
