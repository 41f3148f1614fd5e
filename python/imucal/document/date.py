"""The date in documents."""

from __future__ import annotations

from datetime import datetime, timezone

__all__ = ["now"]


def now() -> str:
    """The current time for a document: ISO 8601, UTC, with a resolution of one second."""
    return datetime.now(timezone.utc).isoformat(timespec="seconds")
