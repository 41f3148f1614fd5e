//! Cache of linearisations. A linearisation contains the residuals at given parameters and their derivatives. For
//! parameters near those of the last linearisation, the result is a first-order update of the last linearisation, so
//! the samples are not integrated again.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use faer::Mat;
use nalgebra::Vector3;

use super::Joint;
use crate::error::Error;
use crate::joint::choices::Kinds;
use crate::joint::linear::Linear;
use crate::joint::model::Model;
use crate::joint::terms::Term;
use crate::numerics::lsq::Solution;

/// Largest distance from the last linearisation at which a first-order update of this linearisation is used. The
/// distance is the norm of the change of the whitened residuals. The neglected second-order terms of the residuals are
/// then at most a thousandth of the standard deviation of a residual. A search for effects uses the update without
/// further computation. If a final fit converges to parameters for which only a first-order update is known, the
/// linearisation is computed from the samples, and the fit is continued from these parameters.
const NEAR: f64 = 3.0;

/// Cached linearisations, shared by all threads.
pub(crate) struct Nearby {
    /// Last linearisation that was computed from the samples.
    last: Mutex<Place>,
    /// Most recent first-order update of `last`.
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
    /// Creates a cache that contains one linearisation.
    pub(crate) fn new(linear: Arc<Linear>) -> Self {
        let place = Place { parameters: linear.model.parameters(), linear };
        Self { last: Mutex::new(place.clone()), near: Mutex::new(place) }
    }
}

impl Joint<'_> {
    /// Returns the linearisation at `parameters`. If they are near the parameters of the last linearisation, the result
    /// is a first-order update of the last linearisation.
    pub(crate) fn linear(&self, parameters: &[f64]) -> Result<Arc<Linear>, Error> {
        for place in [&self.nearby.last, &self.nearby.near] {
            let place = known(place);
            if place.parameters == parameters {
                return Ok(Arc::clone(&place.linear));
            }
        }
        self.linear_within(parameters, None)
    }

    /// Returns the linearisation at the end of the fit `found`. A first-order update is usually accurate enough,
    /// because the last step of the fit is small.
    pub(crate) fn linear_at_end(&self, found: &Solution) -> Result<Arc<Linear>, Error> {
        self.linear_within(&found.parameters, Some(&found.jacobian))
    }

    fn linear_within(&self, parameters: &[f64], jacobian: Option<&Mat<f64>>) -> Result<Arc<Linear>, Error> {
        let Some(moved) = self.moved(parameters, jacobian)? else { return self.linear_anew(parameters) };
        let linear = Arc::new(moved);
        *known(&self.nearby.near) = Place { parameters: parameters.to_vec(), linear: Arc::clone(&linear) };
        Ok(linear)
    }

    /// Computes the linearisation at these parameters from the samples.
    fn linear_anew(&self, parameters: &[f64]) -> Result<Arc<Linear>, Error> {
        let linear = Arc::new(self.prepared.linearise(self.terms, parameters)?);
        *known(&self.nearby.last) = Place { parameters: parameters.to_vec(), linear: Arc::clone(&linear) };
        Ok(linear)
    }

    /// Computes the linearisation from the samples if only a first-order update is known at these parameters. Returns
    /// whether it was computed from the samples.
    pub(crate) fn refresh(&self, parameters: &[f64]) -> Result<bool, Error> {
        let is_moved = known(&self.nearby.last).parameters != parameters && self.moved(parameters, None)?.is_some();
        if is_moved {
            self.linear_anew(parameters)?;
        }
        Ok(is_moved)
    }

    /// Computes a first-order update of the last linearisation; `None` if `parameters` are not near the parameters of
    /// this linearisation, or if there are residuals relative to the stand. If the fit uses the force inside the moves,
    /// the distance is computed from the whitened Jacobian `jacobian`, and there is no update without `jacobian`.
    ///
    /// There is also no update if a time constant is estimated. The derivative with respect to a time constant is zero
    /// while its effect is zero, so the distance would be underestimated.
    fn moved(&self, parameters: &[f64], jacobian: Option<&Mat<f64>>) -> Result<Option<Linear>, Error> {
        let Place { parameters: from, linear } = &*known(&self.nearby.last);
        let Kinds { in_motion, encoders } = self.terms.kinds;
        // The distance does not include priors. There is therefore also no update if the user gave priors for
        // parameters.
        if encoders || !self.prepared.held.is_empty() || self.terms.all.iter().any(Term::has_shape) {
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

    /// Computes the squared norm of the change of the whitened residuals, to first order. Only force norms, gravity
    /// directions after moves and mean rates are included.
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
