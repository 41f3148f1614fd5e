"""Operators and constants of Rust sources that a deliberate error can change."""

from __future__ import annotations

import random
import re
from collections.abc import Iterator

import tree_sitter_rust
from tree_sitter import Language, Node, Parser

from mutants.sites import Edit, Site

__all__ = ["PATTERN", "constants_of", "rust_sites"]

# Text of a switch. The comment marks its end, so that the place of a compiler error leads to its switch.
PATTERN = ("(if imucal_core::mutant::is_on(NUMBER) { ", " } else { ", " }/*NUMBER*/)")

OPERATORS = {
    "+": ("-",),
    "-": ("+",),
    "*": ("/",),
    "/": ("*",),
    "<": ("<=", ">"),
    "<=": ("<", ">"),
    ">": (">=", "<"),
    ">=": (">", "<"),
    "==": ("!=",),
    "!=": ("==",),
    "&&": ("||",),
    "||": ("&&",),
    "+=": ("-=",),
    "-=": ("+=",),
    "*=": ("/=",),
    "/=": ("*=",),
}
# What the compiler evaluates, where no switch can stand, and patterns and tests.
LEFT_OUT = {
    "const_item",
    "static_item",
    "macro_invocation",
    "macro_definition",
    "attribute_item",
    "inner_attribute_item",
    "type_arguments",
    "array_type",
    "match_pattern",
    "range_pattern",
    "tuple_pattern",
    "tuple_struct_pattern",
    "or_pattern",
    "enum_item",
}
CONSTANT = re.compile(r"\bconst ([A-Z][A-Z0-9_]+): (f64|usize|u32|u64|i32) =")


def constants_of(source: bytes) -> dict[str, str]:
    """Types of the numeric constants of a source, by name."""
    return dict(CONSTANT.findall(source.decode()))


def rust_sites(path: str, source: bytes, constants: dict[str, str], chance: random.Random) -> list[Site]:
    """All places within functions where an operator or a constant can change, each with one change.

    constants  types of the constants that the source may use; a use of one changes by 5 %, or by one
    """
    root = Parser(Language(tree_sitter_rust.language())).parse(source).root_node
    return list(_Finder(path, source, constants, chance).found(root, False))


class _Finder:
    def __init__(self, path: str, source: bytes, constants: dict[str, str], chance: random.Random) -> None:
        self.path, self.constants, self.chance = path, constants, chance
        self.lines = source.decode().splitlines()

    def found(self, node: Node, is_in_function: bool) -> Iterator[Site]:
        is_test = False
        for child in node.children:
            if child.type == "attribute_item":
                is_test = is_test or "test" in _text(child)
                continue
            if child.type.endswith("comment"):
                continue
            left_out = (
                is_test or child.type in LEFT_OUT or (child.type == "function_item" and _is_const(child))
            )
            is_test = False
            if left_out:
                continue
            site = self._site(child) if is_in_function else None
            if site is not None:
                yield site
            yield from self.found(child, is_in_function or child.type == "function_item")

    def _site(self, node: Node) -> Site | None:
        text = _text(node)
        match node.type:
            case "binary_expression" | "compound_assignment_expr":
                left, right = node.child_by_field_name("left"), node.child_by_field_name("right")
                sign = _text(node.child_by_field_name("operator"))
                if sign in OPERATORS:
                    other = self.chance.choice(OPERATORS[sign])
                    # The operators of the operands may bind less tightly than the other operator.
                    pieces = ["(", f") {other} (", ")"] if sign[-1] in "+-*/&|" else ["", f" {other} ", ""]
                    return self._replaced(node, [left, right], pieces, sign, other)
            case "unary_expression" if text[0] in "!-":
                return self._replaced(node, [node.children[1]], ["", ""], text[0], "")
            case "float_literal":
                digits, kind = _digits(text)
                value = float(digits) * 1.05 if float(digits) else 1.0
                return self._replaced(node, [], [f"{value!r}{kind}"], text, f"{value!r}{kind}")
            case "integer_literal" if node.parent.type not in ("field_expression", "array_expression"):
                digits, kind = _digits(text)
                if digits.isdecimal():
                    return self._replaced(
                        node, [], [f"{int(digits) + 1}{kind}"], text, f"{int(digits) + 1}{kind}"
                    )
            case "boolean_literal":
                other = "false" if text == "true" else "true"
                return self._replaced(node, [], [other], text, other)
            case "identifier" if text in self.constants and node.parent.type not in (
                "scoped_identifier",
                "array_expression",
            ):
                other = text + (" * 1.05" if self.constants[text] == "f64" else " + 1")
                return self._replaced(node, [], [other], text, other)
        return None

    def _replaced(self, node: Node, operands: list[Node], pieces: list[str], before: str, after: str) -> Site:
        parts = tuple((each.start_byte, each.end_byte) for each in operands)
        edit = Edit(node.start_byte, node.end_byte, parts, tuple(pieces))
        line = node.start_point[0]
        return Site(self.path, line + 1, self.lines[line].strip(), before, after or "(nothing)", edit)


def _text(node: Node) -> str:
    return node.text.decode()


def _digits(literal: str) -> tuple[str, str]:
    """The digits of a literal without `_`, and the type at its end, if any."""
    digits, kind = re.fullmatch(r"(.+?)_?((?:[iuf]\d+|usize)?)", literal).groups()
    return digits.replace("_", ""), kind


def _is_const(function: Node) -> bool:
    return any(child.type == "function_modifiers" and "const" in _text(child) for child in function.children)
