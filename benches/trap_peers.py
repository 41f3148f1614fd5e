"""Other programs on the rows of the table of traps.

The crate imu-calib is compiled before (benches/peers/imu_calib, `make traps`).

A peer gets the recording of a row as arrays of its columns, because no other program reads these files. Rows
that ask for something else than a calibration, and files that are not a plain table with a header, are not
readable.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np
import pyarrow.parquet
from pyarrow import csv

import comparison
import imucal
import scipy_peer
from trap import WITHIN_SIGMAS, Question, Trap

__all__ = ["PEERS", "PeerOutcome", "outcome_of"]

PeerOutcome = Literal["not readable", "refused", "right", "wrong"]
GRAVITY_MPS2: Final = 9.80665
# Errors that count as wrong for a program without standard deviations, rms per axis: specific force at rest,
# mg, and rate at 100 deg/s, deg/s. They are more than ten times those of imu-calib on clean runs.
MOST_FORCE_MG: Final = 5.0
MOST_RATE_DPS: Final = 0.5
# Rest at the start of the recordings from which imu-calib derives its thresholds, s.
FIRST_REST_S: Final = 1.5


class NotReadable(Exception):
    """The peer cannot read this input."""


@dataclass(frozen=True)
class Table:
    """Columns of a recording in the units of the file; `nominal` is the nominal scale of its gyroscope."""

    time_s: np.ndarray
    force: np.ndarray
    rate: np.ndarray
    gravity: float
    nominal: float
    is_si: bool


def table_of(path: Path, truth: Mapping[str, float]) -> Table:
    """The six columns and the time of a file with a header."""
    try:
        read = pyarrow.parquet.read_table if path.suffix == ".parquet" else csv.read_csv
        columns = read(path)
    except (OSError, ValueError) as error:
        raise NotReadable(str(error)) from error

    def triad(sensor: str) -> tuple[np.ndarray, str]:
        for unit in ("mps2", "g", "radps", "dps", "lsb"):
            names = [f"{sensor}_{axis}_{unit}" for axis in "xyz"]
            if set(names) <= set(columns.column_names):
                return np.column_stack([columns[name].to_numpy() for name in names]).astype(float), unit
        raise NotReadable(f"no columns of the {sensor}")

    times = [name for name in columns.column_names if name in ("time_s", "time_ms", "time_us", "time_ns")]
    if not times:
        raise NotReadable("no column of time")
    scale = {"time_s": 1.0, "time_ms": 1e-3, "time_us": 1e-6, "time_ns": 1e-9}[times[0]]
    time_s = columns[times[0]].to_numpy().astype(float) * scale
    (force, force_unit), (rate, rate_unit) = triad("accel"), triad("gyro")
    force *= GRAVITY_MPS2 if force_unit == "g" else 1.0
    rate *= np.pi / 180.0 if rate_unit == "dps" else 1.0
    nominal = truth.get("gyro_sensitivity_xx", 1.0) if rate_unit == "lsb" else 1.0
    return Table(time_s, force, rate, GRAVITY_MPS2, nominal, "lsb" not in (force_unit, rate_unit))


def imu_calib_error(table: Table, truth: Mapping[str, float]) -> float:
    """The larger error of imu-calib, as a multiple of the one that counts as wrong."""
    if not table.is_si:
        raise NotReadable("counts")
    recording = imucal.Recording(table.time_s, table.force, table.rate)
    found, _ = comparison.imu_calib(recording, table.gravity, FIRST_REST_S)

    def of(sensor: str) -> tuple[np.ndarray, np.ndarray]:
        matrix = [truth.get(f"{sensor}_sensitivity_{a}{b}", float(a == b)) for a in "xyz" for b in "xyz"]
        return np.reshape(matrix, (3, 3)), np.array([truth.get(f"{sensor}_bias_{a}", 0.0) for a in "xyz"])

    (accel, accel_bias), (gyro, gyro_bias) = of("accel"), of("gyro")
    # Six entries of the symmetric matrix are in the truth.
    accel = np.maximum(np.abs(accel), np.abs(accel.T)) * np.sign(accel + accel.T)
    force, rate = comparison.errors(found, comparison.Linear(accel, accel_bias, gyro, gyro_bias))
    return max(force / MOST_FORCE_MG, rate / MOST_RATE_DPS)


def scipy_error(table: Table, truth: Mapping[str, float]) -> float:
    """The largest error of the SciPy program, as a multiple of the one that counts as wrong."""
    found = by_scipy(table)
    sigmas = [abs(found[name][0] - truth[name]) / found[name][1] for name in found if name in truth]
    return max(sigmas, default=0.0) / WITHIN_SIGMAS


def by_scipy(table: Table) -> dict[str, tuple[float, float]]:
    """Parameters with standard deviations of benches/scipy_peer.py, the same model without checks."""
    found = scipy_peer.calibrate(
        table.time_s, table.force, table.rate, gravity_mps2=table.gravity, gyro_nominal=table.nominal
    )
    # The sensitivity of the accelerometer is symmetric: six entries.
    symmetric = list(zip(scipy_peer.ROWS, scipy_peer.COLUMNS, strict=True))
    general = [(i, j) for i in range(3) for j in range(3)]
    values = {}
    for sensor, bias, sensitivity, std, entries in (
        ("accel", found.accel_bias, found.accel_sensitivity, found.accel_std, symmetric),
        ("gyro", found.gyro_bias, found.gyro_sensitivity, found.gyro_std, general),
    ):
        values |= {f"{sensor}_bias_{x}": (bias[i], std[i]) for i, x in enumerate("xyz")}
        for (i, j), sigma in zip(entries, std[3:], strict=True):
            values[f"{sensor}_sensitivity_{'xyz'[i]}{'xyz'[j]}"] = (sensitivity[i, j], sigma)
    if not np.all(np.isfinite([value for pair in values.values() for value in pair])):
        raise ValueError("the result is not finite")
    return values


# For each program the error of its result, 1 being the largest that is right.
PEERS: Final[dict[str, Callable[[Table, Mapping[str, float]], float]]] = {
    "SciPy program (benches/scipy_peer.py)": scipy_error,
    "imu-calib 0.3.1 (Rust)": imu_calib_error,
}


def outcome_of(peer: str, trap: Trap, question: Question) -> PeerOutcome:
    """What a peer makes of a row.

    A result is right if a result is right for this row, and if its errors are within what the peer states, or
    small if it states nothing. A refusal is right where it is one of the right outcomes, and otherwise
    `refused`.
    """
    words = [str(word) for word in question.command]
    paths = [Path(word) for word in words[1:] if not word.startswith("-")]
    inputs = [path for path in paths if path.is_file() and "control" not in path.name]
    if words[0] != "calibrate" or len(inputs) != 1:
        return "not readable"
    truth = question.truth or {}
    outcomes = {right.outcome for right in trap.right}
    try:
        error = PEERS[peer](table_of(inputs[0], truth), truth)
    except NotReadable:
        return "not readable"
    except Exception:
        return "right" if outcomes & {"refused", "poor"} else "refused"
    if not outcomes & {"good", "incomplete"}:
        return "wrong"
    return "right" if error <= 1.0 else "wrong"
