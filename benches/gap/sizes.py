"""How large an effect must be to be seen, and how large it usually is, in SI units.

The detection limit is the smallest root mean square per parameter that is seen with 90 % power (family-wise
alpha 0.01) in one run at the noise of the paper's unit and, with encoders, at their noise of 0.005 deg:
`limits` predicts it from differences of simulated runs, without the tool, and writes limits.json.
The temperature goes up and down within the run, as `scene.CYCLE` says.
"""

import json
from dataclasses import dataclass
from math import radians
from typing import Final

import numpy as np

import imucal
from gap.kinds import KINDS, LIMITS
from imucal.units import STANDARD_GRAVITY_MPS2

G: Final = STANDARD_GRAVITY_MPS2
DEG: Final = radians(1.0)


@dataclass(frozen=True)
class Size:
    """The data that show an effect, and its detection limit in each kind of data.

    kind   "A" rests and moves by hand, "A'" on a stand, so that the accelerometer counts within the moves
           too, "C" also encoders; with "T" the temperature is recorded and changes
    limit  by kind; not there where the data cannot show it
    """

    kind: str
    limit: dict[str, float]

    @property
    def here(self) -> float:
        """The limit in the data of its kind."""
        return self.limit[self.kind.removesuffix("T")]


def _sizes() -> dict[str, Size]:
    limits = json.loads(LIMITS.read_text(encoding="utf-8"))
    return {
        name: Size(kind, {data: found[name] for data, found in limits.items() if name in found})
        for name, kind in KINDS.items()
    }


SIZES: Final = _sizes()


def drawn(name: str, rms: float, random: np.random.Generator) -> imucal.EffectValues:
    """The effect in its plain form, in a random direction, with this root mean square per parameter.

    Parameters of different units keep their proportion to the typical sizes; a shape is within a factor of
    1.5 of the typical one.
    """
    effect = imucal.effects.find(name)
    typical = np.array([parameter.typical for parameter in effect.parameters[: effect.plain]])
    direction = random.normal(size=effect.plain)
    direction *= np.sqrt(effect.plain) / np.linalg.norm(direction)
    shape = None if effect.shape is None else effect.shape.typical * 1.5 ** random.uniform(-1.0, 1.0)
    return imucal.EffectValues(name, direction * typical / typical[0] * rms, shape)


def typical(name: str) -> float:
    """What ordinary sensors have."""
    return imucal.effects.find(name).parameters[0].typical
