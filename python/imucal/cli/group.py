"""Command groups that load a command when it is used, and write a JSON document also when it fails."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import click
from click.exceptions import Exit

from imucal.cli.examples import pasteable
from imucal.cli.failure import no_result_told, refusal_told
from imucal.cli.output import NO_RESULT
from imucal.cli.parameters import Argument, call_with, parameters_of

__all__ = ["Command", "Commands", "Lazy"]

# Maximum length of the summary of a command in the list of commands, characters.
LONGEST_SUMMARY = 200
HELP_NAMES = {"help_option_names": ["-h", "--help"]}


class Lazy(NamedTuple):
    """A command whose module is loaded when it is used.

    module     its module
    attribute  the function of a command, or a group
    summary    first sentence of its help, for the list of commands
    """

    module: str
    attribute: str
    summary: str


class _Help(click.Command):
    """Writes the arguments of a command before its options."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        rows = [
            (item.metavar or "", item.described + ("  [required]" if item.required else ""))
            for item in self.params
            if isinstance(item, Argument)
        ]
        if rows:
            with formatter.section("Arguments"):
                formatter.write_dl(rows)
        super().format_options(ctx, formatter)


class Command(_Help):
    """A command of an annotated function; with --json, it writes also the error with which it ends.

    function   its docstring is the help, its annotated parameters those of the command line
    """

    def __init__(self, function: Callable[..., None], name: str | None = None) -> None:
        super().__init__(
            name or function.__name__,
            help=pasteable(inspect.cleandoc(function.__doc__ or "")),
            callback=call_with(function),
            params=parameters_of(function),
            context_settings=dict(HELP_NAMES),
        )

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the command line; an error is written to the file of --json."""
        with refusal_told(tuple(args)):
            return super().parse_args(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; an error is written to the file of --json."""
        with no_result_told(ctx.params):
            return super().invoke(ctx)


class Commands(_Help, click.Group):
    """A group of commands. Its own function, if it has one, also runs without a subcommand.

    lazy      commands by name, in the order of the list of commands
    function  the command without a subcommand, or None, if the help is shown then
    """

    def __init__(
        self,
        name: str,
        lazy: Mapping[str, Lazy] | None = None,
        *,
        help: str,
        epilog: str | None = None,
        function: Callable[..., None] | None = None,
        options: list[click.Parameter] | None = None,
    ) -> None:
        super().__init__(
            name,
            help=pasteable(help),
            epilog=pasteable(epilog),
            callback=None if function is None else call_with(function),
            params=[*(options or []), *([] if function is None else parameters_of(function))],
            invoke_without_command=function is not None,
            no_args_is_help=False,
            context_settings=dict(HELP_NAMES),
        )
        self._lazy = dict(lazy or {})

    def list_commands(self, ctx: click.Context | None) -> list[str]:
        """The names of the commands, in the order of the help."""
        return [*self._lazy, *self.commands]

    def get_command(self, ctx: click.Context | None, cmd_name: str) -> click.Command | None:
        """The command of this name, for which its module is loaded, or None."""
        if cmd_name in self._lazy:
            lazy = self._lazy[cmd_name]
            found = getattr(importlib.import_module(lazy.module), lazy.attribute)
            return found if isinstance(found, click.Command) else Command(found, cmd_name)
        return self.commands.get(cmd_name)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List each command with its whole first sentence."""
        rows = [(name, lazy.summary) for name, lazy in self._lazy.items()]
        rows += [(name, item.get_short_help_str(LONGEST_SUMMARY)) for name, item in self.commands.items()]
        with formatter.section("Commands"):
            formatter.write_dl(rows)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the command line; without any word, show the help and end with exit code 1."""
        if not args and not self.invoke_without_command and not ctx.resilient_parsing:
            click.echo(ctx.get_help(), err=True)
            raise Exit(NO_RESULT)
        return super().parse_args(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the group's own function and the command."""
        # Also needed for a group, because `imucal demo` runs without a subcommand.
        with no_result_told(ctx.params):
            return super().invoke(ctx)

    def subcommand(self, function: Callable[..., None]) -> Callable[..., None]:
        """A decorator that adds a function as a command of its name."""
        self.add_command(Command(function))
        return function
