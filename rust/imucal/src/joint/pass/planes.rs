//! Columns of many parameters in many states.
//!
//! A state has three planes, x, y and z, of one number for each parameter, so that as many parameters as a register has lanes take
//! part in each multiplication.

use nalgebra::Vector3;
use pulp::{Arch, Simd, WithSimd};

use crate::joint::pass::Range;
use crate::numerics::aligned::{Aligned, WIDEST};

/// Columns of some parameters.
pub(crate) struct Planes {
    /// Their places among all columns.
    parameters: Vec<usize>,
    /// Length of a plane: full registers.
    width: usize,
    numbers: Aligned,
}

impl Planes {
    /// No state yet, and room for so many; the parameters have these places among all columns.
    pub(crate) fn new(parameters: Vec<usize>, states: usize) -> Self {
        let width = parameters.len().next_multiple_of(WIDEST);
        Self { parameters, width, numbers: Aligned::with_capacity(states * 3 * width) }
    }

    /// So many states of zeros.
    pub(super) fn zeros(parameters: Vec<usize>, states: usize) -> Self {
        let mut planes = Self::new(parameters, 0);
        planes.numbers.resize(states * 3 * planes.width);
        planes
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
        self.numbers.resize(start + 3 * self.width);
        &mut self.numbers[start..]
    }

    /// The planes of the last state.
    #[inline(always)]
    pub(super) fn last_mut(&mut self) -> &mut [f64] {
        let start = self.numbers.len() - 3 * self.width;
        &mut self.numbers[start..]
    }

    /// Takes the column of a single parameter in the next state.
    pub(crate) fn push_one(&mut self, column: &Vector3<f64>) {
        let width = self.width;
        let state = self.next();
        (0..3).for_each(|axis| state[axis * width] = column[axis]);
    }

    /// Planes of zeros.
    pub(crate) fn zero(&self) -> Vec<f64> {
        vec![0.0; 3 * self.width]
    }

    /// Puts columns in planes as these are, with the other sign, where their parameters have their places.
    pub(crate) fn write_negative(&self, planes: &[f64], to: &mut [Vector3<f64>]) {
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

    /// The same, to be set.
    pub(super) fn of_mut(&mut self, state: usize) -> &mut [f64] {
        &mut self.numbers[state * 3 * self.width..][..3 * self.width]
    }
}

/// How samples fall into groups.
#[derive(Clone, Copy)]
pub(super) struct Groups {
    /// Samples of each.
    size: usize,
    /// So many of the first one are not there.
    lacking: usize,
    /// All samples.
    samples: usize,
}

impl Groups {
    /// Of so many samples, `size` in a group; one begins at sample `begin`.
    pub(super) fn new(size: usize, begin: usize, samples: usize) -> Self {
        Self { size, lacking: (size - begin % size) % size, samples }
    }

    /// That of sample `k`.
    #[inline(always)]
    pub(super) fn of(self, k: usize) -> usize {
        (k + self.lacking) / self.size
    }

    pub(super) fn count(self) -> usize {
        self.of(self.samples - 1) + 1
    }

    /// Its samples.
    pub(super) fn samples(self, group: usize) -> Range<usize> {
        let end = (group + 1) * self.size - self.lacking;
        (group * self.size).saturating_sub(self.lacking)..end.min(self.samples)
    }
}

/// States are blocks; signs are those of what is taken off rate and force.
pub(crate) struct Changes {
    /// Mean of what the columns of the rate have turned.
    pub(crate) turn: Planes,
    /// Mean of what the columns of the force add, turned to the start of the move.
    pub(crate) force: Planes,
}

impl Changes {
    /// Of no block.
    pub(crate) fn none() -> Self {
        let [turn, force] = [(); 2].map(|()| Planes::new(Vec::new(), 0));
        Self { turn, force }
    }

    /// Length of a row of numbers, one for each parameter.
    pub(crate) fn lanes(&self) -> usize {
        self.turn.width() + self.force.width()
    }

    /// Lane and parameter; not every lane has one.
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

    /// Adds what they change of the mean force of a block along `d`, lane by lane.
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

/// Adds what columns in planes are along a direction to as many numbers as a plane is long.
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
