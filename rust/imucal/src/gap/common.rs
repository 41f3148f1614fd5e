//! Eliminates the parameters of a model from the normal equations. The elimination is computed once, and its result is
//! used to score many candidate effects.

use std::ops::Range;

use pulp::{Simd, WithSimd};

use super::evidence::{Column, Gram};
use super::weighing::{Aside, Columns, Swept, Weighing};
use crate::numerics::instructions::Instructions;
use crate::numerics::symmetric::SymmetricMatrix;

/// Gram matrices of the Jacobian columns of a model and of many candidate effects. Only products with at least one
/// model column are stored. [`Common::weighing`] adds the products of two columns of the same candidate, and the
/// products of these columns with the residual.
pub(crate) struct Common<'a> {
    columns: Columns<'a>,
    /// For each group of residuals: the Gram matrix of the normalised columns (see [`Gram::sizes`]), without the
    /// products of two candidate columns.
    parts: Vec<SymmetricMatrix>,
}

/// The normal matrix after elimination of the model's parameters, for given noise scales s_g^2 (chi2 per degree of
/// freedom) of the residual groups. Only the rows of the model's parameters are computed. They are computed once for
/// all candidates.
pub(crate) struct SweptCommon {
    scales: Vec<f64>,
    /// `whole` is the sum of the Gram matrices of all groups, each divided by the noise scale of its group, plus the
    /// prior precisions of the model. `sums` is `whole` after the elimination. `volume` is the log determinant of the
    /// rows and columns of `whole` that belong to the model's parameters.
    whole: SymmetricMatrix,
    sums: SymmetricMatrix,
    volume: f64,
}

impl<'a> Common<'a> {
    pub(crate) fn new(gram: &'a Gram, model: &'a [Column], beside: Vec<Aside>) -> Self {
        let columns = Columns::new(gram, model, beside);
        let rows = 0..model.len();
        let mut parts = vec![SymmetricMatrix::first_rows(rows.len(), columns.count() + 1); gram.sums.len()];
        columns.fill(&mut parts, &rows);
        Self { columns, parts }
    }

    /// Eliminates the model's parameters. The noise variances of each group of residuals are multiplied by the noise
    /// scale s_g^2 of the group. `None` if the normal matrix of the model is singular.
    pub(crate) fn sweep(&self, scales: &[f64]) -> Option<SweptCommon> {
        Instructions::Best.run(SweepCommon(self, scales))
    }

    /// Gram matrices of the model's columns, the candidate columns with the indices `own`, and the residual.
    pub(crate) fn weighing(&self, own: Range<usize>) -> Weighing<'a> {
        let Columns { gram, model, ref beside, ref unit } = self.columns;
        let runs = self.runs(own.clone());
        let columns = Columns {
            gram,
            model,
            beside: beside[own].to_vec(),
            unit: runs.iter().flat_map(|run| &unit[run.clone()]).copied().collect(),
        };
        let mut parts: Vec<SymmetricMatrix> = self.parts.iter().map(|part| part.part(&runs)).collect();
        columns.fill(&mut parts, &(model.len()..columns.count() + 1));
        Weighing { columns, parts }
    }

    /// The normal matrix after the elimination, restricted to the model's columns, the candidate columns with the
    /// indices `own`, and the residual.
    pub(crate) fn part_of(&self, swept: &SweptCommon, weighing: &Weighing<'_>, own: Range<usize>) -> Swept {
        let runs = self.runs(own);
        let known = swept.sums.part(&runs);
        let [_, own, last] = runs;
        Instructions::Best.run(SweepAs { weighing, common: swept, known, columns: own.chain(last).collect() })
    }

    /// Index ranges of three sets of columns: the model's columns, the candidate columns `own`, and the residual.
    fn runs(&self, own: Range<usize>) -> [Range<usize>; 3] {
        let (n, last) = (self.columns.model.len(), self.columns.count());
        [0..n, n + own.start..n + own.end, last..last + 1]
    }
}

struct SweepCommon<'a>(&'a Common<'a>, &'a [f64]);

impl WithSimd for SweepCommon<'_> {
    type Output = Option<SweptCommon>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let Self(Common { columns, parts }, scales) = self;
        let n = columns.model.len();
        let mut whole = SymmetricMatrix::first_rows(n, columns.count() + 1);
        columns.add_up(simd, parts, scales, 0, &mut whole);
        let mut sums = whole.clone();
        let volume = sums.sweep(simd, 0..n)?;
        Some(SweptCommon { scales: scales.to_vec(), whole, sums, volume })
    }
}

struct SweepAs<'a> {
    weighing: &'a Weighing<'a>,
    common: &'a SweptCommon,
    /// The model's rows of the Gram matrix after the elimination, restricted to the columns of `weighing`.
    known: SymmetricMatrix,
    /// Indices of the candidate columns of `weighing` and of the residual, among all columns of `common`.
    columns: Vec<usize>,
}

impl WithSimd for SweepAs<'_> {
    type Output = Swept;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
        let Self { weighing, common: SweptCommon { scales, whole, volume, .. }, known, columns } = self;
        let model = weighing.columns.model.len();
        let mut swept = weighing.whole(simd, scales, model);
        swept.sums.sweep_as(simd, model, (whole, &columns), &known);
        swept.volume = *volume;
        swept
    }
}
