"""`imucal noise`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from imucal.cli.decisions import show_noise_fits
from imucal.cli.options import MIN_REST_S, JsonPath, MinRest, ReportPath, Verbose
from imucal.cli.output import Output, prepare_report, require_apart
from imucal.cli.parameters import argument, option
from imucal.cli.reading import Reading, reading_options
from imucal.cli.working import working

if TYPE_CHECKING:
    from imucal.noise_analysis.noise import NoiseFigure, NoiseResult

__all__ = ["noise"]


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
        option("--cut-steps", help="Use only the longest part without a step of the mean (a bump)."),
    ] = False,
    min_rest_s: MinRest = MIN_REST_S,
    verbose: Verbose = False,
    json: JsonPath = None,
) -> None:
    """Estimate noise density, bias instability and random walk of a unit at rest by the Allan deviation.

    Every figure has a 95 % confidence interval. If a kind of noise is not detected, only its upper bound is
    meaningful. Ends with 2 if the noise of an axis is below one count or does not fit the noise model, or if
    the mean of an axis changes in a step.

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
    # Before any file is written, because these conversions refuse raw counts.
    yaml = None if kalibr is None else kalibr_yaml(found, rostopic=rostopic)
    profile = None if unit_profile is None else unit_of_noise(found, name=unit_profile.stem)
    if report is not None:
        from imucal.report import write_noise_page

        write_noise_page(report, found)
    if kalibr is not None and yaml is not None:
        write_text(kalibr, yaml)
    if unit_profile is not None and profile is not None:
        profile.write(unit_profile)
    out = Output(json)
    out.document(found.to_dict())
    if verbose:
        show_noise_fits(out, found)
    _print(out, found)
    for path in (report, kalibr, unit_profile):
        if path is not None:
            out.line(f"written to {path}")
    out.verdict(found.verdict, found.reasons)


def _print(out: Output, found: NoiseResult) -> None:
    out.line(found.heading())

    def row(axis: str, name: str, figure: NoiseFigure) -> list[str]:
        known = figure.value is not None and figure.std is not None
        return [
            f"{axis} {name}",
            f"{figure.value:.4e}" if known else "not detected",
            f"{figure.std:.1e}" if known else "-",
            f"{figure.low:.3e}",
            f"{figure.high:.3e}",
            figure.unit,
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
    out.findings(found.findings)
