"""Calibrate MEMS accelerometers and gyroscopes with gravity as the only reference.

    rec = imucal.read("run.csv")
    result = imucal.calibrate(rec, control=imucal.read("control.csv"))
    result.calibration.save("unit-0042.json")
    rate, force = result.calibration.apply(rec.angular_rate, rec.specific_force)

SI units, rows are samples, a still sensor reads +g on the axis that points up, measured = T true + bias.
"""

from __future__ import annotations

from typing import Any

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


def __getattr__(name: str) -> Any:
    # Only what is used is loaded: `import imucal` needs numpy alone.
    if name == "__version__":
        from imucal._core import __version__

        return __version__
    raise AttributeError(f"module 'imucal' has no attribute {name!r}")
