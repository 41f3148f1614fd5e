"""The frame of all commands: what a person sees of an error, and the exit codes.

    0  good          1  bad input, or no result          2  finished, but the verdict is poor
    130  interrupted: no file is half written

A command raises ImucalError for everything that is not a bug; here it becomes a message on stderr. A bug
becomes a message, too, which says how to see the traceback.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from imucal.cli import (
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
from imucal.cli.group import group
from imucal.errors import ImucalError

__all__ = ["app", "main"]

BAD_INPUT = 1
INTERRUPTED = 130
INTERRUPTED_MESSAGE = "interrupted, no file is half written"
# A longer message is a list: its items get lines of their own.
MOST_ON_A_LINE = 300
# Set to anything, it lets a bug end with its traceback.
TRACEBACK = "IMUCAL_TRACEBACK"

app = group(
    name="imucal",
    help="Calibrate MEMS accelerometers and gyroscopes with gravity as the only reference.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="Exit codes: 0 good, 1 bad input or no result, 2 finished but the verdict is poor.",
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
    try:
        code = _run(list(sys.argv[1:] if arguments is None else arguments))
        sys.stdout.flush()
        return code
    except OSError as error:
        if error.strerror is None:
            return _bug(error)
        if error.filename is not None:
            return _say(f"{error.filename}: {error.strerror}", BAD_INPUT)
        # Standard output alone is written without InputError. The interpreter must not flush it once more.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            # Whoever read it has gone and asks for no message.
            return BAD_INPUT
        return _say(f"standard output cannot be written: {error.strerror}", BAD_INPUT)


def _run(arguments: list[str]) -> int:
    try:
        result = app(arguments, prog_name="imucal", standalone_mode=False)
    except ImucalError as error:
        return _say(str(error), BAD_INPUT)
    except (KeyboardInterrupt, typer.Abort):
        return _say(INTERRUPTED_MESSAGE, INTERRUPTED)
    except MemoryError:
        return _say("there is not enough memory: give a shorter recording", BAD_INPUT)
    except (SystemExit, OSError):
        raise
    except BaseException as error:
        # A panic of the compiled library is no Exception.
        return _wrong_command_line(error) if hasattr(error, "format_message") else _bug(error)
    code = result if isinstance(result, int) else 0
    # typer versions differ: an interrupt comes as an exception or as its exit code.
    return _say(INTERRUPTED_MESSAGE, code) if code == INTERRUPTED else code


def _wrong_command_line(error: Any) -> int:
    """What the command line parser says; its class has no stable place to import it from."""
    message = error.format_message()
    if not message:
        # `imucal` alone has printed the help.
        return BAD_INPUT
    context = getattr(error, "ctx", None)
    hint = f"\nTry '{context.command_path} --help'." if context is not None else ""
    return _say(f"{message}{hint}", BAD_INPUT)


def _bug(error: BaseException) -> int:
    """An error that nobody foresaw, in one screen: what, where, and how to see all of it."""
    if os.environ.get(TRACEBACK):
        raise error
    import traceback

    last = traceback.extract_tb(error.__traceback__)[-1]
    what = " ".join(str(error).split())[:500]
    return _say(
        f"this is a fault of imucal and not of your data: {type(error).__name__}: {what or 'no message'}\n"
        f"in {last.name}, {Path(last.filename).name}, line {last.lineno}; no file is half written\n"
        f"Run it again with {TRACEBACK}=1 before the command for the traceback, and report it with that.",
        BAD_INPUT,
    )


def _say(message: str, code: int) -> int:
    if len(message) > MOST_ON_A_LINE:
        message = message.replace("; ", ";\n  ")
    print(f"imucal: {message}", file=sys.stderr)
    return code
