"""A card of poses to hold by hand: one self-contained HTML page for print or screen."""

from __future__ import annotations

import os
from collections.abc import Sequence
from html import escape
from typing import Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.document.atomic import write_text
from imucal.rig.motion import Program

__all__ = ["write_card"]

# Half edges of the drawn box along x, y and z, and length of the axis arrows, relative to the half edge along
# x.
BOX: Final = np.array([1.0, 0.7, 0.35])
ARROW: Final = 1.75
COLOURS: Final = ("#d55e00", "#008560", "#0072b2")
SIZE_PX: Final = 170
# Unit vectors of a view from the front right and above: the right and the up direction of the picture, and
# the direction to the eye.
RIGHT: Final = np.array([0.88, 0.48, 0.0])
UP: Final = np.array([-0.19, 0.35, 0.92])
EYE: Final = np.cross(RIGHT, UP)
STYLE: Final = """
body { font: 15px/1.4 system-ui, sans-serif; color: #1a1a1a; margin: 1.5em; max-width: 64em }
ol { display: flex; flex-wrap: wrap; gap: .6em; padding: 0; list-style: none }
li { border: 1px solid #dde1e6; border-radius: 6px; padding: .4em .6em; width: 176px; break-inside: avoid }
li b { font-size: 1.15em } svg { display: block }
"""


def write_card(program: Program, path: str | os.PathLike[str]) -> None:
    """Write the page: a picture of the unit in each pose of a program, and how long to hold it.

    Raises InputError if it cannot be written.
    """
    angles = np.deg2rad(np.cumsum([step.turn_deg for step in program.steps], axis=0))
    items = "\n".join(
        _item(number, _attitude(pose), step.hold_s)
        for number, (pose, step) in enumerate(zip(angles, program.steps, strict=True), start=1)
    )
    minutes = program.duration_s / 60.0
    move_s = max(step.move_s for step in program.steps)
    write_text(
        path,
        f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>Poses to hold</title>
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'">
<style>{STYLE}</style></head><body>
<h1>Poses to hold</h1>
<p>{len(program.steps)} poses, {minutes:.1f} min. The arrows are the axes of the sensor as in its datasheet.
The view is from the front, slightly from the right and from above. Start recording, hold each pose as still
as you can, and rotate to the next one in about {move_s:.0f} s. Deviations of a few degrees do no harm, but
rests that are too short do.</p>
<ol>
{items}
</ol></body></html>
""",
    )


def _attitude(angle_rad: FloatArray) -> FloatArray:
    """Rotation from body to world: motor 1 about x, motor 2 about y, motor 3 about z, outermost first."""
    (c1, c2, c3), (s1, s2, s3) = np.cos(angle_rad), np.sin(angle_rad)
    about_x = np.array([[1, 0, 0], [0, c1, -s1], [0, s1, c1]])
    about_y = np.array([[c2, 0, s2], [0, 1, 0], [-s2, 0, c2]])
    about_z = np.array([[c3, -s3, 0], [s3, c3, 0], [0, 0, 1]])
    attitude: FloatArray = about_x @ about_y @ about_z
    return attitude


def _item(number: int, attitude: FloatArray, hold_s: float) -> str:
    return (
        f"<li><b>{number}</b> hold {hold_s:.0f} s<br>{escape(_words(attitude))}"
        f'<svg viewBox="-2.1 -2.1 4.2 4.2" width="{SIZE_PX}" height="{SIZE_PX}" role="img" '
        f'aria-label="{escape(_words(attitude))}">{_picture(attitude)}</svg></li>'
    )


def _words(attitude: FloatArray) -> str:
    """The axes that point up or down, such as `z up` or `between x up and y down`."""
    up = attitude[2]
    names = [
        f"{'xyz'[axis]} {'up' if up[axis] > 0 else 'down'}"
        for axis in np.argsort(-np.abs(up))
        if abs(up[axis]) > 0.3
    ]
    return names[0] if len(names) == 1 else "between " + " and ".join(names)


def _picture(attitude: FloatArray) -> str:
    """SVG shapes of the visible faces and the axes, farthest first."""
    shapes: list[tuple[float, str]] = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            normal = sign * np.eye(3)[axis]
            if (attitude @ normal) @ EYE > 1e-9:
                first, second = np.eye(3)[(axis + 1) % 3] * BOX, np.eye(3)[(axis + 2) % 3] * BOX
                centre = normal * BOX
                corners = [centre + a * first + b * second for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
                points = " ".join(_point(attitude @ corner) for corner in corners)
                # Faces that point up are drawn brighter, as if the light came from above.
                grey = round(205 + 35 * float((attitude @ normal)[2]))
                look = f'fill="rgb({grey},{grey},{grey})" stroke="#555" stroke-width=".03"'
                shapes.append((0.0, f'<polygon points="{points}" {look}/>'))
    for axis in range(3):
        tip, foot = attitude[:, axis] * ARROW, attitude[:, axis] * BOX[axis]
        # An axis that points away from the viewer is drawn before the box, so that the box covers part of the
        # axis.
        shapes.append((float(np.sign(round(float(tip @ EYE), 6))) or 1.0, _arrow(foot, tip, axis)))
    return "".join(shape for _, shape in sorted(shapes, key=lambda item: item[0]))


def _arrow(foot: FloatArray, tip: FloatArray, axis: int) -> str:
    colour = COLOURS[axis]
    (x1, y1), (x2, y2) = _flat(foot), _flat(tip)
    label = _point(tip * 1.12)
    lx, ly = label.split(",")
    return (
        f'<line x1="{x1:.3f}" y1="{y1:.3f}" x2="{x2:.3f}" y2="{y2:.3f}" stroke="{colour}" '
        'stroke-width=".07"/>'
        f'<circle cx="{x2:.3f}" cy="{y2:.3f}" r=".07" fill="{colour}"/>'
        f'<text x="{lx}" y="{ly}" font-size=".36" text-anchor="middle" dominant-baseline="central" '
        f'fill="{colour}">{"xyz"[axis]}</text>'
    )


def _flat(point: Sequence[float] | FloatArray) -> tuple[float, float]:
    """Coordinates in the picture, with y downwards."""
    return float(np.dot(RIGHT, point)), -float(np.dot(UP, point))


def _point(point: FloatArray) -> str:
    x, y = _flat(point)
    return f"{x:.3f},{y:.3f}"
