"""The check of line lengths sees what formatters do not, and nothing that cannot be wrapped."""

import importlib.util
from pathlib import Path

import pytest

_spec = importlib.util.spec_from_file_location("line_length", Path(__file__).with_name("line_length.py"))
line_length = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(line_length)

# 120 characters, more bytes.
WORDS = "wörd " * 23 + "words"


@pytest.mark.parametrize("text", [f"/// {WORDS}", f"let a = 1; // {WORDS}", f"fn f() {{\n    // {WORDS}\n}}"])
def test_a_long_comment_of_rust_is_found(text, tmp_path):
    (tmp_path / "a.rs").write_text(text, encoding="utf-8")
    number = text[: text.index("//")].count("\n") + 1
    assert list(line_length.too_long(tmp_path / "a.rs")) == [(number, len(text.splitlines()[number - 1]))]


@pytest.mark.parametrize(
    ("text", "found"),
    [
        (WORDS, []),
        (f"{WORDS} word", [1]),
        (f"* {WORDS}", [1]),
        (f"| {WORDS} |", []),
        (f"```\n{WORDS} word\n```\n{WORDS} word", [4]),
        (f"    {WORDS}", []),
        (f"[a]: https://example.org/{WORDS}", []),
        (f"* {WORDS.replace(' ', '-')}", []),
    ],
)
def test_a_long_line_of_a_page_is_found(text, found, tmp_path):
    (tmp_path / "a.md").write_text(text, encoding="utf-8")
    assert [number for number, _ in line_length.too_long(tmp_path / "a.md")] == found
