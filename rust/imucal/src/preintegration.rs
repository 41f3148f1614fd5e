//! Carrying gravity through the integrated gyroscope, and how that depends on the parameters (model.md (6), (7)).
//!
//! One pass over a move gives the rotation and the sums that serve every parameter. With the rate `w = T^-1 (m - b)`, the step
//! `phi = h wbar + h^2/12 (w0 x w1)` and `R <- R exp(phi)`, a change of the parameters turns the end attitude by `delta` on the body
//! side, `R exp(delta)`:
//!
//! ```text
//! d_delta_d_T_ij = -R^T G_j T^-1 e_i,   G_j = integral of R w_j dt
//! d_delta_d_b_i  = -R^T G_b T^-1 e_i,   G_b = integral of R dt
//! ```
//!
//! From rest to rest the trapezoid over the samples is as exact as they are close, and `R' = R [w]x` gives a third of the G_j from
//! where the path ends: with columns R_x, R_y, R_z the integral of `R_y w_z - R_z w_y` is what R_x changes by. In the midst of a turn it
//! is off by a twelfth of the square of the turn in a step. Where steps are short, sixteen are summed as one to the same sums.

mod attitudes;
mod between;
mod kernel;
pub(crate) mod kinematics;
mod lanes;
mod path;
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

pub(crate) use attitudes::attitudes;
pub(crate) use between::{Between, are_alike};
pub use lanes::Instructions;
#[cfg(test)]
pub(crate) use path::STEPS_TAKEN;
pub use path::{Pace, Path};

/// Rotation of one move and its derivative sums.
#[derive(Clone, Copy, Debug)]
pub struct Carried {
    /// `v_start = rotation * v_end`.
    pub rotation: Matrix3<f64>,
    /// G_x, G_y, G_z, rad.
    pub sensitivity_sums: [Matrix3<f64>; 3],
    /// G_b, s.
    pub bias_sum: Matrix3<f64>,
}

/// The rotation from sample `first` to sample `last` of a recording, as exact as the samples let it be.
pub(crate) fn rotate_smoothly(
    recording: &Recording<'_>,
    first: usize,
    last: usize,
    gyroscope: &Triad<f64>,
) -> Matrix3<f64> {
    let paths = Path::smooth(recording.time_s, recording.angular_rate, first, last);
    paths.fold(Matrix3::identity(), |rotation, path| rotation * path.rotation(gyroscope))
}

/// The same of any rates, and the sums.
pub(crate) fn carry_smoothly(
    time_s: &[f64],
    rates: Samples<'_>,
    first: usize,
    last: usize,
    gyroscope: &Triad<f64>,
) -> (Matrix3<f64>, Sums) {
    let (mut rotation, mut sums) = (Matrix3::identity(), Sums::zero());
    for path in Path::smooth(time_s, rates, first, last) {
        let (turn, added) = path.sums(gyroscope);
        sums.add_after(&rotation, &added);
        rotation *= turn;
    }
    (rotation, sums)
}

/// The same for a rate that goes straight from sample to sample, as a fit in two stages takes it.
pub(crate) fn rotate(recording: &Recording<'_>, first: usize, last: usize, gyroscope: &Triad<f64>) -> Matrix3<f64> {
    Path::of(recording, first, last).rotation(gyroscope)
}

/// How far the unit turned about each axis between two samples, rad, signs dropped.
pub(crate) fn turned_rad(recording: &Recording<'_>, first: usize, last: usize, gyroscope: &Triad<f64>) -> Vector3<f64> {
    let rate = |k: usize| gyroscope.correct(Vector3::from(recording.angular_rate.at(k)));
    let step = |k: usize| (rate(k) + rate(k + 1)) * ((recording.time_s[k + 1] - recording.time_s[k]) / 2.0);
    (first..last).map(|k| step(k).abs()).sum()
}

/// Sums over a move.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sums {
    /// G_x, G_y, G_z.
    pub(crate) sensitivity: [Matrix3<f64>; 3],
    /// G_b.
    pub(crate) bias: Matrix3<f64>,
}

impl Sums {
    pub(crate) fn zero() -> Self {
        Self { sensitivity: [Matrix3::zeros(); 3], bias: Matrix3::zeros() }
    }

    /// Adds a sample of a trapezoid: the rotation there times its share of the time, and the rate that the entries multiply.
    #[inline(always)]
    pub(crate) fn add_sample(&mut self, weight: &Matrix3<f64>, rate: &Vector3<f64>) {
        for (j, sum) in self.sensitivity.iter_mut().enumerate() {
            *sum += weight * rate[j];
        }
        self.bias += weight;
    }

    /// What the entries multiply has this much beyond the rate that turns, in a stretch with this weight.
    pub(crate) fn add_beyond(&mut self, weight: &Matrix3<f64>, beyond: &Vector3<f64>) {
        self.sensitivity.iter_mut().zip(beyond).for_each(|(sum, part)| *sum += weight * *part);
    }

    /// Adds the sums of a stretch that comes after a turn by `before`.
    pub(crate) fn add_after(&mut self, before: &Matrix3<f64>, other: &Self) {
        for (sum, term) in self.sensitivity.iter_mut().zip(&other.sensitivity) {
            *sum += before * term;
        }
        self.bias += before * other.bias;
    }
}

/// What a step of `h` seconds turns, rad, with this mean rate and these rates at its ends.
#[inline(always)]
pub(crate) fn turn(mean: &Vector3<f64>, [w0, w1]: [&Vector3<f64>; 2], h: f64) -> Vector3<f64> {
    mean * h + w0.cross(w1) * (h * h / 12.0)
}

/// Turns on by so many rad.
#[inline(always)]
fn turn_on(rotation: &mut UnitQuaternion<f64>, turn: &Vector3<f64>) {
    *rotation *= so3::exp(turn);
    rotation.renormalize_fast();
}
