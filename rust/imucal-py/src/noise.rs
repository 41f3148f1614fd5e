//! Python bindings of the Allan deviations and of the noise identification.

use std::num::NonZeroUsize;

use imucal::error::Error;
use imucal::noise as library;
use imucal::noise::allan;
use numpy::ndarray::{ArrayView1, Axis};
use numpy::{PyArray1, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

use crate::arrays::RecordingColumns;
use crate::error::{ToPython, finding};
use crate::interrupt::interruptible;

/// A noise parameter with its 95 % confidence interval, from `low` to `high`. `value` and `std` are None if the
/// parameter is not significant.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct NoiseEstimate {
    value: Option<f64>,
    std: Option<f64>,
    low: f64,
    high: f64,
}

/// Identified noise of one sensor axis, and its Allan deviations.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct AxisNoise {
    noise_density: Py<NoiseEstimate>,
    bias_instability: Py<NoiseEstimate>,
    random_walk: Py<NoiseEstimate>,
    quantisation: Py<NoiseEstimate>,
    lsb: f64,
    is_below_lsb: bool,
    shortest_period_s: f64,
    misfit: f64,
    tau_s: Py<PyArray1<f64>>,
    deviation: Py<PyArray1<f64>>,
    low: Py<PyArray1<f64>>,
    high: Py<PyArray1<f64>>,
    dof: Py<PyArray1<f64>>,
    model: Py<PyArray1<f64>>,
}

/// Change of the mean reading of one axis of a unit at rest. The values are: index of the axis (0 to 2 for the
/// accelerometer, 3 to 5 for the gyroscope); size of the change; its standard deviation; and the increase of 2 ln L
/// when this change is added to the noise model, where L is the likelihood of the samples.
type Departure = (usize, f64, f64, f64);
/// A step of the mean readings: its time (s), the index of the first sample after the step, and the change of each
/// affected axis.
type Step = (f64, usize, Vec<Departure>);
/// A slow drift of the mean reading of one axis: its start (s), its end (s), its time constant (s; None for a change at
/// a constant rate), and the total change of the mean.
type Drift = (f64, f64, Option<f64>, Departure);

fn departure(axis: &library::Departure) -> Departure {
    (axis.channel, axis.size, axis.std, axis.gain)
}

fn steps(steps: &[library::Step]) -> Vec<Step> {
    steps.iter().map(|step| (step.time_s, step.sample, step.axes.iter().map(departure).collect())).collect()
}

/// Noise of both sensors, identified in one interval of rest.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct Noise {
    start_s: f64,
    end_s: f64,
    samples: usize,
    rate_hz: f64,
    /// Noise on the axes x, y and z; None if the recording does not have the sensor.
    accelerometer: Option<Vec<Py<AxisNoise>>>,
    gyroscope: Option<Vec<Py<AxisNoise>>>,
    steps: Vec<Step>,
    cut_steps: Vec<Step>,
    drifts: Vec<Drift>,
    findings: Vec<Py<PyAny>>,
}

impl AxisNoise {
    fn new(py: Python<'_>, axis: &library::AxisNoise) -> PyResult<Py<Self>> {
        let estimate =
            |e: &library::Estimate| Py::new(py, NoiseEstimate { value: e.value, std: e.std, low: e.low, high: e.high });
        let column = |of: fn(&library::AllanPoint) -> f64| PyArray1::from_iter(py, axis.allan.iter().map(of)).unbind();
        let translated = Self {
            noise_density: estimate(&axis.noise_density)?,
            bias_instability: estimate(&axis.bias_instability)?,
            random_walk: estimate(&axis.random_walk)?,
            quantisation: estimate(&axis.quantisation)?,
            lsb: axis.lsb,
            is_below_lsb: axis.is_below_lsb,
            shortest_period_s: axis.shortest_period_s,
            misfit: axis.misfit,
            tau_s: column(|p| p.tau_s),
            deviation: column(|p| p.deviation),
            low: column(|p| p.low),
            high: column(|p| p.high),
            dof: column(|p| p.dof),
            model: column(|p| p.model),
        };
        Py::new(py, translated)
    }
}

/// Identifies the noise in the longest rest of a recording. `threads` is the number of threads; None uses all
/// processors.
#[pyfunction]
pub(crate) fn identify_noise(
    py: Python<'_>,
    recording: RecordingColumns<'_>,
    min_rest_s: f64,
    cut_steps: bool,
    threads: Option<NonZeroUsize>,
) -> PyResult<Noise> {
    let views = RecordingColumns::views_of_any(py, std::slice::from_ref(&recording))?;
    let threads = or_all(threads);
    let options = library::Options { min_rest_s, cut_steps };
    let noise = interruptible(py, || library::identify(&views[0], &options, threads))?;
    let axes = |axes: &Option<[library::AxisNoise; 3]>| {
        let of = |axes: &[library::AxisNoise; 3]| axes.iter().map(|axis| AxisNoise::new(py, axis)).collect();
        axes.as_ref().map(of).transpose()
    };
    Ok(Noise {
        start_s: noise.start_s,
        end_s: noise.end_s,
        samples: noise.samples,
        rate_hz: noise.rate_hz,
        accelerometer: axes(&noise.accelerometer)?,
        gyroscope: axes(&noise.gyroscope)?,
        steps: steps(&noise.steps),
        cut_steps: steps(&noise.cut_steps),
        drifts: noise
            .drifts
            .iter()
            .map(|drift| (drift.start_s, drift.end_s, drift.time_constant_s, departure(&drift.axis)))
            .collect(),
        findings: noise.findings.iter().map(|f| finding(py, f)).collect::<PyResult<_>>()?,
    })
}

/// One series of samples, or a two-dimensional array in any memory order. Each column of the array is one series.
#[derive(FromPyObject)]
pub(crate) enum Series<'py> {
    One(PyReadonlyArray1<'py, f64>),
    Columns(PyReadonlyArray2<'py, f64>),
}

impl Series<'_> {
    fn views(&self) -> Vec<ArrayView1<'_, f64>> {
        match self {
            Self::One(values) => vec![values.as_array()],
            Self::Columns(values) => {
                let view = values.as_array();
                (0..view.ncols()).map(|column| view.index_axis_move(Axis(1), column)).collect()
            }
        }
    }
}

/// Computes the overlapping Allan deviations of each series in `values`. Each entry of `factors` is an averaging time,
/// in samples. The series are not copied.
#[pyfunction]
pub(crate) fn allan_deviations<'py>(
    py: Python<'py>,
    values: Series<'py>,
    factors: Vec<usize>,
    threads: Option<NonZeroUsize>,
) -> PyResult<Vec<Bound<'py, PyArray1<f64>>>> {
    let threads = or_all(threads);
    let views = values.views();
    let deviations = interruptible(py, || {
        let of = |series: &ArrayView1<'_, f64>| match series.as_slice() {
            Some(slice) => allan::overlapping_deviations(slice.iter().copied(), &factors, threads),
            None => allan::overlapping_deviations(series.iter().copied(), &factors, threads),
        };
        views.iter().map(of).collect::<Result<Vec<_>, _>>()
    })?;
    Ok(deviations.into_iter().map(|series| PyArray1::from_vec(py, series)).collect())
}

/// Averaging times, in samples, at which the Allan deviation of a series with `samples` samples is computed. `spacing`
/// is "octave" or "decade".
#[pyfunction]
pub(crate) fn allan_factors(py: Python<'_>, samples: usize, spacing: &str) -> PyResult<Vec<usize>> {
    match spacing {
        "octave" => Ok(allan::octave_factors(samples)),
        "decade" => Ok(allan::decade_factors(samples)),
        other => Err(Error::Input(format!("taus are {other:?}: give octave, decade or a list in s"))).to_python(py),
    }
}

fn or_all(threads: Option<NonZeroUsize>) -> NonZeroUsize {
    threads.or_else(|| std::thread::available_parallelism().ok()).unwrap_or(NonZeroUsize::MIN)
}
