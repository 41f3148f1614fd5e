//! A model of the forward search: fitted, and linearised together with the candidates.

use std::sync::Arc;

use imucal_core::effects::Sensor;

use super::design::Design;
use super::evidence::Evidence;
use crate::joint::{Kinds, Model, WarmStart};

pub(super) const NO_EVIDENCE: &str =
    "the residuals of these recordings have no evidence: look for numbers that are not finite";

/// A model of the forward search.
#[derive(Clone)]
pub(super) struct Stage {
    pub(super) design: Arc<Design>,
    pub(super) evidence: Evidence,
    /// The fit.
    pub(super) model: Model,
    /// Its effects, of the catalogue and of the user, with the standard deviation of the prior of each.
    pub(super) members: Vec<Member>,
    /// The sensors that these effects act on.
    pub(super) sensors: Vec<Sensor>,
    /// Name of each effect and the places of its parameters in the model.
    pub(super) places: Vec<(String, std::ops::Range<usize>)>,
}

impl Stage {
    /// The places of the parameters of an effect in the model.
    pub(super) fn place(&self, name: &str) -> Option<std::ops::Range<usize>> {
        self.places.iter().find(|(member, _)| member == name).map(|(_, place)| place.clone())
    }

    /// The same model without one of the candidates.
    pub(super) fn without(&self, name: &str) -> Self {
        Self { design: Arc::new(self.design.without(|own| own == name)), ..self.clone() }
    }

    /// The warm start of fits with the same effects.
    pub(super) fn warm_start(&self) -> WarmStart {
        WarmStart::new(&self.model, self.places.iter().map(|(name, place)| (name.clone(), place.len())).collect())
    }
}

/// An effect in a model.
#[derive(Clone)]
pub(super) struct Member {
    pub(super) name: String,
    pub(super) width: f64,
    /// Start value of its time constant, if it has one.
    pub(super) shape: Option<f64>,
    /// Its parameters in the last fit; empty before the first one.
    pub(super) values: Vec<f64>,
}

/// Kinds of residuals, number of moves, and name and prior width of each effect of a fit: equal keys have equal fits.
pub(super) type FitKey = (Kinds, usize, Vec<(String, f64)>);

/// What is linearised together with a model.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Beside {
    Candidates,
    Nothing,
}
