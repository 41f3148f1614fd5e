//! Linearisations of a problem: by a pass over the samples, or by extrapolation of the last one to parameters nearby.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use faer::Mat;
use nalgebra::Vector3;

use super::Joint;
use crate::error::Error;
use crate::joint::linear::Linear;
use crate::joint::model::Model;
use crate::joint::terms::{Kinds, Term};
use crate::numerics::lsq::Solution;

/// Distance, in standard deviations, within which residuals are extrapolated linearly. The neglected terms are of
/// second order and change a residual by about 0.001 standard deviations. A search uses extrapolated residuals; a fit
/// that ends with them is linearised again and continued.
const NEAR: f64 = 3.0;

/// Known linearisations, shared between threads.
pub(crate) struct Nearby {
    /// The last linearisation by a pass over the samples.
    last: Mutex<Place>,
    /// Its last extrapolation.
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
    /// Starts with a known linearisation.
    pub(crate) fn new(linear: Arc<Linear>) -> Self {
        let place = Place { parameters: linear.model.parameters(), linear };
        Self { last: Mutex::new(place.clone()), near: Mutex::new(place) }
    }
}

impl Joint<'_> {
    /// The linearisation at these parameters, extrapolated from the last one if it is close enough.
    pub(crate) fn linear(&self, parameters: &[f64]) -> Result<Arc<Linear>, Error> {
        for place in [&self.nearby.last, &self.nearby.near] {
            let place = known(place);
            if place.parameters == parameters {
                return Ok(Arc::clone(&place.linear));
            }
        }
        self.linear_within(parameters, None)
    }

    /// The linearisation at the end of a fit. The last step of the fit is small, so extrapolation is usually possible.
    pub(crate) fn linear_at_end(&self, found: &Solution) -> Result<Arc<Linear>, Error> {
        self.linear_within(&found.parameters, Some(&found.jacobian))
    }

    fn linear_within(&self, parameters: &[f64], jacobian: Option<&Mat<f64>>) -> Result<Arc<Linear>, Error> {
        let Some(moved) = self.moved(parameters, jacobian)? else { return self.linear_anew(parameters) };
        let linear = Arc::new(moved);
        *known(&self.nearby.near) = Place { parameters: parameters.to_vec(), linear: Arc::clone(&linear) };
        Ok(linear)
    }

    /// The linearisation at these parameters by a pass over the samples.
    fn linear_anew(&self, parameters: &[f64]) -> Result<Arc<Linear>, Error> {
        let linear = Arc::new(self.prepared.linearise(self.terms, parameters)?);
        *known(&self.nearby.last) = Place { parameters: parameters.to_vec(), linear: Arc::clone(&linear) };
        Ok(linear)
    }

    /// Linearises again at these parameters if the last linearisation was an extrapolation; returns whether it was.
    pub(crate) fn refresh(&self, parameters: &[f64]) -> Result<bool, Error> {
        let is_moved = known(&self.nearby.last).parameters != parameters && self.moved(parameters, None)?.is_some();
        if is_moved {
            self.linear_anew(parameters)?;
        }
        Ok(is_moved)
    }

    /// Extrapolates the last linearisation to these parameters if they are close and all residuals are linear in them.
    /// For residuals inside moves, the distance is calculated with `jacobian`, the whitened derivatives, if given.
    ///
    /// There is no extrapolation with time constants, because their derivative is zero while the effect is zero.
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

    /// Sum of squares of the change of the whitened residuals of rests and moves.
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
