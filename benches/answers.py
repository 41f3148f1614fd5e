"""The answers behind a page of results, in docs/results/data, and their origin.

A file holds a line of JSON with the origin: commit, command and machine. A line for each call follows: its
name, its argument, and its answer. It is compressed with xz. `make test` repeats some of the calls, so a page
whose numbers the code no longer gives is found.
"""

from __future__ import annotations

import dataclasses
import datetime
import json
import lzma
import math
import os
import platform
import subprocess
import sys
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from sections import machine_name, write_section

__all__ = ["DATA", "KeptAnswer", "commit", "differs", "plain", "publish", "read", "say_origin"]

ROOT: Final = Path(__file__).resolve().parents[1]
DATA: Final = ROOT / "docs/results/data"
DIGITS: Final = 6
# Two results are the same if each number agrees within this share of the largest number beside it.
TOLERANCE: Final = 1e-3
# Fields of answers that hold processor times, which no run repeats.
TIMES: Final = frozenset({"seconds"})


@dataclass(frozen=True)
class KeptAnswer:
    """One call of a benchmark: the name of its function, its argument, and its answer as JSON has it."""

    name: str
    argument: Any
    answer: Any


def plain(value: Any) -> Any:
    """A value as JSON has it: fields of dataclasses by name, arrays as lists, numbers with six digits."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(each) for key, each in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, set | frozenset):
        return sorted(plain(each) for each in value)
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else repr(value)
    return value if isinstance(value, bool | int | str | None) else str(value)


def differs(kept: Any, now: Any) -> str | None:
    """Where two plain answers differ, or None if they are the same."""
    if isinstance(kept, dict) and isinstance(now, dict):
        if kept.keys() != now.keys():
            return f"fields {sorted(kept.keys() ^ now.keys())}"
        pairs = ((name, differs(kept[name], now[name])) for name in kept if name not in TIMES)
        return next((f"{name}: {found}" for name, found in pairs if found), None)
    if isinstance(kept, list) and isinstance(now, list):
        if len(kept) != len(now):
            return f"{len(kept)} items, not {len(now)}"
        if kept and all(_is_number(each) for each in [*kept, *now]):
            size = max(map(abs, kept))
            far = [(a, b) for a, b in zip(kept, now, strict=True) if abs(a - b) > TOLERANCE * size]
            return f"{far[0][0]}, not {far[0][1]}" if far else None
        return next(filter(None, map(differs, kept, now)), None)
    if _is_number(kept) and _is_number(now):
        return None if abs(kept - now) <= TOLERANCE * abs(kept) else f"{kept}, not {now}"
    return None if kept == now else f"{kept!r}, not {now!r}"


def commit() -> str:
    """The commit of the code, and whether it has changes."""
    # Pages that were made before are no changes.
    changes = _git("status", "--short", "--", ".", ":!docs/results")
    return _git("rev-parse", "--short=10", "HEAD") + (" with changes" if changes else "")


def publish(page: Path, name: str, rows: Iterable[KeptAnswer], commit: str) -> None:
    """Keep the rows of a benchmark, and say on the page where they are and where they come from.

    commit  of the code when the benchmark began
    """
    paths = filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))
    path = os.pathsep.join(os.path.relpath(each, ROOT) for each in paths)
    words = [f"PYTHONPATH={path}"] if path else []
    origin = {
        "commit": commit,
        "date": datetime.date.today().isoformat(),
        "command": " ".join([*words, Path(sys.orig_argv[0]).name, *sys.orig_argv[1:]]),
        "machine": f"{machine_name()}, Python {platform.python_version()}",
    }
    DATA.mkdir(parents=True, exist_ok=True)
    lines = [json.dumps(origin)]
    lines += [json.dumps([row.name, row.argument, row.answer], separators=(",", ":")) for row in rows]
    with lzma.open(DATA / f"{name}.jsonl.xz", "wt", encoding="utf-8", preset=9) as file:
        file.write("\n".join(lines) + "\n")
    say_origin(page, name, origin, len(lines) - 1)


def say_origin(page: Path, name: str, origin: Mapping[str, str], count: int) -> None:
    """Say on a page where its answers are, and where they come from."""
    said = (
        f"* [{name}](data/{name}.jsonl.xz): {count} answers. `{origin['command']}` at commit "
        f"{origin['commit']}, {origin['date']}; {origin['machine']}."
    )
    text = page.read_text(encoding="utf-8").partition("\n## Origin\n")[2].partition("\n## ")[0]
    others = [line for line in text.splitlines() if line.startswith("* [") and f"[{name}]" not in line]
    write_section(page, page.stem, "Origin", "\n".join(sorted([*others, said])))


def read(name: str) -> tuple[dict[str, str], Iterator[KeptAnswer]]:
    """The origin and the rows of a benchmark."""
    with lzma.open(DATA / f"{name}.jsonl.xz", "rt", encoding="utf-8") as file:
        origin, *rows = map(json.loads, file)
    return origin, (KeptAnswer(*row) for row in rows)


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _git(*words: str) -> str:
    return subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True).stdout.strip()
