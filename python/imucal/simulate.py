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
from imucal.recording import STANDARD_GRAVITY_MPS2, Recording

__all__ = ["Program", "Simulation", "Step", "Truth", "simulate"]

SCHEMA: Final = "imucal.program/1"
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
    def random(
        *, seed: int, moves: int = 45, max_rate_dps: float = 120.0, move_s: float = 2.0, hold_s: float = 5.0
    ) -> Program:
        """The paper's gyroscope program: random turns of all motors, a hold before, between and after them.

        max_rate_dps  bound of each motor's mean rate over a turn, deg/s
        """
        from imucal import _core

        return _of_steps(_core.random_program(moves, math.radians(max_rate_dps), move_s, hold_s, seed))

    @staticmethod
    def grid(*, step_deg: float = 20.0, move_s: float = 1.0, hold_s: float = 5.0) -> Program:
        """The paper's accelerometer program: motor 3 through full turns, motor 2 through half a turn."""
        from imucal import _core

        return _of_steps(_core.grid_program(math.radians(step_deg), move_s, hold_s))

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


def _of_steps(steps: Sequence[tuple[Sequence[float], float, float]]) -> Program:
    """A program of the library's steps, angles in rad."""
    return Program(
        tuple(
            Step((math.degrees(first), math.degrees(second), math.degrees(third)), move_s, hold_s)
            for (first, second, third), move_s, hold_s in steps
        )
    )


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
    if program == "random":
        program = Program.random(seed=seed)
    elif program == "grid":
        program = Program.grid()
    elif not isinstance(program, Program):
        program = Program.read(program)
    steps = [(tuple(map(math.radians, step.turn_deg)), step.move_s, step.hold_s) for step in program.steps]
    run = _core.simulate(steps, unit, float(rate_hz), float(gravity_mps2), seed)
    recording = Recording(
        run.time_s,
        run.specific_force,
        run.angular_rate,
        stand_rad=run.stand_rad,
        name=f"simulated-{seed}",
    )
    truth = Truth(
        Calibration(
            Triad(run.accel_sensitivity, run.accel_bias),
            Triad(run.gyro_sensitivity, run.gyro_bias),
            gravity_mps2=gravity_mps2,
        ),
        run.true_specific_force,
        run.true_angular_rate,
        tuple((float(start), float(end)) for start, end in run.rests),
    )
    return Simulation(recording, truth)
