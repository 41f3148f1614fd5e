//! Revises the selected effects: an alias may replace an effect, the forms of effects are selected, and superfluous
//! effects are removed. An alias of an effect is another effect that causes nearly the same residuals. The forms of an
//! effect have different numbers of parameters, for example a linear and a quadratic form.

use imucal_core::effects::Effect;

use super::Score;
use super::forward_search::{ForwardSearch, LEAST_WIDTH};
use super::score::Judged;
use super::stage::{Beside, Member, Stage};
use super::temperature_memory::{
    is_of_history, is_temperature_of_lag, largest_chance, log_prior_odds, log_prior_odds_of_member,
};
use crate::calibrate::EffectChoice;
use crate::error::Error;
use crate::joint::Prepared;
use crate::numerics::stats::p_value;

/// Threshold of differences in log posterior odds (log evidence + log prior odds), nats. A candidate is a rival of the
/// selected effect if its log posterior odds are smaller by less than this threshold. An alias (an effect that causes
/// nearly the same residuals) replaces an effect, and a form with more parameters replaces a form with fewer, if its
/// log posterior odds are larger by more than this threshold. 3 nats are odds of 20 to 1.
const RIVAL_NATS: f64 = 3.0;
/// Maximum p-value of an effect, from the likelihood ratio of the models with and without the effect. An effect with a
/// larger p-value is superfluous and is removed.
const SUPERFLUOUS: f64 = 1e-3;
/// A temperature lag is fitted a second time if the best trial value of its time constant and the estimate of this time
/// constant differ by more than a factor of 2: |ln(trial value / estimate)| > FAR. The second fit starts at the trial
/// value.
const FAR: f64 = 0.7;
/// If the largest log posterior odds (log Bayes factor + log prior odds) are above this number of nats, candidates are
/// compared by nonlinear fits instead of scores. The reason is that scores are computed from linearised residuals. For
/// such large effects, the linearisation errors of the scores exceed the differences between candidates.
const VERY_MUCH: f64 = 2000.0;
/// For the comparison by nonlinear fits (see [`VERY_MUCH`]), only candidates whose log posterior odds are above CLOSE x
/// the largest log posterior odds are fitted.
const CLOSE: f64 = 0.9;

impl Judged {
    /// The list of effects of a model that contains the effects `members` and this candidate.
    pub(super) fn beside(&self, members: &[Member]) -> Vec<Member> {
        let own = Member {
            name: self.score.name.clone(),
            parameters: self.score.parameters,
            width: self.width,
            shape: self.shape,
            values: Vec::new(),
        };
        members.iter().cloned().chain([own]).collect()
    }
}

/// A model in which an alias replaces an effect.
struct Replacement {
    effect: &'static Effect<f64>,
    /// Increase of the log evidence by the replacement, nats.
    gain: f64,
    /// Increase of the log posterior odds by the replacement, nats: `gain` + log prior odds of the alias - log prior
    /// odds of the replaced effect.
    odds: f64,
    /// Decrease of the deviance (-2 ln of the maximum likelihood) by the replacement.
    statistic: f64,
    found: Stage,
}

impl ForwardSearch<'_> {
    /// The candidate with the largest posterior odds (Bayes factor x prior odds) among the candidates that satisfy
    /// `good`, and the names of its rivals (candidates with nearly the same posterior odds).
    ///
    /// If the largest log posterior odds exceed [`VERY_MUCH`], all candidates whose log posterior odds are above
    /// [`CLOSE`] x the largest ones are fitted. The candidate whose fit has the largest posterior odds is then
    /// returned.
    pub(super) fn best<'j>(
        &self,
        prepared: &Prepared<'_>,
        open: &[EffectChoice],
        stage: &Stage,
        scores: &'j [Judged],
        good: impl Fn(&Judged) -> bool,
    ) -> Option<(&'j Judged, Vec<String>)> {
        let prior = |judged: &Judged| log_prior_odds(&judged.score.name);
        let posterior = |judged: &'j Judged| (judged, judged.score.log_bayes_factor + prior(judged));
        let evidence: Vec<(&Judged, f64)> = scores.iter().map(posterior).filter(|(_, log)| *log > 0.0).collect();
        let may_lead = |of: &[(&'j Judged, f64)]| {
            of.iter().filter(|(judged, _)| good(judged)).max_by(|a, b| a.1.total_cmp(&b.1)).copied()
        };
        let (first, most) = may_lead(&evidence)?;
        let near = [&stage.model.accelerometer, &stage.model.gyroscope];
        let fitted = |judged: &'j Judged| {
            let members = judged.beside(&stage.members);
            let found = self.stage(prepared, near, open, &members, Beside::Nothing).ok()?;
            Some((judged, found.evidence.log + prior(judged)))
        };
        let close = evidence.iter().filter(|(judged, log)| *log > CLOSE * most && good(judged));
        let close: Vec<&Judged> = close.map(|(judged, _)| *judged).collect();
        let fits: Vec<(&Judged, f64)> = if most < VERY_MUCH || close.len() < 2 {
            Vec::new()
        } else {
            close.into_iter().filter_map(fitted).collect()
        };
        let (contenders, (pick, most)) = match may_lead(&fits) {
            Some(best) => (fits, best),
            None => (evidence, (first, most)),
        };
        let is_rival = |(other, log): &&(&Judged, f64)| other.score.name != pick.score.name && *log > most - RIVAL_NATS;
        let rivals = contenders.iter().filter(is_rival).map(|(other, _)| other.score.name.clone()).collect();
        Some((pick, rivals))
    }

    /// Replaces an effect by an alias if the log posterior odds (log evidence + log prior odds) of the alias are larger
    /// by more than [`RIVAL_NATS`]. An alias of an effect is another effect that causes nearly the same residuals. Two
    /// kinds of aliases are fitted and compared. Aliases with a time constant are compared because their scores refer
    /// to only a few trial time constants. Effects of the temperature history (lag, rate and hysteresis) are compared
    /// with each other because the evidence of each of them changes when the temperature effect is added. Aliases whose
    /// log posterior odds are smaller than the largest ones by less than [`RIVAL_NATS`] become rivals. A temperature
    /// lag is also fitted from a second start value of its time constant, because the best time constant may change
    /// when effects are added after the lag. If a temperature lag is not distinguishable from an effect of the rate of
    /// change of temperature (see [`Stage::is_unresolved_lag`]), its time constant is not observable. The alias with
    /// the largest posterior odds then replaces the lag, even if the odds of the lag are larger. Returns whether an
    /// effect was replaced.
    pub(super) fn swap(
        &self,
        prepared: &Prepared<'_>,
        open: &[EffectChoice],
        stage: &mut Stage,
        path: &mut [Score],
    ) -> Result<bool, Error> {
        let mut swapped = false;
        let is_alias = |a: &Effect<f64>, b: &Effect<f64>| a.aliases.iter().any(|alias| alias.with == b.name);
        for k in 0..stage.members.len() {
            let name = stage.members[k].name.clone();
            let Some(own) = open.iter().find(|choice| choice.effect.name == name) else { continue };
            let lag_s = match is_of_history(own.effect) {
                true => self.best_lag_s(prepared, open, stage, k),
                false => None,
            };
            let is_far =
                |lag_s: f64| stage.members[k].values.last().is_some_and(|tau_s| (lag_s / tau_s).ln().abs() > FAR);
            let is_again = |other: &Effect<f64>| {
                other.name == own.effect.name && other.shape.is_some() && lag_s.is_some_and(is_far)
            };
            let is_other = |choice: &&EffectChoice| {
                let other = choice.effect;
                is_again(other)
                    || (is_of_history(own.effect) || (other.shape.is_some() && !is_of_history(other)))
                        && (is_alias(other, own.effect) || is_alias(own.effect, other))
                        && !stage.members.iter().any(|member| member.name == other.name)
            };
            let others = open.iter().filter(is_other);
            let replacements: Vec<Replacement> = others
                .filter_map(|other| self.replacement(prepared, open, stage, (k, own.effect, other.effect, lag_s)))
                .collect();
            let Some(score) = path.iter_mut().find(|score| score.name == name) else { continue };
            let all_odds: Vec<(String, f64)> =
                replacements.iter().map(|own| (own.effect.name.to_owned(), own.odds)).collect();
            let best = replacements.into_iter().max_by(|a, b| a.odds.total_cmp(&b.odds));
            let mut most = 0.0;
            let is_unresolved = stage.is_unresolved_lag(k);
            let is_better = |own: &Replacement| own.odds > RIVAL_NATS || is_unresolved;
            if let Some(Replacement { effect, gain, odds, statistic, found }) = best.filter(is_better) {
                let parameters = found.members[k].parameters;
                let statistic = score.statistic + statistic;
                *score = Score {
                    name: effect.name.to_owned(),
                    log_bayes_factor: score.log_bayes_factor + gain,
                    statistic,
                    parameters,
                    dof: parameters,
                    p_value: p_value(statistic, parameters + usize::from(effect.shape.is_some())),
                    rivals: Vec::new(),
                };
                most = odds;
                *stage = found;
                swapped = true;
            }
            for (other, odds) in all_odds {
                if odds > most - RIVAL_NATS && other != score.name && !score.rivals.contains(&other) {
                    score.rivals.push(other);
                }
            }
        }
        Ok(swapped)
    }

    /// The fit of the model in which the effect `other` replaces the effect `own`. `k` is the index of `own` among the
    /// effects of the model. The fit of a temperature lag starts at the time constant `lag_s`. If `own` is an effect of
    /// the temperature history, the form of `other` with the largest evidence is used, up to the number of parameters
    /// of `own`.
    fn replacement(
        &self,
        prepared: &Prepared<'_>,
        open: &[EffectChoice],
        stage: &Stage,
        (k, own, other, lag_s): (usize, &Effect<f64>, &'static Effect<f64>, Option<f64>),
    ) -> Option<Replacement> {
        let of_form = |parameters: usize| {
            let near = [&stage.model.accelerometer, &stage.model.gyroscope];
            let typical = &other.parameters[..parameters];
            let mut members = stage.members.clone();
            let shape = lag_s.filter(|_| other.shape.is_some());
            members[k] = Member { parameters, shape, ..Member::plain(other) };
            // The first fit determines the size of the alias. In the second fit, this size is the width of the alias's
            // prior.
            let mut fit = || {
                let found = self.stage(prepared, near, open, &members, Beside::Nothing).ok()?;
                let sizes = found.members[k].values.iter().zip(typical).map(|(v, p)| (v / p.typical).powi(2));
                members.clone_from(&found.members);
                members[k].width = (sizes.sum::<f64>() / typical.len() as f64).sqrt().max(LEAST_WIDTH);
                Some(found)
            };
            let found = fit().and_then(|_| fit()).filter(|found| !found.is_unresolved_lag(k))?;
            let at_best = if is_of_history(own) {
                found.evidence.clone()
            } else {
                // For the comparison, the time constant of the alias is kept fixed, because all candidates are scored
                // at fixed time constants.
                let shape = found.place(other.name).map_or(0, |place| place.end - 1);
                let mut columns = found.design.model.clone();
                columns.remove(shape);
                found.design.gram.evidence(&columns)?
            };
            let gain = at_best.log - stage.evidence.log;
            let odds = gain + log_prior_odds(other.name) - log_prior_odds_of_member(&stage.members, k);
            Some(Replacement {
                effect: other,
                gain,
                odds,
                statistic: stage.evidence.deviance - at_best.deviance,
                found,
            })
        };
        let most = if is_of_history(own) { stage.members[k].parameters } else { other.plain };
        let forms = (1..=most).filter(|count| other.has_form(*count));
        forms.filter_map(of_form).max_by(|a, b| a.gain.total_cmp(&b.gain))
    }

    /// Selects the form of each effect in the model that has several forms, such as the degree of a temperature effect.
    /// A form with more parameters is selected if its log evidence is larger by more than [`RIVAL_NATS`]. The selection
    /// is repeated whenever an effect has been added to the model, because another form may then have the largest
    /// evidence. Returns whether a form was changed.
    pub(super) fn choose_forms(
        &self,
        prepared: &Prepared<'_>,
        open: &[EffectChoice],
        stage: &mut Stage,
        path: &mut [Score],
    ) -> Result<bool, Error> {
        let mut changed = false;
        for k in 0..stage.members.len() {
            let own = stage.members[k].clone();
            let Some(choice) = open.iter().find(|choice| choice.effect.name == own.name) else { continue };
            let forms = (1..=choice.parameters).filter(|count| choice.effect.has_form(*count));
            for parameters in forms.filter(|count| *count != own.parameters) {
                let mut members = stage.members.clone();
                // The new fit starts at the estimate of the time constant.
                let shape = own.shape.map(|shape| own.values.last().copied().unwrap_or(shape));
                members[k] = Member { parameters, shape, values: Vec::new(), ..own.clone() };
                let near = [&stage.model.accelerometer, &stage.model.gyroscope];
                let Ok(found) = self.stage(prepared, near, open, &members, Beside::Nothing) else { continue };
                let more = if parameters > stage.members[k].parameters { RIVAL_NATS } else { 0.0 };
                if found.evidence.log <= stage.evidence.log + more {
                    continue;
                }
                if let Some(score) = path.iter_mut().find(|score| score.name == own.name) {
                    score.log_bayes_factor += found.evidence.log - stage.evidence.log;
                    score.statistic += stage.evidence.deviance - found.evidence.deviance;
                    (score.parameters, score.dof) = (parameters, parameters);
                    score.p_value = p_value(score.statistic.max(0.0), parameters);
                }
                *stage = found;
                changed = true;
            }
        }
        Ok(changed)
    }

    /// Removes effects whose removal does not reduce the posterior odds of the model, or does not reduce the likelihood
    /// significantly. For example, an effect that resembles the sum of two other effects may be selected first. It is
    /// superfluous when both other effects have been selected. The temperature effect of a bias is kept if the model
    /// contains the temperature lag of the same bias. Returns whether an effect was removed.
    pub(super) fn eliminate(
        &self,
        prepared: &Prepared<'_>,
        open: &[EffectChoice],
        stage: &mut Stage,
        path: &mut Vec<Score>,
    ) -> Result<bool, Error> {
        let before = stage.members.len();
        while stage.members.len() > 1 {
            let mut worst: Option<(usize, Stage)> = None;
            for k in 0..stage.members.len() {
                let names = stage.members.iter().map(|member| &member.name);
                if is_temperature_of_lag(&stage.members[k].name, names) {
                    continue;
                }
                let mut members = stage.members.clone();
                members.remove(k);
                let near = [&stage.model.accelerometer, &stage.model.gyroscope];
                let Ok(without) = self.stage(prepared, near, open, &members, Beside::Nothing) else { continue };
                let dof = stage.place(&stage.members[k].name).map_or(1, |place| place.len());
                let chance = p_value(without.evidence.deviance - stage.evidence.deviance, dof);
                let odds = stage.evidence.log - without.evidence.log + log_prior_odds_of_member(&stage.members, k);
                if (odds <= 0.0 || chance > largest_chance(&stage.members, k, SUPERFLUOUS))
                    && worst.as_ref().is_none_or(|(_, best)| without.evidence.log > best.evidence.log)
                {
                    worst = Some((k, without));
                }
            }
            let Some((k, without)) = worst else { break };
            path.retain(|score| score.name != stage.members[k].name);
            *stage = without;
        }
        Ok(stage.members.len() < before)
    }
}
