"""`imucal demo gap`: simulates a unit with a random effect, searches for it, and prints the true effect."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from imucal.cli.demo_folder import prepare_folder
from imucal.cli.options import JsonPath
from imucal.cli.output import Output
from imucal.cli.parameters import option
from imucal.cli.working import working

if TYPE_CHECKING:
    from imucal.effects.effect import EffectValues
    from imucal.gap.result import Gap

__all__ = ["gap"]

# Effects that the demo can hide. At their typical size they are observable in a run on a stand without
# temperature and encoder readings.
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
# Sampling rate of the simulated runs, Hz.
RATE_HZ: Final = 100.0


def gap(
    folder: Annotated[Path, option("--output", "-o", metavar="FOLDER", help="Folder for the files.")] = Path(
        "demo-gap"
    ),
    seed: Annotated[int, option("--seed", help="Seed of the hidden effect and of both runs.")] = 1,
    json: JsonPath = None,
) -> None:
    """Hide an effect in a simulated unit, find and compensate it, and compare it with the truth.

    Example: imucal demo gap --seed 3
    """
    import imucal
    from imucal.document.json_document import write_json

    prepare_folder(folder, ("run.csv", "control.csv", "truth.json"))
    hidden = _hidden(seed)
    with working("simulating a unit with a hidden effect") as stage:
        runs = [
            imucal.simulate("random", seed=2 * seed + k, rate_hz=RATE_HZ, effects=[hidden]) for k in (0, 1)
        ]
        # The stand angles are removed from the recordings, because the recordings of most users contain none.
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
    out.line(
        f"{folder / 'run.csv'} and {folder / 'control.csv'} contain an effect beyond bias, scale and "
        "misalignment:"
    )
    for line in found.summary().splitlines():
        out.line(line)
    out.line(_revealed(hidden, found))
    files = f"{folder / 'run.csv'} --control {folder / 'control.csv'}"
    out.line(f"to repeat the search: imucal gap {files} -o improved.json")


def _hidden(seed: int) -> EffectValues:
    """The effect to hide. The seed determines which of nine possible effects it is, and its random size."""
    import numpy as np

    from imucal.document.whole import check_seed
    from imucal.effects.effect import EffectValues
    from imucal.effects.table import find

    check_seed(seed)
    random = np.random.default_rng(seed)
    effect = find(HIDDEN[random.integers(len(HIDDEN))])
    typical = np.array([p.typical for p in effect.parameters[: effect.plain]])
    return EffectValues(
        effect.name, typical * random.uniform(0.5, 1.5, len(typical)) * random.choice([-1, 1], len(typical))
    )


def _revealed(hidden: EffectValues, found: Gap) -> str:
    """Text on the hidden effect: whether `imucal gap` found the effect and the right parameters."""
    from imucal.effects.table import find
    from imucal.gap.sizes import for_people

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
    sure = f", all parameters within {max(off):.1f} sigma" if off else ""
    return f"the truth: {hidden.name}, largest parameter {largest:.3g} {unit}: {words}{sure}"
