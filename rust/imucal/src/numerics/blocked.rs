//! Computes Cholesky factors and products of large dense matrices, and solves triangular systems. All calculations
//! proceed block by block, so that a cancelled calculation can end between two blocks.

use faer::linalg::matmul::matmul;
use faer::reborrow::ReborrowMut;
use faer::{Accum, Mat, MatMut, MatRef, Par};

use crate::cancellation::checkpoint;

/// Number of rows or columns of a block. In a matrix with 6000 rows, the computation of one block takes some tens of
/// milliseconds. A cancelled calculation ends within this time.
const BLOCK: usize = 256;

/// Lower Cholesky factor of a symmetric matrix, of which only the lower triangle is read. `None` if the matrix is not
/// positive definite.
pub(crate) fn cholesky(mut matrix: Mat<f64>) -> Option<Mat<f64>> {
    let n = matrix.nrows();
    for first in (0..n).step_by(BLOCK) {
        let size = BLOCK.min(n - first);
        let (next, left) = (first + size, n - first - size);
        let own = matrix.submatrix(first, first, size, size).llt(faer::Side::Lower).ok()?.L().to_owned();
        let mut across = matrix.submatrix(next, first, left, size).transpose().to_owned();
        own.as_ref().solve_lower_triangular_in_place(&mut across);
        add_product(matrix.submatrix_mut(next, next, left, left), -1.0, across.transpose(), across.transpose());
        matrix.submatrix_mut(next, first, left, size).copy_from(across.transpose());
        matrix.submatrix_mut(first, first, size, size).copy_from(&own);
    }
    (1..n).for_each(|j| matrix.col_as_slice_mut(j)[..j].fill(0.0));
    Some(matrix)
}

/// Adds `factor` times the matrix product `a b^T` to the lower triangle of `to`. Some entries above the diagonal also
/// change.
pub(crate) fn add_product(mut to: MatMut<'_, f64>, factor: f64, a: MatRef<'_, f64>, b: MatRef<'_, f64>) {
    let n = to.nrows();
    for first in (0..n).step_by(BLOCK) {
        checkpoint();
        let (width, height) = (BLOCK.min(n - first), n - first);
        let part = to.as_mut().submatrix_mut(first, first, height, width);
        matmul(part, Accum::Add, a.subrows(first, height), b.subrows(first, width).transpose(), factor, Par::Seq);
    }
}

/// Matrix product `a b`.
pub(crate) fn product(a: MatRef<'_, f64>, b: MatRef<'_, f64>) -> Mat<f64> {
    let mut to = Mat::zeros(a.nrows(), b.ncols());
    for first in (0..a.nrows()).step_by(BLOCK) {
        checkpoint();
        let height = BLOCK.min(a.nrows() - first);
        let part = to.as_mut().subrows_mut(first, height);
        matmul(part, Accum::Replace, a.subrows(first, height), b, 1.0, Par::Seq);
    }
    to
}

/// Replaces `right` by `L^-1 right`, where L is the lower triangular matrix `factor`.
pub(crate) fn solve_lower(factor: MatRef<'_, f64>, mut right: MatMut<'_, f64>) {
    let n = factor.nrows();
    for first in (0..n).step_by(BLOCK) {
        checkpoint();
        let size = BLOCK.min(n - first);
        let (known, others) = right.rb_mut().split_at_row_mut(first);
        let mut own = others.subrows_mut(0, size);
        let before = factor.submatrix(first, 0, size, first);
        matmul(own.as_mut(), Accum::Add, before, known.as_ref(), -1.0, Par::Seq);
        factor.submatrix(first, first, size, size).solve_lower_triangular_in_place(own);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cancellation::Cancellation;
    use crate::error::Error;

    /// Positive definite matrix whose size is two complete blocks and a part of a third block.
    fn example() -> Mat<f64> {
        let n = 2 * BLOCK + 50;
        Mat::from_fn(n, n, |i, j| {
            (-(i.abs_diff(j) as f64) / 30.0).exp() * (1.0 + (i * j % 7) as f64 * 1e-3) + if i == j { 2.0 } else { 0.0 }
        })
    }

    #[test]
    fn the_factor_is_that_of_one_block() {
        let matrix = example();
        let (known, found) = (matrix.llt(faer::Side::Lower).unwrap().L().to_owned(), cholesky(matrix).unwrap());
        assert!((&known - &found).norm_max() < 1e-13, "{:e}", (&known - &found).norm_max());
        let mut right = Mat::from_fn(found.nrows(), 5, |i, j| ((i + 1) * (j + 2) % 13) as f64);
        let expected = right.clone();
        solve_lower(found.as_ref(), right.as_mut());
        assert!((&found * &right - &expected).norm_max() < 1e-11);
        assert!((product(found.as_ref(), right.as_ref()) - &expected).norm_max() < 1e-11);
    }

    #[test]
    fn a_matrix_that_is_not_positive_definite_has_no_factor() {
        let mut matrix = example();
        let last = matrix.nrows() - 1;
        matrix[(last, last)] = -1.0;
        assert!(cholesky(matrix).is_none());
        assert_eq!(cholesky(Mat::zeros(0, 0)).unwrap().nrows(), 0);
    }

    #[test]
    fn the_factorisation_can_be_cancelled() {
        let cancellation = Cancellation::new();
        cancellation.cancel();
        assert!(matches!(cancellation.run(|| Ok(cholesky(example()))), Err(Error::Cancelled)));
    }
}
