"""Output of commands: text and tables for people, and a JSON document for scripts."""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Protocol

from click.exceptions import Exit

from imucal.cli.options import UnitSystem
from imucal.cli.streams import printable
from imucal.cli.text_table import table_lines
from imucal.document.name import shown
from imucal.errors import InputError

if TYPE_CHECKING:
    from imucal.calibration.triad import Parameter
    from imucal.finding import Finding
    from imucal.limits.judgement import Judgement
    from imucal.units import Scale


class _Predicted(Protocol):
    """A parameter with its predicted standard deviation, or None if the motion does not determine it."""

    @property
    def name(self) -> str: ...
    @property
    def std(self) -> float | None: ...
    @property
    def unit(self) -> str: ...


__all__ = [
    "Output",
    "prepare_report",
    "require_apart",
]

# Exit code if there is no result, for example after bad input.
NO_RESULT = 1
# Exit code if the verdict is poor or worse than required.
POOR_VERDICT = 2
# Maximum length of a file name, bytes, on Linux, macOS and Windows.
LONGEST_FILE_NAME = 255
# Codes of text styles in a terminal (ECMA-48, SGR), and styles of verdicts and severities by name.
BOLD = "1"
STYLES = {
    "good": "1;32",
    "incomplete": "1;33",
    "poor": "1;31",
    "warning": "33",
    "error": "1;31",
}


def require_apart(inputs: Iterable[str | Path | None], outputs: Mapping[str, str | Path | None]) -> None:
    """Raises InputError if an output file is also an input or another output, or cannot be written.

    Commands call this function before any work is done.

    inputs    input files of the command; may include names of built-in units and stands
    outputs   the output file that each option names; "-" is standard output
    """
    taken = {os.path.realpath(path): "" for path in inputs if path is not None}
    for option, path in outputs.items():
        if path is None or path == "-":
            continue
        _require_place(option, Path(path))
        real = os.path.realpath(path)
        # Several outputs may be the same device or pipe, because writing to a device or pipe overwrites
        # nothing.
        if real in taken and (Path(real).is_file() or not Path(real).exists()):
            raise InputError(
                f"{taken[real]} and {option} are both {path}, so one would overwrite the other: give two "
                "paths"
                if taken[real]
                else f"{option} {path} would overwrite a file that this command reads: give another path"
            )
        taken.setdefault(real, option)


def _require_place(option: str, path: Path) -> None:
    """Raises InputError if `path` is a folder, its folder does not exist, or its name is too long."""
    size = len(os.fsencode(path.name))
    if size > LONGEST_FILE_NAME:
        raise InputError(
            f"{option} {path} cannot be written: its name has {size} bytes, and a file name has at most "
            f"{LONGEST_FILE_NAME}: give a shorter one"
        )
    if path.is_dir():
        raise InputError(f"{option} {path} cannot be written: it is a folder; give the name of a file")
    if not path.parent.is_dir():
        raise InputError(
            f"{option} {path} cannot be written: there is no folder {path.parent}: create it first"
        )


def prepare_report(path: Path | None) -> None:
    """Raises ImucalError, before any work, if a report is requested and plotly is missing."""
    if path is not None:
        from imucal.report import require_plotly

        require_plotly()


class Output:
    """The output of a command.

    If `json_path` is "-", only the JSON document goes to standard output, and all text to standard error.

    json_path   value of --json, or None
    units       units in which parameters and figures of merit are printed
    """

    # Number of calls of `document` in this process. Until a command increases this number, an existing file
    # of --json is from an earlier run.
    documents: ClassVar[int] = 0

    def __init__(self, json_path: str | None, units: UnitSystem = UnitSystem.datasheet) -> None:
        # Characters that the console cannot encode are escaped, so that they do not end the command with an
        # error.
        for output in (sys.stdout, sys.stderr):
            if isinstance(output, io.TextIOWrapper):
                output.reconfigure(errors="backslashreplace")
        self._json_path = json_path
        self._units = units
        self._stream = sys.stderr if json_path == "-" else sys.stdout

    def scale(self, name: str, si_unit: str) -> Scale:
        """The unit and scale in which a quantity with this name and SI unit is printed."""
        return self._units.units(name, si_unit)

    def document(self, document: Mapping[str, Any] | Callable[[], Mapping[str, Any]]) -> None:
        """Write the JSON document if it was requested.

        document  the document, or a function that returns it and is called only if the document is written
        """
        if self._json_path is not None:
            self._write(document() if callable(document) else document, self._json_path)
        Output.documents += 1

    def _write(self, document: Mapping[str, Any], path: str) -> None:
        from imucal.cli.as_typed import document_as_typed
        from imucal.document.json_document import to_json, write_json

        document = document_as_typed(document)
        if path == "-":
            print(to_json(document))
        else:
            write_json(document, path)

    def line(self, text: str, highlighted: str | None = None) -> None:
        """Print a line of text without wrapping it. Names of options are printed as the user types them.

        highlighted   a verdict or a severity, of which the first occurrence is coloured in a terminal
        """
        from imucal.cli.as_typed import as_typed

        printed = printable(as_typed(text))
        if highlighted is not None:
            printed = printed.replace(
                highlighted, self._styled(highlighted, STYLES.get(highlighted, BOLD)), 1
            )
        # Standard output is flushed, so that lines and messages on standard error appear in the order of
        # printing.
        print(printed, file=self._stream, flush=True)

    def table(self, headings: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
        """Print a table. The first column is aligned left, and all other columns are aligned right."""
        for line in table_lines(headings, [list(map(shown, row)) for row in rows], self._bold):
            print(line, file=self._stream, flush=True)

    def _bold(self, text: str) -> str:
        return self._styled(text, BOLD)

    def _styled(self, text: str, code: str) -> str:
        """The text in this style if the output is a terminal and NO_COLOR (no-color.org) is not set."""
        is_terminal = self._stream.isatty() and os.environ.get("TERM", "") not in ("", "dumb", "unknown")
        return f"\x1b[{code}m{text}\x1b[0m" if is_terminal and not os.environ.get("NO_COLOR") else text

    def parameters(self, parameters: Sequence[Parameter], truth: Mapping[str, float] | None = None) -> None:
        """Print the table of parameters, with a column of true values if `truth` is given."""
        from imucal.calibration.parameter_text import difference_text, parameter_row

        headings = ["parameter", "value", "1 sigma", *(["truth", "error / sigma"] if truth else []), "unit"]
        rows = []
        for p in parameters:
            row = parameter_row(p, self._units.units)
            compared = []
            if truth:
                scale = self._units.units(p.name, p.unit)
                std = None if p.std is None else scale.factor * p.std
                error = f"{(p.value - truth[p.name]) / p.std:+.1f}" if p.std else "-"
                compared = [difference_text(scale.shown(truth[p.name]), std), error]
            rows.append([row.name, row.value, row.sigma, *compared, row.unit])
        self.table(headings, rows)

    def predicted(self, parameters: Iterable[_Predicted]) -> None:
        """Print the table of the predicted standard deviations of parameters."""
        from imucal.calibration.parameter_text import sigma_text

        rows = []
        for p in parameters:
            scale = self._units.units(p.name, p.unit)
            std = "not determined" if p.std is None else sigma_text(scale.factor * p.std)
            rows.append([p.name, std, scale.unit])
        self.table(["parameter", "predicted 1 sigma", "unit"], rows)

    def figures(self, rows: Mapping[str, object]) -> None:
        """Print the figures of merit, one line per set of recordings."""
        from imucal.calibration.figures import figures_text

        for name, figures in rows.items():
            if figures is not None:
                self.line(f"{name}: {figures_text(figures, self._units.units)}")

    def findings(self, findings: Sequence[Finding]) -> None:
        """Print one line per finding."""
        for finding in findings:
            self.line(finding.line, finding.severity)

    def judgement(self, judgement: Judgement | None, verbose: bool) -> None:
        """Print the failed checks against limits, the worst first; with `verbose` all checks."""
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

    def verdict(self, verdict: str, reasons: Sequence[str], require: str = "incomplete") -> None:
        """Print the verdict with its reasons. A verdict worse than required ends the command with code 2."""
        self.line("; ".join((f"verdict: {verdict}", *reasons)), verdict)
        if verdict == "poor" or (verdict == "incomplete" and require == "good"):
            raise Exit(POOR_VERDICT)
