//! Python bindings of the planning of motions.

use imucal::calibrate::Checked;
use imucal::gap;
use imucal::plan::{self as library, Axis, Goal, Limits, Search, Sensors, Zone};
use pyo3::prelude::*;

use crate::arrays::RecordingColumns;
use crate::effects::choices;
use crate::error::ToPython;
use crate::interrupt::interruptible;
use crate::options::{CalibrateOptions, HeldTuple, priors};
use crate::simulation::{Motion, StepTuple, UnitArrays, steps};

/// The unit for which a plan is made, with its sampling rate, its effects and the options of the calibration, converted
/// from the attributes of a Python object.
#[derive(FromPyObject)]
pub(crate) struct PlanSensors<'py> {
    unit: UnitArrays<'py>,
    rate_hz: f64,
    gravity_mps2: f64,
    effects: Vec<String>,
    model: String,
    hold: Vec<HeldTuple>,
    profile: Vec<(String, Vec<f64>)>,
    /// Approximate duration of the run, s.
    run_s: f64,
}

/// Limits of a stand, or of a person who moves the unit by hand, converted from the attributes of a Python object.
/// Angles are in rad.
#[derive(FromPyObject)]
pub(crate) struct PlanLimits {
    /// For each motor, outermost first: maximum rate, maximum acceleration, and range of angles; None for a missing
    /// motor. The range is None for a motor without end stops.
    axes: [Option<AxisTuple>; 3],
    settle_s: f64,
    min_rest_s: f64,
    min_move_s: f64,
    forbidden_rad: Vec<[Option<[f64; 2]>; 3]>,
    pose_step_rad: f64,
    most_moves: usize,
    in_hand: bool,
}

type AxisTuple = (f64, f64, Option<[f64; 2]>);

impl PlanSensors<'_> {
    fn sensors(&self, py: Python<'_>) -> PyResult<Sensors> {
        let unit = self.unit.unit(py)?;
        let sensors = Sensors::of(&unit, self.rate_hz, self.gravity_mps2);
        let held = priors(&self.model, &self.hold, &self.profile).and_then(|priors| sensors.with_priors(&priors));
        held.and_then(|sensors| sensors.with_effects(&self.effects, self.run_s)).to_python(py)
    }
}

impl From<PlanLimits> for Limits {
    fn from(given: PlanLimits) -> Self {
        let axis = |(max_rate_radps, max_acceleration_radps2, range_rad): AxisTuple| Axis {
            max_rate_radps,
            max_acceleration_radps2,
            range_rad,
        };
        Self {
            axes: given.axes.map(|a| a.map(axis)),
            settle_s: given.settle_s,
            min_rest_s: given.min_rest_s,
            min_move_s: given.min_move_s,
            forbidden: given.forbidden_rad.into_iter().map(|angle_rad| Zone { angle_rad }).collect(),
            pose_step_rad: given.pose_step_rad,
            most_moves: given.most_moves,
            in_hand: given.in_hand,
        }
    }
}

/// Names and units of the parameters of the effects. In all lists of a plan, these parameters follow the 21 parameters
/// of the triads in this order.
#[pyfunction]
pub(crate) fn plan_effect_parameters(
    py: Python<'_>,
    sensors: PlanSensors<'_>,
) -> PyResult<Vec<(String, &'static str)>> {
    Ok(sensors.sensors(py)?.effect_parameters())
}

/// Predicts the standard deviation, in SI units, of every parameter in a calibration from these motions. The second
/// result is the number of rests.
#[pyfunction]
pub(crate) fn predict_sigma(
    py: Python<'_>,
    sensors: PlanSensors<'_>,
    motions: Vec<Motion>,
    min_rest_s: f64,
    settle_s: f64,
    in_hand: bool,
) -> PyResult<(Vec<f64>, usize)> {
    let sensors = sensors.sensors(py)?;
    let motions = motions.into_iter().map(Motion::motion).collect::<Result<Vec<_>, _>>().to_python(py)?;
    let found = interruptible(py, || library::predict(&sensors, &motions, min_rest_s, settle_s, in_hand))?;
    Ok((found.sigma, found.rests))
}

/// Finds the best program. Returns its steps, and whether it reaches the target standard deviations `sigma`. With
/// `sigma`, the best program is the shortest one that reaches the targets. Without `sigma`, it is the program of at
/// most `duration_s` that gives the most information about all parameters. `proposals` is the number of changes of the
/// program that the search tries, with random numbers from `seed`.
#[pyfunction]
#[pyo3(signature = (sensors, limits, duration_s, sigma, seed, proposals))]
pub(crate) fn optimal_program(
    py: Python<'_>,
    sensors: PlanSensors<'_>,
    limits: PlanLimits,
    duration_s: f64,
    sigma: Option<Vec<f64>>,
    seed: u64,
    proposals: usize,
) -> PyResult<(Vec<StepTuple>, bool)> {
    let (sensors, limits) = (sensors.sensors(py)?, limits.into());
    let goal = sigma.map_or(Goal::MostIn { duration_s }, |sigma| Goal::ShortestTo { sigma });
    let search = Search { goal, seed, proposals };
    let found = interruptible(py, || library::optimal(&sensors, &limits, &search))?;
    Ok((steps(&found.program), found.reached))
}

/// The first list contains, for each observable effect, its name, its detection limit and the unit of this limit. The
/// second list contains, for each effect that is not observable, its name and the data that would make it observable.
type Visible = (Vec<(String, f64, String)>, Vec<(String, String)>);

/// Computes the detection limit of each effect in `candidates`: the smallest size that is significant in the
/// recordings.
#[pyfunction]
pub(crate) fn smallest_visible(
    py: Python<'_>,
    recordings: Vec<RecordingColumns<'_>>,
    options: CalibrateOptions<'_>,
    candidates: Vec<(String, usize)>,
) -> PyResult<Visible> {
    let options = options.options(py)?;
    let recordings = RecordingColumns::views(py, &recordings)?;
    let candidates = choices(&candidates).to_python(py)?;
    let visible = || {
        let checked = Checked::try_new(&recordings, &options)?;
        gap::smallest_visible(&checked, &candidates, false)
    };
    interruptible(py, visible)
}
