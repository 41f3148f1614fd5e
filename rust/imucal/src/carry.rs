//! Carrying gravity through the integrated gyroscope, and how that depends on the parameters (model.md (6), (7)).
//!
//! One pass over a move gives the rotation and the sums that serve every parameter. With the rate
//! `w = T^-1 (m - b)`, the step `phi = s + q`, `s = h/2 (w0 + w1)`, `q = h^2/12 (w0 x w1)` and `R <- R exp(phi)`, a change of
//! the parameters turns the end attitude by `delta` on the body side, `R exp(delta)`:
//!
//! ```text
//! d_delta_d_T_ij = -R^T G_j T^-1 e_i,   G_j = sum_k A_k (s_j I + [e_j x q]x),   [e_j x q]x = q e_j^T - e_j q^T
//! d_delta_d_b_i  = -R^T G_b T^-1 e_i,   G_b = sum_k A_k (h I + h^2/12 [w0 - w1]x)
//! A_k = R_k J_l(phi_k),   R_k the attitude before step k, J_l the left Jacobian of the rotation vector
//! ```

use imucal_core::integrate::Integrator;
use imucal_core::sensor::Triad;
use nalgebra::{Matrix3, Vector3};

use crate::recording::Recording;

/// Rotation of one move and its derivative sums.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Carried {
    /// `v_start = rotation * v_end`.
    pub(crate) rotation: Matrix3<f64>,
    /// G_x, G_y, G_z.
    pub(crate) sensitivity_sums: [Matrix3<f64>; 3],
    /// G_b.
    pub(crate) bias_sum: Matrix3<f64>,
    /// How far the unit turned about each axis, rad, signs dropped.
    pub(crate) turned_rad: Vector3<f64>,
}

/// Integrates samples `first..=last` of the gyroscope.
pub(crate) fn carry(recording: &Recording<'_>, first: usize, last: usize, gyroscope: &Triad<f64>) -> Carried {
    let mut rotation = Matrix3::identity();
    let mut sums = Sums::zero();
    let mut turned_rad = Vector3::zeros();
    let mut w0 = gyroscope.correct(Vector3::from(recording.angular_rate[first]));
    let times = recording.time_s[first..=last].windows(2);
    for (pair, raw) in times.zip(&recording.angular_rate[first + 1..=last]) {
        let h = pair[1] - pair[0];
        let w1 = gyroscope.correct(Vector3::from(*raw));
        let turn = (w0 + w1) * (h / 2.0);
        sums.step(&mut rotation, h, [&w0, &w1], &turn, &turn);
        turned_rad += turn.abs();
        w0 = w1;
    }
    Carried { rotation, sensitivity_sums: sums.sensitivity(), bias_sum: sums.bias, turned_rad }
}

/// Sums over the steps of a move.
#[derive(Clone, Copy)]
pub(crate) struct Sums {
    /// `sum A_k (s_j I - e_j q^T)` for each j.
    by_turn: [Matrix3<f64>; 3],
    /// `sum A_k q`.
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

    pub(crate) fn add(&mut self, other: &Self) {
        for (sum, term) in self.by_turn.iter_mut().zip(&other.by_turn) {
            *sum += term;
        }
        self.coning += other.coning;
        self.bias += other.bias;
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

/// `m [v]x`.
#[inline(always)]
fn times_hat(m: &Matrix3<f64>, v: &Vector3<f64>) -> Matrix3<f64> {
    let (x, y, z) = (m.column(0), m.column(1), m.column(2));
    Matrix3::from_columns(&[y * v.z - z * v.y, z * v.x - x * v.z, x * v.y - y * v.x])
}

/// The rotation alone: as [`carry`], but without derivatives.
pub(crate) fn rotate(recording: &Recording<'_>, first: usize, last: usize, gyroscope: &Triad<f64>) -> Matrix3<f64> {
    let mut integrator = Integrator::new();
    let mut before = recording.time_s[first];
    for (&time, raw) in recording.time_s[first..=last].iter().zip(&recording.angular_rate[first..=last]) {
        integrator.push(time - before, gyroscope.correct(Vector3::from(*raw)));
        before = time;
    }
    *integrator.rotation().to_rotation_matrix().matrix()
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

#[cfg(test)]
mod tests {
    use super::*;
    use imucal_core::so3;

    /// A tumbling gyroscope, 100 Hz for 2 s, in raw units of a unit that is far from perfect.
    fn tumble() -> (Vec<f64>, Vec<[f64; 3]>, Triad<f64>) {
        let time: Vec<f64> = (0..200).map(|k| k as f64 * 0.01).collect();
        let sensitivity = Matrix3::new(1.1, 0.05, -0.02, 0.03, 0.9, 0.04, -0.06, 0.01, 1.05);
        let triad = Triad::try_new(sensitivity, Vector3::new(0.1, -0.2, 0.05)).unwrap();
        let rate = |t: &f64| Vector3::new((3.0 * t).sin() * 4.0, (2.0 * t).cos() * 3.0, (5.0 * t).sin() * 2.0);
        let raw = time.iter().map(|t| triad.measure(rate(t)).into()).collect();
        (time, raw, triad)
    }

    fn carry_with(triad: &Triad<f64>, time: &[f64], raw: &[[f64; 3]]) -> Carried {
        let recording = Recording::try_new("tumble", time, raw, raw).unwrap();
        carry(&recording, 0, time.len() - 1, triad)
    }

    #[test]
    fn the_rotation_is_that_of_the_streaming_integrator() {
        let (time, raw, triad) = tumble();
        let recording = Recording::try_new("tumble", &time, &raw, &raw).unwrap();
        let streamed = rotate(&recording, 0, time.len() - 1, &triad);
        let batch = carry_with(&triad, &time, &raw).rotation;
        let difference = batch.transpose() * streamed;
        assert!((difference - Matrix3::identity()).norm() < 1e-13);
    }

    #[test]
    fn both_branches_of_the_series_agree_with_the_core() {
        for length in [0.0, 1e-9, 1e-3, 0.3, 0.499_999, 0.500_001, 2.0] {
            let phi = Vector3::new(0.48, -0.6, 0.64) * length;
            let mut exp = Matrix3::identity();
            let left = Sums::zero().step(&mut exp, 1.0, [&phi, &phi], &phi, &Vector3::zeros());
            assert!((exp - so3::exp(&phi).to_rotation_matrix().matrix()).norm() < 4e-15, "{length}");
            assert!((left - so3::right_jacobian(&phi).transpose()).norm() < 4e-15, "{length}");
        }
    }

    #[test]
    fn derivatives_meet_finite_differences() {
        let (time, raw, triad) = tumble();
        let carried = carry_with(&triad, &time, &raw);
        let delta = |sensitivity: Matrix3<f64>, bias: Vector3<f64>| {
            let moved = carry_with(&Triad::try_new(sensitivity, bias).unwrap(), &time, &raw).rotation;
            // The turn is tiny: its vector is the antisymmetric part. An arc cosine would lose half of the digits.
            let turn = carried.rotation.transpose() * moved;
            Vector3::new(turn.m32 - turn.m23, turn.m13 - turn.m31, turn.m21 - turn.m12) / 2.0
        };
        let step = 1e-6;
        let unit = |i: usize| Vector3::from_fn(|k, _| f64::from(u8::from(k == i)));
        for i in 0..3 {
            let column = triad.inverse() * unit(i);
            for j in 0..3 {
                let mut change = Matrix3::zeros();
                change[(i, j)] = step;
                let (plus, minus) = (triad.sensitivity() + change, triad.sensitivity() - change);
                let difference = (delta(plus, *triad.bias()) - delta(minus, *triad.bias())) / (2.0 * step);
                let analytic = -carried.rotation.tr_mul(&(carried.sensitivity_sums[j] * column));
                assert!((difference - analytic).norm() < 1e-7, "T_{i}{j}: {difference} {analytic}");
            }
            let (plus, minus) = (triad.bias() + unit(i) * step, triad.bias() - unit(i) * step);
            let sensitivity = *triad.sensitivity();
            let difference = (delta(sensitivity, plus) - delta(sensitivity, minus)) / (2.0 * step);
            let analytic = -carried.rotation.tr_mul(&(carried.bias_sum * column));
            assert!((difference - analytic).norm() < 1e-7, "b_{i}: {difference} {analytic}");
        }
    }
}
