"""C headers that may stand beside each other in one program, each under a prefix of its own."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from typing import Final

from imucal.errors import InputError

__all__ = ["PREFIX", "guarded", "require_prefix"]

PREFIX: Final = "imucal"


def guarded(content: Sequence[str], prefix: str, what: str) -> list[str]:
    """The file, with a macro that says which calibration it is.

    Another one under its name is a compile error: an ordinary guard would drop it in silence. `what` tells
    kinds of files with one prefix apart.
    """
    start = f"{prefix}_{what}".upper()
    # The preprocessor compares whole numbers alone; whether a name is defined it knows for any name.
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
    """Refuse what C cannot have at the start of a name, with InputError."""
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", prefix):
        raise InputError(
            f"{prefix!r} cannot start the names of a C header: use letters, digits and _, a letter first"
        )
