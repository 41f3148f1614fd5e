"""Draws a unit in a pose with Braille characters, as the box with axes that the printed pose cards show."""

from __future__ import annotations

from typing import Final

import numpy as np
from rich.text import Text

from imucal.arrays import FloatArray
from imucal.planning.card import ARROW, BOX, EYE, RIGHT, UP

__all__ = ["draw"]

# Colours of the axes x, y and z: red, green and blue, as in most programs that show axes.
COLOURS: Final = ("bright_red", "bright_green", "dodger_blue1")
# Bits of the eight dots of a Braille character, by column and row of the dot.
DOTS: Final = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))
BRAILLE: Final = 0x2800
# Half width of the drawn area. The unit of length is the longest half edge of the drawn box.
REACH: Final = 2.0
# A hidden axis is drawn with every third dot left blank.
HIDDEN_STEP: Final = 3


class _Canvas:
    """Dots of Braille characters, two by four in a cell of the terminal, with a colour for each cell."""

    def __init__(self, columns: int, lines: int) -> None:
        self.columns, self.lines = columns, lines
        self.bits = np.zeros((lines, columns), dtype=int)
        self.style = np.full((lines, columns), "", dtype=object)
        self.letters: dict[tuple[int, int], tuple[str, str]] = {}
        # The horizontal and the vertical scale are equal, in dots per unit of length. A dot is about as wide
        # as high, because a cell of two by four dots is twice as high as wide.
        self.scale = min(2 * columns, 4 * lines) / (2.0 * REACH)

    def place(self, point: FloatArray) -> tuple[float, float]:
        """Column and row, in dots, of a point in the world frame."""
        right, up = float(RIGHT @ point), float(UP @ point)
        return self.columns + self.scale * right, 2.0 * self.lines - self.scale * up

    def line(self, start: FloatArray, end: FloatArray, style: str, every: int = 1) -> None:
        """Draw a line between two points in the world frame. If `every` > 1, each `every`-th dot is blank."""
        (x1, y1), (x2, y2) = self.place(start), self.place(end)
        count = int(max(abs(x2 - x1), abs(y2 - y1))) + 1
        for i in range(count + 1):
            if every > 1 and i % every == 0:
                continue
            x, y = round(x1 + (x2 - x1) * i / count), round(y1 + (y2 - y1) * i / count)
            row, column = y // 4, x // 2
            if 0 <= row < self.lines and 0 <= column < self.columns:
                self.bits[row, column] |= DOTS[x % 2][y % 4]
                self.style[row, column] = style or self.style[row, column]

    def letter(self, point: FloatArray, letter: str, style: str) -> None:
        x, y = self.place(point)
        row = min(max(round(y) // 4, 0), self.lines - 1)
        column = min(max(round(x) // 2, 0), self.columns - 1)
        self.letters[row, column] = (letter, style)

    def text(self) -> Text:
        text = Text(no_wrap=True)
        for row in range(self.lines):
            for column in range(self.columns):
                if (row, column) in self.letters:
                    text.append(*self.letters[row, column])
                else:
                    bits = int(self.bits[row, column])
                    text.append(chr(BRAILLE + bits) if bits else " ", str(self.style[row, column]))
            text.append("\n" if row + 1 < self.lines else "")
        return text


def draw(attitude: FloatArray, columns: int, lines: int) -> Text:
    """Draw the unit as seen from the front right and above.

    attitude         rotation matrix, body to world, (3, 3)
    columns, lines   size of the drawing, in characters
    """
    canvas = _Canvas(max(columns, 4), max(lines, 2))
    for axis in range(3):
        for sign in (-1.0, 1.0):
            normal = sign * np.eye(3)[axis]
            if (attitude @ normal) @ EYE > 1e-9:
                first, second = np.eye(3)[(axis + 1) % 3] * BOX, np.eye(3)[(axis + 2) % 3] * BOX
                corners = [
                    normal * BOX + a * first + b * second for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))
                ]
                for start, end in zip(corners, corners[1:] + corners[:1], strict=True):
                    canvas.line(attitude @ start, attitude @ end, "")
    for axis in range(3):
        tip, foot = attitude[:, axis] * ARROW, attitude[:, axis] * BOX[axis]
        is_hidden = float(tip @ EYE) < -1e-6
        canvas.line(foot, tip, COLOURS[axis], HIDDEN_STEP if is_hidden else 1)
        canvas.letter(tip * 1.1, "xyz"[axis], f"bold {COLOURS[axis]}")
    return canvas.text()
