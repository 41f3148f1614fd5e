"""Formulas of user-defined effects as C and Rust expressions."""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import imucal._core as _core
from imucal.effects.effect import EffectValues
from imucal.effects.formula import ARGUMENTS, AXES, CONSTANTS, INPUTS
from imucal.effects.formula_effect import FormulaEffect
from imucal.errors import InputError
from imucal.exporting.c_fields import Field
from imucal.exporting.format import number

__all__ = [
    "argument_note",
    "argument_of",
    "auxiliary_of",
    "c_field",
    "calls_function",
    "has_sign",
    "rust_function",
]

OPERATORS: Final[Mapping[type[ast.AST], str]] = {
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.Div: "/",
    ast.USub: "-",
    ast.UAdd: "",
    ast.Lt: "<",
    ast.LtE: "<=",
    ast.Gt: ">",
    ast.GtE: ">=",
}
# Functions of formulas that have another name in the trait RealField of nalgebra, each with that other name.
RUST_METHODS: Final = {"log": "ln"}
# Functions of formulas that have another name in the C library libm, each with that other name.
LIBM: Final = {"abs": "fabs", "min": "fmin", "max": "fmax"}


def auxiliary_of(effect: FormulaEffect) -> tuple[str, ...]:
    """The columns and other quantities that the exported code takes as arguments, in alphabetical order.

    Raises InputError for a column that cannot be part of a C name.
    """
    for name in effect.auxiliary:
        if not name.isascii():
            raise InputError(f"{effect.name} depends on the column {name}: C needs a name of ASCII letters")
    return tuple(sorted({*effect.auxiliary, *(effect.formula.inputs & set(ARGUMENTS))}))


def argument_of(column: str) -> str:
    """The name of the function argument for a column. It does not collide with any local variable."""
    return column if column in ARGUMENTS else f"aux_{column}"


def argument_note(column: str) -> str:
    """The sentence that describes the argument for a column in a comment of the generated code."""
    meaning = INPUTS[column] if column in ARGUMENTS else f"the column {column} of the recordings"
    return f"{argument_of(column)} is {meaning}."


def c_field(effect: FormulaEffect, literal: Callable[[float], str], sign: str, *, single: bool) -> Field:
    """The error per unit of each parameter as C expressions, in the form of `c_fields.FIELDS`.

    literal   function that writes a number
    sign      name of the generated C function for `sign`, see `has_sign`
    """
    return [
        [(axis, _Writer(axis, literal, "f" if single else "", sign).written(factor))]
        for _, axis, factor in effect.columns_of_field()
    ]


def has_sign(effect: FormulaEffect) -> bool:
    """Whether the formula calls `sign`, which C lacks."""
    return any(isinstance(node, ast.Name) and node.id == "sign" for node in _nodes(effect))


def calls_function(effect: FormulaEffect) -> bool:
    """Whether the C code calls functions of libm."""
    return any(
        isinstance(node, (ast.Call, ast.Pow)) or (isinstance(node, ast.Name) and node.id.endswith("_norm"))
        for node in _nodes(effect)
    )


def _nodes(effect: FormulaEffect) -> Iterator[ast.AST]:
    for _, _, factor in effect.columns_of_field():
        yield from ast.walk(factor)


@dataclass(frozen=True)
class _Writer:
    """Writes an expression of a formula as C code for one axis.

    suffix   suffix of the libm functions for the real type ("f" for float)
    sign     name of the generated C function for `sign`
    """

    axis: int
    literal: Callable[[float], str]
    suffix: str
    sign: str

    def written(self, node: ast.expr) -> str:
        match node:
            case ast.Constant(value=value):
                return self.literal(float(value))  # type: ignore[arg-type]
            case ast.Name(id=name):
                return self.literal(CONSTANTS[name]) if name in CONSTANTS else self._input(name)
            case ast.UnaryOp(op=op, operand=operand):
                return f"({OPERATORS[type(op)]}{self.written(operand)})"
            case ast.BinOp(left=ast.Name() as base, op=ast.Pow(), right=ast.Constant(value=2)):
                # The square of a single variable is written as a product. Squares of other expressions use
                # `pow`, because as products their length would double with each nested square.
                return f"({self.written(base)} * {self.written(base)})"
            case ast.BinOp(left=left, op=ast.Pow(), right=right):
                return f"pow{self.suffix}({self.written(left)}, {self.written(right)})"
            case ast.BinOp(left=left, op=op, right=right):
                return f"({self.written(left)} {OPERATORS[type(op)]} {self.written(right)})"
            case ast.Compare(left=left, ops=[order], comparators=[right]):
                condition = f"{self.written(left)} {OPERATORS[type(order)]} {self.written(right)}"
                return f"({condition} ? {self.literal(1.0)} : {self.literal(0.0)})"
            case ast.Call(func=ast.Name(id=name), args=arguments):
                function = self.sign if name == "sign" else f"{LIBM.get(name, name)}{self.suffix}"
                return f"{function}({', '.join(map(self.written, arguments))})"
        raise AssertionError(f"parse_formula admits {ast.dump(node)}")

    def _input(self, name: str) -> str:
        if name == "temp_degc":
            return "temperature_degc"
        if name == "time_s":
            return "time_s"
        if name not in INPUTS or name in ARGUMENTS:
            return argument_of(name)
        vector, _, along = name.partition("_")
        if along == "norm":
            return f"sqrt{self.suffix}({' + '.join(f'{vector}[{i}] * {vector}[{i}]' for i in range(3))})"
        array = "angular_acceleration_radps2" if vector == "dw" else vector
        return f"{array}[{AXES.index(along) if along else self.axis}]"


@dataclass(frozen=True)
class _RustWriter:
    """Writes a formula as a Rust expression for one axis; F is the type of real numbers."""

    axis: int

    def written(self, node: ast.expr) -> str:
        match node:
            case ast.Constant(value=value):
                return f"real({number(float(value))})"  # type: ignore[arg-type]
            case ast.Name(id=name):
                return f"real({number(CONSTANTS[name])})" if name in CONSTANTS else self._input(name)
            case ast.UnaryOp(op=op, operand=operand):
                return f"({OPERATORS[type(op)]}{self.written(operand)})"
            case ast.BinOp(left=left, op=ast.Pow(), right=ast.Constant(value=int() as power)) if power < 10:
                return f"{self.written(left)}.powi({power})"
            case ast.BinOp(left=left, op=ast.Pow(), right=right):
                return f"{self.written(left)}.powf({self.written(right)})"
            case ast.BinOp(left=left, op=op, right=right):
                return f"({self.written(left)} {OPERATORS[type(op)]} {self.written(right)})"
            case ast.Compare(left=left, ops=[order], comparators=[right]):
                return f"when({self.written(left)} {OPERATORS[type(order)]} {self.written(right)})"
            case ast.Call(func=ast.Name(id="sign"), args=[argument]):
                return f"sign({self.written(argument)})"
            case ast.Call(func=ast.Name(id=name), args=[argument, *others]):
                method = RUST_METHODS.get(name, name)
                return f"{self.written(argument)}.{method}({', '.join(map(self.written, others))})"
        raise AssertionError(f"parse_formula admits {ast.dump(node)}")

    def _input(self, name: str) -> str:
        if name in ("temp_degc", "time_s"):
            return name
        if name not in INPUTS or name in ARGUMENTS:
            return argument_of(name)
        vector, _, along = name.partition("_")
        return f"{vector}.norm()" if along == "norm" else f"{vector}.{along or AXES[self.axis]}"


def rust_function(effects: Sequence[tuple[FormulaEffect, EffectValues]]) -> list[str]:
    """The lines of a Rust function `formulas` that sums the effects, for `Calibration::correct_with`."""
    sums: dict[tuple[str, int], list[str]] = {}
    for effect, values in effects:
        for value, (_, axis, factor) in zip(values.values.tolist(), effect.columns_of_field(), strict=True):
            term = f"real({number(value)}) * {_RustWriter(axis).written(factor)}"
            sums.setdefault((effect.sensor, axis), []).append(term)
    text = " ".join(term for terms in sums.values() for term in terms)
    columns = sorted({column for effect, _ in effects for column in auxiliary_of(effect)})
    inputs = {
        "w": "state.angular_rate",
        "f": "state.specific_force",
        "dw": "state.surroundings.angular_acceleration.unwrap_or_else(|| Vector3::repeat(real(f64::NAN)))",
        "temp_degc": "state.surroundings.temperature_difference_k.map_or(real(f64::NAN), "
        f"|d| d + real({number(_core.REFERENCE_TEMPERATURE_DEGC)}))",
        "time_s": "state.surroundings.time_s.unwrap_or(real(f64::NAN))",
    }
    helpers = {
        "sign": "let sign = |x: F| if x > F::zero() { F::one() } else if x < F::zero() { -F::one() } "
        "else { x };",
        "when": "let when = |holds: bool| if holds { F::one() } else { F::zero() };",
    }

    def uses(name: str) -> bool:
        return re.search(rf"\b{name}\b", text) is not None

    def vector(sensor: str) -> str:
        rows = [" + ".join(sums.get((sensor, axis), ["F::zero()"])) for axis in range(3)]
        return f"Vector3::new({', '.join(rows)})"

    state = "state" if any(map(uses, inputs)) else "_state"
    arguments = "".join(f", {argument_of(column)}: F" for column in columns)
    return [
        "",
        f"/// Error that {' and '.join(effect.name for effect, _ in effects)} adds to the true rate and "
        "force, for `correct_with`.",
        "///",
        *(f"/// {effect.name}: {effect.text}" for effect, _ in effects),
        "/// A quantity that `state` does not have makes the result NaN.",
        f"pub fn formulas<F: RealField + Copy>({state}: &State<F>{arguments}) -> (Vector3<F>, Vector3<F>) {{",
        "    let real = convert::<f64, F>;",
        *(f"    let {name} = {value};" for name, value in inputs.items() if uses(name)),
        *(f"    {line}" for name, line in helpers.items() if uses(name)),
        f"    ({vector('gyroscope')}, {vector('accelerometer')})",
        "}",
    ]
