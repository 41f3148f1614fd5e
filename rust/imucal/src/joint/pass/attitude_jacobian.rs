//! Computes the Jacobians of the mean attitude and the mean force in each block (short interval) inside a move. A block
//! consists of one or two segments.
//!
//! A segment has n samples. `turn` is the attitude error due to a change of one parameter, and G is its increase over
//! the segment by the midpoint rule. F is the change of the force at the midpoint of the segment. R is the rotation to
//! the body frame at the start of the move, and Phi is the derivative of the force, in the body frame, with respect to
//! the parameter. Gdot is the central difference of G between the adjacent segments. G.. and F.. are second differences
//! over the adjacent segments.
//!
//! ```text
//! turn(end)    = turn(begin) + G + G.. / 24
//! turn, mean   = turn(begin) + G / 2 - (1/8 - (1 - 1/n^2) / 24) Gdot + G.. / 48,   Gdot = (G_(k+1) - G_(k-1)) / 2
//! force, mean  = F + (1 - 1/n^2) F.. / 24,   F = R Phi
//! ```

use std::ops::Range;

use imucal_core::effects::Need;
use nalgebra::{Matrix3, Vector3};
use pulp::{Simd, WithSimd};

use super::corrected::Corrected;
use super::planes::Changes;
use super::stretches::Stretches;
use super::{EvaluatedTerms, Route};
use crate::joint::model::{Model, force_by_parameters};
use crate::joint::pass::planes::Planes;
use crate::joint::terms::SideBySide;
use crate::numerics::aligned::{Aligned, WIDEST};
use crate::numerics::instructions::Instructions;
use crate::parameters::{ACCEL, BASE, GYRO_BIAS};

/// Accumulates the derivatives of attitude and force inside a move, block by block. The derivatives are stored with
/// negative sign: an increase of a parameter increases the measured rate or force, so the corrected rate or force
/// decreases.
pub(super) struct Turns<'a> {
    route: &'a Route<'a>,
    model: &'a Model,
    freed: &'a Corrected,
    stretches: Stretches,
    /// For each segment, the rotation at its midpoint times its duration, s.
    weights: Vec<Matrix3<f64>>,
    /// Derivatives of the attitude change over each segment with respect to each parameter, in the body frame at the
    /// start of the move.
    on_rate: Turned,
    /// Derivatives of the force at the midpoint of each segment with respect to each parameter, in the body frame at
    /// the start of the move.
    on_force: Turned,
    /// Derivatives of rate and force with respect to the parameters at the midpoint of a segment, in the body frame at
    /// this midpoint.
    rates: Columns<'a>,
    forces: Columns<'a>,
    /// `next` is the index of the first segment of the next block. `turned` contains the attitude error at the start of
    /// this segment, per unit of each parameter.
    next: usize,
    turned: Vec<f64>,
    /// Number of segments per block.
    of_block: usize,
    /// Derivatives of attitude and force in the blocks completed so far.
    changes: Changes,
}

/// Derivatives of the reading of one sensor with respect to the parameters. The base parameters come first, then the
/// parameters of the effects on this sensor.
struct Columns<'a> {
    base: usize,
    terms: &'a SideBySide<'a>,
    all: Vec<Vector3<f64>>,
}

impl<'a> Columns<'a> {
    fn new(base: usize, terms: &'a SideBySide<'a>) -> Self {
        let mut all = vec![Vector3::zeros(); base];
        all.extend(terms.terms.room());
        Self { base, terms, all }
    }

    /// Computes the derivatives of the sensor readings with respect to the parameters of the effects, at the midpoint
    /// of segment `k`. Returns the storage for the derivatives with respect to the base parameters, which the caller
    /// fills.
    fn at(&mut self, route: &Route<'_>, stretches: &Stretches, k: usize) -> &mut [Vector3<f64>] {
        let (base, own) = self.all.split_at_mut(self.base);
        route.columns(&self.terms.terms, &self.terms.values, stretches, k, own);
        base
    }
}

impl<'a> Turns<'a> {
    /// Prepares the derivatives of attitude and force inside a move. `size` is the number of samples per segment, and
    /// `of_block` the number of segments per block.
    pub(super) fn new(
        route: &'a Route<'a>,
        model: &'a Model,
        evaluated: &'a EvaluatedTerms<'a>,
        freed: &'a Corrected,
        [size, of_block]: [usize; 2],
    ) -> Self {
        let EvaluatedTerms { terms, on_rate, on_force, .. } = evaluated;
        let stretches = route.stretches(model, Some(freed), size, terms.needs(Need::AngularAcceleration));
        let of_rate = GYRO_BIAS.start..BASE;
        let (rates, forces) = (Columns::new(of_rate.len(), on_rate), Columns::new(ACCEL.len(), on_force));
        let turned = |base: Range<usize>, own: &SideBySide<'_>| {
            Turned::new(base.chain(own.places.iter().map(|p| BASE + p)).collect())
        };
        let (on_rate, on_force) = (turned(of_rate, on_rate), turned(ACCEL, on_force));
        let next = stretches.groups.of(route.span.first + 1 - route.reach().start);
        let blocks = stretches.count() / of_block;
        let mut turns = Self {
            route,
            model,
            freed,
            weights: stretches.weights(),
            changes: Changes { turn: on_rate.room(blocks), force: on_force.room(blocks) },
            turned: Vec::new(),
            stretches,
            on_rate,
            on_force,
            rates,
            forces,
            next,
            of_block,
        };
        turns.look_to(next);
        turns.turned = turns.on_rate.sum().to_vec();
        turns
    }

    /// Computes the derivatives of attitude and force with respect to all parameters in the segments before `end`,
    /// unless they are already known. The derivatives of the force with respect to the base parameters are evaluated at
    /// the propagated gravity, which contains no noise.
    fn look_to(&mut self, end: usize) {
        let Self { route, model, freed, stretches, weights, on_rate, on_force, rates, forces, .. } = self;
        let inverse = model.gyroscope.inverse();
        for k in on_rate.count()..end.min(stretches.count()) {
            let [added_rate, added_force] = route.mean_added(model, freed, stretches.groups.samples(k));
            let rate = stretches.states[k].angular_rate + added_rate;
            let base = rates.at(route, stretches, k);
            for i in 0..3 {
                base[i] = inverse.column(i).into_owned();
                (0..3).for_each(|j| base[3 + 3 * i + j] = inverse.column(i) * rate[j]);
            }
            on_rate.push(&rates.all, &weights[k]);
            let gravity = stretches.rotations[k].tr_mul(&route.gravity_at_start);
            let by_parameters = force_by_parameters(&model.accelerometer, &(gravity + added_force));
            let base = forces.at(route, stretches, k);
            base.iter_mut().enumerate().for_each(|(p, column)| *column = -by_parameters.column(p));
            on_force.push(&forces.all, &stretches.rotations[k]);
        }
    }

    /// Computes the mean attitude error and the mean change of the force over the next block, per unit of each
    /// parameter.
    pub(super) fn next_block(&mut self) {
        self.changes.turn.next();
        self.changes.force.next();
        for k in self.next..self.next + self.of_block {
            self.look_to(k + 2);
            Instructions::Best.run(NextStretch(self, k));
        }
        self.next += self.of_block;
    }

    /// Adds the contribution of segment `k` to the mean attitude error and the mean change of the force over its block.
    #[inline(always)] // Compiled for the widest SIMD registers of the processor.
    fn take_stretch(&mut self, k: usize) {
        let Self { stretches, on_rate, on_force, turned, of_block, changes, .. } = self;
        let (share, spread) = (1.0 / *of_block as f64, stretches.spread / 24.0);
        // Second differences are valid only if the midpoints of the two adjacent segments are equally far from that of
        // segment k. Otherwise, they are set to zero.
        let [before, after] = if stretches.are_even[k] { [k - 1, k + 1] } else { [k, k] };
        let (of_slope, of_turned) = (share * (spread - 0.125) / 2.0, share / 48.0);
        let around = on_rate.of(before).iter().zip(on_rate.of(k)).zip(on_rate.of(after));
        for (((before, own), after), (mean, turned)) in around.zip(changes.turn.last_mut().iter_mut().zip(turned)) {
            let bend = before + after - 2.0 * own;
            *mean += share * (*turned + 0.5 * own) + of_slope * (after - before) + of_turned * bend;
            *turned += own + bend / 24.0;
        }
        let around = on_force.of(before).iter().zip(on_force.of(k)).zip(on_force.of(after));
        for (((before, own), after), mean) in around.zip(changes.force.last_mut()) {
            *mean += share * (own + spread * (before + after - 2.0 * own));
        }
    }

    /// Returns the derivative of the attitude at the end of the move with respect to each of the `total` parameters,
    /// and the derivatives of the mean attitude and the mean force of each block.
    pub(super) fn at_end(mut self, total: usize) -> (Vec<Vector3<f64>>, Changes) {
        self.look_to(self.stretches.count());
        let mut turn = vec![Vector3::zeros(); total];
        self.on_rate.write_negative_sum(&mut turn);
        (turn, self.changes)
    }
}

struct NextStretch<'a, 'b>(&'a mut Turns<'b>, usize);

impl WithSimd for NextStretch<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        self.0.take_stretch(self.1);
    }
}

/// Number of segments that are kept in memory: a segment and its two neighbours.
const KEPT: usize = 3;

/// For each segment: products of a matrix and the derivatives of the sensor reading with respect to the parameters. The
/// matrix is the rotation of the segment; for rates, it is multiplied by the duration of the segment. The sum of the
/// products over all segments is stored, and the products themselves only for the latest segments.
pub(super) struct Turned {
    last: Planes,
    sum: Aligned,
    count: usize,
}

impl Turned {
    /// Storage without segments. `parameters` are the indices of the parameters in the parameter vector.
    pub(super) fn new(parameters: Vec<usize>) -> Self {
        let last = Planes::zeros(parameters, KEPT);
        Self { sum: Aligned::zeros(3 * last.width()), last, count: 0 }
    }

    /// Appends a segment. It stores the product of `matrix` and each vector in `columns`. `columns` must be padded to
    /// full SIMD registers.
    pub(super) fn push(&mut self, columns: &[Vector3<f64>], matrix: &Matrix3<f64>) {
        let columns = &columns[..self.last.width()];
        let (to, sum) = (self.last.of_mut(self.count % KEPT), &mut *self.sum);
        Instructions::Best.run(Push::<true> { columns, matrix, to, sum });
        self.count += 1;
    }

    /// Adds the products of `matrix` and each vector in `columns` to the sum, without storing the products.
    pub(super) fn add(&mut self, columns: &[Vector3<f64>], matrix: &Matrix3<f64>) {
        let columns = &columns[..self.last.width()];
        Instructions::Best.run(Push::<false> { columns, matrix, to: &mut [], sum: &mut self.sum });
    }

    /// Number of segments appended so far.
    pub(super) fn count(&self) -> usize {
        self.count
    }

    /// Products of the matrix and the derivatives (see [`Turned`]) for one of the latest segments: first the x
    /// components of all parameters, then the y components, then the z components.
    #[inline(always)]
    pub(super) fn of(&self, state: usize) -> &[f64] {
        self.last.of(state % KEPT)
    }

    /// Sum of the products over all segments: first the x components of all parameters, then the y components, then the
    /// z components.
    pub(super) fn sum(&self) -> &[f64] {
        &self.sum
    }

    /// Writes the sum with negative sign to `to`, at the index of each parameter.
    pub(super) fn write_negative_sum(&self, to: &mut [Vector3<f64>]) {
        self.last.write_negative(&self.sum, to);
    }

    /// Empty storage for the derivatives with respect to the same parameters in `states` blocks or segments.
    pub(super) fn room(&self, states: usize) -> Planes {
        Planes::new(self.last.parameters().to_vec(), states)
    }
}

/// Adds the products of a segment to the sum. If `KEEPS` is true, it also stores the products.
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
