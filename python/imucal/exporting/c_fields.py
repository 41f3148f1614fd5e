"""The fields of the catalogue's effects as C expressions (docs/model.md (15)).

The field of a parameter is the error that an effect adds to the true rate or force if the parameter is 1.

The variables of the C code are: w, the true angular rate; f, the true specific force; t, the time; d, the
temperature minus the reference temperature; a, the angular acceleration. The variables of the temperature
history are rate_kps, direction, gyro_lag and accel_lag. The exponential functions of the time in the warm-up
effects are gyro_cold and accel_cold.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, TypeAlias

__all__ = ["FIELDS", "LAGS", "WARM_UPS", "Field", "Term", "product_of"]

# A term of a field (error per unit of a parameter): the index of an axis, and the C expression of the error
# along this axis.
Term: TypeAlias = tuple[int, str]
# For each parameter of an effect, in the order of the catalogue, the nonzero terms of its field.
Field: TypeAlias = Sequence[Sequence[Term]]

W: Final = ("w[0]", "w[1]", "w[2]")
F: Final = ("f[0]", "f[1]", "f[2]")
A: Final = ("a[0]", "a[1]", "a[2]")
PAIRS: Final = ((1, 2), (0, 2), (0, 1))
WARM_UPS: Final = ("gyro_bias_warmup", "accel_bias_warmup")
LAGS: Final = {"gyro": "gyro_bias_temperature_lag", "accel": "accel_bias_temperature_lag"}


def _axes(causes: Sequence[str]) -> Field:
    """The field of an effect that adds, on each axis, a parameter times the input quantity of this axis."""
    return [[(i, cause)] for i, cause in enumerate(causes)]


def _entries(causes: Sequence[str]) -> Field:
    """The field of an effect that adds a 3 x 3 matrix of parameters (by rows) times a vector of inputs."""
    return [[(i, cause)] for i in range(3) for cause in causes]


def _squares(v: Sequence[str]) -> list[str]:
    return [f"{x} * {x}" for x in v]


def _products(v: Sequence[str]) -> list[str]:
    return [f"{v[i]} * {v[j]}" for i, j in PAIRS]


def _each(write: Callable[[str], str], v: Sequence[str]) -> Field:
    return _axes([write(x) for x in v])


def _powers(causes: Sequence[str]) -> Field:
    """The field of an effect that adds, on each axis, a sum of input quantities, such as d, d^2 and d^3.

    Each input quantity is multiplied by a separate parameter for each axis.
    """
    return [column for cause in causes for column in _axes([cause] * 3)]


def _graded(variable: str) -> Field:
    return _powers([variable, f"{variable} * d", f"{variable} * d * d"])


def _scale_powers(v: Sequence[str]) -> Field:
    powers = ("d", "(d * d)", "(d * d * d)")
    return [column for power in powers for column in _axes([f"{x} * {power}" for x in v])]


def _cubic(x: str) -> str:
    return f"{x} * {x} * {x}"


def _magnitude(x: str) -> str:
    return f"({x} < 0 ? -{x} : {x})"


def _accel_cross() -> Field:
    squares, products = _squares(F), _products(F)
    return [[(i, cause)] for i in range(3) for cause in ([squares[j] for j in range(3) if j != i] + products)]


# The matrix L for which the acceleration at the lever arm r is dw/dt x r + w x (w x r) = L r.
LEVER: Final = (
    ("-w[2] * w[2] - w[1] * w[1]", "-a[2] + w[0] * w[1]", "a[1] + w[0] * w[2]"),
    ("a[2] + w[0] * w[1]", "-w[2] * w[2] - w[0] * w[0]", "-a[0] + w[1] * w[2]"),
    ("-a[1] + w[0] * w[2]", "a[0] + w[1] * w[2]", "-w[1] * w[1] - w[0] * w[0]"),
)

FIELDS: Final[dict[str, Field]] = {
    "gyro_g_sensitivity": _entries(F),
    "gyro_g2_sensitivity": [*_entries(_squares(F)), *_entries(_products(F))],
    "gyro_scale_g_sensitivity": _axes([f"{w} * {f}" for w, f in zip(W, F, strict=True)]),
    "gyro_scale_quadratic": _axes(_squares(W)),
    "gyro_scale_cubic": _each(_cubic, W),
    "gyro_scale_asymmetry": _each(_magnitude, W),
    "gyro_cross_axis_quadratic": _entries(_products(W)),
    "accel_scale_quadratic": _axes(_squares(F)),
    "accel_scale_cubic": _each(_cubic, F),
    "accel_scale_asymmetry": _each(_magnitude, F),
    "accel_cross_axis_quadratic": _accel_cross(),
    "gyro_bias_temperature": _powers(["d", "d * d", "d * d * d"]),
    "gyro_scale_temperature": _scale_powers(W),
    "accel_bias_temperature": _powers(["d", "d * d", "d * d * d"]),
    "accel_scale_temperature": _scale_powers(F),
    "gyro_bias_temperature_lag": _graded("gyro_lag"),
    "gyro_bias_temperature_rate": _graded("rate_kps"),
    "gyro_bias_temperature_hysteresis": _graded("direction"),
    "accel_bias_temperature_lag": _graded("accel_lag"),
    "accel_bias_temperature_rate": _graded("rate_kps"),
    "accel_bias_temperature_hysteresis": _graded("direction"),
    "gyro_bias_drift": _axes(["t"] * 3),
    "gyro_bias_warmup": _axes(["gyro_cold"] * 3),
    "gyro_scale_drift": _each(lambda x: f"{x} * t", W),
    "accel_bias_drift": _axes(["t"] * 3),
    "accel_bias_warmup": _axes(["accel_cold"] * 3),
    "gyro_angular_acceleration": _entries(A),
    "gyro_time_offset": [[(i, f"-{A[i]}") for i in range(3)]],
    "accel_lever_arm": [[(i, LEVER[i][k]) for i in range(3)] for k in range(3)],
    "accel_size_effect": [[(1 + k // 3, LEVER[1 + k // 3][k % 3])] for k in range(6)],
}


def product_of(value: str, expression: str) -> str:
    """The C product of a parameter value and an expression, which is put in parentheses where necessary."""
    is_one = " " not in expression or expression.startswith("(")
    return f"{value} * {expression if is_one else f'({expression})'}"
