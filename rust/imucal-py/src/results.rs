//! Results of the library as frozen Python objects, and as mappings where these go into documents.

use imucal::Termination;
use imucal::calibrate;
use imucal::diagnosis;
use imucal::error::Error;
use imucal::evaluate;
use imucal::recording::Recording;
use imucal::segment::{self, Segments};
use nalgebra::Vector3;
use numpy::{PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::arrays::to_rows;
use crate::error::finding;

type Vector = Py<PyArray1<f64>>;
type Rows = Py<PyArray2<f64>>;

fn vector(py: Python<'_>, values: &Vector3<f64>) -> Vector {
    PyArray1::from_slice(py, values.as_slice()).unbind()
}

fn rows(py: Python<'_>, values: &[Vector3<f64>]) -> PyResult<Rows> {
    Ok(to_rows(py, values.iter().map(|v| (*v).into()).collect())?.unbind())
}

fn matrix(py: Python<'_>, values: &nalgebra::Matrix3<f64>) -> PyResult<Rows> {
    Ok(to_rows(py, values.transpose().data.0.to_vec())?.unbind())
}

/// A mapping that goes into documents as it is: what does not exist (NaN) is None in it.
type Fields = Py<PyDict>;

fn fields<'py>(
    py: Python<'py>,
    of: impl IntoPyObject<'py, Output = Bound<'py, PyDict>, Error = PyErr>,
) -> PyResult<Fields> {
    Ok(of.into_pyobject(py)?.unbind())
}

fn known(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

fn each_known(values: &Vector3<f64>) -> [Option<f64>; 3] {
    [known(values.x), known(values.y), known(values.z)]
}

/// The figures of a calibration on a set of recordings.
#[derive(IntoPyObject)]
struct Figures {
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

/// How well noise alone explains residuals; nothing is known where no joint fit used them.
#[derive(IntoPyObject)]
struct Misfit {
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

/// One rest, judged.
#[derive(IntoPyObject)]
struct Rest<'a> {
    recording: &'a str,
    first: usize,
    end: usize,
    start_s: Option<f64>,
    end_s: Option<f64>,
    unsteadiness: Option<f64>,
    mean_specific_force: [Option<f64>; 3],
    mean_angular_rate: [Option<f64>; 3],
    norm_error_mps2: Option<f64>,
    norm_sigma_mps2: Option<f64>,
    excluded: Option<&'static str>,
}

impl<'a> Rest<'a> {
    fn new(recordings: &[Recording<'a>], r: &evaluate::RestReport) -> Self {
        Self {
            recording: recordings[r.recording].name,
            first: r.first,
            end: r.end,
            start_s: known(r.start_s),
            end_s: known(r.end_s),
            unsteadiness: known(r.unsteadiness),
            mean_specific_force: each_known(&r.mean_specific_force),
            mean_angular_rate: each_known(&r.mean_angular_rate),
            norm_error_mps2: known(r.norm_error_mps2),
            norm_sigma_mps2: known(r.norm_sigma_mps2),
            excluded: r.excluded,
        }
    }
}

/// One move, judged.
#[derive(IntoPyObject)]
struct Move<'a> {
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
    fn new(recordings: &[Recording<'a>], m: &evaluate::MoveReport) -> Self {
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

/// How the rests of one recording were found.
#[derive(IntoPyObject)]
struct Threshold {
    factor: Option<f64>,
    stable_from: Option<f64>,
    stable_to: Option<f64>,
    window_s: Option<f64>,
    /// Standard deviation of one sample, gyroscope x, y, z, accelerometer x, y, z, raw units.
    noise_floor: Vec<Option<f64>>,
}

impl From<&segment::Threshold> for Threshold {
    fn from(t: &segment::Threshold) -> Self {
        Self {
            factor: known(t.factor),
            stable_from: known(t.stable_from),
            stable_to: known(t.stable_to),
            window_s: known(t.window_s),
            noise_floor: t.noise_floor.iter().map(|value| known(*value)).collect(),
        }
    }
}

/// How a fit ended.
#[derive(IntoPyObject)]
struct FitReport {
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
                Termination::IterationLimit => "iteration_limit",
                Termination::NotFinite => "not_finite",
            },
        }
    }
}

/// By how much the joint fit widens each kind of residual; 1 where noise explains it.
#[derive(IntoPyObject)]
struct ResidualScales {
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

/// An effect as it was estimated.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct EffectEstimate {
    name: String,
    values: Py<PyArray1<f64>>,
    shape: Option<f64>,
    statistic: f64,
}

impl EffectEstimate {
    fn new(py: Python<'_>, e: &calibrate::TermEstimate) -> PyResult<Py<Self>> {
        let values = PyArray1::from_slice(py, &e.values).unbind();
        Py::new(py, Self { name: e.name.clone(), values, shape: e.shape, statistic: e.statistic })
    }
}

/// A calibration and all that is known about it.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct Outcome {
    accel_sensitivity: Rows,
    accel_bias: Vector,
    gyro_sensitivity: Rows,
    gyro_bias: Vector,
    names: Vec<String>,
    covariance: Rows,
    /// With how well noise alone explains each.
    rests: Vec<Fields>,
    moves: Vec<Fields>,
    thresholds: Vec<Fields>,
    accel_noise_density: Vector,
    gyro_noise_density: Vector,
    accelerometer_fit: Fields,
    gyroscope_fit: Fields,
    joint_fit: Option<Fields>,
    joint_scales: Option<Fields>,
    misfit: Fields,
    bias_instability_radps: Option<[f64; 3]>,
    /// rad
    tremor_rad: Vec<Option<f64>>,
    effects: Vec<Py<EffectEstimate>>,
    figures: Fields,
    held_out: Option<Py<HeldOut>>,
    findings: Vec<Py<PyAny>>,
    diagnosis: Vec<Fields>,
}

/// Moves and rests predicted by a fit without them.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct HeldOut {
    gravity_direction_rms_deg: f64,
    /// By move.
    direction_error_deg: Vector,
    /// By rest.
    norm_error_mps2: Vector,
}

impl HeldOut {
    fn new(py: Python<'_>, h: calibrate::CrossValidation) -> PyResult<Py<Self>> {
        let array = |values| PyArray1::from_vec(py, values).unbind();
        let held_out = Self {
            gravity_direction_rms_deg: h.gravity_direction_rms_deg,
            direction_error_deg: array(h.direction_error_deg),
            norm_error_mps2: array(h.norm_error_mps2),
        };
        Py::new(py, held_out)
    }
}

/// What a calibration knows badly.
#[derive(IntoPyObject)]
struct Diagnosis {
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

impl Outcome {
    /// Of these recordings.
    pub(crate) fn new(
        py: Python<'_>,
        o: calibrate::Outcome,
        diagnosis: Vec<diagnosis::Diagnosis>,
        recordings: &[Recording<'_>],
    ) -> PyResult<Self> {
        let with = |item: Fields, misfit| {
            item.bind(py).update(Misfit::from(misfit).into_pyobject(py)?.as_mapping())?;
            Ok::<Fields, PyErr>(item)
        };
        let rests = o.rests.iter().map(|rest| with(fields(py, Rest::new(recordings, rest))?, rest.misfit));
        let moves = o.moves.iter().map(|m| with(fields(py, Move::new(recordings, m))?, m.misfit));
        let size = o.values.len();
        let covariance: Vec<f64> = o.covariance.concat();
        Ok(Self {
            accel_sensitivity: matrix(py, o.calibration.accelerometer.sensitivity())?,
            accel_bias: vector(py, o.calibration.accelerometer.bias()),
            gyro_sensitivity: matrix(py, o.calibration.gyroscope.sensitivity())?,
            gyro_bias: vector(py, o.calibration.gyroscope.bias()),
            names: o.names,
            covariance: PyArray1::from_vec(py, covariance).reshape([size, size])?.unbind(),
            rests: rests.collect::<PyResult<_>>()?,
            moves: moves.collect::<PyResult<_>>()?,
            thresholds: o.thresholds.iter().map(|t| fields(py, Threshold::from(t))).collect::<PyResult<_>>()?,
            accel_noise_density: vector(py, &o.noise_density.specific_force),
            gyro_noise_density: vector(py, &o.noise_density.angular_rate),
            accelerometer_fit: fields(py, FitReport::from(o.accelerometer_fit))?,
            gyroscope_fit: fields(py, FitReport::from(o.gyroscope_fit))?,
            joint_fit: o.joint_fit.map(|fit| fields(py, FitReport::from(fit))).transpose()?,
            misfit: fields(py, Misfit::from(o.misfit))?,
            bias_instability_radps: o.bias_instability_radps,
            tremor_rad: o.tremor_rad,
            joint_scales: o.joint_scales.map(|scales| fields(py, ResidualScales::from(scales))).transpose()?,
            effects: o.effects.iter().map(|e| EffectEstimate::new(py, e)).collect::<PyResult<_>>()?,
            figures: fields(py, Figures::from(o.figures))?,
            held_out: o.held_out.map(|held_out| HeldOut::new(py, held_out)).transpose()?,
            findings: o.findings.iter().map(|f| finding(py, f)).collect::<PyResult<_>>()?,
            diagnosis: diagnosis.into_iter().map(|d| fields(py, Diagnosis::from(d))).collect::<PyResult<_>>()?,
        })
    }
}

/// Gravity at the rests of one recording, measured and carried there from the first rest.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct Carried {
    time_s: Vector,
    measured: Rows,
    uncalibrated: Rows,
    calibrated: Rows,
}

impl Carried {
    fn new(py: Python<'_>, c: evaluate::CarriedGravity) -> PyResult<Py<Self>> {
        let carried = Self {
            measured: rows(py, &c.measured)?,
            uncalibrated: rows(py, &c.uncalibrated)?,
            calibrated: rows(py, &c.calibrated)?,
            time_s: PyArray1::from_vec(py, c.time_s).unbind(),
        };
        Py::new(py, carried)
    }
}

/// A calibration judged on recordings.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct Evaluation {
    figures: Fields,
    rests: Vec<Fields>,
    moves: Vec<Fields>,
    carried: Vec<Py<Carried>>,
    findings: Vec<Py<PyAny>>,
}

impl Evaluation {
    /// Of these recordings.
    pub(crate) fn new(py: Python<'_>, e: evaluate::Evaluation, recordings: &[Recording<'_>]) -> PyResult<Self> {
        Ok(Self {
            figures: fields(py, Figures::from(e.figures))?,
            rests: e.rests.iter().map(|rest| fields(py, Rest::new(recordings, rest))).collect::<PyResult<_>>()?,
            moves: e.moves.iter().map(|m| fields(py, Move::new(recordings, m))).collect::<PyResult<_>>()?,
            carried: e.carried.into_iter().map(|c| Carried::new(py, c)).collect::<PyResult<_>>()?,
            findings: e.findings.iter().map(|f| finding(py, f)).collect::<PyResult<_>>()?,
        })
    }
}

/// What a recording holds, before any fit.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct Inspection {
    findings: Vec<Py<PyAny>>,
    /// Start and end of each rest, s.
    rests: Vec<(f64, f64)>,
    threshold: Option<Fields>,
    /// Why the threshold was chosen, or why there is no rest.
    explanation: String,
}

impl Inspection {
    pub(crate) fn new(
        py: Python<'_>,
        findings: Vec<Py<PyAny>>,
        segments: Option<Result<Segments, Error>>,
    ) -> PyResult<Self> {
        Ok(match segments {
            Some(Ok(segments)) => Self {
                findings,
                rests: segments.rests.iter().map(|rest| (rest.start_s, rest.end_s)).collect(),
                explanation: segments.threshold.explain(segments.rests.len()),
                threshold: Some(fields(py, Threshold::from(&segments.threshold))?),
            },
            Some(Err(error)) => Self { findings, rests: vec![], threshold: None, explanation: error.to_string() },
            None => Self { findings, rests: vec![], threshold: None, explanation: "the data cannot be read".into() },
        })
    }
}

/// What recordings can determine, before any fit.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct Prospect {
    /// None where a parameter is not determined.
    predicted_sigma: Vec<Option<f64>>,
    missing: Option<String>,
}

impl From<calibrate::Prospect> for Prospect {
    fn from(p: calibrate::Prospect) -> Self {
        Self { predicted_sigma: p.predicted_sigma.into(), missing: p.missing }
    }
}
