//! Residuals inside a move: the force, turned to the body frame at its start, is gravity there (model.md (20)).
//!
//! ```text
//! z_j = d . (mean_j(R f) - g u),   z_j = x_j + white,   x_(j+1) = x_j + random walk
//! ```
//!
//! for d along gravity (no random walk: a turn about gravity and along it is not seen) and two directions across it. The
//! error of the gyroscope's white noise walks; its innovations, as of a scalar Kalman filter, are white. The last
//! residual of a move is the rest after it.

mod blocks;
pub(super) mod filter;

use faer::Mat;
use nalgebra::Vector3;
use pulp::Arch;

use super::lanes::Lanes;
use super::move_ends::AtMove;
use super::pass::planes::Planes;
use crate::joint::inside::filter::{Gain, WalkFilter};
use crate::joint::pass::Pass;
use crate::rests::moves::across;
use blocks::{IntoColumns, IntoLanes, Seen};

/// What a parameter changes of the residuals of a move along the three directions: of all by what it changes at the start, and of the
/// last ones, across gravity, by the rest after the move.
pub(super) struct Edges {
    pub(super) start: [f64; 3],
    pub(super) end: [f64; 2],
}

/// Rows for the residuals inside the moves, which go on from move to move.
pub(super) struct Rows<'a> {
    target: Target<'a>,
    next: usize,
    /// How much of the rows of the next move is there already.
    place: usize,
}

/// What they are rows of.
enum Target<'a> {
    Columns(&'a mut Mat<f64>),
    Lanes(&'a mut Lanes),
}

impl<'a> Rows<'a> {
    /// Of a matrix, from one on.
    pub(super) fn new(matrix: &'a mut Mat<f64>, first: usize) -> Self {
        Self { target: Target::Columns(matrix), next: first, place: 0 }
    }

    /// Of numbers side by side.
    pub(super) fn side_by_side(lanes: &'a mut Lanes) -> Self {
        Self { target: Target::Lanes(lanes), next: 0, place: 0 }
    }

    /// Writes what some parameters change of the white residuals of a move. A state of the planes is a block, of which the part along a
    /// direction d is seen along `toward(block, d)`.
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
        let seen = Seen { inside, planes, toward: &toward, at_edges: &at_edges };
        match &mut self.target {
            Target::Columns(matrix) => Arch::new().dispatch(IntoColumns { seen, matrix, first: self.next }),
            Target::Lanes(lanes) => Arch::new().dispatch(IntoLanes { seen, lanes, place: self.place }),
        }
        self.place += width;
    }

    /// Goes on behind the rows of a move.
    pub(super) fn leave(&mut self, inside: &Inside<'_>) {
        self.next += count(inside.pass, false);
        self.place = 0;
    }

    /// The row after them.
    pub(super) fn next(&self) -> usize {
        self.next
    }

    /// Writes all that is seen inside a move, its derivatives by the parameters and the residuals, which come last.
    pub(super) fn write_move(&mut self, at_move: &AtMove, noise: &InsideNoise, gravity_mps2: f64) {
        let AtMove { pass, before, after } = at_move;
        let inside = Inside::new(pass, &before.up, noise, gravity_mps2);
        let carried = pass.rotation * after.up;
        let at_start = inside.directions.map(|d| d * gravity_mps2);
        let (by_turn, by_end) = (at_start.map(|d| carried.cross(&d)), at_start.map(|d| pass.rotation.tr_mul(&d)));
        let edges = |p: usize| Edges {
            start: at_start.map(|d| -d.dot(&before.jacobian[p])),
            end: [1, 2].map(|c| pass.turn[p].dot(&by_turn[c]) + after.jacobian[p].dot(&by_end[c])),
        };
        self.write_block(&inside, &pass.changes.turn, |k, d| d.cross(&pass.blocks[k].force), edges);
        self.write_block(&inside, &pass.changes.force, |_, d| -d, edges);
        let mut residual = Planes::new(vec![pass.turn.len()], pass.blocks.len());
        pass.blocks.iter().for_each(|block| residual.push_one(&block.force));
        let edges =
            |_| Edges { start: at_start.map(|d| -d.dot(&before.up)), end: [1, 2].map(|c| carried.dot(&at_start[c])) };
        self.write_block(&inside, &residual, |_, d| *d, edges);
        self.leave(&inside);
    }
}

/// Variances of one move.
#[derive(Clone, Copy, Debug)]
pub(crate) struct InsideNoise {
    /// Of the direction of gravity at the start, rad^2.
    pub(crate) start: f64,
    /// Of the direction at the end, rad^2.
    pub(crate) end: f64,
    /// Growth of the attitude error, rad^2/s.
    pub(crate) walk: f64,
    /// Of the force of a block times its length, (m/s^2)^2 s.
    pub(crate) force: f64,
}

/// How many residuals a pass gives; with encoders the rest after it stands among theirs.
pub(crate) fn count(pass: &Pass, with_encoders: bool) -> usize {
    3 * pass.blocks.len() + if with_encoders { 0 } else { 2 }
}

/// What whitens the residuals inside a move.
pub(in crate::joint) struct Inside<'a> {
    pub(in crate::joint) pass: &'a Pass,
    /// Along gravity at the start of the move, and two directions across it.
    pub(in crate::joint) directions: [Vector3<f64>; 3],
    /// Of each block, along gravity and across it, and of the rest after the move.
    pub(super) along: Vec<Gain<1>>,
    pub(super) across: Vec<Gain<1>>,
    pub(super) end: Gain<1>,
}

impl<'a> Inside<'a> {
    /// Of a move with gravity along `up` at its start.
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
