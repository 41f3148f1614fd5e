"""The command `imucal`: `app` handles errors and exit codes, `commands` has one module per command."""

from imucal.cli.app import main

__all__ = ["main"]
