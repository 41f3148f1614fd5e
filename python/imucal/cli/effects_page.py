"""The page docs/effects.md, from the catalogue."""

from __future__ import annotations

from imucal.cli.commands.effects import NEEDS, size
from imucal.effects.disturbance import disturbances
from imucal.effects.effect import Effect, EffectParameter, catalogue

__all__ = ["page"]

HEAD = """# Effects

What a real sensor does beyond bias, scale and misalignment. `imucal effects --markdown docs/effects.md`
writes this page from the catalogue; `imucal effects NAME` shows one with all its parameters.

    measured = T (true + effects) + bias

with w the angular rate, f the specific force, dw/dt the angular acceleration, dT the temperature less 25 degC
and t the time since the first sample; the law and its inverse are (15) and (16) of [the model](model.md). A
parameter is called `<effect>_<parameter>`; `xy` is seen on x and caused by y.
"""

GALLERY = """## What they look like

The error that each effect leaves in corrected readings as long as nobody takes it away, on a stand that turns
the unit, with parameters drawn with their typical sizes as standard deviations. Below it the rate of the
motion, or the temperature. `make docs-figures` draws them from the fields of the catalogue.
"""

IN_PYTHON = """## With Python

```python
import numpy as np
import imucal

for effect in imucal.effects.catalogue():
    print(effect.name, effect.formula, [parameter.name for parameter in effect.parameters])

identity = imucal.Triad(np.eye(3), np.zeros(3))
calibration = imucal.Calibration(
    identity, identity, effects=(imucal.EffectValues("gyro_bias_warmup", [1e-3, 0, 0], shape=100.0),)
)
time_s = np.arange(100) / 100
recording = imucal.Recording(time_s, np.tile([0, 0, 9.80665], (100, 1)), np.zeros((100, 3)))
print(calibration.apply_recording(recording).angular_rate[0])
```

`Calibration.apply` takes away what depends on rate and force alone; `apply_recording` knows time, temperature
and angular acceleration too. An effect that depends on the attitude stays in the data
(`Calibration.left_in_data`): a gyroscope rightly measures the Earth's rate.

Where `Calibration.takes_pieces`, a recording too long for memory is corrected piece by piece, `start_s` being
its first time: `imucal.io.read_pieces` and `write_pieces` do that for CSV and Parquet, and so does
`imucal apply`. An effect of the angular acceleration needs the whole: a derivative by time reaches over the
ends of a piece.

## Your own

A name, parameters, and a function that gives the field: what is added to the true rate (rad/s) or force
(m/s^2) in the body frame per unit of each parameter, (N, 3, p). Here a gyroscope's bias follows the supply
voltage, which was recorded in a column `supply_v`:

```python
import numpy as np
import imucal

def field(state):
    return (state.auxiliary["supply_v"] - 3.3)[:, None, None] * np.eye(3)

per_volt = tuple(imucal.EffectParameter(axis, "rad/s/V", 1e-3) for axis in "xyz")
supply = imucal.UserEffect("gyro_bias_supply", "gyroscope", per_volt, field)

identity = imucal.Triad(np.eye(3), np.zeros(3))
calibration = imucal.Calibration(
    identity,
    identity,
    effects=(imucal.EffectValues("gyro_bias_supply", [0.01, 0, 0]),),
    user_effects=(supply,),
)
calibration.save("unit.json")

recording = imucal.Recording(
    [0.0, 0.01],
    [[0, 0, 9.80665]] * 2,
    [[0.002, 0, 0], [0.001, 0, 0]],
    auxiliary={"supply_v": [3.5, 3.4]},
)
again = imucal.Calibration.load("unit.json", user_effects=[supply])
assert abs(again.apply_recording(recording).angular_rate).max() < 1e-15
```

The function is called with a `State` of N samples: `angular_rate`, `specific_force`, `angular_acceleration`,
`time_s`, `temperature_degc` and `auxiliary`. The calibration's file has the numbers and not the function.
"""


def page() -> str:
    """The text of the page."""
    lines = [HEAD, "## The catalogue", ""]
    lines += ["| effect | adds | parameters | typical | depends on | shown by |", "|---|---|---|---|---|---|"]
    lines += [_row(effect) for effect in catalogue()]
    lines += ["", "What an effect depends on besides rate and force:", ""]
    needed = {need for effect in catalogue() for need in effect.needs}
    lines += [f"* {need.replace('_', ' ')}: {source}" for need, source in NEEDS.items() if need in needed]
    lines += ["", "## Easily mistaken", "", "| effect | for | told apart by |", "|---|---|---|"]
    lines += [
        f"| `{effect.name}` | {_code(alias.name)} | {_cell(alias.told_apart_by)} |"
        for effect in catalogue()
        for alias in effect.aliases
    ]
    lines += [
        "",
        "## Noise and faults",
        "",
        "These have no field. They are named, and not taken away.",
        "",
    ]
    lines += ["| name | where | kind | parameters | typical | shown by |", "|---|---|---|---|---|---|"]
    for row in disturbances():
        names = ", ".join(parameter.name for parameter in row.parameters)
        typical = size(row.parameters[0])
        lines.append(f"| `{row.name}` | {row.sensor} | {row.kind} | {names} | {typical} | {row.looks_for} |")
    lines += ["", GALLERY]
    lines += [_picture(effect) for effect in catalogue()]
    return "\n".join([*lines, IN_PYTHON])


def _picture(effect: Effect) -> str:
    return (
        f"### {effect.name}\n\n`{effect.formula}`\n\n"
        f"![Error along a motion, {effect.observable}](effects/{effect.name}.svg)\n"
    )


def _row(effect: Effect) -> str:
    names = _names(effect.parameters[: effect.plain])
    if effect.plain < len(effect.parameters):
        names += "; full form: " + _names(effect.parameters[effect.plain :])
    sizes = list(dict.fromkeys(map(size, effect.parameters)))
    if effect.shape is not None:
        names += f"; shape: {effect.shape.name}"
        sizes.append(size(effect.shape))
    needs = ", ".join(need.replace("_", " ") for need in effect.needs)
    link = f"[`{effect.name}`](#{effect.name})"
    cells = [link, f"`{effect.formula}`", names, ", ".join(sizes), needs, effect.observable]
    return f"| {' | '.join(map(_cell, cells))} |"


def _names(parameters: tuple[EffectParameter, ...]) -> str:
    return " ".join(parameter.name for parameter in parameters)


def _code(name: str) -> str:
    return f"`{name}`" if name.isidentifier() else name


def _cell(text: str) -> str:
    """Text in a table, where a bar would end the cell."""
    return text.replace("|", "\\|")
