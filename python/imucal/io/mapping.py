"""Parses the option `columns`: a list of names, or canonical=name pairs such as time_s=t."""

from __future__ import annotations

from collections.abc import Sequence

from imucal.errors import InputError

__all__ = ["column_list", "mapping_of"]


def column_list(columns: str | Sequence[str]) -> list[str]:
    """The names in a comma-separated list."""
    return [name.strip() for name in (columns.split(",") if isinstance(columns, str) else columns)]


def mapping_of(columns: str | Sequence[str]) -> dict[str, str] | None:
    """For each canonical name, the column name in the file: {"time_s": "t"} for "time_s=t".

    None for a list without `=`.

    Raises InputError if only some names have a `=`, or a canonical name is given twice.
    """
    split = [name.partition("=") for name in column_list(columns)]
    pairs = [(ours.strip(), theirs.strip()) for ours, _, theirs in split]
    if not any(theirs for _, theirs in pairs):
        return None
    for ours, theirs in pairs:
        if not ours or not theirs:
            raise InputError(
                f"columns contains {ours or theirs!r} without a partner: give canonical=name for all "
                "columns, or only names"
            )
        if sum(ours == other for other, _ in pairs) > 1:
            raise InputError(f"columns contains {ours} twice: give it once")
    return dict(pairs)
