//! Kalman filter for a random walk and constant states that are measured with white noise. The innovations of the
//! filter are white.

use pulp::{Simd, WithSimd};

use crate::numerics::instructions::Instructions;

/// Covariance of the filter states. State 0 is a random walk, and all other states are constant.
pub(crate) struct WalkFilter<const N: usize> {
    covariance: [[f64; N]; N],
}

/// Kalman gain for one measurement `seen`: `innovation = seen - observation . states`, `states += shares * innovation`.
#[derive(Clone, Copy)]
pub(crate) struct Gain<const N: usize> {
    pub(crate) shares: [f64; N],
    /// Reciprocal of the standard deviation of the innovation.
    pub(crate) per_sigma: f64,
}

impl<const N: usize> WalkFilter<N> {
    /// Filter with uncorrelated states that have these initial variances.
    pub(crate) fn new(variances: [f64; N]) -> Self {
        let mut covariance = [[0.0; N]; N];
        (0..N).for_each(|i| covariance[i][i] = variances[i]);
        Self { covariance }
    }

    /// Prediction step: adds `variance` to the variance of the random walk.
    pub(crate) fn predict(&mut self, variance: f64) {
        self.covariance[0][0] += variance;
    }

    /// Update step with a measurement `observation . states + white noise`; returns the gain.
    pub(crate) fn update(&mut self, observation: [f64; N], white_variance: f64) -> Gain<N> {
        let shared: [f64; N] =
            std::array::from_fn(|i| self.covariance[i].iter().zip(&observation).map(|(c, l)| c * l).sum::<f64>());
        let total = shared.iter().zip(&observation).map(|(s, l)| s * l).sum::<f64>() + white_variance;
        let shares = shared.map(|s| s / total);
        for i in 0..N {
            for j in 0..N {
                self.covariance[i][j] -= shares[i] * shared[j];
            }
        }
        Gain { shares, per_sigma: 1.0 / total.sqrt() }
    }
}

/// States of the filter for a residual and for each of its derivatives. The same gains apply to all of them.
pub(crate) struct Filter<const N: usize> {
    states: Vec<[f64; N]>,
    pub(crate) walk: WalkFilter<N>,
}

impl<const N: usize> Filter<N> {
    /// Zero states for `width` values: the derivatives of the residual, and the residual itself.
    pub(crate) fn new(width: usize, walk: WalkFilter<N>) -> Self {
        Self { states: vec![[0.0; N]; width], walk }
    }

    /// Replaces each measurement in `seen` by its innovation, divided by the standard deviation of the innovation. A
    /// measurement is `observation . states + white noise`.
    pub(crate) fn innovate(&mut self, seen: &mut [f64], observation: [f64; N], white_variance: f64) {
        let gain = self.walk.update(observation, white_variance);
        Instructions::Best.run(Innovate { states: &mut self.states, seen, observation, gain });
    }
}

struct Innovate<'a, const N: usize> {
    states: &'a mut [[f64; N]],
    seen: &'a mut [f64],
    observation: [f64; N],
    gain: Gain<N>,
}

impl<const N: usize> WithSimd for Innovate<'_, N> {
    type Output = ();

    #[inline(always)] // Compiled for the widest SIMD registers of the processor.
    fn with_simd<S: Simd>(self, _: S) {
        let Self { states, seen, observation, gain: Gain { shares, per_sigma } } = self;
        for (value, state) in seen.iter_mut().zip(states) {
            let innovation = (0..N).fold(*value, |value, i| value - observation[i] * state[i]);
            (0..N).for_each(|i| state[i] += shares[i] * innovation);
            *value = innovation * per_sigma;
        }
    }
}

#[cfg(test)]
mod tests {
    use faer::Mat;

    use super::*;

    /// The normalised innovations must equal `L^-1 r`, where r are the measurements and L is the Cholesky factor of
    /// their covariance.
    #[test]
    fn innovations_whiten_a_random_walk_seen_through_noise() {
        let (n, start, walk, white) = (6, 0.3, 0.2, 0.5);
        let covariance = |i: usize, j: usize| start + walk * i.min(j) as f64 + if i == j { white } else { 0.0 };
        let seen: Vec<f64> = (0..n).map(|i| ((i * i) as f64).sin()).collect();
        let factor = Mat::from_fn(n, n, covariance).llt(faer::Side::Lower).unwrap().L().to_owned();
        let mut filter = Filter::new(1, WalkFilter::new([start]));
        let mut whitened: Vec<f64> = Vec::new();
        for (i, value) in seen.iter().enumerate() {
            if i > 0 {
                filter.walk.predict(walk);
            }
            let mut z = [*value];
            filter.innovate(&mut z, [1.0], white);
            // Forward substitution with the Cholesky factor of the covariance gives the expected innovation.
            let dot: f64 = (0..i).map(|k| factor[(i, k)] * whitened[k]).sum();
            let expected = (value - dot) / factor[(i, i)];
            assert!((z[0] - expected).abs() < 1e-13, "{i}: {} {expected}", z[0]);
            whitened.push(expected);
        }
    }
}
