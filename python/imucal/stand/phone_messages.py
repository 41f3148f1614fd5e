"""Decoder for the messages of a phone, which resamples accelerometer and gyroscope to one clock."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from imucal.io.streams import SAME_RATE, Stream, median_rate_hz, onto_clock

__all__ = ["PhoneDecoder"]

# Names under which Sensor Logger sends the specific force (acceleration with gravity) and the angular rate.
# If a sensor is sent under both names, only the samples under the name that arrives first are used.
ACCEL: Final = ("totalacceleration", "accelerometeruncalibrated")
GYRO: Final = ("gyroscope", "gyroscopeuncalibrated")
# Number of samples of each sensor from which the sampling rates are determined.
FIRST: Final = 50
# Number of samples before the last row that are kept for each sensor. The sampling rate and the interpolation
# of the next rows are computed from these samples.
KEPT: Final = 100
COLUMNS: Final = (
    "time_us",
    *(f"accel_{axis}_mps2" for axis in "xyz"),
    *(f"gyro_{axis}_radps" for axis in "xyz"),
)


class PhoneDecoder:
    """Decodes messages, one per line, to rows of both sensors.

    The samples of the faster sensor are resampled to the times of the slower sensor; at equal rates, to the
    times of the gyroscope. Separate files of accelerometer and gyroscope are joined by the same rule.
    """

    columns = COLUMNS
    wraps_at: tuple[float | None, ...] = (None,) * len(COLUMNS)
    # Rows need no further check for damage, because the network protocol has a checksum.
    is_checked = True

    def __init__(self) -> None:
        self.damaged = 0
        self.remark = ""
        self._left = b""
        self._names: dict[str, str] = {}
        self._samples: dict[str, list[tuple[int, float, float, float]]] = {"accel": [], "gyro": []}
        # Time of the last row, ns.
        self._done_ns = -1

    def feed(self, data: bytes) -> list[tuple[float, ...]]:
        """Append received bytes. Returns the rows that are now complete."""
        *lines, self._left = (self._left + data).split(b"\n")
        for line in lines:
            if line.strip():
                self._message(line)
        return self._rows()

    def counts(self) -> dict[str, int]:
        """Number of messages that could not be read."""
        return {"messages_damaged": self.damaged}

    def _message(self, line: bytes) -> None:
        try:
            payload = json.loads(line)["payload"]
            samples = [item for item in payload if isinstance(item, Mapping)]
        except (ValueError, KeyError, TypeError):
            self.damaged += 1
            self.remark = "not a message of Sensor Logger, a JSON object with a payload"
            return
        for item in samples:
            self._sample(str(item.get("name", "")).lower(), item)
        self._describe({str(item.get("name", "")).lower() for item in samples})

    def _sample(self, name: str, item: Mapping[str, Any]) -> None:
        for sensor, names in (("accel", ACCEL), ("gyro", GYRO)):
            if name in names and self._names.setdefault(sensor, name) == name:
                values = item.get("values")
                values = values if isinstance(values, Mapping) else item
                try:
                    sample = (int(item["time"]), float(values["x"]), float(values["y"]), float(values["z"]))
                except (KeyError, TypeError, ValueError):
                    self.damaged += 1
                    return
                known = self._samples[sensor]
                # If a message arrives twice or late, its samples are not later than the known samples and are
                # ignored.
                if all(map(math.isfinite, sample)) and (not known or sample[0] > known[-1][0]):
                    known.append(sample)

    def _describe(self, names: set[str]) -> None:
        """Set `remark`, the sentence for the user on a missing sensor; empty if none is missing."""
        if all(self._samples.values()):
            self.remark = ""
        elif not self._samples["accel"] and "accelerometer" in names:
            self.remark = (
                "the accelerometer arrives without gravity: switch on Total Acceleration (Android) or "
                "Accelerometer Uncalibrated (iOS, with Standardise Units & Frames)"
            )
        else:
            missing = " and ".join(
                name
                for sensor, name in (("accel", "acceleration with gravity"), ("gyro", "gyroscope"))
                if not self._samples[sensor]
            )
            self.remark = f"the phone sends no {missing}: switch it on"

    def _rows(self) -> list[tuple[float, ...]]:
        """Rows up to the latest time at which samples of both sensors are available."""
        if any(len(samples) < FIRST for samples in self._samples.values()):
            return []
        accel, gyro = (self._stream(sensor) for sensor in ("accel", "gyro"))
        accel_hz, gyro_hz = median_rate_hz(accel.time_ns), median_rate_hz(gyro.time_ns)
        is_gyro_clock = gyro_hz <= SAME_RATE * accel_hz
        clock, other = (gyro, accel) if is_gyro_clock else (accel, gyro)
        is_averaged = max(accel_hz / gyro_hz, gyro_hz / accel_hz) > SAME_RATE
        kept, moved = onto_clock(clock, other, is_averaged)
        accel, gyro = (moved, kept) if is_gyro_clock else (kept, moved)
        new = kept.time_ns > self._done_ns
        if new.any():
            self._done_ns = int(kept.time_ns[new][-1])
        for sensor, samples in self._samples.items():
            past = sum(1 for sample in samples if sample[0] <= self._done_ns)
            self._samples[sensor] = samples[max(past - KEPT, 0) :]
        rows = np.column_stack([np.round(kept.time_ns / 1e3), accel.values, gyro.values])[new]
        return [tuple(row) for row in rows.tolist()]

    def _stream(self, sensor: str) -> Stream:
        samples = self._samples[sensor]
        time_ns = np.array([sample[0] for sample in samples], dtype=np.int64)
        return Stream(sensor, time_ns, np.array([sample[1:] for sample in samples], dtype=np.float64))
