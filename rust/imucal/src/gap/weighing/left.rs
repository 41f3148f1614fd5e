//! What a model leaves of columns beside it.

use nalgebra::DMatrix;
use pulp::{Arch, Simd, WithSimd};

use super::super::upper::Upper;

/// What a model leaves of columns beside it, in typical sizes, and of the residuals, which come last.
pub(crate) struct Left {
    pub(super) sums: Upper,
    /// What each column is without the model.
    pub(super) whole: Vec<f64>,
}

impl Left {
    fn columns(&self) -> usize {
        self.sums.size() - 1
    }

    /// The width of the prior, in typical sizes, with the largest gain of the logarithm of the evidence, and that gain; `None` where none
    /// can be computed.
    pub(crate) fn best_width(&self, widths: &[f64]) -> Option<(f64, f64)> {
        Arch::new().dispatch(BestWidth(self, widths))
    }

    /// What a width gains; `sums` are overwritten.
    #[inline(always)]
    fn gain<S: Simd>(&self, simd: S, width: f64, sums: &mut Upper) -> Option<f64> {
        let k = self.columns();
        sums.copy_from(&self.sums);
        let residual = *sums.at(k, k);
        (0..k).for_each(|a| *sums.at(a, a) += 1.0 / (width * width));
        let volume = sums.sweep(simd, 0..k)? + 2.0 * k as f64 * width.ln();
        Some(0.5 * (residual - *sums.at(k, k) - volume))
    }

    /// What each direction of the parameters moves chi2 by; what is below the rounding of what was subtracted is nothing.
    pub(crate) fn spectrum(&self) -> Vec<f64> {
        let k = self.columns();
        let normal = DMatrix::from_fn(k, k, |a, b| self.sums.row(a.min(b))[a.abs_diff(b)]);
        if normal.iter().any(|number| !number.is_finite()) {
            return Vec::new();
        }
        let rounding = 1e-9 * self.whole.iter().sum::<f64>();
        let values = normal.symmetric_eigenvalues();
        values.into_iter().map(|value| if *value > rounding { *value } else { 0.0 }).collect()
    }

    /// The sum of these.
    pub(crate) fn trace(&self) -> f64 {
        (0..self.columns()).map(|a| self.sums.row(a)[0].max(0.0)).sum()
    }
}

struct BestWidth<'a>(&'a Left, &'a [f64]);

impl WithSimd for BestWidth<'_> {
    type Output = Option<(f64, f64)>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let (mut best, mut sums): (Option<(f64, f64)>, _) = (None, self.0.sums.clone());
        // Not in a closure, which would be compiled for other registers.
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
