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

use super::pass::Pass;

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

/// How many residuals a pass gives.
pub(crate) fn count(pass: &Pass) -> usize {
    3 * pass.blocks.len() + 2
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
    let smallest = start.up.iamin();
    let first = Vector3::ith(smallest, 1.0).cross(&start.up).normalize();
    let g2 = gravity_mps2 * gravity_mps2;
    let mut z = vec![0.0; n + 1];
    for (channel, d) in [start.up, first, start.up.cross(&first)].iter().enumerate() {
        let across = channel > 0;
        let mut filter = Filter::new(n, if across { g2 * noise.start } else { 0.0 });
        let walk = if across { g2 * noise.walk } else { 0.0 };
        let mut last_s = 0.0;
        for block in &pass.blocks {
            for p in 0..n {
                z[p] = d.dot(&(block.jacobian[p] - start.jacobian[p] * gravity_mps2));
            }
            z[n] = d.dot(&(block.force - start.up * gravity_mps2));
            filter.walk(walk * (block.time_s - last_s));
            last_s = block.time_s;
            filter.innovate(&mut z, noise.force / block.duration_s);
            push(&z);
        }
        if across {
            let carried = pass.rotation * end.up;
            for p in 0..n {
                let by_end = pass.turn[p].cross(&carried) + pass.rotation * end.jacobian[p];
                z[p] = d.dot(&(by_end - start.jacobian[p])) * gravity_mps2;
            }
            z[n] = d.dot(&(carried - start.up)) * gravity_mps2;
            filter.innovate(&mut z, g2 * noise.end);
            push(&z);
        }
    }
}

/// A scalar random walk seen through white noise, for a residual and all its derivatives at once.
pub(super) struct Filter {
    state: Vec<f64>,
    variance: f64,
}

impl Filter {
    /// For a residual and `parameters` derivatives; `variance` is that of the walk at its start.
    pub(super) fn new(parameters: usize, variance: f64) -> Self {
        Self { state: vec![0.0; parameters + 1], variance }
    }

    /// The walk goes on by this variance.
    pub(super) fn walk(&mut self, variance: f64) {
        self.variance += variance;
    }

    /// Replaces what is seen by its innovation over its standard deviation.
    pub(super) fn innovate(&mut self, seen: &mut [f64], white_variance: f64) {
        let total = self.variance + white_variance;
        let gain = self.variance / total;
        for (value, state) in seen.iter_mut().zip(&mut self.state) {
            let innovation = *value - *state;
            *state += gain * innovation;
            *value = innovation / total.sqrt();
        }
        self.variance *= white_variance / total;
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
        let mut filter = Filter::new(0, start);
        let mut whitened: Vec<f64> = Vec::new();
        for (i, value) in seen.iter().enumerate() {
            if i > 0 {
                filter.walk(walk);
            }
            let mut z = [*value];
            filter.innovate(&mut z, white);
            // Forward substitution in the factor of the covariance.
            let dot: f64 = (0..i).map(|k| factor[(i, k)] * whitened[k]).sum();
            let expected = (value - dot) / factor[(i, i)];
            assert!((z[0] - expected).abs() < 1e-13, "{i}: {} {expected}", z[0]);
            whitened.push(expected);
        }
    }
}
