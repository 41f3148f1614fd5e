//! Columns of many parameters at many samples, and their sums weighted by matrices.
//!
//! A sample has three planes, x, y and z, of one number for each parameter, so that as many parameters as a register has lanes take
//! part in each multiplication.

use std::ops::Range;

use imucal_core::effects::Sensor;
use nalgebra::{Matrix3, Vector3};
use pulp::{Arch, Simd, WithSimd};

/// Samples that are forgotten together: those behind them have to be moved.
const TOGETHER: usize = 16;

/// The most lanes that any instruction set has.
const MOST_LANES: usize = 8;

/// Columns of the parameters of one sensor.
pub(super) struct Planes {
    /// Places of the parameters among those of all terms.
    parameters: Vec<usize>,
    /// The same, as many together as stand side by side.
    runs: Vec<Range<usize>>,
    /// Length of a plane: full registers.
    width: usize,
    /// The first sample that is kept.
    first: usize,
    numbers: Vec<f64>,
}

impl Planes {
    /// No sample yet; `sensors` has the sensor of each parameter.
    pub(super) fn new(sensors: &[Sensor], own: Sensor) -> Self {
        let parameters: Vec<usize> = (0..sensors.len()).filter(|&p| sensors[p] == own).collect();
        let width = parameters.len().next_multiple_of(MOST_LANES);
        let runs = parameters.chunk_by(|a, b| a + 1 == *b).map(|run| run[0]..run[0] + run.len()).collect();
        let numbers = Vec::with_capacity(3 * TOGETHER * 3 * width);
        Self { parameters, runs, width, first: 0, numbers }
    }

    /// Places of the parameters among those of all terms.
    pub(super) fn parameters(&self) -> &[usize] {
        &self.parameters
    }

    /// Takes the columns of all terms at the next sample.
    pub(super) fn push(&mut self, columns: &[Vector3<f64>]) {
        let (start, width) = (self.numbers.len(), self.width);
        self.numbers.resize(start + 3 * width, 0.0);
        let (x, yz) = self.numbers[start..].split_at_mut(width);
        let (y, z) = yz.split_at_mut(width);
        let mut k = 0;
        for run in &self.runs {
            let own = k..k + run.len();
            let to = x[own.clone()].iter_mut().zip(&mut y[own.clone()]).zip(&mut z[own]);
            for (((x, y), z), column) in to.zip(&columns[run.clone()]) {
                (*x, *y, *z) = (column.x, column.y, column.z);
            }
            k += run.len();
        }
    }

    /// Keeps samples from `first` on, and of those before so few that all stay in the processor's cache.
    pub(super) fn forget_before(&mut self, first: usize) {
        if first >= self.first + TOGETHER {
            let gone = ((first - self.first) * 3 * self.width).min(self.numbers.len());
            self.numbers.drain(..gone);
            self.first = first;
        }
    }

    /// Sums over the samples from `first` on, each times its matrices; one sum for each matrix.
    pub(super) fn weighted<const M: usize>(&self, first: usize, weights: &[[Matrix3<f64>; M]]) -> [Sum; M] {
        let size = 3 * self.width;
        let mut sums = [(); M].map(|()| Sum { width: self.width, numbers: vec![0.0; size] });
        if !self.parameters.is_empty() {
            let start = (first - self.first) * size;
            let numbers = &self.numbers[start..start + weights.len() * size];
            let to = sums.each_mut().map(|sum| sum.numbers.as_mut_slice());
            Arch::new().dispatch(Weighted { width: self.width, numbers, weights, to });
        }
        sums
    }
}

/// A column for each parameter of [`Planes`].
#[derive(Clone)]
pub(super) struct Sum {
    width: usize,
    numbers: Vec<f64>,
}

impl Sum {
    pub(super) fn zero(planes: &Planes) -> Self {
        Self { width: planes.width, numbers: vec![0.0; 3 * planes.width] }
    }

    pub(super) fn add(&mut self, other: &Self) {
        self.numbers.iter_mut().zip(&other.numbers).for_each(|(to, more)| *to += more);
    }

    /// The column of the parameter at place `k` of [`Planes::parameters`].
    pub(super) fn column(&self, k: usize) -> Vector3<f64> {
        let at = |axis: usize| self.numbers[axis * self.width + k];
        Vector3::new(at(0), at(1), at(2))
    }
}

/// The matrices of each sample times its columns.
struct Weighted<'a, const M: usize> {
    width: usize,
    numbers: &'a [f64],
    weights: &'a [[Matrix3<f64>; M]],
    to: [&'a mut [f64]; M],
}

impl<const M: usize> WithSimd for Weighted<'_, M> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { width, numbers, weights, to } = self;
        let (numbers, _) = S::as_simd_f64s(numbers);
        let to = to.map(|to| S::as_mut_simd_f64s(to).0);
        let (vectors, zero) = (width / S::F64_LANES, simd.splat_f64s(0.0));
        for v in 0..vectors {
            let mut sums = [[zero; 3]; M];
            for (sample, weights) in numbers.chunks_exact(3 * vectors).zip(weights) {
                let column = [sample[v], sample[vectors + v], sample[2 * vectors + v]];
                for (sums, weight) in sums.iter_mut().zip(weights) {
                    for (r, sum) in sums.iter_mut().enumerate() {
                        for (c, column) in column.iter().enumerate() {
                            *sum = simd.mul_add_e_f64s(simd.splat_f64s(weight[(r, c)]), *column, *sum);
                        }
                    }
                }
            }
            for (m, sums) in sums.iter().enumerate() {
                for (r, sum) in sums.iter().enumerate() {
                    to[m][r * vectors + v] = *sum;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weighted_sums_are_those_of_matrices_times_columns() {
        let sensors: Vec<Sensor> =
            (0..21).map(|p| if p % 3 == 1 { Sensor::Accelerometer } else { Sensor::Gyroscope }).collect();
        let column = |k: usize, p: usize| Vector3::new((k + p) as f64, (k * p) as f64, 1.0 / (1 + k + p) as f64);
        let mut planes = Planes::new(&sensors, Sensor::Gyroscope);
        for k in 0..7 {
            planes.push(&(0..sensors.len()).map(|p| column(k, p)).collect::<Vec<_>>());
        }
        planes.forget_before(1);
        let weight = |k: usize, m: usize| Matrix3::from_fn(|r, c| ((k + 3 * r) as f64 - (m * c) as f64).sin());
        let weights: Vec<[Matrix3<f64>; 2]> = (2..6).map(|k| [weight(k, 1), weight(k, 2)]).collect();
        let sums = planes.weighted(2, &weights);
        for (m, sum) in sums.iter().enumerate() {
            for (k, &p) in planes.parameters().iter().enumerate() {
                let expected: Vector3<f64> = (2..6).map(|s| weight(s, m + 1) * column(s, p)).sum();
                assert!((sum.column(k) - expected).norm() < 1e-12 * expected.norm(), "{m} {p}");
            }
        }
        assert_eq!(planes.parameters().len(), 14);
    }
}
