"""Reading and writing of JSON documents.

Writing is atomic and refuses non-finite numbers; errors name the field.
"""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from imucal.arrays import FloatArray
from imucal.document.atomic import write_text
from imucal.document.plain import plain
from imucal.errors import FormatError, InputError

__all__ = ["Node", "read_json", "to_json", "write_json"]


def to_json(document: Any) -> str:
    """A document as indented JSON text, with each row of numbers on one line.

    Python writes the shortest decimal form that reads back as the same float64, so numbers are preserved
    exactly. Raises InputError with the name of the field for NaN and infinity, which JSON does not have.
    """
    document = plain(document)
    for path, number in _numbers(document, "$"):
        if not math.isfinite(number):
            raise InputError(f"{path} is {number}: it is not written, JSON holds finite numbers only")
    text = _escaped(json.dumps(document, indent=2, ensure_ascii=False))
    # Lists of numbers are written on one line. The pattern contains line breaks, so it cannot match text
    # inside a JSON string, which contains no raw line break.
    return re.sub(
        r"\[\n\s*([-+\d.eE]+(?:,\n\s*[-+\d.eE]+)*)\n\s*\]",
        lambda match: "[" + re.sub(r",\n\s*", ", ", match[1]) + "]",
        text,
    )


def write_json(document: Any, path: str | os.PathLike[str]) -> None:
    """Write a document as JSON, atomically. Raises InputError if it cannot be written."""
    write_text(path, to_json(document) + "\n")


def read_json(path: str | os.PathLike[str]) -> Node:
    """Read a JSON document. Raises FormatError if the file is not JSON."""
    # The module is imported only when a document is read from a file.
    from imucal.document.source import open_file

    file = open_file(path)
    # Messages contain the path as given, because the file name alone, often calibration.json, does not
    # identify the file.
    given = file.source.path

    def refuse(constant: str) -> None:
        raise FormatError(f"{given}: {constant} is no JSON number: finite numbers are needed")

    def once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        # Two fields with the same name are an error. The json module would silently keep the second field
        # only.
        found = dict(pairs)
        if len(found) < len(pairs):
            names = [name for name, _ in pairs]
            twice = next(name for name in names if names.count(name) > 1)
            raise FormatError(f"{given}: the field {twice!r} occurs twice in one object: keep one")
        return found

    try:
        content = json.loads(file.content, parse_constant=refuse, object_pairs_hook=once)
        return Node(content, "$", given)
    except json.JSONDecodeError as error:
        raise FormatError(
            f"{given} is not JSON: line {error.lineno}, column {error.colno}: {error.msg}: give a JSON file "
            "here (a calibration, limits, a unit, a program); give recordings where --help shows REC"
        ) from None
    except (UnicodeDecodeError, RecursionError):
        raise FormatError(f"{given} is not JSON: it is no text in UTF-8") from None
    except ValueError as error:
        # The json module raises a ValueError for an integer with thousands of digits.
        raise FormatError(f"{given} is JSON that cannot be read: {error}") from None


@dataclass(frozen=True)
class Node:
    """A value in a JSON document, with its path ($.accelerometer.T) and its file.

    Every method raises FormatError with path and file if the value has another type.
    """

    value: Any
    path: str
    file: str

    def require_schema(self, schema: str) -> None:
        """Raise FormatError unless the field `schema` of the document equals the argument `schema`."""
        found = self.value.get("schema") if isinstance(self.value, dict) else None
        if found != schema:
            what = "has no schema" if found is None else f"has the schema {found!r}"
            raise FormatError(f"{self.file}: the document {what}, {schema!r} is needed")

    def get(self, name: str) -> Node:
        """The field `name` of an object, which must exist."""
        if not isinstance(self.value, dict):
            raise self._wrong("an object")
        if name not in self.value:
            raise FormatError(f"{self.file}: the field {self.path}.{name} is missing")
        return Node(self.value[name], f"{self.path}.{name}", self.file)

    def items(self) -> list[Node]:
        """The items of a list."""
        if not isinstance(self.value, list):
            raise self._wrong("a list")
        return [Node(item, f"{self.path}[{index}]", self.file) for index, item in enumerate(self.value)]

    def mapping(self) -> dict[str, Any]:
        """An object as a dictionary."""
        if not isinstance(self.value, dict):
            raise self._wrong("an object")
        return self.value

    def text(self, one_of: Sequence[str] = ()) -> str:
        """A string. If `one_of` is not empty, the string must be one of its items."""
        if not isinstance(self.value, str) or (one_of and self.value not in one_of):
            raise self._wrong(f"one of {', '.join(one_of)}" if one_of else "a string")
        return self.value

    def number(self) -> float:
        """A finite number."""
        # Booleans are excluded, because bool is a subclass of int in Python. Infinity is excluded, because
        # the json module reads 1e999 as infinity.
        if isinstance(self.value, bool) or not isinstance(self.value, (int, float)):
            raise self._wrong("a number")
        try:
            number = float(self.value)
        except OverflowError:
            number = math.inf
        if not math.isfinite(number):
            raise self._wrong("a finite number")
        return number

    def whole(self) -> int:
        """A non-negative integer."""
        if isinstance(self.value, bool) or not isinstance(self.value, int) or self.value < 0:
            raise self._wrong("a whole number, zero or more")
        return self.value

    def flag(self) -> bool:
        """True or false."""
        if not isinstance(self.value, bool):
            raise self._wrong("true or false")
        return self.value

    def array(self, *shape: int) -> FloatArray:
        """An array from nested lists of numbers, which must have exactly this shape."""
        items = self.items()
        if len(items) != shape[0]:
            raise self._wrong(f"a list of {shape[0]} items, not {len(items)}")
        rows = [item.array(*shape[1:]) if len(shape) > 1 else item.number() for item in items]
        return np.array(rows, dtype=np.float64).reshape(shape)

    def _wrong(self, needed: str) -> FormatError:
        shown = json.dumps(self.value)
        shown = shown if len(shown) <= 40 else shown[:37] + "..."
        return FormatError(f"{self.file}: {self.path} is {shown}, it must be {needed}")


def _escaped(text: str) -> str:
    """JSON text with an escape for each character that cannot be printed.

    Such characters occur in strings only.
    """

    def escape(match: re.Match[str]) -> str:
        character = match[0]
        return character if character.isprintable() else json.dumps(character)[1:-1]

    return re.sub("[^\x00-\x7e]", escape, text)


def _numbers(value: Any, path: str) -> Iterator[tuple[str, float]]:
    """Every float in a document, with its path."""
    if isinstance(value, float):
        yield path, value
    elif isinstance(value, dict):
        for key, item in value.items():
            yield from _numbers(item, f"{path}.{key}")
    elif isinstance(value, list):
        for index, item in enumerate(value):
            yield from _numbers(item, f"{path}[{index}]")
