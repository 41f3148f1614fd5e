"""What a reader knows of a whole file, as a finding."""

from __future__ import annotations

from imucal.finding import Finding

__all__ = ["damaged", "remark"]


def remark(file: str, code: str, message: str, way_out: str) -> Finding:
    """A warning about the whole file."""
    return Finding(code, "warning", file, (), None, 1, 1.0, "1", message, way_out)


def damaged(file: str) -> Finding:
    """A log that could be read around its damage."""
    return remark(
        file,
        "file_damaged",
        "the log is damaged, what could not be read was left out",
        "look for gaps in time, or download it again",
    )
