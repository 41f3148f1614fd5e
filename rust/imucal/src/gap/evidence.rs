//! Computes the evidence of a model from the Gram matrices of groups of residuals (docs/model.md (23)).
//!
//! ```text
//! r(theta) = r + J delta,   theta = theta_0 + delta,   prior theta_p ~ N(0, (s typical_p)^2), none for the base
//! -2 log E = sum_g [n_g ln s_g^2 + chi2_g(theta) / s_g^2] + theta^T P theta + ln det(N + P) - ln det P   model.md (23)
//! N = sum_g J_g^T J_g / s_g^2,   s_g^2 = max(1, chi2_g / free_g)
//! ```
//!
//! r(theta) are the whitened residuals, linearised at the parameters theta_0 with the Jacobian J. E is the evidence.
//! Group g has n_g residuals with free_g degrees of freedom, and J_g contains the rows of J for these residuals.
//! chi2_g(theta) is the sum of squares of the residuals of group g at theta. P is the diagonal matrix of the prior
//! precisions. Parameter p with the typical size typical_p and the prior width s has the precision 1 / (s typical_p)^2.
//! Base parameters (sensitivities and biases) without a prior have the precision zero, and ln det P omits them.
//!
//! A group contains the residuals of one kind, for example norms of the specific force at rests, gravity directions
//! after moves, or mean rates at rests about one axis. Residuals of real recordings exceed sensor noise, by a different
//! factor in each group. The scale s_g^2 of a group is chi2 per degree of freedom of its residuals under the evaluated
//! model, and at least one. In a simulation with only sensor noise and with a complete model, all scales are one. The
//! evidence is then the Laplace approximation for known noise.

use std::ops::Range;

use faer::Mat;
use faer::linalg::solvers::Solve;

/// For each residual group: the Gram matrix `[J r]^T [J r]` of the Jacobian J and the residual r, and the number of
/// residuals.
#[derive(Clone)]
pub(crate) struct Gram {
    pub(crate) sums: Vec<Mat<f64>>,
    pub(crate) rows: Vec<f64>,
    /// For each Gram matrix: the index of its group of residuals. A group without residuals has no Gram matrix.
    pub(crate) groups: Vec<usize>,
    /// Index of the row and column of the residual r in the Gram matrices.
    pub(crate) residual: usize,
}

/// The Jacobian column of one parameter of a model: the index of the column in the Gram matrices, the precision of the
/// parameter's prior (0 without a prior), and the value of the parameter at the linearisation point minus the mean of
/// the prior (0 without a prior).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Column {
    pub(crate) place: usize,
    pub(crate) precision: f64,
    pub(crate) value: f64,
}

/// The evidence of a model, and the linear least-squares fit from which it is computed.
#[derive(Clone, Debug)]
pub(crate) struct Evidence {
    /// Natural logarithm of the evidence, nats. A constant that is equal for all models of the same residuals is
    /// omitted.
    pub(crate) log: f64,
    /// -2 ln L, where L is the maximum likelihood over the parameters and the noise scales.
    pub(crate) deviance: f64,
    /// chi2 of all residuals, with standard deviations from sensor noise only. The noise scales are not applied.
    pub(crate) chi2: f64,
    /// Noise scale s_g^2 of each group, dimensionless: chi2 per degree of freedom, at least one.
    pub(crate) scales: Vec<f64>,
    /// Fitted value of each parameter minus the mean of its prior. For a parameter without a prior: its change from the
    /// linearisation point.
    pub(crate) theta: Vec<f64>,
}

/// Value that is added to the diagonal of a normal matrix of normalised columns, so that the matrix can be factorised
/// even if some parameters are not observable. It is larger than rounding errors and smaller than the eigenvalues of
/// observable directions.
pub(super) const RIDGE: f64 = 1e-13;

impl Gram {
    /// Index of the Gram matrix of a group of residuals; `None` if the group has no residuals.
    pub(super) fn place(&self, group: usize) -> Option<usize> {
        self.groups.iter().position(|own| *own == group)
    }

    /// Lower bound of the noise scale s_g^2 of a group of residuals in a model with these columns. The model is fitted
    /// to the residuals of this group alone. The bound is chi2 of this fit, divided by the number of residuals in the
    /// group. `None` if the group has no rows or the normal matrix is singular.
    pub(crate) fn least_scale(&self, group: usize, columns: &[Column]) -> Option<f64> {
        let place = self.place(group)?;
        let (sum, n) = (&self.sums[place], columns.len());
        let size: Vec<f64> = columns.iter().map(|c| sum[(c.place, c.place)].sqrt().max(1e-300)).collect();
        let normal = Mat::from_fn(n, n, |i, j| {
            sum[(columns[i].place, columns[j].place)] / (size[i] * size[j]) + if i == j { RIDGE } else { 0.0 }
        });
        let right = Mat::from_fn(n, 1, |i, _| sum[(columns[i].place, self.residual)] / size[i]);
        let solved = normal.llt(faer::Side::Lower).ok()?.solve(&right);
        let explained: f64 = (0..n).map(|i| solved[(i, 0)] * right[(i, 0)]).sum();
        Some((sum[(self.residual, self.residual)] - explained).max(0.0) / self.rows[place])
    }

    /// Covariance matrix of the parameters to which `columns[k]` belong, for all indices k in `own`, at the noise
    /// scales `scales`; `None` if the normal matrix is singular.
    pub(crate) fn covariance(&self, columns: &[Column], scales: &[f64], own: &[usize]) -> Option<Mat<f64>> {
        let n = columns.len();
        let size = self.sizes(columns);
        let normal = Mat::from_fn(n, n, |i, j| {
            let (a, b) = (columns[i].place, columns[j].place);
            let seen: f64 = self.sums.iter().zip(scales).map(|(sum, scale)| sum[(a, b)] / scale).sum();
            seen / (size[i] * size[j]) + if i == j { columns[i].precision / (size[i] * size[i]) + RIDGE } else { 0.0 }
        });
        let wanted = Mat::from_fn(n, own.len(), |i, k| f64::from(u8::from(i == own[k])));
        let solved = normal.llt(faer::Side::Lower).ok()?.solve(&wanted);
        Some(Mat::from_fn(own.len(), own.len(), |i, k| solved[(own[i], k)] / (size[own[i]] * size[own[k]])))
    }

    /// Sums the Gram matrices of all groups, each divided by the noise scale s_g^2 of its group, and returns selected
    /// rows and columns of the sum. Row or column i of the result is row or column `place(i)` of the Gram matrices, for
    /// i below `count`. Only the columns in the range `columns` are computed.
    pub(crate) fn at_scales(
        &self,
        scales: &[f64],
        place: impl Fn(usize) -> usize,
        count: usize,
        columns: Range<usize>,
    ) -> Mat<f64> {
        let mut all = Mat::<f64>::zeros(count, columns.len());
        let places: Vec<usize> = (0..count).map(place).collect();
        for (sum, scale) in self.sums.iter().zip(scales) {
            for (c, column) in columns.clone().enumerate() {
                let from = sum.col_as_slice(places[column]);
                let to = all.col_as_slice_mut(c).iter_mut();
                to.zip(&places).for_each(|(to, &place)| *to += from[place] / scale);
            }
        }
        all
    }

    /// The number by which each column is divided so that the normal matrix is well scaled: the larger of the
    /// column's length and the square root of its prior precision.
    pub(super) fn sizes(&self, columns: &[Column]) -> Vec<f64> {
        let total = |place: usize| self.sums.iter().map(|sum| sum[(place, place)]).sum::<f64>();
        columns.iter().map(|c| total(c.place).max(c.precision).sqrt().max(1e-300)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The ratio of the evidences with and without the column of an effect must equal a numerical integral over the
    /// effect's parameter.
    #[test]
    fn the_evidence_is_the_integral_over_the_prior() {
        let rows = 40;
        let noise = |i: usize| ((i * 7919 + 13) % 97) as f64 / 97.0 * 2.8 - 1.4;
        let columns = Mat::from_fn(rows, 3, |i, j| match j {
            0 => 1.0,
            1 => (i as f64 * 0.3).sin(),
            _ => noise(i) + 0.4 * (i as f64 * 0.3).sin(),
        });
        let gram = Gram::of(&columns, &vec![0; rows]);
        let base = Column { place: 0, precision: 0.0, value: 0.0 };
        let effect = Column { place: 1, precision: 1.0 / 0.25, value: 0.0 };
        let with = gram.evidence(&[base, effect]).unwrap();
        let without = gram.evidence(&[base]).unwrap();
        assert_eq!(with.scales, vec![1.0]);
        // For each value of the parameter, the coefficient of the base column is integrated out in closed form.
        let chi2 = |theta: f64| {
            let r: Vec<f64> = (0..rows).map(|i| columns[(i, 2)] + theta * columns[(i, 1)]).collect();
            let mean = r.iter().sum::<f64>() / rows as f64;
            r.iter().map(|v| (v - mean).powi(2)).sum::<f64>()
        };
        let step = 1e-4;
        let prior = |theta: f64| (-0.5 * theta * theta / 0.25).exp() / (0.5 * std::f64::consts::TAU.sqrt());
        let integral: f64 = (-30_000..30_000)
            .map(|k| f64::from(k) * step)
            .map(|theta| (-0.5 * (chi2(theta) - chi2(0.0))).exp() * prior(theta) * step)
            .sum();
        assert!((with.log - without.log - integral.ln()).abs() < 1e-6, "{} {}", with.log - without.log, integral.ln());
    }
}
