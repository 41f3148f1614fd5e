"""Command groups that load a command on use, and write a JSON document even if the command fails."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

import click
from click.exceptions import Exit

from imucal.cli.examples import pasteable
from imucal.cli.failure import no_result_told, refusal_told
from imucal.cli.output import NO_RESULT
from imucal.cli.parameters import Argument, Option, call_with, parameters_of

__all__ = ["Command", "Commands", "Lazy"]

# Maximum length of the summary of a command in the list of commands, characters.
LONGEST_SUMMARY = 200
# Maximum width of the help, characters, even in a wider terminal, because longer lines are hard to read.
WIDEST_HELP = 110
SETTINGS = {"help_option_names": ["-h", "--help"], "max_content_width": WIDEST_HELP}
# Heading in the help for options that do not state a heading.
OPTIONS: Final = "Options"
# Headings in the help that follow all other headings, in this order.
LAST_PANELS: Final = ("Output", "Files of other programs")


class Lazy(NamedTuple):
    """A command whose module is loaded when it is used.

    module     module of the command
    attribute  name of the function or group in this module
    summary    sentence that describes the command in the list of commands
    task       heading under which the command is listed
    """

    module: str
    attribute: str
    summary: str
    task: str = "Commands"


class _Help(click.Command):
    """Command whose help lists the arguments, and then the options in groups."""

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        rows = [
            (item.metavar or "", item.described + ("  [required]" if item.required else ""))
            for item in self.params
            if isinstance(item, Argument)
        ]
        if rows:
            with formatter.section("Arguments"):
                formatter.write_dl(rows)
        panels: dict[str, list[tuple[str, str]]] = {OPTIONS: []}
        for item in self.get_params(ctx):
            record = item.get_help_record(ctx)
            if record is not None and not isinstance(item, Argument):
                panel = item.panel if isinstance(item, Option) else None
                panels.setdefault(panel or OPTIONS, []).append(record)
        # `sorted` is stable, so headings with equal sort keys stay in their order.
        for panel in sorted(
            panels, key=lambda name: LAST_PANELS.index(name) + 1 if name in LAST_PANELS else 0
        ):
            with formatter.section(panel):
                formatter.write_dl(panels[panel])
        if isinstance(self, click.Group):
            self.format_commands(ctx, formatter)


class Command(_Help):
    """A command made from an annotated function. With --json, it also writes the error with which it ends.

    function   function of the command: its docstring is the help, and its annotated parameters are the
               command line parameters
    """

    def __init__(self, function: Callable[..., None], name: str | None = None) -> None:
        super().__init__(
            name or function.__name__,
            help=pasteable(inspect.cleandoc(function.__doc__ or "")),
            callback=call_with(function),
            params=parameters_of(function),
            context_settings=dict(SETTINGS),
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
    """A group of commands. A group with a function can also be called without a subcommand.

    lazy         commands by name, in the order of the list of commands
    function     function that runs without a subcommand; None if `start` or the help is shown instead
    start        text that is shown without a subcommand instead of the help
    other_words  words that users may try, each with the command that does the intended task
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
        start: str | None = None,
        other_words: Mapping[str, str] | None = None,
    ) -> None:
        super().__init__(
            name,
            help=pasteable(help),
            epilog=pasteable(epilog),
            callback=None if function is None else call_with(function),
            params=[*(options or []), *([] if function is None else parameters_of(function))],
            invoke_without_command=function is not None,
            no_args_is_help=False,
            context_settings=dict(SETTINGS),
        )
        self._lazy = dict(lazy or {})
        self._start = start
        self._other_words = dict(other_words or {})

    def list_commands(self, ctx: click.Context | None) -> list[str]:
        """The names of the commands, in the order of the help."""
        return [*self._lazy, *self.commands]

    def get_command(self, ctx: click.Context | None, cmd_name: str) -> click.Command | None:
        """Load the module of the command with this name and return the command; None if there is none."""
        if cmd_name in self._lazy:
            lazy = self._lazy[cmd_name]
            found = getattr(importlib.import_module(lazy.module), lazy.attribute)
            return found if isinstance(found, click.Command) else Command(found, cmd_name)
        return self.commands.get(cmd_name)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands by task, each with the whole first sentence of its help."""
        tasks: dict[str, list[tuple[str, str]]] = {}
        for name, lazy in self._lazy.items():
            tasks.setdefault(lazy.task, []).append((name, lazy.summary))
        for name, item in self.commands.items():
            tasks.setdefault("Commands", []).append((name, item.get_short_help_str(LONGEST_SUMMARY)))
        # The column of command names has the same width in all sections, so that the sentences are aligned.
        widest = max((len(name) for rows in tasks.values() for name, _ in rows), default=0)
        for task, rows in tasks.items():
            with formatter.section(task):
                formatter.write_dl([(name.ljust(widest), summary) for name, summary in rows])

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """The command named by the first word. The error for one of `other_words` names the right command."""
        if args and args[0] in self._other_words and not ctx.resilient_parsing:
            offered = f"{ctx.command_path} {self._other_words[args[0]]}"
            raise click.UsageError(f"there is no command {args[0]!r}: use `{offered}`")
        return super().resolve_command(ctx, args)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the command line; without any word, show the help and end with exit code 1."""
        if not args and not self.invoke_without_command and not ctx.resilient_parsing:
            click.echo(ctx.get_help() if self._start is None else self._start, err=True)
            raise Exit(NO_RESULT)
        return super().parse_args(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the group's own function, and then the subcommand if one is given."""
        # Errors of a group are also written to the file of --json, because `imucal demo` is a group that runs
        # without a subcommand.
        with no_result_told(ctx.params):
            return super().invoke(ctx)

    def subcommand(self, function: Callable[..., None]) -> Callable[..., None]:
        """A decorator that adds a function as a command with the function's name."""
        self.add_command(Command(function))
        return function
