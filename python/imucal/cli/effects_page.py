"""Text of the page docs/effects.md, which is generated from the catalogue of effects."""

from __future__ import annotations

from imucal.effects.disturbance import DisturbanceParameter, disturbances
from imucal.effects.effect import Effect, EffectParameter
from imucal.effects.table import catalogue

__all__ = ["NEEDS", "page", "size"]

NEEDS = {
    "time": "relative to the first sample",
    "temperature": "the column temp_degc, relative to 25 degC",
    "temperature_history": "the temperatures since the first sample (model.md (43))",
    "angular_acceleration": "the derivative of the rate, smoothed as the motion permits (model.md (16))",
    "attitude": "not known when data are corrected; such an effect is no sensor error and stays in the data",
    "stand": "the motors that rotate the unit; not part of the correction of the sensors",
}

HEAD = """# Effects

An effect is a systematic error of a sensor beyond bias, scale and misalignment.
`imucal effects --markdown docs/effects.md` writes this page from the catalogue. `imucal effects NAME` prints
one effect with all its parameters.

    measured = T (true + effects) + bias

w is the angular rate, f the specific force, dw/dt the angular acceleration, dT the temperature minus 25
degC, and t the time since the first sample. Equations (15) and (16) of [the model](model.md) define the
model and its inverse. A parameter is called `<effect>_<parameter>`; `xy` is the error on x caused by y.
"""

GALLERY = """## What they look like

Each picture shows the error of the corrected signals over time if the effect is not compensated. A stand
rotates the unit, and the parameters are random numbers whose standard deviations are the typical sizes.
The lower curve is the angular rate of the motion or, for effects of the temperature, the temperature.
`make docs-figures` draws the pictures from the definitions in the catalogue.
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

`Calibration.apply` compensates effects that depend only on rate and force. `apply_recording` also
compensates effects of time, temperature and angular acceleration. An effect that depends on the attitude
stays in the data (`Calibration.left_in_data`), because for example the Earth rate is a correct measurement
of a gyroscope.

If `Calibration.takes_pieces` is true, a recording that is too long for memory can be corrected in pieces.
Give the start time of the whole recording as `start_s` for each piece. `imucal.io.read_pieces` and
`write_pieces` read and write CSV and Parquet files in pieces, and `imucal apply` uses these functions.
Effects of the angular acceleration need the whole recording, because a time derivative extends across the
ends of a piece.

## User-defined effects

A user-defined effect has a name, parameters, and a function that returns the field. The field is an array
of shape (N, 3, p) that contains the change of the true rate (rad/s) or force (m/s^2) in the body frame
per unit of each parameter. In this example the bias of a gyroscope depends on the supply voltage, which
was recorded in a column `supply_v`:

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
`time_s`, `temperature_degc` and `auxiliary`. The calibration file contains the values but not the function.
"""


def page() -> str:
    """The text of the page docs/effects.md."""
    lines = [HEAD, "## The catalogue", ""]
    lines.append("| effect | adds | parameters | typical size | depends on | observable in |")
    lines.append("|---|---|---|---|---|---|")
    lines += [_row(effect) for effect in catalogue()]
    lines += ["", "The inputs of effects other than rate and force are:", ""]
    needed = {need for effect in catalogue() for need in effect.needs}
    lines += [f"* {need.replace('_', ' ')}: {source}" for need, source in NEEDS.items() if need in needed]
    lines += ["", "## Aliases", "", "| effect | similar effect | distinguished by |", "|---|---|---|"]
    lines += [
        f"| `{effect.name}` | {_code(alias.name)} | {_cell(alias.told_apart_by)} |"
        for effect in catalogue()
        for alias in effect.aliases
    ]
    lines += [
        "",
        "## Noise and faults",
        "",
        "Noise and faults are named but cannot be compensated, because they do not follow from the motion or "
        "the temperature.",
        "",
    ]
    lines += ["| name | where | kind | parameters | typical size | appears as |", "|---|---|---|---|---|---|"]
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
        f"![Error over time; observable in: {effect.observable}](effects/{effect.name}.svg)\n"
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
    """Text of a table cell. Bars are escaped, because a bar would end the cell."""
    return text.replace("|", "\\|")


def size(parameter: EffectParameter | DisturbanceParameter) -> str:
    """The typical size of a parameter, as text with its unit."""
    unit = "" if parameter.unit == "1" else f" {parameter.unit}"
    return f"{parameter.typical:.3g}{unit}"
