"""Errors of a sensor beyond sensitivity and bias: the catalogue of effects, and user-defined effects."""

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
