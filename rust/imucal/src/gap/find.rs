//! The complete search for missing effects: fit without effects, forward search, acceptance on unseen data, and
//! verdict.

use std::rc::Rc;

use imucal_core::calibration::Calibration;
use imucal_core::effects::Sensor;

use super::acceptance::{Accepted, EffectShare, Refusal, UnseenFigure, unless_it_fails};
use super::earth::{self, is_earth_rate};
use super::fits::{Fit, Fits, corrected_by, judged, with_samples};
use super::forward_search::{OF_TIME, search};
use super::options::{GapOptions, Progress};
use super::predicted_error::{BriefMeans, PredictedErrors, UserCorrection, predicted_errors};
use super::remainder::Remainder;
use super::residual_kinds::CorrectedFit;
use super::residuals_by_place::{ResidualsByPlace, residuals_by_place};
use super::verdict::{Basis, Contradiction, Rivals, Verdict};
use super::{Score, Search};
use crate::calibrate::{
    BriefCorrection, Checked, CorrectedSamples, EffectChoice, Options, TermEstimate, UserEffects, views,
};
use crate::correct::correct;
use crate::error::Error;
use crate::finding::Finding;
use crate::recording::Recording;
use crate::verdict::RecordingSet;

/// The result of [`find_gap`].
#[derive(Clone, Debug)]
pub struct Gap {
    /// The conclusion of the search.
    pub verdict: Verdict,
    /// Faults of the data; empty unless the verdict is [`Verdict::DataFault`].
    pub faults: Vec<Finding>,
    /// Fits and evidence; `None` if the data have faults that prevent a fit.
    pub analysis: Option<Analysis>,
}

/// Fits of the models without and with effects, and the evidence for each effect.
#[derive(Clone, Debug)]
pub struct Analysis {
    /// The fit without effects.
    pub before: Fit,
    /// The fit with the accepted effects; `None` if no effect was accepted.
    pub after: Option<Fit>,
    /// Scores of the accepted effects. Each score lists the rivals: effects that explain nearly the same residuals.
    pub effects: Vec<Score>,
    /// For each accepted effect: the share of the excess chi2 of unseen data (chi2 beyond noise) that the effect
    /// removes.
    pub shares: Vec<EffectShare>,
    /// Fits in which a rival replaces an accepted effect.
    pub rivals: Vec<RivalFit>,
    /// Effects that the search selected and that the validation on unseen data then rejected.
    pub refused: Vec<Refusal>,
    /// An estimated constant rate that is not the Earth's rate; `None` if no such rate was found.
    pub not_the_earth: Option<NotTheEarth>,
    /// Effects with a significant log Bayes factor that do not improve the prediction of unseen data and are therefore
    /// not accepted.
    pub not_confirmed: Vec<Score>,
    /// A contradiction between unseen data and effects that had been accepted; `None` if there is no contradiction.
    pub contradiction: Option<Contradiction>,
    /// Residuals that the accepted effects leave unexplained. If no effect was accepted, these are the residuals that
    /// the model without effects leaves unexplained.
    pub remainder: Remainder,
    /// The figure of merit on unseen data (control recordings, or held-out rests and moves) that the accepted effects
    /// improve most: its values without and with these effects.
    pub unseen: UnseenFigure,
    /// chi2 per degree of freedom of the given calibration, of the fit without effects, and of the fit with the
    /// accepted effects. These values are computed on the control recordings, or on the calibration recordings if there
    /// are no control recordings. `None` if no calibration was given.
    pub chi2_of_given: Option<[f64; 3]>,
    /// Residuals of the fit without effects by kind, rest and move. If effects were accepted, these residuals are
    /// compared with the residuals of the fit with the accepted effects.
    pub residuals: ResidualsByPlace,
    /// Predicted rms errors of corrected signals (docs/model.md (35)). `before` is the error after correction by the
    /// given calibration, or by the fit without effects if no calibration was given. `after` is the error after
    /// correction by the fit with effects. Both are computed on the control recordings, or on the calibration
    /// recordings if there are no control recordings. `None` if no effect was accepted.
    pub corrected_errors: Option<PredictedErrors>,
    /// Result of the forward search: scores of all candidates, generic hypotheses (unknown variations of a bias or
    /// scale), and detection limits.
    pub search: Search,
}

/// Estimated parameters of a rival, from a fit in which the rival replaces an accepted effect. A rival is an effect
/// that explains nearly the same residuals as the accepted effect.
#[derive(Clone, Debug)]
pub struct RivalFit {
    /// Name of the accepted effect.
    pub name: String,
    /// Name of the rival.
    pub rival: String,
    /// Estimated parameters of the rival; `None` if the fit with the rival fails.
    pub estimate: Option<TermEstimate>,
}

/// An estimated constant rate in the world frame that cannot be attributed to the Earth. Either its magnitude differs
/// from the Earth's rate, or the recordings do not determine its magnitude.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NotTheEarth {
    /// Magnitude of the estimated rate, rad/s.
    pub size_radps: f64,
    /// Standard deviation of the magnitude, rad/s.
    pub sigma_radps: f64,
}

/// Compares recordings of a unit with the sensor model without effects, identifies the effects that this model lacks,
/// and fits the model with these effects.
///
/// `control` are recordings that are used only for validation. Without control recordings, rests and moves are held out
/// in three folds.
///
/// # Errors
/// The errors of [`calibrate`](crate::calibrate::calibrate()), except that faults of the data are returned as the
/// verdict [`Verdict::DataFault`].
pub fn find_gap(
    recordings: &[Recording<'_>],
    control: &[Recording<'_>],
    options: &Options<'_>,
    gap_options: &GapOptions<'_>,
) -> Result<Gap, Error> {
    let refused = |faults| Ok(Gap { verdict: Verdict::DataFault, faults, analysis: None });
    // The progress function is called for the first fit here, because the checks and the computation of start values
    // below count as part of this fit.
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
    let (search, earth, accepted) = fits.search_and_accept(&before)?;
    let Accepted { path, fit: after, reference, mut refused } = accepted;
    let mut not_the_earth = None;
    match earth {
        Earth::Possible => {}
        Earth::NotFitted(error) => refused.push(Refusal::NotFitted { name: earth::NAME.into(), error }),
        Earth::Other(other) => not_the_earth = Some(other),
    }
    let basis = Basis {
        recordings: checked.recordings(),
        search: &search,
        path: &path,
        before: &before,
        reference: &reference,
        after: &after,
    };
    let judgement = basis.judge();
    let after = judgement.verdict.has_effects().then_some(after);
    let last = after.as_ref().unwrap_or(&before);
    let unseen = before.unseen_figure(last).ok_or_else(|| {
        Error::NotEnoughMotion("there are too few rests and moves for a held-out test: record more of both".into())
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
    let shares = if after.is_some() { fits.shares(&reference, &path)? } else { Vec::new() };
    let analysis = Analysis {
        before: Fit::clone(&before),
        after: after.map(|fit| Fit::clone(&fit)),
        effects,
        shares,
        rivals,
        refused,
        not_the_earth,
        not_confirmed: judgement.not_confirmed,
        contradiction: judgement.contradiction,
        remainder: judgement.remainder,
        unseen,
        chi2_of_given,
        residuals,
        corrected_errors,
        search,
    };
    Ok(Gap { verdict: judgement.verdict, faults: judgement.faults, analysis: Some(analysis) })
}

/// Result of the test whether the effect selected as `earth_rate` is the rate of the Earth.
enum Earth {
    /// The estimate is compatible with the Earth's rate, or `earth_rate` was not selected.
    Possible,
    /// The fit with `earth_rate` fails with this error message.
    NotFitted(String),
    /// The estimated magnitude differs from the Earth's rate, or is not determined by the recordings.
    Other(NotTheEarth),
}

impl Fits<'_> {
    /// Searches for effects, and validates the selected effects on unseen data. If an effect that is a function of time
    /// is refused, the forward search may have mistaken a random walk of the bias for this effect. The search is then
    /// repeated without the candidates of the same sensor that are functions of time.
    fn search_and_accept(&mut self, before: &Rc<Fit>) -> Result<(Search, Earth, Accepted), Error> {
        let mut choices = self.options.choices();
        let first = self.search(before, &choices, false)?;
        let (search, earth) = self.without_other_rates(before, &choices, first)?;
        let accepted = self.accept(before, &search)?;
        let refused: Vec<Refusal> = accepted.refused.iter().filter(|own| own.of_time().is_some()).cloned().collect();
        if refused.is_empty() {
            return Ok((search, earth, accepted));
        }
        let is_refused = |choice: &&EffectChoice| refused.iter().any(|own| own.of_time() == Some(choice.effect.name));
        let sensors: Vec<Sensor> = choices.iter().filter(is_refused).map(|choice| choice.effect.sensor).collect();
        choices.retain(|own| !(OF_TIME.contains(&own.effect.name) && sensors.contains(&own.effect.sensor)));
        let again = self.search_again(before, &choices, search)?;
        let (search, earth) = self.without_other_rates(before, &choices, again)?;
        let mut accepted = self.accept(before, &search)?;
        accepted.refused.extend(refused);
        Ok((search, earth, accepted))
    }

    /// Returns `search` if `earth_rate` is not selected or may be the Earth's rate. Otherwise, repeats the search
    /// without `earth_rate` and returns the new result.
    fn without_other_rates(
        &mut self,
        before: &Rc<Fit>,
        choices: &[EffectChoice],
        search: Search,
    ) -> Result<(Search, Earth), Error> {
        let earth = self.earth(&search)?;
        let is_named = search.path.iter().any(|score| score.name == earth::NAME);
        if matches!(earth, Earth::Possible) || !is_named {
            return Ok((search, earth));
        }
        let others: Vec<EffectChoice> =
            choices.iter().filter(|choice| choice.effect.name != earth::NAME).cloned().collect();
        Ok((self.search_again(before, &others, search)?, earth))
    }

    /// Repeats a search with fewer candidates. The scores of all candidates, and the detection limits of the removed
    /// candidates, are those of the first search. Hand motion is detected if the candidates cannot explain the
    /// residuals inside moves. If the first search detected hand motion, the test is not repeated, because fewer
    /// candidates cannot explain more of these residuals. Otherwise, the test is repeated.
    fn search_again(&mut self, before: &Fit, choices: &[EffectChoice], first: Search) -> Result<Search, Error> {
        let mut again = self.search(before, choices, first.is_hand_moved)?;
        let is_missing = |name: &str| again.smallest_visible.iter().all(|(own, ..)| own != name);
        let missing: Vec<_> = first.smallest_visible.into_iter().filter(|(name, ..)| is_missing(name)).collect();
        again.smallest_visible.extend(missing);
        Ok(Search { ranking: first.ranking, ..again })
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
        self.use_forms(&search.path);
        Ok(search)
    }

    /// Tests whether the rate estimated as the effect `earth_rate` has the known magnitude of the Earth's rate. The
    /// direction is not tested, because heading and latitude are unknown.
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

    /// chi2 per degree of freedom of the given calibration, of the fit `before` and of the fit `after`; `None` if no
    /// calibration was given.
    fn chi2_of_given(&self, before: &Fit, after: &Fit) -> Result<Option<[f64; 3]>, Error> {
        let Some(given) = &self.options.calibration else { return Ok(None) };
        let options = self.checked.options();
        let recordings = if self.control.is_empty() { self.checked.recordings() } else { self.control };
        let chi2 = |calibration: &Calibration<f64>, gravity_mps2: f64, corrected: Option<&[Recording<'_>]>| {
            let evaluation = judged(calibration, None, recordings, corrected, gravity_mps2, options.min_rest_s)?;
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

    /// Computes the residuals of the fit `before` by kind, rest and move, and compares them with those of the fit
    /// `after`. `inside_moves` is true if the moves rotate the unit without translation.
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

    /// Predicted rms errors of corrected signals, without and with the accepted effects.
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

    /// For each rival of an accepted effect, fits the model in which the rival replaces this effect.
    fn rivals(&mut self, path: &[String], rivals: &[Rivals]) -> Result<Vec<RivalFit>, Error> {
        let mut found = Vec::new();
        for Rivals { name, rivals } in rivals {
            for rival in rivals {
                let instead: Vec<String> =
                    path.iter().map(|other| if other == name { rival.clone() } else { other.clone() }).collect();
                let estimate = match self.with(&instead) {
                    Ok(fit) => fit.outcome.effects.iter().find(|own| own.name == *rival).cloned(),
                    Err(error @ Error::Caller(_)) => return Err(error),
                    // The fit with the rival failed, so the parameters of the rival are unknown.
                    Err(_) => None,
                };
                found.push(RivalFit { name: name.clone(), rival: rival.clone(), estimate });
            }
        }
        Ok(found)
    }
}

impl Fit {
    /// Magnitude of the rate `earth_rate` in this fit, and the standard deviation of the magnitude, rad/s. `None` if
    /// the model does not have this effect.
    fn earth_rate(&self) -> Option<NotTheEarth> {
        let TermEstimate { values, parameter_names, .. } =
            self.outcome.effects.iter().find(|effect| effect.name == earth::NAME)?;
        let first = self.outcome.names.iter().position(|name| parameter_names.first() == Some(name))?;
        let size_radps = values.iter().map(|value| value * value).sum::<f64>().sqrt();
        let term = |(i, j): (usize, usize)| values[i] * values[j] * self.outcome.covariance[first + i][first + j];
        let pairs = (0..values.len()).flat_map(|i| (0..values.len()).map(move |j| (i, j)));
        let variance = pairs.map(term).sum::<f64>() / (size_radps * size_radps);
        Some(NotTheEarth { size_radps, sigma_radps: variance.sqrt() })
    }
}
