"""The command line application: its commands, error messages and exit codes.

    0  good, incomplete   1  bad input, or no result          2  finished, but the verdict is poor
    130  interrupted, 143 and 129 ended by SIGTERM and SIGHUP: no file is incomplete

A reader that closes standard output early changes neither the files that are written nor the exit code.

Commands raise ImucalError for all foreseen errors, which are printed on stderr as a message. Other exceptions
are bugs, whose message explains how to show the traceback.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import Annotated, Any

import typer

from imucal.cli.commands import (
    apply,
    calibrate,
    convert,
    demo,
    diff,
    effects,
    evaluate,
    export,
    gap,
    inspect,
    limits,
    noise,
    plan,
    simulate,
    stand,
)
from imucal.cli.ending import INTERRUPTED, as_interrupts
from imucal.cli.failure import TRACEBACK, is_fault, message_of
from imucal.cli.group import group
from imucal.cli.output import NO_RESULT
from imucal.cli.streams import printable, standing_streams

__all__ = ["app", "main"]

# Messages longer than this number of characters are broken at "; " into one item per line.
MOST_ON_A_LINE = 300

app = group(
    name="imucal",
    help="Calibrate MEMS accelerometers and gyroscopes with gravity as the only reference.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="Exit codes: 0 good or incomplete, 1 bad input or no result, 2 finished with a poor verdict, "
    "130 interrupted.",
)
app.add_typer(demo.app, name="demo")
for command in (
    convert.convert,
    inspect.inspect,
    calibrate.calibrate,
    evaluate.evaluate,
    gap.gap,
    apply.apply,
    export.export,
    diff.diff,
    simulate.simulate,
    plan.plan,
    noise.noise,
    effects.effects,
):
    app.command()(command)
app.add_typer(limits.app, name="limits")
app.add_typer(stand.app, name="stand")


def _print_version(wanted: bool) -> None:
    if wanted:
        import imucal

        print(f"imucal {imucal.__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    with standing_streams(), as_interrupts() as ended:
        try:
            code = _run(list(sys.argv[1:] if arguments is None else arguments))
            sys.stdout.flush()
        except KeyboardInterrupt:
            code = INTERRUPTED
        except OSError as error:
            code = _unwritable(error)
    if code == INTERRUPTED:
        return _say(f"{ended.what}, no file is incomplete", ended.code)
    # An error after a signal, such as that of a closed terminal, does not change the exit code of the signal.
    return code if ended.by is None else ended.code


def _run(arguments: list[str]) -> int:
    try:
        result = app(arguments, prog_name="imucal", standalone_mode=False)
    except (KeyboardInterrupt, typer.Abort):
        return INTERRUPTED
    except (SystemExit, OSError):
        raise
    except BaseException as error:
        # A panic of the compiled library is a BaseException.
        return _failed(error)
    # An interrupt is reported as an exception or as an exit code, depending on the version of typer.
    return result if isinstance(result, int) else 0


def _unwritable(error: OSError) -> int:
    """Handle an OSError; commands convert all but those of standard output to ImucalError."""
    if error.filename is None and error.strerror is not None:
        # Otherwise the interpreter would flush standard output again at exit, and fail.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return _failed(error)


def _failed(error: BaseException) -> int:
    """Print the message of the error that ended the command."""
    if hasattr(error, "format_message"):
        return _wrong_command_line(error)
    if is_fault(error) and os.environ.get(TRACEBACK):
        raise error
    return _say(message_of(error), NO_RESULT)


def _wrong_command_line(error: Any) -> int:
    """Print the message of the command line parser, and the command that shows the help."""
    message = message_of(error)
    if not message:
        # typer has printed the help for `imucal` without arguments.
        return NO_RESULT
    context = getattr(error, "ctx", None)
    hint = f"\nTry '{context.command_path} --help'." if context is not None else ""
    return _say(f"{message}{hint}", NO_RESULT)


def _say(message: str, code: int) -> int:
    if len(message) > MOST_ON_A_LINE:
        message = message.replace("; ", ";\n  ")
    print(f"imucal: {printable(message)}", file=sys.stderr)
    return code
