//! The set of products of two Jacobian columns that the scoring of candidates needs.

use std::ops::Range;

use faer::Mat;

/// The column products that the scoring of candidates needs. They are model column x any column, column x column within
/// a block (the columns of one candidate effect at one trial time constant), candidate column x residual, and residual
/// x residual. The model's columns come first, and the residual is the last column.
pub(super) struct Asked<'a> {
    pub(super) model: usize,
    pub(super) last: usize,
    pub(super) blocks: &'a [Range<usize>],
    /// Needed products of columns that are not in the model. Each entry contains the index i of a column, and the
    /// indices j >= i of the columns for the products i x j.
    pairs: Vec<(usize, Vec<usize>)>,
    /// Initial Gram matrix, with zeros for needed products and NaN for all other products.
    nothing_yet: Mat<f64>,
}

impl<'a> Asked<'a> {
    pub(super) fn new(model: usize, last: usize, blocks: &'a [Range<usize>]) -> Self {
        let own = blocks.iter().flat_map(|block| block.clone().map(|i| (i, i..block.end)));
        let with_last = own.map(|(i, others)| (i, others.chain([last]).collect()));
        let pairs: Vec<(usize, Vec<usize>)> = with_last.chain([(last, vec![last])]).collect();
        let mut nothing_yet = Mat::zeros(last + 1, last + 1);
        (model..=last).for_each(|j| nothing_yet.col_as_slice_mut(j)[model..].fill(f64::NAN));
        for (i, others) in &pairs {
            others.iter().for_each(|j| (nothing_yet[(*i, *j)], nothing_yet[(*j, *i)]) = (0.0, 0.0));
        }
        Self { model, last, blocks, pairs, nothing_yet }
    }

    /// Copy of the initial Gram matrix, with zeros for needed products and NaN for all other products.
    pub(super) fn nothing_yet(&self) -> Mat<f64> {
        let size = self.last + 1;
        let mut sums = Mat::zeros(size, size);
        // Column slices are copied, because `Mat::clone` copies element by element and is slower.
        (0..size).for_each(|j| sums.col_as_slice_mut(j).copy_from_slice(self.nothing_yet.col_as_slice(j)));
        sums
    }

    /// Copies the computed products to the transposed entries of the Gram matrix, which is symmetric.
    pub(super) fn mirror(&self, sum: &mut Mat<f64>) {
        for j in self.model..=self.last {
            (0..self.model).for_each(|i| sum[(i, j)] = sum[(j, i)]);
        }
        for (i, others) in &self.pairs {
            others.iter().for_each(|j| sum[(*j, *i)] = sum[(*i, *j)]);
        }
    }
}
