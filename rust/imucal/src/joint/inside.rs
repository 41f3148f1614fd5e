//! Residuals inside a move: the force, turned to the body frame at its start, is gravity there (model.md (20)).
//!
//! ```text
//! z_j = d . (mean_j(R f) - g u),   z_j = x_j + white,   x_(j+1) = x_j + random walk
//! ```
//!
//! for d along gravity (no random walk: a turn about gravity and along it is not seen) and two directions across it. The
//! error of the gyroscope's white noise walks; its innovations, as of a scalar Kalman filter, are white. The last
//! residual of a move is the rest after it.

use nalgebra::Vector3;

use super::pass::{Block, Pass};
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

/// Hands every white residual to `push`: its derivative by every parameter, and the residual itself as the last number.
pub(crate) fn innovations(
    pass: &Pass,
    start: &EndDirection,
    end: &EndDirection,
    noise: &InsideNoise,
    gravity_mps2: f64,
    mut push: impl FnMut(&[f64]),
) {
    let n = start.jacobian.len();
    let [first, second] = across(&start.up);
    let g2 = gravity_mps2 * gravity_mps2;
    let mut z = vec![0.0; n + 1];
    for (channel, d) in [start.up, first, second].iter().enumerate() {
        let across = channel > 0;
        let mut filter = Filter::new(n, [if across { g2 * noise.start } else { 0.0 }]);
        let walk = if across { g2 * noise.walk } else { 0.0 };
        let mut last_s = 0.0;
        for block in &pass.blocks {
            force(block, start, gravity_mps2, d, &mut z);
            filter.walk(walk * (block.time_s - last_s));
            last_s = block.time_s;
            filter.innovate(&mut z, [1.0], noise.force / block.duration_s);
            push(&z);
        }
        if across {
            let carried = pass.rotation * end.up;
            for p in 0..n {
                let by_end = pass.turn[p].cross(&carried) + pass.rotation * end.jacobian[p];
                z[p] = d.dot(&(by_end - start.jacobian[p])) * gravity_mps2;
            }
            z[n] = d.dot(&(carried - start.up)) * gravity_mps2;
            filter.innovate(&mut z, [1.0], g2 * noise.end);
            push(&z);
        }
    }
}

/// The residual of a block along `d`, m/s^2, after its derivatives.
pub(super) fn force(block: &Block, start: &EndDirection, gravity_mps2: f64, d: &Vector3<f64>, z: &mut [f64]) {
    let n = start.jacobian.len();
    for p in 0..n {
        z[p] = d.dot(&(block.jacobian[p] - start.jacobian[p] * gravity_mps2));
    }
    z[n] = d.dot(&(block.force - start.up * gravity_mps2));
}

/// A random walk and what does not change, seen together through white noise, for a residual and all its derivatives at once.
pub(super) struct Filter<const N: usize> {
    states: [Vec<f64>; N],
    covariance: [[f64; N]; N],
}

impl<const N: usize> Filter<N> {
    /// For a residual and `parameters` derivatives; `variances` are those of the states at the start. The first one walks.
    pub(super) fn new(parameters: usize, variances: [f64; N]) -> Self {
        let mut covariance = [[0.0; N]; N];
        (0..N).for_each(|i| covariance[i][i] = variances[i]);
        Self { states: [0; N].map(|_| vec![0.0; parameters + 1]), covariance }
    }

    /// The walk goes on by this variance.
    pub(super) fn walk(&mut self, variance: f64) {
        self.covariance[0][0] += variance;
    }

    /// Replaces what is seen, `look` times the states and white noise, by its innovation over its standard deviation.
    pub(super) fn innovate(&mut self, seen: &mut [f64], look: [f64; N], white_variance: f64) {
        let shared: [f64; N] =
            std::array::from_fn(|i| self.covariance[i].iter().zip(&look).map(|(c, l)| c * l).sum::<f64>());
        let total = shared.iter().zip(&look).map(|(s, l)| s * l).sum::<f64>() + white_variance;
        let (gain, sigma) = (shared.map(|s| s / total), total.sqrt());
        // What is known and does not walk says nothing of what comes.
        if shared != [0.0; N] {
            for (state, look) in self.states.iter().zip(&look) {
                seen.iter_mut().zip(state).for_each(|(value, state)| *value -= look * state);
            }
            for (state, gain) in self.states.iter_mut().zip(&gain) {
                state.iter_mut().zip(&*seen).for_each(|(state, value)| *state += gain * value);
            }
        }
        seen.iter_mut().for_each(|value| *value /= sigma);
        for i in 0..N {
            for j in 0..N {
                self.covariance[i][j] -= gain[i] * shared[j];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use faer::Mat;

    /// The innovations are what the Cholesky factor of the covariance makes of the residuals.
    #[test]
    fn innovations_whiten_a_random_walk_seen_through_noise() {
        let (n, start, walk, white) = (6, 0.3, 0.2, 0.5);
        let covariance = |i: usize, j: usize| start + walk * i.min(j) as f64 + if i == j { white } else { 0.0 };
        let seen: Vec<f64> = (0..n).map(|i| ((i * i) as f64).sin()).collect();
        let factor = Mat::from_fn(n, n, covariance).llt(faer::Side::Lower).unwrap().L().to_owned();
        let mut filter = Filter::new(0, [start]);
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
