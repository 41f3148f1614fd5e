"""Deliberate errors: where each stands in the sources, and a switch that turns one of them on.

All errors of a sample are written into one copy of the sources. The environment variable IMUCAL_MUTANT
selects the error that is on, so the sources are compiled once for all errors.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

__all__ = ["MOST", "REACHED", "REACHED_IN", "SWITCH", "Edit", "Site", "applied"]

# Environment variable with the number of the error that is on; none is without it.
SWITCH = "IMUCAL_MUTANT"
# Environment variable with a file of MOST bytes, in which each error that is reached sets its byte.
REACHED = "IMUCAL_REACHED"
MOST = 4096
# Environment variable with the folder of the files that the plugin of pytest makes.
REACHED_IN = "IMUCAL_REACHED_IN"


@dataclass(frozen=True)
class Edit:
    """A node of a source, by its bytes, and how its text changes: parts of the text stand between `pieces`.

    operands  bytes of the nodes whose text the changed text repeats, in this order
    pieces    text before, between and after the operands
    """

    first: int
    last: int
    operands: tuple[tuple[int, int], ...]
    pieces: tuple[str, ...]


@dataclass(frozen=True)
class Site:
    """One deliberate error.

    path, line     where it is
    text           the line
    before, after  what the error changes in the line, and into what
    at_import      whether Python evaluates it when the module is imported
    """

    path: str
    line: int
    text: str
    before: str
    after: str
    edit: Edit
    at_import: bool = False

    @property
    def name(self) -> tuple[str, str, str]:
        """Path, text and change, which stay the same if lines are added above."""
        return self.path, self.text, f"{self.before} -> {self.after}"


def applied(source: bytes, sites: Mapping[int, Site], pattern: tuple[str, str, str]) -> str:
    """The source with a switch at each site.

    pattern  text before the changed text, between the changed and the present text, and after the present
             text; NUMBER in it is replaced by the number of the site

    Sites may lie within others, as in `a + b * c`; none overlap in part.
    """

    def rendered(first: int, last: int, inside: Iterable[tuple[int, Site]]) -> str:
        text, at = "", first
        outer = sorted(inside, key=lambda each: (each[1].edit.first, -each[1].edit.last))
        while outer:
            number, site = outer.pop(0)
            edit = site.edit
            within = [each for each in outer if each[1].edit.last <= edit.last]
            outer = [each for each in outer if each[1].edit.last > edit.last]
            text += source[at : edit.first].decode() + switched(number, edit, within)
            at = edit.last
        return text + source[at:last].decode()

    def switched(number: int, edit: Edit, within: list[tuple[int, Site]]) -> str:
        def part(first: int, last: int) -> str:
            return rendered(
                first, last, [(n, s) for n, s in within if first <= s.edit.first and s.edit.last <= last]
            )

        changed = edit.pieces[0]
        for operand, piece in zip(edit.operands, edit.pieces[1:], strict=True):
            changed += part(*operand) + piece
        before, between, after = (each.replace("NUMBER", str(number)) for each in pattern)
        return before + changed + between + part(edit.first, edit.last) + after

    return rendered(0, len(source), sites.items())
