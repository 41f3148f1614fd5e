"""The candidate forms of laws: formulas of one or two input variables, in groups by sensor and variables.

The input variables are observed quantities: the rate or force along an axis, temperature, time, time since
the last motion, angles of a stand, and further columns. The forms of a variable are powers, a limiter, steps,
harmonics and decays, each with trial values of its constant. A limiter together with the linear scale
describes a dead zone or a saturation.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.gap.columns import usable_columns
from imucal.recording.recording import Recording, samples_of_both

__all__ = ["Form", "further_forms", "library", "refined"]

# Some forms that depend on the rate or force have a constant, such as the limit of a saturation. Trial values
# of the constant are these quantiles of the magnitudes of the rate or force components. For the rate, the
# quantiles are taken over the samples in motion, and for the force over all samples.
SHARES: Final = (0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9)
# Trial values of a column at which a bias has a step, and of the temperature at which the slope of a bias
# changes, as shares of the range of the column or temperature.
STEPS: Final = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
# Trial periods of sine and cosine forms, as multiples of the range of the input variable.
PERIODS: Final = (1.0, 0.8, 0.65, 0.5, 0.4, 0.33, 0.26)
# Trial time constants of an exponential decay after each motion, s.
SETTLING_S: Final = (0.3, 0.6, 1.2, 2.5, 5.0, 10.0)
# Trial time constants of an exponential decay since power-on, as shares of the duration of the recording.
WARM_UPS: Final = (0.03, 0.06, 0.12, 0.25, 0.5)
# Angular rate above which samples count as motion, rad/s.
MOVING_RADPS: Final = 0.1
# Laws that depend on temperature are tried if the temperature varies by at least this number, K.
LEAST_CHANGE_K: Final = 2.0
# Sine and cosine forms of an angle are tried if the range of the angle is at least this number, rad. Over a
# smaller range, they cannot be distinguished from powers of the angle.
LEAST_ANGLE_RAD: Final = np.pi
# After a form is selected, its constant is refined: the constant is multiplied by each of these factors, and
# the best product is used. The factors cover the interval between adjacent trial values.
REFINEMENT: Final = (0.7, 0.76, 0.82, 0.88, 0.94, 1.0, 1.06, 1.13, 1.21, 1.3, 1.4)
_Make = Callable[..., "Form"]
# Approximate number of samples of each recording from which quantiles are computed.
SAMPLES: Final = 20000


@dataclass(frozen=True)
class Form:
    """A formula that a law can have.

    sensor     "gyro" or "accel"
    driver     name, in formulas, of the variable on which the law depends
    pattern    the expression, with {c} for the constant
    constant   value of the constant; None if the expression has none
    variables  all variables of the expression
    cost       measure of complexity; of equally good forms with the same variables, the one with the smallest
               cost is chosen
    """

    sensor: str
    driver: str
    pattern: str
    constant: float | None
    variables: tuple[str, ...]
    cost: int

    @property
    def expression(self) -> str:
        """The expression, with the value of the constant inserted."""
        return self.pattern if self.constant is None else self.pattern.format(c=f"{self.constant:.4g}")

    @property
    def group(self) -> tuple[str, tuple[str, ...]]:
        """Sensor and variables of the form. Forms with the same sensor and variables are alternatives."""
        return self.sensor, self.variables

    def text(self, name: str) -> str:
        """The form, written as the formula of an effect with this name."""
        return f"{name} = {self.sensor}: {self.expression}"


def library(recordings: Sequence[Recording]) -> list[Form]:
    """The candidate forms of laws whose input variables vary in these corrected recordings."""
    forms: list[Form] = []
    for sensor in ("gyro", "accel"):
        forms += _of_sensor(sensor, recordings)
    return forms


def refined(form: Form) -> list[Form]:
    """Variants of the form with constants near its constant; empty for a form without a constant."""
    if form.constant is None:
        return []
    return [
        Form(form.sensor, form.driver, form.pattern, form.constant * factor, form.variables, form.cost)
        for factor in REFINEMENT
    ]


def _of_sensor(sensor: str, recordings: Sequence[Recording]) -> Iterator[Form]:
    own = "w" if sensor == "gyro" else "f"
    rate = np.concatenate([_thinned(np.asarray(samples_of_both(r)[1], float)) for r in recordings])
    force = np.concatenate([_thinned(np.asarray(samples_of_both(r)[0], float)) for r in recordings])
    duration_s = max(float(r.time_s[-1] - r.time_s[0]) for r in recordings)

    def form(driver: str, pattern: str, constant: float | None = None, cost: int = 1, *more: str) -> Form:
        return Form(sensor, driver, pattern, constant, (driver, *more), cost)

    moving = np.linalg.norm(rate, axis=1) > MOVING_RADPS
    for driver, values in (("w", np.abs(rate[moving])), ("f", np.abs(force))):
        if values.size == 0:
            continue
        yield from _smooth(form, driver, values.ravel(), is_own=driver == own)
    yield form("w_norm", "k*w_norm")
    yield form("w_norm", "k*w_norm**2", None, 2)
    yield form("w", f"k*{own}*w_norm" if own == "w" else "k*w*abs(w)", None, 2)
    for axis in "xyz":
        if sensor == "gyro":
            yield Form(sensor, "f", f"k*w*f_{axis}", None, ("f", "w"), 2)
    yield form("time_s", "k*time_s**2", None, 2)
    for share in WARM_UPS:
        yield form("time_s", "k*exp(-time_s/{c})", share * duration_s, 2)
    for tau_s in SETTLING_S:
        yield form("rest_s", "k*exp(-rest_s/{c})", tau_s, 2)
    yield from _of_temperature(form, sensor, recordings)
    yield from _of_further(sensor, recordings)


def further_forms(recordings: Sequence[Recording]) -> list[Form]:
    """The candidate forms of laws whose input variables are angles of a stand or auxiliary columns."""
    return [form for sensor in ("gyro", "accel") for form in _of_further(sensor, recordings)]


def _of_further(sensor: str, recordings: Sequence[Recording]) -> Iterator[Form]:
    def form(driver: str, pattern: str, constant: float | None = None, cost: int = 1, *more: str) -> Form:
        return Form(sensor, driver, pattern, constant, (driver, *more), cost)

    angles = [recording.stand_rad for recording in recordings if recording.stand_rad is not None]
    if len(angles) == len(recordings):
        for k in range(3):
            yield from _harmonics(
                form, f"stand_{k + 1}_rad", np.concatenate([angle[:, k] for angle in angles])
            )
    own = "w" if sensor == "gyro" else "f"
    for name in usable_columns(recordings):
        yield from _of_column(form, own, name, np.concatenate([r.auxiliary[name] for r in recordings]))


def _smooth(form: _Make, driver: str, sizes: FloatArray, *, is_own: bool) -> Iterator[Form]:
    """Forms that depend on a component of the rate or force; `sizes` are the magnitudes of its samples."""
    yield form(driver, f"k*abs({driver})")
    yield form(driver, f"k*{driver}**2", None, 1)
    yield form(driver, f"k*{driver}*abs({driver})", None, 2)
    yield form(driver, f"k*{driver}**3", None, 2)
    if driver == "f" and not is_own:
        yield form(driver, "k*f")
    for share in SHARES:
        level = float(np.quantile(sizes, share))
        if level > 0.0:
            yield form(driver, f"k*min(max({driver}, -{{c}}), {{c}})", level, 2)
            yield form(driver, f"k*tanh({driver}/{{c}})", level, 3)
    top = 2.0 * float(np.quantile(sizes, 0.999))
    for period in PERIODS:
        yield form(driver, f"s*sin(2*pi*{driver}/{{c}}) + c*cos(2*pi*{driver}/{{c}})", period * top, 4)


def _of_temperature(form: _Make, sensor: str, recordings: Sequence[Recording]) -> Iterator[Form]:
    columns = [r.temperature_degc for r in recordings if r.temperature_degc is not None]
    if len(columns) < len(recordings) or not all(np.isfinite(column).all() for column in columns):
        return
    degc = np.concatenate(columns)
    low, high = np.quantile(degc, [0.005, 0.995])
    if high - low < LEAST_CHANGE_K:
        return
    middle = f"{float(np.mean(degc)):.4g}"
    for power in (1, 2, 3):
        exponent = "" if power == 1 else f"**{power}"
        yield form("temp_degc", f"k*(temp_degc - {middle}){exponent}", None, power)
    yield form("temp_degc", f"a*(temp_degc - {middle}) + b*(temp_degc - {middle})**2", None, 3)
    yield form(
        "temp_degc",
        f"a*(temp_degc - {middle}) + b*(temp_degc - {middle})**2 + c*(temp_degc - {middle})**3",
        None, 4,
    )  # fmt: skip
    own = "w" if sensor == "gyro" else "f"
    for power in (1, 2):
        exponent = "" if power == 1 else f"**{power}"
        yield form("temp_degc", f"k*{own}*(temp_degc - {middle}){exponent}", None, power + 1, own)
    for share in STEPS:
        yield form("temp_degc", "k*max(temp_degc - {c}, 0)", low + share * (high - low), 3)


def _of_column(form: _Make, own: str, name: str, values: FloatArray) -> Iterator[Form]:
    low, high = (float(value) for value in np.quantile(values, [0.005, 0.995]))
    if not high > low:
        return
    middle = f"{float(np.mean(values)):.4g}"
    centred = f"({name} - {middle})"
    yield form(name, f"k*{centred}")
    is_switch = len(np.unique(values)) <= 2
    if is_switch:
        yield form(name, f"k*{own}*{centred}", None, 2, own)
        return
    yield form(name, f"k*{centred}**2", None, 2)
    yield form(name, f"a*{centred} + b*{centred}**2", None, 3)
    yield form(name, f"a*{centred} + b*{centred}**2 + c*{centred}**3", None, 4)
    for share in STEPS:
        yield form(name, f"k*({name} > {{c}})", low + share * (high - low), 2)
    yield form(name, f"k*{own}*{centred}", None, 2, own)
    yield from _harmonics(form, name, values)


def _harmonics(form: _Make, name: str, angle_rad: FloatArray) -> Iterator[Form]:
    if float(np.ptp(angle_rad)) < LEAST_ANGLE_RAD:
        return
    for times in (1, 2, 3, 4, 5, 6, 7, 8):
        inner = name if times == 1 else f"{times}*{name}"
        yield form(name, f"s*sin({inner}) + c*cos({inner})", None, 2)


def _thinned(values: FloatArray) -> FloatArray:
    thinned: FloatArray = values[:: max(1, len(values) // SAMPLES)]
    return thinned
