//! Body frames, and the exact conversion between them (`docs/model.md` (2)).
//!
//! There are two body frames, symmetric and triangular ([`Frame`]). Both are orthogonal and fixed to the accelerometer,
//! and they differ by a rotation Q. A conversion changes the sensitivity of each triad (three-axis sensor) from
//! `T_from` to `T_to = T_from Q^T`. The norm |f| of the specific force and all residuals are the same in both frames.

use faer::Mat;
use nalgebra::{Matrix3, SymmetricEigen};

use crate::error::Error;

/// Indices (row, column) of the six independent entries of a symmetric 3x3 matrix, in the order of the calibration
/// parameters.
pub(crate) const SYMMETRIC: [(usize, usize); 6] = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)];
/// Indices (row, column) of the six nonzero entries of a lower triangular 3x3 matrix, in the order of the calibration
/// parameters.
const TRIANGULAR: [(usize, usize); 6] = [(0, 0), (1, 1), (2, 2), (1, 0), (2, 0), (2, 1)];

/// Convention for the body frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Frame {
    /// The orthogonal frame closest to the three sensor axes. In this frame, the accelerometer's sensitivity is
    /// symmetric positive definite.
    Symmetric,
    /// The frame with x along the accelerometer's x axis and y in the plane of its x and y axes. In this frame, the
    /// accelerometer's sensitivity is lower triangular.
    Triangular,
}

impl Frame {
    /// Indices (row, column) of the six free entries of the accelerometer's sensitivity, in the order of the
    /// parameters.
    pub fn free_entries(self) -> [(usize, usize); 6] {
        match self {
            Self::Symmetric => SYMMETRIC,
            Self::Triangular => TRIANGULAR,
        }
    }
}

/// Sensitivities of both triads, in the same body frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensitivities {
    /// Sensitivity of the accelerometer, 3x3, raw units per m/s^2.
    pub accelerometer: Matrix3<f64>,
    /// Sensitivity of the gyroscope, 3x3, raw units per rad/s.
    pub gyroscope: Matrix3<f64>,
}

/// Converts the sensitivities of a unit to another body frame.
///
/// # Errors
/// [`Error::Input`] if the accelerometer's sensitivity is singular.
pub fn convert(from: &Sensitivities, frame: Frame) -> Result<Sensitivities, Error> {
    let accelerometer = root(&from.accelerometer, frame)?;
    let rotation = rotation(&from.accelerometer, &accelerometer)?;
    Ok(Sensitivities { accelerometer, gyroscope: from.gyroscope * rotation.transpose() })
}

/// Computes the first-order change of the result of [`convert`] if the sensitivities change by the small amount
/// `change`.
pub(crate) fn convert_change(
    from: &Sensitivities,
    to: &Sensitivities,
    frame: Frame,
    change: &Sensitivities,
) -> Result<Sensitivities, Error> {
    let t = &from.accelerometer;
    let product = change.accelerometer * t.transpose() + t * change.accelerometer.transpose();
    let accelerometer = match frame {
        Frame::Triangular => {
            let inverse = inverse(&to.accelerometer)?;
            let inner = inverse * product * inverse.transpose();
            let half = Matrix3::from_fn(|i, j| match i.cmp(&j) {
                std::cmp::Ordering::Less => 0.0,
                std::cmp::Ordering::Equal => inner[(i, j)] / 2.0,
                std::cmp::Ordering::Greater => inner[(i, j)],
            });
            to.accelerometer * half
        }
        Frame::Symmetric => {
            // The change dT of the symmetric sensitivity T solves dT T + T dT = d(T T^T), where d(T T^T) = `product` is
            // the same in both frames. In the basis of the eigenvectors of T, this equation can be solved for each
            // entry of dT separately.
            let eigen = SymmetricEigen::new(to.accelerometer);
            let inner = eigen.eigenvectors.transpose() * product * eigen.eigenvectors;
            let solved = Matrix3::from_fn(|i, j| inner[(i, j)] / (eigen.eigenvalues[i] + eigen.eigenvalues[j]));
            eigen.eigenvectors * solved * eigen.eigenvectors.transpose()
        }
    };
    let rotation = rotation(t, &to.accelerometer)?;
    let turn = inverse(&to.accelerometer)? * (change.accelerometer - accelerometer * rotation);
    Ok(Sensitivities {
        accelerometer,
        gyroscope: change.gyroscope * rotation.transpose() + from.gyroscope * turn.transpose(),
    })
}

/// Computes the Jacobian (21 x 21) of the parameters in the frame `frame` with respect to the parameters in the
/// symmetric frame.
pub(crate) fn parameter_jacobian(from: &Sensitivities, to: &Sensitivities, frame: Frame) -> Result<Mat<f64>, Error> {
    let mut jacobian = Mat::identity(21, 21);
    for column in (3..9).chain(12..21) {
        let mut change = Sensitivities { accelerometer: Matrix3::zeros(), gyroscope: Matrix3::zeros() };
        if column < 9 {
            let (i, j) = SYMMETRIC[column - 3];
            change.accelerometer[(i, j)] = 1.0;
            change.accelerometer[(j, i)] = 1.0;
        } else {
            change.gyroscope[((column - 12) / 3, (column - 12) % 3)] = 1.0;
        }
        let changed = convert_change(from, to, frame, &change)?;
        for (k, (i, j)) in frame.free_entries().into_iter().enumerate() {
            jacobian[(3 + k, column)] = changed.accelerometer[(i, j)];
        }
        for k in 0..9 {
            jacobian[(12 + k, column)] = changed.gyroscope[(k / 3, k % 3)];
        }
    }
    Ok(jacobian)
}

/// Computes the accelerometer's sensitivity R in the body frame `frame` from its sensitivity T in any body frame. R is
/// the symmetric or the lower triangular matrix, depending on the frame, with `R R^T = T T^T`.
fn root(t: &Matrix3<f64>, frame: Frame) -> Result<Matrix3<f64>, Error> {
    let product = t * t.transpose();
    match frame {
        Frame::Symmetric => square_root(&product),
        Frame::Triangular => product.cholesky().map(|factor| factor.l()),
    }
    .ok_or_else(|| Error::Input("the accelerometer's sensitivity is singular: its axes lie in one plane".into()))
}

/// Computes the rotation Q in `T_from = T_to Q`, where `from` and `to` are the accelerometer's sensitivities in the two
/// frames.
pub(crate) fn rotation(from: &Matrix3<f64>, to: &Matrix3<f64>) -> Result<Matrix3<f64>, Error> {
    Ok(inverse(to)? * from)
}

fn inverse(matrix: &Matrix3<f64>) -> Result<Matrix3<f64>, Error> {
    matrix.try_inverse().ok_or_else(|| Error::Input("the accelerometer's sensitivity is singular".into()))
}

/// The symmetric positive definite square root of `matrix`; `None` if the smallest eigenvalue of `matrix` is not above
/// 1e-6 times its largest eigenvalue.
pub(crate) fn square_root(matrix: &Matrix3<f64>) -> Option<Matrix3<f64>> {
    let eigen = SymmetricEigen::try_new(*matrix, f64::EPSILON, 200)?;
    let largest = eigen.eigenvalues.max();
    if !(largest.is_finite() && eigen.eigenvalues.min() > 1e-6 * largest) {
        return None;
    }
    let root = Matrix3::from_diagonal(&eigen.eigenvalues.map(f64::sqrt));
    let rough = eigen.eigenvectors * root * eigen.eigenvectors.transpose();
    // One step of Newton's method removes the rounding errors of the eigenvectors.
    let refined = (rough + matrix * rough.try_inverse()?) / 2.0;
    Some((refined + refined.transpose()) / 2.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn unit() -> Sensitivities {
        Sensitivities {
            accelerometer: Matrix3::new(0.98, 0.0012, 0.0055, 0.0012, 0.9727, 0.0043, 0.0055, 0.0043, 0.9921),
            gyroscope: Matrix3::new(0.9771, 0.0097, -0.006, -0.0084, 1.0309, -0.0031, 0.0087, 0.0036, 1.003),
        }
    }

    #[test]
    fn there_and_back_is_exact_to_rounding() {
        let lower = convert(&unit(), Frame::Triangular).unwrap();
        for (i, j) in [(0, 1), (0, 2), (1, 2)] {
            assert_eq!(lower.accelerometer[(i, j)], 0.0);
        }
        let back = convert(&lower, Frame::Symmetric).unwrap();
        let rounding = 4.0 * f64::EPSILON;
        let error = (back.accelerometer - unit().accelerometer).abs().max();
        assert!(error < rounding, "{error:e}");
        let error = (back.gyroscope - unit().gyroscope).abs().max();
        assert!(error < rounding, "{error:e}");
    }

    #[test]
    fn the_derivative_meets_a_finite_difference_both_ways() {
        let change = Sensitivities {
            accelerometer: Matrix3::new(0.3, -0.2, 0.5, 0.1, 0.7, -0.4, 0.2, 0.6, -0.1),
            gyroscope: Matrix3::new(0.1, 0.2, -0.3, 0.4, -0.5, 0.6, 0.7, 0.8, -0.9),
        };
        for frame in [Frame::Triangular, Frame::Symmetric] {
            let shifted = |h: f64| {
                let moved = Sensitivities {
                    accelerometer: unit().accelerometer + change.accelerometer * h,
                    gyroscope: unit().gyroscope + change.gyroscope * h,
                };
                convert(&moved, frame).unwrap()
            };
            let (plus, minus) = (shifted(1e-5), shifted(-1e-5));
            let analytic = convert_change(&unit(), &shifted(0.0), frame, &change).unwrap();
            let numeric = (plus.accelerometer - minus.accelerometer) / 2e-5;
            assert!((analytic.accelerometer - numeric).abs().max() < 1e-9);
            let numeric = (plus.gyroscope - minus.gyroscope) / 2e-5;
            assert!((analytic.gyroscope - numeric).abs().max() < 1e-9);
        }
    }
}
