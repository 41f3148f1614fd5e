"""What can go wrong. Every message says what, where, the number, and what to do about it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from imucal.finding import Finding

__all__ = ["FitError", "FormatError", "ImucalError", "InputError", "NotEnoughMotionError"]


class ImucalError(Exception):
    """Base of every error that this package raises on purpose.

    `findings` lists the faults of the data when the checks of a recording refused it; it is empty otherwise.
    """

    def __init__(self, message: str, findings: Sequence[Finding] = ()) -> None:
        super().__init__(message)
        self.findings: list[Finding] = list(findings)

    def to_dict(self) -> dict[str, Any]:
        """The document of `--json`, schema imucal.error/1, of a command that came to no result."""
        return {
            "schema": "imucal.error/1",
            "verdict": "no_result",
            "error": type(self).__name__,
            "reasons": [str(self)],
            "findings": [finding.to_dict() for finding in self.findings],
        }


class InputError(ImucalError, ValueError):
    """An argument or a recording that cannot be used."""


class NotEnoughMotionError(ImucalError):
    """The motion does not determine every parameter; the message names them and the poses to add."""


class FitError(ImucalError):
    """The estimation did not come to an acceptable end."""


class FormatError(ImucalError):
    """A file that is not what it should be: damaged, incomplete, or of another format."""
