//! What matrices make of the columns of many parameters, state by state.

use nalgebra::{Matrix3, Vector3};
use pulp::{Arch, Simd, WithSimd};

use super::planes::Planes;
use crate::numerics::aligned::{Aligned, WIDEST};

/// States that are kept: one, and those on either side.
const KEPT: usize = 3;

/// The last states, and the sum of all.
pub(super) struct Turned {
    last: Planes,
    sum: Aligned,
    count: usize,
}

impl Turned {
    /// No state yet; the parameters have these places among all.
    pub(super) fn new(parameters: Vec<usize>) -> Self {
        let last = Planes::zeros(parameters, KEPT);
        Self { sum: Aligned::zeros(3 * last.width()), last, count: 0 }
    }

    /// Takes what a matrix makes of the columns of the parameters in a next state. They stand side by side, and as many as a register takes
    /// are read behind them.
    pub(super) fn push(&mut self, columns: &[Vector3<f64>], matrix: &Matrix3<f64>) {
        let columns = &columns[..self.last.width()];
        let (to, sum) = (self.last.of_mut(self.count % KEPT), &mut *self.sum);
        Arch::new().dispatch(Push::<true> { columns, matrix, to, sum });
        self.count += 1;
    }

    /// The same of a state that nobody asks for by itself: it is added to the sum.
    pub(super) fn add(&mut self, columns: &[Vector3<f64>], matrix: &Matrix3<f64>) {
        let columns = &columns[..self.last.width()];
        Arch::new().dispatch(Push::<false> { columns, matrix, to: &mut [], sum: &mut self.sum });
    }

    /// How many states there have been.
    pub(super) fn count(&self) -> usize {
        self.count
    }

    /// The planes of one of the last states.
    #[inline(always)]
    pub(super) fn of(&self, state: usize) -> &[f64] {
        self.last.of(state % KEPT)
    }

    /// The sum of all states, plane by plane.
    pub(super) fn sum(&self) -> &[f64] {
        &self.sum
    }

    /// Puts the sum, with the other sign, where the parameters have their places.
    pub(super) fn write_negative_sum(&self, to: &mut [Vector3<f64>]) {
        self.last.write_negative(&self.sum, to);
    }

    /// Room for so many states of the same parameters.
    pub(super) fn room(&self, states: usize) -> Planes {
        Planes::new(self.last.parameters().to_vec(), states)
    }
}

/// `KEEPS` says whether the state is kept by itself.
struct Push<'a, const KEEPS: bool> {
    columns: &'a [Vector3<f64>],
    matrix: &'a Matrix3<f64>,
    to: &'a mut [f64],
    sum: &'a mut [f64],
}

impl<const KEEPS: bool> WithSimd for Push<'_, KEEPS> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { columns, matrix, to, sum } = self;
        let mut rows = [[simd.splat_f64s(0.0); 3]; 3];
        for (r, row) in rows.iter_mut().enumerate() {
            for (c, entry) in row.iter_mut().enumerate() {
                *entry = simd.splat_f64s(matrix[(r, c)]);
            }
        }
        let width = columns.len();
        for (group, own) in columns.as_chunks::<WIDEST>().0.iter().enumerate() {
            let (mut x, mut y, mut z) = ([0.0; WIDEST], [0.0; WIDEST], [0.0; WIDEST]);
            for (lane, column) in own.iter().enumerate() {
                (x[lane], y[lane], z[lane]) = (column[0], column[1], column[2]);
            }
            let (x, y, z) = (S::as_simd_f64s(&x).0, S::as_simd_f64s(&y).0, S::as_simd_f64s(&z).0);
            for (axis, row) in rows.iter().enumerate() {
                let first = axis * width + group * WIDEST;
                let lanes = first..first + WIDEST;
                let sum = S::as_mut_simd_f64s(&mut sum[lanes.clone()]).0;
                for v in 0..WIDEST / S::F64_LANES {
                    let turned = simd.mul_add_e_f64s(row[1], y[v], simd.mul_f64s(row[0], x[v]));
                    let turned = simd.mul_add_e_f64s(row[2], z[v], turned);
                    if KEEPS {
                        S::as_mut_simd_f64s(&mut to[lanes.clone()]).0[v] = turned;
                    }
                    sum[v] = simd.add_f64s(sum[v], turned);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_states_and_the_sum_are_those_of_matrices_times_columns() {
        let column = |k: usize, p: usize| Vector3::new((k + p) as f64, (k * p) as f64, 1.0 / (1 + k + p) as f64);
        let matrix = |k: usize| Matrix3::from_fn(|r, c| ((k + 3 * r) as f64 - (2 * c) as f64).sin());
        let parameters: Vec<usize> = (0..21).filter(|p| p % 3 != 1).collect();
        let (mut turned, mut added) = (Turned::new(parameters.clone()), Turned::new(parameters.clone()));
        for k in 0..7 {
            let own = parameters.iter().map(|p| column(k, *p)).chain([Vector3::zeros(); WIDEST]);
            let own: Vec<_> = own.collect();
            turned.push(&own, &matrix(k));
            added.add(&own, &matrix(k));
        }
        assert_eq!(turned.count(), 7);
        assert_eq!(turned.sum(), added.sum());
        let mut sums = vec![Vector3::zeros(); 21];
        turned.write_negative_sum(&mut sums);
        for (k, &p) in parameters.iter().enumerate() {
            let expected: Vec<Vector3<f64>> = (0..7).map(|state| matrix(state) * column(state, p)).collect();
            let sum: Vector3<f64> = expected.iter().sum();
            assert!((sums[p] + sum).norm() < 1e-12 * sum.norm(), "{p}");
            for state in 4..7 {
                let own = turned.last.column(turned.of(state), k);
                assert!((own - expected[state]).norm() < 1e-12 * expected[state].norm(), "{state} {p}");
            }
        }
    }
}
