//! Eigenfunctions of a covariance kernel, computed from the eigenvectors of the kernel's matrix at given points
//! (Nystroem extension).

use faer::Mat;

use crate::numerics::leading_eigen::LeadingEigen;

/// Eigenfunctions whose eigenvalue is below this share of the largest eigenvalue are omitted.
const SMALLEST: f64 = 1e-3;

/// Eigenfunctions `f_c(x) = sqrt(n / trace K) sum_i k(x, x_i) U_ic / sqrt(s_c)`, where k is the kernel after its mean
/// over the n given points has been subtracted in both arguments. K is the matrix k(x_i, x_j) at these points, with the
/// eigendecomposition `K = U diag(s) U^T`. If all functions are kept, the mean over the points of `sum_c f_c^2` is one.
/// Between the points, each function is the conditional mean of a Gaussian process with this kernel, given the values
/// of the function at the points (Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, (2.25)).
pub(crate) struct Smooth<T> {
    points: Vec<T>,
    weights: Mat<f64>,
    means: Vec<f64>,
    mean: f64,
}

impl<T> Smooth<T> {
    /// Computes the eigenfunctions with the largest eigenvalues, at most `most`. `None` if the kernel is constant over
    /// all points. `kernel` writes the covariances between one point and several other points.
    pub(crate) fn new(points: Vec<T>, kernel: impl Fn(&T, &[T], &mut [f64]), most: usize) -> Option<Self> {
        let n = points.len();
        let mut matrix = Mat::zeros(n, n);
        points.iter().enumerate().for_each(|(j, point)| kernel(point, &points, matrix.col_as_slice_mut(j)));
        let means: Vec<f64> = (0..n).map(|i| (0..n).map(|j| matrix[(i, j)]).sum::<f64>() / n as f64).collect();
        let mean = means.iter().sum::<f64>() / n as f64;
        let centred = Mat::from_fn(n, n, |i, j| matrix[(i, j)] - means[i] - means[j] + mean);
        let trace: f64 = (0..n).map(|i| centred[(i, i)]).sum();
        if trace <= 1e-12 {
            return None;
        }
        let LeadingEigen { values, vectors } = LeadingEigen::of(&centred, most)?;
        let kept = values.iter().take_while(|value| **value > SMALLEST * values[0]).count();
        let scale = n as f64 / trace;
        let weights = Mat::from_fn(n, kept, |i, c| vectors[(i, c)] * (scale / values[c]).sqrt());
        Some(Self { points, weights, means, mean })
    }

    /// Number of eigenfunctions.
    pub(crate) fn width(&self) -> usize {
        self.weights.ncols()
    }

    /// Values of all eigenfunctions (rows) at the given points (columns). `kernel` must be the kernel passed to `new`.
    pub(crate) fn at(&self, points: &[T], kernel: impl Fn(&T, &[T], &mut [f64])) -> Mat<f64> {
        let n = self.points.len();
        let mut near = Mat::zeros(n, points.len());
        for (x, point) in points.iter().enumerate() {
            let near = near.col_as_slice_mut(x);
            kernel(point, &self.points, near);
            let own = near.iter().sum::<f64>() / n as f64;
            near.iter_mut().zip(&self.means).for_each(|(k, mean)| *k += self.mean - own - mean);
        }
        self.weights.transpose() * near
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The conditional mean of a random walk is linear between the points at which the walk is given. At the points,
    /// the mean of the sum of squares of the eigenfunctions must be one.
    #[test]
    fn functions_of_a_walk_rebuild_it_and_go_straight_between_points() {
        let points: Vec<f64> = (1..=5).map(f64::from).collect();
        let walk = |a: &f64, all: &[f64], to: &mut [f64]| {
            to.iter_mut().zip(all).for_each(|(to, b)| *to = a.min(*b));
        };
        let smooth = Smooth::new(points.clone(), walk, 5).unwrap();
        let at = |x: f64| smooth.at(&[x], walk).col_as_slice(0).to_vec();
        for (a, b) in at(2.5).iter().zip(at(2.0).iter().zip(at(3.0))) {
            assert!((a - (b.0 + b.1) / 2.0).abs() < 1e-12);
        }
        let square: f64 = points.iter().flat_map(|x| at(*x)).map(|v| v * v).sum();
        assert!((square / 5.0 - 1.0).abs() < 1e-12, "{square}");
    }
}
