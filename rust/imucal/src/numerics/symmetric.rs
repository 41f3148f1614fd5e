//! Small symmetric matrices, of which only the upper triangle is used.

use std::ops::Range;

use pulp::Simd;

use crate::numerics::aligned::WIDEST;

/// The upper triangle of a symmetric matrix, or only the first rows of this triangle. Each row is stored in full length
/// and padded to complete SIMD registers. The stored values to the left of the diagonal are not used.
#[derive(Clone)]
pub(crate) struct SymmetricMatrix {
    /// Number of columns of the matrix, without the padding.
    size: usize,
    /// Number of stored values per row, with the padding.
    width: usize,
    /// The values of all rows, one row after the other.
    numbers: Vec<f64>,
}

impl SymmetricMatrix {
    pub(crate) fn zeros(size: usize) -> Self {
        Self::first_rows(size, size)
    }

    /// The first `rows` rows of a zero matrix with `size` columns.
    pub(crate) fn first_rows(rows: usize, size: usize) -> Self {
        let width = size.next_multiple_of(WIDEST);
        Self { size, width, numbers: vec![0.0; rows * width] }
    }

    /// Copies the values of another matrix of the same size.
    pub(crate) fn copy_from(&mut self, other: &Self) {
        self.numbers.copy_from_slice(&other.numbers);
    }

    /// Number of columns of the matrix.
    pub(crate) fn size(&self) -> usize {
        self.size
    }

    /// The values of row `i` from the diagonal to the last column.
    #[inline(always)]
    pub(crate) fn row(&self, i: usize) -> &[f64] {
        &self.numbers[i * self.width..(i + 1) * self.width][i..self.size]
    }

    /// The values of row `i` from the diagonal to the last column, as a mutable slice.
    #[inline(always)]
    pub(crate) fn row_mut(&mut self, i: usize) -> &mut [f64] {
        &mut self.numbers[i * self.width..(i + 1) * self.width][i..self.size]
    }

    /// The value in row `i` and column `j`, with `j >= i`.
    #[inline(always)]
    pub(crate) fn at(&mut self, i: usize, j: usize) -> &mut f64 {
        &mut self.numbers[i * self.width + j]
    }

    /// The symmetric submatrix of the rows and columns whose indices are in the ranges `own`, in the given order. Rows
    /// of this matrix that are not stored are treated as zero.
    pub(crate) fn part(&self, own: &[Range<usize>]) -> Self {
        let size = own.iter().map(Range::len).sum::<usize>();
        let width = size.next_multiple_of(WIDEST);
        let mut numbers = Vec::with_capacity(size * width);
        for row in own.iter().flat_map(Range::clone) {
            let end = numbers.len() + width;
            if let Some(from) = self.numbers.get(row * self.width..(row + 1) * self.width) {
                own.iter().for_each(|run| numbers.extend_from_slice(&from[run.clone()]));
            }
            numbers.resize(end, 0.0);
        }
        Self { size, width, numbers }
    }

    /// Sets row `row` and all following rows to a weighted sum of the same rows of other matrices. `others` contains
    /// the weight and the matrix of each term of the sum.
    #[inline(always)]
    pub(crate) fn set_sum<'a, S: Simd>(&mut self, simd: S, others: impl Iterator<Item = (f64, &'a Self)>, row: usize) {
        let own = row * self.width..;
        self.numbers[own.clone()].fill(0.0);
        let (to, _) = S::as_mut_simd_f64s(&mut self.numbers[own.clone()]);
        for (share, other) in others {
            let share = simd.splat_f64s(share);
            for (to, from) in to.iter_mut().zip(S::as_simd_f64s(&other.numbers[own.clone()]).0) {
                *to = simd.mul_add_e_f64s(share, *from, *to);
            }
        }
    }

    /// Sweep operator: inverts the block A, which has the rows and columns `places`, and solves for all other columns
    /// (Beaton, The use of special matrix operators in statistical calculus, 1964):
    ///
    /// ```text
    /// A  B      -A^-1    A^-1 B
    ///    C  ->           C - B^T A^-1 B
    /// ```
    ///
    /// A, B and C are the blocks of the matrix at the time of the call. Returns the logarithm of the determinant of A,
    /// or `None` if A is not positive definite.
    ///
    /// Several blocks may be swept one after the other. Each sweep replaces C by the Schur complement `C - B^T A^-1 B`.
    /// In the next sweep, A is a block of this Schur complement, and not a block of the original matrix. The sum of the
    /// returned logarithms is therefore the logarithm of the determinant of the submatrix of the original matrix that
    /// consists of all swept rows and columns.
    #[inline(always)]
    pub(crate) fn sweep<S: Simd>(&mut self, simd: S, places: Range<usize>) -> Option<f64> {
        let width = self.width;
        let mut log_determinant = LogDeterminant::new();
        let mut pivots = vec![0.0; width];
        for k in places {
            for (pivot, row) in pivots[..k].iter_mut().zip(self.numbers.chunks_exact(width)) {
                *pivot = row[k];
            }
            pivots[k..].copy_from_slice(&self.numbers[k * width..(k + 1) * width][k..]);
            let share = log_determinant.times(pivots[k])?;
            for (i, row) in self.numbers.chunks_exact_mut(width).enumerate() {
                let by = pivots[i] * share;
                let (first, by_all) = (i / S::F64_LANES * S::F64_LANES, simd.splat_f64s(by));
                let (to, from) = (S::as_mut_simd_f64s(&mut row[first..]).0, S::as_simd_f64s(&pivots[first..]).0);
                for (to, from) in to.iter_mut().zip(from) {
                    *to = simd.negate_mul_add_e_f64s(by_all, *from, *to);
                }
                row[k] = by;
            }
            let own = &mut self.numbers[k * width..(k + 1) * width];
            own.iter_mut().zip(&pivots).for_each(|(to, from)| *to = from * share);
            own[k] = -share;
        }
        Some(log_determinant.logarithm())
    }

    /// Applies a [`sweep`](Self::sweep) of the first `known` rows and columns, and computes only the other rows. The
    /// values of the first `known` rows after the sweep are already known and are copied from `swept`. `whole` contains
    /// these rows before the sweep, and has more columns than this matrix. `places` contains, for each column of this
    /// matrix after the first `known` columns, the index of the same column in `whole`.
    #[inline(always)]
    pub(crate) fn sweep_as<S: Simd>(
        &mut self,
        simd: S,
        known: usize,
        (whole, places): (&Self, &[usize]),
        swept: &Self,
    ) {
        let (width, lanes) = (self.width, S::F64_LANES);
        let (top, rest) = self.numbers.split_at_mut(known * width);
        for (a, (row, place)) in rest.chunks_exact_mut(width).zip(places).enumerate() {
            let first = (known + a) / lanes * lanes;
            let (to, _) = S::as_mut_simd_f64s(&mut row[first..]);
            for (own, by) in whole.numbers.chunks_exact(whole.width).zip(swept.numbers.chunks_exact(width)).take(known)
            {
                let share = simd.splat_f64s(own[*place]);
                for (to, from) in to.iter_mut().zip(S::as_simd_f64s(&by[first..]).0) {
                    *to = simd.negate_mul_add_e_f64s(share, *from, *to);
                }
            }
        }
        top.copy_from_slice(&swept.numbers[..known * width]);
    }

    /// The product `v^T A v` and the trace of `A B`, where A is this matrix, v is `vector`, and B is `other`.
    #[inline(always)]
    pub(crate) fn between<S: Simd>(&self, simd: S, vector: &[f64], other: &Self) -> [f64; 2] {
        let zero = simd.splat_f64s(0.0);
        let (mut squares, mut products) = (zero, zero);
        let mut on_diagonal = [0.0; 2];
        for i in 0..self.size {
            let first = i / S::F64_LANES * S::F64_LANES;
            let row = |of: &Self| i * of.width + first..(i + 1) * of.width;
            let (own, other) = (&self.numbers[row(self)], &other.numbers[row(other)]);
            // The loop sums over the upper triangle. Each off-diagonal value counts twice, because the complete matrix
            // also contains it below the diagonal.
            on_diagonal[0] += own[i - first] * vector[i] * vector[i];
            on_diagonal[1] += own[i - first] * other[i - first];
            let (own, other) = (S::as_simd_f64s(own).0, S::as_simd_f64s(other).0);
            let mut along = zero;
            for ((own, other), vector) in own.iter().zip(other).zip(S::as_simd_f64s(&vector[first..]).0) {
                along = simd.mul_add_e_f64s(*own, *vector, along);
                products = simd.mul_add_e_f64s(*own, *other, products);
            }
            squares = simd.mul_add_e_f64s(simd.splat_f64s(vector[i]), along, squares);
        }
        let twice = |sum: S::f64s, once: f64| 2.0 * simd.reduce_sum_f64s(sum) - once;
        [twice(squares, on_diagonal[0]), twice(products, on_diagonal[1])]
    }

    /// The values `numbers` as a vector, padded with zeros to the length of a stored row.
    pub(crate) fn vector(&self, numbers: impl Iterator<Item = f64>) -> Vec<f64> {
        let mut all = vec![0.0; self.width];
        all.iter_mut().zip(numbers).for_each(|(to, number)| *to = number);
        all
    }
}

/// Accumulates the logarithm of a determinant. The determinant is the product of the pivots. Computing a logarithm
/// takes as long as updating a row, so several pivots are multiplied before the logarithm of their product is computed.
struct LogDeterminant {
    /// Product of the pivots that are not yet contained in `logarithm`.
    product: f64,
    /// Logarithm of the product of all other pivots so far.
    logarithm: f64,
}

impl LogDeterminant {
    /// The logarithm of the product is computed when the product or its reciprocal reaches this limit, which is far
    /// from overflow and underflow.
    const LARGE: f64 = 1e100;

    fn new() -> Self {
        Self { product: 1.0, logarithm: 0.0 }
    }

    /// Multiplies the determinant by a pivot. Returns the reciprocal of the pivot, or `None` if the pivot is not
    /// positive.
    #[inline(always)]
    fn times(&mut self, pivot: f64) -> Option<f64> {
        if pivot.is_nan() || pivot <= 0.0 {
            return None;
        }
        self.product *= pivot;
        if !(1.0 / Self::LARGE..Self::LARGE).contains(&self.product) {
            self.logarithm += self.product.ln();
            self.product = 1.0;
        }
        Some(1.0 / pivot)
    }

    fn logarithm(&self) -> f64 {
        self.logarithm + self.product.ln()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn upper(size: usize, value: impl Fn(usize, usize) -> f64) -> SymmetricMatrix {
        let mut all = SymmetricMatrix::zeros(size);
        (0..size).for_each(|i| all.row_mut(i).iter_mut().enumerate().for_each(|(k, to)| *to = value(i, i + k)));
        all
    }

    #[test]
    fn a_matrix_is_inverted_and_solved_for() {
        let (n, size) = (9, 11);
        let a = |i: usize, j: usize| match (i.min(j), i.max(j)) {
            (i, j) if j >= n => ((i + 2 * j) as f64).cos(),
            (i, j) if i == j => 1.0 / (1 + i + j) as f64 + 0.1 * (1 + i) as f64,
            (i, j) => 1.0 / (1 + i + j) as f64,
        };
        let mut swept = upper(size, a);
        let log_determinant = swept.sweep(pulp::Scalar, 0..4).unwrap() + swept.sweep(pulp::Scalar, 4..n).unwrap();
        let mut at = |i: usize, j: usize| *swept.at(i.min(j), i.max(j));
        for i in 0..n {
            for j in 0..n {
                let product: f64 = (0..n).map(|k| -a(i, k) * at(k, j)).sum();
                assert!((product - f64::from(u8::from(i == j))).abs() < 1e-12, "{i} {j}: {product}");
            }
            for j in n..size {
                let product: f64 = (0..n).map(|k| a(i, k) * at(k, j)).sum();
                assert!((product - a(i, j)).abs() < 1e-12, "{i} {j}: {product}");
            }
        }
        for (i, j) in [(n, n), (n, n + 1), (n + 1, n + 1)] {
            let left = a(i, j) - (0..n).map(|k| a(k, i) * at(k, j)).sum::<f64>();
            assert!((at(i, j) - left).abs() < 1e-12, "{i} {j}: {left}");
        }
        let eigenvalues = faer::Mat::from_fn(n, n, a).self_adjoint_eigenvalues(faer::Side::Lower).unwrap();
        let expected: f64 = eigenvalues.iter().map(|value| value.ln()).sum();
        assert!((log_determinant - expected).abs() < 1e-12);
    }

    #[test]
    fn what_is_swept_of_all_columns_is_swept_of_some() {
        let (n, size, own) = (5, 12, [0..5, 7..9, 11..12]);
        let a = |i: usize, j: usize| 1.0 / (1 + i + j) as f64 + if i == j { 1.0 } else { 0.0 };
        let mut first = SymmetricMatrix::first_rows(n, size);
        (0..n).for_each(|i| first.row_mut(i).iter_mut().enumerate().for_each(|(k, to)| *to = a(i, i + k)));
        let whole = first.clone();
        let log_determinant = first.sweep(pulp::Scalar, 0..n).unwrap();
        let (mut one_by_one, mut at_once) = (upper(size, a).part(&own), upper(size, a).part(&own));
        assert!((one_by_one.sweep(pulp::Scalar, 0..n).unwrap() - log_determinant).abs() < 1e-14);
        at_once.sweep_as(pulp::Scalar, n, (&whole, &[7, 8, 11]), &first.part(&own));
        for i in 0..at_once.size() {
            for (known, own) in at_once.row(i).iter().zip(one_by_one.row(i)) {
                assert!((known - own).abs() < 1e-14, "{i}: {known} {own}");
            }
        }
    }

    #[test]
    fn what_is_not_positive_definite_is_said() {
        assert!(upper(2, |i, j| if i == j { 1.0 } else { 2.0 }).sweep(pulp::Scalar, 0..2).is_none());
        assert!(upper(1, |_, _| f64::NAN).sweep(pulp::Scalar, 0..1).is_none());
    }

    #[test]
    fn products_are_those_of_whole_matrices() {
        let (a, b) = (|i: usize, j: usize| (i + j) as f64, |i: usize, j: usize| i.abs_diff(j) as f64 + 0.5);
        let (first, second) = (upper(10, a), upper(10, b));
        let vector = first.vector((0..10).map(|i| (7 * i % 5) as f64));
        let sum = |by: &dyn Fn(usize, usize) -> f64| -> f64 {
            (0..10).flat_map(|i| (0..10).map(move |j| (i, j))).map(|(i, j)| a(i, j) * by(i, j)).sum()
        };
        let expected = [sum(&|i, j| vector[i] * vector[j]), sum(&b)];
        assert_eq!(first.between(pulp::Scalar, &vector, &second), expected);
    }
}
