//! What whitens the residuals inside a move: the gains of a filter, and the directions that it looks along.

use nalgebra::Vector3;

use super::filter::{Gain, WalkFilter};
use crate::joint::pass::Pass;
use crate::rests::moves::across;

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
