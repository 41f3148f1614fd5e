"""Findings of a reader about a whole file."""

from __future__ import annotations

from imucal.finding import Finding

__all__ = ["damaged", "remark"]


def remark(file: str, code: str, message: str, way_out: str) -> Finding:
    """A finding of severity warning about the whole file."""
    return Finding(code, "warning", file, (), None, 1, 1.0, "1", message, way_out)


def damaged(file: str) -> Finding:
    """The warning for a log with damaged parts that were skipped."""
    return remark(
        file,
        "file_damaged",
        "the log is damaged; unreadable parts were skipped",
        "check the recording for gaps in time, or download the log again",
    )
