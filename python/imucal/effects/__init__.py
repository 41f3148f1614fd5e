"""Errors of a sensor beyond sensitivity and bias: the catalogue of effects, and user-defined effects."""

from imucal.effects.definition import UserEffect
from imucal.effects.effect import Effect, EffectParameter, EffectValues
from imucal.effects.state import State
from imucal.effects.table import catalogue, find

__all__ = ["Effect", "EffectParameter", "EffectValues", "State", "UserEffect", "catalogue", "find"]
