//! Residuals inside a move: the force, turned to the body frame at its start, is gravity there (model.md (20)).
//!
//! ```text
//! z_j = d . (mean_j(R f) - g u),   z_j = x_j + white,   x_(j+1) = x_j + random walk
//! ```
//!
//! for d along gravity (no random walk: a turn about gravity and along it is not seen) and two directions across it. The
//! error of the gyroscope's white noise walks; its innovations, as of a scalar Kalman filter, are white. The last
//! residual of a move is the rest after it.

use faer::Mat;
use nalgebra::Vector3;
use pulp::{Arch, Simd, WithSimd};

use super::linear::AtMove;
use super::pass::Pass;
use crate::moves::across;

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

/// Direction of gravity at one end of a move and its derivative by every parameter.
#[derive(Clone)]
pub(crate) struct EndDirection {
    pub(crate) up: Vector3<f64>,
    pub(crate) jacobian: Vec<Vector3<f64>>,
}

/// How many residuals a pass gives; with encoders the rest after it stands among theirs.
pub(crate) fn count(pass: &Pass, with_encoders: bool) -> usize {
    3 * pass.blocks.len() + if with_encoders { 0 } else { 2 }
}

/// Where a residual inside a move is seen: in one of its blocks, or by the rest after it; and what the start adds to each of them.
#[derive(Clone, Copy, Debug)]
pub(super) enum Place {
    Start,
    Block(usize),
    End,
}

/// Rows of a matrix, from one on, for the residuals inside the moves.
pub(super) struct Rows<'a> {
    matrix: &'a mut Mat<f64>,
    next: usize,
    /// How many numbers are asked for in a row, and which of them goes to each column.
    lanes: usize,
    lane_of_column: Vec<usize>,
    /// The rows of one move, one after the other.
    gathered: Vec<f64>,
}

impl<'a> Rows<'a> {
    pub(super) fn new(matrix: &'a mut Mat<f64>, first: usize) -> Self {
        let columns = matrix.ncols();
        Self { matrix, next: first, lanes: columns, lane_of_column: (0..columns).collect(), gathered: Vec::new() }
    }

    /// For what [`seen`] says of moves that are passed like this one.
    pub(super) fn of_changes(matrix: &'a mut Mat<f64>, first: usize, pass: &Pass) -> Self {
        let residual = pass.changes.lanes();
        let mut lane_of_column = vec![residual; matrix.ncols()];
        pass.changes.parameters().for_each(|(lane, parameter)| lane_of_column[parameter] = lane);
        Self { matrix, next: first, lanes: residual + 1, lane_of_column, gathered: Vec::new() }
    }

    /// The white residuals of a move with gravity along `up` at its start; `seen` adds what each is before, where and along which
    /// direction.
    pub(super) fn innovations(
        &mut self,
        pass: &Pass,
        up: &Vector3<f64>,
        noise: &InsideNoise,
        gravity_mps2: f64,
        mut seen: impl FnMut(Place, &Vector3<f64>, &mut [f64]),
    ) {
        let (lanes, count) = (self.lanes, count(pass, false));
        self.gathered.resize(count * lanes, 0.0);
        let mut rows = self.gathered.chunks_exact_mut(lanes.max(1));
        let mut start = vec![0.0; lanes];
        let [first, second] = across(up);
        let g2 = gravity_mps2 * gravity_mps2;
        for (channel, d) in [*up, first, second].iter().enumerate() {
            let across = channel > 0;
            let mut filter = Filter::new(lanes, [if across { g2 * noise.start } else { 0.0 }]);
            let walk = if across { g2 * noise.walk } else { 0.0 };
            let mut last_s = 0.0;
            start.fill(0.0);
            seen(Place::Start, d, &mut start);
            for ((k, block), z) in pass.blocks.iter().enumerate().zip(&mut rows) {
                z.copy_from_slice(&start);
                seen(Place::Block(k), d, z);
                filter.walk(walk * (block.time_s - last_s));
                last_s = block.time_s;
                filter.innovate(z, [1.0], noise.force / block.duration_s);
            }
            if across && let Some(z) = rows.next() {
                z.copy_from_slice(&start);
                seen(Place::End, d, z);
                filter.innovate(z, [1.0], g2 * noise.end);
            }
        }
        self.put();
        self.next += count;
    }

    /// The row after them.
    pub(super) fn next(&self) -> usize {
        self.next
    }

    /// Writes what is gathered. The matrix holds columns: some rows are taken together, for one by one they would go to as many
    /// places as there are columns.
    fn put(&mut self) {
        let lanes = self.lanes.max(1);
        for (tile, rows) in self.gathered.chunks(TOGETHER * lanes).enumerate() {
            let first = self.next + tile * TOGETHER;
            let count = rows.len() / lanes;
            let mut own: [&[f64]; TOGETHER] = [&[]; TOGETHER];
            own.iter_mut().zip(rows.chunks_exact(lanes)).for_each(|(own, row)| *own = row);
            for (c, &lane) in self.lane_of_column.iter().enumerate() {
                let to = &mut self.matrix.col_as_slice_mut(c)[first..first + count];
                if let Ok(to) = <&mut [f64; TOGETHER]>::try_from(&mut *to) {
                    *to = std::array::from_fn(|r| own[r][lane]);
                } else {
                    to.iter_mut().zip(own).for_each(|(to, row)| *to = row[lane]);
                }
            }
        }
    }
}

/// Adds a residual inside a move along `d`, m/s^2, after its derivatives by the parameters in their lanes.
pub(super) fn seen(at_move: &AtMove, gravity_mps2: f64, place: Place, d: &Vector3<f64>, z: &mut [f64]) {
    let AtMove { pass, before, after } = at_move;
    let at_start = d * gravity_mps2;
    let Some((residual, by_lane)) = z.split_last_mut() else { return };
    match place {
        Place::Start => {
            pass.changes.parameters().for_each(|(lane, p)| by_lane[lane] -= at_start.dot(&before.jacobian[p]));
            *residual -= at_start.dot(&before.up);
        }
        Place::Block(k) => {
            let force = &pass.blocks[k].force;
            pass.changes.add_along(k, force, d, by_lane);
            *residual += d.dot(force);
        }
        Place::End => {
            let carried = pass.rotation * after.up;
            let (by_turn, by_end) = (carried.cross(&at_start), pass.rotation.tr_mul(&at_start));
            let by = |p: usize| pass.turn[p].dot(&by_turn) + after.jacobian[p].dot(&by_end);
            pass.changes.parameters().for_each(|(lane, p)| by_lane[lane] += by(p));
            *residual += carried.dot(&at_start);
        }
    }
}

/// Rows that are written together.
const TOGETHER: usize = 16;

/// A random walk and what does not change, seen together through white noise, for a residual and all its derivatives at once.
pub(super) struct Filter<const N: usize> {
    states: Vec<[f64; N]>,
    covariance: [[f64; N]; N],
}

impl<const N: usize> Filter<N> {
    /// For so many numbers, a residual and derivatives; `variances` are those of the states at the start. The first one walks.
    pub(super) fn new(width: usize, variances: [f64; N]) -> Self {
        let mut covariance = [[0.0; N]; N];
        (0..N).for_each(|i| covariance[i][i] = variances[i]);
        Self { states: vec![[0.0; N]; width], covariance }
    }

    /// The walk goes on by this variance.
    pub(super) fn walk(&mut self, variance: f64) {
        self.covariance[0][0] += variance;
    }

    /// Replaces what is seen, `look` times the states and white noise, by its innovation over its standard deviation.
    pub(super) fn innovate(&mut self, seen: &mut [f64], look: [f64; N], white_variance: f64) {
        Arch::new().dispatch(Innovate { filter: self, seen, look, white_variance });
    }

    #[inline(always)] // With the widest registers.
    fn take(&mut self, seen: &mut [f64], look: [f64; N], white_variance: f64) {
        let shared: [f64; N] =
            std::array::from_fn(|i| self.covariance[i].iter().zip(&look).map(|(c, l)| c * l).sum::<f64>());
        let total = shared.iter().zip(&look).map(|(s, l)| s * l).sum::<f64>() + white_variance;
        let (gain, per_sigma) = (shared.map(|s| s / total), 1.0 / total.sqrt());
        if shared == [0.0; N] {
            // What is known and does not walk says nothing of what comes.
            seen.iter_mut().for_each(|value| *value *= per_sigma);
        } else {
            for (value, state) in seen.iter_mut().zip(&mut self.states) {
                let innovation = (0..N).fold(*value, |value, i| value - look[i] * state[i]);
                (0..N).for_each(|i| state[i] += gain[i] * innovation);
                *value = innovation * per_sigma;
            }
        }
        for i in 0..N {
            for j in 0..N {
                self.covariance[i][j] -= gain[i] * shared[j];
            }
        }
    }
}

struct Innovate<'a, const N: usize> {
    filter: &'a mut Filter<N>,
    seen: &'a mut [f64],
    look: [f64; N],
    white_variance: f64,
}

impl<const N: usize> WithSimd for Innovate<'_, N> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        self.filter.take(self.seen, self.look, self.white_variance);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The innovations are what the Cholesky factor of the covariance makes of the residuals.
    #[test]
    fn innovations_whiten_a_random_walk_seen_through_noise() {
        let (n, start, walk, white) = (6, 0.3, 0.2, 0.5);
        let covariance = |i: usize, j: usize| start + walk * i.min(j) as f64 + if i == j { white } else { 0.0 };
        let seen: Vec<f64> = (0..n).map(|i| ((i * i) as f64).sin()).collect();
        let factor = Mat::from_fn(n, n, covariance).llt(faer::Side::Lower).unwrap().L().to_owned();
        let mut filter = Filter::new(1, [start]);
        let mut whitened: Vec<f64> = Vec::new();
        for (i, value) in seen.iter().enumerate() {
            if i > 0 {
                filter.walk(walk);
            }
            let mut z = [*value];
            filter.innovate(&mut z, [1.0], white);
            // Forward substitution in the factor of the covariance.
            let dot: f64 = (0..i).map(|k| factor[(i, k)] * whitened[k]).sum();
            let expected = (value - dot) / factor[(i, i)];
            assert!((z[0] - expected).abs() < 1e-13, "{i}: {} {expected}", z[0]);
            whitened.push(expected);
        }
    }
}
