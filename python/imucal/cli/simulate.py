"""`imucal simulate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from imucal.cli.output import Gravity, JsonPath, Output
from imucal.cli.working import working

__all__ = ["simulate"]


def simulate(
    program: Annotated[
        str,
        typer.Argument(metavar="PROGRAM", help="random or grid (the paper's programs), or a program file."),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="Recording to write, .csv or .parquet.")],
    truth: Annotated[
        Path | None, typer.Option("--truth", metavar="PATH", help="Where to write the truth, JSON.")
    ] = None,
    unit: Annotated[str, typer.Option("--unit", help="paper or ideal.")] = "paper",
    rate_hz: Annotated[float, typer.Option("--rate-hz", help="Sample rate.")] = 200.0,
    gravity: Gravity = 9.80665,
    seed: Annotated[int, typer.Option("--seed", help="Of the noise and of the random program.")] = 1,
    json: JsonPath = None,
) -> None:
    """Simulate a unit on the stand.

    Example: imucal simulate random --seed 7 -o run.csv --truth truth.json
    """
    import imucal
    from imucal.document import write_json

    with working("simulating"):
        run = imucal.simulate(program, unit=unit, rate_hz=rate_hz, gravity_mps2=gravity, seed=seed)
    with working("writing"):
        imucal.write(run.recording, output)
    if truth is not None:
        write_json(run.truth.to_dict(), truth)
    out = Output(json)
    out.document({"output": str(output), "samples": len(run.recording), "seed": seed, **run.truth.to_dict()})
    out.line(f"{output}: {run.recording!r}, {len(run.truth.rests)} rests")
