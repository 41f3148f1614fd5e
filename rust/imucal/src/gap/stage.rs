//! A fitted model of the forward search, its linearised residuals, and the Jacobian columns of the candidate effects.

use std::sync::Arc;

use imucal_core::effects::{Effect, Sensor};

use super::design::Design;
use super::evidence::Evidence;
use crate::joint::{Kinds, Model, WarmStart};

pub(super) const NO_EVIDENCE: &str =
    "the evidence of a model could not be computed from these recordings: look for values that are not finite";

/// A fitted model of the forward search and its evidence.
#[derive(Clone)]
pub(super) struct Stage {
    pub(super) design: Arc<Design>,
    pub(super) evidence: Evidence,
    /// The fitted model.
    pub(super) model: Model,
    /// Effects in the model, both from the catalogue and user-defined, each with its prior width.
    pub(super) members: Vec<Member>,
    /// Sensors on which the effects in the model act.
    pub(super) sensors: Vec<Sensor>,
    /// For each effect of the model: its name, and the indices of its parameters among all parameters of the model.
    pub(super) places: Vec<(String, std::ops::Range<usize>)>,
}

impl Stage {
    /// Indices of an effect's parameters among all parameters of the model; `None` if the effect is not in the model.
    pub(super) fn place(&self, name: &str) -> Option<std::ops::Range<usize>> {
        self.places.iter().find(|(member, _)| member == name).map(|(_, place)| place.clone())
    }

    /// chi2 per degree of freedom of a group of residuals, at least one; `None` if the group has no residuals.
    pub(super) fn scale(&self, group: usize) -> Option<f64> {
        self.design.gram.place(group).map(|place| self.evidence.scales[place])
    }

    /// A copy of this stage without the candidate effect `name`. The model is unchanged.
    pub(super) fn without(&self, name: &str) -> Self {
        Self { design: Arc::new(self.design.without(|own| own == name)), ..self.clone() }
    }

    /// The fitted parameters, for use as start values of later fits with the same effects.
    pub(super) fn warm_start(&self) -> WarmStart {
        WarmStart::new(&self.model, self.places.iter().map(|(name, place)| (name.clone(), place.len())).collect())
    }
}

/// An effect in a model.
#[derive(Clone)]
pub(super) struct Member {
    pub(super) name: String,
    /// Number of linear parameters.
    pub(super) parameters: usize,
    /// Standard deviation of the prior of each linear parameter, in multiples of the parameter's typical size.
    pub(super) width: f64,
    /// Start value of the effect's time constant in a fit, s; `None` if the effect has no time constant, or if the fit
    /// starts at the default value.
    pub(super) shape: Option<f64>,
    /// Parameter values of the last fit, SI units; empty before the first fit.
    pub(super) values: Vec<f64>,
}

impl Member {
    /// An effect in its form with the fewest parameters, not yet fitted. The standard deviations of the prior are the
    /// typical sizes of the parameters.
    pub(super) fn plain(effect: &Effect<f64>) -> Self {
        let (name, parameters) = (effect.name.to_owned(), effect.plain);
        Self { name, parameters, width: 1.0, shape: None, values: Vec::new() }
    }
}

/// Key under which the result of a fit is stored: kinds of residuals, number of moves, and the name, number of
/// parameters, prior width and start value of the time constant of each effect. Two fits with equal keys have equal
/// results.
pub(super) type FitKey = (Kinds, usize, Vec<(String, usize, f64, Option<f64>)>);

/// The effects whose Jacobian columns are computed in addition to the columns of the model.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Beside {
    Candidates,
    Nothing,
}
