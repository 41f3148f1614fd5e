"""Cases whose hidden effects are in the catalogue: one, several, confounded, aliases, left out, one's own."""

from collections.abc import Iterator
from itertools import combinations
from typing import Final

import numpy as np

import imucal
from gap.case import Answer, Case, generator
from gap.noise import paper, paper_unit
from gap.scene import WARM_UP, Scene
from gap.sizes import DEG, SIZES, G, drawn, typical

LEVELS: Final = {"1x": 1.0, "2x": 2.0, "5x": 5.0, "10x": 10.0}
EARTH_RATE_RADPS: Final = 7.292e-5
# Another effect can be exactly this one (D = -tau 1; a warm-up of long time constant; where |f| is all that
# is seen, f_x^2 on x is the products on x less a bias): then that name is right if this one is not there.
CONTAINED: Final = {
    "gyro_time_offset": "gyro_angular_acceleration",
    "gyro_bias_drift": "gyro_bias_warmup",
    "accel_bias_drift": "accel_bias_warmup",
    "accel_scale_quadratic": "accel_cross_axis_quadratic",
}
# What a temperature that only rises cannot tell from time.
CONFOUNDED: Final = (
    "gyro_bias_temperature",
    "gyro_bias_warmup",
    "gyro_bias_drift",
    "gyro_scale_temperature",
    "gyro_scale_drift",
    "accel_bias_temperature",
    "accel_bias_warmup",
    "accel_bias_drift",
)


def block_of(name: str) -> str:
    """The part of the model that an effect disturbs."""
    sensor = imucal.effects.find(name).sensor
    if sensor == "encoder":
        return "encoder"
    part = (
        "scale" if "scale" in name or "cross_axis" in name or name == "gyro_angular_acceleration" else "bias"
    )
    return f"{sensor} {part}"


def single(runs: int) -> Iterator[Case]:
    """Each effect at multiples of its detection limit, and at its usual size."""
    for name, size in SIZES.items():
        for level in (*LEVELS, "typical"):
            times = typical(name) / size.here if level == "typical" else LEVELS[level]
            for index in range(runs):
                scene = one(name, size.kind, times, size.here, generator("single", name, level, index))
                answer = Answer(scene.effects, block=block_of(name))
                yield Case("single", name, index, scene, answer, level=level)


def one(name: str, kind: str, times: float, limit: float, random: np.random.Generator) -> Scene:
    """A scene with one effect of so many times its limit.

    The rate of the Earth has one size: there the gyroscope is as much quieter.
    """
    if name != "earth_rate":
        return Scene(kind, (drawn(name, times * limit, random),))
    real = EARTH_RATE_RADPS / np.sqrt(3.0)
    density = paper_unit().gyroscope.noise_density * real / (times * limit)
    quiet = paper(gyroscope={"noise_density": density, "lsb": None, "bits": None})
    return Scene(kind, (drawn(name, real, random),), unit=quiet)


def other_data(runs: int) -> Iterator[Case]:
    """The same effect by hand and on a stand, with and without encoders and temperature."""
    for name, size in SIZES.items():
        for data, limit in size.limit.items():
            # What depends on the temperature needs it.
            for kind in (data + "T",) if size.kind.endswith("T") else (data, data + "T"):
                if kind == size.kind:
                    continue
                for index in range(runs):
                    scene = one(name, kind, 5.0, limit, generator("data", name, kind, index))
                    answer = Answer(scene.effects, block=block_of(name))
                    yield Case("data", name, index, scene, answer, level=f"5x in {kind}")


def several(pairs: int, triples: int) -> Iterator[Case]:
    """Two and three at once, each at five times its limit, of those that rests and moves show."""
    # The rate of the Earth cannot have five times its limit beside another effect at the paper's noise.
    seen = [name for name, size in SIZES.items() if size.kind == "A'" and name != "earth_rate"]
    for count, label, wanted in ((2, "pair", pairs), (3, "triple", triples)):
        random = generator(label)
        groups = list(combinations(seen, count))
        for index, pick in enumerate(random.permutation(len(groups))[:wanted]):
            effects = tuple(drawn(name, 5.0 * SIZES[name].here, random) for name in groups[pick])
            yield Case(label, label, index, Scene("A'", effects), Answer(effects), level="5x")


def confounded(runs: int) -> Iterator[Case]:
    """A unit that warms up: temperature and time rise together."""
    for name in CONFOUNDED:
        for index in range(runs):
            effect = drawn(name, 10.0 * SIZES[name].here, generator("confounded", name, index))
            scene = Scene("A'T", (effect,), temperature=WARM_UP)
            answer = Answer((effect,), ("named", "ambiguous"), block=block_of(name))
            yield Case("confounded", name, index, scene, answer, level="10x")


def aliases(runs: int) -> Iterator[Case]:
    """What this motion cannot tell from something else, or cannot show at all."""
    quiet = Answer(verdicts=("nothing_missing",))
    for index in range(runs):
        random = generator("alias", index)
        sign = random.choice([-1.0, 1.0])
        yield Case(
            "alias", "local gravity, accelerometer scale", index, Scene(gravity_mps2=G + sign * 0.03), quiet
        )
        yield Case("alias", "clock, gyroscope scale", index, Scene(clock_rate_error=sign * 1e-3), quiet)
        in_bias = np.tile(random.normal(size=(3, 1)) * 0.05 * DEG / G**2, 3).ravel()
        values = (imucal.EffectValues("gyro_g2_sensitivity", in_bias),)
        yield Case("alias", "isotropic g2-sensitivity, bias", index, Scene(effects=values), quiet)
        isotropic = imucal.EffectValues("gyro_g_sensitivity", sign * 3 * 7.3e-5 / G * np.eye(3).ravel())
        yield _alias("isotropic g-sensitivity, vertical Earth rate", index, "A", isotropic)
        quadratic = drawn("accel_scale_quadratic", 10.0 * SIZES["accel_scale_quadratic"].limit["A"], random)
        yield _alias("f_x^2 on x, products on x", index, "A", quadratic)
        product = drawn(
            "accel_cross_axis_quadratic", 10.0 * SIZES["accel_cross_axis_quadratic"].limit["A"], random
        )
        yield _alias("f_x f_y on x, f_x^2 on y", index, "A", product)


def _alias(label: str, index: int, kind: str, effect: imucal.EffectValues) -> Case:
    answer = Answer((effect,), ("ambiguous", "named"), block=block_of(effect.name))
    return Case("alias", label, index, Scene(kind, (effect,)), answer)


def left_out(runs: int) -> Iterator[Case]:
    """The effect is hidden, and the tool's catalogue does not have it."""
    names = [effect.name for effect in imucal.effects.catalogue()]
    for name, size in SIZES.items():
        rest = [other for other in names if other != name]
        for index in range(runs):
            scene = one(name, size.kind, 10.0, size.here, generator("left out", name, index))
            answer = Answer(verdicts=("unknown", "stochastic"), block=block_of(name))
            if name in CONTAINED:
                said = (*answer.verdicts, "named", "ambiguous")
                answer = Answer(verdicts=said, names=(CONTAINED[name],), block=block_of(name))
            yield Case("left out", name, index, scene, answer, {"candidates": rest}, level="10x")


def ones_own(runs: int) -> Iterator[Case]:
    """An effect that the user has defined, among all of the catalogue."""

    def field(state: imucal.State) -> np.ndarray:
        return (state.auxiliary["supply_v"] - 3.3)[:, None, None] * np.eye(3)

    per_volt = tuple(imucal.EffectParameter(axis, "rad/s/V", 1e-3) for axis in "xyz")
    supply = imucal.UserEffect("gyro_bias_supply", "gyroscope", per_volt, field)
    for index in range(runs):
        random = generator("own", index)
        phase, period_s = random.uniform(0.0, 2.0 * np.pi), random.uniform(60.0, 150.0)
        effect = imucal.EffectValues("gyro_bias_supply", random.normal(scale=5e-3, size=3))

        def voltage(time_s: np.ndarray, period_s: float = period_s, phase: float = phase) -> np.ndarray:
            return 3.3 + 0.2 * np.sin(2.0 * np.pi * time_s / period_s + phase)

        scene = Scene("A'", (effect,), auxiliary={"supply_v": voltage}, user_effects=(supply,))
        answer = Answer((effect,), block="gyroscope bias")
        yield Case("own", "gyro_bias_supply", index, scene, answer, {"user_effects": (supply,)})
