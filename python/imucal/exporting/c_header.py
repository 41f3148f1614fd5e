"""The correction as a C header: `imucal_correct_f64` and `imucal_correct_f32`, including effects.

The prefix `imucal` can be replaced, so that one firmware can contain several units.

The effects are removed by the fixed-point iteration of imucal-core, `EffectSet::remove` (docs/model.md (16)):
true <- T^-1 (raw - bias) - effects(true), until an iteration changes the values only by rounding errors. The
double version returns the same numbers as `Calibration.apply`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Final

import imucal._core as _core
from imucal.calibration.calibration import Calibration
from imucal.effects.effect import EffectValues
from imucal.effects.formula_effect import FormulaEffect
from imucal.exporting.c_fields import FIELDS, WARM_UPS, Field, product_of
from imucal.exporting.c_file import PREFIX, assigned_sum, guarded, matrix_constant, require_prefix
from imucal.exporting.c_single_precision import (
    Split,
    comment,
    constants,
    corrected_row,
    split,
    sum_function,
    sum_of,
)
from imucal.exporting.c_temperature import memory_code, memory_type
from imucal.exporting.format import SI, Format, Written, block_comment, number
from imucal.exporting.formula_code import (
    argument_note,
    argument_of,
    auxiliary_of,
    c_field,
    calls_function,
    has_sign,
)
from imucal.exporting.model import FRAMES, inverse, linear, lost_effects, temperature_note

if TYPE_CHECKING:
    from imucal.noise_analysis.noise import NoiseResult

__all__ = ["C_HEADER"]

# Effect of a delay tau of the gyroscope: an error of -tau times the mean angular acceleration over the delay.
DELAY: Final = "gyro_time_offset"
# Function argument for each quantity that an effect may need, in the order of the arguments.
ARGUMENTS: Final = {
    "temperature": "{real} temperature_degc",
    "temperature_history": "const {memory} *temperature",
    "time": "{real} time_s",
    "angular_acceleration": "const {real} angular_acceleration_radps2[3]",
}
# Number of passes of the fixed-point iteration in single precision that use the strict limit of convergence.
# Effects of ordinary size, for which each pass multiplies the error by less than 0.1 (docs/model.md (16)),
# reach this limit in about seven passes.
STRICT_PASSES: Final = 16


def write(calibration: Calibration, noise: NoiseResult | None, prefix: str = PREFIX) -> Written:
    """Write the C header. User-defined effects are included if a formula, not a function, defines them."""
    formulas = [own for own in calibration.user_effects if isinstance(own, FormulaEffect)]
    known = {*FIELDS, *(own.name for own in formulas)}
    effects = [values for values in calibration.effects if values.name in known]
    needs = [need for need in ARGUMENTS if any(need in _needs(calibration, values) for values in effects)]
    columns = sorted({column for own in formulas for column in auxiliary_of(own)})
    arguments = [*(ARGUMENTS[need] for need in needs), *(f"{{real}} {argument_of(c)}" for c in columns)]
    has_si_units = calibration.accel_unit != "lsb" or (
        calibration.gyroscope is not None and calibration.gyro_unit != "lsb"
    )
    includes = ["#include <float.h>", "#include <math.h>", ""] if effects else []
    content = [
        *_macros(calibration, prefix),
        *includes,
        *(_sign_functions(prefix) if any(map(has_sign, formulas)) else []),
        *(
            [line for single in (False, True) for line in memory_code(effects, prefix, single=single)]
            if "temperature_history" in needs
            else []
        ),
        *_function(calibration, effects, arguments, prefix, single=False),
        "",
        *(sum_function(prefix) if has_si_units else []),
        *_function(calibration, effects, arguments, prefix, single=True),
    ]
    return Written(
        body="\n".join(guarded(content, prefix, "calibration")),
        lost=lost_effects(calibration, known),
        same_as=linear(calibration, effects),
        frame=FRAMES[calibration.frame],
        notes=_notes(calibration, effects, needs, formulas, columns),
    )


def _sign_functions(prefix: str) -> list[str]:
    return [
        f"static inline {real} {prefix}_sign_{suffix}({real} x) {{ return ({real})((x > 0) - (x < 0)); }}"
        for real, suffix in (("double", "f64"), ("float", "f32"))
    ] + [""]


def _macros(calibration: Calibration, prefix: str) -> list[str]:
    values = []
    if calibration.serial_number:
        values.append(f"SERIAL_NUMBER {_string(calibration.serial_number)}")
    for end, degc in zip(("MIN", "MAX"), calibration.temperature_range_degc or (), strict=False):
        # The constant has single precision, because the compiler option -Wdouble-promotion warns about a
        # comparison of a float temperature with a double constant.
        values.append(f"TEMPERATURE_{end}_DEGC ({number(degc, single=True)}f)")
    return [*(f"#define {prefix.upper()}_{value}" for value in values), *([""] if values else [])]


def _string(text: str) -> str:
    """A C string literal; characters with a special meaning in C are written in octal."""
    # Question marks are excluded from plain characters, because they can form trigraphs.
    plain = set(range(0x20, 0x7F)) - set(b'"\\?')
    written = "".join(chr(byte) if byte in plain else f"\\{byte:03o}" for byte in text.encode())
    return f'"{written}"'


def _needs(calibration: Calibration, values: EffectValues) -> Sequence[str]:
    return getattr(calibration.definition(values), "needs", ())


def _notes(
    calibration: Calibration,
    effects: Sequence[EffectValues],
    needs: Sequence[str],
    formulas: Sequence[FormulaEffect],
    columns: Sequence[str],
) -> tuple[str, ...]:
    state = "no state but the temperature memory" if "temperature_history" in needs else "no state"
    notes = [f"No allocation and {state}. The output arrays may be the input arrays."]
    if effects:
        notes.append(f"Effects compensated: {', '.join(values.name for values in effects)}")
        notes.append("Returns 0, or -1 with NaN results if the effects are too large to be removed.")
    else:
        notes.append("Returns 0.")
    if any(calls_function(own) for own in formulas):
        notes.append("Link libm.")
    else:
        needs_exp = "temperature_history" in needs or any(values.name in WARM_UPS for values in effects)
        notes.append("Link libm for exp." if needs_exp else "No function of libm is called.")
    explained = {
        "temperature": "temperature_degc is the sensor temperature; temperature effects are zero at "
        f"{_core.REFERENCE_TEMPERATURE_DEGC} degC.",
        "temperature_history": "temperature is the memory of the temperatures, updated with each "
        "reading of the thermometer.",
        "time": "time_s counts from the start of the recording that the calibration was made from.",
        "angular_acceleration": "angular_acceleration_radps2 is the derivative of the corrected rate.",
    }
    notes += [explained[need] for need in needs]
    if any(values.name == DELAY for values in effects):
        notes.append(
            f"For {DELAY}, it is more accurate to pass the mean of the derivatives of the measured and of "
            "the corrected rate."
        )
    notes += [f"{own.name} is the formula {own.text}" for own in formulas]
    notes += [argument_note(column) for column in columns]
    notes += temperature_note(calibration)
    if calibration.left_in_data:
        notes.append(
            "Not compensated, because these effects are not sensor errors: "
            f"{', '.join(calibration.left_in_data)}"
        )
    return tuple(notes)


def _function(
    calibration: Calibration,
    effects: Sequence[EffectValues],
    arguments: Sequence[str],
    prefix: str,
    *,
    single: bool,
) -> list[str]:
    real, name = ("float", f"{prefix}_correct_f32") if single else ("double", f"{prefix}_correct_f64")
    memory = memory_type(prefix, single=single)

    def literal(value: float) -> str:
        return number(value, single=single) + ("f" if single else "")

    def row(values: Sequence[float]) -> str:
        return f"{{{', '.join(map(literal, values))}}}"

    triads = [
        (*sensor, triad)
        for sensor, triad in (
            (("gyro", "w", "rate"), calibration.gyroscope),
            (("accel", "f", "force"), calibration.accelerometer),
        )
        if triad is not None
    ]
    lines = [
        f"static inline int {name}(",
        f"    {', '.join(f'const {real} raw_{output}[3]' for _, _, output, _ in triads)},",
        *(f"    {argument.format(real=real, memory=memory)}," for argument in arguments),
        f"    {', '.join(f'{real} {output}[3]' for _, _, output, _ in triads)})",
        "{",
    ]
    units = {"gyro": calibration.gyro_unit, "accel": calibration.accel_unit}
    splits = {sensor: split(triad, units[sensor]) for sensor, _, _, triad in triads} if single else {}
    lines += comment(list(splits.values())) if single else []
    for sensor, _, _, triad in triads:
        if single:
            lines += constants(sensor, splits[sensor], row)
        else:
            lines.append(f"    static const {real} {sensor}_bias[3] = {row(triad.bias.tolist())};")
            lines += matrix_constant(f"{real} {sensor}_inverse", inverse(triad).tolist(), row)
    kept = (
        "large_w[3], small_w[3], large_f[3], small_f[3], size_w = 0, size_f = 0"
        if single
        else "seen_w[3], seen_f[3]"
    )
    lines += [
        f"    {real} {', '.join(f'{local}[3]' for _, local, _, _ in triads)};",
        *([f"    {real} {kept};", "    int pass;"] if effects else []),
        "    int i;",
        "",
        "    for (i = 0; i < 3; ++i) {",
    ]
    for sensor, local, output, _ in triads:
        raw = f"raw_{output}"
        if single:
            lines += corrected_row(local, sensor, raw, splits[sensor], prefix, has_effects=bool(effects))
        else:
            lines += _row(local, sensor, raw)
    lines.append("    }")
    sign = f"{prefix}_sign_{'f32' if single else 'f64'}"
    fields = {
        **FIELDS,
        **{
            own.name: c_field(own, literal, sign, single=single)
            for own in calibration.user_effects
            if isinstance(own, FormulaEffect)
        },
    }
    on_force = [v.name for v in effects if calibration.definition(v).sensor == "accelerometer"]
    lines += _removal(effects, fields, on_force, real, literal, splits, prefix, single) if effects else []
    lines += [
        "    for (i = 0; i < 3; ++i) {",
        *(f"        {output}[i] = {local}[i];" for _, local, output, _ in triads),
        "    }",
        "    return 0;",
        "}",
    ]
    return lines


def _row(target: str, sensor: str, raw: str) -> list[str]:
    products = [f"{sensor}_inverse[i][{k}] * ({raw}[{k}] - {sensor}_bias[{k}])" for k in range(3)]
    return assigned_sum(f"        {target}[i] =", products)


def _removal(
    effects: Sequence[EffectValues],
    fields: Mapping[str, Field],
    on_force: Sequence[str],
    real: str,
    literal: Callable[[float], str],
    splits: Mapping[str, Split],
    prefix: str,
    single: bool,
) -> list[str]:
    """C code of the fixed-point iteration that compensates the effects.

    fields    for each effect, the error per unit of each parameter as C expressions
    on_force  names of the effects of the accelerometer
    splits    for each sensor, the constants of its single-precision correction; empty in double precision
    """
    epsilon, largest = ("FLT_EPSILON", "FLT_MAX") if single else ("DBL_EPSILON", "DBL_MAX")
    lines = [
        "    for (i = 0; i < 3; ++i) {",
        "        seen_w[i] = w[i];",
        "        seen_f[i] = f[i];",
        "    }",
    ]
    # In single precision the effects are subtracted from the small part of the correction (see `Split`),
    # before the larger parts are added.
    next_w, next_f = (
        sum_of(f"large_{v}[i]", sensor, f"small_{v}[i] - on_{v}[i]", splits[sensor], prefix)
        if single
        else f"seen_{v}[i] - on_{v}[i]"
        for v, sensor in (("w", "gyro"), ("f", "accel"))
    )
    tolerance, sizes = "16", "size_w = 0, size_f = 0, "
    if single:
        # The iteration ends if a pass changes the result by at most this multiple of the rounding error. If a
        # pass multiplies the error by q, q / (1 - q) times the last change remains: up to 3 units in the last
        # place for a multiple of 16 and q = 0.1. The rounding errors of large effects may exceed the strict
        # limit (a multiple of 1), so later passes use the wide limit (a multiple of 16).
        tolerance, sizes = f"(pass < {STRICT_PASSES} ? 1 : 16)", ""
        # The large part counts too, because its rounding error remains if the parts nearly cancel.
        lines = [
            "    for (i = 0; i < 3; ++i) {",
            *_largest("size", "large_"),
            *_largest("size", ""),
            "    }",
        ]
    lines += _constants_of_a_sample(effects, fields, real, literal, single)
    lines += [
        f"    for (pass = 0; pass < {_core.MAX_PASSES}; ++pass) {{",
        f"        {real} on_w[3] = {{0, 0, 0}}, on_f[3] = {{0, 0, 0}};",
        f"        {real} {sizes}added_w = 0, added_f = 0, limit_w, limit_f;",
        "        int settled = 1;",
    ]
    for values in effects:
        lines.append(f"        /* {values.name} */")
        target = "on_f" if values.name in on_force else "on_w"
        for axis, terms in _sums(values, fields[values.name], literal).items():
            lines += assigned_sum(f"        {target}[{axis}] +=", terms)
    lines += [
        "        for (i = 0; i < 3; ++i) {",
        *([] if single else _largest("size", "seen_", "    ")),
        *_largest("added", "on_", "    "),
        "        }",
        f"        limit_w = {tolerance} * {epsilon} * (size_w + added_w);",
        f"        limit_f = {tolerance} * {epsilon} * (size_f + added_f);",
        "        for (i = 0; i < 3; ++i) {",
        *(
            (f"            const float next_w = {next_w};", f"            const float next_f = {next_f};")
            if single
            else (f"            const double next_w = {next_w}, next_f = {next_f};",)
        ),
        f"            const {real} change_w = next_w - w[i], change_f = next_f - f[i];",
        "            /* Comparisons with NaN are false, so NaN never counts as settled. */",
        "            settled = settled && change_w <= limit_w && -change_w <= limit_w;",
        "            settled = settled && change_f <= limit_f && -change_f <= limit_f;",
        "            w[i] = next_w;",
        "            f[i] = next_f;",
        "        }",
        f"        if (settled && limit_w <= {largest} && limit_f <= {largest}) break;",
        "    }",
        f"    if (pass == {_core.MAX_PASSES}) {{",
        "        for (i = 0; i < 3; ++i) rate[i] = force[i] = NAN;",
        "        return -1;",
        "    }",
    ]
    return lines


def _largest(size: str, of: str, indent: str = "") -> list[str]:
    """C code that increases size_w and size_f to |of_w[i]| and |of_f[i]| if these values are larger."""
    return [
        line
        for v in "wf"
        for line in (
            f"{indent}        if ({of}{v}[i] > {size}_{v}) {size}_{v} = {of}{v}[i];",
            f"{indent}        if (-{of}{v}[i] > {size}_{v}) {size}_{v} = -{of}{v}[i];",
        )
    ]


def _constants_of_a_sample(
    effects: Sequence[EffectValues],
    fields: Mapping[str, Field],
    real: str,
    literal: Callable[[float], str],
    single: bool,
) -> list[str]:
    """C code of local variables for all quantities on which the effects depend, except rate and force."""
    used = " ".join(
        expression
        for values in effects
        for _, column in zip(values.values, fields[values.name], strict=False)
        for _, expression in column
    )
    lines = []
    has_temperature = any(values.name in FIELDS and "_temperature" in values.name for values in effects)
    if re.search(r"\bd\b", used):
        reference = literal(_core.REFERENCE_TEMPERATURE_DEGC)
        lines.append(f"    const {real} d = temperature_degc - {reference};")
    lines += [
        f"    const {real} {name} = temperature->{member};"
        for name, member in (
            ("rate_kps", "rate_kps"),
            ("direction", "direction"),
            ("gyro_lag", "gyro_lag_k"),
            ("accel_lag", "accel_lag_k"),
        )
        if re.search(rf"\b{name}\b", used)
    ]
    if re.search(r"\bt\b", used):
        lines.append(f"    const {real} t = time_s;")
    if re.search(r"\ba\b", used):
        lines.append(f"    const {real} *const a = angular_acceleration_radps2;")
    if has_temperature and not re.search(r"\bd\b", used):
        lines.append("    (void)temperature_degc;")
    exp = "expf" if single else "exp"
    for values in effects:
        if values.name in WARM_UPS and values.shape is not None:
            sensor = values.name.partition("_")[0]
            lines.append(f"    const {real} {sensor}_cold = {exp}(-time_s / {literal(values.shape)});")
    return lines


def _sums(values: EffectValues, field: Field, literal: Callable[[float], str]) -> dict[int, list[str]]:
    """The C terms that the effect adds to each axis, in the order of its parameters."""
    sums: dict[int, list[str]] = {}
    for value, column in zip(values.values.tolist(), field, strict=False):
        for axis, expression in column:
            sums.setdefault(axis, []).append(product_of(literal(value), expression))
    return sums


def named(prefix: str) -> Format:
    """The export format with another prefix of C names. Raises InputError for an invalid prefix."""
    require_prefix(prefix)
    return replace(
        C_HEADER,
        formula=C_HEADER.formula.replace(f"{PREFIX}_", f"{prefix}_"),
        write=partial(write, prefix=prefix),
    )


C_HEADER = Format(
    name="c-header",
    title="C header for firmware",
    suffix=".h",
    formula="true = T^-1 (raw - bias) - effects(true), by imucal_correct_f64 or imucal_correct_f32",
    source="imucal-core, EffectSet::remove; docs/model.md (16)",
    units=SI,
    includes="bias, scale and misalignment of both sensors, every effect of the catalogue, formulas",
    omits="user-defined effects written in Python, noise figures, standard deviations",
    layout=block_comment,
    write=write,
    takes_counts=True,
    needs_gyroscope=False,
    named=named,
)
