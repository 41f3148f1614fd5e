"""Simulated runs of a unit, with their ground truth.

    run = imucal.simulate("random", unit="bmi088", effects={"gyro_g_sensitivity": 1e-4}, seed=7)
    run.recording, run.truth

Motion, unit, effects and faults form a `Setup`, which is part of the truth. `repeat` simulates the setup of a
truth file again.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

import imucal._core as _core
from imucal.arrays import FloatArray, as_rows
from imucal.document.agreement import Origin, require_agreement
from imucal.document.json_document import read_json
from imucal.document.plain import plain
from imucal.effects.definition import UserEffect, by_name
from imucal.effects.disturbance import disturbances
from imucal.effects.effect import EffectValues
from imucal.effects.formula import is_formula
from imucal.effects.formula_effect import FormulaEffect
from imucal.effects.state import State
from imucal.effects.values import EffectInput, give_effects
from imucal.errors import FormatError, InputError
from imucal.recording.recording import Recording
from imucal.rig.motion import Motion, Program, motion_of
from imucal.rig.stand import Stand, stand_from_name
from imucal.rig.temperature import REFERENCE_DEGC, Temperature, temperature_of
from imucal.rig.unit import Sensor, Unit, unit_of
from imucal.simulation.setup import Setup, setup_from, with_disturbances
from imucal.simulation.truth import Truth, truth_of
from imucal.units import STANDARD_GRAVITY_MPS2

__all__ = ["Auxiliary", "Simulation", "repeat", "simulate"]

Auxiliary: TypeAlias = Mapping[str, ArrayLike | Callable[[FloatArray], ArrayLike]]


@dataclass(frozen=True, eq=False)
class Simulation:
    """A simulated run: the recording of the unit, and the truth."""

    recording: Recording
    truth: Truth


def simulate(
    program: Motion | str | os.PathLike[str] = "random",
    *,
    seed: int,
    unit: Unit | str | os.PathLike[str] = "paper",
    effects: Mapping[str, EffectInput] | Iterable[EffectValues] = (),
    user_effects: Sequence[UserEffect] = (),
    auxiliary: Auxiliary | None = None,
    stand: Stand | str | os.PathLike[str] | None = None,
    rate_hz: float = 200.0,
    gravity_mps2: float | None = None,
    latitude_deg: float | None = None,
    height_m: float | None = None,
    temperature: Temperature | float | str | os.PathLike[str] | None = None,
    clock_rate_error: float = 0.0,
    filter_hz: float | str | None = None,
    averaging: bool = False,
) -> Simulation:
    """Simulate a motion of a unit; the same arguments give the same bytes.

    program       "random" (gyroscope program of the paper cited in docs/model.md, with moves drawn from
                  `seed`), "grid" (accelerometer program of this paper), "tumble" (by hand), "static", a
                  Program, Tumble or Static, or the path of a program file
    seed          seed of the noise, of the random program, and of the tumble
    unit          a name of `unit_names()`, "random:NAME:SEED", a Unit, or the path of a unit file
    effects       name -> values (see `imucal.effects.values`): effects of the catalogue, noise, faults,
                  formulas, and user-defined effects; they replace effects of the unit with the same name
    user_effects  definitions of the user-defined effects in `effects`
    auxiliary     name -> (N,) values at the samples, or a function of the sample times in s; these columns
                  are recorded, and user-defined effects can depend on them
    stand         errors of the stand: a Stand, "cheap" or "cheap:SEED", or the path of a stand file; None
                  uses the stand of the program
    gravity_mps2  local gravity, m/s^2; None: normal gravity at `latitude_deg` and `height_m`, or standard
                  gravity
    latitude_deg  adds the effect earth_rate, the Earth's rate at this latitude; None: no Earth's rate
    temperature   a Temperature, degC, the path of a CSV file with time_s and temp_degc, or a text:
                  "warmup:20:35:300" (from 20 to 35 degC with a time constant of 300 s) or "cycle:10:50:1200"
                  (from 10 to 50 degC and back in 1200 s); the temperature is recorded if it is given or an
                  effect depends on it
    clock_rate_error  relative error of the unit's clock, positive if fast
    filter_hz     bandwidth of the low-pass filter before sampling, or "datasheet" (the bandwidth in the
                  datasheet of the unit); None: the filter of the unit, if it has one
    averaging     whether samples are means over the sampling interval

    Raises InputError for invalid arguments, FormatError for an invalid file.
    """
    effects, formulas = _without_formulas(effects, auxiliary or {})
    user_effects = (*user_effects, *formulas)
    given = give_effects(effects, user_effects)
    unit = _filtered(unit_of(unit), filter_hz, averaging)
    motion = _on_stand(motion_of(program, seed), stand)
    gravity_mps2, earth_rate = _place(gravity_mps2, latitude_deg, height_m, given)
    noise_and_faults = {row.name for row in disturbances()}
    own = by_name(user_effects)
    setup = Setup(
        motion=motion,
        seed=seed,
        unit=unit,
        effects=(
            *(e for e in given if e.name not in noise_and_faults and e.name not in own),
            *earth_rate,
        ),
        user_effects=tuple((own[e.name], e) for e in given if e.name in own),
        rate_hz=rate_hz,
        gravity_mps2=gravity_mps2,
        temperature=temperature_of(REFERENCE_DEGC if temperature is None else temperature),
        clock_rate_error=clock_rate_error,
    )
    setup = with_disturbances(setup, (e for e in given if e.name in noise_and_faults))
    return run(setup, auxiliary, keep_temperature=temperature is not None)


def repeat(
    truth: str | os.PathLike[str],
    *,
    user_effects: Sequence[UserEffect] = (),
    auxiliary: Auxiliary | None = None,
) -> Simulation:
    """Repeat the run of a truth file: the same version of imucal writes the same bytes.

    user_effects, auxiliary  the arguments of the original run, because a truth file does not contain Python
                             functions and auxiliary columns

    Raises InputError if the definition of an effect is missing, FormatError for an invalid file.
    """
    node = read_json(truth)
    node.require_schema("imucal.truth/1")
    keep_temperature = node.get("has_temperature").flag()
    setup = setup_from(node.get("setup"), user_effects)
    try:
        repeated = run(setup, auxiliary, keep_temperature=keep_temperature)
    except InputError as error:
        # The error is attributed to the file only if no columns or effects were passed as arguments, because
        # otherwise the arguments may have caused the error.
        if auxiliary or user_effects:
            raise
        raise FormatError(f"{node.file}: $.setup: {error}") from None
    # A user may edit the setup in the file. The other fields of the file must then agree with the edited
    # setup.
    written = plain(repeated.truth.to_dict())
    require_agreement(
        node,
        {**written, "setup": node.get("setup").value},
        origin=lambda _: Origin("$.setup", absolute=1e-9),
        optional=(),
        way_out="correct one of them, or simulate again",
    )
    return repeated


def _without_formulas(
    effects: Mapping[str, EffectInput] | Iterable[EffectValues], auxiliary: Auxiliary
) -> tuple[Mapping[str, EffectInput] | Iterable[EffectValues], tuple[FormulaEffect, ...]]:
    """`effects` with each formula replaced by the name of its effect, and the definitions of the formulas."""
    if not isinstance(effects, Mapping):
        return effects, ()
    formulas = {
        text: FormulaEffect.of(text, columns=auxiliary.keys()) for text in effects if is_formula(text)
    }
    named = {formulas[name].name if name in formulas else name: given for name, given in effects.items()}
    return named, tuple(formulas.values())


def run(setup: Setup, auxiliary: Auxiliary | None = None, *, keep_temperature: bool = False) -> Simulation:
    """Simulate the run that a setup describes; `auxiliary` as in `simulate`."""
    samples: dict[str, FloatArray] = {}
    sampled_s = np.zeros(0)
    added: dict[str, FloatArray | None] = {}
    if setup.user_effects or auxiliary:
        # A first run without noise gives the true state, on which user-defined effects depend.
        truth = _core.simulate(setup.noise_free().for_core())
        sampled_s = truth.time_s
        samples = {name: _column(name, given, sampled_s) for name, given in (auxiliary or {}).items()}
        added = _added(setup, truth, samples)
    core = _core.simulate(setup.for_core(**added))
    recording = Recording(
        core.time_s,
        core.specific_force,
        core.angular_rate,
        temperature_degc=core.temperature_degc if keep_temperature or setup.needs_temperature else None,
        stand_rad=core.stand_rad,
        # The noise-free run lacks no sample, so its times include all times of this recording. The
        # interpolation therefore only selects the values at the samples that are not missing.
        auxiliary={name: np.interp(core.time_s, sampled_s, given) for name, given in samples.items()},
        name=f"simulated-{setup.seed}",
    )
    return Simulation(recording, truth_of(setup, core, recording))


def _added(setup: Setup, truth: Any, auxiliary: Mapping[str, FloatArray]) -> dict[str, FloatArray | None]:
    """The contributions of user-defined effects to the true force and rate of every sample."""
    state = State(
        truth.true_angular_rate,
        truth.true_specific_force,
        truth.time_s,
        truth.true_angular_acceleration,
        truth.temperature_degc,
        auxiliary,
        truth.rotation_wxyz,
        truth.stand_rad,
    )
    names = {"accelerometer": "added_force", "gyroscope": "added_rate"}
    added: dict[str, FloatArray | None] = {}
    for effect, values in setup.user_effects:
        name, field = names[effect.sensor], effect.at(state, values)
        before = added.get(name)
        added[name] = field if before is None else before + field
    return added


def _column(
    name: str, given: ArrayLike | Callable[[FloatArray], ArrayLike], time_s: FloatArray
) -> FloatArray:
    """An auxiliary column, with values also for the samples that will be missing in the recording."""
    values = given(time_s) if callable(given) else given
    return as_rows(values, f"auxiliary[{name!r}]", None, len(time_s))


def _filtered(unit: Unit, filter_hz: float | str | None, averaging: bool) -> Unit:
    """The unit with a low pass, or averaging over the sampling interval, before sampling."""
    if filter_hz is None and not averaging:
        return unit
    if isinstance(filter_hz, str) and filter_hz != "datasheet":
        try:
            filter_hz = float(filter_hz)
        except ValueError:
            raise InputError(f"filter_hz is {filter_hz!r}: give a bandwidth in Hz, or datasheet") from None
    sensors: dict[str, Any] = {}
    for name in ("accelerometer", "gyroscope"):
        sensor: Sensor = getattr(unit, name)
        if filter_hz == "datasheet" and sensor.bandwidth_hz is None:
            raise InputError(f"the datasheet of the {name} of {unit.name} gives no bandwidth: give it in Hz")
        changed: dict[str, Any] = {"averaging": averaging or sensor.averaging}
        if filter_hz is not None:
            changed["filter_hz"] = sensor.bandwidth_hz if filter_hz == "datasheet" else filter_hz
        sensors[name] = dataclasses.replace(sensor, **changed)
    return dataclasses.replace(unit, **sensors)


def _on_stand(motion: Motion, stand: Stand | str | os.PathLike[str] | None) -> Motion:
    """The motion on the given stand; the unchanged motion if no stand is given."""
    if stand is None:
        return motion
    if not isinstance(motion, Program):
        raise InputError(
            "a stand needs a program: give the motion random, grid or a program file, or no stand"
        )
    return dataclasses.replace(motion, stand=stand_from_name(stand))


def _place(
    gravity_mps2: float | None,
    latitude_deg: float | None,
    height_m: float | None,
    given: tuple[EffectValues, ...],
) -> tuple[float, tuple[EffectValues, ...]]:
    """Local gravity and the effect of the Earth's rate at a place."""
    if latitude_deg is None:
        if height_m is not None:
            raise InputError(
                "height_m without latitude_deg does not determine gravity: give the latitude, too"
            )
        return STANDARD_GRAVITY_MPS2 if gravity_mps2 is None else gravity_mps2, ()
    if not -90.0 <= latitude_deg <= 90.0:
        raise InputError(f"latitude_deg is {latitude_deg}: from -90 (south) to 90 (north) is needed")
    if gravity_mps2 is None:
        gravity_mps2 = float(_core.gravity_mps2(latitude_deg, height_m or 0.0))
    if any(effect.name == "earth_rate" for effect in given):
        return gravity_mps2, ()
    return gravity_mps2, (EffectValues("earth_rate", _core.earth_rate_radps(latitude_deg)),)
