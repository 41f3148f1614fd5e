"""Operators and constants of Python sources that a deliberate error can change."""

from __future__ import annotations

import ast
import random
from collections.abc import Iterable, Iterator
from dataclasses import replace

from mutants.sites import Edit, Site

__all__ = ["PATTERN", "python_sites", "with_switch"]

# Text of a switch: `changed if on(NUMBER) else present`. Python evaluates the condition first.
PATTERN = ("(", " if _imucal_mutant(NUMBER) else ", ")")
IMPORT = "from imucal._mutant import is_on as _imucal_mutant\n"

BINARY = {
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
    ast.FloorDiv: ("//", "*"),
    ast.Pow: ("**", "*"),
}
COMPARISONS = {
    ast.Lt: ("<", ("<=", ">")),
    ast.LtE: ("<=", ("<", ">")),
    ast.Gt: (">", (">=", "<")),
    ast.GtE: (">=", (">", "<")),
    ast.Eq: ("==", ("!=",)),
    ast.NotEq: ("!=", ("==",)),
    ast.Is: ("is", ("is not",)),
    ast.IsNot: ("is not", ("is",)),
    ast.In: ("in", ("not in",)),
    ast.NotIn: ("not in", ("in",)),
}


def python_sites(path: str, source: bytes, chance: random.Random) -> list[Site]:
    """All places of a source where an operator or a constant can change, each with one change."""
    return list(_Finder(path, source, chance).found(ast.parse(source), True))


def with_switch(text: str, at_import: Iterable[int] = ()) -> str:
    """The text of a module that can call the switch: the import follows docstring and `from __future__`.

    at_import  errors that are evaluated when the module is imported; each function of it says that it reaches
               them
    """
    tree, line = ast.parse(text), 0
    for node in tree.body:
        if not _is_docstring(node) and not (isinstance(node, ast.ImportFrom) and node.module == "__future__"):
            break
        line = node.end_lineno or line
    lines = text.splitlines(keepends=True)
    calls = "; ".join(f"_imucal_mutant({number})" for number in at_import)
    added = {line: IMPORT}
    for node in ast.walk(tree) if calls else ():
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            first = next((each for each in node.body if not _is_docstring(each)), None)
            if first is not None and first.lineno > node.lineno:
                above = (
                    min([first.lineno, *(each.lineno for each in getattr(first, "decorator_list", ()))]) - 1
                )
                added[above] = " " * first.col_offset + calls + "\n"
    return added.get(0, "") + "".join(each + added.get(n, "") for n, each in enumerate(lines, 1))


def _is_docstring(node: ast.stmt) -> bool:
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def _is_in(node: ast.AST, body: ast.expr | list[ast.stmt]) -> bool:
    return node in body if isinstance(body, list) else node is body


class _Finder:
    def __init__(self, path: str, source: bytes, chance: random.Random) -> None:
        self.path, self.chance = path, chance
        self.starts = [0]
        for line in source.splitlines(keepends=True):
            self.starts.append(self.starts[-1] + len(line))
        self.source = source

    def found(self, node: ast.AST, at_import: bool) -> Iterator[Site]:
        is_function = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
        for child in self._children(node):
            # The default values of arguments belong to the import.
            now = at_import and not (is_function and _is_in(child, node.body))
            site = self._site(child)
            if site is not None:
                yield replace(site, at_import=now)
            yield from self.found(child, now)

    def _children(self, node: ast.AST) -> Iterator[ast.AST]:
        """Without annotations, decorators, text, patterns and what only type checkers read."""
        if isinstance(node, ast.JoinedStr | ast.pattern):
            return
        if isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING"):
            return
        left_out = {"annotation", "returns", "decorator_list", "format_spec", "type_params"}
        for field, value in ast.iter_fields(node):
            if field not in left_out:
                yield from (
                    each
                    for each in (value if isinstance(value, list) else [value])
                    if isinstance(each, ast.AST)
                )

    def _site(self, node: ast.AST) -> Site | None:
        match node:
            case ast.BinOp(left, operator, right) if type(operator) in BINARY:
                if not any(isinstance(each, ast.JoinedStr) or _is_text(each) for each in (left, right)):
                    sign, other = BINARY[type(operator)]
                    return self._replaced(node, [left, right], ["(", f") {other} (", ")"], sign, other)
            case ast.Compare(left, [operator], [right]):
                sign, others = COMPARISONS[type(operator)]
                other = self.chance.choice(others)
                return self._replaced(node, [left, right], ["(", f") {other} (", ")"], sign, other)
            case ast.BoolOp(operator, [left, right]):
                sign, other = ("and", "or") if isinstance(operator, ast.And) else ("or", "and")
                return self._replaced(node, [left, right], ["(", f") {other} (", ")"], sign, other)
            case ast.UnaryOp(ast.Not(), operand):
                return self._replaced(node, [operand], ["bool(", ")"], "not", "")
            case ast.UnaryOp(ast.USub(), operand) if not isinstance(operand, ast.Constant):
                return self._replaced(node, [operand], ["(", ")"], "-", "")
            case ast.Constant(bool() as value):
                return self._replaced(node, [], [str(not value)], str(value), str(not value))
            case ast.Constant(int() as value):
                return self._replaced(node, [], [str(value + 1)], str(value), str(value + 1))
            case ast.Constant(float() as value):
                other = repr(value * 1.05 if value else 1.0)
                return self._replaced(node, [], [other], repr(value), other)
        return None

    def _replaced(
        self, node: ast.expr, operands: list[ast.expr], pieces: list[str], before: str, after: str
    ) -> Site:
        edit = Edit(*self._bytes(node), tuple(self._bytes(each) for each in operands), tuple(pieces))
        text = self.source.splitlines()[node.lineno - 1].decode().strip()
        return Site(self.path, node.lineno, text, before, after or "(nothing)", edit)

    def _bytes(self, node: ast.expr) -> tuple[int, int]:
        return (
            self.starts[node.lineno - 1] + node.col_offset,
            self.starts[(node.end_lineno or 0) - 1] + (node.end_col_offset or 0),
        )


def _is_text(node: ast.expr) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str)
