"""The command `imucal noise`, which estimates noise figures from a recording at rest."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from imucal.cli.decisions import show_noise_fits
from imucal.cli.options import MIN_REST_S, JsonPath, MinRest, ReportPath, UnitsOption, UnitSystem, Verbose
from imucal.cli.output import Output, prepare_report, require_apart
from imucal.cli.parameters import argument, option
from imucal.cli.reading import Reading, reading_options
from imucal.cli.working import working
from imucal.units import DEGREE_RAD, STANDARD_GRAVITY_MPS2

if TYPE_CHECKING:
    from imucal.calibration.parameter_text import Units
    from imucal.noise_analysis.noise import NoiseFigure, NoiseResult

__all__ = ["noise"]

# Column titles of the table of white noise. For each SI unit of the noise density, WHITE_NOISE_UNITS gives
# the conversion factor and the unit of each column. The two-sided noise density equals the random walk
# coefficient of the integrated signal. The one-sided density is larger by a factor of sqrt(2).
WHITE_NOISE = ("two-sided (filters)", "one-sided (datasheets)", "random walk")
WHITE_NOISE_UNITS = {
    "rad/s/sqrt(Hz)": (
        (1.0, "rad/s/sqrt(Hz)"),
        (math.sqrt(2.0) / DEGREE_RAD, "deg/s/sqrt(Hz)"),
        (60.0 / DEGREE_RAD, "deg/sqrt(h)"),
    ),
    "m/s^2/sqrt(Hz)": (
        (1.0, "m/s^2/sqrt(Hz)"),
        (math.sqrt(2.0) * 1e6 / STANDARD_GRAVITY_MPS2, "ug/sqrt(Hz)"),
        (60.0, "m/s/sqrt(h)"),
    ),
}


@reading_options
def noise(
    recording: Annotated[
        list[Path], argument(metavar="REC", help="Recording at rest, preferably of several hours.")
    ],
    reading: Reading,
    report: ReportPath = None,
    kalibr: Annotated[
        Path | None, option("--kalibr", metavar="PATH", help="Write Kalibr's imu.yaml.")
    ] = None,
    rostopic: Annotated[str, option("--rostopic", metavar="NAME", help="Topic for --kalibr.")] = "/imu0",
    unit_profile: Annotated[
        Path | None,
        option(
            "--unit-profile", metavar="PATH", help="Write a unit file with this noise for imucal simulate."
        ),
    ] = None,
    cut_steps: Annotated[
        bool,
        option("--cut-steps", help="Use only the longest part in which the mean has no step (bump)."),
    ] = False,
    min_rest_s: MinRest = MIN_REST_S,
    verbose: Verbose = False,
    units: UnitsOption = UnitSystem.datasheet,
    json: JsonPath = None,
) -> None:
    """Estimate noise density, bias instability and random walk of a unit at rest by the Allan deviation.

    Every noise figure has a 95 % confidence interval. If a kind of noise is not detected, only the upper
    bound of its interval is meaningful. The exit code is 2 if the noise of an axis is below one count or does
    not fit the noise model, or if the mean of an axis changes in a step.

    Example: imucal noise still.csv --report noise.html --kalibr imu.yaml
    """
    import imucal
    from imucal.document.atomic import write_text
    from imucal.noise_analysis.files import kalibr_yaml, unit_of_noise

    require_apart(
        recording,
        {"--report": report, "--kalibr": kalibr, "--unit-profile": unit_profile, "--json": json},
    )
    prepare_report(report)
    with working("reading"):
        loaded = reading.one(recording)
    with working("identifying the noise"):
        found = imucal.noise(loaded, min_rest_s=min_rest_s, cut_steps=cut_steps)
    # The noise figures are converted for Kalibr and for the unit file before any file is written, because
    # these conversions raise an error for raw counts.
    yaml = None if kalibr is None else kalibr_yaml(found, rostopic=rostopic)
    profile = None if unit_profile is None else unit_of_noise(found, name=unit_profile.stem)
    if report is not None:
        from imucal.report import write_noise_page

        write_noise_page(report, found)
    if kalibr is not None and yaml is not None:
        write_text(kalibr, yaml)
    if unit_profile is not None and profile is not None:
        profile.write(unit_profile)
    out = Output(json, units)
    out.document(found.to_dict())
    if verbose:
        show_noise_fits(out, found)
    _print(out, found, units.units)
    for path in (report, kalibr, unit_profile):
        if path is not None:
            out.line(f"written to {path}")
    out.verdict(found.verdict, found.reasons)


def _print(out: Output, found: NoiseResult, units: Units) -> None:
    out.line(found.heading())

    def row(axis: str, name: str, figure: NoiseFigure) -> list[str]:
        scale = units(name, figure.unit)
        value, std = figure.value, figure.std
        return [
            f"{axis} {name}",
            "not detected" if value is None or std is None else f"{scale.factor * value:.4g}",
            "-" if value is None or std is None else f"{scale.factor * std:.2g}",
            f"{scale.factor * figure.low:.4g}",
            f"{scale.factor * figure.high:.4g}",
            scale.unit,
        ]

    out.table(
        ["figure", "value", "1 sigma", "95 % from", "to", "unit"],
        (
            row(name, figure, estimate)
            for name, axis in found.axes.items()
            for figure, estimate in axis.figures.items()
            if figure != "quantisation" or estimate.value is not None
        ),
    )
    rows = list(filter(None, (_white_noise(name, axis.noise_density) for name, axis in found.axes.items())))
    if rows:
        out.table(["white noise", *WHITE_NOISE], rows)
    out.findings(found.findings)


def _white_noise(axis: str, density: NoiseFigure) -> list[str] | None:
    """The row of an axis in the table of white noise; None if the noise density or its unit is not known."""
    scales = WHITE_NOISE_UNITS.get(density.unit)
    if density.value is None or scales is None:
        return None
    return [axis, *(f"{factor * density.value:.4g} {unit}" for factor, unit in scales)]
