"""Options that several commands share, each declared once, and groups of such options.

A group of options is a dataclass whose fields are options (`options_of`).
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from dataclasses import fields
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, get_type_hints

import imucal.cli.completion as completion
from imucal.cli.parameters import option

if TYPE_CHECKING:
    from imucal.calibration.parameter_text import Units

__all__ = [
    "MAX_ITERATIONS",
    "MIN_REST_S",
    "MODEL",
    "ClockOption",
    "Control",
    "ExcludeSaturated",
    "Gravity",
    "GravityOption",
    "GravitySigmaOption",
    "HeightOption",
    "HoldOption",
    "JsonPath",
    "LatitudeOption",
    "LimitsPath",
    "MinRest",
    "ModelOption",
    "RecordingPath",
    "ReportPath",
    "Require",
    "Required",
    "UnitSystem",
    "UnitsOption",
    "Verbose",
    "effect_option",
    "options_of",
    "unit_option",
    "writing_option",
]

# Heading above the options for printed and written output in the help.
OUTPUT: Final = "Output"
# Heading of the options for gravity and the clock.
REFERENCES: Final = "Gravity and clock"
# Heading of the options for the parameters to estimate.
MODEL: Final = "Model and start values"
# Default of --min-rest-s, s. It equals MIN_REST_S of the compiled library. It is repeated here because --help
# does not load the library.
MIN_REST_S: Final = 1.0
# Default of --max-iterations. It equals MAX_ITERATIONS of the compiled library. It is repeated here because
# --help does not load the library.
MAX_ITERATIONS: Final = 1000

JsonPath = Annotated[
    str | None,
    option("--json", metavar="PATH", help="JSON file to write; - is standard output.", panel=OUTPUT),
]
Control = Annotated[
    list[Path] | None,
    option(
        "--control",
        metavar="REC",
        help="Recording to test the result, not used for the fit; may be repeated.",
    ),
]
Gravity = Annotated[float, option("--gravity", metavar="MPS2", help="Local gravity, m/s^2.")]
# Options for local gravity and the clock in a calibration. Without them, standard gravity and an exact clock
# are assumed.
GravityOption = Annotated[
    float | None,
    option(
        "--gravity",
        metavar="MPS2",
        help="Local gravity, m/s^2; 9.80665 is assumed without it and without --latitude.",
        panel=REFERENCES,
    ),
]
GravitySigmaOption = Annotated[
    float | None,
    option(
        "--gravity-sigma",
        metavar="MPS2",
        help="Standard deviation of local gravity, which adds to the uncertainty of accelerometer scales.",
        panel=REFERENCES,
    ),
]
LatitudeOption = Annotated[
    float | None,
    option(
        "--latitude",
        metavar="DEG",
        help="Latitude, for normal gravity instead of --gravity.",
        panel=REFERENCES,
    ),
]
HeightOption = Annotated[
    float | None,
    option("--height", metavar="M", help="Height of the place, with --latitude.", panel=REFERENCES),
]
ClockOption = Annotated[
    float | None,
    option(
        "--clock-ppm",
        metavar="PPM",
        help="Standard deviation of the clock's rate, which adds to the uncertainty of gyroscope scales.",
        panel=REFERENCES,
    ),
]
MinRest = Annotated[float, option("--min-rest-s", help="Shortest rest to detect, s.")]
ExcludeSaturated = Annotated[
    bool, option("--exclude-saturated", help="Exclude rests and moves with saturated samples.")
]
LimitsPath = Annotated[
    Path | None,
    option("--limits", metavar="LIMITS", help="Limits file; the verdict is poor if a limit is exceeded."),
]
ModelOption = Annotated[
    str,
    option(
        "--model",
        metavar="MODEL",
        help="Parameters without a prior: full, orthogonal (biases and scales) or bias. All other parameters "
        "are held at nominal values by a prior with usual tolerances.",
        panel=MODEL,
    ),
]
HoldOption = Annotated[
    list[str] | None,
    option(
        "--hold",
        metavar="NAME[=VALUE][+-SIGMA]",
        help="Hold a parameter by a prior, such as accel_misalignment_xy=0+-0.005, or a group of them, "
        "such as accel_misalignment; may be repeated.",
        panel=MODEL,
    ),
]


class Required(str, Enum):
    """The worst verdict for which the exit code of a command is still 0."""

    good = "good"
    incomplete = "incomplete"


Require = Annotated[
    Required,
    option("--require", help="Worst verdict with exit code 0; for a worse verdict the exit code is 2."),
]


class UnitSystem(str, Enum):
    """The units of the tables that a command prints."""

    datasheet = "datasheet"
    si = "si"

    @property
    def units(self) -> Units:
        """The function that returns the unit and scale in which a parameter is printed."""
        import imucal.units

        return imucal.units.datasheet if self is UnitSystem.datasheet else imucal.units.si


UnitsOption = Annotated[
    UnitSystem,
    option(
        "--units",
        help="Units of printed tables: datasheet (mg, deg/s, ppm, mrad) or si. Files and --json "
        "are always in SI units.",
        panel=OUTPUT,
    ),
]
Verbose = Annotated[bool, option("--verbose", "-v", help="Also print intermediate results.", panel=OUTPUT)]
ReportPath = Annotated[
    Path | None,
    option("--report", metavar="PAGE", help="HTML report with figures to write; needs plotly.", panel=OUTPUT),
]
RecordingPath = Annotated[Path, option("--output", "-o", help="Recording to write, .csv or .parquet.")]


def writing_option(help: str, metavar: str = "PATH") -> Any:
    """The option --output of a command."""
    return option("--output", "-o", metavar=metavar, help=help, panel=OUTPUT)


def effect_option(help: str, autocompletion: Callable[..., Any], panel: str | None = None) -> Any:
    """The option --effect of a command, which may be repeated."""
    return option("--effect", metavar="NAME", help=help, completion=autocompletion, panel=panel)


def unit_option(help: str, panel: str | None = None) -> Any:
    """The option --unit of a command: the name of a built-in unit profile, or a unit file."""
    return option("--unit", metavar="NAME|FILE", help=help, completion=completion.units, panel=panel)


def options_of(parameter: str, group: Any) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """A decorator that replaces a command's `parameter` by one option for each field of a dataclass.

    group   the dataclass

    Each field is annotated with its option. The command receives an instance of the dataclass.
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
        # The module `parameters` derives the command line parameters from the signature and annotations that
        # are set here.
        with_options.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        with_options.__annotations__ = {given.name: given.annotation for given in parameters}
        return with_options

    return decorate
