"""`--install-completion` and `--show-completion`: the script that completes commands in a shell."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

import click
from click.shell_completion import get_completion_class

from imucal.errors import InputError

__all__ = ["install_completion", "show_completion"]

# For each shell: path of the completion script in the home folder, start file of the shell, and the line in
# the start file that loads the script.
PLACES: Final[dict[str, tuple[str, str | None, str]]] = {
    "bash": (".bash_completions/imucal.sh", ".bashrc", "source {path}"),
    "zsh": (".zfunc/_imucal", ".zshrc", "fpath+=~/.zfunc; autoload -Uz compinit; compinit"),
    "fish": (".config/fish/completions/imucal.fish", None, ""),
}


def show_completion(context: click.Context, complete: str) -> None:
    """Print the completion script for the current shell.

    complete   environment variable that the script sets when it calls `imucal`
    """
    print(_script(context, _shell(), complete))


def install_completion(context: click.Context, complete: str) -> None:
    """Write the script for the current shell, and add a line that loads it to the start file if necessary.

    Raises InputError for a shell other than bash, zsh and fish, or if a file cannot be written.

    complete   environment variable that the script sets when it calls `imucal`
    """
    shell = _shell()
    script, started_by, line = PLACES[shell]
    path = Path.home() / script
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(_script(context, shell, complete), encoding="utf-8")
        if started_by is not None:
            _add_line(Path.home() / started_by, line.format(path=f"'{path}'"))
    except OSError as error:
        raise InputError(f"{error.filename or path} cannot be written: {error.strerror}") from None
    print(f"{shell} completion is installed in {path}. It works in new terminals.")


def _add_line(file: Path, line: str) -> None:
    """Add the line at the end of a file unless the file contains it."""
    text = file.read_text(encoding="utf-8", errors="surrogateescape") if file.exists() else ""
    if line not in text.splitlines():
        with file.open("a", encoding="utf-8", errors="surrogateescape") as end:
            end.write(f"{'' if text.endswith(chr(10)) or not text else chr(10)}{line}\n")


def _shell() -> str:
    name = Path(os.environ.get("SHELL", "")).name
    if name not in PLACES:
        raise InputError(
            f"there is no completion for the shell {name or '(SHELL is not set)'}: it works in "
            f"{', '.join(PLACES)}"
        )
    return name


def _script(context: click.Context, shell: str, complete: str) -> str:
    found = get_completion_class(shell)
    if found is None:
        raise InputError(f"there is no completion for the shell {shell}: it works in {', '.join(PLACES)}")
    return found(context.command, {}, "imucal", complete).source().strip("\n")
