"""C headers that can be included together in one program, each with a different prefix."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Sequence
from typing import Final

from imucal.errors import InputError

__all__ = ["PREFIX", "assigned_sum", "guarded", "matrix_constant", "require_prefix"]

PREFIX: Final = "imucal"


def guarded(content: Sequence[str], prefix: str, what: str) -> list[str]:
    """The lines of a C header: the content inside an include guard that contains a hash of the content.

    Including two different calibrations with the same prefix is a compile error; an ordinary include guard
    would silently drop the second calibration. `what` is the kind of the file; files of different kinds can
    have the same prefix.
    """
    start = f"{prefix}_{what}".upper()
    # The hash of the content is part of the name of a macro, because the preprocessor cannot compare strings.
    identity = f"{start}_{hashlib.sha256(repr(content).encode()).hexdigest()[:16].upper()}"
    return [
        f"#ifndef {start}_H",
        f"#define {start}_H",
        f"#define {identity}",
        "",
        *content,
        "",
        f"#elif !defined({identity})",
        f'#error "another calibration is included as {prefix}: export each with a name, '
        'imucal export --name PREFIX"',
        "#endif",
        "",
    ]


def require_prefix(prefix: str) -> None:
    """Raises InputError if `prefix` cannot start a C identifier."""
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", prefix):
        raise InputError(
            f"{prefix!r} cannot start a C name: use letters, digits and _, starting with a letter"
        )


def matrix_constant(
    name: str, rows: Sequence[Sequence[float]], row: Callable[[Sequence[float]], str]
) -> list[str]:
    """The lines that define a constant 3 x 3 matrix in a C function.

    name   type and name of the matrix
    row    function that writes the initialiser of a row
    """
    return [
        f"    static const {name}[3][3] = {{",
        *(f"        {row(numbers)}," for numbers in rows),
        "    };",
    ]


def assigned_sum(start: str, terms: Sequence[str]) -> list[str]:
    """A C statement that assigns a sum, one term per line; `start` is its beginning, such as `x =`."""
    if len(terms) == 1:
        return [f"{start} {terms[0]};"]
    indent = " " * (len(start) - len(start.lstrip()) + 4)
    return [start, *(f"{indent}{term} +" for term in terms[:-1]), f"{indent}{terms[-1]};"]
