"""Rules for names of units, operators, effects and columns, and for serial numbers.

Names appear in tables, file names, pages, and in YAML, XML, C and Rust files for other programs. A name is
one line of printable characters. Line separators, control characters and marks that reverse the direction of
text could otherwise start a new line or hide part of a line. File names are not restricted, so they are shown
with escapes.
"""

from __future__ import annotations

from typing import Final

from imucal.errors import InputError

__all__ = ["LONGEST_NAME", "require_name", "shown"]

# Maximum length of a name in characters. A name of this length still fits into a file name.
LONGEST_NAME: Final = 200


def require_name(name: object, what: str) -> str:
    """Return `name` if it is a valid name. Raises InputError, with the reason, for any other value.

    what   words for the name in the message, such as "the rostopic"
    """
    if not isinstance(name, str):
        raise InputError(f"{what} is {name!r}: give text, {str(name)!r}")
    if not name.strip():
        raise InputError(f"{what} is empty: give one or more printable characters")
    if len(name) > LONGEST_NAME:
        raise InputError(f"{what} has {len(name)} characters: give at most {LONGEST_NAME}")
    if not name.isprintable():
        wrong = next(character for character in name if not character.isprintable())
        raise InputError(
            f"{what} is '{shown(name)}', which contains the character U+{ord(wrong):04X}: give characters "
            "that can be printed on one line"
        )
    return name


def shown(text: str, *, keep: str = "") -> str:
    """The text with an escape sequence, in the form of JSON, for each character that cannot be printed.

    keep   characters that are not escaped, such as a line break
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in keep else _escape(c) for c in text)


def _escape(character: str) -> str:
    code = ord(character)
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"
