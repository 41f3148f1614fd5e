"""Simulated runs of a unit on the stand, with the truth beside the recording."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from imucal.arrays import FloatArray
from imucal.calibration import Calibration, Triad
from imucal.document import read_json, write_json
from imucal.errors import FormatError, InputError
from imucal.recording import Recording

__all__ = ["Program", "Simulation", "Step", "Truth", "simulate"]

SCHEMA: Final = "imucal.program/1"
STANDARD_GRAVITY_MPS2: Final = 9.80665
PROGRAM_NAMES: Final = ("random", "grid")
UNIT_NAMES: Final = ("paper", "ideal")


@dataclass(frozen=True)
class Step:
    """Turn the three motors by `turn_deg` (outer motor first) in `move_s`, then hold still for `hold_s`."""

    turn_deg: tuple[float, float, float]
    move_s: float
    hold_s: float


@dataclass(frozen=True)
class Program:
    """What the stand's motors are told to do: a list of steps, from all motors at zero."""

    steps: tuple[Step, ...]

    @staticmethod
    def read(path: str | os.PathLike[str]) -> Program:
        """Read a program file (schema imucal.program/1); FormatError names the field that is wrong."""
        node = read_json(path)
        node.require_schema(SCHEMA)
        steps = []
        for item in node.get("steps").items():
            first, second, third = item.get("turn_deg").array(3).tolist()
            times = (item.get("move_s"), item.get("hold_s"))
            for time in times:
                if time.number() < 0:
                    raise FormatError(f"{time.file}: {time.path} is {time.value}, it must not be negative")
            steps.append(Step((first, second, third), times[0].number(), times[1].number()))
        if not steps:
            raise FormatError(f"{node.file}: $.steps is empty: a program needs at least one step")
        return Program(tuple(steps))

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the program file, whole or not at all."""
        write_json({"schema": SCHEMA, "steps": self.steps}, path)


@dataclass(frozen=True, eq=False)
class Truth:
    """What the simulated unit underwent, one row per sample, and the unit itself.

    calibration     the unit's own triads, without uncertainty
    specific_force  (N, 3) in the body frame, m/s^2
    angular_rate    (N, 3) in the body frame, rad/s
    rests           start and end of each rest, s
    """

    calibration: Calibration
    specific_force: FloatArray
    angular_rate: FloatArray
    rests: tuple[tuple[float, float], ...]

    def to_dict(self) -> dict[str, Any]:
        """The document of `imucal simulate --truth`: the unit's parameters and the rests."""
        unit = self.calibration.to_dict()
        fields = ("raw_units", "gravity_mps2", "accelerometer", "gyroscope", "parameters")
        return {
            "schema": "imucal.truth/1",
            **{name: unit[name] for name in fields},
            "rests": [{"start_s": start, "end_s": end} for start, end in self.rests],
        }


@dataclass(frozen=True, eq=False)
class Simulation:
    """A simulated run: what the unit recorded, and the truth."""

    recording: Recording
    truth: Truth


def simulate(
    program: Program | str | os.PathLike[str] = "random",
    *,
    unit: str = "paper",
    rate_hz: float = 200.0,
    gravity_mps2: float = STANDARD_GRAVITY_MPS2,
    seed: int,
) -> Simulation:
    """Run a program with a unit on an ideal stand; the same arguments give the same numbers.

    program  "random" (the paper's gyroscope program, its moves drawn from `seed`), "grid" (its accelerometer
             program), a Program, or the path of a program file
    unit     "paper" (its NXP sensors with datasheet white noise and counts, in SI units) or "ideal"
    seed     of the noise, and of the random program

    Raises InputError for arguments that cannot be used, FormatError for a bad program file.
    """
    from imucal import _core

    if unit not in UNIT_NAMES:
        raise InputError(f"the unit {unit!r} is not known: give one of {', '.join(UNIT_NAMES)}")
    if not 0 <= seed < 2**64:
        raise InputError(f"seed is {seed}: a whole number from 0 to 2^64 - 1 is needed")
    named = isinstance(program, str) and program in PROGRAM_NAMES
    if not named and not isinstance(program, Program):
        program = Program.read(program)
    steps: str | Sequence[tuple[tuple[float, ...], float, float]]
    if isinstance(program, Program):
        steps = [(tuple(map(math.radians, s.turn_deg)), s.move_s, s.hold_s) for s in program.steps]
    else:
        steps = str(program)
    run = _core.simulate(steps, unit=unit, rate_hz=rate_hz, gravity_mps2=gravity_mps2, seed=seed)
    recording = Recording(
        run["time_s"],
        run["specific_force"],
        run["angular_rate"],
        stand_rad=run["stand_rad"],
        name=f"simulated-{seed}",
    )
    truth = Truth(
        Calibration(
            Triad(run["accel_sensitivity"], run["accel_bias"]),
            Triad(run["gyro_sensitivity"], run["gyro_bias"]),
            gravity_mps2=gravity_mps2,
        ),
        run["true_specific_force"],
        run["true_angular_rate"],
        tuple((float(start), float(end)) for start, end in run["rests"]),
    )
    return Simulation(recording, truth)
