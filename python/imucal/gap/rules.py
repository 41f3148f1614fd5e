"""Faults of the data that no check of the columns sees, for where no effect explains a disagreement better.

    mount_slip              up_k - R(q_k)^T e_z = stand errors + s x up_k from some rest on
    loose_mount             up_k - R(q_k)^T e_z scatters from rest to rest, more than any stand explains
    clock_irregular         rates in moves do not follow the stamps, or are noisier by (jitter dw/dt)^2
    noise_grows_in_motion   noise in moves is a multiple of that at rest

Noise is that of fourth differences: motion is too smooth to show in them.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from imucal.estimation.rests import Move, Rest
from imucal.finding import Finding

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from imucal.arrays import FloatArray
    from imucal.estimation.result import CalibrationResult
    from imucal.recording.recording import Recording

__all__ = ["best_mount", "faults_without_effect", "loose_mounts", "mount_slips", "vertical"]

# Rests on both sides of a slip, and how much smaller chi2 is with it: of a drift a step leaves a quarter.
FEWEST_RESTS: Final = 4
SLIP_EXPLAINS: Final = 10.0
# A firm unit misses a cheap stand's angles by less, from rest to rest.
PLAY_DEG: Final = 0.25
STEP_RAD: Final = 1e-4
# By so much chance does not change chi2, nor twice the logarithm of a likelihood.
CLEARLY: Final = 25.0
# Stamps that add less than this share to the variance of the moves do no harm.
WORTH_SAYING: Final = 0.1
# The root of the sum of the squares of 1, 4, 6, 4, 1.
FOURTH: Final = 70.0**0.5
# The median of a normal number without its sign, and what is too large for one.
MEDIAN: Final = 0.6745
JUMP: Final = 5.0
# Fourth differences that share no sample.
APART: Final = 5


def mount_slips(result: CalibrationResult, recordings: Sequence[Recording]) -> Iterator[Finding]:
    """Steps between the attitude of the unit and the angles of the stand, that stay."""
    for recording in recordings:
        rests = [rest for rest in _on_a_stand(result, recording) if rest.excluded is None]
        if len(rests) < 4 * FEWEST_RESTS:
            continue
        first, turn_rad, times = _largest_step(*_against_stand(result, recording, rests))
        if times > SLIP_EXPLAINS:
            degrees = float(np.degrees(turn_rad))
            yield _finding(
                "mount_slip",
                recording,
                (degrees, "deg"),
                f"from {rests[first].start_s:.1f} s on the unit sits turned by {degrees:.2f} deg "
                f"on its mount: with it rests miss the stand's angles {times**0.5:.2g} times less",
                "fasten the unit and record again",
            )


def loose_mounts(result: CalibrationResult, recordings: Sequence[Recording]) -> Iterator[Finding]:
    """A unit that sits another way on its mount after every move."""
    for recording in recordings:
        rests = _on_a_stand(result, recording)
        if len(rests) < 4 * FEWEST_RESTS:
            continue
        missed, basis, _ = _unexplained(*_against_stand(result, recording, rests))
        # Two of the three components of a direction can miss.
        freedom = max(2 * len(rests) - basis.shape[1], 1)
        degrees = float(np.degrees(np.sqrt(missed @ missed / freedom)))
        if degrees > PLAY_DEG:
            yield _finding(
                "loose_mount",
                recording,
                (degrees, "deg"),
                f"the unit misses the stand's angles by {degrees:.2f} deg (1 sigma) from rest to rest, "
                f"where a firm one misses them by less than {PLAY_DEG} deg: it has play on its mount",
                "fasten the unit and record again",
            )


def _on_a_stand(result: CalibrationResult, recording: Recording) -> list[Rest]:
    """The rests of a recording at which the stand's angles are known."""
    angles = recording.stand_rad
    own = [rest for rest in result.rests if rest.recording == recording.name]
    return [] if angles is None else [r for r in own if np.isfinite(angles[r.first : r.end]).all()]


def _against_stand(
    result: CalibrationResult, recording: Recording, rests: Sequence[Rest]
) -> tuple[FloatArray, FloatArray]:
    """The direction up at each rest and the angles of the motors there, (K, 3) each."""
    assert recording.stand_rad is not None
    raw = np.array([rest.mean_specific_force for rest in rests])
    _, force = result.calibration.apply(np.zeros_like(raw), raw)
    up = force / np.linalg.norm(force, axis=1, keepdims=True)
    return up, np.array([recording.stand_rad[r.first : r.end].mean(axis=0) for r in rests])


def _largest_step(up: FloatArray, angles: FloatArray) -> tuple[int, float, float]:
    """The first rest with another mount, by which angle, and how much smaller chi2 is with it."""
    missed, basis, stand = _unexplained(up, angles)
    best = (0, 0.0, 1.0)
    for first in range(FEWEST_RESTS, len(up) - FEWEST_RESTS + 1):
        after = (np.arange(len(up)) >= first)[:, None]
        step = np.array([(column * after).ravel() for column in stand[:3]]).T
        step = step - basis @ (basis.T @ step)
        turn, *_ = np.linalg.lstsq(step, missed, rcond=None)
        left = missed - step @ turn
        times = float(missed @ missed) / max(float(left @ left), 1e-30)
        if times > best[2]:
            best = (first, float(np.linalg.norm(turn)), times)
    return best


def _unexplained(up: FloatArray, angles: FloatArray) -> tuple[FloatArray, FloatArray, list[FloatArray]]:
    """What the stand's own errors do not explain of the directions, what they do, and their derivatives."""
    none = np.zeros(7)
    mount = best_mount(vertical(none, angles), up)

    def seen(parameters: FloatArray, q: FloatArray) -> FloatArray:
        turned: FloatArray = vertical(parameters, q) @ mount
        return turned

    def slope(by: Callable[[float], FloatArray]) -> FloatArray:
        return (by(STEP_RAD) - by(-STEP_RAD)) / (2 * STEP_RAD)

    stand = [slope(lambda h, p=p: seen(h * np.eye(7)[p], angles)) for p in range(7)]  # type: ignore[misc]
    by_angle = [slope(lambda h, m=m: seen(none, angles + h * np.eye(3)[m])) for m in range(3)]  # type: ignore[misc]
    waves = [
        column * wave(k * angles[:, [motor]])
        for motor, column in enumerate(by_angle)
        for k in (1, 2)
        for wave in (np.sin, np.cos)
    ]
    missed = (up - seen(none, angles)).ravel()
    nuisance = np.array([column.ravel() for column in (*stand, *waves)]).T
    # Free of what the stand's own errors and an eccentricity of the encoders explain.
    u, s, _ = np.linalg.svd(nuisance, full_matrices=False)
    basis = u[:, s > 1e-6 * s[0]]
    return missed - basis @ (basis.T @ missed), basis, stand


def best_mount(told: FloatArray, up: FloatArray) -> FloatArray:
    """The rotation R, (3, 3), with which `told @ R` is nearest to `up`, directions in rows."""
    left, _, right = np.linalg.svd(told.T @ up)
    mount: FloatArray = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    return mount


def vertical(parameters: FloatArray, angles: FloatArray) -> FloatArray:
    """The vertical in the body, (K, 3).

    parameters   mount rotation (3), small, base tilt (2), errors of the right angles (2), rad
    """
    mount, tilt, square = parameters[:3], parameters[3:5], parameters[5:]
    v = np.array([-tilt[1], tilt[0], 1.0]) / np.sqrt(1.0 + tilt @ tilt)
    first, second = np.eye(3)[0], np.array([-np.sin(square[0]), np.cos(square[0]), 0.0])
    third = np.array([0.0, -np.sin(square[1]), np.cos(square[1])])
    turned = np.broadcast_to(v, (len(angles), 3))
    for axis, angle in zip((first, second, third), angles.T, strict=True):
        turned = _turned_back(turned, axis, angle[:, None])
    seen: FloatArray = turned - np.cross(mount, turned)
    return seen


def _turned_back(v: FloatArray, axis: FloatArray, angle: FloatArray) -> FloatArray:
    """Rodrigues' formula for the inverse rotation."""
    along = (v @ axis)[:, None] * axis
    return along + (v - along) * np.cos(angle) - np.cross(axis, v) * np.sin(angle)


def faults_without_effect(
    result: CalibrationResult,
    recordings: Sequence[Recording],
) -> tuple[Finding, ...]:
    """What else may be wrong with recordings in which no effect was found."""
    clock = tuple(_clock(result, recordings))
    return (*clock, *(() if clock else _noise(result, recordings)))


def _clock(result: CalibrationResult, recordings: Sequence[Recording]) -> Iterator[Finding]:
    """Stamps that are no instants of samples: even ones would be nearer."""
    for recording in recordings:
        moves = _Moves(result, recording)
        late = moves.slopes * moves.stamps_s
        # What a stamp adds to the variance of a move, as a share of what noise makes of it.
        if len(late) == 0 or np.mean(late**2) < WORTH_SAYING:
            continue
        if np.sum((moves.noise - late) ** 2 - moves.noise**2) > CLEARLY:
            spread_ms = 1e3 * float(np.std(moves.stamps_s))
            yield _finding(
                "clock_irregular",
                recording,
                (spread_ms, "ms"),
                f"time stamps scatter by {spread_ms:.2g} ms (1 sigma) and rates in moves do not follow them: "
                "the samples were taken at more even instants",
                "replace time by sample number / rate, or take the time stamp from the sensor's own clock",
            )


def _noise(result: CalibrationResult, recordings: Sequence[Recording]) -> Iterator[Finding]:
    """Why moves scatter beyond noise though nothing else does."""
    joint = result.fit.joint
    if joint is None or not (joint.scales.moves or 0.0) > 1.0 or (joint.scales.norms or 0.0) > 1.0:
        return
    for recording in recordings:
        moves = _Moves(result, recording)
        if len(moves.noise) == 0:
            continue
        squares = moves.noise**2
        factor = float(np.mean(squares))
        jitters_s = np.median(np.diff(recording.time_s)) * np.geomspace(1e-3, 1.0, 60)
        by_jitter = [_log_likelihood(squares, 1.0 + (moves.slopes * jitter) ** 2) for jitter in jitters_s]
        best = int(np.argmax(by_jitter))
        louder = _log_likelihood(squares, np.full_like(squares, factor))
        still = _log_likelihood(squares, np.ones_like(squares))
        if factor <= 1.0 or 2 * (max(louder, by_jitter[best]) - still) < CLEARLY:
            continue
        if by_jitter[best] > louder:
            jitter_ms = 1e3 * float(jitters_s[best])
            yield _finding(
                "clock_irregular",
                recording,
                (jitter_ms, "ms"),
                "noise in moves goes with the angular acceleration, as if samples were taken "
                f"{jitter_ms:.2g} ms (1 sigma) off their time stamps",
                "let the sensor's own clock start each sample, and take the time stamp from it",
            )
        else:
            yield _finding(
                "noise_grows_in_motion",
                recording,
                (factor**0.5, "1"),
                f"the gyroscope is {factor**0.5:.2g} times as loud in moves as at rest, and "
                f"standard deviations of moves are widened {joint.scales.moves:.2g} times",
                "look for what vibrates while the unit turns; its noise at rest says too little about moves",
            )


class _Moves:
    """Fourth differences inside the moves, as if they were noise of samples, all three axes in a row.

    noise      of the rate, in units of that at rest, without what jumps
    slopes     of the rate, in the same units, per second
    stamps_s   of the time stamps
    """

    def __init__(self, result: CalibrationResult, recording: Recording) -> None:
        rate = result.calibration.apply_recording(recording).angular_rate
        noise = np.diff(rate, n=4, axis=0) / FOURTH
        # Even steps, and some neighbours: stamps and noise are what is asked for.
        step_s = (recording.time_s[-1] - recording.time_s[0]) / (len(rate) - 1)
        slope = np.gradient(rate, step_s, axis=0)[2:-2]
        smooth = np.stack([np.convolve(axis, np.full(5, 0.2), mode="same") for axis in slope.T], axis=1)

        def stretches(items: Sequence[Rest] | Sequence[Move], last: str) -> list[int]:
            own = [i for i in items if i.recording == recording.name and i.excluded is None]
            return [k for item in own for k in range(item.first, getattr(item, last) - 4, APART)]

        at_rest, inside = noise[stretches(result.rests, "end")], stretches(result.moves, "last")
        sigma = np.sqrt(np.mean(at_rest**2, axis=0, where=_is_noise(at_rest))) if len(at_rest) else np.ones(3)
        known = _is_noise(noise[inside])
        self.noise = (noise[inside] / sigma)[known]
        self.slopes = (smooth[inside] / sigma)[known]
        self.stamps_s = np.repeat(np.diff(recording.time_s, n=4)[inside, None] / FOURTH, 3, axis=1)[known]


def _is_noise(differences: FloatArray) -> NDArray[np.bool_]:
    """Which are no jumps of a sample, as far as the others show, (K, 3).

    A rest is where samples do not jump: those in moves would count for noise that rests do not have.
    """
    if len(differences) == 0:
        return np.ones(differences.shape, dtype=bool)
    size = np.abs(differences)
    typical = np.median(size, axis=0) / MEDIAN
    # Where most differences are zero, counts are so coarse that jumps are all the noise there is.
    within: NDArray[np.bool_] = size <= np.where(typical > 0, JUMP * typical, np.inf)
    return within


def _log_likelihood(squares: FloatArray, variance: FloatArray) -> float:
    return float(-0.5 * np.sum(np.log(variance) + squares / variance))


def _finding(
    code: str, recording: Recording, value: tuple[float, str], message: str, way_out: str
) -> Finding:
    number, unit = value
    stand = ("stand_1", "stand_2", "stand_3")
    columns = {"clock_irregular": ("time_s",), "mount_slip": stand, "loose_mount": stand}.get(code, ())
    return Finding(code, "warning", recording.name, columns, None, 1, float(number), unit, message, way_out)
