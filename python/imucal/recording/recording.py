"""A recording: the measurements of one unit, with one sample per row.

1. Time is in seconds. Each sensor is either in SI units (m/s^2, rad/s) or in raw counts ("lsb").
2. An accelerometer at rest reads +g on the axis that points up.
3. Values are kept as recorded. `imucal.inspect`, not this type, detects NaN, gaps and saturation.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from imucal.arrays import FloatArray, SampleArray, as_rows, as_samples
from imucal.data_frame import is_frame, recording_of, table_of
from imucal.document.name import shown
from imucal.document.source import Source
from imucal.errors import ImucalError, InputError
from imucal.finding import Finding, Place
from imucal.notebook import html_of
from imucal.recording.axes import UNCHANGED, Axes

__all__ = [
    "AccelUnit",
    "GyroUnit",
    "Recording",
    "Sensor",
    "as_recording",
    "as_recordings",
    "require_sensors",
    "samples_of_both",
]

Sensor: TypeAlias = Literal["accelerometer", "gyroscope"]
AccelUnit: TypeAlias = Literal["m/s^2", "lsb"]
GyroUnit: TypeAlias = Literal["rad/s", "lsb"]
# A time step of at least this duration, s, counts as a pause between two runs. No sensor that can be
# calibrated has such a long sampling interval.
PAUSE_S: Final = 1.0


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Recording:
    """The measurements of one unit; every column is a read-only, C-contiguous array.

    time_s            (N,)    s
    specific_force    (N, 3)  in `accel_unit`, along the accelerometer's axes; None without an accelerometer
    angular_rate      (N, 3)  in `gyro_unit`, along the gyroscope's axes; None without a gyroscope
    temperature_degc  (N,)    degC, or None
    stand_rad         (N, 3)  angles of the stand's motors from their encoders, rad, or None
    auxiliary         name -> (N,)  other columns of the file. Characters of a name that cannot be printed are
                      replaced by escape sequences
    findings          repairs to the data and remarks that were reported when the file was read
    axes              axis remapping from the columns of the source, in the form of `with_axes`
    column_units      units of the accelerometer and gyroscope columns in the source, such as "g" and "dps",
                      for messages; None if unknown

    All arrays are float64, except that force and rate may also be float32 or int16. A C-contiguous array of
    such a type is not copied; anything else (lists, other integers, Fortran order, strides) is converted
    once. Masked values become NaN. Do not change an array that was not copied while a calculation uses it.

    A recording has at least one of the two sensors. A recording of one sensor alone can be corrected and
    analysed for noise; an accelerometer alone can also be calibrated and evaluated. Functions that need both
    sensors raise InputError with the code `sensor_missing` (docs/one-sensor.md).

    Raises InputError if there is no sensor, or if a column has the wrong shape, another length than `time_s`,
    or values that are not real numbers.
    """

    time_s: FloatArray
    specific_force: SampleArray | None
    angular_rate: SampleArray | None
    temperature_degc: FloatArray | None
    stand_rad: FloatArray | None
    auxiliary: Mapping[str, FloatArray]
    accel_unit: AccelUnit
    gyro_unit: GyroUnit
    name: str
    sources: tuple[Source, ...]
    findings: tuple[Finding, ...]
    axes: str
    column_units: tuple[str | None, str | None]

    def __init__(
        self,
        time_s: ArrayLike,
        specific_force: ArrayLike | None = None,
        angular_rate: ArrayLike | None = None,
        *,
        temperature_degc: ArrayLike | None = None,
        stand_rad: ArrayLike | None = None,
        auxiliary: Mapping[str, ArrayLike] | None = None,
        accel_unit: AccelUnit = "m/s^2",
        gyro_unit: GyroUnit = "rad/s",
        name: str = "recording",
        sources: Sequence[Source] = (),
        findings: Sequence[Finding] = (),
        axes: str = UNCHANGED,
        column_units: tuple[str | None, str | None] = (None, None),
    ) -> None:
        for unit, known, what in (
            (accel_unit, get_args(AccelUnit), "accel_unit"),
            (gyro_unit, get_args(GyroUnit), "gyro_unit"),
        ):
            if unit not in known:
                raise InputError(f"{shown(name)}: {what} is {unit!r}: give one of {', '.join(known)}")

        # The name is escaped, because a file may have any name but messages are one line of printable text.
        printable = shown(name)

        if specific_force is None and angular_rate is None:
            kind = type(time_s).__name__
            frame = f" (imucal.read converts a {kind})" if hasattr(time_s, "__arrow_c_stream__") else ""
            raise InputError(
                f"{printable}: there is neither a specific_force nor an angular_rate: give one{frame}"
            )

        def samples(values: ArrayLike | None, what: str, rows: int) -> SampleArray | None:
            return None if values is None else as_samples(values, f"{printable}: {what}", rows)

        def column(values: ArrayLike, what: str, width: int | None, rows: int | None) -> FloatArray:
            return as_rows(values, f"{printable}: {what}", width, rows)

        time = column(time_s, "time_s", None, None)
        rows = len(time)
        fields: dict[str, Any] = {
            "time_s": time,
            "specific_force": samples(specific_force, "specific_force", rows),
            "angular_rate": samples(angular_rate, "angular_rate", rows),
            "temperature_degc": None
            if temperature_degc is None
            else column(temperature_degc, "temperature_degc", None, rows),
            "stand_rad": None if stand_rad is None else column(stand_rad, "stand_rad", 3, rows),
            "auxiliary": {
                shown(key): column(values, f"auxiliary[{key!r}]", None, rows)
                for key, values in (auxiliary or {}).items()
            },
            "accel_unit": "m/s^2" if specific_force is None else accel_unit,
            "gyro_unit": "rad/s" if angular_rate is None else gyro_unit,
            "name": printable,
            "sources": tuple(sources),
            "findings": tuple(findings),
            "axes": str(Axes.parse(axes)),
            "column_units": tuple(column_units),
        }
        for field, value in fields.items():
            object.__setattr__(self, field, value)

    def __len__(self) -> int:
        return len(self.time_s)

    def __repr__(self) -> str:
        return self.said(len(self), self.duration_s)

    def _repr_html_(self) -> str | None:
        """HTML for display in a notebook."""
        return html_of(self)

    def said(self, samples: int, duration_s: float) -> str:
        """A one-line description of the recording.

        The arguments are the number of samples and the duration that the description states. If this object
        is only the first piece of a recording, the caller may pass the numbers of the whole recording.
        """
        extras = [
            *(["temperature"] if self.temperature_degc is not None else []),
            *(["stand angles"] if self.stand_rad is not None else []),
            *self.auxiliary,
        ]
        return (
            f"Recording({self.name!r}: {samples} samples, {duration_s:.3f} s, {self.rate_hz:.6g} Hz, "
            f"{self.sensors_in_words}" + (f", with {', '.join(extras)})" if extras else ")")
        )

    @property
    def sensors(self) -> tuple[Sensor, ...]:
        """The names of the sensors that the recording has: "accelerometer", "gyroscope"."""
        columns: dict[Sensor, SampleArray | None] = {
            "accelerometer": self.specific_force,
            "gyroscope": self.angular_rate,
        }
        return tuple(name for name, values in columns.items() if values is not None)

    @property
    def sensors_in_words(self) -> str:
        """The sensors with the units of their samples, for messages."""
        units = {"accelerometer": self.accel_unit, "gyroscope": self.gyro_unit}
        words = [f"{sensor} in {units[sensor]}" for sensor in self.sensors]
        return ", ".join(words) if len(words) > 1 else f"{words[0]} alone"

    def of_sensor(self, sensor: Sensor) -> Recording:
        """The same recording with the accelerometer or the gyroscope alone.

        Raises InputError if the recording does not have this sensor.
        """
        if sensor not in get_args(Sensor):
            raise InputError(f"sensor is {sensor!r}: give one of {', '.join(get_args(Sensor))}")
        require_sensors(self, sensor)
        if sensor == "accelerometer":
            return replace(self, angular_rate=None)
        return replace(self, specific_force=None)

    @property
    def rate_hz(self) -> float:
        """Mean sampling rate without pauses, Hz; NaN with fewer than two samples.

        The median time step is not used, because it differs from the mean by ten per cent or more if samples
        come in bursts.
        """
        steps_s = np.diff(self.time_s)
        usual_s = steps_s[steps_s < PAUSE_S]
        counted_s = usual_s if usual_s.size else steps_s
        total_s = float(counted_s.sum())
        return len(counted_s) / total_s if total_s > 0 else float("nan")

    @property
    def duration_s(self) -> float:
        """Time from the first sample to the last, s; 0 with fewer than two samples."""
        return float(self.time_s[-1] - self.time_s[0]) if len(self) > 1 else 0.0

    def between(self, start_s: float | None = None, end_s: float | None = None) -> Recording:
        """The recording with only the samples at start_s <= time_s < end_s; None means no limit."""
        keep = np.ones(len(self), dtype=bool)
        if start_s is not None:
            keep &= self.time_s >= start_s
        if end_s is not None:
            keep &= self.time_s < end_s
        return self.rows(keep)

    def rows(self, keep: NDArray[np.bool_]) -> Recording:
        """The recording with only the samples for which the mask `keep`, (N,), is true."""
        return replace(
            self,
            time_s=self.time_s[keep],
            specific_force=None if self.specific_force is None else self.specific_force[keep],
            angular_rate=None if self.angular_rate is None else self.angular_rate[keep],
            temperature_degc=None if self.temperature_degc is None else self.temperature_degc[keep],
            stand_rad=None if self.stand_rad is None else self.stand_rad[keep],
            auxiliary={key: values[keep] for key, values in self.auxiliary.items()},
        )

    def without_copies(self) -> Recording:
        """The recording without copies.

        A copy is a sample that repeats the time stamp and all values of the previous sample. A warning among
        the findings reports the number of copies. If other consecutive samples have equal time stamps but
        different values, no sample is removed: the time stamps are then too coarse, and equal samples may be
        coincidences.
        """
        is_copy = np.zeros(len(self), dtype=bool)
        # The times are compared first. The samples are compared only at rows with equal times, which are
        # rare.
        is_copy[1:] = self.time_s[1:] == self.time_s[:-1]
        if not is_copy.any():
            return self
        rows = np.flatnonzero(is_copy)
        for values in (self.specific_force, self.angular_rate):
            if values is None:
                continue
            is_copy[rows] &= (values[rows] == values[rows - 1]).all(axis=1)
        count, first = int(is_copy.sum()), int(is_copy.argmax())
        if count < len(rows):
            return self
        time_s, share = float(self.time_s[first]), 100 * count / len(self)
        finding = Finding(
            code="samples_duplicated",
            severity="warning",
            recording=self.name,
            columns=(),
            place=Place(first, first, time_s, time_s),
            count=count,
            value=share,
            unit="%",
            message=(
                f"{count} rows ({share:.2f} %) are exact copies of the row before, with its time stamp, the "
                f"first at {time_s:.2f} s, and were left out"
            ),
            way_out="check the logger, which writes rows twice",
        )
        return replace(self.rows(~is_copy), findings=(*self.findings, finding))

    def with_axes(self, axes: str) -> Recording:
        """The recording after axis remapping: "frd", "ned", "flu", "x,-y,-z", "gyro=-x,-y,-z".

        "x,-y,-z" means that x is the column x, and y and z are the negative columns y and z, for both sensors
        and for a magnetometer among the auxiliary inputs (mag_x_*, mag_y_*, mag_z_*). "frd" and "ned" are the
        same remapping: they convert x forward, y right, z down to x forward, y left, z up. With `accel=` or
        `gyro=`, only this sensor is remapped; "accel=... gyro=..." remaps each sensor separately.

        Raises InputError for any other text.
        """
        wanted = Axes.parse(axes)
        magnetometer = dict(self.auxiliary)
        for names in _magnetometers(self.auxiliary) if wanted.are_alike else ():
            columns = np.column_stack([self.auxiliary[name] for name in names])
            magnetometer.update(zip(names, _along(columns, wanted.accel).T, strict=True))
        return replace(
            self,
            specific_force=None if self.specific_force is None else _along(self.specific_force, wanted.accel),
            angular_rate=None if self.angular_rate is None else _along(self.angular_rate, wanted.gyro),
            auxiliary=magnetometer,
            axes=str(wanted.after(Axes.parse(self.axes))),
        )

    def to_arrow(self) -> Any:
        """The columns as a pyarrow table, with the column names of recording files (accel_x_mps2, ...)."""
        return table_of(self)

    def to_pandas(self) -> Any:
        """The columns as a pandas data frame, with the column names of recording files (accel_x_mps2, ...).

        Raises ImucalError if pandas is not installed.
        """
        try:
            import pandas  # type: ignore[import-untyped, import-not-found, unused-ignore] # noqa: F401
        except ImportError as error:
            raise ImucalError(
                f"to_pandas needs pandas, which cannot be imported ({error}): install it"
            ) from None
        return self.to_arrow().to_pandas()

    def __arrow_c_stream__(self, requested_schema: Any = None) -> Any:
        """The columns through the Arrow PyCapsule interface, for example for polars.DataFrame(recording)."""
        return self.to_arrow().__arrow_c_stream__(requested_schema)


def require_sensors(recording: Recording, *needed: Sensor) -> None:
    """Raise InputError, with the finding `sensor_missing`, for a recording without a needed sensor."""
    for sensor in needed:
        if sensor not in recording.sensors:
            raise _sensor_missing(recording, sensor)


def samples_of_both(recording: Recording) -> tuple[SampleArray, SampleArray]:
    """(specific_force, angular_rate); InputError `sensor_missing` for a recording without one of them."""
    force, rate = recording.specific_force, recording.angular_rate
    if force is None:
        raise _sensor_missing(recording, "accelerometer")
    if rate is None:
        raise _sensor_missing(recording, "gyroscope")
    return force, rate


def _sensor_missing(recording: Recording, sensor: Sensor) -> InputError:
    message = f"there is no {sensor} in this recording, but this operation needs it"
    way_out = f"add the columns of the {sensor}; docs/one-sensor.md lists the operations for a single sensor"
    prefix = {"accelerometer": "accel", "gyroscope": "gyro"}[sensor]
    finding = Finding(
        code="sensor_missing",
        severity="error",
        recording=recording.name,
        columns=tuple(f"{prefix}_{axis}" for axis in "xyz"),
        place=None,
        count=len(recording),
        value=0.0,
        unit="samples",
        message=message,
        way_out=way_out,
    )
    return InputError(f"{recording.name}: {message} [{finding.code}]: {way_out}", [finding])


def _along(samples: NDArray[Any], matrix: FloatArray) -> NDArray[Any]:
    """The samples after axis remapping. Their number type is kept if it can represent the negated values."""
    columns = np.abs(matrix).argmax(axis=1)
    turned = samples[:, columns]
    is_negative = matrix.sum(axis=1) < 0
    if turned.dtype.kind == "i" and is_negative.any():
        # Negated columns of integers are converted to float64, because the lowest integer has no positive
        # counterpart.
        turned = turned.astype(np.float64)
    turned[:, is_negative] *= -1
    return np.ascontiguousarray(turned)


def _magnetometers(names: Iterable[str]) -> list[tuple[str, str, str]]:
    """The names of the three columns of each magnetometer."""
    known = set(names)
    found = [
        tuple(name.replace("mag_x", f"mag_{axis}", 1) for axis in "xyz") for name in known if "mag_x" in name
    ]
    return [(x, y, z) for x, y, z in found if {x, y, z} <= known]


def as_recording(given: Any) -> Recording:
    """`given` if it is a Recording, or the recording in a data frame.

    Raises InputError for any other type.
    """
    if isinstance(given, Recording):
        return given
    if is_frame(given):
        recording: Recording = recording_of(given)
        return recording
    if isinstance(given, (str, os.PathLike)):
        path = os.fspath(given)
        raise InputError(f"{path!r} is the path of a file: give a Recording, imucal.read({path!r})")
    kind = type(given).__name__
    if isinstance(getattr(given, "recording", None), Recording):
        raise InputError(f"a {kind} is given where a Recording is needed: give its `recording`")
    hint = "imucal.read returns a Recording from a file, imucal.Recording one from arrays"
    if isinstance(given, (list, tuple)):
        hint = "give them one by one"
    raise InputError(f"a {kind} is given where a Recording is needed: {hint}")


def as_recordings(given: Recording | Iterable[Recording] | None) -> list[Recording]:
    """One or several recordings as a list, without the samples that `without_copies` removes; empty for None.

    Raises InputError for any other type.
    """
    if given is None:
        return []
    is_one = isinstance(given, (Recording, str, Mapping, np.ndarray)) or is_frame(given)
    if is_one or not isinstance(given, Iterable):
        return [as_recording(given).without_copies()]
    return [as_recording(item).without_copies() for item in given]
