"""The command `imucal`: one module for each of its commands, the common frame in `app`."""

from imucal.cli.app import main

__all__ = ["main"]
