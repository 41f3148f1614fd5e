//! Estimates the excess scatter of the mean rates of the rests: the part of their scatter from rest to rest that their
//! noise does not explain (model.md (19)).
//!
//! ```text
//! sum_i z_i^2 / (1 + s lambda_i) = free,     N^-1/2 C N^-1/2 = Q Lambda Q^T,   z = Q^T N^-1/2 r
//! ```
//!
//! r are the residuals of the mean rates of the rests on one axis. The noise of different rests is independent, and its
//! covariance N is diagonal. The excess scatter is modelled by a covariance s C that is added to N. C is an assumed
//! covariance matrix of the excess at all rests. It needs to be known only up to a factor, because the factor s is
//! estimated. C is either the identity or the covariance that bias instability causes. Lambda contains the eigenvalues
//! lambda_i of `N^-1/2 C N^-1/2`, and Q its eigenvectors. The factor s is chosen so that chi2 equals its degrees of
//! freedom `free` (Paule and Mandel, J. Res. NBS 87, 1982, 377-385). Each candidate matrix C, with its own s, gives the
//! same chi2. The likelihood then depends only on the determinant of N + s C, and is largest for the candidate with the
//! smallest `sum_i ln(1 + s lambda_i)`.

use faer::Mat;

use crate::numerics::fit_report::significance_limit;

/// Squared whitened residuals z_i^2 of the mean rates on one axis, and the eigenvalues lambda_i (see the start of this
/// file).
pub(super) struct Scatter {
    squares: Vec<f64>,
    lambda: Vec<f64>,
}

/// Eigenvectors and eigenvalues of `N^-1/2 C N^-1/2`, for the noise covariance N and the assumed covariance C of the
/// excess. They diagonalise N and C simultaneously.
pub(crate) struct Modes {
    sigma: Vec<f64>,
    directions: Mat<f64>,
    lambda: Vec<f64>,
}

impl Modes {
    /// Computes the modes from the noise variances `variances` and the assumed covariance `covariance` of the excess.
    /// `None` if the eigenvalue decomposition fails.
    pub(super) fn new(variances: &[f64], covariance: &Mat<f64>) -> Option<Self> {
        let n = variances.len();
        let sigma: Vec<f64> = variances.iter().map(|v| v.sqrt()).collect();
        let white = Mat::from_fn(n, n, |i, j| covariance[(i, j)] / (sigma[i] * sigma[j]));
        let eigen = white.self_adjoint_eigen(faer::Side::Lower).ok()?;
        let lambda = eigen.S().column_vector().iter().map(|l| l.max(0.0)).collect();
        Some(Self { sigma, directions: eigen.U().to_owned(), lambda })
    }

    /// Whitens the residuals with their noise and projects them onto the eigenvectors.
    pub(super) fn scatter(&self, residuals: &[f64]) -> Scatter {
        let white = Mat::from_fn(residuals.len(), 1, |i, _| residuals[i] / self.sigma[i]);
        let z = self.directions.transpose() * white;
        Scatter { squares: z.col_as_slice(0).iter().map(|z| z * z).collect(), lambda: self.lambda.clone() }
    }
}

/// Excess scatter of the mean rates on one axis.
#[derive(Clone, Copy, Debug)]
pub(super) struct Excess {
    /// Factor s. The covariance `s C` is added to the covariance of the noise, where C is the assumed covariance of the
    /// excess at all rests, up to a factor.
    pub(super) variance: f64,
    /// Value of `sum_i ln(1 + s lambda_i)`, with the eigenvalues lambda_i of [`Modes`]. Among several candidates for C,
    /// the one with the smallest value has the largest likelihood.
    pub(super) cost: f64,
}

impl Scatter {
    /// Scatter for the candidate C = identity. The excess is then independent from rest to rest and has the same
    /// variance at all rests.
    pub(super) fn from_rest_to_rest(residuals: &[f64], variances: &[f64]) -> Self {
        let squares = residuals.iter().zip(variances).map(|(r, v)| r * r / v).collect();
        Self { squares, lambda: variances.iter().map(|v| 1.0 / v).collect() }
    }

    fn chi2(&self, variance: f64) -> f64 {
        self.squares.iter().zip(&self.lambda).map(|(square, lambda)| square / (1.0 + variance * lambda)).sum()
    }

    /// Whether the excess of chi2 is significant: `chi2 > free (1 + 3 sqrt(2 / free))`, with `free` degrees of freedom.
    pub(super) fn is_significant(&self, free: f64) -> bool {
        free > 0.0 && self.chi2(0.0) > free * significance_limit(free)
    }

    /// Estimates the factor s at which chi2 equals `free`, and computes `sum_i ln(1 + s lambda_i)`. `None` if chi2 does
    /// not exceed `free` at s = 0, or if no s reduces chi2 to `free`.
    pub(super) fn excess(&self, free: f64) -> Option<Excess> {
        if free <= 0.0 || self.chi2(0.0) <= free {
            return None;
        }
        let mut high = 1.0 / self.lambda.iter().copied().fold(0.0, f64::max);
        while self.chi2(high) > free {
            high *= 2.0;
            if !high.is_finite() {
                return None;
            }
        }
        let mut low = 0.0;
        // chi2 decreases monotonically with the factor s (`variance`). 60 bisections give machine precision.
        for _ in 0..60 {
            let middle = (low + high) / 2.0;
            if self.chi2(middle) > free { low = middle } else { high = middle }
        }
        Some(Excess { variance: high, cost: self.lambda.iter().map(|lambda| (high * lambda).ln_1p()).sum() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RESIDUALS: [f64; 6] = [3.0, 2.0, 2.5, -1.5, -3.0, -2.0];

    #[test]
    fn chance_is_no_excess() {
        let scatter = Scatter::from_rest_to_rest(&RESIDUALS, &[6.0; 6]);
        assert!(!scatter.is_significant(5.0) && Scatter::from_rest_to_rest(&RESIDUALS, &[0.1; 6]).is_significant(5.0));
        assert!(scatter.excess(60.0).is_none());
    }

    #[test]
    fn the_excess_leaves_chi2_at_what_is_free() {
        let variances = [0.1, 0.2, 0.1, 0.2, 0.1, 0.2];
        let excess = Scatter::from_rest_to_rest(&RESIDUALS, &variances).excess(5.0).unwrap();
        let chi2: f64 = RESIDUALS.iter().zip(variances).map(|(r, v)| r * r / (v + excess.variance)).sum();
        assert!((chi2 - 5.0).abs() < 1e-9, "{chi2}");
    }

    #[test]
    fn a_covariance_that_residuals_follow_is_the_likelier_one() {
        let walk = Mat::from_fn(6, 6, |i, j| 6.0 - 2.0 * i.abs_diff(j) as f64);
        let variances = [0.01; 6];
        let cost = |residuals: &[f64; 6]| {
            let white = Scatter::from_rest_to_rest(residuals, &variances).excess(5.0).unwrap().cost;
            Modes::new(&variances, &walk).unwrap().scatter(residuals).excess(5.0).unwrap().cost - white
        };
        assert!(cost(&RESIDUALS) < 0.0);
        assert!(cost(&[3.0, -3.0, 2.0, -2.5, 3.0, -2.5]) > 0.0);
    }
}
