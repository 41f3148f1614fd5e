"""The command line application: its commands, error messages and exit codes.

    0  finished, the verdict is good or incomplete   1  bad input, or no result   2  the verdict is poor
    130  interrupted, 143 and 129 ended by SIGTERM and SIGHUP; no output file is left incomplete

If a program that reads standard output closes it early, the written files and the exit code are not affected.

Commands raise ImucalError for all foreseen errors, which are printed on stderr as a message. Other exceptions
are bugs; their message explains how to show the traceback.
"""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Callable, Sequence
from contextvars import copy_context
from typing import Any, Final, NoReturn

import click
from click.exceptions import Exit

from imucal.cli.ending import INTERRUPTED, as_interrupts
from imucal.cli.failure import TRACEBACK, command_offered, is_fault, is_interrupt, message_of
from imucal.cli.group import Commands, Lazy
from imucal.cli.output import NO_RESULT
from imucal.cli.streams import printable, standing_streams

__all__ = ["app", "main"]

# Environment variable that the completion script of a shell sets when it calls `imucal`.
COMPLETE = "_IMUCAL_COMPLETE"
# Number of new objects after which Python's garbage collector searches for reference cycles. With the default
# of 700 objects, these searches take 5 % of the processor time of a calibration, because loading the modules
# creates many objects.
OBJECTS_BETWEEN_SEARCHES = 10_000
# Environment variable with the number of threads of OpenBLAS, the linear algebra of most builds of NumPy. By
# default, `import numpy` starts one thread for each processor, which takes a fifth of the processor time of a
# calibration on two processors. The matrices that commands give to NumPy are too small to gain from more than
# one thread.
THREADS = "OPENBLAS_NUM_THREADS"
# Messages longer than this number of characters are split at each "; " into separate lines.
MOST_ON_A_LINE = 300

# Commands by task, in the order of the help: name, and first sentence of the help of the command.
TASKS: Final[dict[str, dict[str, str]]] = {
    "Start here": {
        "demo": "Calibrate a simulated unit and show a report, or find a hidden effect in simulated data.",
        "help": "Show the help of a command, the cause and cure of a reason code, or all commands.",
    },
    "Calibrate one unit": {
        "capture": "Record a unit that you hold in your hand, guided pose by pose, and calibrate it.",
        "inspect": "Show sampling rate, faults and rests of recordings, and the parameters that they "
        "determine.",
        "calibrate": "Calibrate one unit from its recordings.",
        "evaluate": "Evaluate a calibration on recordings of the same unit that were not used for its fit.",
        "gap": "Find a missing effect from the residuals of a calibration, and add it to the model.",
        "plan": "Plan a motion, and predict the standard deviations of the parameters of a calibration "
        "from it.",
        "stand": "Move a stand, record the unit on it, and calibrate.",
    },
    "Use a calibration": {
        "show": "Print the parameters of a calibration file, its verdict and its origin.",
        "apply": "Correct a recording: the output has samples in SI units along the body frame, and all "
        "other columns.",
        "export": "Write a calibration for another program: firmware, autopilots, estimators, simulators.",
        "import": "Read a calibration of another program, such as Kalibr, Basalt, RealSense, PX4 or "
        "ArduPilot.",
        "compose": "Combine two calibrations of a unit into one.",
        "diff": "Compare two calibrations of a unit: difference of each parameter in standard deviations.",
    },
    "Many units": {
        "fleet": "Calibrate the recordings of many units into one store, and query the store.",
        "limits": "Limits for units: write a first limits file from good units, and check units against it.",
    },
    "Noise and temperature": {
        "noise": "Estimate noise density, bias instability and random walk of a unit at rest by the "
        "Allan deviation.",
        "soak": "Find how the biases of a unit at rest in one pose depend on temperature: polynomial, "
        "lag, hysteresis.",
    },
    "Files, effects and simulation": {
        "convert": "Convert files of other programs to a recording.",
        "effects": "List the errors beyond bias, scale and misalignment that imucal models: effects, "
        "noise and faults.",
        "simulate": "Simulate a unit: on a stand, turned by hand, or at rest.",
    },
}
# Commands whose module and function have another name, because the name of the command is a keyword or a
# function of Python.
OTHER_NAMES = {"import": "import_calibration", "help": "help_command"}
# Commands with subcommands. Their module defines a group of commands, `app`, instead of one function.
GROUPS = ("demo", "fleet", "limits", "stand")
# Words that are not commands but that users may type, each with the command that is probably meant.
OTHER_WORDS: Final = {
    "batch": "fleet run",
    "record": "capture",
    "allan": "noise",
    "correct": "apply",
    "validate": "evaluate",
    "header": "export --to c-header",
}
START: Final = """\
imucal calibrates accelerometers and gyroscopes with gravity as the only reference.

See it work, without hardware:
  imucal demo

Calibrate a unit from a recording with rests in many poses, and judge the result on a second recording:
  imucal inspect run.csv
  imucal calibrate run.csv --control control.csv -o unit.json --report report.html

Record and calibrate a unit in your hand, guided pose by pose:
  imucal capture --help

Use the calibration:
  imucal apply unit.json log.csv -o corrected.csv
  imucal export unit.json --to c-header -o unit.h

Many units at once:
  imucal fleet run --help

All commands: imucal help. One command: imucal help calibrate. A code in a message: imucal help gyro_units."""


def _print_version(context: click.Context, _: click.Parameter, wanted: bool) -> None:
    if wanted:
        import imucal

        print(f"imucal {imucal.__version__}")
        context.exit()


def _completion(context: click.Context, parameter: click.Parameter, wanted: bool) -> None:
    if wanted:
        from imucal.cli.shells import install_completion, show_completion

        (install_completion if parameter.name == "install_completion" else show_completion)(context, COMPLETE)
        context.exit()


def _flag(name: str, callback: Callable[..., None], help: str) -> click.Option:
    return click.Option([name], is_flag=True, is_eager=True, expose_value=False, callback=callback, help=help)


app = Commands(
    "imucal",
    {
        name: Lazy(f"imucal.cli.commands.{module}", "app" if name in GROUPS else module, summary, task)
        for task, summaries in TASKS.items()
        for name, summary in summaries.items()
        for module in (OTHER_NAMES.get(name, name),)
    },
    help="Calibrate MEMS accelerometers and gyroscopes with gravity as the only reference.",
    epilog="Exit codes: 0 good or incomplete, 1 bad input or no result, 2 finished with a poor verdict or "
    "another result that the help of the command names, 130 interrupted.",
    start=START,
    other_words=OTHER_WORDS,
    options=[
        _flag("--version", _print_version, "Print the version."),
        _flag("--install-completion", _completion, "Install completion for the current shell."),
        _flag(
            "--show-completion",
            _completion,
            "Show completion for the current shell, to copy it or customize the installation.",
        ),
    ],
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code."""
    gc.set_threshold(OBJECTS_BETWEEN_SEARCHES)
    if arguments is None:
        os.environ.setdefault(THREADS, "1")
    with standing_streams(), as_interrupts() as ended:
        try:
            # The command runs in a copy of the context, so that the context variables that it sets do not
            # affect the next command in the same process.
            code = copy_context().run(_run, list(sys.argv[1:] if arguments is None else arguments))
            sys.stdout.flush()
        except KeyboardInterrupt:
            code = INTERRUPTED
        except OSError as error:
            code = _unwritable(error)
    if arguments is None:
        # Python searches all objects for reference cycles before the process ends, which takes 5 % of the
        # processor time of a calibration. This search skips frozen objects.
        gc.freeze()
    if code == INTERRUPTED:
        return _say(f"{ended.what}, no file is incomplete", ended.code)
    # If a signal ended the command, its exit code belongs to this signal, even if an error occurred after the
    # signal, for example because the terminal was closed.
    return code if ended.by is None else ended.code


def _run(arguments: list[str]) -> int:
    try:
        if COMPLETE in os.environ:
            _complete(os.environ[COMPLETE])
        # `app.main` is not called, because it prints an empty line when the user interrupts the command.
        with app.make_context(app.name, arguments) as context:
            app.invoke(context)
    except Exit as end:
        return end.exit_code
    except (SystemExit, OSError):
        raise
    except BaseException as error:
        # BaseException is caught, because a panic of the compiled library is not an Exception.
        return INTERRUPTED if is_interrupt(error) else _failed(error, arguments)
    return 0


def _complete(instruction: str) -> NoReturn:
    """Run an instruction of the completion script of a shell, such as `bash_complete`."""
    from click.shell_completion import shell_complete

    sys.exit(shell_complete(app, {}, "imucal", COMPLETE, instruction))


def _unwritable(error: OSError) -> int:
    """Print the message of an OSError of standard output. Commands convert other OSErrors to ImucalError."""
    if error.filename is None and error.strerror is not None:
        # Standard output is redirected to the null device, because the interpreter flushes it again at exit.
        # Without the redirection, this flush would also fail.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return _failed(error)


def _failed(error: BaseException, arguments: Sequence[str] = ()) -> int:
    """Print the message of the error that ended the command with these arguments."""
    if hasattr(error, "format_message"):
        return _wrong_command_line(error)
    if is_fault(error) and os.environ.get(TRACEBACK):
        raise error
    return _say(message_of(error) + command_offered(error, arguments), NO_RESULT)


def _wrong_command_line(error: Any) -> int:
    """Print the message of the command line parser, and the command that shows the help."""
    context = getattr(error, "ctx", None)
    hint = f"\nTry '{context.command_path} --help'." if context is not None else ""
    return _say(f"{message_of(error)}{hint}", NO_RESULT)


def _say(message: str, code: int) -> int:
    if len(message) > MOST_ON_A_LINE:
        message = message.replace("; ", ";\n  ")
    print(f"imucal: {printable(message)}", file=sys.stderr)
    return code
