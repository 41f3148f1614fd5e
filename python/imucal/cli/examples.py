"""Formatting of examples in help texts.

Long commands are broken with a backslash, so that they can be copied.
"""

from __future__ import annotations

import re
from typing import Final

__all__ = ["pasteable"]

EXAMPLE: Final = "Example: "
# The library click does not re-wrap a paragraph of the help that starts with this mark.
KEPT_AS_IT_IS: Final = "\b\n"
# Maximum line length of an example, characters. The help has 80 columns, and its text is indented by two
# columns.
WIDTH: Final = 76
INDENT: Final = "    "
# Matches a word of a shell command. A quoted word may contain spaces.
WORD: Final = re.compile(r"(?:'[^']*'|\S)+")


def pasteable(text: str | None) -> str | None:
    """Break the examples in a help text into lines, and protect them from re-wrapping."""
    if text is None:
        return None
    return "\n\n".join(
        f"{KEPT_AS_IT_IS}{_broken(paragraph)}" if paragraph.startswith(EXAMPLE) else paragraph
        for paragraph in text.split("\n\n")
    )


def _broken(example: str) -> str:
    """Break an example into lines of at most WIDTH characters, never between an option and its value."""
    pieces: list[str] = []
    for word in WORD.findall(example):
        if pieces and pieces[-1].startswith("-") and " " not in pieces[-1] and not word.startswith("-"):
            pieces[-1] += f" {word}"
        else:
            pieces.append(word)
    lines = [pieces[0]]
    for piece in pieces[1:]:
        if len(f"{lines[-1]} {piece} \\") > WIDTH:
            lines[-1] += " \\"
            lines.append(f"{INDENT}{piece}")
        else:
            lines[-1] += f" {piece}"
    return "\n".join(lines)
