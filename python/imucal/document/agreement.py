"""Check that a document does not contradict itself: writing its fields again must give the same document.

Documents repeat some of their contents for readers, such as a table of parameters beside the matrices. A file
that was edited by hand in one of two places contradicts itself, and no program can know which place is
correct.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass
from typing import Any, Final

from imucal.document.json_document import Node
from imucal.errors import FormatError

__all__ = ["ROUNDING", "Origin", "agree", "require_agreement", "require_fields"]

# Largest relative difference between two numbers that counts as rounding. It allows for files whose numbers
# were rounded to seven digits.
ROUNDING: Final = 1e-6


@dataclass(frozen=True)
class Origin:
    """Origin of a value that a document repeats, and the largest difference that counts as rounding.

    place      the field or fields of the document that the value repeats, for messages
    absolute   largest absolute difference of the two numbers that counts as rounding
    relative   largest difference, relative to the larger of the two numbers, that counts as rounding
    """

    place: str
    absolute: float = 0.0
    relative: float = ROUNDING


def agree(one: float, other: float, *, absolute: float = 0.0, relative: float = ROUNDING) -> bool:
    """Whether two numbers differ by no more than the given rounding."""
    return abs(one - other) <= max(absolute, relative * max(abs(one), abs(other)))


def require_agreement(
    given: Node, written: Any, *, origin: Callable[[str], Origin], optional: Container[str], way_out: str
) -> None:
    """Raise FormatError for the first value in `given` that differs from the value at its path in `written`.

    given     the document as it was read
    written   the document that is made from the fields of `given`, as plain values
    origin    function that returns, for the path of a value, the field that this value repeats
    optional  names of fields that older files do not have
    way_out   what to do about a difference
    """
    # Fast path: equal values need no further comparison. Nearly all values of a document are equal.
    if type(given.value) is type(written) and given.value == written:
        return
    if isinstance(written, dict):
        fields = given.mapping()
        require_fields(given, list(written), "this document")
        for name, value in written.items():
            if name in fields or name not in optional:
                require_agreement(given.get(name), value, origin=origin, optional=optional, way_out=way_out)
    elif isinstance(written, list):
        items = given.items()
        if len(items) != len(written):
            raise FormatError(
                f"{given.file}: {given.path} has {len(items)} items, but {origin(given.path).place} gives "
                f"{len(written)}: {way_out}"
            )
        for item, value in zip(items, written, strict=True):
            require_agreement(item, value, origin=origin, optional=optional, way_out=way_out)
    elif not _is_same(given.value, written, origin(given.path)):
        raise FormatError(
            f"{given.file}: {given.path} is {_shown(given.value)}, but {origin(given.path).place} gives "
            f"{_shown(written)}: {way_out}"
        )


def require_fields(node: Node, known: Sequence[str], what: str) -> None:
    """Raise FormatError for an unknown field. The message suggests the known field with the nearest name.

    known   names of the allowed fields
    what    words for the kind of `node` in the message, such as "a unit file"
    """
    for name in node.mapping():
        if name not in known:
            import difflib

            close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
            hint = f"is it {close[0]}?" if close else f"there are {', '.join(known)}"
            raise FormatError(f"{node.file}: {node.path}.{name} is no field of {what}: {hint}")


def _is_same(given: Any, written: Any, origin: Origin) -> bool:
    if _is_number(given) and _is_number(written):
        return agree(given, written, absolute=origin.absolute, relative=origin.relative)
    return type(given) is type(written) and bool(given == written)


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _shown(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 120 else text[:117] + "..."
