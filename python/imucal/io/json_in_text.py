"""Refusal of texts that contain JSON in a form that is not read, with the way out."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Final

from imucal.document.source import first_bytes
from imucal.errors import FormatError
from imucal.io.layout import HEAD
from imucal.io.packed import unpacked_start

__all__ = ["refuse_json", "text_before_json"]

# Start of a list or an object in JSON.
START: Final = rb"(?:\xef\xbb\xbf)?\s*(?:\{\s*\"|\[\s*[\[{])"
# Matches a line with text before an object in JSON.
PREFIXED: Final = r"\s*[^{\s][^{]*(\{.*\})\s*"
# Number of lines that are searched for text before JSON.
LINES: Final = 50


def refuse_json(path: str | os.PathLike[str]) -> None:
    """Raises FormatError for a file in JSON, which is given as one of two files."""
    name = Path(path).name
    if re.match(START, unpacked_start(name, first_bytes(path, HEAD), HEAD)):
        raise FormatError(
            f"{name} is JSON, and two files in JSON are not read together: write the samples of both sensors "
            'to one file, as one list per sensor: {"accelerometer": [...], "gyroscope": [...]}'
        )


def text_before_json(rows: bytes) -> str:
    """A sentence on rows with text before the JSON of each row; empty for other rows."""
    lines = [line for line in rows.decode(errors="replace").split("\n")[:LINES] if line.strip()]
    objects = [re.fullmatch(PREFIXED, line) for line in lines]
    if not objects or not all(found is not None and _is_json(found[1]) for found in objects):
        return ""
    return (
        f"each line has text before its JSON ({lines[0][:40]}...): if this text names the sensor or the "
        'unit, make it a member of the JSON ({"sensor": "accelerometer", ...}); otherwise remove it, so that '
        "each line starts with {"
    )


def _is_json(text: str) -> bool:
    import json

    try:
        json.loads(text)
    except ValueError:
        return False
    return True
