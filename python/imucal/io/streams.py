"""Resampling of accelerometer and gyroscope to one clock if they have different time stamps.

1. If both sensors have the same time stamps, nothing is changed.
2. Otherwise the slower sensor provides the clock. At equal rates the gyroscope provides the clock, because
   its samples are integrated and interpolation would distort the integral.
3. At equal rates the other sensor is interpolated linearly. A faster sensor is averaged over one interval of
   the clock, centred at the time stamp. Averaging preserves the integrated angle of a gyroscope.
4. No sample is extrapolated. Samples of the clock are dropped if they lie before the first or after the last
   sample of the other sensor, or inside a gap of the other sensor.

The resampling is reported as a finding of the recording.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from imucal.arrays import FloatArray
from imucal.document.source import Source
from imucal.errors import FormatError
from imucal.finding import Finding
from imucal.recording.recording import AccelUnit, GyroUnit, Recording

__all__ = ["SAME_RATE", "Stream", "median_rate_hz", "onto_clock", "recording_from_streams"]

# Two sampling rates count as equal if their ratio is at most this number. The oscillators of MEMS sensors
# differ by about 1 %.
SAME_RATE = 1.02
# Largest accepted ratio of the sampling rates. At a larger ratio, too few samples of the slower sensor cover
# a rotation.
LARGEST_RATIO = 10.0
# A time step counts as a gap if it exceeds this number of median time steps. One lost sample (2 median time
# steps) is interpolated; longer gaps are not.
GAP_STEPS = 2.5


class Stream(NamedTuple):
    """The samples of one sensor, as stored in the file.

    name              name in the file
    time_ns           (N,) integers, ns
    values            (N, 3) m/s^2 or rad/s, or counts
    temperature_degc  (N,) degC, or None
    """

    name: str
    time_ns: NDArray[np.int64]
    values: FloatArray
    temperature_degc: FloatArray | None = None


def median_rate_hz(time_ns: NDArray[np.int64]) -> float:
    """The rate that corresponds to the median step of the time stamps, Hz; NaN if it is not positive."""
    step_ns = float(np.median(np.diff(time_ns))) if len(time_ns) > 1 else 0.0
    return 1e9 / step_ns if step_ns > 0 else float("nan")


def recording_from_streams(
    file: str,
    accel: Stream,
    gyro: Stream,
    sources: Sequence[Source],
    findings: Sequence[Finding] = (),
    *,
    accel_unit: AccelUnit = "m/s^2",
    gyro_unit: GyroUnit = "rad/s",
) -> Recording:
    """One recording of both sensors. Time is counted from the first sample of the recording.

    Raises FormatError if a sensor has no samples, if the sampling rates differ too much, or if the two
    sensors never measured at the same time. If resampling is needed, also raises FormatError for decreasing
    time stamps and values that are not finite.
    """
    for stream in (accel, gyro):
        if not len(stream.time_ns):
            raise FormatError(f"{file}: {stream.name} contains no samples: record it, or choose another")
    if np.array_equal(accel.time_ns, gyro.time_ns):
        return _recording(file, accel, gyro, sources, findings, accel_unit, gyro_unit)
    accel, gyro = _resampleable(file, accel), _resampleable(file, gyro)
    accel_hz, gyro_hz = median_rate_hz(accel.time_ns), median_rate_hz(gyro.time_ns)
    if gyro_hz > SAME_RATE * accel_hz:
        clock, other, ratio = accel, gyro, gyro_hz / accel_hz
    else:
        clock, other, ratio = gyro, accel, accel_hz / gyro_hz
    if ratio > LARGEST_RATIO:
        raise FormatError(
            f"{file}: {clock.name} has {median_rate_hz(clock.time_ns):.6g} Hz, {other.name} "
            f"{median_rate_hz(other.time_ns):.6g} Hz, a ratio of more than {LARGEST_RATIO:g}, which is too "
            "large for resampling to one clock: record both at similar rates"
        )
    is_averaged = ratio > SAME_RATE
    kept, moved = onto_clock(clock, other, is_averaged)
    left_out = len(clock.time_ns) - len(kept.time_ns)
    if len(kept.time_ns) < 2:
        raise FormatError(
            f"{file}: {accel.name} and {gyro.name} were recorded at different times (only "
            f"{len(kept.time_ns)} common samples): check their time stamps, or record both together"
        )
    noise_left = _noise_left(kept, other, is_averaged)
    finding = Finding(
        code="resampled",
        severity="warning",
        recording=file,
        columns=("accel" if other is accel else "gyro",),
        place=None,
        count=left_out,
        value=ratio,
        unit="1",
        message=(
            f"{other.name} ({median_rate_hz(other.time_ns):.6g} Hz) was "
            + ("averaged over the intervals" if is_averaged else "interpolated to the time stamps")
            + f" of {clock.name} ({median_rate_hz(clock.time_ns):.6g} Hz), and its white noise per sample is "
            f"{noise_left:.2g} of the original"
            + (
                f"; {left_out} of {len(clock.time_ns)} samples of {clock.name} were dropped, because "
                f"{other.name} has no samples at their times"
                if left_out
                else ""
            )
        ),
        way_out="to measure the noise of the sensor itself, record both sensors at the same instants",
    )
    both = (moved, kept) if clock is gyro else (kept, moved)
    return _recording(file, *both, sources, [*findings, finding], accel_unit, gyro_unit)


def _recording(
    file: str,
    accel: Stream,
    gyro: Stream,
    sources: Sequence[Source],
    findings: Sequence[Finding],
    accel_unit: AccelUnit,
    gyro_unit: GyroUnit,
) -> Recording:
    temperatures = (stream.temperature_degc for stream in (accel, gyro))
    known = (each for each in temperatures if each is not None and np.isfinite(each).any())
    return Recording(
        (gyro.time_ns - gyro.time_ns[0]) / 1e9,
        accel.values,
        gyro.values,
        temperature_degc=next(known, None),
        accel_unit=accel_unit,
        gyro_unit=gyro_unit,
        name=file,
        sources=sources,
        findings=findings,
    )


def _resampleable(file: str, stream: Stream) -> Stream:
    """The stream without repeated samples. Raises FormatError if it cannot be resampled."""
    is_new = np.diff(stream.time_ns, prepend=stream.time_ns[0] - 1) != 0
    # A repeated time stamp with the same values is a copy and is removed. A repeated time stamp with
    # different values is an error, which is detected below.
    is_new[1:] |= (stream.values[1:] != stream.values[:-1]).any(axis=1)
    once = _part(stream, is_new)
    steps_ns = np.diff(once.time_ns)
    bad = np.flatnonzero(steps_ns <= 0)
    if len(bad):
        row = int(bad[0])
        repeated = np.count_nonzero(steps_ns == 0)
        if 2 * repeated > len(bad):
            raise FormatError(
                f"{file}: {repeated} time stamps of {stream.name} are those of the sample before, so the "
                "sensors cannot be resampled to one clock: write time stamps of finer resolution"
            )
        raise FormatError(
            f"{file}: the time stamps of {stream.name} do not increase at {len(bad)} samples, first after "
            f"{(once.time_ns[row] - once.time_ns[0]) / 1e9:.6f} s, so the sensors cannot be resampled to one "
            "clock: record again, or cut the part out"
        )
    bad = np.flatnonzero(~np.isfinite(once.values).all(axis=1))
    if len(bad):
        raise FormatError(
            f"{file}: {stream.name} has {len(bad)} samples that are not finite numbers, first at "
            f"{(once.time_ns[bad[0]] - once.time_ns[0]) / 1e9:.6f} s, so the sensors cannot be resampled to "
            "one clock: record again, or cut the part out"
        )
    if len(once.time_ns) < 2:
        raise FormatError(f"{file}: {stream.name} contains a single sample: record it, or choose another")
    return once


def _part(stream: Stream, which: Any) -> Stream:
    temperature = stream.temperature_degc
    return Stream(
        stream.name,
        stream.time_ns[which],
        stream.values[which],
        None if temperature is None else temperature[which],
    )


def onto_clock(clock: Stream, other: Stream, is_averaged: bool) -> tuple[Stream, Stream]:
    """The samples of `clock` while `other` has samples, and `other` resampled to the times of `clock`.

    is_averaged   whether `other` is averaged over the intervals of `clock`; otherwise it is interpolated
    """
    start_ns = min(clock.time_ns[0], other.time_ns[0])
    at_s, other_s = (clock.time_ns - start_ns) / 1e9, (other.time_ns - start_ns) / 1e9
    half_s = 0.5 / median_rate_hz(clock.time_ns) if is_averaged else 0.0
    first = np.searchsorted(other_s, at_s - half_s, side="right") - 1
    last = np.searchsorted(other_s, at_s + half_s, side="left")
    is_inside = (first >= 0) & (last < len(other_s))
    first, last = first.clip(0, len(other_s) - 1), last.clip(0, len(other_s) - 1)
    steps_s = np.diff(other_s)
    gaps = np.concatenate([[0], np.cumsum(steps_s > GAP_STEPS * np.median(steps_s))])
    kept = _part(clock, is_inside & (gaps[first] == gaps[last]))
    at_s = (kept.time_ns - start_ns) / 1e9
    if is_averaged:
        values = np.stack([_mean(at_s, half_s, other_s, axis) for axis in other.values.T], axis=1)
    else:
        values = np.stack([np.interp(at_s, other_s, axis) for axis in other.values.T], axis=1)
    temperature = other.temperature_degc
    return kept, Stream(
        other.name,
        kept.time_ns,
        values,
        None if temperature is None else np.interp(at_s, other_s, temperature),
    )


def _mean(at_s: FloatArray, half_s: float, time_s: FloatArray, values: FloatArray) -> FloatArray:
    """The mean of the linear interpolation of `values` (at the times time_s) over at_s +- half_s."""
    # The mean of the values is subtracted before the integration, so that the integral stays small and the
    # differences of the integral keep their precision.
    level = float(values.mean())
    steps_s, values = np.diff(time_s), values - level
    integral = np.concatenate([[0.0], np.cumsum(steps_s * (values[1:] + values[:-1]) / 2)])

    def integral_to(t_s: FloatArray) -> FloatArray:
        k = np.clip(np.searchsorted(time_s, t_s, side="right") - 1, 0, len(steps_s) - 1)
        since_s = t_s - time_s[k]
        slope = (values[k + 1] - values[k]) / steps_s[k]
        reached: FloatArray = integral[k] + since_s * (values[k] + slope * since_s / 2)
        return reached

    return level + (integral_to(at_s + half_s) - integral_to(at_s - half_s)) / (2 * half_s)


def _noise_left(clock: Stream, other: Stream, is_averaged: bool) -> float:
    """Standard deviation of the white noise of `other` after resampling, divided by its value before."""
    if is_averaged:
        return float(np.sqrt(median_rate_hz(clock.time_ns) / median_rate_hz(other.time_ns)))
    k = np.clip(np.searchsorted(other.time_ns, clock.time_ns, side="right") - 1, 0, len(other.time_ns) - 2)
    share = np.clip((clock.time_ns - other.time_ns[k]) / (other.time_ns[k + 1] - other.time_ns[k]), 0, 1)
    return float(np.sqrt(np.mean(share**2 + (1 - share) ** 2)))
