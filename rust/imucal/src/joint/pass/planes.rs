//! Columns of many parameters in many states, and what matrices make of them.
//!
//! A state has three planes, x, y and z, of one number for each parameter, so that as many parameters as a register has lanes take
//! part in each multiplication.

use std::ops::Range;

use nalgebra::{Matrix3, Vector3};
use pulp::{Arch, Simd, WithSimd};

/// The most lanes that any instruction set has.
const MOST_LANES: usize = 8;

/// Columns of some parameters.
pub(crate) struct Planes {
    /// Their places among all columns.
    parameters: Vec<usize>,
    /// The same, as many together as stand side by side.
    runs: Vec<Range<usize>>,
    /// Length of a plane: full registers.
    width: usize,
    numbers: Vec<f64>,
}

impl Planes {
    /// No state yet, and room for so many; the parameters have these places among all columns.
    pub(crate) fn new(parameters: Vec<usize>, states: usize) -> Self {
        let width = parameters.len().next_multiple_of(MOST_LANES);
        let runs = parameters.chunk_by(|a, b| a + 1 == *b).map(|run| run[0]..run[0] + run.len()).collect();
        Self { parameters, runs, width, numbers: Vec::with_capacity(states * 3 * width) }
    }

    /// Of the same parameters, with room for so many states.
    pub(crate) fn like(&self, states: usize) -> Self {
        Self::new(self.parameters.clone(), states)
    }

    /// Places of the parameters among all columns.
    pub(crate) fn parameters(&self) -> &[usize] {
        &self.parameters
    }

    /// Length of a plane.
    pub(crate) fn width(&self) -> usize {
        self.width
    }

    /// The planes of a next state, all zero.
    #[inline(always)]
    pub(crate) fn next(&mut self) -> &mut [f64] {
        let start = self.numbers.len();
        self.numbers.resize(start + 3 * self.width, 0.0);
        &mut self.numbers[start..]
    }

    /// Takes the column of a single parameter in the next state.
    pub(crate) fn push_one(&mut self, column: &Vector3<f64>) {
        let width = self.width;
        let state = self.next();
        (0..3).for_each(|axis| state[axis * width] = column[axis]);
    }

    /// Takes those of all columns in the next state.
    pub(crate) fn push(&mut self, columns: &[Vector3<f64>]) {
        let Self { runs, width, numbers, .. } = self;
        for axis in 0..3 {
            let end = numbers.len() + *width;
            runs.iter().for_each(|run| numbers.extend(columns[run.clone()].iter().map(|column| column[axis])));
            numbers.resize(end, 0.0);
        }
    }

    /// Planes of zeros.
    pub(crate) fn zero(&self) -> Vec<f64> {
        vec![0.0; 3 * self.width]
    }

    /// Adds what the matrix of each state makes of its columns to planes, and forgets them.
    pub(crate) fn add_up(&mut self, matrices: &[Matrix3<f64>], sum: &mut [f64]) {
        if !self.parameters.is_empty() {
            Arch::new().dispatch(AddUp { numbers: &self.numbers, matrices, sum });
        }
        self.numbers.clear();
    }

    /// Puts what a matrix makes of the columns of the last state in their place.
    pub(crate) fn turn_last(&mut self, matrix: &Matrix3<f64>) {
        if let Some(first) = self.numbers.len().checked_sub(3 * self.width).filter(|_| self.width > 0) {
            Arch::new().dispatch(Turn { state: &mut self.numbers[first..], matrix });
        }
    }

    /// The sum of the first states, so many.
    pub(crate) fn sum(&self, states: usize) -> Vec<f64> {
        let mut sum = self.zero();
        if self.width > 0 {
            Arch::new().dispatch(AddAll { numbers: &self.numbers[..states * 3 * self.width], sum: &mut sum });
        }
        sum
    }

    /// Puts columns in planes as these are, with the other sign, where their parameters have their places.
    pub(crate) fn put_negative(&self, planes: &[f64], to: &mut [Vector3<f64>]) {
        self.parameters.iter().enumerate().for_each(|(k, p)| to[*p] = -self.column(planes, k));
    }

    /// The column of parameter `k` of these.
    pub(crate) fn column(&self, planes: &[f64], k: usize) -> Vector3<f64> {
        Vector3::from_fn(|axis, _| planes[axis * self.width + k])
    }

    /// The planes of all states, one after the other.
    #[inline(always)]
    pub(crate) fn registers<S: Simd>(&self, _: S) -> &[S::f64s] {
        S::as_simd_f64s(&self.numbers).0
    }

    /// The planes of a state, one after the other.
    #[inline(always)]
    pub(crate) fn of(&self, state: usize) -> &[f64] {
        &self.numbers[state * 3 * self.width..][..3 * self.width]
    }
}

/// A matrix times a column in each lane, and what is there already.
#[inline(always)]
fn times_plus<S: Simd>(simd: S, matrix: &Matrix3<f64>, column: [S::f64s; 3], there: [S::f64s; 3]) -> [S::f64s; 3] {
    let mut sums = there;
    for (r, sum) in sums.iter_mut().enumerate() {
        for (c, column) in column.iter().enumerate() {
            *sum = simd.mul_add_e_f64s(simd.splat_f64s(matrix[(r, c)]), *column, *sum);
        }
    }
    sums
}

struct AddUp<'a> {
    numbers: &'a [f64],
    matrices: &'a [Matrix3<f64>],
    sum: &'a mut [f64],
}

impl WithSimd for AddUp<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let ((numbers, _), (sum, _)) = (S::as_simd_f64s(self.numbers), S::as_mut_simd_f64s(self.sum));
        let vectors = sum.len() / 3;
        for v in 0..vectors {
            let places = [v, vectors + v, 2 * vectors + v];
            let mut sums = places.map(|place| sum[place]);
            for (state, matrix) in numbers.chunks_exact(3 * vectors).zip(self.matrices) {
                sums = times_plus(simd, matrix, places.map(|place| state[place]), sums);
            }
            (0..3).for_each(|r| sum[places[r]] = sums[r]);
        }
    }
}

struct Turn<'a> {
    state: &'a mut [f64],
    matrix: &'a Matrix3<f64>,
}

impl WithSimd for Turn<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let zero = [simd.splat_f64s(0.0); 3];
        let (state, _) = S::as_mut_simd_f64s(self.state);
        let vectors = state.len() / 3;
        for v in 0..vectors {
            let places = [v, vectors + v, 2 * vectors + v];
            let turned = times_plus(simd, self.matrix, places.map(|place| state[place]), zero);
            (0..3).for_each(|r| state[places[r]] = turned[r]);
        }
    }
}

struct AddAll<'a> {
    numbers: &'a [f64],
    sum: &'a mut [f64],
}

impl WithSimd for AddAll<'_> {
    type Output = ();

    #[inline(always)] // With the widest registers.
    fn with_simd<S: Simd>(self, _: S) {
        for state in self.numbers.chunks_exact(self.sum.len()) {
            self.sum.iter_mut().zip(state).for_each(|(sum, number)| *sum += number);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_are_those_of_matrices_times_columns() {
        let column = |k: usize, p: usize| Vector3::new((k + p) as f64, (k * p) as f64, 1.0 / (1 + k + p) as f64);
        let matrix = |k: usize| Matrix3::from_fn(|r, c| ((k + 3 * r) as f64 - (2 * c) as f64).sin());
        let matrices: Vec<Matrix3<f64>> = (0..7).map(matrix).collect();
        let mut planes = Planes::new((0..21).filter(|p| p % 3 != 1).collect(), 7);
        let mut sum = planes.zero();
        let push = |planes: &mut Planes, k: usize| {
            planes.push(&(0..21).map(|p| column(k, p)).collect::<Vec<_>>());
        };
        for states in [0..4, 4..7] {
            states.clone().for_each(|k| push(&mut planes, k));
            planes.add_up(&matrices[states], &mut sum);
        }
        for (k, matrix) in matrices.iter().enumerate() {
            push(&mut planes, k);
            planes.turn_last(matrix);
        }
        let total = planes.sum(7);
        for (k, &p) in planes.parameters.iter().enumerate() {
            let turned: Vec<Vector3<f64>> = (0..7).map(|state| matrix(state) * column(state, p)).collect();
            let expected: Vector3<f64> = turned.iter().sum();
            for sum in [&sum, &total] {
                assert!((planes.column(sum, k) - expected).norm() < 1e-12 * expected.norm(), "{p}");
            }
            for (state, turned) in turned.iter().enumerate() {
                let own = planes.column(planes.of(state), k);
                assert!((own - turned).norm() < 1e-12 * turned.norm(), "{state} {p}");
            }
        }
        assert_eq!(planes.parameters.len(), 14);
    }
}
