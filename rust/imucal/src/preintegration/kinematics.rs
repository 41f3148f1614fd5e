//! Computes a start value of the gyroscope's sensitivity by a linear fit to the motion of gravity in the body frame
//! during moves (`docs/model.md` (10)).
//!
//! In the body frame, the direction u of gravity changes by `du/dt = u x w`. The rate is `w = P (m - b)`, where P is
//! the inverse of the sensitivity, m the measured rate and b the bias. The direction u is measured by the accelerometer
//! and averaged over short blocks. Each pair of consecutive blocks, with the mean direction ubar, gives three equations
//! that are linear in the nine entries of P:
//!
//! ```text
//! u_(j+1) - u_j = [ubar]x P s,   s = integral of (m - b) between the centres of the blocks
//! ```
//!
//! The accelerometer also measures the acceleration of the motion, so the accuracy is only a few per cent. This is
//! sufficient for a start value with any raw unit, sign and order of axes, and for the detection of wrong units and
//! axes.

use imucal_core::sensor::Triad;
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use crate::recording::Recording;
use crate::rests::moves::Move;

/// The motion determines P only if the unit rotates enough about every axis. The sum of squared rotations about the
/// least rotated axis must be at least this share of the sum about the most rotated axis.
const LEAST_TURN_SHARE: f64 = 0.01;
/// Length of a block over which the gravity direction u is averaged, s.
const BLOCK_S: f64 = 0.1;

/// If the rms change of the gravity direction over [`BLOCK_S`] is below this limit, rad, [`RateFromGravity::explained`]
/// is set to 1. The limit corresponds to a rotation at 6 deg/s. White accelerometer noise of the density N = 0.4
/// mg/sqrt(Hz) (model.md (10)) causes an rms change of 2 N / sqrt(0.1 s) = 0.0025 rad, which is a quarter of the limit.
const LEAST_CHANGE_RAD: f64 = 0.01;

/// Relation between the measured rates and the rotation of gravity in the body frame.
pub(crate) struct RateFromGravity {
    /// The matrix P in `true rate = P (raw - bias)`.
    pub(crate) rate_from_raw: Matrix3<f64>,
    /// Share of the (weighted) squared changes of the gravity direction that is explained by the rates and this P. It
    /// is close to 1 on a stand, about 0.8 for vigorous hand-held moves, and small if the sensors did not move
    /// together. It is 1 if the unit rotates so slowly that noise may dominate the changes ([`LEAST_CHANGE_RAD`]).
    pub(crate) explained: f64,
}

/// Estimates the matrix P of [`RateFromGravity`] from the moves; `None` if the motion does not determine it.
pub(crate) fn rate_from_gravity(
    recordings: &[Recording<'_>],
    moves: &[Move],
    accelerometer: &Triad<f64>,
    gyroscope_bias: Vector3<f64>,
) -> Option<RateFromGravity> {
    let mut equations = Vec::new();
    for m in moves {
        pairs(&recordings[m.recording], m, accelerometer, gyroscope_bias, &mut equations);
    }
    // If the unit hardly rotates about an axis, only noise determines the column of P for this axis.
    let turns: Matrix3<f64> = equations.iter().map(|e: &Pair| e.turn * e.turn.transpose()).sum();
    let energies = turns.symmetric_eigenvalues();
    if energies.min() < LEAST_TURN_SHARE * energies.max() {
        return None;
    }
    let size = (equations.iter().map(|e| e.turn.norm_squared()).sum::<f64>() / equations.len().max(1) as f64).sqrt();
    let mut weights = vec![1.0; equations.len()];
    let mut found = None;
    // The fit is repeated twice with new weights, which reduce the influence of jolts in hand-held moves.
    for _ in 0..3 {
        let rate_from_raw = solve(&equations, &weights, size)?;
        let (mut left, mut all, mut total) = (0.0, 0.0, 0.0);
        for (weight, equation) in weights.iter_mut().zip(&equations) {
            let misfit = equation.change - equation.up.cross(&(rate_from_raw * equation.turn));
            left += *weight * misfit.norm_squared();
            all += *weight * equation.change.norm_squared();
            total += *weight;
            *weight = 1.0 / (0.05 + misfit.norm());
        }
        let explained = if all < LEAST_CHANGE_RAD.powi(2) * total { 1.0 } else { 1.0 - left / all };
        found = Some(RateFromGravity { rate_from_raw, explained });
    }
    found.filter(|found| found.rate_from_raw.iter().all(|entry| entry.is_finite()))
}

/// Estimates a common scale of all axes of the gyroscope in `true rate = scale (raw - bias)`. It is used if the motion
/// does not determine the matrix P of `true rate = P (raw - bias)`. `None` if there is no motion.
pub(crate) fn scale_from_gravity(
    recordings: &[Recording<'_>],
    moves: &[Move],
    accelerometer: &Triad<f64>,
    gyroscope_bias: Vector3<f64>,
) -> Option<f64> {
    let mut equations = Vec::new();
    for m in moves {
        pairs(&recordings[m.recording], m, accelerometer, gyroscope_bias, &mut equations);
    }
    let seen = |e: &Pair| e.up.cross(&e.turn);
    let scale = equations.iter().map(|e| seen(e).dot(&e.change)).sum::<f64>()
        / equations.iter().map(|e| seen(e).norm_squared()).sum::<f64>();
    (scale.is_finite() && scale != 0.0).then_some(scale)
}

/// A pair of consecutive blocks: the mean ubar of the gravity directions of the two blocks, the change of the direction
/// from the first to the second block, and the integral s of (raw rate - bias) between the centres of the blocks.
struct Pair {
    up: Vector3<f64>,
    change: Vector3<f64>,
    turn: Vector3<f64>,
}

fn pairs(recording: &Recording<'_>, m: &Move, accelerometer: &Triad<f64>, bias: Vector3<f64>, pairs: &mut Vec<Pair>) {
    let dt_s = m.interval_s;
    // A block has an even number of samples, so that its centre is between two samples. The number is limited, because
    // time stamps that hardly increase would give a far larger number of samples than the move has.
    let block = ((BLOCK_S / dt_s / 2.0).round() as usize).clamp(1, m.last + 1 - m.first) * 2;
    let up = |start: usize| {
        let sum: Vector3<f64> = recording.specific_force.slice(start..start + block).iter().map(Vector3::from).sum();
        accelerometer.correct(sum / block as f64).normalize()
    };
    let (mut start, mut before) = (m.first, None);
    while start + 2 * block <= m.last + 1 {
        let (first, second) = (before.unwrap_or_else(|| up(start)), up(start + block));
        let turn: Vector3<f64> = recording
            .angular_rate
            .slice(start + block / 2..start + block + block / 2)
            .iter()
            .map(|w| Vector3::from(w) - bias)
            .sum();
        pairs.push(Pair { up: (first + second) / 2.0, change: second - first, turn: turn * dt_s });
        (start, before) = (start + block, Some(second));
    }
}

/// Solves the weighted normal equations for the nine entries of P, in row-major order.
fn solve(pairs: &[Pair], weights: &[f64], size: f64) -> Option<Matrix3<f64>> {
    // The equation of a pair of blocks is change = [ubar]x P s, with ubar = `pair.up` and s = `pair.turn`. Its design
    // matrix is the Kronecker product of [ubar]x and s^T. The normal matrix of the pair is therefore the Kronecker
    // product of [ubar]x^T [ubar]x and s s^T.
    let mut blocks = [[Matrix3::<f64>::zeros(); 3]; 3];
    let mut right = [Vector3::zeros(); 3];
    for (pair, weight) in pairs.iter().zip(weights) {
        let turn = pair.turn / size;
        let squares = turn * turn.transpose() * *weight;
        let across = Matrix3::from_diagonal_element(pair.up.norm_squared()) - pair.up * pair.up.transpose();
        let seen = pair.change.cross(&pair.up) * *weight;
        for i in 0..3 {
            right[i] += turn * seen[i];
            for j in 0..=i {
                blocks[i][j] += squares * across[(i, j)];
            }
        }
    }
    // The factorisation uses only the lower triangle of the normal matrix.
    let normal = SMatrix::<f64, 9, 9>::from_fn(|row, column| blocks[row / 3][column / 3][(row % 3, column % 3)]);
    let right = SVector::<f64, 9>::from_fn(|row, _| right[row / 3][row % 3]);
    // Slight damping makes the factorisation possible even if the moves do not determine some entries of P. These
    // entries are then near zero.
    let damping = 1e-9 * normal.trace();
    let factor = (normal + SMatrix::identity() * damping).cholesky()?;
    Some(Matrix3::from_row_slice(factor.solve(&right).as_slice()) / size)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_scale_sign_and_order_of_the_axes_in_any_unit() {
        // Simulates a tumble at up to 1.5 rad/s per axis. The gyroscope reads in counts. The axes of the gyroscope are
        // rotated: its x axis measures the rate about -y of the body, and its y axis measures the rate about x.
        let sensitivity = Matrix3::new(0.0, -4000.0, 50.0, 4200.0, 0.0, 0.0, 0.0, 80.0, 4100.0);
        let gyroscope = Triad::try_new(sensitivity, Vector3::new(32000.0, 33000.0, 32500.0)).unwrap();
        let (mut time, mut force, mut rate) = (vec![], Vec::<[f64; 3]>::new(), Vec::<[f64; 3]>::new());
        let mut integrator = imucal_core::integrate::Integrator::new();
        for k in 0..2000 {
            let t = f64::from(k) * 0.005;
            let w = Vector3::new((1.3 * t).sin(), (0.9 * t).cos(), (2.1 * t + 1.0).sin()) * 1.5;
            integrator.push(0.005, w);
            time.push(t);
            force.push((integrator.rotation().inverse() * Vector3::z() * 9.81).into());
            rate.push(gyroscope.measure(w).into());
        }
        let recording = Recording::try_new("tumble", &time, &force, &rate).unwrap();
        let whole = Move { recording: 0, from: 0, to: 1, first: 0, last: 1999, duration_s: 10.0, interval_s: 0.005 };
        let found = rate_from_gravity(&[recording], &[whole], &Triad::identity(), *gyroscope.bias()).unwrap();
        let product = found.rate_from_raw * sensitivity;
        assert!((product - Matrix3::identity()).norm() < 0.05, "{product}");
        assert!(found.explained > 0.99, "{}", found.explained);
    }

    #[test]
    fn time_stamps_that_hardly_increase_determine_nothing() {
        let time: Vec<f64> = (0..100).map(|k| f64::from(k) * 1e-300).collect();
        let (force, rate) = (vec![[0.0, 0.0, 9.81]; 100], vec![[0.1, 0.2, 0.3]; 100]);
        let recording = Recording::try_new("compressed", &time, &force, &rate).unwrap();
        let whole = Move { recording: 0, from: 0, to: 1, first: 0, last: 99, duration_s: 1e-298, interval_s: 1e-300 };
        assert!(scale_from_gravity(&[recording], &[whole], &Triad::identity(), Vector3::zeros()).is_none());
    }
}
