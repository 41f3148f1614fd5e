//! Computes the evidence of a model with additional Jacobian columns, for several prior widths of the coefficients of
//! these columns (docs/model.md (23)).
//!
//! The noise variances of each group g of residuals are multiplied by a noise scale s_g^2. At fixed noise scales, the
//! sweep operator first eliminates the parameters of the model from the Gram matrix. The Schur complement S of the
//! additional columns then gives the increase of the log evidence for every prior width s:
//!
//! ```text
//! S = D - C^T N^-1 C,   z = r_own - C^T N^-1 r      in typical sizes, sums of each group divided by s_g^2
//! log E(s) - log E = 1/2 (z^T (S + I/s^2)^-1 z - ln det(I + s^2 S))      for a prior N(0, (s typical_p)^2)
//! ```
//!
//! N, C, D, r and r_own are blocks of the Gram matrix. N: model column x model column, plus the prior precisions. C:
//! model column x additional column. D: additional column x additional column. r: model column x residual. r_own:
//! additional column x residual. Each block is a sum over the groups, in which the contribution of a group is divided
//! by its noise scale. The additional columns are multiplied by the typical sizes of their parameters. If the noise
//! scales maximise the evidence of the models with and without the additional columns, the formula for log E(s) - log E
//! is exact. At other noise scales, it is an approximation that is used only to select the prior widths for which the
//! evidence is then computed exactly.

mod left;

use std::ops::Range;

use pulp::{Simd, WithSimd};

use super::evidence::{Column, Evidence, Gram, RIDGE};
use crate::numerics::instructions::Instructions;
use crate::numerics::symmetric::SymmetricMatrix;

pub(crate) use left::Left;

/// Maximum number of rounds of an iteration that alternately estimates the noise scales and the parameters. If the
/// iteration does not converge, the result of the last round is used.
const SCALE_ROUNDS: usize = 20;
/// The iteration over noise scales and parameters ends if an update of the noise scales increases the log evidence by
/// less than this number of nats. Another fit of the parameters at the updated noise scales would increase the log
/// evidence by at most 3 % of this threshold.
const FORESEEN: f64 = 0.05;

/// An additional column: its index in the Gram matrices, and the typical size of its parameter.
pub(crate) type Aside = (usize, f64);

/// Jacobian columns of a model and additional columns (of candidate effects or hypotheses). All columns are normalised:
/// each is divided by its length or, if it is larger, by the square root of its prior precision ([`Gram::sizes`]).
pub(super) struct Columns<'a> {
    pub(super) gram: &'a Gram,
    pub(super) model: &'a [Column],
    pub(super) beside: Vec<Aside>,
    /// Factor by which each column is multiplied to normalise it. The last factor belongs to the residual. It is one,
    /// because the residual is not normalised.
    pub(super) unit: Vec<f64>,
}

/// The Gram matrices of a model with additional columns.
pub(crate) struct Weighing<'a> {
    pub(super) columns: Columns<'a>,
    /// For each group of residuals: the Gram matrix of the normalised columns and the residual.
    pub(super) parts: Vec<SymmetricMatrix>,
}

/// Normal matrix after elimination of the model's parameters. Before the elimination, it is the sum of the Gram
/// matrices of all groups, each divided by the noise scale of its group, plus the prior precisions of the model.
#[derive(Clone)]
pub(crate) struct Swept {
    pub(super) scales: Vec<f64>,
    pub(super) sums: SymmetricMatrix,
    /// Squared length of each additional column before the elimination (diagonal element of the normal matrix).
    whole: Vec<f64>,
    /// Log determinant of the model's normal matrix.
    pub(super) volume: f64,
}

impl<'a> Columns<'a> {
    pub(super) fn new(gram: &'a Gram, model: &'a [Column], beside: Vec<Aside>) -> Self {
        let faint = |&(place, typical): &Aside| Column { place, precision: typical.powi(-2) * RIDGE, value: 0.0 };
        let columns: Vec<Column> = model.iter().copied().chain(beside.iter().map(faint)).collect();
        // Columns are normalised, because rounding errors of long columns would otherwise exceed the squared lengths of
        // short columns.
        let unit = gram.sizes(&columns).iter().map(|size| 1.0 / size).chain([1.0]).collect();
        Self { gram, model, beside, unit }
    }

    /// Number of all columns: columns of the model and additional columns.
    pub(super) fn count(&self) -> usize {
        self.model.len() + self.beside.len()
    }

    /// Index of each column in the Gram matrices. The last entry is the index of the residual.
    fn places(&self) -> Vec<usize> {
        let columns = self.model.iter().map(|column| column.place).chain(self.beside.iter().map(|(place, _)| *place));
        columns.chain([self.gram.residual]).collect()
    }

    /// Writes the rows `rows` of the normalised Gram matrix of each group to `sums`.
    pub(super) fn fill(&self, sums: &mut [SymmetricMatrix], rows: &Range<usize>) {
        let (place, unit) = (self.places(), &self.unit);
        for (part, sum) in sums.iter_mut().zip(&self.gram.sums) {
            for i in rows.clone() {
                let from = sum.col_as_slice(place[i]);
                let to = part.row_mut(i).iter_mut().zip(&place[i..]).zip(&unit[i..]);
                to.for_each(|((to, place), own)| *to = from[*place] * own * unit[i]);
            }
        }
    }

    /// Computes the rows of the matrix `to` from row `from` on. The matrix is the sum of the Gram matrices `parts` of
    /// all groups, each divided by the noise scale of its group, plus the prior precisions of the model.
    #[inline(always)] // Inlined, so that it is compiled for the widest registers.
    pub(super) fn add_up<S: Simd>(
        &self,
        simd: S,
        parts: &[SymmetricMatrix],
        scales: &[f64],
        from: usize,
        to: &mut SymmetricMatrix,
    ) {
        let last = self.count();
        to.set_sum(simd, parts.iter().zip(scales).map(|(part, scale)| (1.0 / scale, part)), from);
        for (i, column) in self.model.iter().enumerate().skip(from) {
            let precision = column.precision * self.unit[i] * self.unit[i];
            *to.at(i, i) += precision + RIDGE;
            *to.at(i, last) += precision * column.value / self.unit[i];
        }
    }
}

impl<'a> Weighing<'a> {
    pub(crate) fn new(gram: &'a Gram, model: &'a [Column], beside: Vec<Aside>) -> Self {
        let columns = Columns::new(gram, model, beside);
        let rows = 0..columns.count() + 1;
        let mut parts = vec![SymmetricMatrix::zeros(rows.len()); gram.sums.len()];
        columns.fill(&mut parts, &rows);
        Self { columns, parts }
    }

    /// Eliminates the model's parameters. `scales` are the noise scales s_g^2 of the groups of residuals. `None` if the
    /// normal matrix of the model is singular.
    pub(crate) fn sweep(&self, scales: &[f64]) -> Option<Swept> {
        Instructions::Best.run(Sweep(self, scales))
    }

    /// The Schur complement of the additional columns in the normal matrix `swept`, with each column multiplied by the
    /// typical size of its parameter.
    pub(crate) fn left(&self, swept: &Swept) -> Left {
        let Columns { model, beside, unit, .. } = &self.columns;
        let (n, k) = (model.len(), beside.len());
        let sizes: Vec<f64> =
            beside.iter().zip(&unit[n..]).map(|((_, typical), unit)| typical / unit).chain([1.0]).collect();
        let mut sums = SymmetricMatrix::zeros(k + 1);
        for a in 0..=k {
            let to = sums.row_mut(a).iter_mut().zip(swept.sums.row(n + a)).zip(&sizes[a..]);
            to.for_each(|((to, from), size)| *to = from * size * sizes[a]);
        }
        let whole = swept.whole.iter().zip(&sizes).map(|(whole, size)| whole * size * size).collect();
        Left { sums, whole }
    }

    /// Evidence of the model with the additional columns. The coefficient of each additional column has a prior, whose
    /// standard deviation is `width` times the typical size of the coefficient. The iteration over noise scales and
    /// parameters starts at the noise scales of `swept`. The second result is the normal matrix after the elimination
    /// of the model's parameters, at the converged noise scales. `None` if the normal matrix is singular.
    pub(crate) fn evidence(&self, width: f64, swept: Swept) -> Option<(Evidence, Swept)> {
        Instructions::Best.run(Settle(self, width, swept))
    }

    /// Normal matrix before the elimination: the sum of the Gram matrices of all groups, each divided by the noise
    /// scale of its group, plus the prior precisions of the model. Only the rows from row `from` on are computed.
    #[inline(always)] // Inlined, so that it is compiled for the widest registers.
    pub(super) fn whole<S: Simd>(&self, simd: S, scales: &[f64], from: usize) -> Swept {
        let (n, all) = (self.columns.model.len(), self.columns.count());
        let mut sums = SymmetricMatrix::zeros(all + 1);
        self.columns.add_up(simd, &self.parts, scales, from, &mut sums);
        let whole = (n..all).map(|i| *sums.at(i, i)).collect();
        Swept { scales: scales.to_vec(), sums, whole, volume: 0.0 }
    }

    #[inline(always)] // Inlined, so that it is compiled for the widest registers.
    fn swept<S: Simd>(&self, simd: S, scales: &[f64]) -> Option<Swept> {
        let mut swept = self.whole(simd, scales, 0);
        swept.volume = swept.sums.sweep(simd, 0..self.columns.model.len())?;
        Some(swept)
    }

    #[inline(always)] // Inlined, so that it is compiled for the widest registers.
    fn settled<S: Simd>(&self, simd: S, width: f64, mut swept: Swept) -> Option<(Evidence, Swept)> {
        let Self { columns: Columns { gram, model, beside, unit }, parts } = self;
        let n = model.len() + beside.len();
        let of_beside = beside.iter().map(|(_, typical)| ((width * typical).powi(-2), 0.0));
        let priors = model.iter().map(|column| (column.precision, column.value)).chain(of_beside);
        let (precision, offset): (Vec<f64>, Vec<f64>) =
            priors.zip(unit).map(|((precision, value), unit)| (precision * unit * unit, value / unit)).unzip();
        let mut chi2 = vec![0.0; parts.len()];
        for round in 1..=SCALE_ROUNDS {
            let mut normal = swept.sums.clone();
            (model.len()..n).for_each(|i| *normal.at(i, i) += precision[i] + RIDGE);
            let volume = swept.volume + normal.sweep(simd, model.len()..n)?;
            // Coefficients of the columns and of the residual. The coefficient of the residual is 1. The sum of
            // coefficient x column, over all columns and the residual, is the residual after the fit.
            let delta = normal.vector((0..n).map(|i| -normal.row(i)[n - i]).chain([1.0]));
            (0..=n).for_each(|i| *normal.at(i, n) = 0.0);
            // `held` and `deviance` are sums of `n_g ln s_g^2 + chi2_g / s_g^2` over the groups g, for n_g residuals
            // with the sum of squares chi2_g. `held` is computed at the noise scales s_g^2 before this round, and
            // `deviance` at the optimised noise scales. `gain` is the increase of the log evidence if the noise scales
            // are optimised and the parameters stay fixed.
            let (mut held, mut gain, mut deviance) = (0.0, 0.0, 0.0);
            let mut scales = swept.scales.clone();
            for (g, part) in parts.iter().enumerate() {
                let [left, unspent] = part.between(simd, &delta, &normal);
                chi2[g] = left.max(0.0);
                let (rows, before) = (gram.rows[g], scales[g]);
                let free = rows + unspent / before;
                let scale = if free < 1.0 { before } else { (chi2[g] / free).max(1.0) };
                held += rows * before.ln() + chi2[g] / before;
                gain += 0.5 * (free * (before / scale).ln() + chi2[g] * (1.0 / before - 1.0 / scale));
                deviance += rows * scale.ln() + chi2[g] / scale;
                scales[g] = scale;
            }
            if gain < FORESEEN || round == SCALE_ROUNDS {
                let theta: Vec<f64> = (0..n).map(|i| offset[i] + delta[i]).collect();
                let prior: f64 = (0..n).map(|i| precision[i] * theta[i] * theta[i]).sum();
                let given: f64 = precision.iter().filter(|p| **p > 0.0).map(|p| p.ln()).sum();
                // Evidences of models can be compared although the columns are normalised. The columns of base
                // parameters (sensitivities and biases) have the same lengths in all models, so they change all log
                // evidences equally. The length of any other column changes `volume` (log determinant of the normal
                // matrix) and `given` (sum of the log prior precisions) equally, so it cancels in the log evidence.
                let evidence = Evidence {
                    log: gain - 0.5 * (held + prior + volume - given),
                    deviance,
                    chi2: chi2.iter().sum(),
                    scales,
                    theta: theta.iter().zip(unit).map(|(theta, unit)| theta * unit).collect(),
                };
                return Some((evidence, swept));
            }
            swept = self.swept(simd, &scales)?;
        }
        None
    }
}

struct Settle<'a>(&'a Weighing<'a>, f64, Swept);

impl WithSimd for Settle<'_> {
    type Output = Option<(Evidence, Swept)>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        self.0.settled(simd, self.1, self.2)
    }
}

struct Sweep<'a>(&'a Weighing<'a>, &'a [f64]);

impl WithSimd for Sweep<'_> {
    type Output = Option<Swept>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        self.0.swept(simd, self.1)
    }
}

impl Gram {
    /// The evidence of a model with these columns; `None` if its normal matrix is singular.
    pub(crate) fn evidence(&self, columns: &[Column]) -> Option<Evidence> {
        self.evidence_near(columns, &vec![1.0; self.sums.len()])
    }

    /// Evidence of a model with these columns. The noise scales are estimated iteratively, starting at `near`. These
    /// should be the noise scales of a model with nearly the same columns.
    pub(crate) fn evidence_near(&self, columns: &[Column], near: &[f64]) -> Option<Evidence> {
        let weighing = Weighing::new(self, columns, Vec::new());
        weighing.evidence(0.0, weighing.sweep(near)?).map(|(evidence, _)| evidence)
    }
}

#[cfg(test)]
mod tests {
    use faer::Mat;

    use super::*;

    /// For any prior width and with noise scales of one, the computed increase of the log evidence must equal the
    /// difference between the log evidences of the models with and without the additional column.
    #[test]
    fn the_gain_is_that_of_the_evidence() {
        let rows = 60;
        let noise = |i: usize| ((i * 7919 + 13) % 97) as f64 / 97.0 * 2.8 - 1.4;
        let columns = Mat::from_fn(rows, 4, |i, j| match j {
            0 => 1.0,
            1 => (i as f64 * 0.3).sin() + 0.5,
            2 => (i as f64 * 0.11).cos() + 0.1 * noise(i + 7),
            _ => noise(i) + 0.4 * (i as f64 * 0.3).sin(),
        });
        let gram = Gram::of(&columns, &vec![0; rows]);
        let model = [Column { place: 0, precision: 0.0, value: 0.0 }, Column { place: 1, precision: 4.0, value: 0.3 }];
        let plain = gram.evidence(&model).unwrap();
        assert_eq!(plain.scales, vec![1.0]);
        let weighing = Weighing::new(&gram, &model, vec![(2, 0.2)]);
        let swept = weighing.sweep(&plain.scales).unwrap();
        let left = weighing.left(&swept);
        for width in [0.1, 1.0, 10.0] {
            let precision = 1.0 / (width * 0.2f64).powi(2);
            let with = [model[0], model[1], Column { place: 2, precision, value: 0.0 }];
            let gain = gram.evidence(&with).unwrap().log - plain.log;
            assert!((left.best_width(&[width]).unwrap().1 - gain).abs() < 1e-9, "{width}: {gain}");
            let beside = weighing.evidence(width, swept.clone()).unwrap().0.log - plain.log;
            assert!((beside - gain).abs() < 1e-9, "{width}: {beside} {gain}");
        }
    }
}
