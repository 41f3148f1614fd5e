"""Descriptions of the found effects for reports."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape

from imucal.effects.meaning import meaning_of
from imucal.report.tables import heading

__all__ = ["meanings"]


def meanings(names: Sequence[str]) -> Iterator[str]:
    """A section for each effect of the catalogue: the error, its usual cause, and the remedy."""
    for name in dict.fromkeys(names):
        meaning = meaning_of(name)
        if meaning is None:
            continue
        yield heading(f"What {name} is")
        rows = (("", meaning.what), ("Usual cause: ", meaning.cause), ("What to do: ", meaning.remedy))
        yield "\n".join(
            f"<p>{f'<strong>{lead}</strong>' if lead else ''}{escape(text)}</p>" for lead, text in rows
        )
