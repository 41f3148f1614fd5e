"""What a real sensor does beyond sensitivity and bias: the catalogue, and effects of one's own."""

from imucal.effects.effect import (
    Effect,
    EffectParameter,
    EffectValues,
    State,
    UserEffect,
    catalogue,
    find,
)

__all__ = ["Effect", "EffectParameter", "EffectValues", "State", "UserEffect", "catalogue", "find"]
