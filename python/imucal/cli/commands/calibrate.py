"""The command `imucal calibrate`, which calibrates one unit from its recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import imucal.cli.completion as completion
from imucal.cli.calibration_summary import show_calibration
from imucal.cli.options import (
    MAX_ITERATIONS,
    MIN_REST_S,
    MODEL,
    ClockOption,
    Control,
    ExcludeSaturated,
    GravityOption,
    GravitySigmaOption,
    HeightOption,
    HoldOption,
    JsonPath,
    LatitudeOption,
    LimitsPath,
    MinRest,
    ModelOption,
    ReportPath,
    Require,
    Required,
    UnitsOption,
    UnitSystem,
    Verbose,
    effect_option,
    unit_option,
    writing_option,
)
from imucal.cli.output import Output, prepare_report, require_apart
from imucal.cli.parameters import option
from imucal.cli.reading import Files, Reading, reading_options
from imucal.cli.working import working

__all__ = ["calibrate"]


@reading_options
def calibrate(
    recordings: Files,
    reading: Reading,
    control: Control = None,
    output: Annotated[Path | None, writing_option("Calibration file to write.")] = None,
    gravity: GravityOption = None,
    gravity_sigma: GravitySigmaOption = None,
    latitude: LatitudeOption = None,
    height: HeightOption = None,
    clock_ppm: ClockOption = None,
    frame: Annotated[
        str, option("--frame", help="Body frame: symmetric or triangular.", panel=MODEL)
    ] = "symmetric",
    min_rest_s: MinRest = MIN_REST_S,
    exclude_saturated: ExcludeSaturated = False,
    accel_nominal: Annotated[
        float | None,
        option(
            "--accel-nominal", help="Nominal sensitivity, lsb per m/s^2; estimated if not given.", panel=MODEL
        ),
    ] = None,
    gyro_nominal: Annotated[
        float | None,
        option(
            "--gyro-nominal", help="Nominal sensitivity, lsb per rad/s; estimated if not given.", panel=MODEL
        ),
    ] = None,
    effect: Annotated[
        list[str] | None,
        effect_option(
            "Also estimate this effect (see `imucal effects`; NAME:full for the full form), or a formula "
            "such as 'gyro: k * (supply_v - 3.3)'; may be repeated.",
            completion.effects_to_estimate,
            MODEL,
        ),
    ] = None,
    model: ModelOption = "full",
    hold: HoldOption = None,
    unit: Annotated[
        str | None,
        unit_option(
            "Unit file; its bias instability and random walk are included in the standard deviations, and "
            "its spread over units is the prior of held parameters.",
            MODEL,
        ),
    ] = None,
    folds: Annotated[
        int | None,
        option("--folds", help="Cross-validate with held-out rests and moves in this number of folds."),
    ] = None,
    max_iterations: Annotated[
        int,
        option(
            "--max-iterations",
            help="Maximum number of iterations; the verdict is poor if a fit needs more.",
            panel=MODEL,
        ),
    ] = MAX_ITERATIONS,
    serial_number: Annotated[
        str | None, option("--serial-number", help="Serial number of the unit, stored in the file.")
    ] = None,
    calibration: Annotated[
        Path | None,
        option(
            "--calibration",
            metavar="PATH",
            help="Calibration of the accelerometer. Its parameters and their covariance are the prior, so "
            "only the moves that determine the gyroscope are needed.",
            panel=MODEL,
        ),
    ] = None,
    means: Annotated[
        bool,
        option(
            "--means", help="The file is a table of mean readings: one row for each pose, without a time."
        ),
    ] = False,
    noise: Annotated[
        float | None,
        option(
            "--noise",
            metavar="MPS2",
            help="Standard deviation of each mean of --means, m/s^2; from the residuals if not given.",
        ),
    ] = None,
    limits: LimitsPath = None,
    require: Require = Required.incomplete,
    verbose: Verbose = False,
    report: ReportPath = None,
    units: UnitsOption = UnitSystem.datasheet,
    json: JsonPath = None,
) -> None:
    """Calibrate one unit from its recordings.

    imucal fleet run calibrates a batch of many units.

    Example: imucal calibrate run.csv --control control.csv -o unit-0042.json --limits limits.json
    """
    import imucal

    require_apart(
        [*recordings, *(control or ()), unit, limits, calibration],
        {"--output": output, "--report": report, "--json": json},
    )
    prepare_report(report)
    with working("reading"):
        wanted = imucal.Limits.load(limits) if limits else None
        unit_data = reading.means(recordings) if means else reading.each(recordings)
        judges = reading.each(control or [])
        known = imucal.Calibration.load(calibration) if calibration else None
    with working("calibrating"):
        result = imucal.calibrate(
            unit_data,
            control=judges,
            gravity_mps2=gravity,
            gravity_sigma_mps2=gravity_sigma,
            latitude_deg=latitude,
            height_m=height,
            clock_ppm=clock_ppm,
            frame=frame,
            min_rest_s=min_rest_s,
            exclude_saturated=exclude_saturated,
            accel_nominal=accel_nominal,
            gyro_nominal=gyro_nominal,
            effects=effect or [],
            model=model,
            hold=hold or [],
            unit=unit,
            folds=folds,
            noise_mps2=noise,
            calibration=known,
            max_iterations=max_iterations,
            serial_number=serial_number,
        )
    if wanted is not None:
        result = result.judged_by(wanted)
    if output is not None:
        result.calibration.save(output)
    if report is not None:
        from imucal.report import write_calibration_page

        write_calibration_page(report, result)
    out = Output(json, units)
    out.document(result.to_dict)
    show_calibration(out, result, output, require, verbose=verbose)
