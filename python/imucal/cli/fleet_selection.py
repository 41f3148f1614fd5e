"""Arguments and options of all commands that read a store of calibrations (`imucal fleet`)."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from imucal.cli.options import options_of
from imucal.cli.output import require_apart
from imucal.cli.parameters import argument, option

if TYPE_CHECKING:
    from imucal.fleet.fleet import Fleet

__all__ = ["CsvPath", "Selection", "StorePath", "selection_options", "store_of", "write_table"]

StorePath = Annotated[Path, argument(metavar="STORE", help="Store that `imucal fleet run` has made.")]
CsvPath = Annotated[Path | None, option("--csv", metavar="PATH", help="Also write the table as CSV.")]

PANEL = "Selection"


def _text(name: str, help: str) -> Any:
    return option(name, metavar="TEXT", help=help, panel=PANEL)


@dataclass(frozen=True)
class Selection:
    """Options that select calibrations; the fields are the arguments of `Fleet.measurements`."""

    since: Annotated[
        str | None, option("--since", metavar="DATE", help="Only from this date on.", panel=PANEL)
    ] = None
    until: Annotated[
        str | None, option("--until", metavar="DATE", help="Only before this date.", panel=PANEL)
    ] = None
    station: Annotated[str | None, _text("--station", "Only of this station.")] = None
    operator: Annotated[str | None, _text("--operator", "Only of this operator.")] = None
    batch: Annotated[str | None, _text("--batch", "Only of this batch.")] = None
    role: Annotated[str | None, _text("--role", "Only with this role in the manifest, such as grr.")] = None

    @property
    def given(self) -> dict[str, str | None]:
        """The options that the user has given, as arguments of `Fleet.measurements`."""
        return {name: value for name, value in asdict(self).items() if value is not None}


def selection_options(command: Callable[..., None]) -> Callable[..., None]:
    """Decorator: replaces the parameter `selection` of a command by the options of `Selection`."""
    return options_of("selection", Selection)(command)


def store_of(path: Path, **outputs: str | Path | None) -> Fleet:
    """The store at `path`. Raises InputError if an output would overwrite it.

    outputs   output files; the keyword of a file is its command line option without dashes
    """
    from imucal.fleet.fleet import Fleet

    require_apart([path], {f"--{name}": output for name, output in outputs.items()})
    return Fleet(path)


def write_table(path: Path | None, headings: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    """Write a table as CSV, atomically; does nothing if `path` is None."""
    if path is None:
        return
    from imucal.document.atomic import write_text

    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(headings)
    writer.writerows(rows)
    write_text(path, text.getvalue())
