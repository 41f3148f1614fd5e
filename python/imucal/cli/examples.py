"""Examples in the help: what is too long for a line goes on after a backslash, so that a copy of it runs."""

from __future__ import annotations

import re
from typing import Final

__all__ = ["pasteable"]

EXAMPLE: Final = "Example: "
# To the parser a paragraph that begins so has its lines already.
KEPT_AS_IT_IS: Final = "\b\n"
# The help is 80 columns wide and indented by two.
WIDTH: Final = 76
INDENT: Final = "    "
# What a shell takes for one: quotes may hold spaces.
WORD: Final = re.compile(r"(?:'[^']*'|\S)+")


def pasteable(text: str | None) -> str | None:
    """A help text with its examples in lines that the parser leaves alone."""
    if text is None:
        return None
    return "\n\n".join(
        f"{KEPT_AS_IT_IS}{_broken(paragraph)}" if paragraph.startswith(EXAMPLE) else paragraph
        for paragraph in text.split("\n\n")
    )


def _broken(example: str) -> str:
    """An example in lines as a shell reads them; an option and its value stay together."""
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
