"""Effects defined by a formula such as `gyro: k * (supply_v - 3.3)`, see `imucal.effects.formula`."""

from __future__ import annotations

import ast
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.effects.definition import UserEffect
from imucal.effects.effect import EffectParameter
from imucal.effects.formula import AXES, CONSTANTS, DIMENSIONLESS, INPUTS, Formula, names_in, parse_formula
from imucal.effects.state import State
from imucal.errors import InputError
from imucal.recording.recording import Recording, require_sensors
from imucal.units import STANDARD_GRAVITY_MPS2

__all__ = ["FormulaEffect", "formula_effects", "sizes_of"]

UNITS: Final = {"gyroscope": "rad/s", "accelerometer": "m/s^2"}
# Assumed typical rms error that a formula adds to a sensor, rad/s and m/s^2: 0.05 deg/s and 1 mg, the typical
# sizes of the warm-up effects in the catalogue.
TYPICAL: Final = {"gyroscope": 8.7e-4, "accelerometer": 9.8e-3}
# Assumed angular rate of a typical rotation, rad/s. If gyroscope samples are in counts of unknown scale, they
# are scaled such that the largest sample has this rate, before typical sizes of effects are computed.
TURN_RADPS: Final = 1.0
OPERATIONS: Final[Mapping[type[ast.AST], Callable[..., Any]]] = {
    ast.Add: np.add,
    ast.Sub: np.subtract,
    ast.Mult: np.multiply,
    ast.Div: np.divide,
    ast.Pow: np.power,
    ast.USub: np.negative,
    ast.UAdd: np.positive,
    ast.Lt: np.less,
    ast.LtE: np.less_equal,
    ast.Gt: np.greater,
    ast.GtE: np.greater_equal,
}
FUNCTIONS: Final[Mapping[str, Callable[..., Any]]] = {
    **{
        name: getattr(np, name) for name in ("abs", "sign", "sqrt", "exp", "log", "sin", "cos", "tan", "tanh")
    },
    "atan": np.arctan,
    "min": np.minimum,
    "max": np.maximum,
}


@dataclass(frozen=True, eq=False)
class FormulaEffect(UserEffect):
    """A user-defined effect whose field (the error per unit of each parameter) is computed by a formula.

    Calibration files contain the formula, so commands can apply the effect without a Python function.

    formula  the parsed formula
    """

    formula: Formula

    @staticmethod
    def of(
        text: str, *, columns: Collection[str] = (), typical: Sequence[float] | None = None, name: str = ""
    ) -> FormulaEffect:
        """Make the effect that a formula such as "gyro: k * (supply_v - 3.3)" defines.

        columns  names of the auxiliary columns of the recordings on which the formula may depend
        typical  typical size of each parameter in its SI unit; 1 if not given
        name     name of the effect if the text contains none; default: gyro_formula or accel_formula

        Raises InputError if the text is not a formula.
        """
        formula = parse_formula(text, columns)
        terms = _terms(formula)
        parameters = tuple(
            EffectParameter(parameter, _unit_of(formula, factor), size)
            for (parameter, _, factor), size in zip(terms, typical or [1.0] * len(terms), strict=True)
        )
        named = formula.name or name or f"{formula.prefix}_formula"
        return FormulaEffect(named, formula.sensor, parameters, _Field(formula), formula)

    @staticmethod
    def stored(text: str, name: str, parameters: Sequence[EffectParameter]) -> FormulaEffect:
        """Make the effect that a formula in a file defines.

        A name in the formula that is neither one of `parameters` nor an input is a column.

        Raises InputError if the text is not a formula, or if its number of parameters differs from that of
        `parameters`.
        """
        names = names_in(text)
        stored = {parameter.name for parameter in parameters}
        columns = {n for n in names if n not in stored and not stored >= {f"{n}_{axis}" for axis in AXES}}
        count = len(_terms(parse_formula(text, columns)))
        if count != len(parameters):
            raise InputError(f"it has {count} parameters, but the file has {len(parameters)} values")
        return FormulaEffect.of(
            text, columns=columns, typical=[parameter.typical for parameter in parameters], name=name
        )

    @property
    def text(self) -> str:
        """The formula as text."""
        return self.formula.text

    @property
    def needs(self) -> tuple[str, ...]:
        """Names of the quantities that the formula needs, as in `Effect.needs`, such as "temperature"."""
        inputs = self.formula.inputs
        given = {
            "time": "time_s" in inputs,
            "temperature": "temp_degc" in inputs,
            "angular_acceleration": any(name in INPUTS and name.startswith("dw") for name in inputs),
        }
        return tuple(need for need, is_needed in given.items() if is_needed)

    @property
    def auxiliary(self) -> tuple[str, ...]:
        """The columns of the recordings that the formula depends on, in alphabetical order."""
        return tuple(sorted(self.formula.inputs - set(INPUTS)))

    def columns_of_field(self) -> list[tuple[str, int, ast.expr]]:
        """For each parameter: its name, the index of its axis, and the expression that multiplies it."""
        return _terms(self.formula)


def formula_effects(texts: Sequence[str], recordings: Sequence[Recording]) -> tuple[FormulaEffect, ...]:
    """Make the effects that the formulas `texts` define.

    The typical sizes of their parameters are computed from the motion in `recordings`.

    Raises InputError if a text is not a formula, and for a column that one of the recordings lacks.
    """
    columns = set.intersection(*(set(recording.auxiliary) for recording in recordings))
    states = [_rough_state(recording) for recording in recordings] if texts else []
    found: list[FormulaEffect] = []
    for text in texts:
        effect = FormulaEffect.of(text, columns=columns)
        count = sum(other.name.startswith(effect.name) for other in found)
        name = f"{effect.name}_{count + 1}" if count else effect.name
        typical = _typical_sizes(effect, states)
        found.append(FormulaEffect.of(text, columns=columns, typical=typical, name=name))
    return tuple(found)


@dataclass(frozen=True, eq=False)
class _Field:
    """Callable that computes from a State the error per unit of each parameter of a formula, (N, 3, p)."""

    formula: Formula

    def __call__(self, state: State) -> FloatArray:
        terms = _terms(self.formula)
        field = np.zeros((len(state.time_s), 3, len(terms)))
        for k, (_, axis, factor) in enumerate(terms):
            # NumPy's warnings, such as for a division by zero, are suppressed, because the caller reports
            # values that are not finite.
            with np.errstate(all="ignore"):
                field[:, axis, k] = _value(factor, _inputs(state, axis, self.formula))
        return field


def _terms(formula: Formula) -> list[tuple[str, int, ast.expr]]:
    """Name, index of the axis, and factor of each parameter, in the order of the parameters in the field."""
    several = len(formula.axes) > 1
    return [
        (f"{name}_{axis}" if several else name, AXES.index(axis), factor)
        for name, factor in formula.factors.items()
        for axis in formula.axes
    ]


def _unit_of(formula: Formula, factor: ast.expr) -> str:
    unit = UNITS[formula.sensor]
    if _is_dimensionless(factor):
        return unit
    text = ast.unparse(factor)
    return f"{unit}/{text}" if text.isidentifier() else f"{unit}/({text})"


def _is_dimensionless(factor: ast.expr) -> bool:
    """Whether the value of `factor` has no unit: a number or, for example, the tanh of an expression."""
    if isinstance(factor, ast.BinOp):
        return _is_dimensionless(factor.left) and _is_dimensionless(factor.right)
    if isinstance(factor, ast.UnaryOp):
        return _is_dimensionless(factor.operand)
    if isinstance(factor, ast.Call):
        return isinstance(factor.func, ast.Name) and factor.func.id in DIMENSIONLESS
    return isinstance(factor, ast.Constant)


def _inputs(state: State, axis: int, formula: Formula) -> dict[str, FloatArray]:
    """Values of the inputs that the formula uses, (N,) each; w, f and dw are components along `axis`."""
    vectors = {"w": state.angular_rate, "f": state.specific_force, "dw": state.angular_acceleration}
    values: dict[str, FloatArray | None] = {
        **state.auxiliary,
        "temp_degc": state.temperature_degc,
        "time_s": state.time_s,
        "rest_s": state.rest_s,
    }
    for k in range(3):
        values[f"stand_{k + 1}_rad"] = None if state.stand_rad is None else state.stand_rad[:, k]
    for name, vector in vectors.items():
        values[name] = None if vector is None else vector[:, axis]
        for k, along in enumerate(AXES):
            values[f"{name}_{along}"] = None if vector is None else vector[:, k]
    for name, given in (("w", state.angular_rate), ("f", state.specific_force)):
        if f"{name}_norm" in formula.inputs:
            values[f"{name}_norm"] = np.linalg.norm(given, axis=1)
    found = {}
    for name in formula.inputs:
        value = values.get(name)
        if value is None:
            raise InputError(f"the formula {formula.text!r} depends on {name}, which the recording lacks")
        found[name] = value
    return found


def _value(node: ast.expr, inputs: Mapping[str, FloatArray]) -> Any:
    match node:
        case ast.Constant(value=value):
            return float(value)  # type: ignore[arg-type]
        case ast.Name(id=name):
            return CONSTANTS[name] if name in CONSTANTS else inputs[name]
        case ast.UnaryOp(op=op, operand=operand):
            return OPERATIONS[type(op)](_value(operand, inputs))
        case ast.BinOp(left=left, op=op, right=right):
            return OPERATIONS[type(op)](_value(left, inputs), _value(right, inputs))
        case ast.Compare(left=left, ops=[op], comparators=[right]):
            return np.asarray(OPERATIONS[type(op)](_value(left, inputs), _value(right, inputs)), dtype=float)
        case ast.Call(func=ast.Name(id=name), args=args):
            return FUNCTIONS[name](*(_value(argument, inputs) for argument in args))
    raise AssertionError(f"parse_formula admits {ast.dump(node)}")


def _typical_sizes(effect: FormulaEffect, states: Sequence[State]) -> list[float]:
    """The typical size of each parameter (see `sizes_of`) for the motion in these states."""
    return sizes_of(effect, [effect.columns(state) for state in states])


def sizes_of(effect: FormulaEffect, fields: Sequence[FloatArray]) -> list[float]:
    """The size of each parameter for which its term has a typical standard deviation.

    The term is the parameter times the expression that multiplies it. The typical standard deviation over the
    recordings is `TYPICAL`: 0.05 deg/s for a gyroscope and 1 mg for an accelerometer. `fields` contains, for
    each recording, the field (the derivatives with respect to the parameters) at its samples, (N, 3, p).

    Raises InputError if the factor of a parameter is constant.
    """
    axes = [axis for _, axis, _ in _terms(effect.formula)]
    along = [np.concatenate([field[:, axis, k] for field in fields]) for k, axis in enumerate(axes)]
    spread = [float(np.nanstd(values)) for values in along]
    constant = [p.name for p, s in zip(effect.parameters, spread, strict=True) if not s > 0]
    if constant:
        raise InputError(
            f"in the formula {effect.name}, {' and '.join(constant)} multiplies an expression that is "
            "constant in the recordings, so it cannot be distinguished from a bias: record data in which "
            "the expression varies"
        )
    return [TYPICAL[effect.sensor] / value for value in spread]


def _rough_state(recording: Recording) -> State:
    """Approximate the true state by uncorrected samples.

    Counts are scaled such that the median force is standard gravity and the largest rate is 1 rad/s.
    """
    require_sensors(recording, "accelerometer", "gyroscope")
    force, rate = np.asarray(recording.specific_force, float), np.asarray(recording.angular_rate, float)
    if recording.accel_unit == "lsb":
        force = force * (STANDARD_GRAVITY_MPS2 / max(float(np.median(np.linalg.norm(force, axis=1))), 1.0))
    if recording.gyro_unit == "lsb":
        rate = rate * (TURN_RADPS / max(float(np.abs(rate).max()), 1.0))
    return State.of(recording, rate, force)
