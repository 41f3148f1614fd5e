//! Fits models with and without effects to the recordings of a unit, and evaluates them on unseen data: control
//! recordings, or held-out rests and moves.

use std::rc::Rc;

use imucal_core::calibration::Calibration;
use imucal_core::effects::Effect;
use nalgebra::Vector3;

use super::Score;
use super::options::{GapOptions, Progress};
use super::session::SessionStep;
use crate::calibrate::{
    Checked, CorrectedSamples, EffectChoice, Kinds, ModelOptions, Outcome, WarmStart, require_independent, rest_ranges,
};
use crate::correct::{correct, require_surroundings};
use crate::error::Error;
use crate::evaluate::{Evaluation, Uncertainty, evaluate, evaluate_corrected};
use crate::recording::Recording;
use crate::verdict::RecordingSet;

/// Number of cross-validation folds if there are no control recordings. Each fold is a third of the rests and moves and
/// is predicted with a fit to the other two thirds.
pub const FOLDS: usize = 3;

/// A model fitted to the recordings of a unit.
#[derive(Clone, Debug)]
pub struct Fit {
    /// Names of the effects in the model.
    pub effects: Vec<String>,
    /// Result of the calibration with these effects.
    pub outcome: Outcome,
    /// Evaluation of the calibration on the control recordings; `None` if there are no control recordings.
    pub control: Option<Control>,
    /// Additional kinds of residuals (specific force inside moves, stand angles) that the fit uses even if its effects
    /// are observable without them.
    pub kinds: Kinds,
}

/// Evaluation of a calibration on control recordings.
#[derive(Clone, Debug)]
pub struct Control {
    /// Figures of merit, and residuals of rests and moves.
    pub evaluation: Evaluation,
    /// For each rest: chi2, with three degrees of freedom, of the difference between the mean angular rate of the rest
    /// and the mean over all rests of the same recording. `None` for rests that the evaluation excludes.
    pub rate_chi2: Vec<Option<f64>>,
    /// Significant change of the biases from the calibration recordings to the control recordings. `None` if the fit
    /// without effects, or this fit, has no such change.
    pub step: Option<SessionStep>,
    /// Evaluation with the biases estimated from the control recordings; `None` if the biases did not change
    /// significantly.
    pub with_own_biases: Option<Evaluation>,
}

impl Control {
    /// The evaluation on which the acceptance of effects is based. If the biases changed from the calibration
    /// recordings to the control recordings, this is the evaluation with the changed biases. The changed biases are
    /// used because a change of the biases is evidence neither for nor against an effect.
    pub fn judged(&self) -> &Evaluation {
        self.with_own_biases.as_ref().unwrap_or(&self.evaluation)
    }
}

/// The recordings and options of a search, and all fits made so far.
pub(super) struct Fits<'a> {
    pub(super) checked: &'a Checked<'a>,
    pub(super) control: &'a [Recording<'a>],
    pub(super) options: &'a GapOptions<'a>,
    /// Start values for the next fit: the parameters of the final fit of the last search. The solutions with the
    /// selected effects are close to these values.
    pub(super) warm_start: Option<WarmStart>,
    /// Number of parameters in the selected form (for example linear or quadratic) of each selected effect.
    forms: Vec<(String, usize)>,
    /// Additional kinds of residuals that the next fits use, see [`Fit::kinds`].
    pub(super) kinds: Kinds,
    made: Vec<Rc<Fit>>,
}

impl<'a> Fits<'a> {
    pub(super) fn new(checked: &'a Checked<'a>, control: &'a [Recording<'a>], options: &'a GapOptions<'a>) -> Self {
        Self {
            checked,
            control,
            options,
            warm_start: None,
            forms: Vec::new(),
            kinds: Kinds::default(),
            made: Vec::new(),
        }
    }

    /// Sets the forms of the effects for the next fits: each selected effect gets the form that the search selected.
    /// Earlier fits with effects are discarded.
    pub(super) fn use_forms(&mut self, path: &[Score]) {
        self.forms = path.iter().map(|score| (score.name.clone(), score.parameters)).collect();
        self.kinds = Kinds::default();
        self.made.retain(|fit| fit.effects.is_empty());
    }

    /// The fit with the effects `names`, which may be from the catalogue or user-defined. Earlier fits are reused.
    pub(super) fn with(&mut self, names: &[String]) -> Result<Rc<Fit>, Error> {
        if let Some(known) = self.made.iter().find(|fit| fit.effects == names && fit.kinds == self.kinds) {
            return Ok(Rc::clone(known));
        }
        if !names.is_empty() {
            self.options.report(Progress::Fit { effects: names })?;
        }
        let fit = Rc::new(self.fit(names)?);
        self.made.push(Rc::clone(&fit));
        Ok(fit)
    }

    fn fit(&self, names: &[String]) -> Result<Fit, Error> {
        let own_names: Vec<String> = names.iter().filter(|name| self.options.user_effect(name)).cloned().collect();
        let model = self.model(names)?;
        let warm_start = self.warm_start.as_ref();
        let outcome = match self.options.user_effects {
            Some(source) => self.checked.calibrate_with(&model, source, &own_names, warm_start),
            None => self.checked.calibrate(&model, warm_start),
        };
        let outcome = outcome.map_err(|error| match error {
            // The fit without effects succeeded with the same recordings, so the effects cause this error. For example,
            // an effect depends on the heading, and the heading is lost in a move that the fit leaves out.
            Error::Input(words) if !names.is_empty() && !self.made.is_empty() => Error::Fit(words),
            other => other,
        })?;
        let control = (!self.control.is_empty()).then(|| self.judge(&outcome)).transpose()?;
        if let Some(control) = control.as_ref().filter(|_| self.made.is_empty()) {
            self.require_independent(&outcome, control)?;
        }
        if let Some(control) = &control
            && !control.evaluation.figures.chi2_per_dof.is_finite()
        {
            let words = control.evaluation.verdict.words();
            let is_finite = |recording: &Recording<'_>| {
                recording.temperature_degc.is_none_or(|degc| degc.iter().all(|value| value.is_finite()))
            };
            // An earlier evaluation of the control recordings, with the model without effects, gave finite figures. If
            // the temperatures of these recordings are also finite, the effects are the cause of the failure.
            let effects_fail = !names.is_empty() && self.control.iter().all(is_finite);
            return Err(if effects_fail { Error::Fit(words) } else { Error::Input(words) });
        }
        Ok(Fit { effects: names.to_vec(), outcome, control, kinds: self.kinds })
    }

    /// Options of a calibration with the catalogue effects among `names`. Each effect has the form (for example linear
    /// or quadratic) that the search selected.
    pub(super) fn model(&self, names: &[String]) -> Result<ModelOptions<'static>, Error> {
        let partly: Vec<String> = names.iter().filter(|name| !self.options.user_effect(name)).cloned().collect();
        let choice = |name: &String| {
            let effect = Effect::find(name).ok_or_else(|| Error::Input(format!("{name} is not in the catalogue")))?;
            let form = self.forms.iter().find(|(own, _)| own == name);
            Ok(EffectChoice { effect, parameters: form.map_or(effect.plain, |(_, parameters)| *parameters) })
        };
        Ok(ModelOptions {
            effects: partly.iter().map(choice).collect::<Result<_, Error>>()?,
            partly,
            user_fields: Vec::new(),
            kinds: self.kinds,
            folds: self.control.is_empty().then_some(FOLDS),
        })
    }

    /// The calibration recordings, corrected by a calibration with effects; `None` if the calibration has no effects.
    pub(super) fn corrected(&self, outcome: &Outcome) -> Result<Option<Vec<CorrectedSamples>>, Error> {
        self.corrected_set(outcome, RecordingSet::Calibration)
    }

    fn corrected_set(&self, outcome: &Outcome, set: RecordingSet) -> Result<Option<Vec<CorrectedSamples>>, Error> {
        let has_own = outcome.effects.iter().any(|effect| !effect.in_catalogue);
        match (self.options.user_effects, set) {
            (Some(source), _) if has_own => source.corrected(outcome, set).map(Some),
            (_, RecordingSet::Control) => corrected_by(&outcome.calibration, self.control),
            (_, RecordingSet::Calibration) => corrected_by(&outcome.calibration, self.checked.recordings()),
        }
    }

    /// Returns an error if a control recording is a copy of a calibration recording.
    fn require_independent(&self, outcome: &Outcome, control: &Control) -> Result<(), Error> {
        let recordings = self.checked.recordings();
        let rests = rest_ranges(&outcome.rests, recordings.len());
        let control_rests = rest_ranges(&control.evaluation.rests, self.control.len());
        require_independent((recordings, &rests), (self.control, &control_rests))
    }

    /// Evaluates a calibration on the control recordings. No fit uses these recordings.
    fn judge(&self, outcome: &Outcome) -> Result<Control, Error> {
        let options = self.checked.options();
        let corrected = self.corrected_set(outcome, RecordingSet::Control)?;
        let corrected = corrected.as_ref().map(|samples| with_samples(self.control, samples));
        let (gravity_mps2, min_rest_s) = (options.gravity_mps2, options.min_rest_s);
        let uncertainty = Uncertainty::try_new(&outcome.covariance, outcome.frame)?;
        let evaluation = judged(
            &outcome.calibration,
            Some(&uncertainty),
            self.control,
            corrected.as_deref(),
            gravity_mps2,
            min_rest_s,
        )?;
        let rate_chi2 = rate_chi2(&outcome.calibration, &evaluation, self.control, corrected.as_deref());
        let is_corrected = corrected.is_some();
        let sets = [self.checked.recordings(), self.control];
        // A change of the biases between the calibration and the control recordings is considered only if the fit
        // without effects also shows a change. If only a fit with effects shows a change, a wrong effect may be the
        // cause.
        let first = self.made.first().and_then(|fit| fit.control.as_ref());
        let step = match first.is_none_or(|control| control.step.is_some()) {
            true => SessionStep::find(outcome, &evaluation, is_corrected, sets),
            false => None,
        };
        let with_own_biases =
            step.map(|step| self.with_own_biases(outcome, &uncertainty, &step)).transpose()?.flatten();
        Ok(Control { evaluation, rate_chi2, step, with_own_biases })
    }

    /// Evaluation of a calibration on the control recordings, with biases that are estimated from these recordings.
    /// `None` if a calibration with these biases is not valid.
    fn with_own_biases(
        &self,
        outcome: &Outcome,
        uncertainty: &Uncertainty,
        step: &SessionStep,
    ) -> Result<Option<Evaluation>, Error> {
        let Some(calibration) = step.calibration(&outcome.calibration) else { return Ok(None) };
        let own: Option<Vec<CorrectedSamples>> =
            self.corrected_set(outcome, RecordingSet::Control)?.map(|samples| step.corrected(&samples));
        let corrected = own.as_ref().map(|samples| with_samples(self.control, samples));
        let options = self.checked.options();
        let (gravity_mps2, min_rest_s) = (options.gravity_mps2, options.min_rest_s);
        judged(&calibration, Some(uncertainty), self.control, corrected.as_deref(), gravity_mps2, min_rest_s).map(Some)
    }
}

/// Recordings corrected by a calibration; `None` if the calibration has no effects, because an evaluation without
/// effects uses the raw samples.
pub(super) fn corrected_by(
    calibration: &Calibration<f64>,
    recordings: &[Recording<'_>],
) -> Result<Option<Vec<CorrectedSamples>>, Error> {
    if calibration.effects.is_empty() {
        return Ok(None);
    }
    let corrected = recordings.iter().map(|recording| {
        require_surroundings(recording, calibration)?;
        Ok(correct(recording, calibration))
    });
    corrected.collect::<Result<_, Error>>().map(Some)
}

/// Evaluates a calibration on recordings. A calibration with effects requires the corrected recordings.
pub(super) fn judged(
    calibration: &Calibration<f64>,
    uncertainty: Option<&Uncertainty>,
    recordings: &[Recording<'_>],
    corrected: Option<&[Recording<'_>]>,
    gravity_mps2: f64,
    min_rest_s: f64,
) -> Result<Evaluation, Error> {
    match corrected {
        None => evaluate(calibration, uncertainty, recordings, gravity_mps2, min_rest_s),
        Some(corrected) => {
            evaluate_corrected(calibration, uncertainty, recordings, corrected, gravity_mps2, min_rest_s)
        }
    }
}

/// Recordings in which corrected samples replace the raw samples.
pub(super) fn with_samples<'a>(recordings: &[Recording<'a>], samples: &'a [CorrectedSamples]) -> Vec<Recording<'a>> {
    let with = |(recording, (rate, force)): (&Recording<'a>, &'a CorrectedSamples)| Recording {
        angular_rate: rate.into(),
        specific_force: force.into(),
        ..*recording
    };
    recordings.iter().zip(samples).map(with).collect()
}

/// chi2 of the mean angular rate at each rest of the control recordings, see [`Control::rate_chi2`].
///
/// Some gyroscope effects, for example an isotropic g-sensitivity, are observable only in these means. The noise is
/// estimated from the raw samples. A noise estimate from corrected samples would be too small, because the correction
/// of a delay smooths the samples but does not make their mean more accurate.
fn rate_chi2(
    calibration: &Calibration<f64>,
    evaluation: &Evaluation,
    recordings: &[Recording<'_>],
    corrected: Option<&[Recording<'_>]>,
) -> Vec<Option<f64>> {
    let mut chi2 = vec![None; evaluation.rests.len()];
    let inverse = calibration.gyroscope.inverse();
    for (index, recording) in recordings.iter().enumerate() {
        let of_rest = |k: usize| {
            let rest = &evaluation.rests[k];
            let samples = rest.first..rest.end;
            let recorded = || samples.clone().map(|i| inverse * Vector3::from(recording.angular_rate.at(i)));
            let rates: Vec<Vector3<f64>> = match corrected {
                Some(corrected) => samples.clone().map(|i| corrected[index].angular_rate.at(i).into()).collect(),
                None => recorded().map(|rate| rate - inverse * calibration.gyroscope.bias()).collect(),
            };
            let recorded: Vec<Vector3<f64>> = recorded().collect();
            (k, mean(&rates), standard_deviation(&recorded) / (samples.len() as f64).sqrt())
        };
        let is_judged = |k: &usize| evaluation.rests[*k].recording == index && evaluation.rests[*k].excluded.is_none();
        let rests: Vec<_> = (0..evaluation.rests.len()).filter(is_judged).map(of_rest).collect();
        let all = mean(&rests.iter().map(|(_, mean, _)| *mean).collect::<Vec<_>>());
        for (k, mean, sigma) in rests {
            chi2[k] = Some((mean - all).component_div(&sigma).norm_squared());
        }
    }
    chi2
}

fn mean(values: &[Vector3<f64>]) -> Vector3<f64> {
    values.iter().sum::<Vector3<f64>>() / values.len() as f64
}

fn standard_deviation(values: &[Vector3<f64>]) -> Vector3<f64> {
    let mean = mean(values);
    let squares: Vector3<f64> = values.iter().map(|value| (value - mean).map(|v| v * v)).sum();
    (squares / values.len() as f64).map(f64::sqrt)
}
