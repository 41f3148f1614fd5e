"""Formulas of effects as text: `gyro: k * (supply_v - 3.3)`.

    [NAME =] SENSOR [AXIS]: EXPRESSION

The effect adds the value of the expression to the true rate (rad/s) or force (m/s^2). The parameters are the
names that are neither inputs (such as temp_degc), constants, functions nor columns of the recordings. The
expression must be linear in the parameters, and each of its terms must contain a parameter. Without an axis,
the effect acts on all three axes, each of which has separate parameters.

The text is parsed but never executed. The syntax tree may contain only numbers, names, the operations in
`OPERATORS`, comparisons, and calls of `FUNCTIONS`.
"""

from __future__ import annotations

import ast
import difflib
import functools
import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from imucal.document.name import shown
from imucal.errors import InputError
from imucal.units import STANDARD_GRAVITY_MPS2

__all__ = [
    "ARGUMENTS",
    "AXES",
    "CONSTANTS",
    "FUNCTIONS",
    "INPUTS",
    "Formula",
    "is_formula",
    "names_in",
    "parse_formula",
]

AXES: Final = "xyz"
SENSORS: Final = {
    "gyro": "gyroscope",
    "gyroscope": "gyroscope",
    "accel": "accelerometer",
    "accelerometer": "accelerometer",
}
# Names of the quantities, other than columns of the recording, that an expression may contain. The names w, f
# and dw without an axis mean the component along the axis on which the effect acts.
INPUTS: Final[Mapping[str, str]] = {
    **{f"w{axis}": "angular rate, rad/s" for axis in ("", "_x", "_y", "_z")},
    **{f"f{axis}": "specific force, m/s^2" for axis in ("", "_x", "_y", "_z")},
    **{f"dw{axis}": "angular acceleration, rad/s^2" for axis in ("", "_x", "_y", "_z")},
    "w_norm": "norm of the angular rate, rad/s",
    "f_norm": "norm of the specific force, m/s^2",
    "temp_degc": "temperature, degC",
    "time_s": "time since the first sample, s",
    "rest_s": "time since the rate last exceeded 0.1 rad/s, or since the first sample if it never did, s",
    **{f"stand_{k}_rad": f"measured angle of motor {k} of the stand, rad" for k in (1, 2, 3)},
}
# Inputs that cannot be computed from a single sample. The C and Rust functions that `imucal export` writes
# have these inputs as arguments.
ARGUMENTS: Final = ("rest_s", "stand_1_rad", "stand_2_rad", "stand_3_rad")
CONSTANTS: Final[Mapping[str, float]] = {"pi": 3.141592653589793, "g": STANDARD_GRAVITY_MPS2}
# Permitted functions, each with its number of arguments.
FUNCTIONS: Final[Mapping[str, int]] = {
    **dict.fromkeys(("abs", "sign", "sqrt", "exp", "log", "sin", "cos", "tan", "tanh", "atan"), 1),
    **dict.fromkeys(("min", "max"), 2),
}
# Functions whose value has no unit.
DIMENSIONLESS: Final = frozenset({"sign", "exp", "log", "sin", "cos", "tan", "tanh", "atan"})
OPERATORS: Final = (ast.Add, ast.Sub, ast.Mult, ast.Div, ast.Pow)
COMPARISONS: Final = (ast.Lt, ast.LtE, ast.Gt, ast.GtE)
# Maximum number of characters of a formula, and maximum depth of nested operations. Usual formulas are far
# below both limits.
MOST_CHARACTERS: Final = 500
MOST_NESTED: Final = 50
# Largest accepted magnitude of a number in a formula. The limit is needed because Python integers are
# unbounded and may not fit into a float.
LARGEST: Final = 1e100

HEAD: Final = re.compile(
    rf"\s*(?:(?P<name>\w+)\s*=\s*)?(?P<sensor>{'|'.join(SENSORS)})(?:[ _.](?P<axis>[xyz]))?\s*"
)
FORM: Final = "give SENSOR: EXPRESSION, such as 'gyro: k * (supply_v - 3.3)' or 'accel z: k * f_x**2'"


@dataclass(frozen=True, eq=False)
class Formula:
    """A parsed formula.

    text     the text as given, with single spaces
    name     name of the effect; None if the text contains no name
    sensor   "gyroscope" or "accelerometer"
    axes     the axes on which the effect acts: "xyz", or one of them
    factors  for each parameter, the expression that multiplies it
    """

    text: str
    name: str | None
    sensor: str
    axes: str
    factors: Mapping[str, ast.expr]

    @property
    def prefix(self) -> str:
        """The abbreviation of the sensor with which names of effects and parameters begin."""
        return "gyro" if self.sensor == "gyroscope" else "accel"

    @functools.cached_property
    def inputs(self) -> frozenset[str]:
        """The inputs and columns of the recordings that the expression depends on."""
        return frozenset(
            node.id
            for factor in self.factors.values()
            for node in ast.walk(factor)
            if isinstance(node, ast.Name) and node.id not in CONSTANTS and node.id not in FUNCTIONS
        )


def names_in(text: str) -> frozenset[str]:
    """All names in the expression of a formula: parameters, inputs, columns and functions."""
    return frozenset(re.findall(r"[^\W\d]\w*", text.partition(":")[2]))


def is_formula(text: str) -> bool:
    """Whether a text is a formula and not the name of an effect, such as NAME or NAME:full."""
    head, colon, body = text.partition(":")
    return bool(colon) and (HEAD.fullmatch(head) is not None or not re.fullmatch(r"\w*", body.strip()))


def parse_formula(text: str, columns: Collection[str]) -> Formula:
    """Parse the text of a formula.

    columns  names of the auxiliary columns of the recordings

    Raises InputError, with the position and a remedy, if the text is not a formula, if an operation is not
    allowed, and if the expression is not linear in its parameters.
    """
    printable = " ".join(shown(text).split())
    if len(printable) > MOST_CHARACTERS:
        raise InputError(f"a formula has {len(printable)} characters: give at most {MOST_CHARACTERS}")
    head, colon, body = printable.partition(":")
    found = HEAD.fullmatch(head)
    if not colon or found is None:
        raise InputError(f"{printable!r} is no formula: {FORM}")
    try:
        expression = ast.parse(body.strip(), mode="eval").body
    except (SyntaxError, ValueError, MemoryError, RecursionError) as error:
        reason = error.msg if isinstance(error, SyntaxError) else "it is nested too deeply"
        raise InputError(f"the formula {printable!r} cannot be read ({reason}): {FORM}") from None
    _Reader(printable, columns).require_allowed(expression)
    terms = _Reader(printable, columns).terms(expression)
    if None in terms:
        raise InputError(
            f"the formula {printable!r} adds {ast.unparse(terms[None])} without a parameter: multiply each "
            "term by a parameter, which is a name of your own such as k"
        )
    return Formula(
        text=printable,
        name=found["name"],
        sensor=SENSORS[found["sensor"]],
        axes=found["axis"] or AXES,
        factors={name: factor for name, factor in terms.items() if name is not None},
    )


@dataclass(frozen=True)
class _Reader:
    """Checks the expression of a formula, and splits it into terms, one per parameter."""

    text: str
    columns: Collection[str]

    def require_allowed(self, node: ast.expr, depth: int = 0) -> None:
        """Raise InputError if the expression contains anything that is not permitted."""
        if depth > MOST_NESTED:
            raise self._error("is nested too deeply", "split it into several effects")
        match node:
            case ast.Constant(value=bool()):
                raise self._error(f"holds {node.value!r}", "give a number, or a comparison such as (w > 1)")
            case ast.Constant(value=int() | float() as value):
                if not abs(value) <= LARGEST:
                    raise self._error("holds a number that is too large", f"give at most {LARGEST:g}")
                parts: Iterable[ast.expr] = ()
            case ast.Name():
                if node.id in FUNCTIONS:
                    raise self._error(f"has {node.id} without its argument", f"give {node.id}(...)")
                parts = ()
            case ast.BinOp(op=operator) if isinstance(operator, OPERATORS):
                parts = (node.left, node.right)
            case ast.UnaryOp(op=ast.USub() | ast.UAdd()):
                parts = (node.operand,)
            case ast.Compare(ops=[operation]) if isinstance(operation, COMPARISONS):
                parts = (node.left, *node.comparators)
            case ast.Call(func=ast.Name(id=function), keywords=[]) if function in FUNCTIONS:
                if len(node.args) != FUNCTIONS[function]:
                    count = FUNCTIONS[function]
                    raise self._error(
                        f"calls {function} with {len(node.args)} arguments", f"{function} takes {count}"
                    )
                parts = node.args
            case ast.BinOp(op=ast.BitXor()):
                raise self._error("holds ^", "write a power as x**2")
            case ast.Call():
                known = ", ".join(FUNCTIONS)
                raise self._error(f"calls {ast.unparse(node.func)}", f"the functions are {known}")
            case _:
                raise self._error(
                    f"holds {ast.unparse(node)!r}", "use numbers, names, + - * / **, < > and functions"
                )
        for part in parts:
            self.require_allowed(part, depth + 1)

    def terms(self, node: ast.expr) -> dict[str | None, ast.expr]:
        """The factor of each parameter in an expression that is linear in the parameters.

        The factor of the terms without a parameter has the key None.
        """
        match node:
            case ast.Name() if self._is_parameter(node.id):
                return {node.id: ast.Constant(1)}
            case ast.UnaryOp():
                return {name: _minus(node.op, factor) for name, factor in self.terms(node.operand).items()}
            case ast.BinOp(op=ast.Add() | ast.Sub()):
                terms = self.terms(node.left)
                for name, factor in self.terms(node.right).items():
                    if name in terms:
                        terms[name] = ast.BinOp(terms[name], node.op, factor)
                    else:
                        terms[name] = factor if isinstance(node.op, ast.Add) else _minus(ast.USub(), factor)
                return terms
            case ast.BinOp(op=ast.Mult()):
                left, right = self.terms(node.left), self.terms(node.right)
                if set(left) != {None} and set(right) != {None}:
                    raise self._nonlinear({*left, *right}, "multiplied by each other")
                if set(left) == {None}:
                    return {name: _product(node.left, factor) for name, factor in right.items()}
                return {name: _product(factor, node.right) for name, factor in left.items()}
            case ast.BinOp(op=ast.Div()):
                self._require_without(node.right, "in a denominator")
                return {
                    name: ast.BinOp(f, ast.Div(), node.right) for name, f in self.terms(node.left).items()
                }
            case _:
                self._require_without(node, f"inside {ast.unparse(node)}")
                return {None: node}

    def _is_parameter(self, name: str) -> bool:
        return not (name in INPUTS or name in CONSTANTS or name in self.columns)

    def _require_without(self, node: ast.expr, where: str) -> None:
        names = {n.id for n in ast.walk(node) if isinstance(n, ast.Name) and n.id not in FUNCTIONS}
        found = {name for name in names if self._is_parameter(name)}
        if found:
            raise self._nonlinear(found, where)

    def _nonlinear(self, names: Iterable[str | None], where: str) -> InputError:
        found = sorted(name for name in names if name is not None)
        known = sorted({*self.columns, *INPUTS})
        near = {name: difflib.get_close_matches(name, known, 1, 0.7) for name in found}
        hints = [f"{name} may be {matches[0]}" for name, matches in near.items() if matches]
        columns = ", ".join(sorted(self.columns)) or "no further columns"
        return self._error(
            f"has {' and '.join(found)} {where}",
            "the formula must be linear in its parameters, so replace these parameters by numbers"
            + (f"; {', '.join(hints)}" if hints else f"; the recording has {columns}"),
        )

    def _error(self, what: str, way_out: str) -> InputError:
        return InputError(f"the formula {self.text!r} {what}: {way_out}")


def _minus(sign: ast.unaryop, factor: ast.expr) -> ast.expr:
    return ast.UnaryOp(sign, factor) if isinstance(sign, ast.USub) else factor


def _product(left: ast.expr, right: ast.expr) -> ast.expr:
    for one, other in ((left, right), (right, left)):
        if isinstance(one, ast.Constant) and one.value == 1:
            return other
    return ast.BinOp(left, ast.Mult(), right)
