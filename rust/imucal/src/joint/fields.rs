//! Computes the whitened derivatives of the residuals with respect to generic error fields (model.md (24)). A generic
//! error field is a variation of a bias or scale that no effect of the catalogue describes. It is a linear combination
//! of basis functions (its columns). Each basis function has one value at each rest and in each segment of a move.
//!
//! ```text
//! gyroscope       rest rates    -T Phi_k
//!                 moves         E R(end)^T (u x turn(end)),   turn(t) = -sum R Phi dt from the start of the move to t
//!                 inside moves  turn x R f
//! accelerometer   rest norms    -u^T Phi_k
//!                 inside moves  -R Phi
//! ```
//!
//! Phi is the error field, and Phi_k is its value at rest k. T is the sensitivity of the gyroscope, f is the specific
//! force, and u is the unit vector up at the rest or at the start of the move. R(t) is the rotation from the body frame
//! at time t to the body frame at the start of the move. The correction subtracts Phi from the rate, and this changes
//! R(t) to exp(turn(t)) R(t). The two rows of E span the plane perpendicular to the direction up at the end of the
//! move. A field of the accelerometer also changes the gravity directions at the rests, and through them the residuals
//! of the moves.

use std::ops::Range;

use faer::Mat;
use imucal_core::effects::Sensor;
use nalgebra::{Matrix2x3, Matrix3, Vector3};

use super::inside::{Edges, Inside, Rows};
use super::linear::{Linear, Source};
use super::move_ends::AtMove;
use super::pass::planes::Planes;
use super::pass::segments::{MoveSegments, Stretch};
use super::prepared::Prepared;
use super::problem::Joint;
use crate::cancellation::checkpoint;
use crate::rests::moves::{Move, rows_across};

/// Basis functions (columns) of a generic error field of one sensor. Each basis function acts on one body axis. The
/// basis functions of the x axis come first, followed by equally many of the y axis and of the z axis. Values are in
/// rad/s (gyroscope) or m/s^2 (accelerometer).
pub(crate) struct Field {
    pub(crate) sensor: Sensor,
    /// Number of basis functions.
    pub(crate) width: usize,
    /// Values of the basis functions at the rests: `width` values per rest.
    pub(crate) rests: Vec<f64>,
    /// Values of the basis functions inside the moves: for each move, `width` values per segment.
    pub(crate) moves: Vec<Vec<f64>>,
}

impl Field {
    fn at_rest(&self, rest: usize) -> &[f64] {
        &self.rests[rest * self.width..][..self.width]
    }

    fn in_move(&self, k: usize, stretch: usize) -> &[f64] {
        &self.moves[k][stretch * self.width..][..self.width]
    }

    /// Body axis (0 to 2) on which the basis function `column` acts.
    fn axis(&self, column: usize) -> usize {
        3 * column / self.width
    }

    /// Index range of the basis functions that act on the body axis `axis`.
    fn own(&self, axis: usize) -> Range<usize> {
        let count = self.width / 3;
        axis * count..(axis + 1) * count
    }

    /// Multiplies one vector for each basis function by `matrix`. The vector is along the body axis of the basis
    /// function, and its length is the value in `numbers`. Adds the products to `to`: first the x components of all
    /// products, then the y components, then the z components.
    fn add(&self, matrix: &Matrix3<f64>, numbers: &[f64], to: &mut [f64]) {
        let width = to.len() / 3;
        for (component, to) in to.chunks_exact_mut(width.max(1)).enumerate() {
            for axis in 0..3 {
                let (own, by) = (self.own(axis), matrix[(component, axis)]);
                to[own.clone()].iter_mut().zip(&numbers[own]).for_each(|(to, number)| *to += by * number);
            }
        }
    }
}

/// Divides each move into segments, and computes the attitude at the midpoint of each segment from rates that are not
/// corrected for effects. Only every `every`-th segment is kept.
pub(crate) fn move_segments(prepared: &Prepared<'_>, linear: &Linear, every: usize) -> Vec<MoveSegments> {
    let way = |(index, at_move): (usize, &AtMove)| {
        let route = prepared.route(index, None, &at_move.before, false);
        route.segments(&linear.model, &at_move.pass, every)
    };
    linear.moves.iter().enumerate().map(way).collect()
}

impl Field {
    /// Computes the attitude change due to each basis function (with the coefficient 1), rad, at the midpoint of each
    /// segment of move `k` and at the end of the move. Between two midpoints, the field is assumed to be the mean of
    /// its values in the two segments.
    fn turns(&self, k: usize, way: &MoveSegments) -> Planes {
        let count = way.stretches.len();
        let mut turns = Planes::new((0..self.width).collect(), count + 1);
        let (mut sums, mut before) = (turns.zero(), Matrix3::zeros());
        for (stretch, turn) in way.stretches.iter().map(|s| s.turn).chain([way.end]).enumerate() {
            if let Some(last) = count.checked_sub(1) {
                let half = (turn - before) / 2.0;
                self.add(&half, self.in_move(k, stretch.saturating_sub(1)), &mut sums);
                self.add(&half, self.in_move(k, stretch.min(last)), &mut sums);
            }
            turns.next().copy_from_slice(&sums);
            before = turn;
        }
        turns
    }
}

impl Joint<'_> {
    /// Computes the whitened derivatives of the residuals with respect to the coefficients of the basis functions of
    /// `field`. The derivatives of the residuals relative to the stand are not computed and are zero in the result.
    pub(crate) fn by_field(&self, linear: &Linear, ways: &[MoveSegments], field: &Field) -> Mat<f64> {
        let mut all = Mat::zeros(self.rows(), field.width);
        let mut lines = Mat::zeros(linear.lines.len(), field.width);
        if field.sensor == Sensor::Gyroscope {
            self.by_rate(linear, ways, field, &mut lines, &mut all);
        } else {
            self.by_force(linear, ways, field, &mut lines, &mut all);
        }
        self.weights.whitening.apply(&mut lines);
        all.as_mut().subrows_mut(0, lines.nrows()).copy_from(&lines);
        self.let_wander(&mut all);
        all
    }

    /// Computes the derivatives of the residuals with respect to an error field of the gyroscope. The derivatives of
    /// force norms and of gravity directions after moves are written to `lines` and are not yet whitened. The
    /// derivatives of all other residuals are whitened and written to `all`.
    fn by_rate(&self, linear: &Linear, ways: &[MoveSegments], field: &Field, lines: &mut Mat<f64>, all: &mut Mat<f64>) {
        let (width, gravity_mps2) = (field.width, self.prepared.gravity_mps2);
        let mut row = lines.nrows();
        for (rest, _) in &linear.rates {
            let white = self.weights.rates[*rest] * linear.model.gyroscope.sensitivity();
            for (c, number) in field.at_rest(*rest).iter().enumerate() {
                (0..3).for_each(|axis| all[(row + axis, c)] = -white[(axis, field.axis(c))] * number);
            }
            row += 3;
        }
        let mut turned = Vec::with_capacity(ways.len());
        let mut rows = Rows::new(all, row);
        for (k, (at_move, way)) in linear.moves.iter().zip(ways).enumerate() {
            checkpoint();
            let AtMove { pass, before, after } = at_move;
            let turns = field.turns(k, way);
            let end: Vec<Vector3<f64>> = (0..width).map(|c| turns.column(turns.of(way.stretches.len()), c)).collect();
            if linear.sees_inside() {
                // An attitude error t changes the rotated force f by t x f. The component of this change along a
                // direction d is (f x d) . t.
                let inside = Inside::new(pass, &before.up, &self.weights.inside[k], gravity_mps2);
                let propagated = pass.rotation * after.up * gravity_mps2;
                let by_end = [1, 2].map(|c| propagated.cross(&inside.directions[c]));
                let edges = |c: usize| Edges { start: [0.0; 3], end: by_end.map(|by_end| by_end.dot(&end[c])) };
                rows.write_block(&inside, &turns, |block, d| pass.blocks[block].force.cross(d), edges);
                rows.leave(&inside);
            }
            turned.push(end);
        }
        let mut component = 0;
        for (row, line) in linear.lines.iter().enumerate() {
            if let Source::Move(k) = line.source {
                let seen = across(&linear.moves[k]).row(component).transpose();
                turned[k].iter().enumerate().for_each(|(c, turned)| lines[(row, c)] = seen.dot(turned));
                component = 1 - component;
            }
        }
    }

    /// Computes the derivatives of the residuals with respect to an error field of the accelerometer. The derivatives
    /// of force norms and of gravity directions after moves are written to `lines` and are not yet whitened. The
    /// derivatives of all other residuals are whitened and written to `all`.
    fn by_force(
        &self,
        linear: &Linear,
        ways: &[MoveSegments],
        field: &Field,
        lines: &mut Mat<f64>,
        all: &mut Mat<f64>,
    ) {
        for (row, line) in linear.lines.iter().enumerate() {
            for (rest, by) in &line.by_means {
                let by_axis = linear.model.accelerometer.sensitivity().tr_mul(by);
                for (c, number) in field.at_rest(*rest).iter().enumerate() {
                    lines[(row, c)] -= by_axis[field.axis(c)] * number;
                }
            }
        }
        if !linear.sees_inside() {
            return;
        }
        let mut rows = Rows::new(all, linear.head_rows());
        for (k, (at_move, way)) in linear.moves.iter().zip(ways).enumerate() {
            checkpoint();
            let AtMove { pass, before, after } = at_move;
            let Move { from, to, .. } = self.prepared.moves[k];
            let (at_start, at_end) = (field.at_rest(from), field.at_rest(to));
            let inside = Inside::new(pass, &before.up, &self.weights.inside[k], self.prepared.gravity_mps2);
            // The field also acts at the rests before and after the move, so it also changes the gravity directions
            // measured there.
            let level = |up: &Vector3<f64>, d: &Vector3<f64>| d - up * up.dot(d);
            let by_start = inside.directions.map(|d| level(&before.up, &d));
            let by_end = [1, 2].map(|c| level(&after.up, &pass.rotation.tr_mul(&inside.directions[c])));
            let edges = |c: usize| Edges {
                start: by_start.map(|by| by[field.axis(c)] * at_start[c]),
                end: by_end.map(|by| -by[field.axis(c)] * at_end[c]),
            };
            let mut added = Planes::new((0..field.width).collect(), way.stretches.len());
            for (stretch, Stretch { attitude, .. }) in way.stretches.iter().enumerate() {
                field.add(attitude, field.in_move(k, stretch), added.next());
            }
            rows.write_block(&inside, &added, |_, d| -d, edges);
            rows.leave(&inside);
        }
    }
}

/// Derivative of a move's two direction residuals with respect to the attitude error at the end of the move. This error
/// is a rotation vector, given in the body frame at the start of the move.
fn across(at_move: &AtMove) -> Matrix2x3<f64> {
    let AtMove { pass, before, after } = at_move;
    let across = rows_across(&after.up);
    across * pass.rotation.transpose() * before.up.cross_matrix()
}
