//! Covariance of the two-stage estimate (model.md (9)).
//!
//! The stages share their data: the errors of the rests reach the gyroscope through the directions of gravity,
//! through the accelerometer's parameters and through the bias. To first order every parameter is a linear function
//! of independent errors - three of each accelerometer mean, three of each gyroscope mean, two of each move - and the
//! covariance is that map applied to their variances.

use faer::Mat;
use nalgebra::{Matrix3, SMatrix, Vector3};

use crate::accelerometer::{AccelerometerFit, SYMMETRIC};
use crate::gyroscope::{Ends, GyroscopeBias, GyroscopeFit, Move, residual_gradient};
use crate::segment::Rest;

/// Standard deviation of each direction component of a move that the gyroscope's white noise makes, rad.
pub(crate) fn random_walk_rad(density: &Vector3<f64>, inverse: &Matrix3<f64>, duration_s: f64) -> f64 {
    let per_axis = (inverse * Matrix3::from_diagonal(density)).norm_squared() / 3.0;
    (per_axis * duration_s).sqrt()
}

/// Covariance of `[accelerometer bias, its six entries, gyroscope bias, its nine entries]`, symmetric frame, 21 x 21.
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
    // Columns: accelerometer means (3 k), gyroscope means (3 k), moves (2 m).
    let mut map = Mat::<f64>::zeros(21, 6 * k + 2 * m);
    accelerometer_rows(&mut map, rests, accelerometer);
    for (rest, weight) in bias.weights.iter().enumerate() {
        for axis in 0..3 {
            map[(9 + axis, 3 * (k + rest) + axis)] = weight[axis];
        }
    }
    let residuals = residual_rows(&map, rests, moves, ends, accelerometer, gyroscope);
    let entries = -(&gyroscope.gain * &residuals);
    for i in 0..9 {
        for column in 0..map.ncols() {
            map[(12 + i, column)] = entries[(i, column)];
        }
    }

    // Where residuals exceed what noise explains, the noise is taken to be larger by that much.
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
    &scaled * scaled.transpose()
}

/// How the errors of the accelerometer means move its nine parameters.
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

/// How all errors move the residuals of the moves, rad, 2 m rows.
fn residual_rows(
    map: &Mat<f64>,
    rests: &[&Rest],
    moves: &[Move],
    ends: &[Ends],
    accelerometer: &AccelerometerFit,
    gyroscope: &GyroscopeFit,
) -> Mat<f64> {
    let (k, columns) = (rests.len(), map.ncols());
    let mut rows = Mat::<f64>::zeros(2 * moves.len(), columns);
    let directions: Vec<_> = rests.iter().map(|rest| direction_gradients(rest, accelerometer)).collect();
    let parameters = SMatrix::<f64, 9, 1>::zeros;
    for (index, ((m, end), carried)) in moves.iter().zip(ends).zip(&gyroscope.carried).enumerate() {
        let across = end.across();
        let gradient = residual_gradient(end, carried, &gyroscope.triad);
        for (rest, sign, rotation) in [(m.from, 1.0, carried.rotation.transpose()), (m.to, -1.0, Matrix3::identity())] {
            let (by_mean, by_parameters) = &directions[rest];
            let own = across * rotation * by_mean * sign;
            for axis in 0..3 {
                for c in 0..2 {
                    rows[(2 * index + c, 3 * rest + axis)] += own[(c, axis)];
                }
            }
            let through = across * rotation * by_parameters * sign;
            for column in 0..3 * k {
                let mut change = parameters();
                for i in 0..9 {
                    change[i] = map[(i, column)];
                }
                let moved = through * change;
                for c in 0..2 {
                    rows[(2 * index + c, column)] += moved[c];
                }
            }
        }
        for column in 3 * k..6 * k {
            for c in 0..2 {
                rows[(2 * index + c, column)] +=
                    (0..3).map(|axis| gradient[9 + axis][c] * map[(9 + axis, column)]).sum::<f64>();
            }
        }
        for c in 0..2 {
            rows[(2 * index + c, 6 * k + 2 * index + c)] = 1.0;
        }
    }
    rows
}

/// Derivative of the direction of gravity at a rest with respect to its mean (3 x 3) and the nine parameters (3 x 9).
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
