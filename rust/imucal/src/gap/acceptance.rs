//! Whether effects that a search has found predict what no fit has seen: control recordings, or rests and moves held
//! out.

use std::rc::Rc;

use super::fits::{Fit, Fits};
use crate::error::Error;

/// Relative increase of chi2 per degree of freedom up to which the prediction counts as equally good.
const SAME: f64 = 0.005;
/// Relative increase of chi2 per degree of freedom above which the prediction is worse, unless so few rests and moves
/// are held out that a larger increase is not significant.
const MAY_BE_CHANCE: f64 = 0.1;
/// Standard deviations by which a change of chi2 is significant.
const SIGNIFICANT: f64 = 3.0;

/// A figure on what no fit has seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnseenFigure {
    /// Which figure.
    pub metric: Metric,
    /// Without effects.
    pub before: f64,
    /// With the effects that joined.
    pub after: f64,
    /// What noise alone leaves of it.
    pub floor: f64,
}

/// Which figure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Metric {
    /// chi2 per degree of freedom on control recordings.
    Chi2PerDof,
    /// Rms angle between predicted and measured gravity after moves held out, deg.
    HeldOutDirection,
    /// Rms of |f| - g at rests held out, m/s^2.
    HeldOutNorm,
}

impl Metric {
    /// Its name in documents.
    pub fn name(self) -> &'static str {
        match self {
            Self::Chi2PerDof => "chi2_per_dof",
            Self::HeldOutDirection => "held_out_gravity_direction_rms_deg",
            Self::HeldOutNorm => "held_out_gravity_norm_rms_mps2",
        }
    }
}

/// An effect that was found and did not join.
#[derive(Clone, Debug, PartialEq)]
pub enum Refusal {
    /// No fit with it has an acceptable end.
    NotFitted {
        /// Name of the effect.
        name: String,
        /// Why.
        error: String,
    },
    /// It predicts what no fit has seen worse than the model without it.
    PredictsWorse {
        /// Name of the effect.
        name: String,
        /// chi2 per degree of freedom without it.
        before: f64,
        /// chi2 per degree of freedom with it.
        after: f64,
    },
}

/// Effects that have joined the model.
pub(super) struct Accepted {
    pub(super) path: Vec<String>,
    /// The fit with them.
    pub(super) fit: Rc<Fit>,
    pub(super) refused: Vec<Refusal>,
}

impl Fits<'_> {
    /// The effects of a path that do not make the prediction of unseen data worse, one after the other; all of them if
    /// that predicts it better still.
    pub(super) fn accept(&mut self, before: &Rc<Fit>, path: &[String]) -> Result<Accepted, Error> {
        let mut accepted = Accepted { path: Vec::new(), fit: Rc::clone(before), refused: Vec::new() };
        for name in path {
            let names = [accepted.path.as_slice(), std::slice::from_ref(name)].concat();
            let fit = match unless_it_fails(self.with(&names))? {
                Ok(fit) => fit,
                Err(error) => {
                    accepted.refused.push(Refusal::NotFitted { name: name.clone(), error });
                    continue;
                }
            };
            if fit.is_worse_than(&accepted.fit, before) {
                let [after, before] = [&fit, &accepted.fit].map(|fit| fit.unseen_chi2(before));
                accepted.refused.push(Refusal::PredictsWorse { name: name.clone(), before, after });
                continue;
            }
            accepted.path.push(name.clone());
            accepted.fit = fit;
        }
        // Effects that do not help one by one may help together.
        if accepted.path.len() < path.len()
            && let Ok(fit) = unless_it_fails(self.with(path))?
            && fit.unseen_chi2(before) < accepted.fit.unseen_chi2(before)
        {
            return Ok(Accepted { path: path.to_vec(), fit, refused: Vec::new() });
        }
        Ok(accepted)
    }
}

/// A fit, or why there is none; errors that are not those of a fit stay errors.
pub(super) fn unless_it_fails(fit: Result<Rc<Fit>, Error>) -> Result<Result<Rc<Fit>, String>, Error> {
    match fit {
        Ok(fit) => Ok(Ok(fit)),
        Err(error @ (Error::Fit(_) | Error::NotEnoughMotion(_))) => Ok(Err(error.to_string())),
        Err(other) => Err(other),
    }
}

/// What noise alone leaves of a figure, and of how many numbers the figure is.
struct Floor {
    value: f64,
    count: usize,
}

impl Fit {
    /// chi2 per degree of freedom of what no fit has seen; `before` is the fit without effects, whose noise counts.
    pub(super) fn unseen_chi2(&self, before: &Self) -> f64 {
        if let Some(control) = &self.control {
            return control.evaluation.figures.chi2_per_dof;
        }
        let term = |(metric, floor): (Metric, Floor)| {
            let figure = self.held_out_figure(metric).filter(|_| floor.value > 0.0)?;
            Some((floor.count, floor.count as f64 * (figure / floor.value).powi(2)))
        };
        let terms: Vec<(usize, f64)> = before.floors().into_iter().filter_map(term).collect();
        let count: usize = terms.iter().map(|(count, _)| count).sum();
        terms.iter().map(|(_, chi2)| chi2).sum::<f64>() / count.max(1) as f64
    }

    /// The figure on what no fit has seen that improves most from this fit to another one.
    pub(super) fn unseen_figure(&self, after: &Self) -> Option<UnseenFigure> {
        if let (Some(own), Some(other)) = (&self.control, &after.control) {
            let [before, after] = [own, other].map(|control| control.evaluation.figures.chi2_per_dof);
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
        // Both components of a direction have its standard deviation.
        let direction = Floor { value: std::f64::consts::SQRT_2 * rms(&moves), count: 2 * moves.len() };
        [(Metric::HeldOutDirection, direction), (Metric::HeldOutNorm, Floor { value: rms(&rests), count: rests.len() })]
    }

    /// Whether what no fit has seen is predicted worse than by `other`, by more than chance; `before` is the fit
    /// without effects.
    fn is_worse_than(&self, other: &Self, before: &Self) -> bool {
        let [value, least] = [self, other].map(|fit| fit.unseen_chi2(before));
        if value <= least * (1.0 + SAME) {
            return false;
        }
        let items = self.unseen_items().into_iter().zip(other.unseen_items());
        let change: Vec<f64> = items.flat_map(|(own, other)| changes(&own, &other)).collect();
        let (sum, count) = (change.iter().sum::<f64>(), change.len() as f64);
        let variance = change.iter().map(|value| (value - sum / count).powi(2)).sum::<f64>() / count;
        // Under the null hypothesis the change of chi2 has two parts: errors of the parameters change all items
        // together, by chi2 with as many degrees of freedom as there are parameters, and each item changes by itself.
        let shared = 2.0 * self.outcome.names.len() as f64;
        let together = SIGNIFICANT * shared.sqrt();
        let all = SIGNIFICANT * (shared + if change.is_empty() { 0.0 } else { count * variance }).sqrt();
        value > least + (MAY_BE_CHANCE * least).max(together / count.max(1.0)) || sum > all
    }

    /// chi2 of each rest, of each move and of the mean rate at each rest that no fit has seen.
    fn unseen_items(&self) -> [Vec<Option<f64>>; 3] {
        let of = |errors: &mut dyn Iterator<Item = f64>, sigmas: &mut dyn Iterator<Item = f64>| {
            let chi2 = |(error, sigma): (f64, f64)| {
                (error.is_finite() && sigma.is_finite() && sigma != 0.0).then(|| (error / sigma).powi(2))
            };
            errors.zip(sigmas).map(chi2).collect::<Vec<_>>()
        };
        if let Some(control) = &self.control {
            let (rests, moves) = (&control.evaluation.rests, &control.evaluation.moves);
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

/// Differences of what both have.
fn changes(own: &[Option<f64>], other: &[Option<f64>]) -> Vec<f64> {
    own.iter().zip(other).filter_map(|(own, other)| Some((*own)? - (*other)?)).collect()
}
