//! Schur complement of columns that are added to a linear model, after elimination of the columns of the model itself.

use faer::Mat;
use nalgebra::DMatrix;
use pulp::{Simd, WithSimd};

use crate::numerics::instructions::Instructions;
use crate::numerics::symmetric::SymmetricMatrix;

/// Upper bound of the rounding error in the squared length of a column after the elimination, as a share of the squared
/// length before the elimination.
const ROUNDING: f64 = 1e-9;

/// Gram matrix of the additional columns and the residual after elimination of the model's columns (Schur complement).
/// The residual is the last column. Each column is multiplied by the typical size of its parameter.
pub(crate) struct Left {
    pub(super) sums: SymmetricMatrix,
    /// Squared length of each additional column before the elimination.
    pub(super) whole: Vec<f64>,
}

impl Left {
    /// The matrix `information` and the vector `slope` of the log likelihood `slope . x - 1/2 x^T information x`,
    /// where x are the parameters of the additional columns in units of their typical sizes.
    pub(crate) fn information(&self) -> (Mat<f64>, Vec<f64>) {
        let k = self.columns();
        let matrix = Mat::from_fn(k, k, |a, b| self.sums.row(a.min(b))[a.abs_diff(b)]);
        (matrix, (0..k).map(|a| -self.sums.row(a)[k - a]).collect())
    }

    fn columns(&self) -> usize {
        self.sums.size() - 1
    }

    /// The prior width (in typical sizes) with the largest increase of the log evidence, and this increase in nats.
    /// `None` if the normal matrix is singular for all widths.
    pub(crate) fn best_width(&self, widths: &[f64]) -> Option<(f64, f64)> {
        Instructions::Best.run(BestWidth(self, widths))
    }

    /// Increase of the log evidence for a prior width, nats. `sums` is working memory.
    #[inline(always)]
    fn gain<S: Simd>(&self, simd: S, width: f64, sums: &mut SymmetricMatrix) -> Option<f64> {
        let k = self.columns();
        sums.copy_from(&self.sums);
        let residual = *sums.at(k, k);
        (0..k).for_each(|a| *sums.at(a, a) += 1.0 / (width * width));
        let volume = sums.sweep(simd, 0..k)? + 2.0 * k as f64 * width.ln();
        Some(0.5 * (residual - *sums.at(k, k) - volume))
    }

    /// Number of observable directions in parameter space. A direction is observable if a change of the parameters by
    /// one typical size in this direction changes chi2 by at least `least`. The change must also exceed the rounding
    /// errors of the elimination.
    pub(crate) fn directions(&self, least: f64) -> usize {
        let least = least.max(ROUNDING * self.whole.iter().sum::<f64>());
        // Fast path: usually all eigenvalues exceed the threshold. A factorisation tests this faster than the
        // eigenvalues are computed.
        if Instructions::Best.run(AreAllAbove(self, least)) {
            return self.columns();
        }
        self.eigenvalues().into_iter().filter(|value| *value >= least).count()
    }

    /// Eigenvalues of the Schur complement: a change of the parameters by one typical size in the direction of an
    /// eigenvector changes chi2 by its eigenvalue. All eigenvalues are zero if a matrix element is not finite.
    pub(crate) fn eigenvalues(&self) -> Vec<f64> {
        let normal = DMatrix::from_fn(self.columns(), self.columns(), |a, b| self.sums.row(a.min(b))[a.abs_diff(b)]);
        if normal.iter().any(|number| !number.is_finite()) {
            return vec![0.0; self.columns()];
        }
        normal.symmetric_eigenvalues().as_slice().to_vec()
    }
}

/// Tests whether all eigenvalues of the Schur complement exceed a value.
struct AreAllAbove<'a>(&'a Left, f64);

impl WithSimd for AreAllAbove<'_> {
    type Output = bool;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> bool {
        let (mut sums, k) = (self.0.sums.clone(), self.0.columns());
        for a in 0..k {
            *sums.at(a, a) -= self.1;
        }
        sums.sweep(simd, 0..k).is_some()
    }
}

struct BestWidth<'a>(&'a Left, &'a [f64]);

impl WithSimd for BestWidth<'_> {
    type Output = Option<(f64, f64)>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let (mut best, mut sums): (Option<(f64, f64)>, _) = (None, self.0.sums.clone());
        // This is a loop, because a closure would not be compiled for the widest SIMD registers.
        for &width in self.1 {
            if let Some(gain) =
                self.0.gain(simd, width, &mut sums).filter(|gain| best.is_none_or(|(_, most)| *gain > most))
            {
                best = Some((width, gain));
            }
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_are_counted_by_their_eigenvalues() {
        // The matrix has two columns, with the eigenvalues 1 and 3, and the residual.
        let mut sums = SymmetricMatrix::zeros(3);
        sums.row_mut(0).copy_from_slice(&[2.0, 1.0, 0.3]);
        sums.row_mut(1).copy_from_slice(&[2.0, -0.2]);
        let of = |whole: f64| Left { sums: sums.clone(), whole: vec![whole; 2] };
        assert_eq!([0.9, 1.1, 2.9, 3.1].map(|least| of(2.0).directions(least)), [2, 1, 1, 0]);
        // If the squared lengths of the columns were 1e9 before the elimination, an eigenvalue of one may be a rounding
        // error.
        assert_eq!(of(1e9).directions(0.9), 1);
        let mut unknown = of(2.0);
        *unknown.sums.at(0, 1) = f64::NAN;
        assert_eq!(unknown.directions(0.9), 0);
    }
}
