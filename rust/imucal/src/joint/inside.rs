//! Residuals inside a move: the force, turned to the body frame at its start, is gravity there (model.md (20)).
//!
//! ```text
//! z_j = d . (mean_j(R f) - g u),   z_j = x_j + white,   x_(j+1) = x_j + random walk
//! ```
//!
//! for d along gravity (no random walk: a turn about gravity and along it is not seen) and two directions across it. The
//! error of the gyroscope's white noise walks; its innovations, as of a scalar Kalman filter, are white. The last
//! residual of a move is the rest after it.

pub(super) mod walk;

use faer::Mat;
use nalgebra::Vector3;
use pulp::{Arch, Simd, WithSimd};

use super::at_move::AtMove;
use super::pass::Pass;
use super::pass::planes::Planes;
use crate::moves::across;
use walk::{Gain, Walk};

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
pub(super) struct Inside<'a> {
    pub(super) pass: &'a Pass,
    /// Along gravity at the start of the move, and two directions across it.
    pub(super) directions: [Vector3<f64>; 3],
    /// Of each block, along gravity and across it, and of the rest after the move.
    along: Vec<Gain<1>>,
    across: Vec<Gain<1>>,
    end: Gain<1>,
}

/// What a parameter changes of the residuals of a move along the three directions: of all by what it changes at the start, and of the
/// last ones, across gravity, by the rest after the move.
pub(super) struct Edges {
    pub(super) start: [f64; 3],
    pub(super) end: [f64; 2],
}

impl<'a> Inside<'a> {
    /// Of a move with gravity along `up` at its start.
    pub(super) fn new(pass: &'a Pass, up: &Vector3<f64>, noise: &InsideNoise, gravity_mps2: f64) -> Self {
        let g2 = gravity_mps2 * gravity_mps2;
        let mut walk = Walk::new([g2 * noise.start]);
        let mut last_s = 0.0;
        let (mut along, mut across_it) = (Vec::new(), Vec::new());
        for block in &pass.blocks {
            let white = noise.force / block.duration_s;
            along.push(Walk::new([0.0]).look([1.0], white));
            walk.go_on(g2 * noise.walk * (block.time_s - last_s));
            last_s = block.time_s;
            across_it.push(walk.look([1.0], white));
        }
        let end = walk.look([1.0], g2 * noise.end);
        let [first, second] = across(up);
        Self { pass, directions: [*up, first, second], along, across: across_it, end }
    }
}

/// Rows of a matrix, from one on, for the residuals inside the moves.
pub(super) struct Rows<'a> {
    matrix: &'a mut Mat<f64>,
    next: usize,
}

impl<'a> Rows<'a> {
    pub(super) fn new(matrix: &'a mut Mat<f64>, first: usize) -> Self {
        Self { matrix, next: first }
    }

    /// Writes what some parameters change of the white residuals of a move. A state of the planes is a block, of which the part along a
    /// direction d is seen along `toward(block, d)`.
    pub(super) fn put(
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
        Arch::new().dispatch(Put { rows: self, inside, planes, toward: &toward, at_edges: &at_edges });
    }

    /// Goes on behind the rows of a move.
    pub(super) fn leave(&mut self, inside: &Inside<'_>) {
        self.next += count(inside.pass, false);
    }

    /// The row after them.
    pub(super) fn next(&self) -> usize {
        self.next
    }

    /// Writes all that is seen inside a move, its derivatives by the parameters and the residuals, which come last.
    pub(super) fn put_move(&mut self, at_move: &AtMove, noise: &InsideNoise, gravity_mps2: f64) {
        let AtMove { pass, before, after } = at_move;
        let inside = Inside::new(pass, &before.up, noise, gravity_mps2);
        let carried = pass.rotation * after.up;
        let at_start = inside.directions.map(|d| d * gravity_mps2);
        let (by_turn, by_end) = (at_start.map(|d| carried.cross(&d)), at_start.map(|d| pass.rotation.tr_mul(&d)));
        let edges = |p: usize| Edges {
            start: at_start.map(|d| -d.dot(&before.jacobian[p])),
            end: [1, 2].map(|c| pass.turn[p].dot(&by_turn[c]) + after.jacobian[p].dot(&by_end[c])),
        };
        self.put(&inside, &pass.changes.turn, |k, d| d.cross(&pass.blocks[k].force), edges);
        self.put(&inside, &pass.changes.force, |_, d| -d, edges);
        let mut residual = Planes::new(vec![self.matrix.ncols() - 1], pass.blocks.len());
        pass.blocks.iter().for_each(|block| residual.push_one(&block.force));
        let edges =
            |_| Edges { start: at_start.map(|d| -d.dot(&before.up)), end: [1, 2].map(|c| carried.dot(&at_start[c])) };
        self.put(&inside, &residual, |_, d| *d, edges);
        self.leave(&inside);
    }
}

struct Put<'a, 'b> {
    rows: &'a mut Rows<'b>,
    inside: &'a Inside<'a>,
    planes: &'a Planes,
    toward: &'a [[Vector3<f64>; 3]],
    /// Of each lane what stands at the start along the three directions, and at the end along two of them.
    at_edges: &'a [f64],
}

impl WithSimd for Put<'_, '_> {
    type Output = ();

    /// As many columns at once as a register has lanes, from the start of the move to its end. They are turned into columns of the matrix
    /// from what is still in the nearest cache.
    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { rows, inside, planes, toward, at_edges } = self;
        let (width, blocks, count) = (planes.width(), toward.len(), count(inside.pass, false));
        let mut tile = vec![0.0; count * S::F64_LANES];
        for (group, parameters) in planes.parameters().chunks(S::F64_LANES).enumerate() {
            let own = group * S::F64_LANES..(group + 1) * S::F64_LANES;
            let zero = simd.splat_f64s(0.0);
            let mut edges = [zero; 5];
            for (row, edge) in edges.iter_mut().enumerate() {
                *edge = S::as_simd_f64s(&at_edges[row * width..][own.clone()]).0[0];
            }
            let (lanes, _) = S::as_mut_simd_f64s(&mut tile);
            let mut states = [zero; 3];
            for (k, toward) in toward.iter().enumerate() {
                let state = planes.of(k);
                let mut seen = [edges[0], edges[1], edges[2]];
                for axis in 0..3 {
                    let plane = S::as_simd_f64s(&state[axis * width..][own.clone()]).0[0];
                    for c in 0..3 {
                        seen[c] = simd.mul_add_e_f64s(simd.splat_f64s(toward[c][axis]), plane, seen[c]);
                    }
                }
                for c in 0..3 {
                    let Gain { shares: [share], per_sigma } = if c == 0 { inside.along[k] } else { inside.across[k] };
                    let innovation = simd.sub_f64s(seen[c], states[c]);
                    states[c] = simd.mul_add_e_f64s(simd.splat_f64s(share), innovation, states[c]);
                    lanes[row_of(c, k, blocks)] = simd.mul_f64s(simd.splat_f64s(per_sigma), innovation);
                }
            }
            for c in 1..3 {
                let innovation = simd.sub_f64s(edges[2 + c], states[c]);
                lanes[row_of(c, blocks, blocks)] = simd.mul_f64s(simd.splat_f64s(inside.end.per_sigma), innovation);
            }
            for (lane, parameter) in parameters.iter().enumerate() {
                let to = &mut rows.matrix.col_as_slice_mut(*parameter)[rows.next..][..count];
                to.iter_mut().zip(tile.chunks_exact(S::F64_LANES)).for_each(|(to, row)| *to = row[lane]);
            }
        }
    }
}

/// The row of a block along a direction, among those of a move: along gravity there is no rest after the last one.
fn row_of(direction: usize, block: usize, blocks: usize) -> usize {
    direction * blocks + direction.saturating_sub(1) + block
}
