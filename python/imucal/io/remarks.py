"""Findings of a reader about a whole file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from imucal.finding import Finding

__all__ = ["damaged", "lines_left_out", "remark"]


def remark(file: str, code: str, message: str, way_out: str) -> Finding:
    """A finding of severity warning about the whole file."""
    return Finding(code, "warning", file, (), None, 1, 1.0, "1", message, way_out)


def lines_left_out(file: str, parts: Sequence[str], count: int) -> Finding:
    """The warning that counts the lines left out of a text; `parts` are numbers of lines by kind."""
    return replace(
        remark(
            file,
            "lines_left_out",
            f"left out: {', '.join(parts)}",
            "check that no samples are lost there, or remove these lines from the file",
        ),
        count=count,
    )


def damaged(file: str) -> Finding:
    """The warning for a log with damaged parts that were skipped."""
    return remark(
        file,
        "file_damaged",
        "the log is damaged; unreadable parts were skipped",
        "check the recording for gaps in time, or download the log again",
    )
