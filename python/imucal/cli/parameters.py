"""Command line parameters, declared by the annotations of a command's function.

    def convert(files: Annotated[list[Path], argument(metavar="FILE...", help="...")],
                output: Annotated[Path, option("--output", "-o", help="...")],
                rate_hz: Annotated[float | None, option("--rate-hz", help="...")] = None) -> None: ...

A parameter without a default is required. A parameter of type `bool` is a flag. A parameter of type `list[X]`
may be given several times. A parameter whose type is an `Enum` accepts the values of the `Enum`.
"""

from __future__ import annotations

import inspect
import types
import typing
from collections.abc import Callable
from enum import Enum
from pathlib import Path
from typing import Any, Final

import click

__all__ = ["Argument", "Declared", "Option", "argument", "call_with", "option", "parameters_of"]

_TYPES: Final[dict[Any, Any]] = {str: click.STRING, int: click.INT, float: click.FLOAT}
# Metavars (placeholders of values in the help) of options whose names end with a unit, by this ending.
_ENDINGS: Final = {
    "_s": "S",
    "_hz": "HZ",
    "_deg": "DEG",
    "_dps": "DPS",
    "_degc": "DEGC",
    "minutes": "MINUTES",
}
_METAVARS: Final[dict[Any, str]] = {str: "TEXT", int: "N", float: "NUMBER", Path: "PATH"}
_MISSING: Final = inspect.Parameter.empty


class Declared:
    """The declaration of a parameter by `option` or `argument`, in addition to its type and default."""

    def __init__(
        self,
        names: tuple[str, ...],
        help: str,
        metavar: str | None = None,
        panel: str | None = None,
        completion: Callable[[str], list[str]] | None = None,
        callback: Callable[[Any], None] | None = None,
        is_eager: bool = False,
    ) -> None:
        self.names, self.help, self.metavar, self.panel = names, help, metavar, panel
        self.completion, self.callback, self.is_eager = completion, callback, is_eager

    @property
    def settings(self) -> dict[str, Any]:
        """The settings for the library click that options and arguments have in common."""
        return {
            "metavar": self.metavar,
            "is_eager": self.is_eager,
            "shell_complete": None if self.completion is None else self._complete,
            "callback": None if self.callback is None else self._call_back,
        }

    def _complete(self, context: Any, parameter: Any, typed: str) -> list[str]:
        return [] if self.completion is None else self.completion(typed)

    def _call_back(self, context: Any, parameter: Any, value: Any) -> Any:
        if self.callback is not None:
            self.callback(value)
        return value


def option(
    *names: str,
    help: str,
    metavar: str | None = None,
    panel: str | None = None,
    completion: Callable[[str], list[str]] | None = None,
    callback: Callable[[Any], None] | None = None,
    is_eager: bool = False,
) -> Any:
    """An option `--name`, or a flag `--name/--no-name`.

    panel       heading under which the help lists the option
    completion  function that returns the values that start with the typed text, for shell completion
    callback    function that is called with the value before the command runs
    is_eager    whether the callback is called before other options are checked
    """
    return Declared(names, help, metavar, panel, completion, callback, is_eager)


def argument(*, metavar: str, help: str, completion: Callable[[str], list[str]] | None = None) -> Any:
    """A positional argument."""
    return Declared((), help, metavar, completion=completion)


class Argument(click.Argument):
    """A positional argument with a line in the help."""

    def __init__(self, *declarations: Any, help: str, **settings: Any) -> None:
        super().__init__(*declarations, **settings)
        # The help text is stored in an attribute of another name. click 8.2 does not support a help text of
        # arguments, and newer versions print it in a section with another heading.
        self.described = help


class Option(click.Option):
    """An option that the help lists under the heading `panel`."""

    def __init__(self, *declarations: Any, panel: str | None, **settings: Any) -> None:
        super().__init__(*declarations, **settings)
        self.panel = panel


def parameters_of(function: Callable[..., Any]) -> list[click.Parameter]:
    """The click parameters for the annotated parameters of a function, in the order of the function."""
    return [_parameter(name, *rest) for name, *rest in _signature(function)]


def call_with(function: Callable[..., Any]) -> Callable[..., Any]:
    """The function adapted to the parser: empty lists become defaults, and texts become enum members."""
    kinds = {name: (kind, default) for name, kind, _, default in _signature(function)}

    def called(**values: Any) -> Any:
        return function(**{name: _value(value, *kinds[name]) for name, value in values.items()})

    return called


def _signature(function: Callable[..., Any]) -> list[tuple[str, Any, Declared, Any]]:
    """Name, type, declaration and default of each parameter."""
    hints = typing.get_type_hints(function, include_extras=True)
    rows = []
    for name, given in inspect.signature(function).parameters.items():
        kind, declared = typing.get_args(_annotated(hints[name]))[:2]
        rows.append((name, _without_none(kind), declared, given.default))
    return rows


def _annotated(hint: Any) -> Any:
    """The annotation without Optional, which Python 3.10 adds to a parameter whose default is None."""
    if hasattr(hint, "__metadata__"):
        return hint
    return next(item for item in typing.get_args(hint) if hasattr(item, "__metadata__"))


def _without_none(kind: Any) -> Any:
    if typing.get_origin(kind) in (typing.Union, types.UnionType):
        (kind,) = (item for item in typing.get_args(kind) if item is not type(None))
    return kind


def _parameter(name: str, kind: Any, declared: Declared, default: Any) -> click.Parameter:
    is_list = typing.get_origin(kind) is list
    plain = typing.get_args(kind)[0] if is_list else kind
    settings = declared.settings | {"type": _type_of(plain), "required": default is _MISSING}
    if default is not _MISSING and default is not None:
        settings["default"] = default.value if isinstance(default, Enum) else default
    if not declared.names:
        if is_list and declared.metavar and not declared.metavar.endswith("..."):
            settings["metavar"] = f"{declared.metavar}..."
        return Argument([name], help=declared.help, nargs=-1 if is_list else 1, **settings)
    if plain is bool:
        del settings["type"], settings["metavar"]
        settings |= {"is_flag": True, "default": default}
    elif settings["metavar"] is None:
        settings["metavar"] = _metavar(name, plain)
    shown = default not in (_MISSING, None, "", False)
    return Option(
        [name, *declared.names],
        panel=declared.panel,
        help=declared.help,
        show_default=shown,
        multiple=is_list,
        **settings,
    )


def _metavar(name: str, kind: Any) -> str | None:
    """The placeholder of an option's value in the help, such as HZ for `rate_hz`; None if there is none."""
    if kind in (int, float):
        for ending, metavar in _ENDINGS.items():
            if name.endswith(ending):
                return metavar
    return _METAVARS.get(kind)


def _type_of(kind: Any) -> Any:
    if kind is Path:
        return click.Path(path_type=Path)
    if isinstance(kind, type) and issubclass(kind, Enum):
        return click.Choice([item.value for item in kind])
    return _TYPES.get(kind)


def _value(value: Any, kind: Any, default: Any) -> Any:
    if typing.get_origin(kind) is list:
        return list(value) if value or default is _MISSING else default
    if isinstance(value, str) and isinstance(kind, type) and issubclass(kind, Enum):
        return kind(value)
    return value
