//! Python bindings of the search for missing effects.

mod residuals;

use std::sync::Arc;

use imucal::calibrate::{EffectChoice, Options, UserEffects, diagnosis};
use imucal::error::Error;
use imucal::gap as library;
use imucal::recording::Recording;
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;

use crate::arrays::RecordingColumns;
use crate::calibration::{CalibrationArrays, TriadArrays};
use crate::effects::{choices, find};
use crate::error::{ToPython, finding};
use crate::interrupt::interruptible;
use crate::mappings::Fields;
use crate::options::CalibrateOptions;
use crate::results::{EffectEstimate, Evaluation, Outcome};
use crate::user_effects::PythonEffects;

/// Evidence for an effect, from a comparison of the models with and without the effect; see `imucal::gap::Score`.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct EffectScore {
    name: String,
    log_bayes_factor: f64,
    statistic: f64,
    dof: usize,
    p_value: f64,
    rivals: Vec<String>,
}

/// A variation of a bias or a scale that no effect of the catalogue describes; see `imucal::gap::GenericFinding`.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct GenericFinding {
    block: &'static str,
    kernel: &'static str,
    log_bayes_factor: f64,
    axis: usize,
    rests: Vec<usize>,
    /// Rms variation of the bias or of the scale on the sensor axis `axis`, SI units. `block` states which of the two
    /// varies.
    rms: f64,
    p_value: f64,
}

/// Test of the residuals that the accepted effects do not explain; see `imucal::gap::Remainder`.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct Remainder {
    kind: &'static str,
    block: Option<&'static str>,
    pattern: Option<&'static str>,
    p_value: f64,
    matters: bool,
}

/// Change of the biases from the calibration recordings to the control recordings; see `imucal::gap::SessionStep`.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct SessionStep {
    accelerometer_mps2: Option<[f64; 3]>,
    gyroscope_radps: Option<[f64; 3]>,
    p_value: f64,
    temperature_change_k: Option<f64>,
    /// Two values of chi2 per degree of freedom of the control recordings, from the fit with the accepted effects: with
    /// the biases of the calibration, and with biases estimated from the control recordings.
    chi2: (f64, f64),
}

/// Name of an effect, and two measures of the residuals that remain if a unit has an effect of typical size and the
/// fitted model lacks this effect. The first measure lists, for each kind of residual, its name and the rms of the
/// residuals, divided by their standard deviation from noise. The missing effect increases chi2. The second measure is
/// the share of this increase that disappears when the other parameters are fitted.
type Trace = (String, Vec<(&'static str, f64)>, f64);

/// Result of a search for effects: the score of each candidate effect, the detection limits, and `generic`, a variation
/// of a bias or scale that no effect of the catalogue describes. See `imucal::gap::Search`.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct Search {
    path: Vec<Py<EffectScore>>,
    ranking: Vec<Py<EffectScore>>,
    generic: Option<Py<GenericFinding>>,
    /// Effects that fit the calibration data but do not improve the prediction of held-out rests and moves. For each
    /// effect: its name, its log Bayes factor, the increase of the log predictive density of these rests and moves due
    /// to the effect, and the standard deviation of this increase. All numbers are in nats.
    not_predictive: Vec<(String, f64, f64, f64)>,
    /// For each effect that is not observable in the recordings: its name, and the data that would make it observable.
    not_observable: Vec<(String, String)>,
    /// For each effect: its name, its detection limit (smallest detectable rms size per parameter), and the unit of
    /// this limit.
    smallest_visible: Vec<(String, f64, String)>,
    traces: Vec<Trace>,
    /// The kind of residuals with the largest significant ratio of their standard deviation to their noise: the name of
    /// the kind, the ratio, and the p-value of the ratio. None if no ratio is significant.
    scattering_rests: Option<(&'static str, f64, f64)>,
    is_hand_moved: bool,
}

/// Name of a rejected effect, followed by one entry for each of four possible reasons. The entries of the reasons that
/// do not apply are None. Reason 1: the fit with the effect failed; the entry is the message. Reason 2: the effect
/// makes the prediction of unseen data (data that the fit does not use) worse; the entry is chi2 per degree of freedom
/// of these data without and with the effect. Reason 3: the parameters of the effect are not significant; the entry is
/// their p-value. Reason 4: a pure delay does not describe the gyroscope's filter; the entry contains the estimated
/// mean delay of the filter (s), half of the variance of the delay (s^2), and the standard deviation of this half
/// (s^2). Mean and variance are weighted by the impulse response of the filter.
type RefusalTuple = (String, Option<String>, Option<[f64; 2]>, Option<f64>, Option<[f64; 3]>);

/// A model fitted to the recordings of a unit, with its evaluation on the control recordings if there are any.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct GapFit {
    effects: Vec<String>,
    outcome: Py<Outcome>,
    control: Option<Py<Evaluation>>,
    /// Whether the fit also uses the specific force inside moves, and whether it also uses the angles of the stand. It
    /// uses such residuals if the other residuals hardly determine its effects.
    more_residuals: (bool, bool),
}

/// Fits and evidence of a search; see `imucal::gap::Analysis`.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct GapAnalysis {
    before: Py<GapFit>,
    /// The fit with the accepted effects; None if no effect was accepted.
    after: Option<Py<GapFit>>,
    effects: Vec<Py<EffectScore>>,
    /// For each accepted effect: its name, and one share for each of three kinds of residuals (norms of the specific
    /// force at rest, gravity directions after moves, mean rates at rest). Without effects, chi2 of unseen data exceeds
    /// the value expected from noise; the share is the part of this excess that the effect removes. It is None if there
    /// is hardly any excess.
    shares: Vec<(String, [Option<f64>; 3])>,
    /// Name of an accepted effect, name of a rival (an effect that explains nearly the same residuals), and the
    /// estimated parameters of the rival in a fit in which it replaces the effect. The estimated parameters are None if
    /// this fit fails.
    rivals: Vec<(String, String, Option<Py<EffectEstimate>>)>,
    refused: Vec<RefusalTuple>,
    /// An estimated constant rate that is not the rotation of the Earth: its magnitude and the standard deviation of
    /// the magnitude, rad/s. The magnitude differs from the Earth's rate, or the recordings do not determine it. None
    /// if there is no such rate.
    not_the_earth: Option<(f64, f64)>,
    not_confirmed: Vec<Py<EffectScore>>,
    /// Names of effects that unseen data contradict, and chi2 per degree of freedom of these data without and with the
    /// effects; None if there is no contradiction.
    contradiction: Option<(Vec<String>, f64, f64)>,
    remainder: Py<Remainder>,
    /// Change of the biases from the calibration recordings to the control recordings; None if it is not significant.
    session: Option<Py<SessionStep>>,
    /// Name of the figure of merit on unseen data (data that the fit does not use), its values without and with the
    /// accepted effects, and the value that noise alone would cause.
    unseen: (&'static str, f64, f64, f64),
    /// Three values of chi2 per degree of freedom on the same recordings: for the calibration that the caller gave for
    /// comparison, for the fit without effects, and for the fit with the accepted effects. None if no calibration was
    /// given.
    chi2_of_given: Option<[f64; 3]>,
    /// Residuals of the fit without effects, grouped by kind of residual, by rest and by move.
    residuals: Fields,
    /// Predicted rms errors of the corrected angular rate and specific force; None if no effect was accepted.
    corrected_errors: Option<Fields>,
    search: Py<Search>,
}

/// Result of a search for missing effects: its verdict, faults of the data, and the fits; see `imucal::gap::Gap`.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct GapResult {
    verdict: &'static str,
    faults: Vec<Py<PyAny>>,
    /// Fits and evidence; None if faults of the data prevented the first fit.
    analysis: Option<Py<GapAnalysis>>,
}

impl EffectScore {
    fn new(py: Python<'_>, s: library::Score) -> PyResult<Py<Self>> {
        let library::Score { name, log_bayes_factor, statistic, dof, p_value, rivals, .. } = s;
        Py::new(py, Self { name, log_bayes_factor, statistic, dof, p_value, rivals })
    }

    fn all(py: Python<'_>, scores: Vec<library::Score>) -> PyResult<Vec<Py<Self>>> {
        scores.into_iter().map(|score| Self::new(py, score)).collect()
    }
}

impl Search {
    fn new(py: Python<'_>, found: library::Search) -> PyResult<Py<Self>> {
        let generic = found.generic.map(|g| {
            let (block, kernel) = (g.block.name(), g.kernel.name());
            let library::GenericFinding { log_bayes_factor, p_value, axis, rests, rms, .. } = g;
            Py::new(py, GenericFinding { block, kernel, log_bayes_factor, axis, rests, rms, p_value })
        });
        let not_predictive = found.not_predictive.into_iter();
        let search = Self {
            path: EffectScore::all(py, found.path)?,
            ranking: EffectScore::all(py, found.ranking)?,
            generic: generic.transpose()?,
            not_predictive: not_predictive.map(|n| (n.name, n.log_bayes_factor, n.gain, n.gain_std)).collect(),
            not_observable: found.not_observable,
            smallest_visible: found.smallest_visible,
            traces: found.traces.into_iter().map(|t| (t.name, t.times_noise, t.taken_up)).collect(),
            scattering_rests: found.scattering_rests,
            is_hand_moved: found.is_hand_moved,
        };
        Py::new(py, search)
    }
}

/// The calibration recordings and the control recordings.
struct Sets<'a> {
    recordings: &'a [Recording<'a>],
    control: &'a [Recording<'a>],
    options: &'a Options<'a>,
}

impl Sets<'_> {
    fn fit(&self, py: Python<'_>, fit: library::Fit) -> PyResult<Py<GapFit>> {
        let diagnosis = diagnosis::diagnose(&fit.outcome, self.recordings);
        let control = fit.control.map(|control| Py::new(py, Evaluation::new(py, control.evaluation, self.control)?));
        let outcome = Py::new(py, Outcome::new(py, fit.outcome, diagnosis, self.recordings, self.options)?)?;
        let more_residuals = (fit.kinds.in_motion, fit.kinds.encoders);
        Py::new(py, GapFit { effects: fit.effects, outcome, control: control.transpose()?, more_residuals })
    }

    fn analysis(&self, py: Python<'_>, found: library::Analysis) -> PyResult<Py<GapAnalysis>> {
        let rival = |fit: library::RivalFit| {
            let estimate = fit.estimate.map(|estimate| EffectEstimate::new(py, &estimate)).transpose()?;
            Ok((fit.name, fit.rival, estimate))
        };
        let refused = found.refused.into_iter().map(|refusal| match refusal {
            library::Refusal::NotFitted { name, error } => (name, Some(error), None, None, None),
            library::Refusal::PredictsWorse { name, before, after } => (name, None, Some([before, after]), None, None),
            library::Refusal::NotSignificant { name, p_value } => (name, None, None, Some(p_value), None),
            library::Refusal::NotOnlyDelayed { name, tau_s, k_s2, k_sigma_s2 } => {
                (name, None, None, None, Some([tau_s, k_s2, k_sigma_s2]))
            }
        });
        let unseen = found.unseen;
        let session =
            session_of(found.after.as_ref().unwrap_or(&found.before)).map(|step| Py::new(py, step)).transpose()?;
        let library::Remainder { kind, block, pattern, p_value, matters } = found.remainder;
        let remainder = Py::new(py, Remainder { kind: kind.name(), block, pattern, p_value, matters })?;
        let analysis = GapAnalysis {
            before: self.fit(py, found.before)?,
            after: found.after.map(|fit| self.fit(py, fit)).transpose()?,
            effects: EffectScore::all(py, found.effects)?,
            shares: found.shares.into_iter().map(|share| (share.name, share.closed)).collect(),
            rivals: found.rivals.into_iter().map(rival).collect::<PyResult<_>>()?,
            refused: refused.collect(),
            not_the_earth: found.not_the_earth.map(|rate| (rate.size_radps, rate.sigma_radps)),
            not_confirmed: EffectScore::all(py, found.not_confirmed)?,
            contradiction: found.contradiction.map(|c| (c.effects, c.before, c.after)),
            remainder,
            session,
            unseen: (unseen.metric.name(), unseen.before, unseen.after, unseen.floor),
            chi2_of_given: found.chi2_of_given,
            residuals: residuals::residuals(py, &found.residuals, self.recordings)?,
            corrected_errors: found.corrected_errors.map(|e| residuals::predicted_errors(py, &e)).transpose()?,
            search: Search::new(py, found.search)?,
        };
        Py::new(py, analysis)
    }
}

/// Change of the biases from the calibration recordings to the control recordings, from the last fit: the fit with the
/// accepted effects, or without effects if none was accepted. None if the change is not significant or if there are no
/// control recordings.
fn session_of(last: &library::Fit) -> Option<SessionStep> {
    let control = last.control.as_ref()?;
    let library::SessionStep { accelerometer_mps2, gyroscope_radps, p_value, temperature_change_k } = control.step?;
    let chi2 = (control.evaluation.figures.chi2_per_dof, control.judged().figures.chi2_per_dof);
    Some(SessionStep { accelerometer_mps2, gyroscope_radps, p_value, temperature_change_k, chi2 })
}

/// A calibration for comparison, and the local gravity with which it was made, m/s^2. If the calibration has
/// user-defined effects, the third entry contains the recordings of the comparison after correction by this
/// calibration.
type Given<'py> = (CalibrationArrays<'py>, f64, Option<Vec<RecordingColumns<'py>>>);

/// Input of a search, read from the attributes of a Python object.
#[derive(FromPyObject)]
pub(crate) struct GapQuestion<'py> {
    recordings: Vec<RecordingColumns<'py>>,
    control: Vec<RecordingColumns<'py>>,
    options: CalibrateOptions<'py>,
    /// Names of candidate effects from the catalogue; None for all effects.
    candidates: Option<Vec<String>>,
    user_effects: Option<PythonEffects>,
    given: Option<Given<'py>>,
}

/// Finds missing effects. The Python function `stage(effects, candidates)` is called before each step to report
/// progress. Before a fit, `effects` contains the names of the fitted effects. Before a search, `candidates` is the
/// number of candidate effects. An argument that does not apply is None; before the prediction of errors, both
/// arguments are None.
#[pyfunction]
pub(crate) fn find_gap(py: Python<'_>, question: GapQuestion<'_>, stage: Py<PyAny>) -> PyResult<GapResult> {
    let GapQuestion { recordings, control, options, candidates, user_effects, given } = question;
    let options = options.options(py)?;
    let recordings = RecordingColumns::views(py, &recordings)?;
    let control = RecordingColumns::views(py, &control)?;
    let choice = |name: &String| Ok(EffectChoice::candidate(find(name)?));
    let choices = |names: &Vec<String>| names.iter().map(choice).collect::<Result<Vec<_>, Error>>();
    let candidates = candidates.as_ref().map(choices).transpose().to_python(py)?;
    let given = given.as_ref().map(|(calibration, gravity_mps2, corrected)| {
        let corrected = corrected.as_ref().map(|columns| RecordingColumns::views(py, columns)).transpose()?;
        Ok::<_, PyErr>((calibration.calibration(py)?, *gravity_mps2, corrected))
    });
    let given = given.transpose()?;
    let found = interruptible(py, || {
        let progress = |progress: library::Progress<'_>| {
            Python::attach(|py| match progress {
                library::Progress::Fit { effects } => stage.call1(py, (effects, None::<usize>)),
                library::Progress::Score { candidates } => stage.call1(py, (None::<Vec<String>>, candidates)),
                library::Progress::PredictErrors => stage.call1(py, (None::<Vec<String>>, None::<usize>)),
            })
            .map_err(|error| Error::Caller(Arc::new(error)))
            .map(drop)
        };
        let given = given.as_ref().map(|(calibration, gravity_mps2, corrected)| library::GivenCalibration {
            calibration,
            gravity_mps2: *gravity_mps2,
            corrected: corrected.as_deref(),
        });
        let gap_options = library::GapOptions {
            candidates,
            user_effects: user_effects.as_ref().map(|source| source as &dyn UserEffects),
            calibration: given,
            progress: Some(&progress),
        };
        library::find_gap(&recordings, &control, &options, &gap_options)
    })?;
    let library::Gap { verdict, faults, analysis } = found;
    let sets = Sets { recordings: &recordings, control: &control, options: &options };
    Ok(GapResult {
        verdict: verdict.name(),
        faults: faults.iter().map(|fault| finding(py, fault)).collect::<PyResult<_>>()?,
        analysis: analysis.map(|analysis| sets.analysis(py, analysis)).transpose()?,
    })
}

/// A rest of a recording on a stand: index of its first sample, index of its last sample plus one, start time (s), mean
/// accelerometer reading (raw units), and whether the fit used the rest.
type RestTuple = (usize, usize, f64, [Option<f64>; 3], bool);

/// Findings about the mount of the unit on the stand in one recording: slips of the unit on the mount or, if there are
/// no slips, looseness of the mount.
#[pyfunction]
pub(crate) fn mount_faults(
    py: Python<'_>,
    accelerometer: TriadArrays<'_>,
    rests: Vec<RestTuple>,
    recording: RecordingColumns<'_>,
) -> PyResult<Vec<Py<PyAny>>> {
    let accelerometer = accelerometer.triad(py, "accelerometer")?;
    let recordings = RecordingColumns::views(py, std::slice::from_ref(&recording))?;
    let rest = |(first, end, start_s, mean, is_used): RestTuple| library::StandRest {
        recording: 0,
        first,
        end,
        start_s,
        mean_specific_force: mean.map(|value| value.unwrap_or(f64::NAN)).into(),
        is_used,
    };
    let rests: Vec<library::StandRest> = rests.into_iter().map(rest).collect();
    let found = py.detach(|| {
        let slips = library::mount_slips(&accelerometer, &rests, &recordings);
        if slips.is_empty() { library::loose_mounts(&accelerometer, &rests, &recordings) } else { slips }
    });
    found.iter().map(|fault| finding(py, fault)).collect()
}

/// Median angle, deg, between the direction of the raw accelerometer samples and the gravity direction computed from
/// the angles of the stand; None without these angles.
#[pyfunction]
pub(crate) fn stand_mismatch_deg(py: Python<'_>, recording: RecordingColumns<'_>) -> PyResult<Option<f64>> {
    let recordings = RecordingColumns::views(py, std::slice::from_ref(&recording))?;
    Ok(py.detach(|| library::stand_mismatch_deg(&recordings[0])))
}

/// Residuals of the model without effects, divided by their standard deviation from noise, and the Jacobian of these
/// scaled residuals; see `imucal::gap::Linearised`.
#[pyclass(frozen, get_all, module = "imucal._core")]
pub(crate) struct GapDesign {
    residual: Py<PyArray1<f64>>,
    base: Py<PyArray2<f64>>,
    /// For each effect: its name, and the derivatives (m, p) of the m residuals with respect to its p parameters.
    effects: Vec<(String, Py<PyArray2<f64>>)>,
    groups: Py<PyArray1<usize>>,
    items: Py<PyArray1<usize>>,
}

/// Linearises the residuals about the model without effects. The result also contains the derivatives with respect to
/// the parameters of the candidate effects and of the user-defined effects in the options.
#[pyfunction]
#[pyo3(signature = (recordings, options, candidates, is_hand_moved = None))]
pub(crate) fn gap_design(
    py: Python<'_>,
    recordings: Vec<RecordingColumns<'_>>,
    options: CalibrateOptions<'_>,
    candidates: Vec<(String, usize)>,
    is_hand_moved: Option<bool>,
) -> PyResult<GapDesign> {
    let mut options = options.options(py)?;
    let user_fields = std::mem::take(&mut options.user_fields);
    let recordings = RecordingColumns::views(py, &recordings)?;
    let candidates = choices(&candidates).to_python(py)?;
    let found =
        interruptible(py, || library::linearise(&recordings, &options, &candidates, &user_fields, is_hand_moved))?;
    let array = |rows: &[Vec<f64>]| Ok::<_, PyErr>(PyArray2::from_vec2(py, rows)?.unbind());
    let effects = found.candidates.iter().map(|(name, rows)| Ok::<_, PyErr>((name.clone(), array(rows)?)));
    Ok(GapDesign {
        residual: PyArray1::from_vec(py, found.residual).unbind(),
        base: array(&found.base)?,
        effects: effects.collect::<PyResult<_>>()?,
        groups: PyArray1::from_vec(py, found.groups).unbind(),
        items: PyArray1::from_vec(py, found.items).unbind(),
    })
}
