"""The command `imucal help`, which shows the help of a command or explains a reason code."""

from __future__ import annotations

from typing import Annotated

import click

from imucal.cli.parameters import argument

__all__ = ["help_command"]


def help_command(
    words: Annotated[
        list[str] | None, argument(metavar="COMMAND|CODE", help="Command, such as: fleet run; or code.")
    ] = None,
) -> None:
    """Show the help of a command, the cause and cure of a reason code, or all commands.

    Example: imucal help fleet run

    Example: imucal help gyro_units
    """
    from imucal.cli.codes import code_text

    explained = code_text(words[0]) if words and len(words) == 1 else None
    if explained is not None:
        click.echo(explained)
        return
    context = click.get_current_context().parent
    assert context is not None, "`imucal help` is a command of a group"
    for word in words or []:
        group = context.command
        command = group.get_command(context, word) if isinstance(group, click.Group) else None
        if command is None:
            raise click.UsageError(f"{context.command_path} has no command {word!r}", context)
        context = click.Context(command, context, word, **command.context_settings)
    click.echo(context.get_help())
