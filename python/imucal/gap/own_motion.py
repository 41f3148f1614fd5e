"""Residuals for the report of a search, computed from the motion that the recordings contain.

    motion = imucal.own_motion(gap, run, control=control)
    motion.signals.predicted_before, motion.rests.rate_before

The recordings are corrected with the calibration without effects ("before") and with the calibration of the
result ("after"). At a rest, a corrected gyroscope reads zero and a corrected accelerometer has the norm of
gravity. During a move, the corrected rates propagate the gravity vector of the rest before the move. This
prediction is compared with the accelerometer.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt

import imucal._core as _core
from imucal.arrays import FloatArray
from imucal.calibration.calibration import Calibration
from imucal.errors import InputError
from imucal.estimation.rests import Move, Rest
from imucal.gap.result import Gap
from imucal.recording.one_unit import of_one_unit, with_own_names
from imucal.recording.recording import Recording, as_recordings, samples_of_both

__all__ = ["MoveResiduals", "MoveSignals", "OwnMotion", "RestResiduals", "own_motion"]

# Maximum duration, s, of the parts of the rests before and after the move that `MoveSignals` includes.
MARGIN_S: Final = 1.0
# The rate of a move is the median over the samples whose rate exceeds this share of the maximum rate. The
# threshold excludes the samples during acceleration and deceleration.
PLATEAU: Final = 0.7
# A move counts as a rotation about a body axis if the cosine of the angle between the rotation axis and this
# body axis is at least this value: 0.85 is 32 deg.
ALONG: Final = 0.85
# A move counts as a rotation about a fixed axis if its total rotation angle is at least this share of the sum
# of the rotation angles between consecutive samples. Otherwise the rotation axis changes during the move.
FIXED: Final = 0.98
# `MoveResiduals` uses a move if the cosine of the angle between its rotation axis and the vertical is at most
# this value: 0.5 is 60 deg. A rotation about the vertical does not change gravity in the body frame.
VERTICAL: Final = 0.5
STAND: Final = ("stand_1_rad", "stand_2_rad", "stand_3_rad")


@dataclass(frozen=True, eq=False)
class MoveSignals:
    """Signals of one move: the measured specific force, and gravity predicted from the gyroscope.

    recording, move  name of the recording, and number of the move in it
    is_control       whether it is a control recording, which the fits did not use
    time_s           (N,) time, s, including parts of the rests before and after the move
    start_s, end_s   start and end of the move, s
    measured_before, measured_after    (N, 3) specific force, corrected without and with the effects, m/s^2
    predicted_before, predicted_after  (N, 3) gravity of the rest before the move, propagated by the
                                       corrected rates, m/s^2
    """

    recording: str
    move: int
    is_control: bool
    time_s: FloatArray
    start_s: float
    end_s: float
    measured_before: FloatArray
    measured_after: FloatArray
    predicted_before: FloatArray
    predicted_after: FloatArray

    @property
    def residual_before(self) -> FloatArray:
        """Measured force minus predicted gravity, from samples corrected without effects, (N, 3), m/s^2."""
        residual: FloatArray = self.measured_before - self.predicted_before
        return residual

    @property
    def residual_after(self) -> FloatArray:
        """Measured force minus predicted gravity, from samples corrected with the effects, (N, 3), m/s^2."""
        residual: FloatArray = self.measured_after - self.predicted_after
        return residual


@dataclass(frozen=True, eq=False)
class RestResiduals:
    """Residuals at the K rests that are not excluded, including those of the control recordings.

    is_control  (K,) whether the rest is from a control recording, which the fits did not use
    time_s      (K,) time of the middle of the rest, s
    up          (K, 3) up direction in the body frame, unit vectors
    rate_before, rate_after  (K, 3) mean corrected rate, rad/s; the true rate is zero
    norm_before, norm_after  (K,) norm of the mean corrected force minus gravity, m/s^2
    columns     mean of the temperature (temp_degc), the stand's angles (stand_1_rad) and each further column
                at the rest, (K,)
    """

    is_control: npt.NDArray[np.bool_]
    time_s: FloatArray
    up: FloatArray
    rate_before: FloatArray
    rate_after: FloatArray
    norm_before: FloatArray
    norm_after: FloatArray
    columns: Mapping[str, FloatArray]


@dataclass(frozen=True, eq=False)
class MoveResiduals:
    """Errors of the corrected rate in K moves, each a rotation about one axis of the body.

    A rotation about the vertical does not change gravity in the body frame. Therefore only moves whose axis
    is at least 60 deg from the vertical are included.

    is_control  (K,) whether the move is from a control recording, which the fits did not use
    axis        (K,) axis of the rotation: 0, 1 or 2
    rate        (K,) rate of the rotation, rad/s
    error_before, error_after  (K,) mean error of the corrected rate about this axis, rad/s
    """

    is_control: npt.NDArray[np.bool_]
    axis: npt.NDArray[np.int_]
    rate: FloatArray
    error_before: FloatArray
    error_after: FloatArray


@dataclass(frozen=True, eq=False)
class OwnMotion:
    """Signals of one move, and residuals at rests and of moves.

    signals  signals of the move with the largest residual; None if there is no move
    rests    residuals at all rests
    moves    residuals of the moves about one body axis
    """

    signals: MoveSignals | None
    rests: RestResiduals
    moves: MoveResiduals


@dataclass(frozen=True, eq=False)
class _Corrected:
    """A recording, corrected without and with the effects, and its rests and moves."""

    raw: Recording
    before: Recording
    after: Recording
    is_control: bool
    rests: Mapping[int, Rest]
    moves: Sequence[tuple[int, Move]]


def own_motion(
    gap: Gap,
    recordings: Recording | Sequence[Recording],
    *,
    control: Recording | Sequence[Recording] | None = None,
) -> OwnMotion:
    """Residuals at the rests and moves of the recordings of a search, without and with the found effects.

    Raises InputError for a result without fits, and for other recordings than those of the search.
    """
    if not gap.fits:
        raise InputError("there is no fit: faults of the data ended the search")
    unit_data = of_one_unit(recordings)
    judges = with_own_names(as_recordings(control))
    before, after = gap.fits["before"], gap.fits["after"]
    corrected = list(
        _corrected(unit_data, before.calibration, after.calibration, after.rests, after.moves, False)
    )
    moves: list[tuple[bool, Move]] = [(False, move) for move in before.moves]
    if judges and after.control is not None and before.control is not None:
        own = after.control
        corrected += _corrected(judges, before.calibration, after.calibration, own.rests, own.moves, True)
        moves = [(True, move) for move in before.control.moves]
    gravity = after.calibration.gravity_mps2
    return OwnMotion(
        _signals(corrected, moves, gravity), _rest_residuals(corrected, gravity), _move_residuals(corrected)
    )


def _corrected(
    recordings: Sequence[Recording],
    before: Calibration,
    after: Calibration,
    rests: Sequence[Rest],
    moves: Sequence[Move],
    is_control: bool,
) -> list[_Corrected]:
    known = {recording.name for recording in recordings}
    unknown = {rest.recording for rest in rests} - known
    if unknown:
        raise InputError(f"{min(unknown)} is not among the recordings: give the recordings of the search")
    return [
        _Corrected(
            recording,
            before.apply_recording(recording),
            after.apply_recording(recording),
            is_control,
            {k: rest for k, rest in enumerate(rests) if rest.recording == recording.name},
            [(k, move) for k, move in enumerate(moves) if move.recording == recording.name],
        )
        for recording in recordings
    ]


def _signals(
    corrected: Sequence[_Corrected], moves: Sequence[tuple[bool, Move]], gravity: float
) -> MoveSignals | None:
    """Signals of the move with the largest ratio of residual to noise in the model without the effects."""
    worst, place = 0.0, None
    for is_control, move in moves:
        error, sigma = move.direction_error_deg, move.direction_sigma_deg
        if move.excluded is None and error is not None and sigma and error / sigma > worst:
            worst, place = error / sigma, (is_control, move)
    if place is None:
        return None
    is_control, move = place
    of = next(c for c in corrected if c.is_control == is_control and c.raw.name == move.recording)
    number = next(k for k, own in of.moves if (own.first, own.last) == (move.first, move.last))
    first_number = of.moves[0][0]
    time = of.raw.time_s
    start, end = time[[move.first, move.last]]
    rest_before, rest_after = of.rests.get(_rest_at(of, move.first)), of.rests.get(_rest_at(of, move.last))
    first = max(np.searchsorted(time, start - MARGIN_S), 0 if rest_before is None else rest_before.first)
    last = min(np.searchsorted(time, end + MARGIN_S), len(time) if rest_after is None else rest_after.end)
    both = []
    for own in (of.before, of.after):
        force, rate = (np.asarray(rows, dtype=float)[first:last] for rows in samples_of_both(own))
        own_force = np.asarray(own.specific_force, dtype=float)
        origin = own_force[rest_before.first : rest_before.end].mean(axis=0) if rest_before else force[0]
        origin = gravity * origin / np.linalg.norm(origin)
        both.append((force, _propagated(time[first:last], rate, origin, int(move.first - first))))
    (measured_before, predicted_before), (measured_after, predicted_after) = both
    return MoveSignals(
        move.recording, number - first_number, is_control, time[first:last], float(start), float(end),
        measured_before, measured_after, predicted_before, predicted_after,
    )  # fmt: skip


def _rest_at(of: _Corrected, sample: int) -> int:
    """Number of the rest that contains a sample; -1 if there is none."""
    return next((k for k, rest in of.rests.items() if rest.first <= sample <= rest.end), -1)


def _propagated(time_s: FloatArray, rate: FloatArray, origin: FloatArray, at: int) -> FloatArray:
    """A vector that is constant in the world frame, expressed in the body frame at each sample, (N, 3).

    The vector is `origin` until sample `at`. After this sample, dv/dt = v x w is integrated, where w is the
    mean rate of adjacent samples.
    """
    out = np.empty_like(rate)
    out[: at + 1] = origin
    angles = 0.5 * (rate[1:] + rate[:-1]) * np.diff(time_s)[:, None]
    for k in range(at, len(rate) - 1):
        out[k + 1] = _rotated(out[k], -angles[k])
    return out


def _rotated(vector: FloatArray, angle: FloatArray) -> FloatArray:
    """The vector after a rotation by the rotation vector `angle`, rad (Rodrigues' formula)."""
    size = float(np.linalg.norm(angle))
    if size < 1e-12:
        return vector
    axis = angle / size
    cosine, sine = np.cos(size), np.sin(size)
    rotated: FloatArray = (
        cosine * vector + sine * np.cross(axis, vector) + (1.0 - cosine) * (axis @ vector) * axis
    )
    return rotated


def _rest_residuals(corrected: Sequence[_Corrected], gravity: float) -> RestResiduals:
    rows = [(of, rest) for of in corrected for rest in of.rests.values() if rest.excluded is None]
    names = set.intersection(*(set(_columns(of.raw)) for of in corrected)) if corrected else set()

    def means(pick: str, when: str) -> FloatArray:
        values = [np.asarray(getattr(getattr(of, when), pick))[rest.first : rest.end] for of, rest in rows]
        return np.array([own.mean(axis=0) for own in values]).reshape(-1, 3)

    force_before, force_after = means("specific_force", "before"), means("specific_force", "after")
    return RestResiduals(
        is_control=np.array([of.is_control for of, _ in rows], dtype=bool),
        time_s=np.array([of.raw.time_s[rest.first : rest.end].mean() for of, rest in rows]),
        up=force_after / np.linalg.norm(force_after, axis=1, keepdims=True),
        rate_before=means("angular_rate", "before"),
        rate_after=means("angular_rate", "after"),
        norm_before=np.linalg.norm(force_before, axis=1) - gravity,
        norm_after=np.linalg.norm(force_after, axis=1) - gravity,
        columns={
            name: np.array([_columns(of.raw)[name][rest.first : rest.end].mean() for of, rest in rows])
            for name in sorted(names)
        },
    )


def _columns(recording: Recording) -> dict[str, FloatArray]:
    degc = recording.temperature_degc
    angles = {} if recording.stand_rad is None else dict(zip(STAND, recording.stand_rad.T, strict=True))
    return {**({} if degc is None else {"temp_degc": degc}), **angles, **recording.auxiliary}


def _move_residuals(corrected: Sequence[_Corrected]) -> MoveResiduals:
    rows: list[tuple[bool, int, float, float, float]] = []
    for of in corrected:
        for _, move in of.moves:
            rest_from, rest_to = _rest_at(of, move.first), _rest_at(of, move.last)
            if move.excluded is None and rest_from >= 0 and rest_to >= 0:
                row = _move_row(of, move, of.rests[rest_from], of.rests[rest_to])
                rows += [] if row is None else [row]
    is_control, axis, rate, before, after = zip(*rows, strict=True) if rows else ([], [], [], [], [])
    return MoveResiduals(
        np.array(is_control, dtype=bool), np.array(axis, dtype=int),
        np.array(rate, dtype=float), np.array(before, dtype=float), np.array(after, dtype=float),
    )  # fmt: skip


def _move_row(
    of: _Corrected, move: Move, rest_from: Rest, rest_to: Rest
) -> tuple[bool, int, float, float, float] | None:
    """The values of `MoveResiduals` for one move; None for a move that `MoveResiduals` does not include."""
    time = of.raw.time_s[move.first : move.last + 1]
    rates = np.asarray(of.after.angular_rate, dtype=float)[move.first : move.last + 1]
    turned = 0.5 * (np.diff(time)[:, None] * (rates[1:] + rates[:-1])).sum(axis=0)
    angle = float(np.linalg.norm(turned))
    speed = np.linalg.norm(rates, axis=1)
    path = float(0.5 * (np.diff(time) * (speed[1:] + speed[:-1])).sum())
    if angle < FIXED * path or angle == 0.0:
        return None
    about = turned / angle
    axis = int(np.argmax(np.abs(about)))
    up = np.asarray(of.after.specific_force, dtype=float)[rest_to.first : rest_to.end].mean(axis=0)
    if abs(about[axis]) < ALONG or abs(about @ up) > VERTICAL * np.linalg.norm(up):
        return None
    rate = float(np.median(rates[speed >= PLATEAU * speed.max(), axis]))
    about = about * np.sign(about[axis])
    # Duration, s, of a rotation by the angle of the move at this constant rate.
    seconds = float(turned[axis]) / rate
    errors = []
    for own in (of.before, of.after):
        force = np.asarray(own.specific_force, dtype=float)
        start, end = (force[rest.first : rest.end].mean(axis=0) for rest in (rest_from, rest_to))
        own_rates = np.asarray(own.angular_rate, dtype=float)[move.first : move.last + 1]
        rotation = _core.integrate(time, np.ascontiguousarray(own_rates))
        predicted = _into_end(rotation, start / np.linalg.norm(start))
        # A rate error e that acts for a time dt changes the predicted gravity direction p by p x e dt (cross
        # product). If e is perpendicular to p, the cross product of p and the measured direction is e dt.
        errors.append(float(np.cross(predicted, end / np.linalg.norm(end)) @ about) / seconds)
    return of.is_control, axis, rate, errors[0], errors[1]


def _into_end(quaternion: FloatArray, vector: FloatArray) -> FloatArray:
    """Transform a vector from the body frame at the first sample to the body frame at the last sample.

    The quaternion maps in the opposite direction, v_start = q v_end.
    """
    w, imaginary = float(quaternion[0]), -np.asarray(quaternion[1:], dtype=float)
    twice = 2.0 * np.cross(imaginary, vector)
    rotated: FloatArray = vector + w * twice + np.cross(imaginary, twice)
    return rotated
