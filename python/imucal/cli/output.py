"""What commands print: tables for people, a JSON document for scripts."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import typer

from imucal.errors import InputError

if TYPE_CHECKING:
    from imucal.calibration.triad import Parameter
    from imucal.finding import Finding
    from imucal.limits.judgement import Judgement

__all__ = [
    "Control",
    "ExcludeSaturated",
    "Gravity",
    "JsonPath",
    "LimitsPath",
    "MinRest",
    "Output",
    "ReportPath",
    "Verbose",
    "prepare_report",
    "require_apart",
]

# Exit codes. Bad input, too, comes to no result.
NO_RESULT = 1
POOR_VERDICT = 2
# Wide enough for every table when the output is a file or a pipe, where rich would assume 80 columns.
PIPE_WIDTH = 160

JsonPath = Annotated[
    str | None, typer.Option("--json", metavar="PATH", help="Write the result as JSON; - is standard output.")
]
Control = Annotated[
    list[Path] | None,
    typer.Option("--control", metavar="REC", help="A recording that only judges; may be given again."),
]
Gravity = Annotated[float, typer.Option("--gravity", metavar="MPS2", help="Local gravity, m/s^2.")]
MinRest = Annotated[float, typer.Option("--min-rest-s", help="Shortest rest, s.")]
ExcludeSaturated = Annotated[
    bool, typer.Option("--exclude-saturated", help="Leave out rests and moves with saturated samples.")
]
LimitsPath = Annotated[
    Path | None,
    typer.Option(
        "--limits", metavar="LIMITS", help="Limits file: one that is not kept makes a poor verdict."
    ),
]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Say each decision, and not only the result.")]
ReportPath = Annotated[
    Path | None,
    typer.Option("--report", metavar="PAGE", help="HTML page with figures to write; needs plotly."),
]


def require_apart(inputs: Iterable[str | Path | None], outputs: Mapping[str, str | Path | None]) -> None:
    """InputError if a file to write is one that is read, or two are one: before anything is lost.

    It is raised, too, for one that cannot be written because it is a folder or in none: before the work.

    inputs    files that the command reads; a name of something built in is no file
    outputs   by option, the files that it writes; "-" is standard output
    """
    taken = {os.path.realpath(path): "" for path in inputs if path is not None}
    for option, path in outputs.items():
        if path is None or path == "-":
            continue
        _require_place(option, Path(path))
        real = os.path.realpath(path)
        # What is written to a device or a pipe does not take the place of anything.
        if real in taken and (Path(real).is_file() or not Path(real).exists()):
            raise InputError(
                f"{taken[real]} and {option} are both {path}, one would overwrite the other: give two paths"
                if taken[real]
                else f"{option} {path} would overwrite a file that this command reads: give another path"
            )
        taken.setdefault(real, option)


def _require_place(option: str, path: Path) -> None:
    """InputError if there is no place for a file."""
    if path.is_dir():
        raise InputError(f"{option} {path} cannot be written: it is a folder, give a file's name")
    if not path.parent.is_dir():
        raise InputError(
            f"{option} {path} cannot be written: there is no folder {path.parent}: make it first"
        )


def prepare_report(path: Path | None) -> None:
    """ImucalError if a report is asked for and plotly is missing: before the work, not after it."""
    if path is not None:
        from imucal.report import require_plotly

        require_plotly()


class Output:
    """The output of one command: `json_path` as given with --json.

    With --json - the document alone goes to standard output, the summary for people to standard error.
    """

    # How many documents this process has written: none, and the last run's may still be there.
    documents: ClassVar[int] = 0

    def __init__(self, json_path: str | None) -> None:
        from rich.console import Console

        # A file's name, or a sigma on an old console, must not end a command that has done its work.
        for output in (sys.stdout, sys.stderr):
            if isinstance(output, io.TextIOWrapper):
                output.reconfigure(errors="backslashreplace")
        self._json_path = json_path
        stream = sys.stderr if json_path == "-" else sys.stdout
        width = None if stream.isatty() else PIPE_WIDTH
        self._console = Console(file=stream, width=width, markup=False, highlight=False, emoji=False)

    def document(self, document: Mapping[str, Any]) -> None:
        """Write the JSON document, if one was asked for."""
        from imucal.document.json_document import to_json, write_json

        if self._json_path == "-":
            print(to_json(document))
        elif self._json_path is not None:
            write_json(document, self._json_path)
        Output.documents += 1

    def line(self, text: str) -> None:
        """A line of text; it is never broken."""
        self._console.print(text, soft_wrap=True)

    def table(self, headings: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
        """A table: the first column to the left, the others to the right."""
        from rich.measure import Measurement
        from rich.table import Table

        table = Table(box=None, pad_edge=False)
        for index, heading in enumerate(headings):
            table.add_column(heading, justify="left" if index == 0 else "right", no_wrap=True)
        for row in rows:
            table.add_row(*row)
        # A narrow terminal breaks a long line; digits that are cut off would be lost.
        own_width = self._console.width
        self._console.width = max(own_width, PIPE_WIDTH)
        self._console.width = max(
            own_width, Measurement.get(self._console, self._console.options, table).maximum
        )
        self._console.print(table)
        self._console.width = own_width

    def parameters(self, parameters: Sequence[Parameter], truth: Mapping[str, float] | None = None) -> None:
        """The table of parameters, with the truth where it is known."""
        headings = ["parameter", "value", "1 sigma", *(["truth", "error / sigma"] if truth else []), "unit"]
        rows = []
        for p in parameters:
            row = [p.name, f"{p.value:.7g}", "-" if p.std is None else f"{p.std:.2e}"]
            if truth:
                row += [f"{truth[p.name]:.7g}", f"{(p.value - truth[p.name]) / p.std:+.1f}" if p.std else "-"]
            rows.append([*row, p.unit])
        self.table(headings, rows)

    def figures(self, rows: Mapping[str, Mapping[str, Any] | None]) -> None:
        """The figures of merit, one line for each set."""
        from imucal.calibration.figures import figures_text

        for name, figures in rows.items():
            if figures is not None:
                self.line(f"{name}: {figures_text(figures)}")

    def findings(self, findings: Sequence[Finding]) -> None:
        """One line for each finding."""
        for finding in findings:
            self.line(finding.line)

    def judgement(self, judgement: Judgement | None, verbose: bool) -> None:
        """The limits that are not kept, the worst first, and with `verbose` the others after them."""
        if judgement is None:
            return
        checks = judgement.by_use if verbose else judgement.failed
        if checks:
            rows = [
                (c.what, c.value_text, c.limit_text, c.unit, "pass" if c.passed else "FAIL") for c in checks
            ]
            self.table(("check", "value", "limit", "unit", ""), rows)
        for warning in judgement.warnings:
            self.line(f"warning: {warning}")
        self.line(judgement.count)

    def verdict(self, verdict: str, reasons: Sequence[str]) -> None:
        """The verdict; a poor one ends the command with its exit code."""
        self.line("; ".join((f"verdict: {verdict}", *reasons)))
        if verdict == "poor":
            raise typer.Exit(POOR_VERDICT)
