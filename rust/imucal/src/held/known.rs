//! Prior of an accelerometer that is already calibrated, for the calibration of the gyroscope of the same unit.
//!
//! The nine parameters p have the covariance C = S V L V^T S. S is the diagonal matrix of their standard deviations. V
//! and L contain the eigenvectors and the eigenvalues of their correlation matrix. C defines nine uncorrelated linear
//! combinations h of the parameters, each with a standard deviation of 1:
//!
//! ```text
//! h = L^-1/2 V^T S^-1 (p - value)
//! ```
//!
//! `value` are the calibrated parameters. Each component of h becomes one prior.

use nalgebra::{SMatrix, SVector};

use super::{HeldParameter, PriorSource, Quantity};
use crate::error::Error;

/// The nine parameters of a calibrated accelerometer in raw units, and their covariance. They refer to the symmetric
/// frame, which is the body frame in which the accelerometer sensitivity is a symmetric matrix.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KnownAccelerometer {
    /// Bias x, y, z and the six entries of the sensitivity.
    pub parameters: [f64; 9],
    /// Covariance of the parameters.
    pub covariance: [[f64; 9]; 9],
}

/// Lower limit of the eigenvalues of the correlation matrix. Smaller eigenvalues are rounding errors and are set to
/// this limit.
const LEAST_EIGENVALUE: f64 = 1e-9;
/// Name of a held linear combination of accelerometer parameters in messages.
const CALIBRATED: &str = "the accelerometer of the given calibration";

impl KnownAccelerometer {
    /// Computes the nine uncorrelated linear combinations h of the parameters, each as a held parameter (a parameter
    /// with a prior).
    ///
    /// # Errors
    /// [`Error::Input`] unless all variances are positive and finite, and all parameters are finite.
    pub(super) fn combinations(&self) -> Result<Vec<HeldParameter>, Error> {
        let covariance = SMatrix::<f64, 9, 9>::from_fn(|i, j| (self.covariance[i][j] + self.covariance[j][i]) / 2.0);
        let sigma = covariance.diagonal().map(f64::sqrt);
        let is_known = sigma.iter().all(|sigma| *sigma > 0.0 && sigma.is_finite());
        if !(is_known && self.parameters.iter().all(|parameter| parameter.is_finite())) {
            return Err(Error::Input(
                "the calibration of the accelerometer has no covariance with positive variances: give one of imucal \
                 calibrate"
                    .into(),
            ));
        }
        let correlation = SMatrix::<f64, 9, 9>::from_fn(|i, j| covariance[(i, j)] / sigma[i] / sigma[j]);
        let eigen = correlation.symmetric_eigen();
        let combination = |k: usize| {
            let root = eigen.eigenvalues[k].max(LEAST_EIGENVALUE).sqrt();
            HeldParameter {
                name: CALIBRATED.into(),
                value: 0.0,
                sigma: 1.0,
                source: PriorSource::Given,
                usual: None,
                quantity: Quantity::Combination {
                    number: k,
                    by: std::array::from_fn(|p| eigen.eigenvectors[(p, k)] / sigma[p] / root),
                    at: self.parameters,
                },
            }
        };
        Ok((0..9).map(combination).collect())
    }
}

/// Finds the accelerometer parameter whose estimate differs most from its value in the given calibration. Returns its
/// index among the nine parameters, and the difference in standard deviations of the calibrated value. `estimates` are
/// the held parameters with their estimates. `None` if they do not contain the nine linear combinations h of
/// [`KnownAccelerometer::combinations`].
pub(crate) fn most_changed<'a>(estimates: impl Iterator<Item = (&'a HeldParameter, f64)>) -> Option<(usize, f64)> {
    let (mut rows, mut values) = (SMatrix::<f64, 9, 9>::zeros(), SVector::<f64, 9>::zeros());
    for (held, estimate) in estimates {
        if let Quantity::Combination { number, by, .. } = held.quantity {
            (0..9).for_each(|p| rows[(number, p)] = by[p]);
            values[number] = estimate;
        }
    }
    let to_parameters = rows.try_inverse()?;
    let change = to_parameters * values;
    (0..9)
        .map(|p| (p, change[p] / to_parameters.row(p).norm()))
        .max_by(|one, other| one.1.abs().total_cmp(&other.1.abs()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_changed_parameter_is_found_from_the_combinations() {
        let sigma: [f64; 9] = std::array::from_fn(|p| 0.01 * (p + 1) as f64);
        let correlation = |i: usize, j: usize| if i == j { 1.0 } else { 0.3 };
        let known = KnownAccelerometer {
            parameters: [0.5; 9],
            covariance: std::array::from_fn(|i| std::array::from_fn(|j| correlation(i, j) * sigma[i] * sigma[j])),
        };
        let held = known.combinations().unwrap();
        for changed in 0..9 {
            let mut parameters = known.parameters;
            parameters[changed] -= 7.0 * sigma[changed];
            let (found, size) = most_changed(held.iter().map(|own| (own, own.estimate(&parameters)))).unwrap();
            assert_eq!(found, changed);
            assert!((size + 7.0).abs() < 1e-9, "{size}");
        }
        assert_eq!(most_changed(held.iter().take(3).map(|own| (own, 1.0))), None);
    }
}
