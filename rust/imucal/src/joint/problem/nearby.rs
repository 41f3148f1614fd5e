//! Linearisations of a problem: a pass over the samples, or what the last one makes of parameters nearby.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use faer::Mat;
use nalgebra::Vector3;

use super::Joint;
use crate::error::Error;
use crate::joint::linear::Linear;
use crate::joint::model::Model;
use crate::joint::terms::{Kinds, Term};
use crate::numerics::lsq::Solution;

/// Within so many standard deviations of a linearisation the residuals follow their derivatives, to a part in a thousand of one: what
/// is left out is of second order in the parameters' errors. A search, which only asks what explains the residuals, leaves it at that; a
/// fit that ends there is linearised anew and goes on.
const NEAR: f64 = 3.0;

/// The linearisations that are known, whichever thread asks.
pub(crate) struct Nearby {
    /// The last one that took a pass over the samples.
    last: Mutex<Place>,
    /// What was made of it nearby.
    near: Mutex<Place>,
}

/// A linearisation and its parameters.
#[derive(Clone)]
struct Place {
    parameters: Vec<f64>,
    linear: Arc<Linear>,
}

fn known(place: &Mutex<Place>) -> MutexGuard<'_, Place> {
    place.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Nearby {
    /// One is known.
    pub(crate) fn new(linear: Arc<Linear>) -> Self {
        let place = Place { parameters: linear.model.parameters(), linear };
        Self { last: Mutex::new(place.clone()), near: Mutex::new(place) }
    }
}

impl Joint<'_> {
    /// The linearisation at these parameters, or what the last one makes of them if it is near.
    pub(crate) fn linear(&self, parameters: &[f64]) -> Result<Arc<Linear>, Error> {
        for place in [&self.nearby.last, &self.nearby.near] {
            let place = known(place);
            if place.parameters == parameters {
                return Ok(Arc::clone(&place.linear));
            }
        }
        self.linear_within(parameters, None)
    }

    /// The linearisation where a fit has ended: its last step, which it did not look back at, is small.
    pub(crate) fn linear_at_end(&self, found: &Solution) -> Result<Arc<Linear>, Error> {
        self.linear_within(&found.parameters, Some(&found.jacobian))
    }

    fn linear_within(&self, parameters: &[f64], jacobian: Option<&Mat<f64>>) -> Result<Arc<Linear>, Error> {
        let Some(moved) = self.moved(parameters, jacobian)? else { return self.linear_anew(parameters) };
        let linear = Arc::new(moved);
        *known(&self.nearby.near) = Place { parameters: parameters.to_vec(), linear: Arc::clone(&linear) };
        Ok(linear)
    }

    /// The linearisation at these parameters.
    fn linear_anew(&self, parameters: &[f64]) -> Result<Arc<Linear>, Error> {
        let linear = Arc::new(self.prepared.linearise(self.terms, parameters)?);
        *known(&self.nearby.last) = Place { parameters: parameters.to_vec(), linear: Arc::clone(&linear) };
        Ok(linear)
    }

    /// Linearises at these parameters if only a linearisation nearby is known; says whether that was so.
    pub(crate) fn refresh(&self, parameters: &[f64]) -> Result<bool, Error> {
        let is_moved = known(&self.nearby.last).parameters != parameters && self.moved(parameters, None)?.is_some();
        if is_moved {
            self.linear_anew(parameters)?;
        }
        Ok(is_moved)
    }

    /// What the last linearisation makes of these parameters, if they are near and all residuals are lines. How far they
    /// go inside the moves is said by whitened derivatives, if these are at hand.
    ///
    /// A time constant has no derivative where there is no effect yet, so that how far it goes is not seen.
    fn moved(&self, parameters: &[f64], jacobian: Option<&Mat<f64>>) -> Result<Option<Linear>, Error> {
        let Place { parameters: from, linear } = &*known(&self.nearby.last);
        let Kinds { in_motion, encoders } = self.terms.kinds;
        if encoders || self.terms.all.iter().any(Term::has_shape) {
            return Ok(None);
        }
        let change = Mat::from_fn(parameters.len(), 1, |p, _| parameters[p] - from[p]);
        let square = match jacobian {
            Some(jacobian) if in_motion => (jacobian * &change).squared_norm_l2(),
            None if in_motion => return Ok(None),
            _ => self.square_of_lines(linear, change.col_as_slice(0)),
        };
        let moved = || Ok(linear.moved(change.col_as_slice(0), Model::of(parameters, self.terms)?));
        (square < NEAR * NEAR).then(moved).transpose()
    }

    /// Sum of the squares of what a change of the parameters does to the whitened lines and rates.
    fn square_of_lines(&self, linear: &Linear, change: &[f64]) -> f64 {
        let mut lines = Mat::from_fn(linear.lines.len(), 1, |row, _| linear.lines[row].change(change));
        self.weights.whitening.apply(&mut lines);
        let rates = linear.rates.iter().map(|(rest, rates)| {
            let change = Vector3::from_fn(|axis, _| rates[axis].change(change));
            (self.weights.rates[*rest] * change).norm_squared()
        });
        lines.squared_norm_l2() + rates.sum::<f64>()
    }
}
