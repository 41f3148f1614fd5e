"""The motion that distinguishes between effects that the recordings cannot distinguish (T-optimality).

    T(a, b) = min over delta, theta_b of |J_a theta_a - J_base delta - J_b theta_b|^2

Effect a, with its estimated parameters theta_a, causes residuals. The rival b (parameters theta_b) and the 21
base parameters (changes delta) are fitted to these residuals, and T(a, b) is the chi2 that remains. Residuals
are divided by their standard deviation. A motion distinguishes between effects if T(a, b) and T(b, a) are
large for all rivals (Atkinson and Fedorov, Biometrika 62, 1975, 57-70). J_a, J_b and J_base are the
Jacobians of the residuals with respect to the parameters, as in the search for effects. They are evaluated
on the present recordings and on a simulated recording of the motion.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

import imucal._core as _core
from imucal.document.plain import plain
from imucal.effects.effect import Effect
from imucal.effects.table import catalogue, find
from imucal.errors import ImucalError
from imucal.gap.motion_library import Suggestion, suggestions
from imucal.recording.recording import Recording
from imucal.rig.temperature import Temperature
from imucal.rig.unit import Sensor, Unit

if TYPE_CHECKING:
    from imucal.arrays import FloatArray
    from imucal.estimation.result import CalibrationResult
    from imucal.gap.question import Question

__all__ = ["next_motion"]

# A motion distinguishes between an effect and its rival if the expected chi2 T(effect, rival), defined at the
# top of this file, exceeds this number. The log likelihood ratio of the true effect to its rival has the mean
# chi2 / 2 and the standard deviation sqrt(chi2). For chi2 = 30, the log likelihood ratio is 15 +- 5.5 nats.
SEPARATES: Final = 30.0
# Seed of the noise of simulated recordings.
SEED: Final = 3
# Lower bounds of the noise densities of the simulated unit, m/s^2/sqrt(Hz) and rad/s/sqrt(Hz). They are
# needed for present recordings that were themselves simulated without noise.
LEAST_DENSITY: Final = (1e-5, 1e-6)
# Trial time constants of effects, as shares of the duration of the longest recording.
SHAPE_SHARES: Final = (0.03, 0.1, 0.3, 1.0)

Design = tuple["FloatArray", Mapping[str, Sequence["FloatArray"]]]


@dataclass(frozen=True, eq=False)
class _Pair:
    """An effect with its estimated parameters, and a rival.

    values   estimated parameters of the effect, SI units
    shape    estimated time constant of the effect, s; None for an effect without one
    beside   names of the other effects in the model
    """

    name: str
    rival: str
    values: FloatArray
    shape: float | None
    beside: tuple[str, ...]


def next_motion(question: Question, analysis: _core.GapAnalysis, after: CalibrationResult) -> dict[str, Any]:
    """The next motion to record: description, stand program, and expected chi2 that distinguishes the rivals.

    `chi2_now` is the expected chi2 with the present recordings, and `chi2_predicted` with the motion.

    after   calibration with the accepted effects
    """
    from imucal.rig.motion import SCHEMA

    known = {effect.name: effect for effect in catalogue()}
    path = tuple(score.name for score in analysis.effects)
    rivals = {name: [rival for of, rival, _ in analysis.rivals if of == name] for name in path}
    names = {*path, *(rival for of in rivals.values() for rival in of)}
    needs = frozenset(need for name in names & set(known) for need in known[name].needs)
    pairs = list(_pairs(analysis, path, after)) if names <= set(known) else []
    hints = _distinctions(known, rivals)
    now = _separation(question, None, pairs, after)
    best: tuple[float, Suggestion] | None = None
    # The catalogue recommends motions for distinguishing pairs of effects. These motions are tried first.
    library = sorted(
        suggestions(question.recordings, needs), key=lambda s: not any(s.answers in words for words in hints)
    )
    for suggestion in library:
        question.stage(f"trying the next motion: {suggestion.words}")
        chi2 = _separation(question, suggestion, pairs, after)
        if best is None or chi2 > best[0]:
            best = (chi2, suggestion)
        if chi2 > SEPARATES:
            break
    assert best is not None
    chi2, suggestion = best
    words = [*hints, suggestion.words]
    if pairs:
        used = "this motion alone" if suggestion.on_its_own else "the present recordings and this motion"
        words.append(
            f"the expected chi2 that distinguishes these effects is {chi2:.0f} with {used}, and {now:.1f} "
            "with the present recordings alone"
        )
        if chi2 <= SEPARATES:
            words.append(
                "no known motion distinguishes these effects with certainty; this motion is the best"
            )
    if suggestion.on_its_own:
        words.append("search for effects in that recording alone")
    return {
        "description": "; ".join(words),
        "program": {"schema": SCHEMA, **plain(suggestion.program.to_dict())},
        "simulate": [] if suggestion.temperature is None else ["--temperature", suggestion.temperature],
        "on_its_own": suggestion.on_its_own,
        "chi2_now": now if pairs else None,
        "chi2_predicted": chi2 if pairs else None,
    }


def _distinctions(known: Mapping[str, Effect], rivals: Mapping[str, Sequence[str]]) -> list[str]:
    """Advice of the catalogue on how to distinguish each pair of effects."""
    words = []
    for name, of in rivals.items():
        for rival in of:
            for one, other in ((name, rival), (rival, name)):
                aliases = known[one].aliases if one in known else ()
                found = next((alias for alias in aliases if alias.name == other), None)
                if found is not None:
                    words.append(f"{name} and {rival} are distinguished by {found.told_apart_by}")
                    break
    return words


def _pairs(analysis: _core.GapAnalysis, path: tuple[str, ...], after: CalibrationResult) -> Iterator[_Pair]:
    """Pairs of effects to distinguish, as (accepted effect, rival) and as (rival, accepted effect)."""
    for name, rival, estimate in analysis.rivals:
        beside = tuple(other for other in path if other != name)
        own = next(values for values in after.calibration.effects if values.name == name)
        yield _Pair(name, rival, own.values, own.shape, beside)
        # If a rival cannot be fitted, it has no estimate. Then only the pair (accepted effect, rival) is
        # used.
        if estimate is not None:
            yield _Pair(rival, name, estimate.values, estimate.shape, beside)


def _separation(
    question: Question, suggestion: Suggestion | None, pairs: Sequence[_Pair], after: CalibrationResult
) -> float:
    """Smallest expected chi2 T(a, b) (see the module) over all pairs; zero if parameters are not determined.

    The chi2 is computed for the present recordings together with the suggested motion, or for this motion
    alone if `suggestion.on_its_own` is set. Without a suggestion, it is computed for the present recordings.
    """
    if not pairs:
        return 0.0
    recordings = list(question.recordings)
    if suggestion is not None:
        further = _simulated(question, suggestion, after)
        recordings = [further] if suggestion.on_its_own else [*recordings, further]
    names = sorted({name for pair in pairs for name in (pair.name, pair.rival, *pair.beside)})
    try:
        design = _design(question, recordings, names)
    except ImucalError:
        return 0.0
    longest_s = max(float(np.ptp(recording.time_s)) for recording in recordings)
    return min(_chi2(design, pair, longest_s) for pair in pairs)


def _design(question: Question, recordings: Sequence[Recording], names: Sequence[str]) -> Design:
    found = _core.gap_design(recordings, question.options, [(name, find(name).plain) for name in names])
    base, candidates = found.base, found.effects
    # The matrix of the Jacobian columns is replaced by the factor R of its QR decomposition. R has fewer
    # rows, and the inner products of its columns are the same.
    whole: FloatArray = np.asarray(np.linalg.qr(np.hstack([base, *(of for _, of in candidates)]), mode="r"))
    columns: dict[str, list[FloatArray]] = {}
    at = base.shape[1]
    for name, of in candidates:
        columns.setdefault(name, []).append(whole[:, at : at + of.shape[1]])
        at += of.shape[1]
    return whole[:, : base.shape[1]], columns


def _chi2(design: Design, pair: _Pair, longest_s: float) -> float:
    """Expected chi2 T(a, b) of an effect a after a fit of its rival b and of the rival's time constant."""
    base, columns = design
    if pair.name not in columns or pair.rival not in columns:
        return 0.0
    own = columns[pair.name]
    chosen = 0
    if pair.shape is not None and len(own) > 1:
        shapes = np.array(SHAPE_SHARES[: len(own)]) * longest_s
        chosen = int(np.argmin(np.abs(np.log(shapes / pair.shape))))
    trace = own[chosen] @ pair.values[: own[chosen].shape[1]]
    beside = [columns[name][0] for name in pair.beside if name in columns]
    rivals = columns[pair.rival]
    if len(rivals) > 1:
        # A fit of the rival, the other effect of the pair, would also estimate its time constant. Linear
        # combinations of the rival's columns at two adjacent time constants of `SHAPE_SHARES` approximate its
        # columns at any time constant between the two.
        rivals = [np.hstack(both) for both in itertools.pairwise(rivals)]
    return min(_residual_norm2(trace, np.hstack([base, *beside, rival])) for rival in rivals)


def _residual_norm2(trace: FloatArray, columns: FloatArray) -> float:
    """Squared norm of the part of a vector that is orthogonal to all columns."""
    size = np.linalg.norm(columns, axis=0)
    known = columns[:, size > 0] / size[size > 0]
    basis, values, _ = np.linalg.svd(known, full_matrices=False)
    basis = basis[:, values > 1e-9 * values[0]]
    return float(np.sum((trace - basis @ (basis.T @ trace)) ** 2))


def _simulated(question: Question, suggestion: Suggestion, after: CalibrationResult) -> Recording:
    """Simulate the motion with the triads and noise of the calibration, without effects."""
    from imucal.simulation.simulate import simulate

    calibration = after.calibration
    densities = [
        [calibration.noise[f"{sensor}_noise_density_{axis}_{unit}_per_sqrt_hz"] for axis in "xyz"]
        for sensor, unit in (("accel", "mps2"), ("gyro", "radps"))
    ]
    accel, gyro = (np.maximum(of, least) for of, least in zip(densities, LEAST_DENSITY, strict=True))
    accelerometer, gyroscope = (
        Sensor(
            triad.sensitivity,
            triad.bias,
            # The density is converted to raw units, because the simulation adds noise to raw samples.
            noise_density=float(np.mean(density) * np.cbrt(abs(np.linalg.det(triad.sensitivity)))),
        )
        for triad, density in zip(calibration.both(), (accel, gyro), strict=True)
    )
    first = question.recordings[0]
    temperature: Any = suggestion.temperature
    if temperature is None and first.temperature_degc is not None:
        # A temperature profile needs finite values at increasing times.
        rises = np.diff(np.maximum.accumulate(first.time_s), prepend=-np.inf) > 0
        known = rises & np.isfinite(first.temperature_degc)
        if known.any():
            temperature = Temperature(first.time_s[known] - first.time_s[0], first.temperature_degc[known])
    rate_hz = (len(first) - 1) / float(np.ptp(first.time_s))
    made = simulate(
        suggestion.program,
        seed=SEED,
        unit=Unit(accelerometer, gyroscope),
        rate_hz=rate_hz,
        gravity_mps2=question.options.gravity_mps2,
        temperature=temperature,
    ).recording
    keeps_angles = suggestion.encoders or all(r.stand_rad is not None for r in question.recordings)
    return replace(
        made,
        accel_unit=first.accel_unit,
        gyro_unit=first.gyro_unit,
        stand_rad=made.stand_rad if keeps_angles else None,
        name="next",
    )
