"""A table of mean readings: one row for each pose in which a unit rested."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from imucal.arrays import FloatArray, as_rows
from imucal.document.name import shown
from imucal.document.source import Source
from imucal.errors import InputError
from imucal.finding import Finding
from imucal.recording.axes import UNCHANGED, Axes
from imucal.recording.recording import AccelUnit, GyroUnit, Recording, require_sensors
from imucal.units import COLUMN_UNITS

__all__ = ["Means"]

DURATION: Final = "duration_s"


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Means:
    """Mean readings of a unit at rest, one row for each pose, in any order.

    specific_force      (K, 3)  means of the accelerometer, in `accel_unit`
    angular_rate        (K, 3)  means of the gyroscope, in `gyro_unit`; None without a gyroscope
    specific_force_std  (K, 3)  standard deviation of each mean of the accelerometer (not of a sample); None
                                if it is not known
    duration_s          (K,)    time over which each mean was taken, s; None if it is not known

    Raises InputError for wrong shapes.
    """

    specific_force: FloatArray
    angular_rate: FloatArray | None = None
    specific_force_std: FloatArray | None = None
    duration_s: FloatArray | None = None
    accel_unit: AccelUnit = "m/s^2"
    gyro_unit: GyroUnit = "rad/s"
    name: str = "means"
    sources: Sequence[Source] = ()
    findings: Sequence[Finding] = ()
    axes: str = field(default=UNCHANGED)

    def __post_init__(self) -> None:
        name = shown(self.name)
        force = as_rows(self.specific_force, f"{name}: specific_force", 3)
        fields = {
            "name": name,
            "specific_force": force,
            "sources": tuple(self.sources),
            "findings": tuple(self.findings),
            "axes": str(Axes.parse(self.axes)),
        }
        for key, width in (("angular_rate", 3), ("specific_force_std", 3), (DURATION, None)):
            values = getattr(self, key)
            if values is not None:
                fields[key] = as_rows(values, f"{name}: {key}", width, len(force))
        for key, value in fields.items():
            object.__setattr__(self, key, value)

    def __len__(self) -> int:
        return len(self.specific_force)

    def __repr__(self) -> str:
        sensors = "accelerometer" if self.angular_rate is None else "accelerometer, gyroscope"
        return f"Means({self.name!r}: {len(self)} rests, {sensors})"

    @staticmethod
    def of_rows(table: Recording) -> Means:
        """The means in the rows of a table that was read as a recording without time.

        Its other columns may be accel_x_std_mps2, ... (standard deviations, in any unit of the accelerometer)
        and duration_s. Raises InputError for a table without an accelerometer.
        """
        require_sensors(table, "accelerometer")
        unit = table.column_units[0] or ("lsb" if table.accel_unit == "lsb" else "mps2")
        deviations = [_std(table, axis, unit) for axis in "xyz"]
        known = [values for values in deviations if values is not None]
        if len(known) not in (0, 3):
            raise InputError(f"{table.name}: give accel_x_std, accel_y_std and accel_z_std, or none of them")
        std = np.column_stack(known) if known else None
        matrix = np.abs(Axes.parse(table.axes).accel)
        rate = table.angular_rate
        return Means(
            specific_force=np.asarray(table.specific_force, dtype=np.float64),
            angular_rate=None if rate is None else np.asarray(rate, dtype=np.float64),
            # The means are already remapped to the body axes, but their standard deviations are not yet.
            specific_force_std=None if std is None else std @ matrix.T,
            duration_s=table.auxiliary.get(DURATION),
            accel_unit=table.accel_unit,
            gyro_unit=table.gyro_unit,
            name=table.name,
            sources=table.sources,
            findings=table.findings,
            axes=table.axes,
        )


def _std(table: Recording, axis: str, unit: str) -> FloatArray | None:
    """The column accel_<axis>_std_<unit>, converted to the unit of `Means`; None if there is none."""
    names = [name for name in table.auxiliary if name.startswith(f"accel_{axis}_std_")]
    if not names:
        return None
    given = names[0].rpartition("_")[2]
    factors = COLUMN_UNITS["accel"]
    if len(names) > 1 or given not in factors or (given == "lsb") != (unit == "lsb"):
        raise InputError(
            f"{table.name}: {', '.join(names)}: give one column accel_{axis}_std_{unit}, in the unit of the "
            "means"
        )
    return table.auxiliary[names[0]] * factors[given]
