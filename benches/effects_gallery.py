"""A picture of each effect of the catalogue: `make docs-figures`, to docs/effects/NAME.svg.

The picture shows the error of corrected samples if the effect is not compensated: its field along a motion,
times random parameters with the typical sizes as standard deviations. Below it is the quantity that the field
depends on: the magnitude of the rate, or the temperature.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import imucal
import imucal._core as _core

FOLDER = Path(__file__).resolve().parent.parent / "docs" / "effects"
SEED = 1
SENSOR_SEED = 14
RATE_HZ = 100.0
# Moves of the short run, for effects of the motion, and of the long run, for effects of time and temperature.
MOVES = {"short": 6, "long": 45}
HOLD_S = {"short": 1.5, "long": 5.0}
LATITUDE_DEG = 45.0
WARMING_UP = "warmup:20:45:100"
# Heating and cooling, for effects of the temperature history.
CYCLE = "cycle:20:45:300"
MOST_POINTS = 400

WIDTH, HEIGHT, LEFT, RIGHT = 640, 300, 70, 12
EFFECT = (14, 190)
MOTION = (215, 262)
UNITS = {
    "gyroscope": ("deg/s", np.degrees(1.0), "xyz"),
    "accelerometer": ("mm/s²", 1e3, "xyz"),
    "encoder": ("deg", np.degrees(1.0), ("motor 1", "motor 2", "motor 3")),
}
# Colours of Okabe and Ito, which colour-blind readers can distinguish.
STYLE = """<style>
polyline { fill: none; stroke-width: 1.6 } .below { stroke: #888 }
.back { fill: #fff } .text { fill: #444 } .grid { stroke: #ddd }
.line-0 { stroke: #0072b2 } .line-1 { stroke: #d55e00 } .line-2 { stroke: #009e73 }
@media (prefers-color-scheme: dark) {
  .back { fill: #1f2229 } .text { fill: #c8c8c8 } .grid { stroke: #3a3d45 }
  .line-0 { stroke: #56b4e9 } .line-1 { stroke: #e69f00 } .line-2 { stroke: #20c997 }
}
</style>"""
LINES = ("line-0", "line-1", "line-2")


@dataclass(frozen=True)
class Scene:
    """A motion with its true state."""

    state: imucal.State
    below: np.ndarray
    below_unit: str

    @staticmethod
    def of(length: str, temperature: str = WARMING_UP) -> Scene:
        program = imucal.Program.random(seed=SEED, moves=MOVES[length], hold_s=HOLD_S[length])
        run = imucal.simulate(program, unit="ideal", rate_hz=RATE_HZ, temperature=temperature, seed=SEED)
        truth = run.truth
        angles = run.recording.stand_rad
        speeds = np.gradient(angles, 1 / RATE_HZ, axis=0)
        state = imucal.State(
            truth.angular_rate,
            truth.specific_force,
            truth.time_s,
            angular_acceleration=truth.angular_acceleration,
            temperature_degc=truth.temperature_degc,
            rotation_wxyz=truth.rotation_wxyz,
            stand_rad=angles,
            stand_rate_radps=speeds,
            stand_direction=last_direction(speeds),
        )
        rate_dps = np.degrees(np.linalg.norm(truth.angular_rate, axis=1))
        return Scene(state, rate_dps, "rate, deg/s")

    def warming(self) -> Scene:
        """The motion with temperature as the quantity below the effect."""
        return Scene(self.state, self.state.temperature_degc, "degC")


def last_direction(speeds: np.ndarray) -> np.ndarray:
    """Sign of the last motion of each motor, 0 before the first."""
    moving = np.sign(speeds) * (np.abs(speeds) > 1e-6)
    rows = np.arange(len(speeds))[:, None]
    last = np.maximum.accumulate(np.where(moving != 0, rows, 0), axis=0)
    return np.take_along_axis(moving, last, axis=0)


def error(effect: imucal.Effect, state: imucal.State) -> np.ndarray:
    """The error caused by the plain form of an effect, (N, 3), in the unit of its picture."""
    shape = None if effect.shape is None else effect.shape.typical
    field = _core.effect_field(effect.name, shape, state)
    return field[:, :, : effect.plain] @ values(effect) * UNITS[effect.sensor][1]


def values(effect: imucal.Effect) -> np.ndarray:
    """Random parameters with the typical sizes as standard deviations; a single parameter has its typical
    size.
    """
    if effect.name == "earth_rate":
        return _core.earth_rate_radps(LATITUDE_DEG)
    typical = np.array([parameter.typical for parameter in effect.parameters[: effect.plain]])
    if len(typical) == 1:
        return typical
    return typical * np.random.default_rng(SENSOR_SEED).normal(size=len(typical))


def ticks(low: float, high: float) -> list[float]:
    """Three to six round numbers within a range, for an axis."""
    step = 10.0 ** np.floor(np.log10((high - low) / 2))
    while (high - low) / step > 5:
        step *= 2 if (high - low) / step <= 10 else 5
    return [step * k for k in range(int(np.ceil(low / step)), int(np.floor(high / step)) + 1)]


def panel(
    time_s: np.ndarray, lines: np.ndarray, span: tuple[int, int], unit: str, classes: Sequence[str]
) -> list[str]:
    """The grid and the lines of values (N, k) in a panel between two heights."""
    top, bottom = span
    low, high = float(min(lines.min(), 0.0)), float(max(lines.max(), 0.0))
    room = 0.04 * (high - low)
    low, high = low - room, high + room

    def y(value: float) -> str:
        return f"{bottom - (value - low) / (high - low) * (bottom - top):.1f}"

    def x(seconds: float) -> str:
        return f"{LEFT + seconds / time_s[-1] * (WIDTH - LEFT - RIGHT):.1f}"

    parts = []
    for tick in ticks(low, high) if bottom - top > 60 else [0.0, max(ticks(low, high))]:
        parts.append(f'<line class="grid" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y(tick)}" y2="{y(tick)}"/>')
        parts.append(
            f'<text class="text" x="{LEFT - 6}" y="{y(tick)}" dy="4" text-anchor="end">{tick:.4g}</text>'
        )
    middle = (top + bottom) / 2
    parts.append(
        f'<text class="text" transform="translate(14 {middle}) rotate(-90)" '
        f'text-anchor="middle">{unit}</text>'
    )
    kept = np.unique(np.linspace(0, len(time_s) - 1, MOST_POINTS).astype(int))
    for values, name in zip(lines.T, classes, strict=True):
        points = " ".join(f"{x(time_s[i])},{y(values[i])}" for i in kept)
        parts.append(f'<polyline class="{name}" points="{points}"/>')
    return parts


def picture(effect: imucal.Effect, scene: Scene) -> str:
    """The picture of an effect, as SVG."""
    unit, _, names = UNITS[effect.sensor]
    time_s = scene.state.time_s
    parts = panel(time_s, error(effect, scene.state), EFFECT, unit, LINES)
    parts += panel(time_s, scene.below[:, None], MOTION, scene.below_unit, ["below"])
    for seconds in ticks(0, time_s[-1]):
        at = LEFT + seconds / time_s[-1] * (WIDTH - LEFT - RIGHT)
        parts.append(f'<text class="text" x="{at:.1f}" y="280" text-anchor="middle">{seconds:.0f} s</text>')
    for k, (name, line) in enumerate(zip(names, LINES, strict=True)):
        at = LEFT + 90 * k
        parts.append(f'<line x1="{at}" x2="{at + 16}" y1="293" y2="293" class="{line}" stroke-width="3"/>')
        parts.append(f'<text class="text" x="{at + 21}" y="297">{name}</text>')
    box = f'<rect class="back" width="{WIDTH}" height="{HEIGHT}"/>'
    size = f'viewBox="0 0 {WIDTH} {HEIGHT}" font-family="sans-serif" font-size="12"'
    return "\n".join([f'<svg xmlns="http://www.w3.org/2000/svg" {size}>', STYLE, box, *parts, "</svg>", ""])


def pictures() -> dict[str, str]:
    """SVG pictures of all effects of the catalogue, by name."""
    scenes = {length: Scene.of(length) for length in MOVES}
    scenes["cycle"] = Scene.of("long", CYCLE)
    drawn = {}
    for effect in imucal.effects.catalogue():
        slow = {"time", "temperature"} & set(effect.needs)
        cycle = "temperature_history" in effect.needs
        scene = scenes["cycle" if cycle else "long" if slow else "short"]
        drawn[effect.name] = picture(effect, scene.warming() if "temperature" in effect.needs else scene)
    return drawn


def main() -> None:
    parser = argparse.ArgumentParser(description="Draw one picture of each effect.")
    parser.add_argument("--folder", type=Path, default=FOLDER)
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    drawn = pictures()
    for name, svg in drawn.items():
        (folder / f"{name}.svg").write_text(svg, encoding="utf-8")
    print(f"{len(drawn)} pictures in {folder}")


if __name__ == "__main__":
    main()
