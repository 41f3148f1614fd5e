from .definition import UserEffect as UserEffect
from .effect import Effect as Effect, EffectParameter as EffectParameter, EffectValues as EffectValues
from .state import State as State
from .table import catalogue as catalogue, find as find
