"""`imucal demo gap`: an effect is hidden, found, named and taken away, and at last revealed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from imucal.cli.demo_folder import prepare_folder
from imucal.cli.output import JsonPath, Output
from imucal.cli.working import working

if TYPE_CHECKING:
    from imucal.effects.effect import EffectValues
    from imucal.gap.result import Gap

__all__ = ["gap"]

# What a stand run without temperature and encoders shows at its typical size.
HIDDEN: Final = (
    "gyro_g_sensitivity",
    "gyro_scale_quadratic",
    "gyro_scale_asymmetry",
    "gyro_scale_g_sensitivity",
    "gyro_time_offset",
    "accel_scale_quadratic",
    "accel_scale_asymmetry",
    "accel_cross_axis_quadratic",
    "accel_lever_arm",
)
RATE_HZ: Final = 100.0


def gap(
    folder: Annotated[
        Path, typer.Option("--output", "-o", metavar="FOLDER", help="Where the files go.")
    ] = Path("demo-gap"),
    seed: Annotated[int, typer.Option("--seed", help="Of the hidden effect, its size, and both runs.")] = 1,
    json: JsonPath = None,
) -> None:
    """Hide an effect in a simulated unit, find it, name it, take it away, and reveal what it was.

    Example: imucal demo gap --seed 3
    """
    import imucal
    from imucal.document.json_document import write_json

    prepare_folder(folder, ("run.csv", "control.csv", "truth.json"))
    hidden = _hidden(seed)
    with working("simulating a unit with a secret") as stage:
        runs = [
            imucal.simulate("random", seed=2 * seed + k, rate_hz=RATE_HZ, effects=[hidden]) for k in (0, 1)
        ]
        # The search must not use the stand's angles: few people have them.
        run, control = (
            replace(made.recording, stand_rad=None, name=f"{name}.csv")
            for name, made in zip(("run", "control"), runs, strict=True)
        )
        stage("writing the recordings")
        for recording in (run, control):
            imucal.write(recording, folder / recording.name)
        found = imucal.find_gap(run, control=control, stage=stage)
    if found.calibration is not None:
        found.calibration.save(folder / "improved.json")
    write_json(runs[0].truth.to_dict(), folder / "truth.json")
    out = Output(json)
    out.document({**found.to_dict(), "truth": runs[0].truth.to_dict()})
    out.line(f"{folder / 'run.csv'} and {folder / 'control.csv'} hide an effect that the 21 parameters miss:")
    for line in found.summary().splitlines():
        out.line(line)
    out.line(_revealed(hidden, found))
    files = f"{folder / 'run.csv'} --control {folder / 'control.csv'}"
    out.line(f"the same by hand: imucal gap {files} -o improved.json")


def _hidden(seed: int) -> EffectValues:
    """One effect and its size, of the seed alone."""
    import numpy as np

    from imucal.document.whole import check_seed
    from imucal.effects.effect import EffectValues, find

    check_seed(seed)
    random = np.random.default_rng(seed)
    effect = find(HIDDEN[random.integers(len(HIDDEN))])
    typical = np.array([p.typical for p in effect.parameters[: effect.plain]])
    return EffectValues(
        effect.name, typical * random.uniform(0.5, 1.5, len(typical)) * random.choice([-1, 1], len(typical))
    )


def _revealed(hidden: EffectValues, found: Gap) -> str:
    """What it was, beside what was found."""
    from imucal.effects.effect import find
    from imucal.gap.text import for_people

    names = [effect["name"] for effect in found.effects]
    words = "found" if names == [hidden.name] else f"not found: {', '.join(names) or 'nothing'} was named"
    numbers = {
        p["name"]: p
        for effect in found.effects
        if effect["name"] == hidden.name
        for p in effect["parameters"]
    }
    off = [
        abs(numbers[p.name]["value"] - value) / numbers[p.name]["std"]
        for p, value in zip(find(hidden.name).parameters, hidden.values.tolist(), strict=False)
        if p.name in numbers and numbers[p.name]["std"]
    ]
    largest, unit = for_people(float(abs(hidden.values).max()), find(hidden.name).parameters[0].unit)
    sure = f", every number within {max(off):.1f} sigma" if off else ""
    return f"the truth: {hidden.name}, {largest:.3g} {unit} at most: {words}{sure}"
