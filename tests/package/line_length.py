"""Lines that are too long in comments of Rust and in Markdown, which no formatter checks.

    python tests/package/line_length.py     each such line; exit code 1 if there are any

In Markdown tables, code blocks, headings and lines with one long link cannot be wrapped, and pages that the
package prints are left as they are printed.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

LONGEST = 120
FOLDERS = ("rust", "benches", "docs", "examples", "tests")
PRINTED = ("docs/effects.md", "docs/export.md", "docs/formats.md", "docs/results/")
UNWRAPPABLE = re.compile(r"\s*(\||#|!\[|\[[^\]]*\]:|(?:[*-] )?\S+$)")


def too_long(path: Path) -> Iterator[tuple[int, int]]:
    """Numbers of the lines, from 1, and their lengths."""
    in_code = False
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), start=1):
        if path.suffix == ".rs":
            checked = "//" in line
        else:
            fence = line.lstrip().startswith("```")
            in_code = in_code != fence
            indented = line.startswith("    ")
            checked = not (in_code or fence or indented or UNWRAPPABLE.match(line))
        if checked and len(line) > LONGEST:
            yield number, len(line)


def main(root: Path) -> int:
    files = [*root.glob("*.md"), *(path for folder in FOLDERS for path in (root / folder).rglob("*.*"))]
    found = 0
    for path in sorted(path for path in files if path.suffix in (".rs", ".md")):
        name = path.relative_to(root).as_posix()
        if "target" in path.parts or name.startswith(PRINTED):
            continue
        for number, length in too_long(path):
            found += 1
            print(f"{name}:{number}: {length} characters, {LONGEST} are allowed")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(Path(__file__).resolve().parents[2]))
