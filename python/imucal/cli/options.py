"""Options shared by several commands: a dataclass whose fields are command line options."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from dataclasses import fields
from typing import Any, get_type_hints

__all__ = ["options_of"]


def options_of(parameter: str, group: Any) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """A decorator that replaces a command's `parameter` by one option for each field of a dataclass.

    group   the dataclass

    The fields have the annotations of typer options. The command receives an instance of the dataclass.
    """

    def decorate(command: Callable[..., None]) -> Callable[..., None]:
        hints = get_type_hints(command, include_extras=True)
        kept = [
            given.replace(annotation=hints[given.name])
            for given in inspect.signature(command).parameters.values()
            if given.name != parameter
        ]
        option_hints = get_type_hints(group, include_extras=True)
        options = [
            inspect.Parameter(
                field.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=field.default,
                annotation=option_hints[field.name],
            )
            for field in fields(group)
        ]

        @functools.wraps(command)
        def with_options(**values: Any) -> None:
            given = group(**{field.name: values.pop(field.name) for field in fields(group)})
            command(**{parameter: given}, **values)

        parameters = [given.replace(kind=inspect.Parameter.KEYWORD_ONLY) for given in kept] + options
        # typer reads the signature and the annotations.
        with_options.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        with_options.__annotations__ = {given.name: given.annotation for given in parameters}
        return with_options

    return decorate
