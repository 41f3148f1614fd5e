//! Stores derivatives with respect to many parameters in an order that SIMD instructions can process.
//!
//! A Jacobian column contains the derivative with respect to one parameter: a 3-vector for each state. A state is a
//! block or a segment of a move. The x components of all parameters in a state are stored together and form a plane.
//! The planes of the y and z components follow. One SIMD instruction processes as many parameters as a register has
//! lanes.

use nalgebra::Vector3;
use pulp::{Simd, WithSimd};

use crate::joint::pass::Range;
use crate::numerics::aligned::{Aligned, WIDEST};
use crate::numerics::instructions::Instructions;

/// Jacobian columns (3-vectors) of several parameters in a sequence of states (blocks or segments of a move).
pub(crate) struct Planes {
    /// Indices, in the parameter vector, of the parameters whose columns are stored.
    parameters: Vec<usize>,
    /// Number of values per plane (one vector component of all parameters in a state), padded to full registers.
    width: usize,
    numbers: Aligned,
}

impl Planes {
    /// Storage without states (blocks or segments of a move), with capacity for `states` states.
    pub(crate) fn new(parameters: Vec<usize>, states: usize) -> Self {
        let width = parameters.len().next_multiple_of(WIDEST);
        Self { parameters, width, numbers: Aligned::with_capacity(states * 3 * width) }
    }

    /// Storage with `states` states, in which all values are zero.
    pub(super) fn zeros(parameters: Vec<usize>, states: usize) -> Self {
        let mut planes = Self::new(parameters, 0);
        planes.numbers.resize(states * 3 * planes.width);
        planes
    }

    /// Indices, in the parameter vector, of the parameters whose columns are stored.
    pub(crate) fn parameters(&self) -> &[usize] {
        &self.parameters
    }

    /// Number of values per plane, including padding.
    pub(crate) fn width(&self) -> usize {
        self.width
    }

    /// Appends a state (block or segment) with zeros, and returns its planes so that they can be filled.
    #[inline(always)]
    pub(crate) fn next(&mut self) -> &mut [f64] {
        let start = self.numbers.len();
        self.numbers.resize(start + 3 * self.width);
        &mut self.numbers[start..]
    }

    /// Mutable access to the planes of the state that was appended last.
    #[inline(always)]
    pub(super) fn last_mut(&mut self) -> &mut [f64] {
        let start = self.numbers.len() - 3 * self.width;
        &mut self.numbers[start..]
    }

    /// Appends a state (block or segment) with the column of a single parameter.
    pub(crate) fn push_one(&mut self, column: &Vector3<f64>) {
        let width = self.width;
        let state = self.next();
        (0..3).for_each(|axis| state[axis * width] = column[axis]);
    }

    /// Planes of zeros for one state.
    pub(crate) fn zero(&self) -> Vec<f64> {
        vec![0.0; 3 * self.width]
    }

    /// Writes the columns in `planes` (one 3-vector per parameter), with negative sign, to `to` at the index of each
    /// parameter.
    pub(crate) fn write_negative(&self, planes: &[f64], to: &mut [Vector3<f64>]) {
        self.parameters.iter().enumerate().for_each(|(k, p)| to[*p] = -self.column(planes, k));
    }

    /// Jacobian column (3-vector) of the `k`-th stored parameter, read from `planes`.
    pub(crate) fn column(&self, planes: &[f64], k: usize) -> Vector3<f64> {
        Vector3::from_fn(|axis, _| planes[axis * self.width + k])
    }

    /// All stored values as SIMD registers: the planes x, y and z of the first state, then those of the next state, and
    /// so on.
    #[inline(always)]
    pub(crate) fn registers<S: Simd>(&self, _: S) -> &[S::f64s] {
        S::as_simd_f64s(&self.numbers).0
    }

    /// Planes x, y and z of one state.
    #[inline(always)]
    pub(crate) fn of(&self, state: usize) -> &[f64] {
        &self.numbers[state * 3 * self.width..][..3 * self.width]
    }

    /// Mutable access to the planes (x, y and z components of all parameters) of one state.
    pub(super) fn of_mut(&mut self, state: usize) -> &mut [f64] {
        &mut self.numbers[state * 3 * self.width..][..3 * self.width]
    }
}

/// Division of the samples of a move into groups (segments) of equal size. The first and the last group may contain
/// fewer samples.
#[derive(Clone, Copy)]
pub(super) struct Groups {
    /// Number of samples in a complete group.
    size: usize,
    /// Number of samples that the first group lacks compared with a complete group.
    lacking: usize,
    /// Total number of samples.
    samples: usize,
}

impl Groups {
    /// Divides `samples` samples into groups of `size` samples. One of the groups starts at sample `begin`.
    pub(super) fn new(size: usize, begin: usize, samples: usize) -> Self {
        Self { size, lacking: (size - begin % size) % size, samples }
    }

    /// Index of the group that contains sample `k`.
    #[inline(always)]
    pub(super) fn of(self, k: usize) -> usize {
        (k + self.lacking) / self.size
    }

    pub(super) fn count(self) -> usize {
        self.of(self.samples - 1) + 1
    }

    /// Range of the samples of a group.
    pub(super) fn samples(self, group: usize) -> Range<usize> {
        let end = (group + 1) * self.size - self.lacking;
        (group * self.size).saturating_sub(self.lacking)..end.min(self.samples)
    }
}

/// Derivatives of attitude and force inside a move, with one state per block. The derivatives are stored with negative
/// sign: an increase of a parameter increases the measured rate or force, so the corrected rate or force decreases.
pub(crate) struct Changes {
    /// Mean attitude error over each block due to each parameter, rad per unit of the parameter.
    pub(crate) turn: Planes,
    /// Mean change of the force over each block, per unit of each parameter, in the body frame at the start of the
    /// move.
    pub(crate) force: Planes,
}

impl Changes {
    /// Empty storage for a move without blocks.
    pub(crate) fn none() -> Self {
        let [turn, force] = [(); 2].map(|()| Planes::new(Vec::new(), 0));
        Self { turn, force }
    }

    /// Number of values in a row of derivatives inside the move: one for each parameter that affects the attitude, then
    /// one for each parameter that affects the force, with padding after each part.
    pub(crate) fn lanes(&self) -> usize {
        self.turn.width() + self.force.width()
    }

    /// For each parameter: its position in a row of derivatives (its lane), and its index in the parameter vector.
    pub(crate) fn parameters(&self) -> impl Iterator<Item = (usize, usize)> {
        let first = self.turn.width();
        let of_turn = self.turn.parameters().iter().copied().enumerate();
        of_turn.chain(self.force.parameters().iter().enumerate().map(move |(k, p)| (first + k, *p)))
    }

    /// Derivative of the mean attitude in a block with respect to each of `total` parameters.
    pub(crate) fn turns(&self, block: usize, total: usize) -> Vec<Vector3<f64>> {
        let mut turns = vec![Vector3::zeros(); total];
        self.turn.write_negative(self.turn.of(block), &mut turns);
        turns
    }

    /// For each parameter, adds the derivative of `d . F` to `lanes`. F is the mean force of a block, with the value
    /// `force`, and d is a constant vector.
    pub(crate) fn add_along(&self, block: usize, force: &Vector3<f64>, d: &Vector3<f64>, lanes: &mut [f64]) {
        Instructions::Best.run(AddAlong { changes: self, block, force, d, lanes });
    }
}

struct AddAlong<'a> {
    changes: &'a Changes,
    block: usize,
    force: &'a Vector3<f64>,
    d: &'a Vector3<f64>,
    lanes: &'a mut [f64],
}

impl WithSimd for AddAlong<'_> {
    type Output = ();

    #[inline(always)] // Compiled for the widest SIMD registers of the processor.
    fn with_simd<S: Simd>(self, _: S) {
        let Self { changes: Changes { turn, force: adding }, block, force, d, lanes } = self;
        let (by_turn, by_force) = lanes.split_at_mut(turn.width());
        add_along(&d.cross(force), turn.of(block), by_turn);
        add_along(&-d, adding.of(block), by_force);
    }
}

/// For each parameter, adds the dot product of `direction` and the column (3-vector) of the parameter in `planes` to
/// `to`.
#[inline(always)] // Compiled for the SIMD registers of the caller.
fn add_along(direction: &Vector3<f64>, planes: &[f64], to: &mut [f64]) {
    let (x, yz) = planes.split_at(to.len());
    let (y, z) = yz.split_at(to.len());
    for (((to, x), y), z) in to.iter_mut().zip(x).zip(y).zip(z) {
        *to += direction.x * x + direction.y * y + direction.z * z;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_sample_is_in_its_group_and_one_begins_where_it_is_wanted() {
        for (size, begin, samples) in [(1, 0, 5), (2, 2, 23), (4, 1, 40), (3, 2, 30)] {
            let groups = Groups::new(size, begin, samples);
            let all: Vec<usize> = (0..groups.count()).flat_map(|group| groups.samples(group)).collect();
            assert_eq!(all, (0..samples).collect::<Vec<usize>>());
            assert!((0..samples).all(|k| groups.samples(groups.of(k)).contains(&k)));
            assert_eq!(groups.samples(groups.of(begin)).start, begin);
        }
    }
}
