//! One rest: its range of samples, the means of the accelerometer and of the gyroscope, and the error of the norm of
//! the mean force.

use faer::Mat;
use imucal_core::sensor::Triad;
use nalgebra::Vector3;

use crate::rounding::Rounding;

/// A rest is hand-held if its unsteadiness (a ratio of variances) is above this limit (model.md (11)). The unsteadiness
/// is near 1 for rests on a table.
pub(super) const UNSTEADY: f64 = 2.0;

/// Mean of a three-axis sensor over a rest, with its errors, in raw units.
#[derive(Clone, Copy, Debug)]
pub struct RestMean {
    /// Mean reading of each of the three axes over the rest.
    pub mean: Vector3<f64>,
    /// Variance of the mean of each axis, squared raw units. It is computed from the scatter within this rest and the
    /// correlation of the noise.
    pub variance_of_mean: Vector3<f64>,
    /// Quantisation step of each axis, and the statistics of the rounding error of its mean. Rests with equal readings
    /// have equal rounding errors of the mean (model.md (37)).
    pub rounding: [Rounding; 3],
}

impl RestMean {
    /// Variance of the mean of each axis, including the rounding error, squared raw units.
    pub fn whole_variance(&self) -> Vector3<f64> {
        self.variance_of_mean + self.rounding_std().map(|std| std * std)
    }

    /// Standard deviation of the rounding error of the mean of each axis, raw units.
    pub(crate) fn rounding_std(&self) -> Vector3<f64> {
        Vector3::from(self.rounding.map(|rounding| rounding.error_variance.sqrt()))
    }
}

/// Two rests are treated as rests in the same pose if their readings on each axis differ by at most this number of
/// quantisation steps. In the same pose, both rests have the same rounding error, even if its size is unknown.
const SAME_POSE: f64 = 0.5;

/// Covariance matrix of the rounding errors of `means`, the means of several rests, on one axis, squared raw units.
/// `None` if these rounding errors are negligible at all rests.
pub(crate) fn rounding_covariance(means: &[&RestMean], axis: usize) -> Option<Mat<f64>> {
    let reading = |k: usize| (&means[k].rounding[axis], means[k].mean[axis]);
    let are_in_one_pose = |i: usize, j: usize| {
        let apart = |axis: usize| (means[i].mean[axis] - means[j].mean[axis]).abs();
        (0..3).all(|axis| apart(axis) <= SAME_POSE * means[i].rounding[axis].step)
    };
    let covariance = |i, j| {
        let ((own, at), (other, other_at)) = (reading(i), reading(j));
        let is_common = i == j || (own.is_determined && other.is_determined) || are_in_one_pose(i, j);
        if is_common { own.covariance(at, other, other_at) } else { 0.0 }
    };
    let is_coarse = means.iter().any(|mean| mean.rounding[axis].is_coarse());
    is_coarse.then(|| Mat::from_fn(means.len(), means.len(), covariance))
}

/// An interval in which the unit does not move.
#[derive(Clone, Copy, Debug)]
pub struct Rest {
    /// Index of the first sample of the rest.
    pub first: usize,
    /// Index of the first sample after the rest.
    pub end: usize,
    /// Time of the first sample, s.
    pub start_s: f64,
    /// Time of the last sample, s.
    pub end_s: f64,
    /// Unsteadiness (model.md (11)): the larger of two ratios. The first ratio is (variance of the samples) / (noise
    /// variance), as the median over all half-second windows of the rest. The second ratio compares the drift of the
    /// mean force with noise. It is the sum over the axes of (squared drift) / (15 x variance of the drift due to
    /// noise). With the factor 15, noise alone almost never gives a ratio above 2. The unsteadiness is near 1 if the
    /// unit lies on a table, and above 2 if it is hand-held.
    pub unsteadiness: f64,
    /// Mean of the accelerometer over the rest, raw units.
    pub specific_force: RestMean,
    /// Mean of the gyroscope over the rest, raw units.
    pub angular_rate: RestMean,
}

impl Rest {
    /// Whether the unit is on a rigid support during the rest. Otherwise, it is hand-held, and the samples contain
    /// tremor.
    pub fn is_steady(&self) -> bool {
        self.unsteadiness < UNSTEADY
    }
}

/// Lower bound of the standard deviation of the norm of the mean force at a rest, m/s^2. It prevents a standard
/// deviation of zero in simulated data without noise.
pub(crate) const FINEST_MPS2: f64 = 1e-5;

/// Standard deviation of the norm of a rest's mean force, m/s^2. It includes the noise and the rounding errors of the
/// mean (model.md (5)).
pub(crate) fn sigma_norm(rest: &Rest, triad: &Triad<f64>) -> f64 {
    let v = triad.inverse().tr_mul(&triad.correct(rest.specific_force.mean).normalize());
    at_least(FINEST_MPS2, v.component_mul(&v).dot(&rest.specific_force.whole_variance()).sqrt())
}

/// A standard deviation with a lower bound. A standard deviation of NaN (an unknown error) remains NaN. [`f64::max`] is
/// not used, because it would replace NaN by the lower bound.
pub(crate) fn at_least(finest: f64, sigma: f64) -> f64 {
    if sigma < finest { finest } else { sigma }
}

/// Error of the norm of the mean force of a rest: the norm minus gravity. The second result is the standard deviation
/// of this error due to noise and rounding. Both are in m/s^2.
pub(crate) fn norm_error_mps2(rest: &Rest, accelerometer: &Triad<f64>, gravity_mps2: f64) -> (f64, f64) {
    let error = accelerometer.correct(rest.specific_force.mean).norm() - gravity_mps2;
    (error, sigma_norm(rest, accelerometer))
}
