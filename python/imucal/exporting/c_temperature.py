"""C code of the temperature memory, with the operations of `imucal_core::temperature_memory`.

The temperature memory is the state of the filters that compute lag, rate and direction of the temperature
(docs/model.md (43)). It is a struct in the generated C code. The firmware keeps one memory per unit, and
updates it with each reading of the thermometer.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import imucal._core as _core
from imucal.effects.effect import EffectValues
from imucal.exporting.c_fields import LAGS
from imucal.exporting.format import number

__all__ = ["memory_code", "memory_type"]

STRUCT: Final = """/* State of the temperature effects. Start with all zeros. */
typedef struct {{
    int started;
    {real} last_k, first_lag_k, second_lag_k, direction, rate_kps, gyro_lag_k, accel_lag_k;
}} {type};

/* Takes a finite reading of the thermometer. time_step_s is the time since the previous reading. */
static inline void {name}({type} *memory, {real} time_step_s, {real} temperature_degc)
{{
    const {real} now_k = temperature_degc - {reference};
    const {real} change_k = memory->started ? now_k - memory->last_k : 0;
    const {real} before_k = memory->first_lag_k, second_before_k = memory->second_lag_k;
    {real} step, settled, share, turned;

    memory->last_k = now_k;
    memory->started = 1;
{lags}    step = time_step_s / {smoothing};
    settled = -{expm1}(-step);
    share = step > 0 ? settled / step : 1;
    memory->first_lag_k = memory->first_lag_k - settled * memory->first_lag_k - change_k * share;
    if (step > 0) {{
        const {real} steady_k = -change_k / step;
        memory->second_lag_k = memory->second_lag_k - settled * memory->second_lag_k + steady_k * settled +
                               (before_k - steady_k) * step * (1 - settled);
    }}
    memory->rate_kps = -memory->second_lag_k / {smoothing};
    turned = memory->direction +
             (change_k + (memory->first_lag_k - before_k) -
              (memory->second_lag_k - second_before_k)) / {reversal};
    memory->direction = turned > 1 ? 1 : turned < -1 ? -1 : turned;
}}
"""
LAG: Final = """    step = time_step_s / {tau};
    settled = -{expm1}(-step);
    share = step > 0 ? settled / step : 1;
    memory->{sensor}_lag_k = memory->{sensor}_lag_k - settled * memory->{sensor}_lag_k - change_k * share;
"""


def memory_type(prefix: str, *, single: bool) -> str:
    """Name of the C type of the memory."""
    return f"{prefix}_temperature_{'f32' if single else 'f64'}"


def memory_code(effects: Sequence[EffectValues], prefix: str, *, single: bool) -> list[str]:
    """The type of the temperature memory and the function that updates the memory, as lines of C."""

    def literal(value: float) -> str:
        return number(value, single=single) + ("f" if single else "")

    taus = {values.name: values.shape for values in effects}
    expm1 = "expm1f" if single else "expm1"
    lags = "".join(
        LAG.format(tau=literal(tau), expm1=expm1, sensor=sensor)
        for sensor, name in LAGS.items()
        if (tau := taus.get(name)) is not None
    )
    kind = memory_type(prefix, single=single)
    code = STRUCT.format(
        real="float" if single else "double",
        type=kind,
        name=f"{kind}_update",
        reference=literal(_core.REFERENCE_TEMPERATURE_DEGC),
        lags=lags,
        smoothing=literal(_core.TEMPERATURE_SMOOTHING_S),
        reversal=literal(_core.TEMPERATURE_REVERSAL_K),
        expm1=expm1,
    )
    return [*code.splitlines(), ""]
