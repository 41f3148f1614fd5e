//! Carrying gravity through the integrated gyroscope, and how that depends on the parameters (model.md (6), (7)).
//!
//! One pass over a move gives the rotation and the sums that serve every parameter. With the rate
//! `w = T^-1 (m - b)`, the step `phi = h/2 (w0 + w1) + h^2/12 (w0 x w1)` and `R <- R exp(phi)`, a change of the
//! parameters turns the end attitude by `delta` on the body side, `R exp(delta)`:
//!
//! ```text
//! d_delta_d_T_ij = -R^T G_j T^-1 e_i,   G_j = sum_k A_k (h wbar_j I + h^2/12 (w1_j [w0]x - w0_j [w1]x))
//! d_delta_d_b_i  = -R^T G_b T^-1 e_i,   G_b = sum_k A_k (h I        + h^2/12 (     [w0]x -      [w1]x))
//! A_k = R_k J_l(phi_k),   R_k the attitude before step k, J_l the left Jacobian of the rotation vector
//! ```

use imucal_core::integrate::Integrator;
use imucal_core::sensor::Triad;
use imucal_core::so3::hat;
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
    let mut sensitivity_sums = [Matrix3::zeros(); 3];
    let mut bias_sum = Matrix3::zeros();
    let mut turned_rad = Vector3::zeros();
    let mut w0 = gyroscope.correct(Vector3::from(recording.angular_rate[first]));
    let mut hat0 = hat(&w0);
    let times = recording.time_s[first..=last].windows(2);
    for (pair, raw) in times.zip(&recording.angular_rate[first + 1..=last]) {
        let h = pair[1] - pair[0];
        let w1 = gyroscope.correct(Vector3::from(*raw));
        let hat1 = hat(&w1);
        let mean = (w0 + w1) / 2.0;
        let phi = mean * h + w0.cross(&w1) * (h * h / 12.0);
        let (exp, left_jacobian) = exp_and_left_jacobian(&phi);

        let a = rotation * left_jacobian;
        let coning = h * h / 12.0;
        let (a0, a1) = (a * hat0 * coning, a * hat1 * coning);
        for j in 0..3 {
            sensitivity_sums[j] += a * (h * mean[j]) + a0 * w1[j] - a1 * w0[j];
        }
        bias_sum += a * h + a0 - a1;
        turned_rad += mean.abs() * h;

        rotation *= exp;
        (w0, hat0) = (w1, hat1);
    }
    Carried { rotation, sensitivity_sums, bias_sum, turned_rad }
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

/// Coefficients `(-1)^k / (2k + first)!` of the three even series in the angle.
const SINE: [f64; 7] = alternating(1);
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

/// `exp(phi)` and the left Jacobian, `I + a [phi]x + b [phi]x^2` and `I + b [phi]x + c [phi]x^2`.
#[inline]
pub(crate) fn exp_and_left_jacobian(phi: &Vector3<f64>) -> (Matrix3<f64>, Matrix3<f64>) {
    let t2 = phi.norm_squared();
    let (a, b, c) = if t2 < 0.25 {
        // sin t / t, (1 - cos t) / t^2 and (t - sin t) / t^3: the next terms are below 2^-53 for t < 1/2.
        (horner(&SINE, t2), horner(&COSINE, t2), horner(&CUBIC, t2))
    } else {
        let t = t2.sqrt();
        (t.sin() / t, (1.0 - t.cos()) / t2, (t - t.sin()) / (t2 * t))
    };
    let hat = hat(phi);
    let square = phi * phi.transpose() - Matrix3::from_diagonal_element(t2);
    let identity = Matrix3::identity();
    (identity + hat * a + square * b, identity + hat * b + square * c)
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
            let (exp, left) = exp_and_left_jacobian(&phi);
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
