"""A group of commands, whose help is plain text."""

from __future__ import annotations

from typing import Any

import typer
from typer.core import TyperGroup

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


def group(**settings: Any) -> typer.Typer:
    """A `typer.Typer`; boxes and colours would take longer to load than all that the help needs."""
    return typer.Typer(cls=_Commands, rich_markup_mode=None, **settings)
