"""A group of commands: their help is plain text, and --json gets a document when a command fails, too."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from imucal.cli.examples import pasteable
from imucal.cli.failure import no_result_told, refusal_told

__all__ = ["group"]

LONGEST_SUMMARY = 200


class _Commands(TyperGroup):
    """Shows each command's first sentence whole, where the parser's own list cuts it short."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**_with_examples(settings))

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        commands = [(name, self.get_command(ctx, name)) for name in self.list_commands(ctx)]
        rows = [
            (name, command.get_short_help_str(LONGEST_SUMMARY))
            for name, command in commands
            if command is not None
        ]
        with formatter.section("Commands"):
            formatter.write_dl(rows)

    def invoke(self, ctx: Any) -> Any:
        # `imucal demo` is a group that does something itself.
        with no_result_told(ctx.params):
            return super().invoke(ctx)


class _Command(TyperCommand):
    """Writes what went wrong where --json asks for the result."""

    def __init__(self, name: str | None, **settings: Any) -> None:
        super().__init__(name, **_with_examples(settings))

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        with refusal_told(tuple(args)):
            return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        with no_result_told(ctx.params):
            return super().invoke(ctx)


class _App(typer.Typer):
    """Its commands are of this file's kind."""

    def command(self, name: str | None = None, **settings: Any) -> Callable[[Any], Any]:
        return super().command(name, cls=_Command, **settings)


def _with_examples(settings: dict[str, Any]) -> dict[str, Any]:
    """Settings of a command whose examples can be copied from its help."""
    return settings | {what: pasteable(settings.get(what)) for what in ("help", "epilog")}


def group(**settings: Any) -> typer.Typer:
    """A `typer.Typer`; boxes and colours would take longer to load than all that the help needs."""
    return _App(cls=_Commands, rich_markup_mode=None, **settings)
