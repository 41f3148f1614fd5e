//! Small symmetric matrices, of which the upper half is kept.

/// As many numbers as the widest register has.
const LANES: usize = 8;

/// The upper half of a symmetric matrix, row by row, each filled up to whole registers: what is left of the diagonal means nothing.
#[derive(Clone)]
pub(super) struct Upper {
    size: usize,
    /// Registers in a row.
    width: usize,
    numbers: Vec<[f64; LANES]>,
}

impl Upper {
    #[inline(always)]
    pub(super) fn zeros(size: usize) -> Self {
        let width = size.div_ceil(LANES);
        Self { size, width, numbers: vec![[0.0; LANES]; size * width] }
    }

    /// Row `i` from the diagonal on.
    #[inline(always)]
    pub(super) fn row_mut(&mut self, i: usize) -> &mut [f64] {
        &mut self.numbers[i * self.width..(i + 1) * self.width].as_flattened_mut()[i..self.size]
    }

    /// The number in row `i` and column `j`, which is not left of the diagonal.
    #[inline(always)]
    pub(super) fn at(&mut self, i: usize, j: usize) -> &mut f64 {
        &mut self.row_mut(i)[j - i]
    }

    /// Adds so many times another one.
    #[inline(always)]
    pub(super) fn add(&mut self, share: f64, other: &Self) {
        let numbers = self.numbers.as_flattened_mut().iter_mut().zip(other.numbers.as_flattened());
        numbers.for_each(|(to, from)| *to += share * from);
    }

    /// Inverts the first `count` rows and columns, which are positive definite, and solves for those behind them:
    ///
    /// ```text
    /// A  B      -A^-1    A^-1 B
    ///    C  ->           C - B^T A^-1 B    (Beaton, The use of special matrix operators in statistical calculus, 1964)
    /// ```
    ///
    /// The logarithm of the determinant of A; `None` where it is not positive definite.
    #[inline(always)]
    pub(super) fn sweep(&mut self, count: usize) -> Option<f64> {
        let width = self.width;
        let mut log_determinant = 0.0;
        let mut pivots = vec![[0.0; LANES]; width];
        for k in 0..count {
            for i in 0..k {
                pivots.as_flattened_mut()[i] = *self.at(i, k);
            }
            pivots.as_flattened_mut()[k..self.size].copy_from_slice(self.row_mut(k));
            let pivot = pivots.as_flattened()[k];
            if pivot.is_nan() || pivot <= 0.0 {
                return None;
            }
            log_determinant += pivot.ln();
            let share = 1.0 / pivot;
            for (i, row) in self.numbers.chunks_exact_mut(width).enumerate() {
                let by = pivots.as_flattened()[i] * share;
                if i == k {
                    pivots.as_flattened().iter().zip(row.as_flattened_mut()).for_each(|(from, to)| *to = from * share);
                    row.as_flattened_mut()[k] = -share;
                    continue;
                }
                for (to, from) in row[i / LANES..].iter_mut().zip(&pivots[i / LANES..]) {
                    to.iter_mut().zip(from).for_each(|(to, from)| *to -= by * from);
                }
                if i < k {
                    row.as_flattened_mut()[k] = by;
                }
            }
        }
        Some(log_determinant)
    }

    /// Sums of the products of its numbers with those of two others, number by number.
    #[inline(always)]
    pub(super) fn with(&self, a: &Self, b: &Self) -> [f64; 2] {
        let mut sums = [[0.0; LANES]; 2];
        let of = |all: &Self, i: usize| i * all.width + i / LANES..(i + 1) * all.width;
        for i in 0..self.size {
            let rows = self.numbers[of(self, i)].iter().zip(&a.numbers[of(a, i)]).zip(&b.numbers[of(b, i)]);
            for ((own, a), b) in rows {
                for lane in 0..LANES {
                    sums[0][lane] += own[lane] * a[lane];
                    sums[1][lane] += own[lane] * b[lane];
                }
            }
        }
        sums.map(|sum| sum.iter().sum())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn upper(size: usize, value: impl Fn(usize, usize) -> f64) -> Upper {
        let mut all = Upper::zeros(size);
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
        let log_determinant = swept.sweep(n).unwrap();
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
    fn what_is_not_positive_definite_is_said() {
        assert!(upper(2, |i, j| if i == j { 1.0 } else { 2.0 }).sweep(2).is_none());
        assert!(upper(1, |_, _| f64::NAN).sweep(1).is_none());
    }

    #[test]
    fn products_are_those_of_what_is_there() {
        let (a, b, c) = (upper(10, |i, j| (i + j) as f64), upper(10, |_, _| 1.0), upper(10, |i, j| (j - i) as f64));
        let sum = |by: &dyn Fn(usize, usize) -> f64| -> f64 {
            (0..10).flat_map(|i| (i..10).map(move |j| (i, j))).map(|(i, j)| (i + j) as f64 * by(i, j)).sum()
        };
        assert_eq!(a.with(&b, &c), [sum(&|_, _| 1.0), sum(&|i, j| (j - i) as f64)]);
    }
}
