//! Decides which effects of the forward search are accepted, by validation on unseen data: control recordings, or
//! held-out rests and moves.

use std::rc::Rc;

use imucal_core::effects::{Effect, Need, Sensor};
use nalgebra::{DMatrix, DVector};

use super::Score;
use super::fits::{Control, Fit, Fits};
use super::forward_search::OF_TIME;
use super::temperature_memory::is_temperature_of_lag;
use crate::error::Error;
use crate::joint::is_unobservable_hand_held;
use crate::numerics::stats::p_value;
use crate::verdict::{GroupMisfit, ResidualGroup};

/// If an effect increases chi2 per degree of freedom of unseen data by at most this fraction, the prediction does not
/// count as worse.
const SAME: f64 = 0.005;
/// The prediction of unseen data counts as worse if chi2 per degree of freedom increases by more than this fraction. A
/// smaller increase counts only if it is significant (see [`SIGNIFICANT`]). If the unseen data contain few rests and
/// moves, parameter errors can cause a larger increase. [`SIGNIFICANT`] standard deviations of the increase that
/// parameter errors cause are then the threshold instead.
const MAY_BE_CHANCE: f64 = 0.1;
/// An effect with a log Bayes factor below this number of nats is accepted only if it improves the prediction of unseen
/// data. 8 nats are odds of 3000 to 1.
const CERTAIN_NATS: f64 = 8.0;
/// A prediction of unseen data counts as improved if its chi2 decreases by more than this number of standard deviations
/// of the decrease. The threshold applies only to effects with a log Bayes factor below [`CERTAIN_NATS`], and to
/// effects that are functions of time.
const LEAST_IMPROVEMENT: f64 = 0.5;
/// Threshold that replaces [`LEAST_IMPROVEMENT`] if the fits use additional residuals (stand angles, or specific force
/// inside moves) that their effects do not require. It is compared with the decrease of chi2 of all unseen residuals
/// together, in standard deviations of this decrease. It is larger than [`LEAST_IMPROVEMENT`], because an effect may
/// fit errors of the stand in the additional residuals.
const LEAST_IMPROVEMENT_BY_MORE: f64 = 1.0;
/// The share [`EffectShare::closed`] = decrease of chi2 / excess of chi2 over noise is computed only if chi2 of unseen
/// data without effects exceeds this multiple of its expected value. At smaller multiples, the excess is too small to
/// be used as a divisor.
const LEAST_EXCESS: f64 = 1.5;
/// Maximum p-value of the parameters of an effect in the final fit, under the hypothesis that they are zero. An effect
/// with a larger p-value is removed. A p-value of 1 % corresponds to 2.6 standard deviations of one parameter.
const LEAST_SIGNIFICANT: f64 = 0.01;
/// An increase of chi2 of unseen data is significant if it exceeds this number of standard deviations of the increase
/// under the null hypothesis that the fits with and without the effect predict equally well.
const SIGNIFICANT: f64 = 3.0;

/// A figure of merit on unseen data (control recordings, or held-out rests and moves).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnseenFigure {
    /// The quantity that measures the quality of the prediction.
    pub metric: Metric,
    /// Value of `metric` without effects, in its unit.
    pub before: f64,
    /// Value of `metric` with the accepted effects, in its unit.
    pub after: f64,
    /// Expected value of `metric` if sensor noise is the only error, in its unit.
    pub floor: f64,
}

/// A quantity that measures how well unseen data are predicted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Metric {
    /// chi2 per degree of freedom of control recordings, dimensionless.
    Chi2PerDof,
    /// Rms angle between predicted and measured gravity direction after held-out moves, deg.
    HeldOutDirection,
    /// Rms of `|f| - g` at held-out rests, m/s^2; f: specific force, g: local gravity.
    HeldOutNorm,
}

impl Metric {
    /// Name of the metric in JSON documents.
    pub fn name(self) -> &'static str {
        match self {
            Self::Chi2PerDof => "chi2_per_dof",
            Self::HeldOutDirection => "held_out_gravity_direction_rms_deg",
            Self::HeldOutNorm => "held_out_gravity_norm_rms_mps2",
        }
    }
}

/// An effect that the forward search selected and that was not accepted, with the reason.
#[derive(Clone, Debug, PartialEq)]
pub enum Refusal {
    /// The fit with the effect fails.
    NotFitted {
        /// Name of the effect.
        name: String,
        /// Error message of the fit.
        error: String,
    },
    /// Unseen data are predicted worse with the effect than without it. The variant is also used if the effect does not
    /// improve the prediction although an improvement is required. An improvement is required of effects with little
    /// evidence (a small log Bayes factor) and of effects that are functions of time.
    PredictsWorse {
        /// Name of the effect.
        name: String,
        /// chi2 per degree of freedom of unseen data without the effect.
        before: f64,
        /// chi2 per degree of freedom of unseen data with the effect.
        after: f64,
    },
    /// The parameters of the effect do not differ significantly from zero in the fit with all accepted effects.
    NotSignificant {
        /// Name of the effect.
        name: String,
        /// p-value of the effect's parameters under the hypothesis that they are zero.
        p_value: f64,
    },
    /// The effect `gyro_time_offset` (delay of the gyroscope) is not accepted, because a filter not only delays but
    /// also smooths the output of the gyroscope.
    NotOnlyDelayed {
        /// Name of the effect.
        name: String,
        /// Mean delay of the filter, weighted by the impulse response of the filter, s.
        tau_s: f64,
        /// Half of the variance of the delay, weighted by the impulse response of the filter, s^2; zero for a pure
        /// delay.
        k_s2: f64,
        /// Standard deviation of `k_s2`, s^2.
        k_sigma_s2: f64,
    },
}

impl Refusal {
    /// Name of the refused effect if it is a function of time and was refused because unseen data or the final fit do
    /// not confirm it; otherwise `None`.
    pub(super) fn of_time(&self) -> Option<&str> {
        match self {
            Self::PredictsWorse { name, .. } | Self::NotSignificant { name, .. }
                if OF_TIME.contains(&name.as_str()) =>
            {
                Some(name)
            }
            _ => None,
        }
    }

    /// Whether the effect may have been refused because the residuals of the fit hardly determine its parameters.
    pub(super) fn may_be_undetermined(&self) -> bool {
        matches!(self, Self::PredictsWorse { .. } | Self::NotSignificant { .. })
    }
}

/// Share of the excess chi2 (chi2 beyond noise) of unseen data that one accepted effect removes, for each kind of
/// residuals.
#[derive(Clone, Debug, PartialEq)]
pub struct EffectShare {
    /// Name of the effect.
    pub name: String,
    /// Share of the excess chi2 that this effect removes: decrease / excess, for each kind of unseen residual. The
    /// excess is chi2 without effects minus its expected value from noise. The decrease of chi2 is that caused by
    /// adding this effect to the effects accepted before it. The three kinds are norms of the specific force at rest,
    /// gravity directions after moves, and mean angular rates at rest. `None` if the kind is not evaluated, or if its
    /// chi2 in the fit without effects is below 1.5 times the expected value.
    pub closed: [Option<f64>; 3],
}

/// Decrease of chi2 of unseen data when effects are added to the model.
pub(super) struct Removed {
    /// Relative decrease: decrease of chi2 / chi2 without the effects, at most 1. It is the largest value over the
    /// kinds of residuals.
    pub(super) share: f64,
    /// Decrease of chi2 in standard deviations of the decrease. It is the largest value over the kinds of residuals.
    pub(super) significance: f64,
    /// Decrease of chi2 of all kinds of residuals together, in standard deviations of this decrease.
    significance_of_all: f64,
}

/// The accepted effects.
pub(super) struct Accepted {
    pub(super) path: Vec<String>,
    /// The fit with the accepted effects.
    pub(super) fit: Rc<Fit>,
    /// The fit without effects that uses the same kinds of residuals as `fit`.
    pub(super) reference: Rc<Fit>,
    pub(super) refused: Vec<Refusal>,
}

impl Fits<'_> {
    /// Tries the selected effects in order of selection. An effect is accepted if it does not make the prediction of
    /// unseen data worse. Effects with little evidence (see [`CERTAIN_NATS`]), and effects that are functions of time,
    /// must also improve the prediction. If the model with all selected effects predicts unseen data better than the
    /// model with the accepted effects, all selected effects are accepted.
    ///
    /// `before` is the first fit without effects, and `reference` the fit without effects that uses the same kinds of
    /// residuals as the fits with effects. If these fits use more kinds of residuals than `before`, effects with much
    /// evidence must also improve the prediction of unseen data, and the model with all selected effects is not tried.
    pub(super) fn accept_selected(
        &mut self,
        before: &Rc<Fit>,
        reference: &Rc<Fit>,
        selected: &[Score],
    ) -> Result<Accepted, Error> {
        let path: Vec<String> = selected.iter().map(|score| score.name.clone()).collect();
        let path = path.as_slice();
        let has_more_residuals = self.kinds != before.kinds;
        let must_improve = |name: &String| {
            let effect = Effect::<f64>::find(name);
            // Effects of the stand, and effects that act only inside moves, hardly change the residuals at rests and
            // the residuals of gravity directions after moves. Such effects are therefore not required to improve the
            // prediction of these residuals.
            let is_of_rests =
                effect.is_none_or(|own| own.sensor != Sensor::Encoder) && !is_unobservable_hand_held(name);
            is_of_rests
                && !is_temperature_of_lag(name, path.iter())
                && (has_more_residuals
                    || selected.iter().any(|score| score.name == *name && score.log_bayes_factor < CERTAIN_NATS))
        };
        let mut accepted = Accepted {
            path: Vec::new(),
            fit: Rc::clone(reference),
            reference: Rc::clone(reference),
            refused: Vec::new(),
        };
        for name in path {
            let names = [accepted.path.as_slice(), std::slice::from_ref(name)].concat();
            let fit = match unless_it_fails(self.with(&names))? {
                Ok(fit) => fit,
                Err(error) => {
                    accepted.refused.push(Refusal::NotFitted { name: name.clone(), error });
                    // If the fit with an effect fails, the effects selected after it are not tried. They were selected
                    // from the residuals of a model that contains the failed effect. In a model without the failed
                    // effect, they could fit the residuals that the failed effect causes.
                    break;
                }
            };
            let removed = fit.removed(&accepted.fit);
            let is_confirmed = match OF_TIME.contains(&name.as_str()) {
                // A random walk of the bias in one recording may resemble a function of time so closely that the
                // evidence for this function is large. In unseen data, the random walk takes another course, and the
                // function of time does not improve the prediction. An improvement is therefore required, however large
                // the evidence is.
                true => removed.significance_of_all > LEAST_IMPROVEMENT,
                false if has_more_residuals => {
                    !must_improve(name) || removed.significance_of_all > LEAST_IMPROVEMENT_BY_MORE
                }
                false => !must_improve(name) || removed.significance > LEAST_IMPROVEMENT,
            };
            if fit.is_worse_than(&accepted.fit, before, needs_heading(name)) || !is_confirmed {
                let [after, before] = [&fit, &accepted.fit].map(|fit| fit.unseen_chi2(before));
                accepted.refused.push(Refusal::PredictsWorse { name: name.clone(), before, after });
                continue;
            }
            accepted.path.push(name.clone());
            accepted.fit = fit;
        }
        // Effects that do not improve the prediction when they are added one by one may improve it together.
        if accepted.path.len() < path.len()
            && !has_more_residuals
            && let Ok(fit) = unless_it_fails(self.with(path))?
            && fit.unseen_chi2(before) < accepted.fit.unseen_chi2(before)
            && (!accepted.refused.iter().any(|own| own.of_time().is_some())
                || fit.removed(&accepted.fit).significance_of_all > LEAST_IMPROVEMENT)
        {
            accepted = Accepted { path: path.to_vec(), fit, refused: Vec::new(), ..accepted };
        }
        let accepted = self.significant(accepted)?;
        self.without_smoothing(accepted)
    }

    /// Computes, for each accepted effect, the share of the excess chi2 (chi2 beyond noise) of unseen data that this
    /// effect removes. Fits that were made when the effects were accepted are reused.
    pub(super) fn shares(&mut self, before: &Rc<Fit>, path: &[String]) -> Result<Vec<EffectShare>, Error> {
        let sums = |fit: &Fit| fit.unseen_items().map(|items| items.into_iter().flatten().sum::<f64>());
        let counts = before.unseen_items().map(|items| items.into_iter().flatten().count());
        let (whole, mut last) = (sums(before), sums(before));
        let mut shares = Vec::new();
        for end in 1..=path.len() {
            let Ok(fit) = unless_it_fails(self.with(&path[..end]))? else { continue };
            let own = sums(&fit);
            let closed = std::array::from_fn(|kind| {
                let noise = ([1, 2, 3][kind] * counts[kind]) as f64;
                (whole[kind] > LEAST_EXCESS * noise && noise > 0.0)
                    .then(|| (last[kind] - own[kind]) / (whole[kind] - noise))
            });
            shares.push(EffectShare { name: path[end - 1].clone(), closed });
            last = own;
        }
        Ok(shares)
    }

    /// Removes, one after the other, accepted effects whose parameters do not differ significantly from zero. The
    /// temperature effect of a bias is kept if the temperature lag of the same bias (a delayed response of the bias to
    /// temperature) is accepted. Without the temperature effect, the estimated time constant of the lag would be
    /// biased.
    fn significant(&mut self, mut accepted: Accepted) -> Result<Accepted, Error> {
        loop {
            let tested = accepted.path.iter().filter(|name| !is_temperature_of_lag(name, accepted.path.iter()));
            let chances = tested.filter_map(|name| Some((name.clone(), accepted.fit.chance_of(name)?)));
            let least = chances.max_by(|a, b| a.1.total_cmp(&b.1)).filter(|(_, chance)| *chance > LEAST_SIGNIFICANT);
            let Some((name, p_value)) = least else { return Ok(accepted) };
            accepted.path.retain(|own| *own != name);
            let Ok(fit) = unless_it_fails(self.with(&accepted.path))? else { return Ok(accepted) };
            accepted.fit = fit;
            accepted.refused.push(Refusal::NotSignificant { name, p_value });
        }
    }
}

/// Separates a failed fit from other errors: returns the fit, or the error message if the model could not be fitted,
/// and propagates all other errors.
pub(super) fn unless_it_fails(fit: Result<Rc<Fit>, Error>) -> Result<Result<Rc<Fit>, String>, Error> {
    match fit {
        Ok(fit) => Ok(Ok(fit)),
        Err(error @ (Error::Fit(_) | Error::NotEnoughMotion(_))) => Ok(Err(error.to_string())),
        Err(other) => Err(other),
    }
}

/// Expected `value` of a [`Metric`] if sensor noise is the only error, and the `count` of the residuals from which the
/// metric is computed.
struct Floor {
    value: f64,
    count: usize,
}

impl Fit {
    /// chi2 per degree of freedom of unseen data. Without control recordings, the held-out residuals are divided by
    /// their standard deviations in `before`, the fit without effects.
    pub(super) fn unseen_chi2(&self, before: &Self) -> f64 {
        if let Some(control) = &self.control {
            return control.judged().figures.chi2_per_dof;
        }
        let term = |(metric, floor): (Metric, Floor)| {
            let figure = self.held_out_figure(metric).filter(|_| floor.value > 0.0)?;
            Some((floor.count, floor.count as f64 * (figure / floor.value).powi(2)))
        };
        let terms: Vec<(usize, f64)> = before.floors().into_iter().filter_map(term).collect();
        let count: usize = terms.iter().map(|(count, _)| count).sum();
        terms.iter().map(|(_, chi2)| chi2).sum::<f64>() / count.max(1) as f64
    }

    /// The figure of merit on unseen data that improves most from this fit to the fit `after`. The improvement of a
    /// figure is its value for this fit divided by its value for the fit `after`.
    pub(super) fn unseen_figure(&self, after: &Self) -> Option<UnseenFigure> {
        if let (Some(own), Some(other)) = (&self.control, &after.control) {
            // If no effect was accepted, both fits are the same fit. chi2 is then computed with the biases of the
            // calibration, not with biases estimated from the control recordings. It therefore includes the errors from
            // any change of the biases between the calibration and the control recordings.
            let is_same = std::ptr::eq(own, other);
            let chi2 = |control: &Control| match is_same {
                true => control.evaluation.figures.chi2_per_dof,
                false => control.judged().figures.chi2_per_dof,
            };
            let [before, after] = [own, other].map(chi2);
            return Some(UnseenFigure { metric: Metric::Chi2PerDof, before, after, floor: 1.0 });
        }
        let figure = |(metric, floor): (Metric, Floor)| {
            let [before, after] = [self, after].map(|fit| fit.held_out_figure(metric));
            Some(UnseenFigure { metric, before: before?, after: after?, floor: floor.value })
        };
        let improvement = |figure: &UnseenFigure| figure.before / figure.after.max(1e-300);
        let better = |a: UnseenFigure, b: UnseenFigure| if improvement(&b) > improvement(&a) { b } else { a };
        self.floors().into_iter().filter_map(figure).reduce(better)
    }

    fn held_out_figure(&self, metric: Metric) -> Option<f64> {
        let held_out = self.outcome.held_out.as_ref()?;
        match metric {
            Metric::Chi2PerDof => None,
            Metric::HeldOutDirection => Some(held_out.gravity_direction_rms_deg),
            Metric::HeldOutNorm => held_out.gravity_norm_rms_mps2(),
        }
    }

    fn floors(&self) -> [(Metric, Floor); 2] {
        let finite = |values: Vec<f64>| values.into_iter().filter(|value| value.is_finite()).collect::<Vec<_>>();
        let moves = finite(self.outcome.moves.iter().map(|m| m.direction_sigma_deg).collect());
        let rests = finite(self.outcome.rests.iter().map(|rest| rest.norm_sigma_mps2).collect());
        let rms = |values: &[f64]| match values.len() {
            0 => 0.0,
            count => (values.iter().map(|value| value * value).sum::<f64>() / count as f64).sqrt(),
        };
        // A direction error has two components with equal standard deviations, so its rms is sqrt(2) x the rms of one
        // component.
        let direction = Floor { value: std::f64::consts::SQRT_2 * rms(&moves), count: 2 * moves.len() };
        [(Metric::HeldOutDirection, direction), (Metric::HeldOutNorm, Floor { value: rms(&rests), count: rests.len() })]
    }

    /// Whether this fit predicts unseen data significantly worse than the fit `other`. Without control recordings, the
    /// held-out residuals are divided by their standard deviations in `before`, the fit without effects. If the effect
    /// depends on heading (`needs_heading`), a small increase of chi2 does not count, even if it is significant. The
    /// reason is that the heading of control recordings is unknown, so only the vertical component of the effect is
    /// corrected there.
    fn is_worse_than(&self, other: &Self, before: &Self, needs_heading: bool) -> bool {
        let [value, least] = [self, other].map(|fit| fit.unseen_chi2(before));
        if value <= least * (1.0 + SAME) {
            return false;
        }
        let items = self.unseen_items().into_iter().zip(other.unseen_items());
        let change: Vec<f64> = items.flat_map(|(own, other)| changes(&own, &other)).collect();
        let (sum, count) = (change.iter().sum::<f64>(), change.len() as f64);
        let variance = change.iter().map(|value| (value - sum / count).powi(2)).sum::<f64>() / count;
        // Under the null hypothesis (both fits predict equally well) the change of chi2 has two parts. The first part
        // comes from parameter errors, which shift the residuals of all rests and moves together. It is a chi2 variable
        // with as many degrees of freedom as there are parameters. The second part is the sum of independent changes of
        // the chi2 of each rest and each move.
        let shared = 2.0 * self.outcome.names.len() as f64;
        let together = SIGNIFICANT * shared.sqrt();
        let all = SIGNIFICANT * (shared + if change.is_empty() { 0.0 } else { count * variance }).sqrt();
        value > least + (MAY_BE_CHANCE * least).max(together / count.max(1.0)) || (sum > all && !needs_heading)
    }

    /// p-value of the parameters of an effect under the hypothesis that they are zero; `None` if the effect is not in
    /// the model, or if the covariance of its parameters is singular. The time constant of an effect is not tested.
    fn chance_of(&self, name: &str) -> Option<f64> {
        let effect = self.outcome.effects.iter().find(|effect| effect.name == name)?;
        let first = self.outcome.names.iter().position(|own| effect.parameter_names.first() == Some(own))?;
        let count = effect.values.len();
        let covariance = DMatrix::from_fn(count, count, |i, j| self.outcome.covariance[first + i][first + j]);
        let values = DVector::from_column_slice(&effect.values);
        let chi2 = values.dot(&covariance.cholesky()?.solve(&values));
        chi2.is_finite().then(|| p_value(chi2, count))
    }

    /// Decrease of chi2 of unseen data from the fit `before` to this fit. The standard deviation of the decrease is
    /// estimated from the changes of chi2 of the individual rests and moves.
    pub(super) fn removed(&self, before: &Self) -> Removed {
        let mut removed = Removed { share: 0.0, significance: 0.0, significance_of_all: 0.0 };
        let (mut sum_of_all, mut variance_of_all) = (0.0, 0.0);
        for (own, other) in self.unseen_items().iter().zip(&before.unseen_items()) {
            let pairs: Vec<(f64, f64)> = own.iter().zip(other).filter_map(|(own, other)| own.zip(*other)).collect();
            let total: f64 = pairs.iter().map(|(_, other)| other).sum();
            let count = pairs.len() as f64;
            let sum = pairs.iter().map(|(own, other)| other - own).sum::<f64>();
            let mean = sum / count.max(1.0);
            let variance = pairs.iter().map(|(own, other)| (other - own - mean).powi(2)).sum::<f64>();
            if total > 0.0 && count > 2.0 {
                removed.share = removed.share.max(sum / total);
                removed.significance = removed.significance.max(sum / variance.max(1e-300).sqrt());
            }
            sum_of_all += sum;
            variance_of_all += variance;
        }
        if variance_of_all > 0.0 {
            removed.significance_of_all = sum_of_all / variance_of_all.sqrt();
        }
        removed
    }

    /// p-value of the residuals of unseen data under the hypothesis that sensor noise and the uncertainty of the
    /// calibration are the only errors. It is the smallest p-value of all kinds of residuals, corrected for the number
    /// of kinds (Bonferroni). If `is_as_recorded` is true, the residuals include the errors from a change of the biases
    /// between calibration and control recordings.
    pub(super) fn unseen_chance(&self, is_as_recorded: bool) -> f64 {
        if let Some(control) = &self.control {
            let evaluation = if is_as_recorded { &control.evaluation } else { control.judged() };
            let groups = evaluation.groups.iter();
            let least = groups.clone().map(GroupMisfit::p_value).fold(1.0, f64::min);
            return (least * groups.count() as f64).min(1.0);
        }
        let kinds = self.unseen_items().map(|items| items.into_iter().flatten().collect::<Vec<f64>>());
        // Each cross-validation fold is predicted with parameters that are estimated from the other folds. The errors
        // of these parameters increase the expected chi2 per degree of freedom from 1 to about 1 + parameters /
        // residuals.
        let residuals = self.outcome.rests.len() + 2 * self.outcome.moves.len();
        let floor = 1.0 + self.outcome.names.len() as f64 / residuals.max(1) as f64;
        let chance = |(items, size): (&Vec<f64>, usize)| p_value(items.iter().sum::<f64>() / floor, size * items.len());
        let least = kinds.iter().zip([1, 2, 3]).map(chance).fold(1.0, f64::min);
        (3.0 * least).min(1.0)
    }

    /// The kinds of residuals that exceed noise significantly and by more than a factor of 2: sqrt(chi2 / dof) > 2.
    /// Only the norms of the specific force at rest and the gravity directions after moves are tested. The residuals
    /// are those of the control recordings, or of the calibration recordings if there are no control recordings.
    /// If `is_as_recorded` is true, the residuals of the control recordings include the errors from a change of the
    /// biases between calibration and control recordings.
    pub(super) fn unexplained(&self, is_as_recorded: bool) -> Vec<&GroupMisfit> {
        const JUDGED: [ResidualGroup; 2] = [ResidualGroup::RestNorms, ResidualGroup::MoveDirections];
        let groups = match &self.control {
            Some(control) if is_as_recorded => &control.evaluation.groups,
            Some(control) => &control.judged().groups,
            None => &self.outcome.groups,
        };
        groups.iter().filter(|own| JUDGED.contains(&own.group) && own.exceeds_noise()).collect()
    }

    /// chi2 of the force norm at each rest, of the gravity direction after each move, and of the mean angular rate at
    /// each rest, for the unseen data (control recordings, or held-out rests and moves). Without control recordings,
    /// the list of the angular rates is empty.
    fn unseen_items(&self) -> [Vec<Option<f64>>; 3] {
        let of = |errors: &mut dyn Iterator<Item = f64>, sigmas: &mut dyn Iterator<Item = f64>| {
            let chi2 = |(error, sigma): (f64, f64)| {
                (error.is_finite() && sigma.is_finite() && sigma != 0.0).then(|| (error / sigma).powi(2))
            };
            errors.zip(sigmas).map(chi2).collect::<Vec<_>>()
        };
        if let Some(control) = &self.control {
            let (rests, moves) = (&control.judged().rests, &control.judged().moves);
            let norms = of(
                &mut rests.iter().map(|rest| rest.norm_error_mps2),
                &mut rests.iter().map(|rest| rest.norm_sigma_mps2),
            );
            let directions =
                of(&mut moves.iter().map(|m| m.direction_error_deg), &mut moves.iter().map(|m| m.direction_sigma_deg));
            return [norms, directions, control.rate_chi2.clone()];
        }
        let (rests, moves) = (&self.outcome.rests, &self.outcome.moves);
        let Some(held_out) = &self.outcome.held_out else { return [Vec::new(), Vec::new(), Vec::new()] };
        let norms =
            of(&mut held_out.norm_error_mps2.iter().copied(), &mut rests.iter().map(|rest| rest.norm_sigma_mps2));
        let directions =
            of(&mut held_out.direction_error_deg.iter().copied(), &mut moves.iter().map(|m| m.direction_sigma_deg));
        [norms, directions, Vec::new()]
    }
}

/// Whether the effect depends on the heading of the unit. The heading of control recordings is unknown. Only the
/// vertical component of such an effect is therefore corrected there, and residuals of the other components remain.
pub(super) fn needs_heading(name: &str) -> bool {
    Effect::<f64>::find(name).is_some_and(|effect| effect.needs.contains(&Need::Attitude))
}

/// Differences `own - other` for all indices at which both lists have a value.
fn changes(own: &[Option<f64>], other: &[Option<f64>]) -> Vec<f64> {
    own.iter().zip(other).filter_map(|(own, other)| Some((*own)? - (*other)?)).collect()
}
