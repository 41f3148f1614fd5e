"""The calibration as a Rust module for imucal-core: `calibration::<f32>()` or `calibration::<f64>()`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import imucal._core as _core
from imucal.arrays import FloatArray
from imucal.calibration.calibration import Calibration
from imucal.effects.effect import EffectValues
from imucal.effects.formula_effect import FormulaEffect
from imucal.exporting.format import SI, Format, Written, line_comments, number
from imucal.exporting.formula_code import argument_of, auxiliary_of, rust_function
from imucal.exporting.model import FRAMES, linear, lost_effects, temperature_note

if TYPE_CHECKING:
    from imucal.noise_analysis.noise import NoiseResult

__all__ = ["RUST"]

# For each quantity that an effect may need, the field of imucal-core's `Surroundings`, which is an argument
# of `correct_at`.
SURROUNDINGS: Final = {
    "temperature": "temperature_difference_k (sensor temperature minus REFERENCE_TEMPERATURE_DEGC)",
    "temperature_history": "temperature_history (of a TemperatureMemory, updated with each temperature)",
    "time": "time_s (since the start of the recording that the calibration was made from)",
    "angular_acceleration": "angular_acceleration (derivative of the corrected rate, rad/s^2)",
}

FUNCTION = """
/// The calibration, for `correct` and `correct_at` of imucal-core.
///
/// # Errors
/// No error occurs with these numbers; the signatures of the constructors require a `Result`.
pub fn calibration<F: RealField + Copy>() -> Result<Calibration<F>, &'static str> {
    let real = convert::<f64, F>;
"""


def write(calibration: Calibration, noise: NoiseResult | None) -> Written:
    """Write the Rust module. User-defined effects are included if a formula, not a function, defines them."""
    own = {effect.name for effect in calibration.user_effects}
    effects = [values for values in calibration.effects if values.name not in own]
    formulas = [(own, values) for own, values in calibration.own_effects() if isinstance(own, FormulaEffect)]
    used = [*(["Effect", "EffectValues"] if effects else []), *(["State"] if formulas else [])]
    listed = f"effects::{{{', '.join(used)}}}, " if used else ""
    imports = f"use imucal_core::{{calibration::Calibration, {listed}sensor::Triad}};"
    lines = [imports, "use nalgebra::{Matrix3, RealField, Vector3, convert};", ""]
    for name, triad in zip(("ACCELEROMETER", "GYROSCOPE"), calibration.both(), strict=True):
        rows = ",\n    ".join(_row(row) for row in triad.sensitivity)
        lines += [
            "/// T in raw = T true + bias.",
            f"pub const {name}_SENSITIVITY: [[f64; 3]; 3] = [\n    {rows},\n];",
            "/// In raw units.",
            f"pub const {name}_BIAS: [f64; 3] = {_row(triad.bias)};",
        ]
    if calibration.temperature_effects:
        lines += [
            "/// Temperature at which the temperature effects are zero, degC.",
            "#[allow(dead_code)]",
            f"pub const REFERENCE_TEMPERATURE_DEGC: f64 = {number(_core.REFERENCE_TEMPERATURE_DEGC)};",
        ]
    for end, degc in zip(("MIN", "MAX"), calibration.temperature_range_degc or (), strict=False):
        side = "Lowest" if end == "MIN" else "Highest"
        lines += [
            f"/// {side} temperature of the recordings, degC.",
            "#[allow(dead_code)]",
            f"pub const TEMPERATURE_{end}_DEGC: f64 = {number(degc)};",
        ]
    lines.append(FUNCTION.rstrip("\n"))
    # The matrices are written as constant expressions, so that the code for the device contains no
    # conversion, no indexing and no panic.
    for name in ("ACCELEROMETER", "GYROSCOPE"):
        lines += [
            f"    let {name.lower()} = Triad::try_new(",
            "        Matrix3::new(",
            *(
                "            " + " ".join(f"real({name}_SENSITIVITY[{i}][{k}])," for k in range(3))
                for i in range(3)
            ),
            "        ),",
            "        Vector3::new(" + ", ".join(f"real({name}_BIAS[{i}])" for i in range(3)) + "),",
            "    )",
            '    .map_err(|_| "axes in one plane")?;',
        ]
    lines.append(
        f"    let {'mut ' if effects else ''}calibration = Calibration::new(accelerometer, gyroscope);"
    )
    for values in effects:
        name, constant = values.name, f"Effect::{values.name.upper()}"
        shape = "None" if values.shape is None else f"Some(real({number(values.shape)}))"
        lines += [
            f"    let numbers = [{', '.join(f'real({number(value)})' for value in values.values)}];",
            f'    let values = EffectValues::try_new({constant}, &numbers, {shape}).map_err(|_| "{name}")?;',
            '    calibration.effects.push(values).map_err(|_| "there are too many effects")?;',
        ]
    lines += ["    Ok(calibration)", "}"]
    lines += [*(rust_function(formulas) if formulas else []), ""]
    exported = [*effects, *(values for _, values in formulas)]
    return Written(
        body="\n".join(lines),
        lost=lost_effects(calibration, {values.name for values in exported}),
        same_as=linear(calibration, exported),
        frame=FRAMES[calibration.frame],
        notes=(
            f"Needs imucal-core and nalgebra. Effects: {', '.join(v.name for v in exported) or 'none'}",
            *_formulas_note(formulas),
            *_surroundings_note(calibration, effects),
            *temperature_note(calibration),
        ),
    )


def _formulas_note(formulas: Sequence[tuple[FormulaEffect, EffectValues]]) -> tuple[str, ...]:
    """A note on how formulas are compensated; empty without formulas."""
    if not formulas:
        return ()
    columns = sorted({column for effect, _ in formulas for column in auxiliary_of(effect)})
    arguments = "".join(f", {argument_of(column)}" for column in columns)
    call = f"calibration.correct_with(rate, force, &surroundings, |state| formulas(state{arguments}))"
    return (f"{', '.join(effect.name for effect, _ in formulas)}: only {call} compensates formulas",)


def _surroundings_note(calibration: Calibration, effects: Sequence[EffectValues]) -> tuple[str, ...]:
    """Notes on the quantities besides rate and force that the effects need; empty if none are needed."""
    needs = {
        values.name: [
            need for need in SURROUNDINGS if need in getattr(calibration.definition(values), "needs", ())
        ]
        for values in effects
    }
    left_in = [name for name, needed in needs.items() if needed]
    if not left_in:
        return ()
    fields = [text for need, text in SURROUNDINGS.items() if any(need in needed for needed in needs.values())]
    return (
        f"Use correct_at with these fields of Surroundings: {', '.join(fields)}",
        f"Without them, or with correct, these effects are not compensated: {', '.join(left_in)}",
    )


def _row(values: FloatArray) -> str:
    return f"[{', '.join(number(value) for value in values)}]"


RUST = Format(
    name="rust",
    title="Rust module for imucal-core",
    suffix=".rs",
    formula="true = T^-1 (raw - bias) - effects(true), by Calibration::correct, correct_at and correct_with",
    source="imucal-core",
    units=SI,
    includes="bias, scale and misalignment of both sensors, every effect of the catalogue, formulas",
    omits="user-defined effects written in Python, noise figures, standard deviations",
    layout=line_comments("//"),
    write=write,
    takes_counts=True,
)
