//! The search for the missing effect for Python.

use imucal::calibrate::{EffectChoice, UserField};
use imucal::error::Error;
use imucal::gap as library;
use imucal_core::so3;
use numpy::{PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;

use crate::_core::Checked;
use crate::arrays::{RecordingColumns, UserFieldArrays, column, rows};
use crate::effects::find;
use crate::error::ToPython;
use crate::options::CalibrateOptions;

/// How an effect scores.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct EffectScore {
    name: String,
    log_bayes_factor: f64,
    statistic: f64,
    dof: usize,
    p_value: f64,
    rivals: Vec<String>,
}

/// A bias that varies in a pattern that no named effect explains.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct GenericFinding {
    block: &'static str,
    kernel: &'static str,
    log_bayes_factor: f64,
    axis: usize,
    rests: Vec<usize>,
    /// SI units.
    rms: f64,
}

/// An effect, what it leaves in each kind of residual, and the share that is taken up.
type Trace = (String, Vec<(&'static str, f64)>, f64);

/// What a search has found.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct Search {
    path: Vec<Py<EffectScore>>,
    ranking: Vec<Py<EffectScore>>,
    generic: Option<Py<GenericFinding>>,
    /// Name, log Bayes factor, gain on what is held out and its standard deviation.
    not_predictive: Vec<(String, f64, f64, f64)>,
    /// Size and standard deviation, rad/s.
    not_the_earth: Option<(f64, f64)>,
    not_observable: Vec<(String, String)>,
    smallest_visible: Vec<(String, f64, String)>,
    /// Name, kind of residual with how many times the noise it leaves there, and the share that the base takes up.
    traces: Vec<Trace>,
    scattering_rests: Option<(&'static str, f64, f64)>,
    in_motion_left_out: Option<String>,
}

impl EffectScore {
    fn new(py: Python<'_>, s: library::Score) -> PyResult<Py<Self>> {
        let library::Score { name, log_bayes_factor, statistic, dof, p_value, rivals } = s;
        Py::new(py, Self { name, log_bayes_factor, statistic, dof, p_value, rivals })
    }
}

/// Residuals (m,), base columns (m, n) and those of each effect, (name, (m, p)).
type Columns<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray2<f64>>, Vec<(String, Bound<'py, PyArray2<f64>>)>);

/// Whitened residuals of the model without effects, and what they depend on.
#[pyfunction]
pub(crate) fn gap_design<'py>(
    py: Python<'py>,
    recordings: Vec<RecordingColumns<'py>>,
    options: CalibrateOptions<'py>,
    candidates: Vec<(String, bool)>,
) -> PyResult<Columns<'py>> {
    let options = options.options(py)?;
    let recordings = RecordingColumns::views(py, &recordings)?;
    let candidates = choices(&candidates).to_python(py)?;
    let found = py.detach(|| library::linearise(&recordings, &options, &candidates, &[])).to_python(py)?;
    let array = |rows: &[Vec<f64>]| PyArray2::from_vec2(py, rows).map_err(PyErr::from);
    let effects =
        found.candidates.iter().map(|(name, rows)| Ok((name.clone(), array(rows)?))).collect::<PyResult<_>>()?;
    Ok((PyArray1::from_vec(py, found.residual.clone()), array(&found.base)?, effects))
}

pub(crate) fn choices(candidates: &[(String, bool)]) -> Result<Vec<EffectChoice>, Error> {
    candidates.iter().map(|(name, full)| Ok(EffectChoice { effect: find(name)?, full: *full })).collect()
}

/// Looks for effects among `candidates`, names with whether the full form is meant, and `user_fields`.
#[pyfunction]
pub(crate) fn search_gap(
    py: Python<'_>,
    checked: &Checked,
    recordings: Vec<RecordingColumns<'_>>,
    options: CalibrateOptions<'_>,
    candidates: Vec<(String, bool)>,
    user_fields: Vec<UserFieldArrays<'_>>,
) -> PyResult<Search> {
    let options = options.options(py)?;
    let recordings = RecordingColumns::views(py, &recordings)?;
    let candidates = choices(&candidates).to_python(py)?;
    let fields: Vec<UserField<'_>> = user_fields.iter().map(|field| field.view(py)).collect::<PyResult<_>>()?;
    let found = py.detach(|| library::search(&checked.0, &recordings, &options, &candidates, &fields)).to_python(py)?;
    let scores = |all: Vec<library::Score>| all.into_iter().map(|s| EffectScore::new(py, s)).collect::<PyResult<_>>();
    let generic = found.generic.map(|g| {
        let (block, kernel) = (g.block.name(), g.kernel.name());
        let library::GenericFinding { log_bayes_factor, axis, rests, rms, .. } = g;
        Py::new(py, GenericFinding { block, kernel, log_bayes_factor, axis, rests, rms })
    });
    Ok(Search {
        path: scores(found.path)?,
        ranking: scores(found.ranking)?,
        generic: generic.transpose()?,
        not_predictive: found
            .not_predictive
            .into_iter()
            .map(|n| (n.name, n.log_bayes_factor, n.gain, n.gain_std))
            .collect(),
        not_the_earth: found.not_the_earth,
        not_observable: found.not_observable,
        smallest_visible: found.smallest_visible,
        traces: found.traces.into_iter().map(|t| (t.name, t.times_noise, t.taken_up)).collect(),
        scattering_rests: found.scattering_rests,
        in_motion_left_out: found.in_motion_left_out,
    })
}

/// Whether a rate is that of the Earth, and is determined.
#[pyfunction]
pub(crate) fn is_earth_rate(size_radps: f64, sigma_radps: f64) -> bool {
    library::is_earth_rate(size_radps, sigma_radps)
}

/// Rotations `[w, x, y, z]` from the body at the samples `at` of a stretch, and half-way between each two, to the body at the
/// first sample, (2 n - 1, 4).
#[pyfunction]
pub(crate) fn attitudes<'py>(
    py: Python<'py>,
    time_s: PyReadonlyArray1<'py, f64>,
    angular_rate: PyReadonlyArray2<'py, f64>,
    at: Vec<usize>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let (time, rate) = (column(py, &time_s, "time_s")?, rows(py, &angular_rate, "angular_rate")?);
    let rotations = py.detach(|| library::attitudes(time, rate, &at)).to_python(py)?;
    let wxyz: Vec<Vec<f64>> = rotations.iter().map(|rotation| so3::to_wxyz(rotation).to_vec()).collect();
    Ok(PyArray2::from_vec2(py, &wxyz)?)
}
