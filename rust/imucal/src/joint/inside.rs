//! Computes the residuals inside a move: the specific force, rotated to the body frame at the start of the move, minus
//! gravity in this frame (model.md (20)).
//!
//! ```text
//! z_j = d . (mean_j(R f) - g u),   z_j = x_j + white,   x_(j+1) = x_j + random walk
//! ```
//!
//! f is the specific force, and R is the rotation from the body frame at a sample to the body frame at the start of the
//! move. mean_j is the mean over block j of 40 ms, and z_j is the residual of this block along the unit vector d. g is
//! local gravity, and u is the unit vector up at the start of the move. x_j is the part of z_j that is due to the error
//! of the attitude relative to gravity. x_j is a random walk and is the state of the Kalman filter. `white` is the
//! noise of the mean force.
//!
//! The direction d is along gravity or along one of two directions perpendicular to it. The component along gravity
//! contains no random walk, because an attitude error does not change it to first order. The perpendicular components
//! contain the integrated white noise of the gyroscope, which is a random walk. For each direction, a scalar Kalman
//! filter whitens the z_j, and its normalised innovations are the residuals. The last residuals of a move compare the
//! propagated gravity direction with the gravity direction at the rest after the move.

mod blocks;
pub(super) mod filter;

use faer::Mat;
use nalgebra::Vector3;

use super::lanes::Lanes;
use super::move_ends::AtMove;
use super::pass::planes::Planes;
use crate::joint::inside::filter::{Gain, WalkFilter};
use crate::joint::pass::Pass;
use crate::numerics::instructions::Instructions;
use crate::rests::moves::across;
use blocks::{Derivatives, IntoColumns, IntoLanes};

/// Derivatives of a move's residuals with respect to one parameter, m/s^2 per unit of the parameter: the parts that are
/// due to the gravity directions at the two ends of the move. `start` is the part due to the direction at the start
/// (three orthogonal components). It is added to the derivatives of every residual. `end` is the part due to the
/// direction at the end, in the body frame at the start (the two components perpendicular to gravity). It is added to
/// the derivatives of the last two residuals of the move, which compare the directions at both ends.
pub(super) struct Edges {
    pub(super) start: [f64; 3],
    pub(super) end: [f64; 2],
}

/// Writes the whitened residuals inside the moves and their derivatives to a matrix, one move after another.
pub(super) struct Rows<'a> {
    target: Target<'a>,
    next: usize,
    /// Number of values already written in each row of the current move. It is used only if the target is [`Lanes`].
    place: usize,
}

/// The matrix to which the whitened residuals and their derivatives are written.
enum Target<'a> {
    Columns(&'a mut Mat<f64>),
    Lanes(&'a mut Lanes),
}

impl<'a> Rows<'a> {
    /// Writes to a matrix with one column per parameter. The first row written is row `first`.
    pub(super) fn new(matrix: &'a mut Mat<f64>, first: usize) -> Self {
        Self { target: Target::Columns(matrix), next: first, place: 0 }
    }

    /// Writes the rows of one move to `lanes`, a matrix that is stored row by row.
    pub(super) fn side_by_side(lanes: &'a mut Lanes) -> Self {
        Self { target: Target::Lanes(lanes), next: 0, place: 0 }
    }

    /// Writes the whitened derivatives of a move's residuals with respect to the parameters of `planes`. For each block
    /// (short interval with a mean force) and each parameter, `planes` contains a 3-vector. The residual of a block has
    /// one component along each of the three directions d of the move. The derivative of such a component with respect
    /// to the parameter is the dot product of the 3-vector and `toward(block, d)`, plus the contributions of the ends
    /// of the move ([`Edges`]).
    pub(super) fn write_block(
        &mut self,
        inside: &Inside<'_>,
        planes: &Planes,
        toward: impl Fn(usize, &Vector3<f64>) -> Vector3<f64>,
        edges: impl Fn(usize) -> Edges,
    ) {
        let width = planes.width();
        let toward: Vec<[Vector3<f64>; 3]> =
            (0..inside.pass.blocks.len()).map(|k| inside.directions.each_ref().map(|d| toward(k, d))).collect();
        let mut at_edges = vec![0.0; 5 * width];
        for (lane, p) in planes.parameters().iter().enumerate() {
            let Edges { start, end } = edges(*p);
            let values = [start[0], start[1], start[2], start[1] + end[0], start[2] + end[1]];
            values.into_iter().enumerate().for_each(|(row, value)| at_edges[row * width + lane] = value);
        }
        let seen = Derivatives { inside, planes, toward: &toward, at_edges: &at_edges };
        match &mut self.target {
            Target::Columns(matrix) => Instructions::Best.run(IntoColumns { seen, matrix, first: self.next }),
            Target::Lanes(lanes) => Instructions::Best.run(IntoLanes { seen, lanes, place: self.place }),
        }
        self.place += width;
    }

    /// Moves the write position to the rows of the next move.
    pub(super) fn leave(&mut self, inside: &Inside<'_>) {
        self.next += count(inside.pass, false);
        self.place = 0;
    }

    /// Index of the first row that has not been written.
    pub(super) fn next(&self) -> usize {
        self.next
    }

    /// Writes all whitened residuals of a move, one row per residual. The first columns are the derivatives with
    /// respect to all parameters, and the last column is the residual.
    pub(super) fn write_move(&mut self, at_move: &AtMove, noise: &InsideNoise, gravity_mps2: f64) {
        let AtMove { pass, before, after } = at_move;
        let inside = Inside::new(pass, &before.up, noise, gravity_mps2);
        let propagated = pass.rotation * after.up;
        let at_start = inside.directions.map(|d| d * gravity_mps2);
        let (by_turn, by_end) = (at_start.map(|d| propagated.cross(&d)), at_start.map(|d| pass.rotation.tr_mul(&d)));
        let edges = |p: usize| Edges {
            start: at_start.map(|d| -d.dot(&before.jacobian[p])),
            end: [1, 2].map(|c| pass.turn[p].dot(&by_turn[c]) + after.jacobian[p].dot(&by_end[c])),
        };
        self.write_block(&inside, &pass.changes.turn, |k, d| d.cross(&pass.blocks[k].force), edges);
        self.write_block(&inside, &pass.changes.force, |_, d| -d, edges);
        let mut residual = Planes::new(vec![pass.turn.len()], pass.blocks.len());
        pass.blocks.iter().for_each(|block| residual.push_one(&block.force));
        let edges = |_| Edges {
            start: at_start.map(|d| -d.dot(&before.up)),
            end: [1, 2].map(|c| propagated.dot(&at_start[c])),
        };
        self.write_block(&inside, &residual, |_, d| *d, edges);
        self.leave(&inside);
    }
}

/// Noise variances of the residuals inside one move.
#[derive(Clone, Copy, Debug)]
pub(crate) struct InsideNoise {
    /// Variance of each component of the gravity direction at the start of the move, rad^2.
    pub(crate) start: f64,
    /// Variance of each component of the gravity direction at the end of the move, rad^2.
    pub(crate) end: f64,
    /// Increase of the variance of the attitude error per second (angle random walk), rad^2/s.
    pub(crate) walk: f64,
    /// Power spectral density of the force noise, (m/s^2)^2 s: the variance of the mean force of a block times the
    /// duration of the block.
    pub(crate) force: f64,
}

/// Number of residuals inside a move. With encoders, the two residuals of the rest after the move are omitted, because
/// the residuals of this rest relative to the stand contain the same gravity direction.
pub(crate) fn count(pass: &Pass, with_encoders: bool) -> usize {
    3 * pass.blocks.len() + if with_encoders { 0 } else { 2 }
}

/// Filter gains that whiten the residuals inside one move.
pub(in crate::joint) struct Inside<'a> {
    pub(in crate::joint) pass: &'a Pass,
    /// Unit vector along gravity at the start of the move, and two unit vectors perpendicular to it.
    pub(in crate::joint) directions: [Vector3<f64>; 3],
    /// Filter gains. `along` has one gain per block for the residual along gravity, and `across` has one gain per block
    /// for the two residuals perpendicular to gravity. `end` is the gain for the gravity direction at the rest after
    /// the move.
    pub(super) along: Vec<Gain<1>>,
    pub(super) across: Vec<Gain<1>>,
    pub(super) end: Gain<1>,
}

impl<'a> Inside<'a> {
    /// Computes the filter gains of a move; `up` is the gravity direction at its start.
    pub(in crate::joint) fn new(pass: &'a Pass, up: &Vector3<f64>, noise: &InsideNoise, gravity_mps2: f64) -> Self {
        let g2 = gravity_mps2 * gravity_mps2;
        let mut walk = WalkFilter::new([g2 * noise.start]);
        let mut last_s = 0.0;
        let (mut along, mut across_it) = (Vec::new(), Vec::new());
        for block in &pass.blocks {
            let white = noise.force / block.duration_s;
            along.push(WalkFilter::new([0.0]).update([1.0], white));
            walk.predict(g2 * noise.walk * (block.time_s - last_s));
            last_s = block.time_s;
            across_it.push(walk.update([1.0], white));
        }
        let end = walk.update([1.0], g2 * noise.end);
        let [first, second] = across(up);
        Self { pass, directions: [*up, first, second], along, across: across_it, end }
    }
}
