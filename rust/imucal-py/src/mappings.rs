//! Converts parts of a result to mappings, which are written to JSON documents unchanged. The library uses NaN for a
//! value that does not exist. Such values, and all other values that are not finite, become None.

use imucal::Termination;
use imucal::calibrate;
use imucal::calibrate::diagnosis;
use imucal::evaluate;
use imucal::held;
use imucal::recording::Recording;
use imucal::rests;
use imucal::verdict;
use nalgebra::Vector3;
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// Named fields of a result, as a Python dict.
pub(crate) type Fields = Py<PyDict>;

pub(crate) fn fields<'py>(
    py: Python<'py>,
    of: impl IntoPyObject<'py, Output = Bound<'py, PyDict>, Error = PyErr>,
) -> PyResult<Fields> {
    Ok(of.into_pyobject(py)?.unbind())
}

pub(crate) fn known(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

fn each_known(values: &Vector3<f64>) -> [Option<f64>; 3] {
    [known(values.x), known(values.y), known(values.z)]
}

/// Figures of merit of a calibration on a set of recordings.
#[derive(IntoPyObject)]
pub(crate) struct Figures {
    chi2_per_dof: Option<f64>,
    gravity_norm_rms_mps2: Option<f64>,
    gravity_direction_rms_deg: Option<f64>,
    rests: usize,
    moves: usize,
}

impl From<evaluate::Figures> for Figures {
    fn from(f: evaluate::Figures) -> Self {
        Self {
            chi2_per_dof: known(f.chi2_per_dof),
            gravity_norm_rms_mps2: known(f.gravity_norm_rms_mps2),
            gravity_direction_rms_deg: known(f.gravity_direction_rms_deg),
            rests: f.rests,
            moves: f.moves,
        }
    }
}

/// chi2 test of the residuals of a rest, a move or a whole fit against noise. All fields are None if no joint fit used
/// these residuals.
#[derive(IntoPyObject)]
pub(crate) struct Misfit {
    chi2: Option<f64>,
    degrees_of_freedom: Option<usize>,
    p_value: Option<f64>,
}

impl From<Option<calibrate::Misfit>> for Misfit {
    fn from(misfit: Option<calibrate::Misfit>) -> Self {
        Self {
            chi2: misfit.and_then(|m| known(m.chi2)),
            degrees_of_freedom: misfit.map(|m| m.degrees_of_freedom),
            p_value: misfit.and_then(|m| known(m.p_value)),
        }
    }
}

/// A held parameter (a parameter with a prior), with its prior and its estimate.
#[derive(IntoPyObject)]
pub(crate) struct HeldParameter<'a> {
    name: &'a str,
    prior_value: f64,
    prior_sigma: f64,
    prior_source: &'static str,
    estimate: f64,
    sigma: f64,
    prior_share: f64,
    /// Difference between the prior value and the estimate from the recordings alone, in standard deviations of this
    /// difference; None if the recordings hardly determine the parameter.
    contradiction: Option<f64>,
}

impl<'a> From<&'a calibrate::HeldEstimate> for HeldParameter<'a> {
    fn from(held: &'a calibrate::HeldEstimate) -> Self {
        Self {
            name: &held.prior.name,
            prior_value: held.prior.value,
            prior_sigma: held.prior.sigma,
            prior_source: held.prior.source.name(),
            estimate: held.estimate,
            sigma: held.sigma,
            prior_share: held.prior_share,
            contradiction: held.contradiction,
        }
    }
}

/// Errors of the corrected samples that are due to the uncertainty of the priors of held parameters.
#[derive(IntoPyObject)]
pub(crate) struct PriorCost {
    gravity_direction_deg: f64,
    rotation_deg: Option<f64>,
}

impl From<held::PriorCost> for PriorCost {
    fn from(cost: held::PriorCost) -> Self {
        Self { gravity_direction_deg: cost.gravity_direction_deg, rotation_deg: known(cost.rotation_deg) }
    }
}

/// Evaluation of one rest.
#[derive(IntoPyObject)]
pub(crate) struct Rest<'a> {
    recording: &'a str,
    first: usize,
    end: usize,
    start_s: Option<f64>,
    end_s: Option<f64>,
    epochs: usize,
    unsteadiness: Option<f64>,
    mean_specific_force: [Option<f64>; 3],
    mean_angular_rate: [Option<f64>; 3],
    norm_error_mps2: Option<f64>,
    norm_sigma_mps2: Option<f64>,
    excluded: Option<&'static str>,
}

impl<'a> Rest<'a> {
    pub(crate) fn new(recordings: &[Recording<'a>], r: &evaluate::RestReport) -> Self {
        Self {
            recording: recordings[r.recording].name,
            first: r.first,
            end: r.end,
            start_s: known(r.start_s),
            end_s: known(r.end_s),
            epochs: r.epochs,
            unsteadiness: known(r.unsteadiness),
            mean_specific_force: each_known(&r.mean_specific_force),
            mean_angular_rate: each_known(&r.mean_angular_rate),
            norm_error_mps2: known(r.norm_error_mps2),
            norm_sigma_mps2: known(r.norm_sigma_mps2),
            excluded: r.excluded,
        }
    }
}

/// Evaluation of one move.
#[derive(IntoPyObject)]
pub(crate) struct Move<'a> {
    recording: &'a str,
    from_rest: usize,
    to_rest: usize,
    first: usize,
    last: usize,
    duration_s: Option<f64>,
    direction_error_deg: Option<f64>,
    direction_sigma_deg: Option<f64>,
    gravity_before: [Option<f64>; 3],
    gravity_after: [Option<f64>; 3],
    excluded: Option<&'static str>,
}

impl<'a> Move<'a> {
    pub(crate) fn new(recordings: &[Recording<'a>], m: &evaluate::MoveReport) -> Self {
        Self {
            recording: recordings[m.recording].name,
            from_rest: m.from_rest,
            to_rest: m.to_rest,
            first: m.first,
            last: m.last,
            duration_s: known(m.duration_s),
            direction_error_deg: known(m.direction_error_deg),
            direction_sigma_deg: known(m.direction_sigma_deg),
            gravity_before: each_known(&m.gravity_before),
            gravity_after: each_known(&m.gravity_after),
            excluded: m.excluded,
        }
    }
}

/// The threshold of rest detection for one recording, and the range of thresholds with which the same number of rests
/// is detected.
#[derive(IntoPyObject)]
pub(crate) struct Threshold {
    factor: Option<f64>,
    stable_from: Option<f64>,
    stable_to: Option<f64>,
    window_s: Option<f64>,
    /// Standard deviation of one sample at rest: gyroscope x, y, z, accelerometer x, y, z, in raw units.
    noise_floor: Vec<Option<f64>>,
}

impl From<&rests::Threshold> for Threshold {
    fn from(t: &rests::Threshold) -> Self {
        Self {
            factor: known(t.factor),
            stable_from: known(t.stable_from),
            stable_to: known(t.stable_to),
            window_s: known(t.window_s),
            noise_floor: t.noise_floor.iter().map(|value| known(*value)).collect(),
        }
    }
}

/// Report of a fit: chi2 of its residuals, number of iterations, and the reason why the iterations ended.
#[derive(IntoPyObject)]
pub(crate) struct FitReport {
    chi2: Option<f64>,
    degrees_of_freedom: usize,
    inflation: Option<f64>,
    iterations: u64,
    termination: &'static str,
}

impl From<imucal::FitReport> for FitReport {
    fn from(f: imucal::FitReport) -> Self {
        Self {
            chi2: known(f.chi2),
            degrees_of_freedom: f.degrees_of_freedom,
            inflation: known(f.inflation),
            iterations: f.iterations,
            termination: match f.termination {
                Termination::Converged => "converged",
                Termination::Stalled => "stalled",
                Termination::WeightsNotSettled => "weights_not_settled",
                Termination::FieldsNotSettled => "fields_not_settled",
                Termination::IterationLimit => "iteration_limit",
                Termination::NotFinite => "not_finite",
            },
        }
    }
}

/// Factors by which the joint fit increases the standard deviations of each kind of residual. A factor is 1 if noise
/// explains the residuals.
#[derive(IntoPyObject)]
pub(crate) struct ResidualScales {
    norms: Option<f64>,
    moves: Option<f64>,
    inside: Option<f64>,
    stand: Option<f64>,
}

impl From<calibrate::ResidualScales> for ResidualScales {
    fn from(s: calibrate::ResidualScales) -> Self {
        Self { norms: known(s.norms), moves: known(s.moves), inside: known(s.inside), stand: known(s.stand) }
    }
}

/// The residuals of one kind, compared with noise. `rms` and `noise` are in `unit`, a unit that datasheets use.
#[derive(IntoPyObject)]
pub(crate) struct GroupMisfit {
    kind: &'static str,
    rms: Option<f64>,
    noise: Option<f64>,
    unit: &'static str,
    ratio: Option<f64>,
    degrees_of_freedom: Option<f64>,
    p_value: Option<f64>,
    exceeds_noise: bool,
}

impl From<&verdict::GroupMisfit> for GroupMisfit {
    fn from(m: &verdict::GroupMisfit) -> Self {
        Self {
            kind: m.group.name(),
            rms: known(m.group.in_unit(m.rms)),
            noise: known(m.group.in_unit(m.noise())),
            unit: m.group.unit(),
            ratio: known(m.ratio()),
            degrees_of_freedom: known(m.degrees_of_freedom),
            p_value: known(m.p_value()),
            exceeds_noise: m.exceeds_noise(),
        }
    }
}

/// Parameters that the recordings determine only poorly, and the motion that would determine them better.
#[derive(IntoPyObject)]
pub(crate) struct Diagnosis {
    code: &'static str,
    parameters: Vec<String>,
    value: Option<f64>,
    message: String,
    way_out: String,
}

impl From<diagnosis::Diagnosis> for Diagnosis {
    fn from(d: diagnosis::Diagnosis) -> Self {
        Self { code: d.code, parameters: d.parameters, value: known(d.value), message: d.message, way_out: d.way_out }
    }
}
