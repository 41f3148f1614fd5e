//! Preintegration of the gyroscope: the rotation over a move, and its derivatives with respect to the parameters
//! (`docs/model.md` (6), (7)).
//!
//! One pass over the samples of a move computes the rotation, and the integrals (as sums over the samples) that its
//! derivatives with respect to all parameters contain. The rate is `w = T^-1 (m - b)` for the measured rate m, the
//! sensitivity T and the bias b. The rotation vector of a step of length h is `phi = h wbar + h^2/12 (w0 x w1)`, and
//! each step updates the rotation R by `R <- R exp(phi)`. wbar is the mean rate over the step, and w0 and w1 are the
//! rates at its ends. A change of the parameters changes the attitude at the end of the move to `R exp(delta)`, where
//! `delta` is a rotation vector in the body frame at the end of the move. With the unit vector e_i along axis i, the
//! derivatives of `delta` are:
//!
//! ```text
//! d_delta_d_T_ij = -R^T G_j T^-1 e_i,   G_j = integral of R w_j dt
//! d_delta_d_b_i  = -R^T G_b T^-1 e_i,   G_b = integral of R dt
//! ```
//!
//! Inside the integrals, R is the rotation from the frame at a sample to the frame at the start of the move. In front
//! of the integrals, R is the rotation over the whole move. The integrals are trapezoidal sums over the samples. The
//! time derivative of R is `R' = R [w]x`, so a third of the columns of the G_j can be computed from the other columns
//! and the rotation over the whole move. For example, if R has the columns R_x, R_y and R_z, the integral of `R_y w_z -
//! R_z w_y` is the change of R_x. If the move does not start and end at rest, the relative deviation of the trapezoidal
//! sums from this relation is a twelfth of the squared rotation angle of a step. Short steps are summed in groups of
//! sixteen, which changes the sums only by a negligible amount (see `preintegration/sums.rs`).

mod attitudes;
mod interpolation;
mod kernel;
pub(crate) mod kinematics;
mod lanes;
mod rate_segment;
#[cfg(test)]
mod reference;
mod step;
mod sums;

#[cfg(test)]
mod tests;

use imucal_core::sensor::Triad;
use imucal_core::so3;
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use crate::recording::{Recording, Samples};

pub use crate::numerics::instructions::Instructions;
pub(crate) use attitudes::attitudes;
pub(crate) use interpolation::{Interpolation, are_equal_steps};
#[cfg(test)]
pub(crate) use rate_segment::STEPS_TAKEN;
pub use rate_segment::{RateSegment, SampleTimes};

/// Rotation over one move, and the sums from which its derivatives with respect to the parameters are computed. In the
/// sums, R is the rotation from the frame at a sample to the frame at the first sample.
#[derive(Clone, Copy, Debug)]
pub struct Preintegrated {
    /// Rotation from the frame at the last sample to the frame at the first sample: `v_start = rotation * v_end`.
    pub rotation: Matrix3<f64>,
    /// G_x, G_y, G_z: integrals of R times each component of the rate, rad.
    pub sensitivity_sums: [Matrix3<f64>; 3],
    /// G_b: integral of R, s.
    pub bias_sum: Matrix3<f64>,
}

/// Integrates the rotation from sample `first` to sample `last` of a recording. Between samples, the rate is a cubic
/// polynomial if the time steps permit it, otherwise linear (`docs/model.md` (17)).
pub(crate) fn integrate_rotation(
    recording: &Recording<'_>,
    first: usize,
    last: usize,
    gyroscope: &Triad<f64>,
) -> Matrix3<f64> {
    let paths = RateSegment::smooth(recording.time_s, recording.angular_rate, first, last);
    paths.fold(Matrix3::identity(), |rotation, path| rotation * path.rotation(gyroscope))
}

/// Integrates the rotation like [`integrate_rotation`]. Also returns the sums from which its derivatives are computed.
pub(crate) fn preintegrate(
    time_s: &[f64],
    rates: Samples<'_>,
    first: usize,
    last: usize,
    gyroscope: &Triad<f64>,
) -> (Matrix3<f64>, Sums) {
    let (mut rotation, mut sums) = (Matrix3::identity(), Sums::zero());
    for path in RateSegment::smooth(time_s, rates, first, last) {
        let (turn, added) = path.sums(gyroscope);
        sums.add_after(&rotation, &added);
        rotation *= turn;
    }
    (rotation, sums)
}

/// Integrates the rotation from sample `first` to sample `last` with linear interpolation of the rate, as in the
/// two-stage fit (`docs/model.md` (6)).
pub(crate) fn integrate_rotation_linear(
    recording: &Recording<'_>,
    first: usize,
    last: usize,
    gyroscope: &Triad<f64>,
) -> Matrix3<f64> {
    RateSegment::of(recording, first, last).rotation(gyroscope)
}

/// Computes the total rotation about each axis between two samples, rad: the integral of the absolute value of the rate
/// about the axis.
pub(crate) fn total_rotation_rad(
    recording: &Recording<'_>,
    first: usize,
    last: usize,
    gyroscope: &Triad<f64>,
) -> Vector3<f64> {
    let rate = |k: usize| gyroscope.correct(Vector3::from(recording.angular_rate.at(k)));
    let step = |k: usize| (rate(k) + rate(k + 1)) * ((recording.time_s[k + 1] - recording.time_s[k]) / 2.0);
    (first..last).map(|k| step(k).abs()).sum()
}

/// Integrals over a move, computed as sums over its samples. The derivatives of the move's rotation with respect to the
/// parameters of the gyroscope are computed from them. R is the rotation from the frame at a sample to the frame at the
/// first sample.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sums {
    /// G_x, G_y, G_z: integrals of R times each component of the rate, rad.
    pub(crate) sensitivity: [Matrix3<f64>; 3],
    /// G_b: integral of R, s.
    pub(crate) bias: Matrix3<f64>,
}

impl Sums {
    pub(crate) fn zero() -> Self {
        Self { sensitivity: [Matrix3::zeros(); 3], bias: Matrix3::zeros() }
    }

    /// Adds a sample to the sums by the trapezoidal rule. `weight` is R times the time that the sample represents, s.
    /// `rate` is the rate of the sample, rad/s.
    #[inline(always)]
    pub(crate) fn add_sample(&mut self, weight: &Matrix3<f64>, rate: &Vector3<f64>) {
        for (j, sum) in self.sensitivity.iter_mut().enumerate() {
            *sum += weight * rate[j];
        }
        self.bias += weight;
    }

    /// Adds the contribution of effects to the sums of R times the rate, over an interval. Effects are sensor errors
    /// that sensitivity and bias do not describe. `beyond` is the rate error due to the effects, rad/s. Its
    /// contribution is needed because the sensitivity multiplies the sum of the true rate and this error. `weight` is
    /// the integral of R over the interval, s.
    pub(crate) fn add_beyond(&mut self, weight: &Matrix3<f64>, beyond: &Vector3<f64>) {
        self.sensitivity.iter_mut().zip(beyond).for_each(|(sum, part)| *sum += weight * *part);
    }

    /// Adds the sums `other` of an interval. `before` is the rotation from the frame at the start of the interval to
    /// the frame at the start of the move.
    pub(crate) fn add_after(&mut self, before: &Matrix3<f64>, other: &Self) {
        for (sum, term) in self.sensitivity.iter_mut().zip(&other.sensitivity) {
            *sum += before * term;
        }
        self.bias += before * other.bias;
    }
}

/// Computes the rotation vector, rad, of a step of `h` seconds from its mean rate and the rates at its ends, rad/s.
#[inline(always)]
pub(crate) fn turn(mean: &Vector3<f64>, [w0, w1]: [&Vector3<f64>; 2], h: f64) -> Vector3<f64> {
    mean * h + w0.cross(w1) * (h * h / 12.0)
}

/// Multiplies `rotation` from the right by the rotation with the rotation vector `turn`, rad.
#[inline(always)]
fn rotate_by(rotation: &mut UnitQuaternion<f64>, turn: &Vector3<f64>) {
    *rotation *= so3::exp(turn);
    rotation.renormalize_fast();
}
