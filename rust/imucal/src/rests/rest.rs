//! One rest: the samples in it, the means of both sensors, and the error of |f|.

use imucal_core::sensor::Triad;
use nalgebra::Vector3;

/// A rest whose scatter is this many times the noise floor (in variance) is held by a hand.
pub(super) const UNSTEADY: f64 = 2.0;

/// Mean of a triad over a rest, in raw units.
#[derive(Clone, Copy, Debug)]
pub struct RestMean {
    /// The mean.
    pub mean: Vector3<f64>,
    /// Variance of that mean, from this rest's own scatter and the correlation of the noise.
    pub variance_of_mean: Vector3<f64>,
}

/// A stretch in which the unit stands still.
#[derive(Clone, Copy, Debug)]
pub struct Rest {
    /// Index of the first sample.
    pub first: usize,
    /// Index after the last sample.
    pub end: usize,
    /// Time of the first sample, s.
    pub start_s: f64,
    /// Time of the last sample, s.
    pub end_s: f64,
    /// Scatter in half a second over the noise floor, or drift of gravity over what noise explains, whichever is more
    /// (ratios of variances): near 1 on a table, more in a hand.
    pub unsteadiness: f64,
    /// Accelerometer.
    pub specific_force: RestMean,
    /// Gyroscope.
    pub angular_rate: RestMean,
}

impl Rest {
    /// Whether the unit lies on something firm; if not, a hand holds it, and its tremor is seen.
    pub fn is_steady(&self) -> bool {
        self.unsteadiness < UNSTEADY
    }
}

/// No standard deviation of |f| is finer than this, m/s^2: a noise-free simulation has no scatter at all.
pub(crate) const FINEST_MPS2: f64 = 1e-5;

/// Standard deviation of |f| over one rest, from the scatter of its samples, m/s^2.
pub(crate) fn sigma_norm(rest: &Rest, triad: &Triad<f64>) -> f64 {
    let v = triad.inverse().tr_mul(&triad.correct(rest.specific_force.mean).normalize());
    v.component_mul(&v).dot(&rest.specific_force.variance_of_mean).sqrt().max(FINEST_MPS2)
}

/// Error of |f| at a rest and the standard deviation that noise explains, m/s^2.
pub(crate) fn norm_error_mps2(rest: &Rest, accelerometer: &Triad<f64>, gravity_mps2: f64) -> (f64, f64) {
    let error = accelerometer.correct(rest.specific_force.mean).norm() - gravity_mps2;
    (error, sigma_norm(rest, accelerometer))
}
