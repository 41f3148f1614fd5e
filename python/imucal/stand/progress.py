"""Progress of a run: rate, rests, coverage of directions, and predicted accuracy of a calibration."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.errors import ImucalError, InputError
from imucal.estimation.inspection import Inspection, inspect
from imucal.limits.limit import ParameterLimit
from imucal.recording.recording import Recording, samples_of_both
from imucal.stand.clock import SYSTEM_CLOCK, Clock
from imucal.stand.rows import recording_of

__all__ = ["Progress", "Prospect", "parse_target"]

# Number of directions on the sphere for which coverage is evaluated.
DIRECTIONS: Final = 200
# A body direction is covered if it is less than this angle, deg, away from the vertical at one of the rests.
NEAR_DEG: Final = 30.0
# Largest share of one processor that the evaluation of samples may use.
SHARE: Final = 0.2
# Shortest time between two evaluations, s. It is the refresh interval of the live view.
EVERY_S: Final = 0.2
# The arrival rate is computed from this number of most recent chunks of samples.
RATE_OVER: Final = 50


@dataclass(frozen=True)
class Prospect:
    """Evaluation of the samples received so far.

    rests     number of rests
    coverage  share of all body directions that were within 30 deg of the vertical at any rest
    sigma     standard deviation of each parameter that a calibration from these samples would have; None for
              a parameter that is not determined
    units     units of the parameters
    missing   description of the motion that is needed to determine the undetermined parameters
    """

    rests: int = 0
    coverage: float = 0.0
    sigma: Mapping[str, float | None] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    missing: str | None = None

    def reaches(self, targets: Sequence[ParameterLimit]) -> bool:
        """Whether the predicted standard deviation of every targeted parameter is within its target."""
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
    """Parse `gyro_bias_*=5e-5`: a parameter or group of parameters, and its maximum standard deviation, SI.

    Raises InputError, with an example, for other text.
    """
    from imucal.calibration.triad import ACCEL_ENTRIES, GYRO_ENTRIES

    name, _, value = text.partition("=")
    try:
        # The limit needs no unit, because predictions are in the units of the parameters.
        target = ParameterLimit(name.strip(), "", max_std=float(value))
    except (ValueError, InputError):
        raise InputError(
            f"the target {text!r} is not NAME=SIGMA: give one such as gyro_sensitivity_*=2e-4"
        ) from None
    names = [f"{sensor}_bias_{axis}" for sensor in ("accel", "gyro") for axis in "xyz"]
    names += [f"accel_sensitivity_{entry}" for entry in ACCEL_ENTRIES["symmetric"]]
    names += [f"gyro_sensitivity_{entry}" for entry in GYRO_ENTRIES]
    if not any(target.covers(known) for known in names):
        raise InputError(f"the target {text!r} matches no parameter: give one of {', '.join(names)}")
    return target


class Progress:
    """Collects the samples of a run and evaluates them from time to time in a background thread."""

    def __init__(self, columns: Sequence[str], clock: Clock = SYSTEM_CLOCK) -> None:
        self.columns = tuple(columns)
        self._clock = clock
        self.samples = 0
        self.prospect = Prospect()
        self._chunks: list[FloatArray] = []
        self._arrivals: list[tuple[float, int]] = []
        self._evaluating: threading.Thread | None = None
        self._next_s = 0.0

    def add(self, rows: FloatArray) -> None:
        """Add new samples, (N, columns)."""
        if len(rows) == 0:
            return
        self._chunks.append(rows)
        self.samples += len(rows)
        self._arrivals = [*self._arrivals[-RATE_OVER:], (self._clock.now_s(), self.samples)]

    @property
    def arrival_rate_hz(self) -> float:
        """Samples per second of host time, over the latest chunks; 0 if there are fewer than two."""
        if len(self._arrivals) < 2:
            return 0.0
        (start_s, first), (end_s, last) = self._arrivals[0], self._arrivals[-1]
        return (last - first) / (end_s - start_s) if end_s > start_s else 0.0

    def update(self, *, wait: bool = False) -> None:
        """Update `prospect` in the background; with `wait`, update it now and return when it is done."""
        if self._evaluating is not None and self._evaluating.is_alive():
            if not wait:
                return
            self._evaluating.join()
        if not wait and (self._clock.now_s() < self._next_s or not self._chunks):
            return
        # The chunks are concatenated before the background thread starts, because `add` appends to the list
        # in the calling thread.
        self._chunks = [np.concatenate(self._chunks)] if self._chunks else []
        rows = self._chunks[0] if self._chunks else np.zeros((0, len(self.columns)))
        if wait:
            self._evaluate(rows)
        else:
            self._evaluating = threading.Thread(target=self._evaluate, args=(rows,), daemon=True)
            self._clock.start_work(self._evaluating)

    def _evaluate(self, rows: FloatArray) -> None:
        start_s = self._clock.now_s()
        try:
            recording = recording_of(self.columns, rows, "the run so far")
            self.prospect = _prospect(recording, inspect(recording))
        except ImucalError as error:
            self.prospect = Prospect(missing=str(error))
        end_s = self._clock.now_s()
        self._next_s = max(end_s + (end_s - start_s) * (1 / SHARE - 1), start_s + EVERY_S)


def _prospect(recording: Recording, inspection: Inspection) -> Prospect:
    return Prospect(
        rests=len(inspection.rests),
        coverage=_coverage(recording, inspection),
        sigma={item.name: item.std for item in inspection.predicted_sigma},
        units={item.name: item.unit for item in inspection.predicted_sigma},
        missing=inspection.missing,
    )


def _coverage(recording: Recording, inspection: Inspection) -> float:
    """Share of all body directions that were within `NEAR_DEG` of the vertical at any rest."""
    ups = [
        samples_of_both(recording.between(rest.start_s, rest.end_s))[0].mean(axis=0)
        for rest in inspection.rests
    ]
    if not ups:
        return 0.0
    up = np.array(ups) / np.linalg.norm(ups, axis=1, keepdims=True)
    return float(np.mean((_sphere() @ up.T).max(axis=1) >= np.cos(np.radians(NEAR_DEG))))


def _sphere() -> FloatArray:
    """Evenly distributed unit vectors, (N, 3), on a spiral with the golden angle."""
    k = np.arange(DIRECTIONS) + 0.5
    z = 1.0 - 2.0 * k / DIRECTIONS
    turn = np.pi * (3.0 - 5.0**0.5) * k
    around = np.sqrt(1.0 - z * z)
    return np.column_stack([around * np.cos(turn), around * np.sin(turn), z])
