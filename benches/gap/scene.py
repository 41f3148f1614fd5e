"""How a recording is made: motion, unit, stand, temperature, and the columns that are recorded.

The unit and the program are those of the paper: 46 rests in random poses, 320 s, at 100 Hz.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np

import imucal
from imucal.rig.unit import unit_of

RATE_HZ: Final = 100.0
# Kinds of data that are recorded by hand.
BY_HAND: Final = ("A", "AT")


def cycle(duration_s: float) -> imucal.Temperature:
    """Heated by 30 K and cooled again."""
    return imucal.Temperature.cycle(10.0, 40.0, duration_s)


CYCLE: Final = cycle(320.0)
WARM_UP: Final = imucal.Temperature.warm_up(25.0, 40.0, 100.0)
# Errors that a stand has and that its kinematics must find for themselves.
CROOKED: Final = imucal.Stand(
    mount_rotation_deg=(0.8, -1.1, 0.6),
    base_tilt_deg=(0.4, -0.3),
    non_orthogonality_deg=(0.3, -0.4),
    encoder_noise_deg=0.005,
)

# An addition to what one sensor truly sees: (sensor, function of the true state that gives (N, 3)).
Added = tuple[str, Callable[[imucal.State], np.ndarray]]


@dataclass(frozen=True)
class Scene:
    """Everything about a run but its seed; calibration and control are two runs of one scene.

    kind        "A", "A'" or "C", with "T" where the temperature is recorded; see `sizes.Size`
    effects     of the catalogue, noise and faults included
    added       what is on no list, as functions of the true state
    noise_like  additions that differ from run to run: function of (state, generator)
    """

    kind: str = "A'"
    effects: tuple[imucal.EffectValues, ...] = ()
    added: tuple[Added, ...] = ()
    noise_like: tuple[tuple[str, Callable[[imucal.State, np.random.Generator], np.ndarray]], ...] = ()
    unit: imucal.Unit | str = "paper"
    motion: imucal.Program | imucal.Tumble | None = None
    temperature: imucal.Temperature | None = None
    stand: imucal.Stand | None = None
    auxiliary: dict[str, Any] = field(default_factory=dict)
    filter_hz: float | None = None
    averaging: bool = False
    user_effects: tuple[imucal.UserEffect, ...] = ()
    gravity_mps2: float | None = None
    clock_rate_error: float = 0.0
    stamp_jitter_s: float = 0.0

    @property
    def has_temperature(self) -> bool:
        return self.kind.endswith("T")

    @property
    def has_encoders(self) -> bool:
        return self.kind.startswith("C")


def by_hand(seed: int) -> imucal.Tumble:
    """As many rests as the program has, as long, turned by hand between them."""
    return imucal.Tumble(seed, poses=46, hold_s=5.0, move_s=2.0)


def record(
    scene: Scene, seed: int, program: imucal.Program | None = None, name: str = "measured"
) -> imucal.Recording:
    """One run of the scene; only what the kind of data says is recorded."""
    recording = simulated(scene, seed, program).recording
    jitter = np.random.default_rng([seed, 2]).normal(scale=scene.stamp_jitter_s, size=len(recording.time_s))
    return imucal.Recording(
        # Stamps of a busy computer: late and early, never in another order.
        np.maximum.accumulate(recording.time_s + jitter) + 1e-7 * np.arange(len(jitter))
        if scene.stamp_jitter_s
        else recording.time_s,
        recording.specific_force,
        recording.angular_rate,
        temperature_degc=recording.temperature_degc if scene.has_temperature else None,
        stand_rad=recording.stand_rad if scene.has_encoders else None,
        auxiliary=recording.auxiliary,
        name=name,
    )


def simulated(scene: Scene, seed: int, program: imucal.Program | None = None) -> Any:
    """One run of the scene with its truth."""
    motion = (
        program
        or scene.motion
        or (by_hand(seed) if scene.kind in BY_HAND else imucal.Program.random(seed=seed))
    )
    if isinstance(motion, imucal.Tumble):
        motion = replace(motion, seed=seed)
    temperature = scene.temperature or (CYCLE if scene.has_temperature else None)
    stand = scene.stand or (CROOKED if scene.has_encoders else None)
    if not isinstance(motion, imucal.Program):
        stand = None
    own, values = _additions(scene, motion, stand, temperature, seed)
    return imucal.simulate(
        motion,
        seed=seed,
        unit=unit_of(scene.unit),
        effects=[*scene.effects, *values],
        user_effects=[*scene.user_effects, *own],
        auxiliary=scene.auxiliary,
        stand=stand,
        rate_hz=RATE_HZ,
        gravity_mps2=scene.gravity_mps2,
        clock_rate_error=scene.clock_rate_error,
        temperature=temperature,
        filter_hz=scene.filter_hz,
        averaging=scene.averaging,
    )


def _additions(
    scene: Scene, motion: Any, stand: Any, temperature: Any, seed: int
) -> tuple[list[imucal.UserEffect], list[imucal.EffectValues]]:
    """The additions of this run as effects of one's own: their fields are known at all its samples."""
    if not scene.added and not scene.noise_like:
        return [], []
    state = true_state(motion, stand, temperature, seed)
    random = np.random.default_rng([seed, 1])
    fields = [(sensor, make(state)) for sensor, make in scene.added]
    fields += [(sensor, make(state, random)) for sensor, make in scene.noise_like]
    own, values = [], []
    for number, (sensor, added) in enumerate(fields):
        one = (imucal.EffectParameter("size", "SI", 1.0),)
        # The array is bound now: a closure would see that of the last turn of the loop.
        of = lambda _, added=added: added[:, :, None]  # noqa: E731
        own.append(imucal.UserEffect(f"addition_{number}", sensor, one, of))
        values.append(imucal.EffectValues(f"addition_{number}", np.ones(1)))
    return own, values


def true_state(motion: Any, stand: Any, temperature: Any, seed: int) -> imucal.State:
    """The true state at each sample of a run, the motors' angles included."""
    run = imucal.simulate(
        motion, seed=seed, unit="ideal", stand=stand, temperature=temperature, rate_hz=RATE_HZ
    )
    truth, angles = run.truth, run.recording.stand_rad
    rates = None if angles is None else np.gradient(angles, run.recording.time_s, axis=0)
    return imucal.State(
        truth.angular_rate,
        truth.specific_force,
        truth.time_s - truth.time_s[0],
        truth.angular_acceleration,
        truth.temperature_degc,
        rotation_wxyz=truth.rotation_wxyz,
        stand_rad=angles,
        stand_rate_radps=rates,
    )
