"""Faults of a simulated stand or unit, for tests of a production line, which must detect each fault.

slip         the unit slips on its mount by 1 to 3 deg about a random axis, once in each run, at a random
             time between 15 % and 85 % of its duration
loose-mount  the mount is loose: after every move the unit's attitude deviates from the commanded attitude
             by a new random rotation, 0.5 deg (1 sigma) about each motor's axis
clipping     the gyroscope saturates at 0.4 to 0.8 of the highest rate of the run
dead-axis    one of the six axes outputs only its bias, with or without noise
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Final

import numpy as np

from imucal.arrays import FloatArray
from imucal.errors import InputError
from imucal.recording.recording import Recording, samples_of_both
from imucal.rig.motion import Program, Step
from imucal.rig.stand import Stand, stand_from_name
from imucal.rig.unit import Unit, unit_of
from imucal.simulation.simulate import simulate

__all__ = ["FAULTS", "SimulatedUnit"]

FAULTS: Final = ("slip", "loose-mount", "clipping", "dead-axis")
# Range of the angle of a slip, deg, and range of its time as a share of the run's duration.
SLIP_DEG: Final = (1.0, 3.0)
SLIP_SHARE: Final = (0.15, 0.85)
# Standard deviation of the attitude error due to a loose mount, deg about the axis of each motor.
PLAY_DEG: Final = 0.5
# The measurement range of a clipping gyroscope is drawn between these shares of the highest rate of the run.
RANGE_SHARE: Final = (0.4, 0.8)


@dataclass(frozen=True)
class SimulatedUnit:
    """A unit on a simulated stand. All runs have the same unit, stand and unit faults.

    unit, stand  arguments of `imucal.simulate`; without a stand, the program's stand is used
    rate_hz      sampling rate, Hz
    fault        one of `FAULTS`, or None
    fault_seed   seed of the fault's size, axis and time
    """

    unit: Unit | str = "paper"
    stand: Stand | str | None = None
    rate_hz: float = 200.0
    fault: str | None = None
    fault_seed: int = 1

    def __post_init__(self) -> None:
        if self.fault is not None and self.fault not in FAULTS:
            raise InputError(f"there is no fault {self.fault!r}: give one of {', '.join(FAULTS)}")

    def run(self, program: Program, seed: int) -> Recording:
        """The recording of a program; `seed` is the seed of the noise."""
        random = np.random.default_rng([self.fault_seed, seed])
        # A dead axis and a reduced range are properties of the unit, so their seed does not depend on the
        # run.
        of_unit = np.random.default_rng(self.fault_seed)
        unit = unit_of(self.unit)
        stand = (program.stand or Stand()) if self.stand is None else stand_from_name(self.stand)
        motion = dataclasses.replace(program, stand=stand)
        if self.fault == "slip":
            motion = dataclasses.replace(motion, stand=_slipping(stand, program, random))
        if self.fault == "loose-mount":
            motion = _with_play(motion, random)
        if self.fault == "clipping":
            unit = self._clipped(unit, motion, seed, float(of_unit.uniform(*RANGE_SHARE)))
        recording = simulate(motion, seed=seed, unit=unit, rate_hz=self.rate_hz).recording
        if self.fault == "loose-mount":
            # The encoders measure the commanded motor angles, which do not include the attitude error due to
            # the loose mount.
            commanded = dataclasses.replace(program, stand=stand)
            encoders = simulate(commanded, seed=seed, unit=unit, rate_hz=self.rate_hz).recording.stand_rad
            recording = dataclasses.replace(recording, stand_rad=encoders)
        if self.fault == "dead-axis":
            recording = _with_dead_axis(recording, unit, of_unit)
        return recording

    def _clipped(self, unit: Unit, program: Program, seed: int, share: float) -> Unit:
        """The unit with a gyroscope range of `share` times the highest rate of the program."""
        whole = simulate(program, seed=seed, unit=unit, rate_hz=self.rate_hz).recording
        highest_radps = float(np.abs(samples_of_both(whole)[1]).max())
        return dataclasses.replace(unit, gyroscope=unit.gyroscope.with_range(share * highest_radps))


def _slipping(stand: Stand, program: Program, random: np.random.Generator) -> Stand:
    axis = random.normal(size=3)
    turn_deg = random.uniform(*SLIP_DEG) * axis / np.linalg.norm(axis)
    time_s = float(random.uniform(*SLIP_SHARE)) * program.duration_s
    x, y, z = turn_deg.tolist()
    return dataclasses.replace(stand, slip_deg=(x, y, z), slip_time_s=time_s)


def _with_play(program: Program, random: np.random.Generator) -> Program:
    """The actual motion of a unit whose mount is loose.

    After each move, the attitude deviates from the commanded attitude by a new random rotation.
    """
    steps, before = [], np.zeros(3)
    for step in program.steps:
        moves = any(step.turn_deg)
        after = random.normal(scale=PLAY_DEG, size=3) if moves else before
        x, y, z = (np.array(step.turn_deg) + after - before).tolist()
        steps.append(Step((x, y, z), step.move_s, step.hold_s))
        before = after
    return dataclasses.replace(program, steps=tuple(steps))


def _with_dead_axis(recording: Recording, unit: Unit, random: np.random.Generator) -> Recording:
    axis, stuck = int(random.integers(6)), bool(random.integers(2))
    columns = {name: getattr(recording, name).copy() for name in ("specific_force", "angular_rate")}
    name, sensor = ("specific_force", unit.accelerometer) if axis < 3 else ("angular_rate", unit.gyroscope)
    column: FloatArray = columns[name]
    noise = 0.0 if stuck else sensor.noise_density * recording.rate_hz**0.5
    bias = float(sensor.bias[axis % 3])
    column[:, axis % 3] = bias + random.normal(scale=noise, size=len(column)) if noise else bias
    return dataclasses.replace(recording, **columns)
