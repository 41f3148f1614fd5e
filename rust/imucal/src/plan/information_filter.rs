//! Accumulates the information of a run with an information filter. The state of the filter consists of the current
//! gravity direction (two angles) and of all parameters.
//!
//! ```text
//! measurement   y = A d + B theta + noise
//! propagation   d' = d - C theta + noise of covariance Q;   d is then eliminated
//! ```
//!
//! y is a measurement divided by its standard deviation. d contains the two angles of the gravity direction at the
//! start of an interval, and d' contains these angles at its end. theta contains all parameters. A, B and C are
//! Jacobians. The gravity direction at a rest is directly coupled only to the gravity directions at the previous and at
//! the next rest. Directions are therefore eliminated one after the other, and the computing time is proportional to
//! the number of rests.

use faer::Mat;
use nalgebra::Matrix2;

use super::DIRECTION;

/// The information filter. It stores the normal matrix (information matrix) of its state. The first two rows and
/// columns of this matrix belong to the current gravity direction, and the others to the parameters.
#[derive(Clone)]
pub(super) struct InformationFilter {
    width: usize,
    /// Entries of the normal matrix, row by row. Only the upper triangle is used.
    matrix: Vec<f64>,
}

/// Propagation of the direction of gravity over a time interval with the measured angular rate.
#[derive(Clone)]
pub(super) struct Propagation {
    /// The matrix C in `d' = d - C theta`. It contains the derivatives, with reversed sign, of the two angles of the
    /// gravity direction at the end of the interval with respect to the parameters.
    pub(super) jacobian: [Vec<f64>; 2],
    /// Covariance Q of the noise that the propagation adds to the two angles, rad^2.
    pub(super) covariance: Matrix2<f64>,
}

impl InformationFilter {
    /// A filter without information.
    pub(super) fn new(parameters: usize) -> Self {
        let width = DIRECTION + parameters;
        Self { width, matrix: vec![0.0; width * width] }
    }

    /// Adds a measurement and multiplies its information by `weight`. `row` contains the derivatives divided by the
    /// standard deviation of the measurement. If `row` is scaled for a mean over one second, `weight` is the actual
    /// averaging time in seconds, because the variance of a mean is inversely proportional to the averaging time. The
    /// derivatives with respect to the two angles of the gravity direction come first in `row`, and the derivatives
    /// with respect to the parameters follow.
    pub(super) fn add_row(&mut self, row: &[f64], weight: f64) {
        for (i, value) in row.iter().enumerate().filter(|(_, value)| **value != 0.0) {
            let factor = weight * value;
            let start = i * self.width;
            for (entry, other) in self.matrix[start + i..start + self.width].iter_mut().zip(&row[i..]) {
                *entry += factor * other;
            }
        }
    }

    /// Propagates the gravity direction over an interval, and eliminates the direction at the start of the interval.
    pub(super) fn propagate(&mut self, step: &Propagation) {
        let width = self.width;
        let weight = inverse(&step.covariance);
        let here = Matrix2::new(self.matrix[0], self.matrix[1], self.matrix[1], self.matrix[width + 1]);
        let left = inverse(&(here + weight));
        // Off-diagonal entries of the normal matrix between the eliminated direction and the parameters.
        let mut shared = [vec![0.0; width - DIRECTION], vec![0.0; width - DIRECTION]];
        let mut propagated = shared.clone();
        for p in 0..width - DIRECTION {
            let by = [step.jacobian[0][p], step.jacobian[1][p]];
            for i in 0..2 {
                propagated[i][p] = weight[(i, 0)] * by[0] + weight[(i, 1)] * by[1];
                shared[i][p] = self.matrix[i * width + DIRECTION + p] - propagated[i][p];
            }
        }
        let solved = |i: usize, p: usize| left[(i, 0)] * shared[0][p] + left[(i, 1)] * shared[1][p];
        for p in 0..width - DIRECTION {
            let (first, second) = (propagated[0][p], propagated[1][p]);
            let (by, gone) = ([step.jacobian[0][p], step.jacobian[1][p]], [solved(0, p), solved(1, p)]);
            let row = (DIRECTION + p) * width + DIRECTION;
            if first != 0.0 || second != 0.0 || gone != [0.0; 2] {
                for q in p..width - DIRECTION {
                    self.matrix[row + q] += by[0] * propagated[0][q] + by[1] * propagated[1][q]
                        - gone[0] * shared[0][q]
                        - gone[1] * shared[1][q];
                }
            }
            for i in 0..2 {
                self.matrix[i * width + DIRECTION + p] =
                    propagated[i][p] + weight[(i, 0)] * gone[0] + weight[(i, 1)] * gone[1];
            }
        }
        let next = weight - weight * left * weight;
        (self.matrix[0], self.matrix[1], self.matrix[width + 1]) = (next[(0, 0)], next[(0, 1)], next[(1, 1)]);
    }

    /// Information matrix of the parameters only, after elimination of the last gravity direction.
    pub(super) fn information(&self) -> Mat<f64> {
        let (width, n) = (self.width, self.width - DIRECTION);
        let left = inverse(&Matrix2::new(self.matrix[0], self.matrix[1], self.matrix[1], self.matrix[width + 1]));
        let shared = |i: usize, p: usize| self.matrix[i * width + DIRECTION + p];
        Mat::from_fn(n, n, |p, q| {
            let (p, q) = (p.min(q), p.max(q));
            let solved = |i: usize| left[(i, 0)] * shared(0, q) + left[(i, 1)] * shared(1, q);
            self.matrix[(DIRECTION + p) * width + DIRECTION + q] - shared(0, p) * solved(0) - shared(1, p) * solved(1)
        })
    }
}

/// Inverse of a symmetric 2x2 matrix. The result is zero for a singular matrix. A matrix is singular here only if the
/// filter has no information about the direction yet, or if the noise of the propagation is zero.
fn inverse(matrix: &Matrix2<f64>) -> Matrix2<f64> {
    let determinant = matrix.determinant();
    if determinant == 0.0 {
        return Matrix2::zeros();
    }
    Matrix2::new(matrix[(1, 1)], -matrix[(0, 1)], -matrix[(0, 1)], matrix[(0, 0)]) / determinant
}

#[cfg(test)]
mod tests {
    use faer::linalg::solvers::Solve;

    use super::*;

    /// Elimination of the gravity directions step by step must give the same information as elimination of all
    /// directions together. The example has three directions and two parameters.
    #[test]
    fn what_is_eliminated_step_by_step_is_what_is_eliminated_at_once() {
        let value = |i: usize| ((i * 37 + 11) as f64).sin();
        let steps: Vec<Propagation> = (0..2)
            .map(|k| Propagation {
                jacobian: [vec![value(4 * k), value(4 * k + 1)], vec![value(4 * k + 2), value(4 * k + 3)]],
                covariance: Matrix2::new(0.5, 0.1, 0.1, 0.3 + k as f64),
            })
            .collect();
        let row = |k: usize, r: usize| -> Vec<f64> { (0..4).map(|c| value(100 + 12 * k + 4 * r + c)).collect() };
        let mut filter = InformationFilter::new(2);
        let mut whole = Mat::<f64>::zeros(8, 8);
        for k in 0..3 {
            for r in 0..3 {
                let row = row(k, r);
                filter.add_row(&row, 2.0);
                let place = |c: usize| if c < 2 { 2 * k + c } else { 4 + c };
                for (i, j) in (0..4).flat_map(|i| (0..4).map(move |j| (i, j))) {
                    whole[(place(i), place(j))] += 2.0 * row[i] * row[j];
                }
            }
            let Some(step) = steps.get(k) else { break };
            filter.propagate(step);
            // The residual of the propagation is d' - d + C theta. d and d' are the gravity directions before and after
            // the propagation, C is `step.jacobian`, and theta contains the two parameters.
            let weight = inverse(&step.covariance);
            let noise = |i: usize, c: usize| match c {
                _ if c == 2 * k + 2 + i => 1.0,
                _ if c == 2 * k + i => -1.0,
                6 | 7 => step.jacobian[i][c - 6],
                _ => 0.0,
            };
            for (i, j) in (0..8).flat_map(|i| (0..8).map(move |j| (i, j))) {
                for (a, b) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
                    whole[(i, j)] += noise(a, i) * weight[(a, b)] * noise(b, j);
                }
            }
        }
        let directions = whole.submatrix(0, 0, 6, 6).to_owned();
        let shared = whole.submatrix(0, 6, 6, 2).to_owned();
        let own = whole.submatrix(6, 6, 2, 2).to_owned();
        let expected = own - shared.transpose() * directions.llt(faer::Side::Lower).unwrap().solve(&shared);
        let found = filter.information();
        for (i, j) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            assert!(
                (found[(i, j)] - expected[(i, j)]).abs() < 1e-10,
                "{i} {j}: {} {}",
                found[(i, j)],
                expected[(i, j)]
            );
        }
    }
}
