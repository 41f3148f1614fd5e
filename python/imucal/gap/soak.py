"""How the biases of a unit at rest in one pose change with temperature.

    found = imucal.soak(sweep)
    found.gyroscope.terms, found.gyroscope.left

A soak or a temperature sweep in one pose does not determine scales or misalignments. It determines how the
mean reading depends on the temperature and on the temperature history. The recording is divided into epochs
with about equal numbers of samples, and averaged over each epoch. Models with polynomials in the temperature,
its rate, one or two lags, and hysteresis are compared by cross-validation: each model is fitted by least
squares to nine tenths of the epochs and predicts the other epochs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from typing import Final

import numpy as np
import numpy.typing as npt

import imucal._core as _core
from imucal.arrays import FloatArray
from imucal.calibration.calibration import Calibration
from imucal.errors import InputError
from imucal.gap.soak_result import Soak, SoakedSensor, SoakTerm
from imucal.gap.temperature_history import TemperatureHistory
from imucal.recording.recording import Recording, samples_of_both

__all__ = ["is_soak", "soak"]

# Maximum number of epochs. Readings are averaged over each epoch, which has `LEAST_SAMPLES` samples or more.
EPOCHS: Final = 240
LEAST_SAMPLES: Final = 10
# Minimum number of epochs, and minimum range of their temperatures, K. Recordings with fewer epochs or a
# smaller range are refused.
LEAST_EPOCHS: Final = 40
LEAST_RANGE_K: Final = 2.0
# Number of folds of the cross-validation. Epochs are held out in blocks of `BLOCK` consecutive epochs, so
# that slow variations cannot be predicted from adjacent epochs.
FOLDS: Final = 10
BLOCK: Final = 3
# A simpler model is preferred if its prediction of held-out epochs is worse than the best prediction by at
# most this number of standard errors over the folds. In tests on sensors with a constant reading, a model
# with a temperature term was wrongly chosen for one of eight sensors with the threshold 1, and for none of 40
# with the threshold 2.
STANDARD_ERRORS: Final = 2.5
# Maximum angle between the gravity direction of an epoch and the median direction, rad. A larger angle means
# that the unit was moved.
MOST_TURN_RAD: Final = 0.35
# The time constant of a lag is searched in ROUNDS rounds with TAUS trial values each. Each round searches
# between the neighbours of the best value of the previous round. In the last round, consecutive trial values
# differ by at most 2 %. For two lags, the first round compares all pairs of values, and the other rounds
# search one time constant after the other.
TAUS: Final = 11
ROUNDS: Final = 3
AXES: Final = "xyz"
REFERENCE_DEGC: Final = _core.REFERENCE_TEMPERATURE_DEGC
# Formulas of each kind of term, in ascending order of the degree of the polynomial. T is the temperature, T0
# the reference temperature, T_tau the lagged temperature, and s the direction of the temperature change.
FORMULAS: Final = {
    "polynomial": (
        "k (T - T0)",
        "k (T - T0) + q (T - T0)^2",
        "k (T - T0) + q (T - T0)^2 + c (T - T0)^3",
    ),
    "rate": ("k dT/dt",),
    "lag": (
        "k (T_tau - T), tau dT_tau/dt = T - T_tau",
        "(k + q (T - T0)) (T_tau - T), tau dT_tau/dt = T - T_tau",
        "(k + q (T - T0) + c (T - T0)^2) (T_tau - T), tau dT_tau/dt = T - T_tau",
    ),
    "hysteresis": ("k s", "s (k + q (T - T0))", "s (k + q (T - T0) + c (T - T0)^2)"),
}
# Suffixes of the names of parameters, such as x_square, by kind of term and degree.
SUFFIXES: Final = {
    "polynomial": ("", "_square", "_cube"),
    "rate": ("",),
    "lag": ("", "_linear", "_square"),
    "hysteresis": ("", "_linear", "_square"),
}
# Suffixes, by kind of term and degree, that are appended to the unit of the reading in units of parameters.
UNITS: Final = {
    "polynomial": ("/K", "/K^2", "/K^3"),
    "rate": ("/(K/s)",),
    "lag": ("/K", "/K^2", "/K^3"),
    "hysteresis": ("", "/K", "/K^2"),
}
SENSORS: Final = {"gyroscope": "gyro", "accelerometer": "accel"}


@dataclass(frozen=True)
class Form:
    """A model of the mean reading of one sensor.

    effects   name and number of parameters of each effect; the last effects are lags
    taus_s    time constant of each lag, s
    """

    effects: tuple[tuple[str, int], ...] = ()
    taus_s: tuple[float, ...] = ()

    @property
    def size(self) -> int:
        """Number of parameters of all axes, including the time constants."""
        return sum(count for _, count in self.effects) + len(self.taus_s)

    @property
    def terms(self) -> Iterator[tuple[str, int, float | None]]:
        """Name, number of parameters and time constant of each effect."""
        plain = len(self.effects) - len(self.taus_s)
        for (name, count), tau_s in zip(self.effects, (None,) * plain + self.taus_s, strict=True):
            yield name, count, tau_s


def soak(recording: Recording, *, calibration: Calibration | None = None) -> Soak:
    """Find how the biases depend on the temperature, from a recording at rest in one pose.

    recording    a soak or a sweep with temperatures; a longer recording over a wider range gives better
                 results
    calibration  calibration of the unit, without temperature effects, with which the readings are corrected;
                 without a calibration, the readings must be in SI units

    Raises InputError for missing temperatures, too few samples, a small temperature range, or a moved unit.
    """
    recording = _corrected(recording, calibration)
    edges, degc, epoch_degc = _epochs(recording)
    history = TemperatureHistory(recording.time_s, degc)
    force, rate = (np.asarray(rows, dtype=np.float64) for rows in samples_of_both(recording))
    gyroscope, accelerometer = (
        _Search(name, _means(rows, edges), degc, history, edges).result()
        for name, rows in (("gyroscope", rate), ("accelerometer", force))
    )
    times = _means((recording.time_s - recording.time_s[0])[:, None], edges)[:, 0]
    return Soak(recording.name, times, epoch_degc, gyroscope, accelerometer)


def is_soak(recording: Recording) -> bool:
    """Whether the recording is at rest in one pose while its temperature changes."""
    try:
        _epochs(recording)
    except InputError:
        return False
    return True


def _epochs(recording: Recording) -> tuple[npt.NDArray[np.intp], FloatArray, FloatArray]:
    """Edges of the epochs, the temperature of each sample, and the mean temperature of each epoch.

    Raises InputError if the recording is no soak.
    """
    degc = recording.temperature_degc
    if degc is None or not np.isfinite(degc).all():
        raise InputError(
            f"{recording.name}: a soak needs a temperature of every sample (temp_degc in a file)"
        )
    edges = _edges(len(recording))
    epoch_degc = _means(degc[:, None], edges)[:, 0]
    if np.ptp(epoch_degc) < LEAST_RANGE_K:
        raise InputError(
            f"{recording.name}: the temperature changes by {np.ptp(epoch_degc):.1f} K: record a soak over "
            f"{LEAST_RANGE_K:g} K or more"
        )
    force, _ = samples_of_both(recording)
    _require_one_pose(recording.name, _means(np.asarray(force, dtype=np.float64), edges))
    return edges, np.asarray(degc, dtype=np.float64), epoch_degc


def _corrected(recording: Recording, calibration: Calibration | None) -> Recording:
    """The readings in SI units. Raises InputError for a calibration with temperature effects."""
    if calibration is None:
        if (recording.accel_unit, recording.gyro_unit) != ("m/s^2", "rad/s"):
            raise InputError(
                f"{recording.name} is in raw counts: give the calibration of the unit with --calibration"
            )
        return recording
    if calibration.temperature_effects:
        raise InputError(
            f"the calibration has {' and '.join(calibration.temperature_effects)}: give a calibration "
            "without temperature effects"
        )
    return calibration.apply_recording(recording)


def _edges(samples: int) -> npt.NDArray[np.intp]:
    count = min(EPOCHS, samples // LEAST_SAMPLES)
    if count < LEAST_EPOCHS:
        raise InputError(f"the soak has {samples} samples: {LEAST_EPOCHS * LEAST_SAMPLES} or more are needed")
    return np.linspace(0, samples, count + 1).astype(np.intp)


def _means(rows: FloatArray, edges: npt.NDArray[np.intp]) -> FloatArray:
    sums = np.add.reduceat(rows, edges[:-1], axis=0)
    means: FloatArray = sums / np.diff(edges).reshape(-1, *(1,) * (rows.ndim - 1))
    return means


def _require_one_pose(name: str, force: FloatArray) -> None:
    up = force / np.linalg.norm(force, axis=1, keepdims=True)
    middle = np.median(up, axis=0)
    turn = float(np.arccos(np.clip(up @ (middle / np.linalg.norm(middle)), -1.0, 1.0)).max())
    if not turn < MOST_TURN_RAD:
        raise InputError(
            f"{name}: the direction of gravity changes by {np.degrees(turn):.0f} deg, so the unit was moved: "
            "a soak is at rest in one pose; imucal gap searches recordings in several poses"
        )


def _scaled(columns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The columns of a matrix, each divided by its largest magnitude, and these magnitudes."""
    size = np.maximum(np.abs(columns).max(axis=0), 1e-300)
    return columns / size, size


class _Search:
    """Compares models of the mean reading of one sensor by their predictions of held-out epochs."""

    def __init__(
        self,
        sensor: str,
        mean: FloatArray,
        degc: FloatArray,
        history: TemperatureHistory,
        edges: npt.NDArray[np.intp],
    ) -> None:
        self.sensor, self.mean, self.edges = sensor, mean, edges
        self.prefix = f"{SENSORS[sensor]}_bias_temperature"
        self.difference, self.history = degc - REFERENCE_DEGC, history
        folds = (np.arange(len(mean)) // BLOCK) % FOLDS
        self.of_fold = [np.flatnonzero(folds == fold) for fold in range(FOLDS)]
        self.known: dict[tuple[str, float | None], FloatArray] = {}
        self.cubic = Form(((self.prefix, 9),))
        # The residuals of each axis are divided by the rms residual of a cubic polynomial in the temperature,
        # so that all axes have similar weights.
        self.scale = np.sqrt((self._held_out(self.cubic) ** 2).mean(axis=0))
        self.scale = np.maximum(self.scale, np.finfo(np.float64).tiny)

    def _columns(self, form: Form) -> FloatArray:
        """Matrix of the linear fit: a column of ones, and the columns of the terms, (N, 1 + p)."""
        columns = [np.ones((len(self.mean), 1))]
        for name, count, tau_s in form.terms:
            if (name, tau_s) not in self.known:
                cause = self._cause(name, tau_s)
                powers = np.column_stack([cause, cause * self.difference, cause * self.difference**2])
                self.known[name, tau_s] = _means(powers, self.edges)
            columns.append(self.known[name, tau_s][:, : count // 3])
        return np.hstack(columns)

    def _cause(self, name: str, tau_s: float | None) -> FloatArray:
        """The variable of a term at each sample: temperature, or its lag, rate or direction of change."""
        if tau_s is not None:
            return self.history.lag_k(tau_s)
        if name.endswith("_rate"):
            return self.history.rate_kps
        return self.history.direction if name.endswith("_hysteresis") else self.difference

    def _fit(self, form: Form) -> FloatArray:
        """Coefficients of the linear fit of a form, for all axes, (1 + p, 3)."""
        columns, size = _scaled(self._columns(form))
        found = np.linalg.lstsq(columns, self.mean, rcond=1e-10)[0]
        solved: FloatArray = found / size[:, None]
        return solved

    def _held_out(self, form: Form) -> FloatArray:
        """Mean of each epoch minus its prediction by a fit to the other folds, (N, 3)."""
        basis, sizes, _ = np.linalg.svd(_scaled(self._columns(form))[0], False)
        basis = basis[:, sizes > 1e-10 * sizes[0]]
        # The columns of `basis` are orthonormal, so the normal matrix of a fit to the other folds is the unit
        # matrix minus the normal matrix of the held-out fold. If only the held-out fold determines a linear
        # combination of the parameters, the difference is singular. Adding 1e-10 keeps it invertible.
        parts = [(basis[own], self.mean[own]) for own in self.of_fold]
        normals = np.stack([basis_of.T @ basis_of for basis_of, _ in parts])
        sums = basis.T @ self.mean - np.stack([basis_of.T @ mean for basis_of, mean in parts])
        fitted = np.linalg.solve((1.0 + 1e-10) * np.eye(basis.shape[1]) - normals, sums)
        residual = np.empty_like(self.mean)
        for own, (basis_of, mean), values in zip(self.of_fold, parts, fitted, strict=True):
            residual[own] = mean - basis_of @ values
        return residual

    def _errors(self, form: Form) -> FloatArray:
        """Mean squared held-out residual in each fold, (FOLDS,).

        The residuals are divided by the rms held-out residual of a cubic polynomial in the temperature.
        """
        squares = ((self._held_out(form) / self.scale) ** 2).mean(axis=1)
        return np.array([squares[own].mean() for own in self.of_fold])

    def _forms(self) -> Iterator[Form]:
        """All models without a lag."""
        rate, turn = f"{self.prefix}_rate", f"{self.prefix}_hysteresis"
        others: Sequence[tuple[tuple[str, int], ...]] = (
            (), ((rate, 3),), ((turn, 3),), ((turn, 6),), ((turn, 9),), ((rate, 3), (turn, 3)),
        )  # fmt: skip
        for degree, other in product(range(4), others):
            own = ((self.prefix, 3 * degree),) if degree else ()
            yield Form((*own, *other))

    def _with_lags(self, form: Form, counts: tuple[int, ...]) -> Form:
        """The form with additional lags, with the time constants that fit best.

        counts   number of parameters of each additional lag
        """
        effects = (*form.effects, *((f"{self.prefix}_lag", count) for count in counts))
        span_s = self.history.duration_s
        grid = np.geomspace(max(span_s / 300.0, 1.0), span_s / 2.0, TAUS)

        def error(taus_s: tuple[float, ...]) -> float:
            return float(self._errors(Form(effects, taus_s)).mean())

        best = min(combinations(map(float, grid), len(counts)), key=error)
        ratio = float(grid[1] / grid[0])
        for _ in range(ROUNDS - 1):
            for k in range(len(counts)):
                trials = best[k] * np.geomspace(1.0 / ratio, ratio, TAUS)
                best = min(((*best[:k], float(tau_s), *best[k + 1 :]) for tau_s in trials), key=error)
            ratio = float(ratio ** (2.0 / (TAUS - 1)))
        return Form(effects, best)

    def _lagged(self, plain: Sequence[Form], lags: int) -> Iterator[Form]:
        """Models with one or two lags.

        To first order, the lag of a polynomial in the temperature is its derivative times the lag of the
        temperature. In a model with two lags, the coefficients of the lags are therefore polynomials whose
        degree is less by one than that of the bias.
        """
        turn = f"{self.prefix}_hysteresis"
        for form in plain:
            if form.effects[:1] not in [((self.prefix, 3 * degree),) for degree in (1, 2, 3)]:
                continue
            own, others = form.effects[0][1], form.effects[1:]
            if lags == 1 and others in ((), ((turn, 3),), ((turn, 9),)):
                yield self._with_lags(form, (3,))
            if others == () and (lags == 2 or own > 3):
                yield self._with_lags(form, (own,) * lags)

    def best(self) -> Form:
        """The simplest model whose prediction is not significantly worse than the best prediction."""
        plain = list(self._forms())
        errors = {form: self._errors(form) for form in [*plain, *self._lagged(plain, 1)]}

        def first() -> Form:
            return min(errors, key=lambda form: float(errors[form].mean()))

        # Two lags are compared only if one lag predicts better than every model without a lag.
        if first().taus_s:
            errors.update({form: self._errors(form) for form in self._lagged(plain, 2)})
        best = errors[first()]

        def is_as_good(form: Form) -> bool:
            change = errors[form] - best
            return bool(change.mean() <= STANDARD_ERRORS * change.std(ddof=1) / np.sqrt(FOLDS))

        return min(filter(is_as_good, errors), key=lambda form: form.size)

    def result(self) -> SoakedSensor:
        """The best model, fitted to all epochs."""
        form = self.best()
        solved = self._fit(form)
        fitted = self._columns(form) @ solved
        cubic = self._columns(self.cubic) @ self._fit(self.cubic)
        held_out = np.sqrt((self._held_out(form) ** 2).mean(axis=0))
        columns, size = _scaled(self._columns(form))
        spread = np.sqrt(np.diag(np.linalg.pinv(columns.T @ columns))) / size
        unit = "rad/s" if self.sensor == "gyroscope" else "m/s^2"
        tau_stds = iter(self._tau_stds(form))
        terms, place = [], 1
        for name, count, tau_s in form.terms:
            kind = name.removeprefix(f"{self.prefix}_") if name != self.prefix else "polynomial"
            values, std, units = {}, {}, {}
            for degree in range(count // 3):
                for axis in range(3):
                    own = AXES[axis] + SUFFIXES[kind][degree]
                    values[own] = float(solved[place + degree, axis])
                    std[own] = float(held_out[axis] * spread[place + degree])
                    units[own] = f"{unit}{UNITS[kind][degree]}"
            if tau_s is not None:
                values["tau"], std["tau"], units["tau"] = tau_s, next(tau_stds), "s"
            terms.append(SoakTerm(name, FORMULAS[kind][count // 3 - 1], values, std, units))
            place += count // 3
        constant = solved[0]
        return SoakedSensor(
            self.sensor, unit, tuple(terms), constant, self.mean, fitted, cubic, held_out, self.scale
        )

    def _tau_stds(self, form: Form) -> FloatArray:
        """Standard deviations of the time constants, from the curvature of the squared residuals, s."""
        taus_s, step = np.array(form.taus_s), 0.1

        def squares(logs: FloatArray) -> float:
            own = Form(form.effects, tuple(map(float, taus_s * np.exp(logs))))
            left = (self.mean - self._columns(own) @ self._fit(own)) / self.scale
            return float((left**2).sum())

        steps = step * np.eye(len(taus_s))
        curvature = np.array(
            [
                [squares(a + b) - squares(a - b) - squares(b - a) + squares(-a - b) for b in steps]
                for a in steps
            ]
        ).reshape(len(taus_s), len(taus_s)) / (4.0 * step**2)
        noise = squares(np.zeros(len(taus_s))) / (3.0 * len(self.mean))
        if not (np.linalg.eigvalsh(curvature) > 0.0).all():
            return np.full(len(taus_s), np.nan)
        stds: FloatArray = taus_s * np.sqrt(2.0 * noise * np.diag(np.linalg.inv(curvature)))
        return stds
