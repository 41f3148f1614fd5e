//! Computes the second-order errors of an estimate that are due to the errors of priors (model.md (40)).
//!
//! ```text
//! p(e) = p + v e + c e^2
//! v = G 1_k                              change of the estimate due to one standard deviation of prior k
//! c = -G (r(p + v) - 2 r(p) + r(p - v)) / 2
//! ```
//!
//! p is the estimate, and e is the error of prior k in standard deviations. r are the whitened residuals, J is their
//! Jacobian, and G is the gain `(J^T J)^-1 J^T`. 1_k is one for the residual of prior k and zero for all other
//! residuals. The covariance of a least-squares estimate includes only the first-order change v. The term c e^2 matters
//! if prior k alone determines a parameter, because the other residuals then do not reduce the error e. For example,
//! readings in six positions along the sensitive axes do not determine the misalignments. If the prior of a
//! misalignment has the error m rad, the relative change of the estimated scale of this axis is 3/2 m^2. Products of
//! the errors of two priors are neglected.

use std::ops::Range;

use faer::Mat;

use crate::error::Error;
use crate::numerics::lsq::Solution;

/// Computes the matrix of second moments of the second-order errors c e^2, for independent normal errors e of the
/// priors. The matrix is `2 sum c c^T + (sum c) (sum c)^T`, where the sums run over the priors and c is the vector in
/// the formulas at the top of this file. `priors` contains the indices of the residuals of the priors. `gain` is the
/// matrix G in these formulas. `residuals_at` returns all whitened residuals at given parameters.
pub(crate) fn mean_square(
    found: &Solution,
    gain: &Mat<f64>,
    priors: Range<usize>,
    residuals_at: impl Fn(&[f64]) -> Result<Mat<f64>, Error>,
) -> Result<Mat<f64>, Error> {
    let n = found.parameters.len();
    let (mut sum, mut changes) = (Mat::<f64>::zeros(n, 1), Vec::new());
    for row in priors {
        let shifted = |sign: f64| -> Vec<f64> {
            found.parameters.iter().enumerate().map(|(p, value)| value + sign * gain[(p, row)]).collect()
        };
        let (above, below) = (residuals_at(&shifted(1.0))?, residuals_at(&shifted(-1.0))?);
        let half = Mat::from_fn(above.nrows(), 1, |i, _| {
            (2.0 * found.residuals[(i, 0)] - above[(i, 0)] - below[(i, 0)]) / 2.0
        });
        let change = gain * half;
        sum += &change;
        changes.push(change);
    }
    let of_priors = changes.iter().map(|change| change * change.transpose());
    Ok(of_priors.fold(&sum * sum.transpose(), |all, own| all + &own + &own))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::lsq::{self, Residuals};

    /// Residuals of a problem with two parameters, a scale s and a misalignment m. The data are a simulated reading of
    /// `s sqrt(1 + m^2)` and a prior of m.
    struct Tilted {
        reading: f64,
        sigma: f64,
        prior: f64,
    }

    const NOISE: f64 = 1e-6;

    impl Residuals for Tilted {
        fn evaluate(&self, p: &[f64], residuals: &mut Mat<f64>, jacobian: &mut Mat<f64>) {
            let norm = (1.0 + p[1] * p[1]).sqrt();
            residuals[(0, 0)] = (p[0] * norm - self.reading) / NOISE;
            residuals[(1, 0)] = (p[1] - self.prior) / self.sigma;
            let rows = [[norm / NOISE, p[0] * p[1] / norm / NOISE], [0.0, 1.0 / self.sigma]];
            (0..2).for_each(|i| (0..2).for_each(|j| jacobian[(i, j)] = rows[i][j]));
        }

        fn count(&self) -> usize {
            2
        }
    }

    #[test]
    fn the_mean_square_is_that_of_fits_with_shifted_priors() {
        let (sigma, reading) = (0.01, 1.0);
        let fit = |prior: f64| lsq::minimize(&Tilted { reading, sigma, prior }, &[1.0, 0.0], lsq::EXACT).unwrap();
        let found = fit(0.0);
        let problem = Tilted { reading, sigma, prior: 0.0 };
        let residuals_at = |p: &[f64]| {
            let (mut residuals, mut jacobian) = (Mat::zeros(2, 1), Mat::zeros(2, 2));
            problem.evaluate(p, &mut residuals, &mut jacobian);
            Ok(residuals)
        };
        let stated = mean_square(&found, &lsq::gain(&found.jacobian), 1..2, residuals_at).unwrap()[(0, 0)];
        // The squared error is proportional to e^4 for small e. Gauss-Hermite quadrature with three points gives the
        // expectation of e^4 for a normal distribution exactly.
        let error = |e: f64| (fit(e * sigma).parameters[0] - found.parameters[0]).powi(2);
        let exact = (error(3f64.sqrt()) + 4.0 * error(0.0) + error(-(3f64.sqrt()))) / 6.0;
        assert!((stated / exact - 1.0).abs() < 1e-3, "{stated:e} {exact:e}");
    }
}
