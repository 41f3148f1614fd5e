//! The search for the missing effect from end to end: fit, search, accept, judge.

use std::rc::Rc;

use imucal_core::calibration::Calibration;

use super::acceptance::{Accepted, Refusal, UnseenFigure, unless_it_fails};
use super::earth::{self, is_earth_rate};
use super::fits::{Fit, Fits, corrected_by, judged, with_samples};
use super::forward_search::search;
use super::options::{GapOptions, Progress};
use super::predicted_error::{BriefMeans, PredictedErrors, UserCorrection, predicted_errors};
use super::residual_kinds::CorrectedFit;
use super::residuals_by_place::{ResidualsByPlace, residuals_by_place};
use super::verdict::{Basis, Contradiction, Rivals, Verdict};
use super::{Score, Search};
use crate::calibrate::{
    BriefCorrection, Checked, CorrectedSamples, EffectChoice, Options, RecordingSet, TermEstimate, UserEffects, views,
};
use crate::correct::correct;
use crate::error::Error;
use crate::finding::Finding;
use crate::recording::Recording;

/// What a search for the missing effect has found.
#[derive(Clone, Debug)]
pub struct Gap {
    /// The verdict.
    pub verdict: Verdict,
    /// Faults of the data, if they are the verdict.
    pub faults: Vec<Finding>,
    /// Fits and evidence; `None` if faults of the data prevented any fit.
    pub analysis: Option<Analysis>,
}

/// Fits and evidence of a search.
#[derive(Clone, Debug)]
pub struct Analysis {
    /// The fit without effects.
    pub before: Fit,
    /// The fit with the effects that joined the model; `None` if none did.
    pub after: Option<Fit>,
    /// The effects that joined, each with its score and its rivals.
    pub effects: Vec<Score>,
    /// Rivals of the effects that joined, fitted in their place.
    pub rivals: Vec<RivalFit>,
    /// Effects that were found and did not join.
    pub refused: Vec<Refusal>,
    /// What has the pattern of the Earth's rate and not its size.
    pub not_the_earth: Option<NotTheEarth>,
    /// Effects that fit the recordings too well for chance and do not predict what no fit has seen.
    pub not_confirmed: Vec<Score>,
    /// Control recordings that contradict effects that had been accepted.
    pub contradiction: Option<Contradiction>,
    /// The figure on what no fit has seen, before and after.
    pub unseen: UnseenFigure,
    /// chi2 per degree of freedom of the given calibration, if there is one, of the fit without effects and of that
    /// with what joined: on the control recordings, or on the recordings if there are none.
    pub chi2_of_given: Option<[f64; 3]>,
    /// Residuals of the fit without effects by kind and place, and what the fit with effects leaves of them.
    pub residuals: ResidualsByPlace,
    /// Predicted errors of signals corrected by the given calibration, or else by the fit without effects, and by the
    /// fit with effects: on the control recordings if there are any. `None` if no effect joined.
    pub corrected_errors: Option<PredictedErrors>,
    /// All scores, generic hypotheses, and what the recordings could show.
    pub search: Search,
}

/// A rival of an effect that joined the model, as it was estimated in the place of that effect.
#[derive(Clone, Debug)]
pub struct RivalFit {
    /// The effect that joined.
    pub name: String,
    /// The rival.
    pub rival: String,
    /// The estimate of the rival; `None` if it cannot be fitted.
    pub estimate: Option<TermEstimate>,
}

/// A rate with the pattern of the Earth's and another size, or one that these recordings do not determine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NotTheEarth {
    /// Its size, rad/s.
    pub size_radps: f64,
    /// Its standard deviation, rad/s.
    pub sigma_radps: f64,
}

/// Finds where recordings of a unit disagree with the model, names the effect that is missing, and adds it.
///
/// `control` are recordings that only judge; without them rests and moves are held out, in three folds.
///
/// # Errors
/// As [`calibrate`](crate::calibrate::calibrate()), but faults of the data are a verdict.
pub fn find_gap(
    recordings: &[Recording<'_>],
    control: &[Recording<'_>],
    options: &Options<'_>,
    gap_options: &GapOptions<'_>,
) -> Result<Gap, Error> {
    let refused = |faults| Ok(Gap { verdict: Verdict::DataFault, faults, analysis: None });
    // Checks and start values belong to the first fit.
    gap_options.report(Progress::Fit { effects: &[] })?;
    let checked = match Checked::try_new(recordings, options) {
        Err(Error::Data(faults)) => return refused(faults),
        checked => checked?,
    };
    let mut fits = Fits::new(&checked, control, gap_options);
    let before = match fits.with(&[]) {
        Err(Error::Data(faults)) => return refused(faults),
        fit => fit?,
    };
    let (search, earth) = fits.search_beyond_the_earth(&before)?;
    let path: Vec<String> = search.path.iter().map(|score| score.name.clone()).collect();
    let Accepted { path, fit: after, mut refused } = fits.accept(&before, &path)?;
    let mut not_the_earth = None;
    match earth {
        Earth::Possible => {}
        Earth::NotFitted(error) => refused.push(Refusal::NotFitted { name: earth::NAME.into(), error }),
        Earth::Other(other) => not_the_earth = Some(other),
    }
    let basis =
        Basis { recordings: checked.recordings(), search: &search, path: &path, before: &before, after: &after };
    let judgement = basis.judge();
    let after = judgement.verdict.has_effects().then_some(after);
    let last = after.as_ref().unwrap_or(&before);
    let unseen = before.unseen_figure(last).ok_or_else(|| {
        Error::NotEnoughMotion("no rest and no move can be held out to judge by: record more of both".into())
    })?;
    let chi2_of_given = fits.chi2_of_given(&before, last)?;
    let rivals = match judgement.verdict {
        Verdict::Ambiguous => fits.rivals(&path, &judgement.rivals)?,
        _ => Vec::new(),
    };
    let residuals = fits.residuals(&before, after.as_deref(), !search.is_hand_moved)?;
    let corrected_errors = after.as_ref().map(|after| fits.corrected_errors(&before, after)).transpose()?;
    let joined = |name: &String| search.path.iter().find(|score| score.name == *name).cloned();
    let effects = if after.is_some() { path.iter().filter_map(joined).collect() } else { Vec::new() };
    let analysis = Analysis {
        before: Fit::clone(&before),
        after: after.map(|fit| Fit::clone(&fit)),
        effects,
        rivals,
        refused,
        not_the_earth,
        not_confirmed: judgement.not_confirmed,
        contradiction: judgement.contradiction,
        unseen,
        chi2_of_given,
        residuals,
        corrected_errors,
        search,
    };
    Ok(Gap { verdict: judgement.verdict, faults: judgement.faults, analysis: Some(analysis) })
}

/// Whether what was named `earth_rate` may be the rate of the Earth.
enum Earth {
    /// It may be, or was not named.
    Possible,
    /// It cannot be fitted.
    NotFitted(String),
    /// It has another size, or is not determined.
    Other(NotTheEarth),
}

impl Fits<'_> {
    /// The search, once more without `earth_rate` where that was named and is something else.
    fn search_beyond_the_earth(&mut self, before: &Rc<Fit>) -> Result<(Search, Earth), Error> {
        let choices = self.options.choices();
        let search = self.search(before, &choices, false)?;
        let earth = self.earth(&search)?;
        let is_named = search.path.iter().any(|score| score.name == earth::NAME);
        if matches!(earth, Earth::Possible) || !is_named {
            return Ok((search, earth));
        }
        let others: Vec<EffectChoice> =
            choices.into_iter().filter(|choice| choice.effect.name != earth::NAME).collect();
        // A motion by hand stays one, whatever fewer effects explain.
        let again = self.search(before, &others, search.is_hand_moved)?;
        Ok((again, earth))
    }

    fn search(&mut self, before: &Fit, choices: &[EffectChoice], is_hand_moved: bool) -> Result<Search, Error> {
        let own = self.options.user_effects.map_or(&[][..], UserEffects::names);
        self.options.report(Progress::Score { candidates: choices.len() + own.len() })?;
        let fields = match self.options.user_effects {
            Some(source) => source.fields(own, &before.outcome)?,
            None => Vec::new(),
        };
        let search = search(self.checked, choices, &views(&fields), is_hand_moved)?;
        self.warm_start = Some(search.warm_start.clone());
        Ok(search)
    }

    /// The direction of the Earth's rate is free, because the heading is not known and every latitude is possible; its
    /// size is known.
    fn earth(&mut self, search: &Search) -> Result<Earth, Error> {
        if let Some((size_radps, sigma_radps)) = search.not_the_earth {
            return Ok(Earth::Other(NotTheEarth { size_radps, sigma_radps }));
        }
        let path: Vec<String> = search.path.iter().map(|score| score.name.clone()).collect();
        if !path.iter().any(|name| name == earth::NAME) {
            return Ok(Earth::Possible);
        }
        let fit = match unless_it_fails(self.with(&path))? {
            Ok(fit) => fit,
            Err(error) => return Ok(Earth::NotFitted(error)),
        };
        Ok(match fit.earth_rate() {
            Some(rate) if !is_earth_rate(rate.size_radps, rate.sigma_radps) => Earth::Other(rate),
            _ => Earth::Possible,
        })
    }

    /// chi2 per degree of freedom of the given calibration, if there is one, and of the two fits.
    fn chi2_of_given(&self, before: &Fit, after: &Fit) -> Result<Option<[f64; 3]>, Error> {
        let Some(given) = &self.options.calibration else { return Ok(None) };
        let options = self.checked.options();
        let recordings = if self.control.is_empty() { self.checked.recordings() } else { self.control };
        let chi2 = |calibration: &Calibration<f64>, gravity_mps2: f64, corrected: Option<&[Recording<'_>]>| {
            let evaluation = judged(calibration, recordings, corrected, gravity_mps2, options.min_rest_s)?;
            let chi2 = evaluation.figures.chi2_per_dof;
            if chi2.is_finite() { Ok(chi2) } else { Err(Error::Input(evaluation.verdict.words())) }
        };
        let of_given = match given.corrected {
            Some(corrected) => chi2(given.calibration, given.gravity_mps2, Some(corrected))?,
            None => {
                let samples = corrected_by(given.calibration, recordings)?;
                let corrected = samples.as_ref().map(|samples| with_samples(recordings, samples));
                chi2(given.calibration, given.gravity_mps2, corrected.as_deref())?
            }
        };
        let of_fit = |fit: &Fit| {
            if let Some(control) = &fit.control {
                return Ok(control.evaluation.figures.chi2_per_dof);
            }
            let samples = self.corrected(&fit.outcome)?;
            let corrected = samples.as_ref().map(|samples| with_samples(recordings, samples));
            chi2(&fit.outcome.calibration, options.gravity_mps2, corrected.as_deref())
        };
        Ok(Some([of_given, of_fit(before)?, of_fit(after)?]))
    }

    /// Residuals of the fit without effects by kind and place, and what the other one leaves of them.
    fn residuals(&self, before: &Fit, after: Option<&Fit>, inside_moves: bool) -> Result<ResidualsByPlace, Error> {
        let recordings = self.checked.recordings();
        let samples = |fit: &Fit| {
            let each = || recordings.iter().map(|recording| correct(recording, &fit.outcome.calibration)).collect();
            Ok::<Vec<CorrectedSamples>, Error>(self.corrected(&fit.outcome)?.unwrap_or_else(each))
        };
        let (of_before, of_after) = (samples(before)?, after.map(samples).transpose()?);
        let corrected_before = with_samples(recordings, &of_before);
        let corrected_after = of_after.as_ref().map(|samples| with_samples(recordings, samples));
        let gravity_mps2 = self.checked.options().gravity_mps2;
        let before = CorrectedFit { outcome: &before.outcome, corrected: &corrected_before, gravity_mps2 };
        let after = after.zip(corrected_after.as_ref()).map(|(fit, corrected)| CorrectedFit {
            outcome: &fit.outcome,
            corrected,
            gravity_mps2,
        });
        Ok(residuals_by_place(&before, after.as_ref(), inside_moves))
    }

    /// Predicted errors of corrected signals, without and with the effects that joined.
    fn corrected_errors(&self, before: &Fit, after: &Fit) -> Result<PredictedErrors, Error> {
        self.options.report(Progress::PredictErrors)?;
        let calibration =
            self.options.calibration.as_ref().map_or(&before.outcome.calibration, |given| given.calibration);
        let (recordings, set) = match self.control {
            [] => (self.checked.recordings(), RecordingSet::Calibration),
            control => (control, RecordingSet::Control),
        };
        let Some(source) = self.options.user_effects else {
            return predicted_errors(calibration, &after.outcome, recordings, None);
        };
        let BriefCorrection { before, after: corrected, fields } =
            source.brief_means(&before.outcome, &after.outcome, set)?;
        let means: Vec<BriefMeans> = recordings.iter().map(BriefMeans::of).collect();
        let brief: Vec<Recording<'_>> = means.iter().zip(recordings).map(|(means, of)| means.recording(of)).collect();
        let user = UserCorrection {
            before: &with_samples(&brief, &before),
            after: &with_samples(&brief, &corrected),
            fields: &views(&fields),
        };
        predicted_errors(calibration, &after.outcome, recordings, Some(&user))
    }

    /// Each rival of an effect that joined, fitted in the place of that effect.
    fn rivals(&mut self, path: &[String], rivals: &[Rivals]) -> Result<Vec<RivalFit>, Error> {
        let mut found = Vec::new();
        for Rivals { name, rivals } in rivals {
            for rival in rivals {
                let instead: Vec<String> =
                    path.iter().map(|other| if other == name { rival.clone() } else { other.clone() }).collect();
                let estimate = match self.with(&instead) {
                    Ok(fit) => fit.outcome.effects.iter().find(|own| own.name == *rival).cloned(),
                    Err(error @ Error::Caller(_)) => return Err(error),
                    // A rival that cannot be fitted has no size.
                    Err(_) => None,
                };
                found.push(RivalFit { name: name.clone(), rival: rival.clone(), estimate });
            }
        }
        Ok(found)
    }
}

impl Fit {
    /// The size of `earth_rate` in this fit and its standard deviation.
    fn earth_rate(&self) -> Option<NotTheEarth> {
        let values = &self.outcome.effects.iter().find(|effect| effect.name == earth::NAME)?.values;
        let first = self.outcome.names.iter().position(|name| name.starts_with("earth_rate_"))?;
        let size_radps = values.iter().map(|value| value * value).sum::<f64>().sqrt();
        let term = |(i, j): (usize, usize)| values[i] * values[j] * self.outcome.covariance[first + i][first + j];
        let pairs = (0..values.len()).flat_map(|i| (0..values.len()).map(move |j| (i, j)));
        let variance = pairs.map(term).sum::<f64>() / (size_radps * size_radps);
        Some(NotTheEarth { size_radps, sigma_radps: variance.sqrt() })
    }
}
