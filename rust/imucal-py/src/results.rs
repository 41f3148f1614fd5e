//! Results of the library as frozen Python objects.

use imucal::Termination;
use imucal::calibrate;
use imucal::diagnosis;
use imucal::error::Error;
use imucal::evaluate;
use imucal::segment::{self, Segments};
use nalgebra::Vector3;
use numpy::{PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;

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

/// The figures of a calibration on a set of recordings.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct Figures {
    chi2_per_dof: f64,
    gravity_norm_rms_mps2: f64,
    gravity_direction_rms_deg: f64,
    rests: usize,
    moves: usize,
}

impl From<evaluate::Figures> for Figures {
    fn from(f: evaluate::Figures) -> Self {
        Self {
            chi2_per_dof: f.chi2_per_dof,
            gravity_norm_rms_mps2: f.gravity_norm_rms_mps2,
            gravity_direction_rms_deg: f.gravity_direction_rms_deg,
            rests: f.rests,
            moves: f.moves,
        }
    }
}

/// How well noise alone explains residuals.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct Misfit {
    chi2: f64,
    degrees_of_freedom: usize,
    p_value: f64,
}

impl Misfit {
    fn new(py: Python<'_>, misfit: Option<calibrate::Misfit>) -> PyResult<Option<Py<Self>>> {
        misfit
            .map(|m| {
                let misfit = Self { chi2: m.chi2, degrees_of_freedom: m.degrees_of_freedom, p_value: m.p_value };
                Py::new(py, misfit)
            })
            .transpose()
    }
}

/// One rest, judged.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct Rest {
    recording: usize,
    first: usize,
    end: usize,
    start_s: f64,
    end_s: f64,
    unsteadiness: f64,
    mean_specific_force: Vector,
    mean_angular_rate: Vector,
    norm_error_mps2: f64,
    norm_sigma_mps2: f64,
    misfit: Option<Py<Misfit>>,
    excluded: Option<&'static str>,
}

impl Rest {
    fn new(py: Python<'_>, r: &evaluate::RestReport) -> PyResult<Py<Self>> {
        let rest = Self {
            recording: r.recording,
            first: r.first,
            end: r.end,
            start_s: r.start_s,
            end_s: r.end_s,
            unsteadiness: r.unsteadiness,
            mean_specific_force: vector(py, &r.mean_specific_force),
            mean_angular_rate: vector(py, &r.mean_angular_rate),
            norm_error_mps2: r.norm_error_mps2,
            norm_sigma_mps2: r.norm_sigma_mps2,
            misfit: Misfit::new(py, r.misfit)?,
            excluded: r.excluded,
        };
        Py::new(py, rest)
    }
}

/// One move, judged.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct Move {
    recording: usize,
    from_rest: usize,
    to_rest: usize,
    first: usize,
    last: usize,
    duration_s: f64,
    direction_error_deg: f64,
    direction_sigma_deg: f64,
    gravity_before: Vector,
    gravity_after: Vector,
    misfit: Option<Py<Misfit>>,
    excluded: Option<&'static str>,
}

impl Move {
    fn new(py: Python<'_>, m: &evaluate::MoveReport) -> PyResult<Py<Self>> {
        let report = Self {
            recording: m.recording,
            from_rest: m.from_rest,
            to_rest: m.to_rest,
            first: m.first,
            last: m.last,
            duration_s: m.duration_s,
            direction_error_deg: m.direction_error_deg,
            direction_sigma_deg: m.direction_sigma_deg,
            gravity_before: vector(py, &m.gravity_before),
            gravity_after: vector(py, &m.gravity_after),
            misfit: Misfit::new(py, m.misfit)?,
            excluded: m.excluded,
        };
        Py::new(py, report)
    }
}

/// How the rests of one recording were found.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct Threshold {
    factor: f64,
    stable_from: f64,
    stable_to: f64,
    window_s: f64,
    /// Standard deviation of one sample, gyroscope x, y, z, accelerometer x, y, z, raw units.
    noise_floor: Vector,
}

impl Threshold {
    fn new(py: Python<'_>, t: &segment::Threshold) -> PyResult<Py<Self>> {
        let threshold = Self {
            factor: t.factor,
            stable_from: t.stable_from,
            stable_to: t.stable_to,
            window_s: t.window_s,
            noise_floor: PyArray1::from_slice(py, t.noise_floor.as_slice()).unbind(),
        };
        Py::new(py, threshold)
    }
}

/// How a fit ended.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct FitReport {
    chi2: f64,
    degrees_of_freedom: usize,
    inflation: f64,
    iterations: u64,
    termination: &'static str,
}

impl From<imucal::FitReport> for FitReport {
    fn from(f: imucal::FitReport) -> Self {
        Self {
            chi2: f.chi2,
            degrees_of_freedom: f.degrees_of_freedom,
            inflation: f.inflation,
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
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct ResidualScales {
    norms: f64,
    moves: f64,
    inside: f64,
    stand: f64,
}

impl From<calibrate::ResidualScales> for ResidualScales {
    fn from(s: calibrate::ResidualScales) -> Self {
        Self { norms: s.norms, moves: s.moves, inside: s.inside, stand: s.stand }
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
    rests: Vec<Py<Rest>>,
    moves: Vec<Py<Move>>,
    thresholds: Vec<Py<Threshold>>,
    accel_noise_density: Vector,
    gyro_noise_density: Vector,
    accelerometer_fit: Py<FitReport>,
    gyroscope_fit: Py<FitReport>,
    joint_fit: Option<Py<FitReport>>,
    misfit: Option<Py<Misfit>>,
    joint_scales: Option<Py<ResidualScales>>,
    bias_instability_radps: Option<[f64; 3]>,
    /// rad
    tremor_rad: Vec<Option<f64>>,
    effects: Vec<Py<EffectEstimate>>,
    figures: Py<Figures>,
    held_out: Option<Py<HeldOut>>,
    findings: Vec<Py<PyAny>>,
    diagnosis: Vec<Py<Diagnosis>>,
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
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct Diagnosis {
    code: &'static str,
    parameters: Vec<String>,
    value: f64,
    message: String,
    way_out: String,
}

impl From<diagnosis::Diagnosis> for Diagnosis {
    fn from(d: diagnosis::Diagnosis) -> Self {
        Self { code: d.code, parameters: d.parameters, value: d.value, message: d.message, way_out: d.way_out }
    }
}

impl Outcome {
    pub(crate) fn new(py: Python<'_>, o: calibrate::Outcome, diagnosis: Vec<diagnosis::Diagnosis>) -> PyResult<Self> {
        let size = o.values.len();
        let covariance: Vec<f64> = o.covariance.concat();
        Ok(Self {
            accel_sensitivity: matrix(py, o.calibration.accelerometer.sensitivity())?,
            accel_bias: vector(py, o.calibration.accelerometer.bias()),
            gyro_sensitivity: matrix(py, o.calibration.gyroscope.sensitivity())?,
            gyro_bias: vector(py, o.calibration.gyroscope.bias()),
            names: o.names,
            covariance: PyArray1::from_vec(py, covariance).reshape([size, size])?.unbind(),
            rests: o.rests.iter().map(|rest| Rest::new(py, rest)).collect::<PyResult<_>>()?,
            moves: o.moves.iter().map(|m| Move::new(py, m)).collect::<PyResult<_>>()?,
            thresholds: o.thresholds.iter().map(|t| Threshold::new(py, t)).collect::<PyResult<_>>()?,
            accel_noise_density: vector(py, &o.noise_density.specific_force),
            gyro_noise_density: vector(py, &o.noise_density.angular_rate),
            accelerometer_fit: Py::new(py, FitReport::from(o.accelerometer_fit))?,
            gyroscope_fit: Py::new(py, FitReport::from(o.gyroscope_fit))?,
            joint_fit: o.joint_fit.map(|fit| Py::new(py, FitReport::from(fit))).transpose()?,
            misfit: Misfit::new(py, o.misfit)?,
            bias_instability_radps: o.bias_instability_radps,
            tremor_rad: o.tremor_rad,
            joint_scales: o.joint_scales.map(|scales| Py::new(py, ResidualScales::from(scales))).transpose()?,
            effects: o.effects.iter().map(|e| EffectEstimate::new(py, e)).collect::<PyResult<_>>()?,
            figures: Py::new(py, Figures::from(o.figures))?,
            held_out: o.held_out.map(|held_out| HeldOut::new(py, held_out)).transpose()?,
            findings: o.findings.iter().map(|f| finding(py, f)).collect::<PyResult<_>>()?,
            diagnosis: diagnosis.into_iter().map(|d| Py::new(py, Diagnosis::from(d))).collect::<PyResult<_>>()?,
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
    figures: Py<Figures>,
    rests: Vec<Py<Rest>>,
    moves: Vec<Py<Move>>,
    carried: Vec<Py<Carried>>,
    findings: Vec<Py<PyAny>>,
}

impl Evaluation {
    pub(crate) fn new(py: Python<'_>, e: evaluate::Evaluation) -> PyResult<Self> {
        Ok(Self {
            figures: Py::new(py, Figures::from(e.figures))?,
            rests: e.rests.iter().map(|rest| Rest::new(py, rest)).collect::<PyResult<_>>()?,
            moves: e.moves.iter().map(|m| Move::new(py, m)).collect::<PyResult<_>>()?,
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
    threshold: Option<Py<Threshold>>,
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
                threshold: Some(Threshold::new(py, &segments.threshold)?),
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
