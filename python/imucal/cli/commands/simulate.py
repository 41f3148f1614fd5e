"""The command `imucal simulate`, which simulates a recording of a unit."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import click

import imucal.cli.completion as completion
from imucal.cli.options import JsonPath, RecordingPath
from imucal.cli.output import Output, require_apart
from imucal.cli.parameters import argument, option
from imucal.cli.working import working
from imucal.errors import InputError

__all__ = ["simulate"]

# Headings of the options in the help.
MOTION = "Motion"
UNIT = "Unit"
PLACE = "Place and clock"

# If a run is repeated from a truth file, only these parameters of the command are allowed: the truth file
# itself, and the options that name output files.
OUTPUTS = {"program", "output", "truth", "truth_samples", "save_unit", "json"}


def simulate(
    program: Annotated[
        str,
        argument(
            metavar="PROGRAM",
            help="random or grid (the paper's programs on a stand), faces (a box rolled over its faces), "
            "tumble (hand-held), static, a program file, or a truth file, whose run is repeated.",
            completion=completion.programs,
        ),
    ],
    output: RecordingPath,
    truth: Annotated[
        Path | None, option("--truth", metavar="PATH", help="Truth file to write, JSON.")
    ] = None,
    truth_samples: Annotated[
        Path | None,
        option(
            "--truth-samples",
            metavar="PATH",
            help="File to write with the true force, rate, angular acceleration and attitude of every "
            "sample, .csv or .parquet.",
        ),
    ] = None,
    seed: Annotated[
        int, option("--seed", help="Seed of the noise, of the random program and of the tumble.")
    ] = 1,
    unit: Annotated[
        str,
        option(
            "--unit",
            metavar="NAME|FILE",
            help="paper, ideal, bmi088, adis16460, icm42688p, mpu6050, lsm6dso; random:NAME:SEED for a unit "
            "drawn from the spread in its datasheet; or a unit file.",
            completion=completion.units,
            panel=UNIT,
        ),
    ] = "paper",
    save_unit: Annotated[
        Path | None,
        option("--save-unit", metavar="PATH", help="Unit file to write.", panel=UNIT),
    ] = None,
    effect: Annotated[
        list[str] | None,
        option(
            "--effect",
            metavar="NAME=VALUES",
            help="Effect, noise or fault, SI units: NAME=V for all parameters, NAME=V,V,V for each, or "
            "NAME=typical. Append @SHAPE if the effect has a shape parameter. May be repeated; see "
            "`imucal effects`.",
            completion=completion.effects_to_simulate,
            panel=UNIT,
        ),
    ] = None,
    temperature: Annotated[
        str | None,
        option(
            "--temperature",
            metavar="SPEC",
            help="DEGC, warmup:START:END:TIME_CONSTANT_S, cycle:LOW:HIGH:DURATION_S, or a CSV file with the "
            "columns time_s,temp_degc.",
            panel=UNIT,
        ),
    ] = None,
    filter_hz: Annotated[
        str | None,
        option(
            "--filter",
            metavar="HZ",
            help="Bandwidth of the low-pass filter before sampling, Hz, or `datasheet` for the bandwidth in "
            "the datasheet.",
            panel=UNIT,
        ),
    ] = None,
    averaging: Annotated[
        bool,
        option("--averaging", help="Samples are means over the sampling interval.", panel=UNIT),
    ] = False,
    rate_hz: Annotated[float, option("--rate-hz", help="Sampling rate, Hz.", panel=PLACE)] = 200.0,
    clock_error: Annotated[
        float,
        option("--clock-error", help="Relative rate error of the clock.", panel=PLACE),
    ] = 0.0,
    gravity: Annotated[
        float | None,
        option(
            "--gravity",
            metavar="MPS2",
            help="Local gravity, m/s^2; by default from --latitude, or 9.80665.",
            panel=PLACE,
        ),
    ] = None,
    latitude: Annotated[
        float | None,
        option(
            "--latitude",
            metavar="DEG",
            help="Latitude, for gravity and the Earth rate; without it the Earth rate is zero.",
            panel=PLACE,
        ),
    ] = None,
    height: Annotated[
        float | None,
        option("--height", metavar="M", help="Height above the ellipsoid, m.", panel=PLACE),
    ] = None,
    stand: Annotated[
        str | None,
        option(
            "--stand",
            metavar="FILE|cheap",
            help="Errors of the stand: a stand file, cheap, or cheap:SEED for another stand.",
            panel=MOTION,
        ),
    ] = None,
    moves: Annotated[int | None, option("--moves", help="random: number of moves.", panel=MOTION)] = None,
    max_rate_dps: Annotated[
        float | None,
        option(
            "--max-rate-dps",
            help="random: mean rate of each motor in a move, deg/s.",
            panel=MOTION,
        ),
    ] = None,
    step_deg: Annotated[float | None, option("--step-deg", help="grid: step, deg.", panel=MOTION)] = None,
    poses: Annotated[int | None, option("--poses", help="tumble: number of poses.", panel=MOTION)] = None,
    hold_s: Annotated[float | None, option("--hold-s", help="Duration of a rest, s.", panel=MOTION)] = None,
    move_s: Annotated[float | None, option("--move-s", help="Duration of a move, s.", panel=MOTION)] = None,
    tremor_deg: Annotated[
        float | None,
        option("--tremor-deg", help="tumble: standard deviation of the hand tremor, deg.", panel=MOTION),
    ] = None,
    translation_mm: Annotated[
        float | None,
        option(
            "--translation-mm",
            help="tumble: edge length of the cube that contains the positions of the poses, mm.",
            panel=MOTION,
        ),
    ] = None,
    duration_s: Annotated[
        float | None, option("--duration-s", help="static: duration, s.", panel=MOTION)
    ] = None,
    json: JsonPath = None,
) -> None:
    """Simulate a unit: on a stand, turned by hand, or at rest.

    Example: imucal simulate random --seed 7 -o run.csv --truth truth.json

    Example: imucal simulate tumble --unit random:bmi088:3 --effect gyro_g_sensitivity=1e-4 -o run.csv
    """
    import imucal
    from imucal.document.json_document import write_json
    from imucal.effects.values import parse_effects
    from imucal.rig.motion import motion_of
    from imucal.simulation.truth import is_truth

    require_apart(
        [program, unit, stand, temperature],
        {
            "--output": output,
            "--truth": truth,
            "--truth-samples": truth_samples,
            "--save-unit": save_unit,
            "--json": json,
        },
    )
    motion_options = {
        "moves": moves,
        "max_rate_dps": max_rate_dps,
        "step_deg": step_deg,
        "poses": poses,
        "hold_s": hold_s,
        "move_s": move_s,
        "tremor_deg": tremor_deg,
        "translation_mm": translation_mm,
        "duration_s": duration_s,
    }
    with working("simulating"):
        if is_truth(program):
            _require_no_setup(click.get_current_context())
            run = imucal.repeat(program)
        else:
            run = imucal.simulate(
                motion_of(program, seed, {k: v for k, v in motion_options.items() if v is not None}),
                seed=seed,
                unit=unit,
                effects=parse_effects(effect or ()),
                stand=stand,
                rate_hz=rate_hz,
                gravity_mps2=gravity,
                latitude_deg=latitude,
                height_m=height,
                temperature=temperature,
                clock_rate_error=clock_error,
                filter_hz=filter_hz,
                averaging=averaging,
            )
    with working("writing"):
        imucal.write(run.recording, output)
        if truth_samples is not None:
            run.truth.write_samples(truth_samples)
    if truth is not None:
        write_json(run.truth.to_dict(), truth)
    if save_unit is not None:
        run.truth.setup.unit.write(save_unit)
    out = Output(json)
    used = run.truth.setup.seed
    out.document({"output": str(output), "samples": len(run.recording), "seed": used, **run.truth.to_dict()})
    out.line(f"{output}: {run.recording!r}, {len(run.truth.rests)} rests")


def _require_no_setup(context: click.Context) -> None:
    """Refuse options whose values a truth file already contains."""
    for parameter in context.command.params:
        name = parameter.name or ""
        source = context.get_parameter_source(name)
        if name not in OUTPUTS and source is not None and source.name == "COMMANDLINE":
            raise InputError(
                f"{parameter.opts[0]} is given, but the truth file already states this setting: leave it out"
            )
