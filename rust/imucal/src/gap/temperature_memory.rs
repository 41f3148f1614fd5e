//! Special steps of the forward search for effects of the temperature history (past temperatures).
//!
//! A bias with a memory of the temperature (lag, rate or hysteresis) usually depends on the present temperature as
//! well, so two effects describe it. The effects of the temperature and of the temperature history on the same bias are
//! called partners. A fit with only one of the two partners may give a wrong time constant, favour a wrong effect, or
//! fail the cross-validation.

use imucal_core::effects::{Effect, Need};
use imucal_core::temperature_memory::SMOOTHING_S;

use super::Score;
use super::detect::FALSE_ALARM;
use super::forward_search::ForwardSearch;
use super::score::{Judged, gain, judge};
use super::stage::{Beside, Member, Stage};
use crate::calibrate::EffectChoice;
use crate::joint::Prepared;

/// Log prior odds, nats. They are -PRIOR_NATS for an effect of the temperature history and 0 for other effects. If the
/// temperature-history effect of a bias is in the model, the log prior odds of the temperature effect of the same bias
/// are +PRIOR_NATS. 3 nats are odds of 20 to 1.
const PRIOR_NATS: f64 = 3.0;
/// Maximum p-value of a bias's temperature effect if the temperature-history effect of the same bias is in the model.
/// The limit is larger than for other effects, because the estimated time constant of a lag would be wrong without the
/// temperature effect.
const PARTNER_CHANCE: f64 = 0.01;
/// Delay, s, of the rate of change of temperature in effects of the catalogue. Two low-pass filters in series smooth
/// this rate, and each filter delays the rate by one time constant.
const RATE_DELAY_S: f64 = 2.0 * SMOOTHING_S;
/// A lag is distinguishable from an effect of the rate of change of temperature only if the estimated time constant of
/// the lag exceeds [`RATE_DELAY_S`] by this number of standard deviations.
const RESOLVED: f64 = 2.0;

pub(super) fn is_of_history(effect: &Effect<f64>) -> bool {
    effect.has_need(Need::TemperatureHistory)
}

fn is_lag(effect: &Effect<f64>) -> bool {
    is_of_history(effect) && effect.shape.is_some()
}

fn is_bias_of_temperature(effect: &Effect<f64>) -> bool {
    effect.has_need(Need::Temperature) && !is_of_history(effect) && effect.reads.is_empty()
}

fn are_partners(a: &Effect<f64>, b: &Effect<f64>) -> bool {
    let is_pair = |a, b| is_of_history(a) && is_bias_of_temperature(b);
    a.sensor == b.sensor && (is_pair(a, b) || is_pair(b, a))
}

/// Log prior odds of an effect, nats. An effect of the temperature history needs a larger evidence than an effect
/// without memory, because a long temperature lag causes nearly the same errors as the temperature itself.
pub(super) fn log_prior_odds(name: &str) -> f64 {
    if Effect::find(name).is_some_and(is_of_history) { -PRIOR_NATS } else { 0.0 }
}

/// Log prior odds, nats, of the effect `members[k]` in a model with all effects in `members`.
pub(super) fn log_prior_odds_of_member(members: &[Member], k: usize) -> f64 {
    if is_temperature_of_history(members, k) { PRIOR_NATS } else { log_prior_odds(&members[k].name) }
}

/// Maximum p-value at which the effect `members[k]` stays in a model with all effects in `members`. It is
/// [`PARTNER_CHANCE`] for the temperature effect of a bias if `members` contains the temperature-history effect of the
/// same bias, and `usual` otherwise.
pub(super) fn largest_chance(members: &[Member], k: usize, usual: f64) -> f64 {
    if is_temperature_of_history(members, k) { PARTNER_CHANCE } else { usual }
}

/// Whether `members[k]` is the temperature effect of a bias, and `members` also contains the temperature-history effect
/// of the same bias.
fn is_temperature_of_history(members: &[Member], k: usize) -> bool {
    has_partner(&members[k].name, members.iter().map(|member| &member.name), is_of_history)
}

/// Whether `name` is the temperature effect of a bias whose lag is among `names`. Without the temperature effect, the
/// time constant of the lag is biased and its standard deviation is too small. The temperature effect therefore stays
/// in the model even if it is not significant.
pub(super) fn is_temperature_of_lag<'n>(name: &str, names: impl Iterator<Item = &'n String>) -> bool {
    has_partner(name, names, is_lag)
}

/// Whether `name` is the temperature effect of a bias, and `names` contains a partner of this effect (a
/// temperature-history effect of the same bias) for which `counts` is true.
fn has_partner<'n>(name: &str, names: impl Iterator<Item = &'n String>, counts: fn(&Effect<f64>) -> bool) -> bool {
    let own = Effect::<f64>::find(name).filter(|own| is_bias_of_temperature(own));
    let mut others = names.filter_map(|other| Effect::find(other)).filter(|other| counts(other));
    own.is_some_and(|own| others.any(|other| are_partners(own, other)))
}

impl Stage {
    /// Whether the effect `members[k]` is a temperature lag whose time constant tau does not significantly exceed
    /// [`RATE_DELAY_S`]. A lag with the coefficient k is the error `k (T_tau - T)`, where T_tau is the temperature T
    /// after a low-pass with the time constant tau. For a short tau, this error nearly equals `-k tau dT/dt`, an effect
    /// of the rate of change of temperature. The recordings then determine only the product k tau, and not k and tau
    /// separately.
    pub(super) fn is_unresolved_lag(&self, k: usize) -> bool {
        let Member { name, values, .. } = &self.members[k];
        let place = self.place(name).filter(|_| Effect::find(name).is_some_and(is_lag));
        let (Some(place), Some(tau_s)) = (place, values.last()) else { return false };
        let covariance = self.design.gram.covariance(&self.design.model, &self.evidence.scales, &[place.end - 1]);
        covariance.is_none_or(|own| tau_s - RESOLVED * own[(0, 0)].sqrt() < RATE_DELAY_S)
    }
}

impl ForwardSearch<'_> {
    /// The temperature effect of a bias, with its score, if the temperature-history effect of the same bias is in the
    /// model. `None` if the temperature effect is already in the model. If the temperature-history effect is a lag, the
    /// temperature effect is always returned. Otherwise (rate or hysteresis), it is returned only if it is significant
    /// and no other candidate has larger posterior odds (Bayes factor x prior odds, see [`PRIOR_NATS`]).
    pub(super) fn temperature_of_history(&self, stage: &Stage) -> Option<(Judged, Score)> {
        let find = |name: &str| Effect::<f64>::find(name);
        let histories: Vec<_> =
            stage.members.iter().filter_map(|member| find(&member.name)).filter(|own| is_of_history(own)).collect();
        if histories.is_empty() {
            return None;
        }
        let mut scores = judge(stage).scores;
        let limit = FALSE_ALARM / scores.len().max(1) as f64;
        let is_own = |judged: &Judged| {
            let own = find(&judged.score.name).filter(|own| is_bias_of_temperature(own));
            own.is_some_and(|own| histories.iter().any(|history| are_partners(own, history)))
        };
        let own = scores.swap_remove(scores.iter().position(is_own)?);
        let log = own.score.log_bayes_factor + PRIOR_NATS;
        let by = |other: &Judged| other.score.log_bayes_factor + log_prior_odds(&other.score.name) - log;
        let is_supported =
            log > 0.0 && own.score.p_value < PARTNER_CHANCE && !scores.iter().any(|other| by(other) > 0.0);
        if !is_supported && !is_temperature_of_lag(&own.score.name, stage.members.iter().map(|member| &member.name)) {
            return None;
        }
        let is_rival = |other: &&Judged| is_supported && by(other) > -PRIOR_NATS && other.score.p_value < limit;
        let rivals = scores.iter().filter(is_rival).map(|other| other.score.name.clone()).collect();
        let score = Score { rivals, ..own.score.clone() };
        Some((own, score))
    }

    /// Adds the candidate `pick` to the model. Returns `None` if `pick` does not increase the evidence, or if no
    /// partner of `pick` is significant in the new model and improves the prediction of held-out data. Partners are the
    /// temperature effect and a temperature-history effect of the same bias.
    pub(super) fn with_partner(
        &self,
        prepared: &Prepared<'_>,
        open: &[EffectChoice],
        stage: &Stage,
        pick: &Judged,
    ) -> Option<Stage> {
        let picked =
            Effect::<f64>::find(&pick.score.name).filter(|own| is_of_history(own) || is_bias_of_temperature(own))?;
        let near = [&stage.model.accelerometer, &stage.model.gyroscope];
        let next = self.stage(prepared, near, open, &pick.beside(&stage.members), Beside::Candidates).ok()?;
        let scores = judge(&next).scores;
        let limit = FALSE_ALARM / scores.len().max(1) as f64;
        let is_partner = |judged: &&Judged| {
            let other = Effect::<f64>::find(&judged.score.name);
            judged.score.p_value < limit && other.is_some_and(|other| are_partners(picked, other))
        };
        let partners = scores.iter().filter(is_partner);
        let best = partners.max_by(|a, b| a.score.log_bayes_factor.total_cmp(&b.score.log_bayes_factor))?;
        let is_predictive = gain(&next, best).is_none_or(|gain| gain.is_sure());
        (is_predictive && next.evidence.log > stage.evidence.log).then_some(next)
    }

    /// For a temperature lag on the sensor of effect `k` of the model: the trial time constant with the largest
    /// evidence, s. The lag is scored as an addition to the model without effect `k`.
    pub(super) fn best_lag_s(
        &self,
        prepared: &Prepared<'_>,
        open: &[EffectChoice],
        stage: &Stage,
        k: usize,
    ) -> Option<f64> {
        let sensor = Effect::<f64>::find(&stage.members[k].name)?.sensor;
        let mut members = stage.members.clone();
        members.remove(k);
        let near = [&stage.model.accelerometer, &stage.model.gyroscope];
        let without = self.stage(prepared, near, open, &members, Beside::Candidates).ok()?;
        let is_own_lag = |judged: &Judged| {
            let own = Effect::<f64>::find(&judged.score.name);
            own.is_some_and(|own| is_lag(own) && own.sensor == sensor)
        };
        judge(&without).scores.into_iter().find(is_own_lag)?.shape
    }
}
