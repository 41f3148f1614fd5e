//! Computes the largest eigenvalues of a symmetric positive semidefinite matrix, with their eigenvectors.

use faer::Mat;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use crate::numerics::blocked::product;

/// If a matrix has at most this number of rows, all its eigenvalues are computed, which takes at most some tens of
/// milliseconds. Larger matrices are decomposed by subspace iteration, unless a third or more of their eigenvalues are
/// requested.
const WHOLE: usize = 300;
/// Ratio of the dimension of the iterated subspace to the number of requested eigenvectors. With a larger subspace,
/// fewer iterations are needed, but each iteration is slower.
const BESIDE: usize = 3;
/// The iteration ends if |A u - s u| is below this share of the largest eigenvalue, for all requested pairs of an
/// eigenvalue s and an eigenvector u of the matrix A.
const TOLERANCE: f64 = 1e-10;
/// Maximum number of iterations. The covariance matrix of a random walk takes about 12 iterations, and that of a smooth
/// process fewer.
const MOST_ROUNDS: usize = 100;
/// Seed of the random start vectors. It is fixed, so that results are reproducible.
const SEED: u64 = 1;

/// Eigenvalues in decreasing order, and one eigenvector (column) for each of them.
pub(crate) struct LeadingEigen {
    pub(crate) values: Vec<f64>,
    pub(crate) vectors: Mat<f64>,
}

impl LeadingEigen {
    /// The `count` largest eigenvalues of `matrix`, or all its eigenvalues if it has fewer than `count` rows. `None` if
    /// the decomposition fails.
    ///
    /// A large matrix is decomposed by subspace iteration with Rayleigh-Ritz projections (Halko, Martinsson and Tropp,
    /// SIAM Review 53, 2011, 217-288). The time of an iteration grows only with the square of the number of rows.
    pub(crate) fn of(matrix: &Mat<f64>, count: usize) -> Option<Self> {
        let n = matrix.nrows();
        if n <= WHOLE.max(BESIDE * count) { Self::all(matrix, count) } else { Self::iterated(matrix, count) }
    }

    fn all(matrix: &Mat<f64>, count: usize) -> Option<Self> {
        let (eigen, n) = (matrix.self_adjoint_eigen(faer::Side::Lower).ok()?, matrix.nrows());
        let kept = count.min(n);
        Some(Self {
            values: (0..kept).map(|k| eigen.S()[n - 1 - k]).collect(),
            vectors: Mat::from_fn(n, kept, |i, k| eigen.U()[(i, n - 1 - k)]),
        })
    }

    fn iterated(matrix: &Mat<f64>, count: usize) -> Option<Self> {
        let mut generator = ChaCha8Rng::seed_from_u64(SEED);
        let mut image = Mat::from_fn(matrix.nrows(), BESIDE * count, |_, _| StandardNormal.sample(&mut generator));
        for _ in 0..MOST_ROUNDS {
            let basis = image.qr().compute_thin_Q();
            image = product(matrix.as_ref(), basis.as_ref());
            let inner = Self::all(&(basis.transpose() * &image), BESIDE * count)?;
            // After this rotation, the columns of `image` are the products A u of the matrix A and the approximate
            // eigenvectors u.
            image = &image * &inner.vectors;
            let vectors = &basis * inner.vectors.subcols(0, count);
            if is_converged(&image, &vectors, &inner.values) {
                return Some(Self { values: inner.values[..count].to_vec(), vectors });
            }
        }
        Self::all(matrix, count)
    }
}

/// Whether |A u - s u| is small for all columns u of `vectors`. A is the matrix that is decomposed, and `image`
/// contains the vectors A u. `values` contains the eigenvalues s in decreasing order.
fn is_converged(image: &Mat<f64>, vectors: &Mat<f64>, values: &[f64]) -> bool {
    values.iter().zip(0..vectors.ncols()).all(|(value, k)| {
        let (image, vector) = (image.col_as_slice(k), vectors.col_as_slice(k));
        let square: f64 = image.iter().zip(vector).map(|(image, u)| (image - value * u).powi(2)).sum();
        square.sqrt() <= TOLERANCE * values[0]
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cancellation::Cancellation;
    use crate::error::Error;

    fn kernel(n: usize, of: impl Fn(f64, f64) -> f64) -> Mat<f64> {
        let at = |i: usize| (i as f64 + 0.5) / n as f64;
        Mat::from_fn(n, n, |i, j| of(at(i), at(j)))
    }

    /// Asserts that the leading eigenvalues equal those of the complete decomposition. Eigenvectors of equal
    /// eigenvalues are not unique, so the eigenvectors are not compared. Instead, |A u - s u| is checked for each
    /// eigenvalue s and eigenvector u of the matrix A, and the scalar products of the eigenvectors are checked.
    fn check(matrix: &Mat<f64>, count: usize) {
        let (all, some) = (LeadingEigen::all(matrix, count).unwrap(), LeadingEigen::iterated(matrix, count).unwrap());
        for (a, b) in all.values.iter().zip(&some.values) {
            assert!((a - b).abs() < 1e-10 * all.values[0], "{a} {b}");
        }
        for k in 0..count {
            let image = matrix * some.vectors.subcols(k, 1);
            let error = (0..matrix.nrows())
                .map(|i| (image[(i, 0)] - some.values[k] * some.vectors[(i, k)]).powi(2))
                .sum::<f64>()
                .sqrt();
            assert!(error < 2.0 * TOLERANCE * all.values[0], "{k}: {error:e}");
        }
        let gram = some.vectors.transpose() * &some.vectors;
        let is_unit = |i: usize, j: usize| (gram[(i, j)] - f64::from(u8::from(i == j))).abs() < 1e-12;
        assert!((0..count).all(|i| (0..count).all(|j| is_unit(i, j))));
    }

    #[test]
    fn leading_pairs_are_those_of_the_complete_decomposition() {
        // The four matrices are the covariance matrix of a random walk, the covariance matrix of a smooth random
        // process, a matrix of rank two, and a matrix of rank five that consists of five blocks of equal rows.
        check(&kernel(400, f64::min), 20);
        check(&kernel(400, |a, b| (-0.5 * ((a - b) / 0.1).powi(2)).exp()), 12);
        check(&kernel(400, |a, b| (7.0 * a).sin() * (7.0 * b).sin() + (7.0 * a).cos() * (7.0 * b).cos()), 12);
        check(&kernel(400, |a, b| f64::from(u8::from((5.0 * a).floor() == (5.0 * b).floor()))), 12);
    }

    #[test]
    fn a_small_matrix_has_all_its_eigenvalues() {
        let eigen = LeadingEigen::of(&kernel(4, f64::min), 12).unwrap();
        assert_eq!((eigen.values.len(), eigen.vectors.ncols()), (4, 4));
        assert!(eigen.values.is_sorted_by(|a, b| a >= b));
    }

    #[test]
    fn the_decomposition_of_a_large_matrix_can_be_cancelled() {
        let (cancellation, matrix) = (Cancellation::new(), kernel(400, f64::min));
        cancellation.cancel();
        let found = cancellation.run(|| Ok(LeadingEigen::of(&matrix, 20).is_some()));
        assert!(matches!(found, Err(Error::Cancelled)));
    }
}
