"""Exceptions of the package. Every message says what is wrong, where, with which value, and what to do."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from imucal.finding import Finding

__all__ = ["FitError", "FormatError", "ImucalError", "InputError", "NotEnoughMotionError"]


class ImucalError(Exception):
    """Base class of all exceptions of this package.

    `findings` lists the faults for which the checks refused a recording. It is empty for any other error.
    """

    def __init__(self, message: str, findings: Sequence[Finding] = ()) -> None:
        super().__init__(message)
        self.findings: list[Finding] = list(findings)

    def to_dict(self) -> dict[str, Any]:
        """The document that `--json` writes if a command fails without a result, schema imucal.error/1."""
        return {
            "schema": "imucal.error/1",
            "verdict": "no_result",
            "error": type(self).__name__,
            "reasons": [str(self)],
            "findings": [finding.to_dict() for finding in self.findings],
        }


class InputError(ImucalError, ValueError):
    """An argument or a recording is invalid."""


class NotEnoughMotionError(ImucalError):
    """The motion does not determine every parameter. The message names these parameters and poses to add."""


class FitError(ImucalError):
    """The fit did not converge to an acceptable result."""


class FormatError(ImucalError):
    """A file is damaged, incomplete, or of another format."""
