"""The command `imucal`.

The module `app` handles errors and exit codes. The package `commands` has one module per command.
"""

from imucal.cli.app import main

__all__ = ["main"]
