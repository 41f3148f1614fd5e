"""A group of commands: their help is plain text, and --json gets a document when a command fails, too."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from imucal.cli.output import Output
from imucal.errors import ImucalError

__all__ = ["group"]

LONGEST_SUMMARY = 200


class _Commands(TyperGroup):
    """Shows each command's first sentence whole, where the parser's own list cuts it short."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        commands = [(name, self.get_command(ctx, name)) for name in self.list_commands(ctx)]
        rows = [
            (name, command.get_short_help_str(LONGEST_SUMMARY))
            for name, command in commands
            if command is not None
        ]
        with formatter.section("Commands"):
            formatter.write_dl(rows)


class _Command(TyperCommand):
    """Writes what went wrong where --json asks for the result: a script must not read the last run's."""

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except ImucalError as error:
            path = ctx.params.get("json")
            if path == "-" or (path is not None and not _is_read(path, ctx.params.values())):
                # The error itself is what must be seen, not that of a second file.
                with contextlib.suppress(ImucalError):
                    Output(path).document(error.to_dict())
            raise


class _App(typer.Typer):
    """Its commands are of this file's kind."""

    def command(self, name: str | None = None, **settings: Any) -> Callable[[Any], Any]:
        return super().command(name, cls=_Command, **settings)


def group(**settings: Any) -> typer.Typer:
    """A `typer.Typer`; boxes and colours would take longer to load than all that the help needs."""
    return _App(cls=_Commands, rich_markup_mode=None, **settings)


def _is_read(path: str, given: Iterable[Any]) -> bool:
    """Whether --json names a file that stands in another place of the command line, which may be data."""
    values = [item for value in given for item in (value if isinstance(value, (list, tuple)) else [value])]
    named = [os.path.realpath(value) for value in values if isinstance(value, (str, Path))]
    # The samples of a run that was broken off are in OUTPUT.journal.
    journals = [f"{name}.journal" for name in named]
    # One of them is --json itself.
    return [*named, *journals].count(os.path.realpath(path)) > 1
