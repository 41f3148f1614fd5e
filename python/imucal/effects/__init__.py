"""Effects: systematic errors beyond sensitivity and bias, from the catalogue or defined by the user."""

from imucal.effects.definition import UserEffect
from imucal.effects.effect import Effect, EffectParameter, EffectValues
from imucal.effects.state import State
from imucal.effects.table import catalogue, find

__all__ = ["Effect", "EffectParameter", "EffectValues", "State", "UserEffect", "catalogue", "find"]
