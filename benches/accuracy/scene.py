"""How a run is made: motion, unit and rate; the seed draws moves and noise.

The paper run is its gyroscope program: 45 moves of 2 s, holds of 5 s, on a stand. The hand-held run is 40
poses of 4 s and moves of 2 s between them, in a cube of 30 cm, by a hand that trembles by 0.05 deg about each
axis all the time.
"""

from dataclasses import dataclass, replace

import numpy as np

import imucal
from accuracy.bound import Noise
from imucal import Tumble, Unit

DEGREE_PER_HOUR = np.radians(1.0) / 3600.0
TREMOR_DEG = 0.05
TRANSLATION_MM = 300.0
# Full scale over half the counts of the paper's sensors.
RANGES = {"accelerometer": 2 * 9.80665, "gyroscope": np.radians(512.0)}


@dataclass(frozen=True)
class Scene:
    """One condition.

    noise    factor on the noise densities of the datasheet
    flicker  bias instability of the gyroscope, deg/h
    bits     of both converters, or None for those of the unit
    """

    name: str
    held: bool = False
    rate_hz: float = 200.0
    noise: float = 1.0
    flicker: float = 0.0
    bits: int | None = None

    @property
    def is_main(self) -> bool:
        """Whether it is one of the two runs that are reported parameter by parameter."""
        return self in (PAPER, HELD)

    @property
    def has_bound(self) -> bool:
        """The bound is that of white noise."""
        return self.flicker == 0.0

    @property
    def unit(self) -> Unit:
        unit = Unit.named("paper")
        sensors = {}
        for name in ("accelerometer", "gyroscope"):
            sensor = getattr(unit, name)
            sensor = replace(sensor, noise_density=self.noise * sensor.noise_density)
            if self.bits is not None:
                sensor = replace(sensor, bits=self.bits).with_range(RANGES[name])
            sensors[name] = sensor
        flicker = self.flicker * DEGREE_PER_HOUR
        sensors["gyroscope"] = replace(sensors["gyroscope"], bias_instability=flicker)
        return replace(unit, **sensors)

    @property
    def sample_noise(self) -> Noise:
        return Noise.of(self.unit, self.rate_hz)

    def run(self, seed: int) -> imucal.Simulation:
        hand = Tumble(seed, tremor_deg=TREMOR_DEG, translation_mm=TRANSLATION_MM)
        motion = hand if self.held else "random"
        return imucal.simulate(motion, seed=seed, unit=self.unit, rate_hz=self.rate_hz)

    def true_parameters(self, run: imucal.Simulation) -> np.ndarray:
        """(21,). Of a bias that wanders, the mean over the record is the truth."""
        values = np.array([parameter.value for parameter in run.truth.calibration.parameters])
        if self.flicker:
            values[9:12] += self._wandering(run).mean(axis=0)
        return values

    def _wandering(self, run: imucal.Simulation) -> np.ndarray:
        """The flicker noise of a run: the same seed without white noise and counts draws the same."""
        setup = run.truth.setup
        gyroscope = replace(setup.unit.gyroscope, noise_density=0.0, lsb=None, bits=None)
        alone = imucal.simulate(
            setup.motion,
            seed=setup.seed,
            unit=replace(setup.unit, gyroscope=gyroscope),
            rate_hz=setup.rate_hz,
        )
        exact = run.truth.angular_rate @ gyroscope.sensitivity.T + gyroscope.bias
        return alone.recording.angular_rate - exact


PAPER = Scene("paper")
HELD = Scene("hand-held", held=True)
CONDITIONS = (
    Scene("noise x 0.3", noise=0.3),
    Scene("noise x 3", noise=3.0),
    Scene("100 Hz", rate_hz=100.0),
    Scene("1 kHz", rate_hz=1000.0),
    Scene("flicker 3 deg/h", flicker=3.0),
    Scene("flicker 10 deg/h", flicker=10.0),
    Scene("12 bit", bits=12),
)
