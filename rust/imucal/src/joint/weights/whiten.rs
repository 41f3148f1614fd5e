//! Whitens residuals that have errors in common.
//!
//! ```text
//! C = diag(own) + sum_e sigma_e^2 j_e j_e^T,   C = L L^T,   r <- L^-1 r,   J <- L^-1 J           model.md (19)
//! ```
//!
//! r are the residuals and J is their Jacobian. `own` are the variances of independent errors. An error e that several
//! residuals have in common has the standard deviation sigma_e, and j_e are the derivatives of the residuals with
//! respect to it. C is the covariance of the residuals, and L is its Cholesky factor. Each error e of a rest affects
//! only the residuals of this rest and of its adjacent moves, so C and L are banded.

use faer::Mat;
use pulp::{Simd, WithSimd};

use crate::numerics::instructions::Instructions;

/// Dependence of one residual on errors that also affect other residuals. Each entry contains the index of an error,
/// and the standard deviation of this error times the derivative of the residual with respect to it.
pub(crate) type Shares = Vec<(usize, f64)>;

/// Lower Cholesky factor L of a covariance. For each row: the index of its first nonzero entry, and the entries from
/// there to the diagonal.
#[derive(Clone)]
pub(crate) struct Whitening {
    rows: Vec<(usize, Vec<f64>)>,
}

impl Whitening {
    /// Computes the factor L. For each residual, `own` contains the variance of its independent error. These variances
    /// must be positive. `shares` contains the dependence of each residual on the common errors.
    pub(crate) fn new(own: &[f64], shares: &[Shares], error_count: usize) -> Self {
        // `first_row_of` contains, for each error, the first residual that depends on it. Row i of the factor begins
        // at the first residual that has an error in common with residual i.
        let mut first_row_of = vec![usize::MAX; error_count];
        let mut rows: Vec<(usize, Vec<f64>)> = Vec::with_capacity(own.len());
        for (i, seen) in shares.iter().enumerate() {
            for &(error, _) in seen {
                first_row_of[error] = first_row_of[error].min(i);
            }
            let first = seen.iter().map(|&(error, _)| first_row_of[error]).min().unwrap_or(i);
            let mut row: Vec<f64> =
                (first..=i).map(|j| product(seen, &shares[j]) + if i == j { own[i] } else { 0.0 }).collect();
            for j in first..i {
                let (start, other) = &rows[j];
                let from = first.max(*start);
                let dot: f64 = (from..j).map(|k| row[k - first] * other[k - start]).sum();
                row[j - first] = (row[j - first] - dot) / other[j - start];
            }
            let square: f64 = row[..i - first].iter().map(|v| v * v).sum();
            // In exact arithmetic, the square of a diagonal entry is at least `own[i]`, the variance of the independent
            // error. The lower limit of half this variance protects against rounding errors.
            row[i - first] = (row[i - first] - square).max(0.5 * own[i]).sqrt();
            rows.push((first, row));
        }
        Self { rows }
    }

    /// Computes `L^-1 matrix` in place.
    pub(crate) fn apply(&self, matrix: &mut Mat<f64>) {
        let width = matrix.ncols();
        let places = || (0..self.rows.len()).flat_map(|i| (0..width).map(move |j| (i, j)));
        let mut rows: Vec<f64> = places().map(|place| matrix[place]).collect();
        self.apply_to_rows(&mut rows);
        places().zip(rows).for_each(|(place, value)| matrix[place] = value);
    }

    /// Computes `L^-1 M` in place, for a matrix M stored row by row.
    pub(crate) fn apply_to_rows(&self, rows: &mut [f64]) {
        Instructions::Best.run(Apply(self, rows));
    }
}

struct Apply<'a>(&'a Whitening, &'a mut [f64]);

impl WithSimd for Apply<'_> {
    type Output = ();

    #[inline(always)] // Compiled for the widest SIMD registers of the processor.
    fn with_simd<S: Simd>(self, _: S) {
        let Self(Whitening { rows }, numbers) = self;
        let width = numbers.len() / rows.len().max(1);
        for (i, (first, row)) in rows.iter().enumerate() {
            let (before, last) = row.split_at(i - first);
            let (known, own) = numbers.split_at_mut(i * width);
            let own = &mut own[..width];
            for (by, known) in before.iter().zip(known[first * width..].chunks_exact(width.max(1))) {
                own.iter_mut().zip(known).for_each(|(own, known)| *own -= by * known);
            }
            own.iter_mut().for_each(|own| *own /= last[0]);
        }
    }
}

impl Whitening {
    /// Column j of L^-1, from row j on. Negligible entries at the end of the column are omitted.
    pub(crate) fn unit(&self, j: usize) -> Vec<f64> {
        let band = self.rows.iter().enumerate().map(|(i, (first, _))| i - first).max().unwrap_or(0);
        let mut column = vec![1.0 / self.rows[j].1[j - self.rows[j].0]];
        let nothing = 1e-14 * column[0].abs();
        for (i, (first, row)) in self.rows.iter().enumerate().skip(j + 1) {
            let (before, last) = row.split_at(i - first);
            let from = (*first).max(j);
            let dot: f64 = before[from - first..].iter().zip(&column[from - j..]).map(|(a, b)| a * b).sum();
            column.push(-dot / last[0]);
            let end = column.len();
            if end > band && column[end - band.max(1)..].iter().all(|value| value.abs() < nothing) {
                break;
            }
        }
        column
    }
}

fn product(a: &Shares, b: &Shares) -> f64 {
    a.iter()
        .map(|&(error, left)| left * b.iter().filter(|(e, _)| *e == error).map(|(_, right)| right).sum::<f64>())
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_factor_times_its_transpose_is_the_covariance() {
        let shares: Vec<Shares> =
            vec![vec![(0, 1.0)], vec![(0, -2.0), (1, 0.5)], vec![(1, 3.0)], vec![], vec![(1, 1.0), (2, 4.0)]];
        let own = [0.1, 0.2, 0.3, 0.4, 0.5];
        let whitening = Whitening::new(&own, &shares, 3);
        let covariance = Mat::from_fn(5, 5, |i, j| product(&shares[i], &shares[j]) + if i == j { own[i] } else { 0.0 });
        for j in 0..5 {
            let unit = whitening.unit(j);
            let mut column = Mat::from_fn(5, 1, |i, _| f64::from(u8::from(i == j)));
            whitening.apply(&mut column);
            (0..5).for_each(|i| {
                assert!(
                    (column[(i, 0)] - i.checked_sub(j).and_then(|k| unit.get(k)).copied().unwrap_or(0.0)).abs() < 1e-13
                )
            });
        }
        // L^-1 C L^-T is the identity.
        let mut half = covariance.clone();
        whitening.apply(&mut half);
        let mut whole = half.transpose().to_owned();
        whitening.apply(&mut whole);
        for i in 0..5 {
            for j in 0..5 {
                assert!((whole[(i, j)] - f64::from(u8::from(i == j))).abs() < 1e-13, "{i} {j} {}", whole[(i, j)]);
            }
        }
    }

    #[test]
    fn where_there_is_no_row_nothing_is_whitened() {
        let mut none = Mat::zeros(0, 3);
        Whitening::new(&[], &[], 0).apply(&mut none);
        assert_eq!((none.nrows(), none.ncols()), (0, 3));
    }
}
