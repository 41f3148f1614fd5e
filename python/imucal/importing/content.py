"""Reads files of other programs as text, JSON or YAML."""

from __future__ import annotations

import json
import os
import re
from typing import Any, Final

from imucal.document.json_document import Node, read_json
from imucal.document.source import open_file, parsing
from imucal.errors import FormatError
from imucal.importing.inav import has_settings
from imucal.importing.parameters import has_parameters
from imucal.importing.source_format import Content
from imucal.io.extra import library

__all__ = ["content_of"]

# Maximum size of a calibration file, bytes. Parameter files of autopilots have about 50 kB, and calibrations
# with cameras up to 1 MB. A larger file is probably a recording.
LARGEST_BYTES: Final = 4 << 20
# Matches a line with a YAML field. A text with such a line is parsed as YAML.
YAML_FIELD: Final = re.compile(r"^\s*[A-Za-z_][\w ]*:(\s|$)", re.MULTILINE)
# Matches numbers with an exponent and no decimal point, which YAML 1.1 reads as text.
EXPONENT_ONLY: Final = re.compile(r"[-+]?\d+(\.\d*)?[eE][-+]?\d+")


def content_of(path: str | os.PathLike[str]) -> Content:
    """The content of a file. A binary file has an empty text.

    Raises InputError if the file cannot be read, FormatError if it is damaged, and ImucalError if it is YAML
    and PyYAML is not installed.
    """
    file = open_file(path)
    name = file.source.path
    if len(file.content) > LARGEST_BYTES:
        raise FormatError(
            f"{name} has {len(file.content)} bytes: a calibration has at most {LARGEST_BYTES}; recordings "
            "are converted by `imucal convert`"
        )
    try:
        text = file.content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return Content(name, "", None, file.source, file.content)
    document = None
    if text.lstrip().startswith("{"):
        document = read_json(path)
    # Files with parameters or settings of an autopilot are not parsed as YAML, because a console may write
    # lines above the parameters that look like YAML.
    elif YAML_FIELD.search(text) and not has_parameters(text) and not has_settings(text):
        document = Node(_yaml(text, name), "$", name)
    return Content(name, text, document, file.source, file.content)


def _yaml(text: str, name: str) -> Any:
    """The value of a YAML document, or a list of values if there are several documents."""
    yaml = library("yaml", "yaml", "YAML files")

    class Once(yaml.SafeLoader):  # type: ignore[misc, name-defined]
        """Loader that refuses duplicate fields, of which PyYAML would silently keep the last."""

        def construct_mapping(self, node: Any, deep: bool = False) -> Any:
            keys = [self.construct_object(key, deep=True) for key, _ in node.value]
            for key in keys:
                if keys.count(key) > 1:
                    raise FormatError(f"{name}: the field {key!r} occurs twice: keep one")
            return super().construct_mapping(node, deep)

    # The directive %YAML:1.0 is removed. OpenCV writes it, and PyYAML does not accept it.
    text = re.sub(r"\A\s*%YAML:1\.0[^\n]*\n(---)?", "", text)
    with parsing(name, "YAML", "export or copy it again"):
        found = [document for document in yaml.load_all(text, Once) if document is not None]
        # The document is converted to JSON and back, which replaces dates by texts and YAML aliases by
        # copies.
        plain = json.loads(json.dumps(found, default=str))
    return _with_numbers(plain[0] if len(plain) == 1 else plain)


def _with_numbers(value: Any) -> Any:
    """Convert texts such as 1e-5, which YAML 1.1 does not read as numbers, to numbers."""
    if isinstance(value, dict):
        return {key: _with_numbers(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_with_numbers(item) for item in value]
    if isinstance(value, str) and EXPONENT_ONLY.fullmatch(value):
        return float(value)
    return value
