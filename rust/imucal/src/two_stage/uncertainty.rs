//! Computes the covariance of the parameters that the two-stage fit estimates (model.md (9)).
//!
//! Both stages use the same rests. Errors of mean readings therefore affect the gyroscope in three ways: through the
//! gravity directions, through the parameters of the accelerometer, and through the gyroscope bias. To first order, the
//! error of every parameter is a linear function of independent errors: three errors of each mean force (one per axis),
//! three of each mean rate, and two of each move (one per direction residual). The covariance is computed from the
//! variances of these errors. If an accelerometer is calibrated without a gyroscope, some parameters may have priors.
//! The covariance then includes the effect of the uncertainty of these priors on all parameters, to second order.

use faer::Mat;
use nalgebra::{Matrix2x3, Matrix3, SMatrix, SVector, Vector3};

use crate::frame::SYMMETRIC;
use crate::rests::moves::{Ends, Move};
use crate::rests::rest::{Rest, RestMean, rounding_covariance};
use crate::two_stage::accelerometer::AccelerometerFit;
use crate::two_stage::gyroscope::{GyroscopeBias, GyroscopeFit, residual_gradient};

/// Computes the covariance of all parameters, 21 x 21, raw units. The parameters refer to the symmetric frame, which is
/// the body frame in which the accelerometer sensitivity is a symmetric matrix. The order is: accelerometer bias, the
/// six entries of its sensitivity, gyroscope bias, the nine entries of its sensitivity.
///
/// For each move, `random_walk_rad` contains the standard deviation, rad, of the part of the direction residual that is
/// not due to the noise of the mean readings at rest.
pub(crate) fn covariance(
    rests: &[&Rest],
    moves: &[Move],
    ends: &[Ends],
    accelerometer: &AccelerometerFit,
    bias: &GyroscopeBias,
    gyroscope: &GyroscopeFit,
    random_walk_rad: &[f64],
) -> Mat<f64> {
    let (k, m) = (rests.len(), moves.len());
    // Derivatives of the parameters (rows) with respect to the errors (columns). The columns are the errors of the mean
    // forces (3 k), of the mean rates (3 k), and of the moves (2 m).
    let mut map = Mat::<f64>::zeros(21, 6 * k + 2 * m);
    accelerometer_rows(&mut map, rests, accelerometer);
    for (rest, weight) in bias.weights.iter().enumerate() {
        for axis in 0..3 {
            map[(9 + axis, 3 * (k + rest) + axis)] = weight[axis];
        }
    }
    gyroscope_rows(&mut map, rests, moves, ends, accelerometer, gyroscope);

    // The inflation factor of a stage is above 1 if its residuals are significantly larger than noise. The factor of
    // the accelerometer stage multiplies the standard deviations of the mean forces. The factor of the gyroscope stage
    // multiplies the standard deviations of the moves.
    let (widen_rests, widen_moves) = (accelerometer.report.inflation, gyroscope.report.inflation);
    let deviation = |column: usize| {
        let (item, axis) = (column / 3, column % 3);
        if item < k {
            rests[item].specific_force.variance_of_mean[axis].sqrt() * widen_rests
        } else if item < 2 * k {
            (rests[item - k].angular_rate.variance_of_mean[axis] + bias.between[axis]).sqrt()
        } else {
            random_walk_rad[(column - 6 * k) / 2] * widen_moves
        }
    };
    let scaled = Mat::from_fn(21, map.ncols(), |i, column| map[(i, column)] * deviation(column));
    let mut covariance = &scaled * scaled.transpose();
    // Rests with equal readings have equal rounding errors, so the covariance of rounding errors is not diagonal.
    let forces: Vec<&RestMean> = rests.iter().map(|rest| &rest.specific_force).collect();
    let rates: Vec<&RestMean> = rests.iter().map(|rest| &rest.angular_rate).collect();
    for (first, means, axis) in
        [(0, &forces), (3 * k, &rates)].into_iter().flat_map(|(f, m)| [0, 1, 2].map(|a| (f, m, a)))
    {
        if let Some(own) = rounding_covariance(means, axis) {
            let by = Mat::from_fn(21, k, |i, rest| map[(i, first + 3 * rest + axis)]);
            covariance += &by * own * by.transpose();
        }
    }
    covariance
}

/// Computes the covariance of the nine parameters of an accelerometer without a gyroscope, raw units. The order is:
/// bias x, y, z, and then the entries xx, yy, zz, xy, xz, yz of the sensitivity.
pub(crate) fn accelerometer_covariance(rests: &[&Rest], fit: &AccelerometerFit) -> Mat<f64> {
    let mut map = Mat::<f64>::zeros(9, 3 * rests.len());
    accelerometer_rows(&mut map, rests, fit);
    let variance = |column: usize| rests[column / 3].specific_force.variance_of_mean[column % 3];
    let scaled =
        Mat::from_fn(9, map.ncols(), |i, column| map[(i, column)] * variance(column).sqrt() * fit.report.inflation);
    let mut covariance = &scaled * scaled.transpose();
    covariance += &fit.prior_gain * fit.prior_gain.transpose();
    covariance += &fit.second_order;
    let forces: Vec<&RestMean> = rests.iter().map(|rest| &rest.specific_force).collect();
    for axis in 0..3 {
        if let Some(own) = rounding_covariance(&forces, axis) {
            let by = Mat::from_fn(9, rests.len(), |i, rest| map[(i, 3 * rest + axis)]);
            covariance += &by * own * by.transpose();
        }
    }
    covariance
}

/// Writes the derivatives of the nine accelerometer parameters with respect to the errors of the mean forces to `map`.
fn accelerometer_rows(map: &mut Mat<f64>, rests: &[&Rest], fit: &AccelerometerFit) {
    for (rest, r) in rests.iter().enumerate() {
        let up = fit.triad.correct(r.specific_force.mean).normalize();
        let v = fit.triad.inverse().tr_mul(&up);
        for axis in 0..3 {
            for i in 0..9 {
                map[(i, 3 * rest + axis)] = -fit.gain[(i, rest)] * v[axis];
            }
        }
    }
}

/// Writes the derivatives of the nine entries of the gyroscope sensitivity with respect to all errors of rests and
/// moves to `map`. These derivatives are the negative product of two matrices: the gain of the fit, which is
/// `(J^T J)^-1 J^T / sigma` for the whitened Jacobian J and the standard deviations sigma of the residuals, and the
/// derivatives of the residuals with respect to the errors.
///
/// The derivatives with respect to the accelerometer parameters and the gyroscope bias are first summed over the moves.
/// The computing time is then proportional to the number of moves instead of its square.
fn gyroscope_rows(
    map: &mut Mat<f64>,
    rests: &[&Rest],
    moves: &[Move],
    ends: &[Ends],
    accelerometer: &AccelerometerFit,
    gyroscope: &GyroscopeFit,
) {
    let k = rests.len();
    let directions: Vec<_> = rests.iter().map(|rest| direction_gradients(rest, accelerometer)).collect();
    let mut by_parameters = SMatrix::<f64, 9, 9>::zeros();
    let mut by_bias = SMatrix::<f64, 9, 3>::zeros();
    for (index, ((m, end), preintegrated)) in moves.iter().zip(ends).zip(&gyroscope.preintegrated).enumerate() {
        let gain = SMatrix::<f64, 9, 2>::from_fn(|i, c| gyroscope.gain[(i, 2 * index + c)]);
        let gradient = residual_gradient(end, preintegrated, &gyroscope.triad);
        by_bias += gain * Matrix2x3::from_columns(&gradient[9..]);
        let before = gain * end.across() * preintegrated.rotation.transpose();
        let after = gain * -end.across();
        for (rest, by_direction) in [(m.from, before), (m.to, after)] {
            let (by_mean, direction_by_parameters) = &directions[rest];
            by_parameters += by_direction * direction_by_parameters;
            // At a hand-held rest, the gravity direction is not computed from the mean force of the rest, but from the
            // samples near the move. The variance of the move already contains the noise of these samples, so the
            // derivative with respect to the mean force is not added.
            if rests[rest].is_steady() {
                subtract(map, 3 * rest, &(by_direction * by_mean));
            }
        }
        subtract(map, 6 * k + 2 * index, &gain);
    }
    for column in 0..3 * k {
        let change = SVector::<f64, 9>::from_fn(|i, _| map[(i, column)]);
        subtract(map, column, &(by_parameters * change));
    }
    for column in 3 * k..6 * k {
        let change = Vector3::from_fn(|axis, _| map[(9 + axis, column)]);
        subtract(map, column, &(by_bias * change));
    }
}

/// Subtracts `change` from the nine rows of `map` that belong to the gyroscope sensitivity, beginning at column
/// `column`.
fn subtract<const C: usize>(map: &mut Mat<f64>, column: usize, change: &SMatrix<f64, 9, C>) {
    for i in 0..9 {
        for c in 0..C {
            map[(12 + i, column + c)] -= change[(i, c)];
        }
    }
}

/// Computes the derivatives of the gravity direction at a rest: with respect to the mean reading (3 x 3), and with
/// respect to the nine parameters of the accelerometer (3 x 9).
fn direction_gradients(rest: &Rest, fit: &AccelerometerFit) -> (Matrix3<f64>, SMatrix<f64, 3, 9>) {
    let f = fit.triad.correct(rest.specific_force.mean);
    let up = f.normalize();
    let by_force = (Matrix3::identity() - up * up.transpose()) / f.norm();
    let by_mean = by_force * fit.triad.inverse();
    let by_parameters = SMatrix::<f64, 3, 9>::from_fn(|row, p| {
        let change = match p {
            0..3 => Vector3::from_fn(|i, _| f64::from(u8::from(i == p))),
            _ => {
                let (i, j) = SYMMETRIC[p - 3];
                let mut change = Vector3::zeros();
                change[i] += f[j];
                if i != j {
                    change[j] += f[i];
                }
                change
            }
        };
        -(by_mean * change)[row]
    });
    (by_mean, by_parameters)
}
