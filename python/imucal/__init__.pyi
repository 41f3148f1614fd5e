"""The public names of imucal, each with its module. `__init__.py` loads a name when it is first used."""

from . import effects as effects, io as io, plot as plot, report as report, stand as stand
from ._core import __version__ as __version__
from .calibration.calibration import Calibration as Calibration
from .calibration.composition import compose as compose
from .calibration.difference import Change as Change, Difference as Difference, diff as diff
from .calibration.provenance import Imported as Imported, Provenance as Provenance
from .calibration.triad import Parameter as Parameter, Triad as Triad
from .document.source import Source as Source
from .effects.definition import UserEffect as UserEffect
from .effects.effect import Effect as Effect, EffectParameter as EffectParameter, EffectValues as EffectValues
from .effects.state import State as State
from .errors import (
    FitError as FitError,
    FormatError as FormatError,
    ImucalError as ImucalError,
    InputError as InputError,
    NotEnoughMotionError as NotEnoughMotionError,
)
from .estimation.calibrate import calibrate as calibrate
from .estimation.evaluate import Evaluation as Evaluation, evaluate as evaluate
from .estimation.inspection import Inspection as Inspection, inspect as inspect
from .estimation.result import CalibrationResult as CalibrationResult
from .exporting import Export as Export, Residual as Residual, export as export
from .finding import Finding as Finding, Place as Place
from .fleet.fleet import Fleet as Fleet
from .gap import Gap as Gap, find_gap as find_gap
from .gap.own_motion import (
    MoveResiduals as MoveResiduals,
    MoveSignals as MoveSignals,
    OwnMotion as OwnMotion,
    RestResiduals as RestResiduals,
    own_motion as own_motion,
)
from .gap.soak import soak as soak
from .gap.soak_result import Soak as Soak, SoakedSensor as SoakedSensor, SoakTerm as SoakTerm
from .importing import read_calibration as read_calibration
from .io import read as read, write as write
from .io.means import read_means as read_means
from .limits.judgement import Check as Check, Judgement as Judgement
from .limits.limit import FigureLimit as FigureLimit, ParameterLimit as ParameterLimit
from .limits.limits import Limits as Limits
from .noise_analysis.allan import allan_deviation as allan_deviation
from .noise_analysis.noise import (
    AxisNoise as AxisNoise,
    NoiseFigure as NoiseFigure,
    NoiseResult as NoiseResult,
    noise as noise,
)
from .planning.groups import PlannedParameter as PlannedParameter
from .planning.plan import plan as plan
from .planning.result import Plan as Plan
from .recording.means import Means as Means
from .recording.recording import Recording as Recording
from .rig.motion import Program as Program, Static as Static, Step as Step, Tumble as Tumble
from .rig.stand import Stand as Stand
from .rig.stand_limits import AxisLimits as AxisLimits, StandLimits as StandLimits
from .rig.temperature import Temperature as Temperature
from .rig.unit import Sensor as Sensor, Unit as Unit, unit_names as unit_names
from .simulation.simulate import Simulation as Simulation, repeat as repeat, simulate as simulate
from .simulation.truth import Truth as Truth
