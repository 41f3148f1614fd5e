"""Calibrate MEMS accelerometers and gyroscopes with gravity as the only reference.

    rec = imucal.read("run.csv")
    result = imucal.calibrate(rec, control=imucal.read("control.csv"))
    result.calibration.save("unit-0042.json")
    rate, force = result.calibration.apply(rec.angular_rate, rec.specific_force)

SI units, rows are samples, a still sensor reads +g on the axis that points up, measured = T true + bias.
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from imucal.allan import allan_deviation
    from imucal.calibrate import calibrate
    from imucal.calibration import Calibration, Parameter, Provenance, Triad
    from imucal.calibration_result import CalibrationResult
    from imucal.diff import Change, Difference, diff
    from imucal.effects import Effect, EffectParameter, EffectValues, State, UserEffect
    from imucal.errors import FitError, FormatError, ImucalError, InputError, NotEnoughMotionError
    from imucal.evaluate import Evaluation, evaluate
    from imucal.export import Export, Residual, export
    from imucal.finding import Finding, Place
    from imucal.gap import Gap, find_gap
    from imucal.inspection import Inspection, inspect
    from imucal.io import read, write
    from imucal.judgement import Check, Judgement
    from imucal.limits import FigureLimit, Limits, ParameterLimit
    from imucal.motion import Program, Static, Step, Tumble
    from imucal.noise import AxisNoise, NoiseFigure, NoiseResult, noise
    from imucal.plan import Plan, PlannedParameter, plan
    from imucal.recording import Recording, Source
    from imucal.simulate import Simulation, repeat, simulate
    from imucal.stand import Stand
    from imucal.stand_limits import AxisLimits, StandLimits
    from imucal.temperature import Temperature
    from imucal.truth import Truth
    from imucal.unit import Sensor, Unit, unit_names

__all__ = [
    "AxisLimits",
    "AxisNoise",
    "Calibration",
    "CalibrationResult",
    "Change",
    "Check",
    "Difference",
    "Effect",
    "EffectParameter",
    "EffectValues",
    "Evaluation",
    "Export",
    "FigureLimit",
    "Finding",
    "FitError",
    "FormatError",
    "Gap",
    "ImucalError",
    "InputError",
    "Inspection",
    "Judgement",
    "Limits",
    "NoiseFigure",
    "NoiseResult",
    "NotEnoughMotionError",
    "Parameter",
    "ParameterLimit",
    "Place",
    "Plan",
    "PlannedParameter",
    "Program",
    "Provenance",
    "Recording",
    "Residual",
    "Sensor",
    "Simulation",
    "Source",
    "Stand",
    "StandLimits",
    "State",
    "Static",
    "Step",
    "Temperature",
    "Triad",
    "Truth",
    "Tumble",
    "Unit",
    "UserEffect",
    "__version__",
    "allan_deviation",
    "calibrate",
    "diff",
    "evaluate",
    "export",
    "find_gap",
    "inspect",
    "noise",
    "plan",
    "read",
    "repeat",
    "simulate",
    "unit_names",
    "write",
]

# Where each name lives: `import imucal` loads nothing, and who uses a name loads what that needs. A test
# keeps this table and the imports above, which type checkers read, the same.
_HOME = {
    "AxisLimits": "imucal.stand_limits",
    "AxisNoise": "imucal.noise",
    "Calibration": "imucal.calibration",
    "CalibrationResult": "imucal.calibration_result",
    "Change": "imucal.diff",
    "Check": "imucal.judgement",
    "Difference": "imucal.diff",
    "Effect": "imucal.effects",
    "EffectParameter": "imucal.effects",
    "EffectValues": "imucal.effects",
    "Evaluation": "imucal.evaluate",
    "Export": "imucal.export",
    "FigureLimit": "imucal.limits",
    "Finding": "imucal.finding",
    "FitError": "imucal.errors",
    "FormatError": "imucal.errors",
    "Gap": "imucal.gap",
    "ImucalError": "imucal.errors",
    "InputError": "imucal.errors",
    "Inspection": "imucal.inspection",
    "Judgement": "imucal.judgement",
    "Limits": "imucal.limits",
    "NoiseFigure": "imucal.noise",
    "NoiseResult": "imucal.noise",
    "NotEnoughMotionError": "imucal.errors",
    "Parameter": "imucal.calibration",
    "ParameterLimit": "imucal.limits",
    "Place": "imucal.finding",
    "Plan": "imucal.plan",
    "PlannedParameter": "imucal.plan",
    "Program": "imucal.motion",
    "Provenance": "imucal.calibration",
    "Recording": "imucal.recording",
    "Residual": "imucal.export",
    "Sensor": "imucal.unit",
    "Simulation": "imucal.simulate",
    "Source": "imucal.recording",
    "Stand": "imucal.stand",
    "StandLimits": "imucal.stand_limits",
    "State": "imucal.effects",
    "Static": "imucal.motion",
    "Step": "imucal.motion",
    "Temperature": "imucal.temperature",
    "Triad": "imucal.calibration",
    "Truth": "imucal.truth",
    "Tumble": "imucal.motion",
    "Unit": "imucal.unit",
    "UserEffect": "imucal.effects",
    "__version__": "imucal._core",
    "allan_deviation": "imucal.allan",
    "calibrate": "imucal.calibrate",
    "diff": "imucal.diff",
    "evaluate": "imucal.evaluate",
    "export": "imucal.export",
    "find_gap": "imucal.gap",
    "inspect": "imucal.inspection",
    "noise": "imucal.noise",
    "plan": "imucal.plan",
    "read": "imucal.io",
    "repeat": "imucal.simulate",
    "simulate": "imucal.simulate",
    "unit_names": "imucal.unit",
    "write": "imucal.io",
}


class _Package(ModuleType):
    """The package, in which `imucal.calibrate` is the function, whether or not its module has been loaded."""

    def __setattr__(self, name: str, value: Any) -> None:
        # The import system puts every module that it loads into its package, under the name of the function.
        if isinstance(value, ModuleType) and _HOME.get(name) == value.__name__:
            value = getattr(value, name)
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package


def __getattr__(name: str) -> Any:
    home = _HOME.get(name)
    if home is not None:
        value = getattr(importlib.import_module(home), name)
        globals()[name] = value
        return value
    if not name.startswith("__"):
        try:
            return importlib.import_module(f"imucal.{name}")
        except ModuleNotFoundError as error:
            if error.name != f"imucal.{name}":
                raise
    raise AttributeError(f"module 'imucal' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__
