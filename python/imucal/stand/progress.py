"""What a run has so far: rate, rests, coverage of the sphere, and the standard deviations to be expected."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.errors import ImucalError, InputError
from imucal.estimation.inspection import Inspection, inspect
from imucal.limits.limits import ParameterLimit
from imucal.recording.recording import Recording
from imucal.stand.clock import SYSTEM_CLOCK, Clock
from imucal.stand.rows import recording_of

__all__ = ["Progress", "Prospect", "parse_target"]

# Directions on a sphere, and how near to one of them a rest must be.
DIRECTIONS: Final = 200
NEAR_DEG: Final = 30.0
# Predictions take at most this share of one processor.
SHARE: Final = 0.2
# Shortest time between two predictions, s: the live view is not refreshed more often.
EVERY_S: Final = 0.2
RATE_OVER: Final = 50


@dataclass(frozen=True)
class Prospect:
    """What the samples so far promise.

    rests     how many were found
    coverage  share of all directions that are within 30 deg of the vertical of a rest
    sigma     the standard deviation expected of each parameter, None if it is not determined
    units     of the parameters
    missing   what the samples so far do not determine, in words
    """

    rests: int = 0
    coverage: float = 0.0
    sigma: Mapping[str, float | None] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    missing: str | None = None

    def reaches(self, targets: Sequence[ParameterLimit]) -> bool:
        """Whether every parameter that a target covers is expected to keep it."""
        if not targets or not self.sigma:
            return False
        kept = [
            std is not None and target.max_std is not None and std <= target.max_std
            for target in targets
            for name, std in self.sigma.items()
            if target.covers(name)
        ]
        return bool(kept) and all(kept)


def parse_target(text: str) -> ParameterLimit:
    """The target of `gyro_bias_*=5e-5`: a parameter or a group, and the largest standard deviation, SI units.

    Raises InputError, with an example, for anything else.
    """
    from imucal.calibration.calibration import ACCEL_ENTRIES, GYRO_ENTRIES

    name, _, value = text.partition("=")
    try:
        # The unit is not asked for: a prediction is in the units of the parameters.
        target = ParameterLimit(name.strip(), "", max_std=float(value))
    except (ValueError, InputError):
        raise InputError(
            f"the target {text!r} is not NAME=SIGMA: give one such as gyro_sensitivity_*=2e-4"
        ) from None
    names = [f"{sensor}_bias_{axis}" for sensor in ("accel", "gyro") for axis in "xyz"]
    names += [f"accel_sensitivity_{entry}" for entry in ACCEL_ENTRIES["symmetric"]]
    names += [f"gyro_sensitivity_{entry}" for entry in GYRO_ENTRIES]
    if not any(target.covers(known) for known in names):
        raise InputError(f"the target {text!r} is for no parameter: there are {', '.join(names)}")
    return target


class Progress:
    """Keeps the samples of a run and looks at them in another thread, now and then."""

    def __init__(self, columns: Sequence[str], clock: Clock = SYSTEM_CLOCK) -> None:
        self.columns = tuple(columns)
        self._clock = clock
        self.samples = 0
        self.prospect = Prospect()
        self._chunks: list[FloatArray] = []
        self._arrivals: list[tuple[float, int]] = []
        self._looking: threading.Thread | None = None
        self._next_s = 0.0

    def see(self, rows: FloatArray) -> None:
        """New samples."""
        if len(rows) == 0:
            return
        self._chunks.append(rows)
        self.samples += len(rows)
        self._arrivals = [*self._arrivals[-RATE_OVER:], (self._clock.now_s(), self.samples)]

    @property
    def arrival_rate_hz(self) -> float:
        """Samples per second of the host's time, over the last chunks; 0 without any."""
        if len(self._arrivals) < 2:
            return 0.0
        (start_s, first), (end_s, last) = self._arrivals[0], self._arrivals[-1]
        return (last - first) / (end_s - start_s) if end_s > start_s else 0.0

    def look(self, finally_too: bool = False) -> None:
        """Bring `prospect` up to date: at once if that is asked for, else later and not too often."""
        if self._looking is not None and self._looking.is_alive():
            if not finally_too:
                return
            self._looking.join()
        if not finally_too and (self._clock.now_s() < self._next_s or not self._chunks):
            return
        # Here, where samples are added, and not in the other thread.
        self._chunks = [np.concatenate(self._chunks)] if self._chunks else []
        rows = self._chunks[0] if self._chunks else np.zeros((0, len(self.columns)))
        if finally_too:
            self._look(rows)
        else:
            self._looking = threading.Thread(target=self._look, args=(rows,), daemon=True)
            self._clock.start_work(self._looking)

    def _look(self, rows: FloatArray) -> None:
        start_s = self._clock.now_s()
        try:
            recording = recording_of(self.columns, rows, "the run so far")
            self.prospect = _prospect(recording, inspect(recording))
        except ImucalError as error:
            self.prospect = Prospect(missing=str(error))
        end_s = self._clock.now_s()
        self._next_s = max(end_s + (end_s - start_s) * (1 / SHARE - 1), start_s + EVERY_S)


def _prospect(recording: Recording, seen: Inspection) -> Prospect:
    predicted: Sequence[Mapping[str, Any]] = seen.predicted_sigma
    return Prospect(
        rests=len(seen.rests),
        coverage=_coverage(recording, seen),
        sigma={item["name"]: item["std"] for item in predicted},
        units={item["name"]: item["unit"] for item in predicted},
        missing=seen.missing,
    )


def _coverage(recording: Recording, seen: Inspection) -> float:
    """Share of all directions that are near the vertical of a rest."""
    ups = [
        recording.between(rest["start_s"], rest["end_s"]).specific_force.mean(axis=0) for rest in seen.rests
    ]
    if not ups:
        return 0.0
    up = np.array(ups) / np.linalg.norm(ups, axis=1, keepdims=True)
    return float(np.mean((_sphere() @ up.T).max(axis=1) >= np.cos(np.radians(NEAR_DEG))))


def _sphere() -> FloatArray:
    """Directions spread evenly, (N, 3), on a spiral with the golden angle."""
    k = np.arange(DIRECTIONS) + 0.5
    z = 1.0 - 2.0 * k / DIRECTIONS
    turn = np.pi * (3.0 - 5.0**0.5) * k
    around = np.sqrt(1.0 - z * z)
    return np.column_stack([around * np.cos(turn), around * np.sin(turn), z])
