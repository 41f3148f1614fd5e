"""Command groups with plain text help, whose commands write a JSON document also when they fail."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from imucal.cli.examples import pasteable
from imucal.cli.failure import no_result_told, refusal_told

__all__ = ["group"]

# Maximum length of the summary of a command in the list of commands, characters.
LONGEST_SUMMARY = 200


class _Commands(TyperGroup):
    """Lists each command with its whole first sentence, which typer's own list would truncate."""

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
        # Also needed for a group, because `imucal demo` runs without a subcommand.
        with no_result_told(ctx.params):
            return super().invoke(ctx)


class _Command(TyperCommand):
    """Writes the error to the file of --json if the command fails."""

    def __init__(self, name: str | None, **settings: Any) -> None:
        super().__init__(name, **_with_examples(settings))

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        with refusal_told(tuple(args)):
            return super().parse_args(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        with no_result_told(ctx.params):
            return super().invoke(ctx)


class _App(typer.Typer):
    """Creates commands of class `_Command`."""

    def command(self, name: str | None = None, **settings: Any) -> Callable[[Any], Any]:
        return super().command(name, cls=_Command, **settings)


def _with_examples(settings: dict[str, Any]) -> dict[str, Any]:
    """Settings of a command, with examples that can be copied from its help."""
    return settings | {what: pasteable(settings.get(what)) for what in ("help", "epilog")}


def group(**settings: Any) -> typer.Typer:
    """A `typer.Typer` with plain text help, because importing rich formatting is slow."""
    return _App(cls=_Commands, rich_markup_mode=None, **settings)
