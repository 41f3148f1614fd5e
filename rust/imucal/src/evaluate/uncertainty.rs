//! chi2 of the residuals on control recordings, with allowance for the uncertainty of the calibration.
//!
//! ```text
//! cov(r) = N + D C D^T,     chi2 = r^T cov(r)^-1 r = z^T z - v^T (I + d^T d)^-1 v
//! z = N^(-1/2) r,  d = N^(-1/2) D L,  v = d^T z
//! ```
//!
//! r are the residuals on the control recordings, N is the covariance of their noise, and I is the identity matrix. The
//! parameters of the calibration have the covariance C = L L^T. D is the derivative of the residuals with respect to
//! these parameters. A column of D L is the change of the residuals if the parameters change by the corresponding
//! column of L. If the calibration is from a short recording, the residuals on a long control recording exceed their
//! noise because of the errors of the calibration. This chi2 therefore takes the uncertainty of the calibration into
//! account.

use imucal_core::calibration::Calibration;
use imucal_core::sensor::Triad;
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

use crate::error::Error;
use crate::frame::Frame;
use crate::parameters::{ACCEL, BASE};

/// Uncertainty of the 21 parameters of both triads.
#[derive(Clone, Debug)]
pub struct Uncertainty {
    changes: Vec<Change>,
}

/// Change of both triads by one standard deviation along one eigenvector of the correlation matrix of the parameters.
#[derive(Clone, Debug)]
struct Change {
    accelerometer: (Matrix3<f64>, Vector3<f64>),
    gyroscope: (Matrix3<f64>, Vector3<f64>),
}

impl Uncertainty {
    /// Creates the uncertainty from the covariance matrix `covariance` of the parameters in the body frame `frame`. The
    /// order of the parameters is that of [`crate::calibrate::parameter_names`]. Further rows and columns, for example
    /// those of effects, are not used.
    ///
    /// # Errors
    /// [`Error::Input`] if the covariance has fewer than 21 rows or columns, or values that are not finite.
    pub fn try_new(covariance: &[Vec<f64>], frame: Frame) -> Result<Self, Error> {
        let is_complete = |row: &Vec<f64>| row.len() >= BASE && row[..BASE].iter().all(|value| value.is_finite());
        if covariance.len() < BASE || !covariance[..BASE].iter().all(is_complete) {
            return Err(Error::Input(format!("the covariance of a calibration needs {BASE} rows and columns")));
        }
        // The units of the parameters differ by orders of magnitude. The correlation matrix is therefore decomposed
        // instead of the covariance.
        let sigma: Vec<f64> = (0..BASE).map(|p| covariance[p][p].max(0.0).sqrt()).collect();
        let correlation = DMatrix::from_fn(BASE, BASE, |i, j| {
            let size = sigma[i] * sigma[j];
            if size > 0.0 { (covariance[i][j] + covariance[j][i]) / 2.0 / size } else { 0.0 }
        });
        let eigen = correlation.symmetric_eigen();
        let change = |k: usize| {
            let root = eigen.eigenvalues[k].max(0.0).sqrt();
            Change::of(&std::array::from_fn(|p| root * eigen.eigenvectors[(p, k)] * sigma[p]), frame)
        };
        Ok(Self { changes: (0..BASE).map(change).collect() })
    }

    /// The uncertainty of an accelerometer without a gyroscope. `covariance` is the covariance of its nine parameters
    /// in the body frame `frame`.
    ///
    /// # Errors
    /// The errors of [`try_new`](Self::try_new), for nine rows and columns.
    pub fn of_accelerometer(covariance: &[Vec<f64>], frame: Frame) -> Result<Self, Error> {
        let nine = ACCEL.len();
        if covariance.len() != nine || covariance.iter().any(|row| row.len() != nine) {
            return Err(Error::Input(format!("the covariance of an accelerometer needs {nine} rows and columns")));
        }
        let of = |i: usize, j: usize| covariance.get(i).and_then(|row| row.get(j)).copied().unwrap_or(0.0);
        let all: Vec<Vec<f64>> = (0..BASE).map(|i| (0..BASE).map(|j| of(i, j)).collect()).collect();
        Self::try_new(&all, frame)
    }

    /// Returns, for each eigenvector of the parameters' correlation matrix, both triads after a change by one standard
    /// deviation along this eigenvector. `corrected` is true if the samples have already been corrected with
    /// `calibration`.
    pub(super) fn changed(&self, calibration: &Calibration<f64>, corrected: bool) -> Vec<[Triad<f64>; 2]> {
        let triad = |triad: &Triad<f64>, (sensitivity, bias): (Matrix3<f64>, Vector3<f64>)| {
            if corrected {
                let inverse = triad.inverse();
                Triad::try_new(Matrix3::identity() + inverse * sensitivity, inverse * bias)
            } else {
                Triad::try_new(triad.sensitivity() + sensitivity, triad.bias() + bias)
            }
        };
        let both = |change: &Change| {
            let accelerometer = triad(&calibration.accelerometer, change.accelerometer).ok()?;
            Some([accelerometer, triad(&calibration.gyroscope, change.gyroscope).ok()?])
        };
        self.changes.iter().filter_map(both).collect()
    }
}

impl Change {
    fn of(values: &[f64; BASE], frame: Frame) -> Self {
        let vector = |first: usize| Vector3::new(values[first], values[first + 1], values[first + 2]);
        let mut sensitivity = Matrix3::zeros();
        for (value, (i, j)) in values[3..9].iter().zip(frame.free_entries()) {
            sensitivity[(i, j)] = *value;
            if frame == Frame::Symmetric {
                sensitivity[(j, i)] = *value;
            }
        }
        Self {
            accelerometer: (sensitivity, vector(0)),
            gyroscope: (Matrix3::from_row_slice(&values[12..21]), vector(9)),
        }
    }
}

/// Computes chi2 of residuals relative to noise and the uncertainty of the calibration. `z` are the residuals. Each
/// entry of `changes` contains the changes of all residuals due to one [`Change`] of the triads. Residuals and changes
/// are divided by the standard deviations of noise.
pub(super) fn chi2_with(z: &[f64], changes: &[Vec<f64>]) -> f64 {
    let z = DVector::from_column_slice(z);
    let d = DMatrix::from_fn(z.len(), changes.len(), |row, k| changes[k][row]);
    let v = d.tr_mul(&z);
    let inner = DMatrix::identity(changes.len(), changes.len()) + d.tr_mul(&d);
    let explained = inner.cholesky().map_or(0.0, |factor| v.dot(&factor.solve(&v)));
    (z.norm_squared() - explained).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_along_the_uncertainty_of_the_calibration_is_explained() {
        let z = [30.0, -30.0, 30.0, -30.0];
        let known = chi2_with(&z, &[vec![1.0, 1.0, 1.0, 1.0]]);
        assert!((known - 3600.0).abs() < 1e-9);
        let uncertain = chi2_with(&z, &[vec![15.0, -15.0, 15.0, -15.0]]);
        assert!((uncertain - 3600.0 / (1.0 + 900.0)).abs() < 1e-9);
    }
}
