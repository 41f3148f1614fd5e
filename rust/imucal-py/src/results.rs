//! Converts results of the library to immutable Python objects.

use std::ops::Range;

use imucal::calibrate;
use imucal::calibrate::diagnosis;
use imucal::error::Error;
use imucal::evaluate;
use imucal::recording::Recording;
use imucal::rests::Segments;
use imucal::verdict;
use nalgebra::Vector3;
use numpy::{PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;

use crate::arrays::to_rows;
use crate::error::{ToPython, finding};
use crate::mappings::{
    Diagnosis, Fields, Figures, FitReport, GroupMisfit, HeldParameter, Misfit, Move, PriorCost, ResidualScales, Rest,
    Threshold, fields,
};

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

/// The reasons of a verdict as sentences, each with its code in brackets.
fn words_of(verdict: &verdict::Verdict) -> Vec<String> {
    verdict.reasons().iter().map(|reason| format!("{reason} [{}]", reason.code())).collect()
}

fn residuals(py: Python<'_>, groups: &[verdict::GroupMisfit]) -> PyResult<Vec<Fields>> {
    groups.iter().map(|group| fields(py, GroupMisfit::from(group))).collect()
}

fn ranges(rests: &[evaluate::RestReport], recordings: &[Recording<'_>]) -> Vec<Vec<(usize, usize)>> {
    let of_recording = |ranges: Vec<Range<usize>>| ranges.into_iter().map(|rest| (rest.start, rest.end)).collect();
    calibrate::rest_ranges(rests, recordings.len()).into_iter().map(of_recording).collect()
}

/// An estimated effect. `statistic` is the Wald statistic for the hypothesis that all parameters of the effect are
/// zero.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct EffectEstimate {
    name: String,
    values: Py<PyArray1<f64>>,
    shape: Option<f64>,
    statistic: f64,
}

impl EffectEstimate {
    pub(crate) fn new(py: Python<'_>, e: &calibrate::TermEstimate) -> PyResult<Py<Self>> {
        let values = PyArray1::from_slice(py, &e.values).unbind();
        Py::new(py, Self { name: e.name.clone(), values, shape: e.shape, statistic: e.statistic })
    }
}

/// Triads and effects of a calibration. The library passes this estimate to the Python functions that evaluate
/// user-defined effects or remove them from recordings.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct Estimate {
    accel_sensitivity: Rows,
    accel_bias: Vector,
    gyro_sensitivity: Rows,
    gyro_bias: Vector,
    effects: Vec<Py<EffectEstimate>>,
}

impl Estimate {
    pub(crate) fn new(py: Python<'_>, o: &calibrate::Outcome) -> PyResult<Self> {
        Ok(Self {
            accel_sensitivity: matrix(py, o.calibration.accelerometer.sensitivity())?,
            accel_bias: vector(py, o.calibration.accelerometer.bias()),
            gyro_sensitivity: matrix(py, o.calibration.gyroscope.sensitivity())?,
            gyro_bias: vector(py, o.calibration.gyroscope.bias()),
            effects: o.effects.iter().map(|e| EffectEstimate::new(py, e)).collect::<PyResult<_>>()?,
        })
    }
}

/// Result of a calibration. For an accelerometer without a gyroscope, all gyroscope fields are None.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct Outcome {
    accel_sensitivity: Rows,
    accel_bias: Vector,
    gyro_sensitivity: Option<Rows>,
    gyro_bias: Option<Vector>,
    names: Vec<String>,
    covariance: Rows,
    /// Report on each rest, with a chi2 test of the residuals of this rest against noise.
    rests: Vec<Fields>,
    moves: Vec<Fields>,
    /// For each recording and each of its rests: index of the first sample, and index of the last sample plus one.
    rest_ranges: Vec<Vec<(usize, usize)>>,
    thresholds: Vec<Fields>,
    accel_noise_density: Vector,
    gyro_noise_density: Option<Vector>,
    accelerometer_fit: Fields,
    gyroscope_fit: Option<Fields>,
    joint_fit: Option<Fields>,
    joint_scales: Option<Fields>,
    misfit: Fields,
    bias_instability_radps: Option<[f64; 3]>,
    /// Rms angle of the hand tremor about each axis in each recording, rad; None for a unit that is not hand-held.
    tremor_rad: Vec<Option<f64>>,
    effects: Vec<Py<EffectEstimate>>,
    /// Parameters with a prior (held parameters), with their priors and estimates; empty if there are none.
    held: Vec<Fields>,
    /// For each parameter of the calibration, the share of its variance that is due to the priors of held parameters
    /// (parameters with a prior); empty if no parameter is held.
    prior_shares: Vec<f64>,
    /// Errors of the corrected samples that are due to the uncertainty of the priors; None if no parameter has a prior.
    prior_cost: Option<Fields>,
    figures: Fields,
    /// Verdict on the calibration recordings: good, incomplete or poor.
    verdict: &'static str,
    /// Reasons for this verdict; empty for the verdict good.
    reasons: Vec<String>,
    /// Goodness of fit of each kind of residual, relative to noise.
    residuals: Vec<Fields>,
    held_out: Option<Py<HeldOut>>,
    findings: Vec<Py<PyAny>>,
    diagnosis: Vec<Fields>,
}

/// Prediction errors of the moves and rests in a cross-validation. Each move or rest is predicted by a fit that does
/// not use it.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct HeldOut {
    gravity_direction_rms_deg: f64,
    /// Error of the predicted gravity direction after each move, deg.
    direction_error_deg: Vector,
    /// Norm of the corrected specific force at each rest, minus local gravity, m/s^2.
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

impl Outcome {
    /// Converts the outcome of a calibration to Python objects. `recordings` are the recordings from which it was made.
    pub(crate) fn new(
        py: Python<'_>,
        o: calibrate::Outcome,
        diagnosis: Vec<diagnosis::Diagnosis>,
        recordings: &[Recording<'_>],
        options: &calibrate::Options<'_>,
    ) -> PyResult<Self> {
        let with = |item: Fields, misfit| {
            item.bind(py).update(Misfit::from(misfit).into_pyobject(py)?.as_mapping())?;
            Ok::<Fields, PyErr>(item)
        };
        let rests = o.rests.iter().map(|rest| with(fields(py, Rest::new(recordings, rest))?, rest.misfit));
        let moves = o.moves.iter().map(|m| with(fields(py, Move::new(recordings, m))?, m.misfit));
        let size = o.values.len();
        let verdict = o.verdict();
        let covariance = o.covariance_with_references(&options.references, options.gravity_mps2).concat();
        Ok(Self {
            accel_sensitivity: matrix(py, o.calibration.accelerometer.sensitivity())?,
            accel_bias: vector(py, o.calibration.accelerometer.bias()),
            gyro_sensitivity: Some(matrix(py, o.calibration.gyroscope.sensitivity())?),
            gyro_bias: Some(vector(py, o.calibration.gyroscope.bias())),
            names: o.names,
            covariance: PyArray1::from_vec(py, covariance).reshape([size, size])?.unbind(),
            rests: rests.collect::<PyResult<_>>()?,
            moves: moves.collect::<PyResult<_>>()?,
            rest_ranges: ranges(&o.rests, recordings),
            thresholds: o.thresholds.iter().map(|t| fields(py, Threshold::from(t))).collect::<PyResult<_>>()?,
            accel_noise_density: vector(py, &o.noise_density.specific_force),
            gyro_noise_density: Some(vector(py, &o.noise_density.angular_rate)),
            accelerometer_fit: fields(py, FitReport::from(o.accelerometer_fit))?,
            gyroscope_fit: Some(fields(py, FitReport::from(o.gyroscope_fit))?),
            joint_fit: o.joint_fit.map(|fit| fields(py, FitReport::from(fit))).transpose()?,
            misfit: fields(py, Misfit::from(o.misfit))?,
            bias_instability_radps: o.bias_instability_radps,
            tremor_rad: o.tremor_rad,
            joint_scales: o.joint_scales.map(|scales| fields(py, ResidualScales::from(scales))).transpose()?,
            effects: o.effects.iter().map(|e| EffectEstimate::new(py, e)).collect::<PyResult<_>>()?,
            held: o.held.iter().map(|held| fields(py, HeldParameter::from(held))).collect::<PyResult<_>>()?,
            prior_shares: o.prior_shares,
            prior_cost: o.prior_cost.map(|cost| fields(py, PriorCost::from(cost))).transpose()?,
            figures: fields(py, Figures::from(o.figures))?,
            reasons: words_of(&verdict),
            verdict: verdict.name(),
            residuals: residuals(py, &o.groups)?,
            held_out: o.held_out.map(|held_out| HeldOut::new(py, held_out)).transpose()?,
            findings: o.findings.iter().map(|f| finding(py, f)).collect::<PyResult<_>>()?,
            diagnosis: diagnosis.into_iter().map(|d| fields(py, Diagnosis::from(d))).collect::<PyResult<_>>()?,
        })
    }
}

impl Outcome {
    /// Converts the outcome of a calibration from a table of mean readings to Python objects. `name` is the name of the
    /// table.
    pub(crate) fn of_means(
        py: Python<'_>,
        o: calibrate::AccelerometerOutcome,
        name: &str,
        options: &calibrate::Options<'_>,
    ) -> PyResult<Self> {
        let table = Recording::try_new(name, &[], &[], &[]).to_python(py)?;
        Self::of_accelerometer(py, o, &[table], options)
    }

    /// Converts the outcome of a calibration of an accelerometer without a gyroscope to Python objects.
    pub(crate) fn of_accelerometer(
        py: Python<'_>,
        o: calibrate::AccelerometerOutcome,
        recordings: &[Recording<'_>],
        options: &calibrate::Options<'_>,
    ) -> PyResult<Self> {
        let without_misfit = |rest| {
            let item = fields(py, Rest::new(recordings, rest))?;
            item.bind(py).update(Misfit::from(None).into_pyobject(py)?.as_mapping())?;
            Ok::<Fields, PyErr>(item)
        };
        let size = o.values.len();
        let verdict = o.verdict();
        let covariance = o.covariance_with_references(&options.references, options.gravity_mps2).concat();
        Ok(Self {
            accel_sensitivity: matrix(py, o.triad.sensitivity())?,
            accel_bias: vector(py, o.triad.bias()),
            gyro_sensitivity: None,
            gyro_bias: None,
            covariance: PyArray1::from_vec(py, covariance).reshape([size, size])?.unbind(),
            rests: o.rests.iter().map(without_misfit).collect::<PyResult<_>>()?,
            moves: Vec::new(),
            rest_ranges: ranges(&o.rests, recordings),
            thresholds: o.thresholds.iter().map(|t| fields(py, Threshold::from(t))).collect::<PyResult<_>>()?,
            accel_noise_density: vector(py, &o.noise_density),
            gyro_noise_density: None,
            accelerometer_fit: fields(py, FitReport::from(o.fit))?,
            gyroscope_fit: None,
            joint_fit: None,
            misfit: fields(py, Misfit::from(None))?,
            bias_instability_radps: None,
            tremor_rad: vec![None; recordings.len()],
            joint_scales: None,
            effects: Vec::new(),
            figures: fields(py, Figures::from(o.figures))?,
            reasons: words_of(&verdict),
            verdict: verdict.name(),
            residuals: residuals(py, &o.groups)?,
            held: o.held.iter().map(|held| fields(py, HeldParameter::from(held))).collect::<PyResult<_>>()?,
            prior_shares: o.prior_shares,
            prior_cost: o.prior_cost.map(|cost| fields(py, PriorCost::from(cost))).transpose()?,
            held_out: None,
            findings: o.findings.iter().map(|f| finding(py, f)).collect::<PyResult<_>>()?,
            diagnosis: Vec::new(),
            names: o.names,
        })
    }
}

/// Gravity at the rests of one recording, m/s^2 in the body frame: measured by the calibrated accelerometer, and
/// propagated from the first rest by the uncalibrated and by the calibrated gyroscope.
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

/// Evaluation of a calibration on recordings.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct Evaluation {
    figures: Fields,
    /// Figures of merit of the uncalibrated sensors with their nominal sensitivity.
    before: Fields,
    /// Verdict on the control recordings: good, incomplete or poor.
    verdict: &'static str,
    /// Reasons for this verdict; empty for the verdict good.
    reasons: Vec<String>,
    /// Goodness of fit of each kind of residual, relative to noise and the uncertainty of the calibration.
    residuals: Vec<Fields>,
    rests: Vec<Fields>,
    moves: Vec<Fields>,
    /// For each recording and each of its rests: index of the first sample, and index of the last sample plus one.
    rest_ranges: Vec<Vec<(usize, usize)>>,
    carried: Vec<Py<Carried>>,
    findings: Vec<Py<PyAny>>,
}

impl Evaluation {
    /// Converts an evaluation to Python objects. `recordings` are the recordings on which the calibration was
    /// evaluated.
    pub(crate) fn new(py: Python<'_>, e: evaluate::Evaluation, recordings: &[Recording<'_>]) -> PyResult<Self> {
        Ok(Self {
            figures: fields(py, Figures::from(e.figures))?,
            before: fields(py, Figures::from(e.before))?,
            reasons: words_of(&e.verdict),
            verdict: e.verdict.name(),
            residuals: residuals(py, &e.groups)?,
            rests: e.rests.iter().map(|rest| fields(py, Rest::new(recordings, rest))).collect::<PyResult<_>>()?,
            moves: e.moves.iter().map(|m| fields(py, Move::new(recordings, m))).collect::<PyResult<_>>()?,
            rest_ranges: ranges(&e.rests, recordings),
            carried: e.carried.into_iter().map(|c| Carried::new(py, c)).collect::<PyResult<_>>()?,
            findings: e.findings.iter().map(|f| finding(py, f)).collect::<PyResult<_>>()?,
        })
    }
}

/// Findings about a recording and its rests, before any fit.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct Inspection {
    findings: Vec<Py<PyAny>>,
    /// For each rest: its start and end, s, and the number of epochs (parts) into which it is divided. Only long rests
    /// are divided. The samples are averaged separately in each epoch.
    rests: Vec<(f64, f64, usize)>,
    threshold: Option<Fields>,
    /// Explanation of the chosen threshold, or the reason why there are no rests.
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
                rests: (segments.rests.iter().zip(&segments.epochs))
                    .map(|(rest, epochs)| (rest.start_s, rest.end_s, epochs.len().max(1)))
                    .collect(),
                explanation: segments.threshold.explain(segments.rests.len()),
                threshold: Some(fields(py, Threshold::from(&segments.threshold))?),
            },
            Some(Err(error)) => Self { findings, rests: vec![], threshold: None, explanation: error.to_string() },
            None => Self { findings, rests: vec![], threshold: None, explanation: "the data cannot be read".into() },
        })
    }
}

/// Prediction, before any fit, of which parameters the recordings determine and how accurately.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct Prospect {
    /// Predicted standard deviation of each of the 21 parameters, in raw units; None if the recordings do not determine
    /// the parameter.
    predicted_sigma: Vec<Option<f64>>,
    /// Names of the accelerometer parameters that the rests determine only together with the moves.
    through_moves: Vec<String>,
    missing: Option<String>,
}

impl From<calibrate::Prospect> for Prospect {
    fn from(p: calibrate::Prospect) -> Self {
        Self { predicted_sigma: p.predicted_sigma.into(), through_moves: p.through_moves, missing: p.missing }
    }
}
