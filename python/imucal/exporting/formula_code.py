"""Formulas of user-defined effects as C expressions."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final

from imucal.effects.formula import AXES, CONSTANTS, INPUTS
from imucal.effects.formula_effect import FormulaEffect
from imucal.errors import InputError
from imucal.exporting.c_fields import Field

__all__ = ["argument_of", "auxiliary_of", "c_field", "calls_function", "has_sign"]

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
# Functions of libm by their names in a formula.
LIBM: Final = {"abs": "fabs", "min": "fmin", "max": "fmax"}


def auxiliary_of(effect: FormulaEffect) -> tuple[str, ...]:
    """The columns of the recordings that the formula depends on, in alphabetical order.

    Raises InputError for a column that cannot be part of a C name.
    """
    for name in effect.auxiliary:
        if not name.isascii():
            raise InputError(f"{effect.name} depends on the column {name}: C needs a name of ASCII letters")
    return effect.auxiliary


def argument_of(column: str) -> str:
    """The function argument for a column, which no local variable has as its name."""
    return f"aux_{column}"


def c_field(effect: FormulaEffect, literal: Callable[[float], str], sign: str, *, single: bool) -> Field:
    """The field as C expressions, as those of the catalogue (`imucal.exporting.c_fields.FIELDS`).

    literal   writes a number
    sign      name of the function of the sign, see `has_sign`
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
    """Writes an expression for one axis.

    suffix   of the functions of libm for this type
    sign     name of the function that C lacks
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
                # Only a name is written twice: nested squares would double the text each time.
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
        if name not in INPUTS:
            return argument_of(name)
        vector, _, along = name.partition("_")
        if along == "norm":
            return f"sqrt{self.suffix}({' + '.join(f'{vector}[{i}] * {vector}[{i}]' for i in range(3))})"
        array = "angular_acceleration_radps2" if vector == "dw" else vector
        return f"{array}[{AXES.index(along) if along else self.axis}]"
