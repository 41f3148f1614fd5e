//! What every parameter changes inside a move, block by block.
//!
//! ```text
//! d(R f) = turn x R f + R d_f,   along d:   turn . (R f x d) + R d_f . d
//! ```
//!
//! Numbers stand lane by lane, so that as many parameters as a register has lanes take part in each multiplication: first those of the
//! rate, then those of the force.

use nalgebra::Vector3;
use pulp::{Arch, Simd, WithSimd};

use super::planes::Planes;

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
