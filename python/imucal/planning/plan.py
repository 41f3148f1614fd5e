"""Predicted accuracy of a motion, and optimal programs.

    planned = imucal.plan("optimal", targets={"accel_sensitivity": "50 ppm", "gyro_bias": 5e-5})
    planned.program.write("program.json"); print(planned.summary())

Standard deviations are predicted for a fit of all parameters together, from the sensor model and the white
noise of the unit. Detection limits of effects are those that `imucal gap` reports for a simulated run.
"""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

import imucal._core as _core
from imucal.calibration.calibration import Calibration
from imucal.calibration.triad import Triad
from imucal.document.whole import check_count, check_seed
from imucal.effects.table import catalogue, find
from imucal.errors import ImucalError, InputError
from imucal.estimation.holds import Hold, HoldTuple, holds_of, profile_of
from imucal.estimation.options import Options
from imucal.planning.groups import PlannedParameter, Size, worst_of
from imucal.planning.result import ROUNDING, ComparedProgram, NotObservable, Plan, is_within
from imucal.planning.targets import sigma_of, targets_of
from imucal.recording.recording import Recording
from imucal.rig.motion import Motion, Program, Tumble, motion_of
from imucal.rig.stand import Stand
from imucal.rig.stand_limits import StandLimits, stand_limits_of
from imucal.rig.unit import Unit, unit_of
from imucal.simulation.simulate import simulate
from imucal.units import STANDARD_GRAVITY_MPS2

__all__ = ["plan"]

DEFAULT_MINUTES: Final = 3.0
PROPOSALS: Final = 12000
# Number of changes of the program that a short trial search tries. This search finds the parameters that the
# motions of the stand can determine.
FEW_PROPOSALS: Final = 300
# Standard deviation of the hand tremor about each axis, deg, in the simulated run from which detection limits
# are computed.
TREMOR_DEG: Final = 0.05
# Largest number of rounds of the program `faces`, which rolls a box over its faces. This number of rounds
# takes about twenty minutes.
MOST_ROUNDS: Final = 20


def plan(
    kind: Motion | str | os.PathLike[str] = "optimal",
    *,
    unit: Unit | str | os.PathLike[str] = "paper",
    stand: StandLimits | str | os.PathLike[str] = "paper",
    targets: Mapping[str, float | str] | None = None,
    minutes: float | None = None,
    effects: Sequence[str] = (),
    model: str = "full",
    hold: Hold = (),
    seed: int = 1,
    proposals: int = PROPOSALS,
    detection_limits: bool = True,
    rate_hz: float = 200.0,
    gravity_mps2: float = STANDARD_GRAVITY_MPS2,
    options: Mapping[str, float | int] | None = None,
) -> Plan:
    """Predict the accuracy of a motion, or find an optimal program.

    kind       "optimal"; "random", "grid", "faces" (a box rolled over its faces) or "tumble"; a Program,
               Tumble or Static; or a program file
    unit       the unit with its noise: a name of `unit_names()`, a Unit, or the path of a unit file
    stand      limits of the stand: "paper" (three motors, 120 deg/s), "two-axis", "one-axis", "hand" (poses
               to hold, without a stand), a StandLimits, or the path of a limits file
    targets    largest permitted standard deviation of the parameters in a group, in SI units or as text with
               a unit ("50 ppm"), for the optimal program. Groups are accel_bias, accel_sensitivity,
               gyro_bias, gyro_sensitivity and the names in `effects`. The search finds the shortest program;
               for "faces", the smallest number of rounds. Without targets, the optimal program is the
               D-optimal program of duration `minutes`, which maximises the determinant of the information
               matrix of all parameters
    minutes    maximum duration of the optimal program; default: the maximum in the stand limits, or 3
    effects    names of further effects that the program must determine
    model, hold  parameters that have a prior, as in `calibrate`. The default standard deviation of a prior is
               the spread of the parameter over units, which `unit` states
    seed       seed of the search and of the random program
    proposals  number of changes of the program that the search tries
    detection_limits  if False, detection limits and `not_observable`, which take most of the time, are
                      omitted
    rate_hz    sampling rate of the unit
    options    options of the named motions: `moves`, `max_rate_dps`, `move_s`, `hold_s`, `step_deg`,
               `rounds`, `poses`, ...

    Raises InputError for invalid arguments, FormatError for an invalid file, NotEnoughMotionError if the
    stand cannot run any program in this time.
    """
    check_seed(seed)
    check_count(proposals, "proposals")
    unit = dataclasses.replace(unit_of(unit), effects=())
    limits = stand_limits_of(stand)
    minutes = minutes if minutes is not None else limits.minutes
    if minutes is not None and not 0 < minutes < math.inf:
        raise InputError(f"minutes is {minutes}: a positive number is needed")
    for name in effects:
        find(name)
    if not 0 < rate_hz < math.inf:
        raise InputError(f"rate_hz is {rate_hz}: a positive number is needed")
    for name, sensor in (("accelerometer", unit.accelerometer), ("gyroscope", unit.gyroscope)):
        if not sensor.noise_density > 0 and sensor.lsb is None:
            raise InputError(
                f"the {name} of {unit.name or 'the unit'} has no noise, so every predicted standard "
                "deviation would be zero: give a unit with the noise of its datasheet"
            )
    held = Held(model, holds_of(hold), profile_of(unit))
    planner = _Planner(unit, limits, tuple(effects), held, seed, proposals, rate_hz, gravity_mps2)
    targets_si = targets_of(targets or {}, effects)
    if kind != "optimal":
        if targets_si and kind != "faces":
            raise InputError(
                "targets need the program optimal or faces: plan one of these programs, or leave the "
                "targets out"
            )
        motion, reached = motion_of(kind, seed, dict(options or {})), True
        if targets_si:
            motion, reached = planner.rounds_of_faces(targets_si, dict(options or {}))
        name = kind if isinstance(kind, str) and kind in ("random", "grid", "faces", "tumble") else "program"
        planned = planner.predicted(name, motion, targets_si, detection_limits)
        return _within(planned, minutes, reached=reached)
    if options:
        raise InputError(f"{next(iter(options))} is no option of the optimal program: leave it out")
    motion, reached = planner.optimal(targets_si, minutes)
    planned = planner.predicted("optimal", motion, targets_si, detection_limits)
    return _within(planned, minutes, reached=reached)


def _within(planned: Plan, minutes: float | None, *, reached: bool) -> Plan:
    """The plan with its allowed duration. `reached` is whether the plan meets the targets."""
    planned = dataclasses.replace(planned, allowed_minutes=minutes)
    return dataclasses.replace(planned, reached=reached and is_within(planned))


@dataclass(frozen=True)
class Held:
    """The options that define the priors of parameters, in fields as the compiled library expects them."""

    model: str
    hold: tuple[HoldTuple, ...]
    profile: tuple[tuple[str, list[float]], ...]


@dataclass(frozen=True)
class CoreSensors:
    """The unit and the options of a plan, in fields with the names that the compiled library expects."""

    unit: Unit
    rate_hz: float
    gravity_mps2: float
    effects: tuple[str, ...]
    run_s: float
    model: str
    hold: tuple[HoldTuple, ...]
    profile: tuple[tuple[str, list[float]], ...]


@dataclass(frozen=True)
class _Planner:
    """Plans for one unit on one stand."""

    unit: Unit
    limits: StandLimits
    effects: tuple[str, ...]
    held: Held
    seed: int
    proposals: int
    rate_hz: float
    gravity_mps2: float

    def optimal(self, targets: Mapping[str, float], minutes: float | None) -> tuple[Program, bool]:
        """Search the optimal program. Also returns whether the program reaches the targets."""
        minutes_allowed = DEFAULT_MINUTES if minutes is None else minutes
        if not targets:
            return self._search(minutes_allowed, None, self.proposals)
        sigma = sigma_of(targets, self._parameters(minutes_allowed))
        if self.limits.axis_count < 3 or any(axis and axis.in_si()[2] for axis in self.limits.axes):
            # If no program of this stand determines a parameter, the target of this parameter is removed.
            trial, _ = self._search(minutes_allowed, None, FEW_PROPOSALS)
            determined = self._prospect(self._run(trial)).predicted_sigma
            base = [math.inf if std is None else s for s, std in zip(sigma, determined, strict=False)]
            sigma = [*base, *sigma[len(base) :]]
            if not any(map(math.isfinite, sigma)):
                raise InputError(
                    "this stand determines no parameter that has a target: use a stand with more axes"
                )
        return self._search(minutes_allowed, sigma, self.proposals)

    def rounds_of_faces(
        self, targets: Mapping[str, float], options: dict[str, float | int]
    ) -> tuple[Motion, bool]:
        """The motion `faces` with the fewest rounds that reach the targets, and whether they are reached."""
        if "rounds" in options:
            raise InputError(
                "the number of rounds is computed from the targets: leave out rounds or the targets"
            )
        for rounds in range(1, MOST_ROUNDS + 1):
            motion = motion_of("faces", self.seed, {**options, "rounds": rounds})
            minutes = motion.duration_s / 60.0
            sigma, _ = self._sigma([motion], minutes)
            wished = sigma_of(targets, self._parameters(minutes))
            if all(std <= wish * ROUNDING for std, wish in zip(sigma, wished, strict=True)):
                return motion, True
        return motion, False

    def predicted(self, kind: str, motion: Motion, targets: Mapping[str, float], thorough: bool) -> Plan:
        """The plan for this motion: predicted accuracy and, if `thorough`, detection limits of effects."""
        minutes = motion.duration_s / 60.0
        sigma, rests = self._sigma([motion], minutes)
        run = self._run(motion)
        prospect = self._prospect(run)
        known, undetermined = [std is not None for std in prospect.predicted_sigma], prospect.missing
        notes = self._notes()
        visible: dict[str, Size] = {}
        blind: tuple[NotObservable, ...] = ()
        if thorough:
            if undetermined is None:
                visible, blind, note = self._visible(run)
                notes += note
            else:
                notes.append(
                    "no detection limits, because they need a calibration, and the program does not "
                    "determine one"
                )
        parameters = tuple(
            PlannedParameter(name, std if k >= 21 or known[k] else None, unit)
            for k, ((name, unit), std) in enumerate(zip(self._parameters(minutes), sigma, strict=True))
        )
        return Plan(
            kind=kind,
            motion=motion,
            minutes=minutes,
            moves=_moves(motion),
            rests=rests,
            parameters=parameters,
            worst=worst_of(parameters, self.effects),
            targets=targets,
            reached=True,
            allowed_minutes=None,
            detection_limits=visible,
            not_observable=blind,
            undetermined=undetermined,
            through_moves=tuple(prospect.through_moves),
            comparison=self._papers(),
            notes=tuple(notes),
            unit=self.unit.name,
            seed=self.seed,
        )

    def _search(self, minutes: float, sigma: Sequence[float] | None, proposals: int) -> tuple[Program, bool]:
        steps, reached = _core.optimal_program(
            self._sensors(minutes), self.limits.in_si(), 60.0 * minutes, sigma, self.seed, proposals
        )
        return Program.of_steps(steps), reached

    def _sensors(self, minutes: float) -> CoreSensors:
        held = self.held
        return CoreSensors(
            unit=self.unit,
            rate_hz=self.rate_hz,
            gravity_mps2=self.gravity_mps2,
            effects=self.effects,
            run_s=60.0 * minutes,
            model=held.model,
            hold=held.hold,
            profile=held.profile,
        )

    def _sigma(self, motions: Sequence[Motion], minutes: float) -> tuple[list[float], int]:
        trembles = any(isinstance(motion, Tumble) and motion.tremor_deg > 0 for motion in motions)
        limits, in_hand = self.limits, self.limits.in_hand
        sigma, rests = _core.predict_sigma(
            self._sensors(minutes),
            [motion.in_si() for motion in motions],
            min(1.0, limits.min_rest_s),
            limits.settle_s,
            in_hand or trembles,
        )
        return sigma, rests

    def _parameters(self, minutes: float) -> list[tuple[str, str]]:
        """Name and unit of each parameter."""
        perfect = Triad(np.eye(3), np.zeros(3))
        base = [(parameter.name, parameter.unit) for parameter in Calibration(perfect, perfect).parameters]
        return [*base, *_core.plan_effect_parameters(self._sensors(minutes))]

    def _run(self, motion: Motion) -> Recording:
        """Simulate a recording of the motion."""
        if self.limits.in_hand and isinstance(motion, Program):
            motion = Program(motion.steps, Stand(tremor_deg=TREMOR_DEG, tremor_seed=self.seed))
        run = simulate(
            motion, seed=self.seed, unit=self.unit, rate_hz=self.rate_hz, gravity_mps2=self.gravity_mps2
        ).recording
        return dataclasses.replace(run, stand_rad=None) if self.limits.in_hand else run

    def _options(self) -> Options:
        held = self.held
        return Options(
            gravity_mps2=self.gravity_mps2,
            min_rest_s=min(1.0, self.limits.min_rest_s),
            model=held.model,
            hold=held.hold,
            profile=held.profile,
        )

    def _prospect(self, run: Recording) -> _core.Prospect:
        """Predict which parameters a calibration from the recording `run` determines, and how accurately."""
        return _core.prospect([run], self._options())

    def _visible(self, run: Recording) -> tuple[dict[str, Size], tuple[NotObservable, ...], list[str]]:
        """Detection limits, effects that are not observable, and notes if there are no detection limits."""
        candidates = [(effect.name, effect.plain) for effect in catalogue()]
        try:
            visible, blind = _core.smallest_visible([run], self._options(), candidates)
        except ImucalError as error:
            return {}, (), [f"no detection limits: {error}"]
        limits = {name: Size(size, unit) for name, size, unit in visible}
        return limits, tuple(NotObservable(name, needs) for name, needs in blind), []

    def _papers(self) -> tuple[ComparedProgram, ...]:
        """Predict this unit's accuracy with the programs and stand of the paper cited in docs/model.md."""
        own = dataclasses.replace(self, limits=stand_limits_of("paper"), effects=())
        grid, random = Program.grid(), Program.random(seed=self.seed)
        rows = []
        for name, motions in (("grid", [grid]), ("random", [random]), ("grid and random", [grid, random])):
            minutes = sum(motion.duration_s for motion in motions) / 60.0
            sigma, _ = own._sigma(motions, minutes)
            # The grid program rotates about one axis at a time, so it does not determine the off-diagonal
            # entries of the gyroscope's sensitivity.
            parameters = [
                PlannedParameter(parameter, std if std < OPEN else None, unit)
                for (parameter, unit), std in zip(own._parameters(minutes), sigma, strict=True)
            ]
            rows.append(ComparedProgram(name, minutes, worst_of(parameters, ())))
        return tuple(rows)

    def _notes(self) -> list[str]:
        sensors = (("accelerometer", self.unit.accelerometer), ("gyroscope", self.unit.gyroscope))
        return [
            f"the bias of the {name} varies (bias instability): these standard deviations include only white "
            "noise"
            for name, sensor in sensors
            if sensor.bias_instability > 0 or np.any(sensor.random_walk > 0)
        ]


# A parameter counts as determined if its predicted standard deviation, in SI units, is below this threshold.
# For a sensitivity that is not observable, the prediction equals the standard deviation of its prior, 0.1.
# The threshold is a fifth of this value.
OPEN: Final = 0.02


def _moves(motion: Motion) -> int:
    if isinstance(motion, Program):
        return sum(any(step.turn_deg) for step in motion.steps)
    return motion.poses - 1 if isinstance(motion, Tumble) else 0
