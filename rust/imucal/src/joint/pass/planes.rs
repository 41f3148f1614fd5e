//! Columns of many parameters in many states, in the layout of SIMD registers.
//!
//! A state has three planes, x, y and z, with one number per parameter, so that each multiplication processes a full
//! register of parameters.

use nalgebra::Vector3;
use pulp::{Arch, Simd, WithSimd};

use crate::joint::pass::Range;
use crate::numerics::aligned::{Aligned, WIDEST};

/// Columns of some parameters in a sequence of states.
pub(crate) struct Planes {
    /// Indices of these parameters among all columns.
    parameters: Vec<usize>,
    /// Length of a plane, a multiple of the register width.
    width: usize,
    numbers: Aligned,
}

impl Planes {
    /// Without any state, and with capacity for `states`; `parameters` are indices among all columns.
    pub(crate) fn new(parameters: Vec<usize>, states: usize) -> Self {
        let width = parameters.len().next_multiple_of(WIDEST);
        Self { parameters, width, numbers: Aligned::with_capacity(states * 3 * width) }
    }

    /// With `states` states of zeros.
    pub(super) fn zeros(parameters: Vec<usize>, states: usize) -> Self {
        let mut planes = Self::new(parameters, 0);
        planes.numbers.resize(states * 3 * planes.width);
        planes
    }

    /// Indices of the parameters among all columns.
    pub(crate) fn parameters(&self) -> &[usize] {
        &self.parameters
    }

    /// Length of a plane.
    pub(crate) fn width(&self) -> usize {
        self.width
    }

    /// Appends a state of zeros and returns its planes.
    #[inline(always)]
    pub(crate) fn next(&mut self) -> &mut [f64] {
        let start = self.numbers.len();
        self.numbers.resize(start + 3 * self.width);
        &mut self.numbers[start..]
    }

    /// The planes of the last state.
    #[inline(always)]
    pub(super) fn last_mut(&mut self) -> &mut [f64] {
        let start = self.numbers.len() - 3 * self.width;
        &mut self.numbers[start..]
    }

    /// Appends a state with the column of a single parameter.
    pub(crate) fn push_one(&mut self, column: &Vector3<f64>) {
        let width = self.width;
        let state = self.next();
        (0..3).for_each(|axis| state[axis * width] = column[axis]);
    }

    /// Planes of zeros.
    pub(crate) fn zero(&self) -> Vec<f64> {
        vec![0.0; 3 * self.width]
    }

    /// Writes the negated columns in `planes`, which have this layout, to the columns of their parameters.
    pub(crate) fn write_negative(&self, planes: &[f64], to: &mut [Vector3<f64>]) {
        self.parameters.iter().enumerate().for_each(|(k, p)| to[*p] = -self.column(planes, k));
    }

    /// The column of the k-th parameter in `planes`.
    pub(crate) fn column(&self, planes: &[f64], k: usize) -> Vector3<f64> {
        Vector3::from_fn(|axis, _| planes[axis * self.width + k])
    }

    /// The planes of all states, consecutively.
    #[inline(always)]
    pub(crate) fn registers<S: Simd>(&self, _: S) -> &[S::f64s] {
        S::as_simd_f64s(&self.numbers).0
    }

    /// The planes of a state, consecutively.
    #[inline(always)]
    pub(crate) fn of(&self, state: usize) -> &[f64] {
        &self.numbers[state * 3 * self.width..][..3 * self.width]
    }

    /// The mutable planes of a state, consecutively.
    pub(super) fn of_mut(&mut self, state: usize) -> &mut [f64] {
        &mut self.numbers[state * 3 * self.width..][..3 * self.width]
    }
}

/// A partition of samples into groups of equal size.
#[derive(Clone, Copy)]
pub(super) struct Groups {
    /// Samples per group.
    size: usize,
    /// Number of samples by which the first group is shorter.
    lacking: usize,
    /// Number of all samples.
    samples: usize,
}

impl Groups {
    /// Groups of `size` samples, one of which begins at sample `begin`.
    pub(super) fn new(size: usize, begin: usize, samples: usize) -> Self {
        Self { size, lacking: (size - begin % size) % size, samples }
    }

    /// The group of sample `k`.
    #[inline(always)]
    pub(super) fn of(self, k: usize) -> usize {
        (k + self.lacking) / self.size
    }

    pub(super) fn count(self) -> usize {
        self.of(self.samples - 1) + 1
    }

    /// The samples of a group.
    pub(super) fn samples(self, group: usize) -> Range<usize> {
        let end = (group + 1) * self.size - self.lacking;
        (group * self.size).saturating_sub(self.lacking)..end.min(self.samples)
    }
}

/// Changes in each block within a move, with the sign of a correction that is subtracted from rate and force.
pub(crate) struct Changes {
    /// Mean integral of the columns of the rate.
    pub(crate) turn: Planes,
    /// Mean of the columns of the force, rotated to the start of the move.
    pub(crate) force: Planes,
}

impl Changes {
    /// Without any block.
    pub(crate) fn none() -> Self {
        let [turn, force] = [(); 2].map(|()| Planes::new(Vec::new(), 0));
        Self { turn, force }
    }

    /// Numbers in a row: one for each parameter, and padding.
    pub(crate) fn lanes(&self) -> usize {
        self.turn.width() + self.force.width()
    }

    /// Lanes with a parameter, and that parameter.
    pub(crate) fn parameters(&self) -> impl Iterator<Item = (usize, usize)> {
        let first = self.turn.width();
        let of_turn = self.turn.parameters().iter().copied().enumerate();
        of_turn.chain(self.force.parameters().iter().enumerate().map(move |(k, p)| (first + k, *p)))
    }

    /// d_turn_d_p in a block for each of `total` parameters.
    pub(crate) fn turns(&self, block: usize, total: usize) -> Vec<Vector3<f64>> {
        let mut turns = vec![Vector3::zeros(); total];
        self.turn.write_negative(self.turn.of(block), &mut turns);
        turns
    }

    /// Adds the change of the mean force of a block along `d` for each lane.
    pub(crate) fn add_along(&self, block: usize, force: &Vector3<f64>, d: &Vector3<f64>, lanes: &mut [f64]) {
        Arch::new().dispatch(AddAlong { changes: self, block, force, d, lanes });
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

    #[inline(always)] // With the widest registers.
    fn with_simd<S: Simd>(self, _: S) {
        let Self { changes: Changes { turn, force: adding }, block, force, d, lanes } = self;
        let (by_turn, by_force) = lanes.split_at_mut(turn.width());
        add_along(&d.cross(force), turn.of(block), by_turn);
        add_along(&-d, adding.of(block), by_force);
    }
}

/// Adds the components of the columns in `planes` along a direction to one number per column.
#[inline(always)] // With the widest registers that the caller has.
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
