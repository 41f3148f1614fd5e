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
//! where the path ends: with columns R_x, R_y, R_z the integral of `R_y w_z - R_z w_y` is what R_x changes by. In the midst of a turn it is off by a twelfth of
//! the square of the turn in a step, so a walk that stops there takes what a step really does:
//!
//! ```text
//! G_j = sum_k A_k (h wbar_j I + [e_j x q]x),   q = h^2/12 (w0 x w1),   [e_j x q]x = q e_j^T - e_j q^T
//! G_b = sum_k A_k (h I + h^2/12 [w0 - w1]x)
//! A_k = R_k J_l(phi_k),   R_k the attitude before step k, J_l the left Jacobian of the rotation vector
//! ```

mod between;
mod kernel;
mod lanes;
mod path;
mod step;

#[cfg(test)]
mod tests;

use imucal_core::sensor::Triad;
use imucal_core::so3;
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use crate::recording::{Recording, Samples};

pub(crate) use between::Between;
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
    /// G_x, G_y, G_z but for the coning's part that is the same for all: `sum A_k (h wbar_j I - e_j q^T)` for each j.
    by_turn: [Matrix3<f64>; 3],
    /// `sum A_k q`; a trapezoid has none.
    coning: Vector3<f64>,
    /// G_b.
    pub(crate) bias: Matrix3<f64>,
}

impl Sums {
    pub(crate) fn zero() -> Self {
        Self { by_turn: [Matrix3::zeros(); 3], coning: Vector3::zeros(), bias: Matrix3::zeros() }
    }

    /// Takes a step of `h` seconds between two samples of the rate: `turn` is the integral of the rate over it, and `seen` that
    /// of the rate that the entries multiply, which has effects in it. The result is A.
    #[inline(always)]
    pub(crate) fn step(
        &mut self,
        rotation: &mut Matrix3<f64>,
        h: f64,
        [w0, w1]: [&Vector3<f64>; 2],
        turn: &Vector3<f64>,
        seen: &Vector3<f64>,
    ) -> Matrix3<f64> {
        let coning = h * h / 12.0;
        let q = w0.cross(w1) * coning;
        let phi = turn + q;
        let (sine, cosine, cubic) = coefficients(phi.norm_squared());
        let once = times_hat(rotation, &phi);
        let twice = times_hat(&once, &phi);
        let a = *rotation + once * cosine + twice * cubic;
        *rotation += once * sine + twice * cosine;
        for j in 0..3 {
            for k in 0..3 {
                let column = a.column(k) * seen[j] - a.column(j) * q[k];
                self.by_turn[j].set_column(k, &(self.by_turn[j].column(k) + column));
            }
        }
        self.coning += a * q;
        self.bias += a * h + times_hat(&a, &((w0 - w1) * coning));
        a
    }

    /// Adds a sample of a trapezoid: the rotation there times its share of the time, and the rate that the entries multiply.
    #[inline(always)]
    pub(crate) fn add_sample(&mut self, weight: &Matrix3<f64>, rate: &Vector3<f64>) {
        for (j, sum) in self.by_turn.iter_mut().enumerate() {
            *sum += weight * rate[j];
        }
        self.bias += weight;
    }

    /// What the entries multiply has this much beyond the rate that turns, in a stretch with this weight.
    pub(crate) fn add_beyond(&mut self, weight: &Matrix3<f64>, beyond: &Vector3<f64>) {
        self.by_turn.iter_mut().zip(beyond).for_each(|(sum, part)| *sum += weight * *part);
    }

    pub(crate) fn add(&mut self, other: &Self) {
        for (sum, term) in self.by_turn.iter_mut().zip(&other.by_turn) {
            *sum += term;
        }
        self.coning += other.coning;
        self.bias += other.bias;
    }

    /// Adds the sums of a stretch that comes after a turn by `before`.
    pub(crate) fn add_after(&mut self, before: &Matrix3<f64>, other: &Self) {
        for (sum, term) in self.by_turn.iter_mut().zip(&other.by_turn) {
            *sum += before * term;
        }
        self.coning += before * other.coning;
        self.bias += before * other.bias;
    }

    /// G_x, G_y, G_z.
    pub(crate) fn sensitivity(&self) -> [Matrix3<f64>; 3] {
        let mut sums = self.by_turn;
        for (j, sum) in sums.iter_mut().enumerate() {
            sum.set_column(j, &(sum.column(j) + self.coning));
        }
        sums
    }
}

/// Turns on by a step of `h` seconds with this mean rate and these rates at its ends.
#[inline(always)]
pub(crate) fn turn_on(rotation: &mut UnitQuaternion<f64>, mean: &Vector3<f64>, [w0, w1]: [&Vector3<f64>; 2], h: f64) {
    *rotation *= so3::exp(&(mean * h + w0.cross(w1) * (h * h / 12.0)));
    rotation.renormalize_fast();
}

/// `m [v]x`.
#[inline(always)]
pub(crate) fn times_hat(m: &Matrix3<f64>, v: &Vector3<f64>) -> Matrix3<f64> {
    let (x, y, z) = (m.column(0), m.column(1), m.column(2));
    Matrix3::from_columns(&[y * v.z - z * v.y, z * v.x - x * v.z, x * v.y - y * v.x])
}

/// Coefficients `(-1)^k / (2k + first)!` of two even series in the angle.
const COSINE: [f64; 7] = alternating(2);
const CUBIC: [f64; 7] = alternating(3);

const fn alternating(first: u32) -> [f64; 7] {
    let mut coefficients = [0.0; 7];
    let mut factorial = 1.0;
    let mut n = 1;
    while n <= first {
        factorial *= n as f64;
        n += 1;
    }
    let mut k = 0;
    while k < 7 {
        coefficients[k] = if k % 2 == 0 { 1.0 / factorial } else { -1.0 / factorial };
        factorial *= n as f64 * (n + 1) as f64;
        n += 2;
        k += 1;
    }
    coefficients
}

#[inline]
fn horner(coefficients: &[f64; 7], x: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, c| sum * x + c)
}

/// `sin t / t`, `(1 - cos t) / t^2` and `(t - sin t) / t^3` of the squared angle: the rotation is `I + a [phi]x + b [phi]x^2`, its
/// left Jacobian `I + b [phi]x + c [phi]x^2`.
#[inline(always)]
fn coefficients(t2: f64) -> (f64, f64, f64) {
    if t2 < 0.25 {
        // The next terms are below 2^-53 for t < 1/2.
        let cubic = horner(&CUBIC, t2);
        (1.0 - t2 * cubic, horner(&COSINE, t2), cubic)
    } else {
        let t = t2.sqrt();
        (t.sin() / t, (1.0 - t.cos()) / t2, (t - t.sin()) / (t2 * t))
    }
}
