//! Biases that vary during a recording: bias instability and random walk (`docs/model.md` (28)).
//!
//! ```text
//! C_kl = cov(mean of b over rest k, mean of b over rest l),   b measured from its mean over the recording
//! covariance of b(t), b(s), up to a constant:   -B^2/pi ln |t - s|  -  K^2/2 |t - s|
//! ```
//!
//! B is the bias instability and K the random walk of each axis. A recording with minutes of rests shows only a large
//! B; otherwise B and K are given by the user. The estimated bias is then the mean over the recording. The bias of a
//! move is the mean of the biases at the rests before and after.

use std::f64::consts::PI;

use faer::Mat;

use crate::error::Error;

/// Maximum number of residuals for which the full covariance is factored; more would take too long.
pub(super) const MOST_ROWS: usize = 6000;

/// Model of the variation of the biases of a unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Wander {
    /// Constant biases. Excess scatter of the rests is independent from rest to rest.
    Constant,
    /// Bias instability estimated from the rates at the rests, if it is likelier than independent scatter.
    Seen,
    Known(UnitWander),
}

impl Wander {
    /// The given bias instability and random walk of the unit, or constant biases if there are none.
    pub(crate) fn of(known: Option<UnitWander>) -> Self {
        known.map_or(Self::Constant, Self::Known)
    }
}

/// Bias instability and random walk of the biases of one sensor, x, y and z, in SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BiasWander {
    /// Bias instability B, SI unit: the minimum of the Allan deviation is `sqrt(2 ln 2 / pi) B`.
    pub bias_instability: [f64; 3],
    /// Random walk K, SI unit per sqrt(s): the Allan deviation is `K sqrt(tau / 3)`.
    pub random_walk: [f64; 3],
}

/// Variation of the biases of both sensors of a unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnitWander {
    /// Accelerometer, m/s^2.
    pub accelerometer: BiasWander,
    /// Gyroscope, rad/s.
    pub gyroscope: BiasWander,
}

impl UnitWander {
    /// A unit with these bias instabilities of the gyroscope, rad/s, and no other variation.
    pub(crate) fn of_gyroscope(bias_instability: [f64; 3]) -> Self {
        let none = BiasWander { bias_instability: [0.0; 3], random_walk: [0.0; 3] };
        Self { accelerometer: none, gyroscope: BiasWander { bias_instability, ..none } }
    }

    /// # Errors
    /// [`Error::Input`] for a number that is negative or not finite.
    pub fn check(&self) -> Result<(), Error> {
        for (name, wander) in [("accelerometer", &self.accelerometer), ("gyroscope", &self.gyroscope)] {
            for value in wander.bias_instability.iter().chain(&wander.random_walk) {
                if !(value.is_finite() && *value >= 0.0) {
                    return Err(Error::Input(format!(
                        "bias_instability or random_walk of the {name} is {value}: give numbers from zero on, SI units"
                    )));
                }
            }
        }
        Ok(())
    }
}

impl BiasWander {
    /// Second integral of the covariance of an axis with respect to the lag.
    fn integrated(&self, axis: usize, lag_s: f64) -> f64 {
        let lag_s = lag_s.abs();
        if lag_s == 0.0 {
            return 0.0;
        }
        let flicker = lag_s * lag_s / 2.0 * (lag_s.ln() - 1.5);
        let (b, k) = (self.bias_instability[axis], self.random_walk[axis]);
        -b * b / PI * flicker - k * k / 12.0 * lag_s.powi(3)
    }

    /// Covariance of the means over two intervals of time, up to a constant.
    fn covariance(&self, axis: usize, [a, b]: [f64; 2], [c, d]: [f64; 2]) -> f64 {
        let g = |lag_s: f64| self.integrated(axis, lag_s);
        (g(d - a) - g(c - a) - g(d - b) + g(c - b)) / ((b - a) * (d - c))
    }

    /// Covariance of the means over the rests of one recording, relative to the mean over the interval `whole`.
    pub(super) fn of_rests(&self, axis: usize, rests: &[[f64; 2]], whole: [f64; 2]) -> Mat<f64> {
        let with_whole: Vec<f64> = rests.iter().map(|rest| self.covariance(axis, *rest, whole)).collect();
        let all = self.covariance(axis, whole, whole);
        let mut own = Mat::zeros(rests.len(), rests.len());
        for (i, j) in (0..rests.len()).flat_map(|i| (0..=i).map(move |j| (i, j))) {
            own[(i, j)] = self.covariance(axis, rests[i], rests[j]) - with_whole[i] - with_whole[j] + all;
            own[(j, i)] = own[(i, j)];
        }
        own
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const UNIT: BiasWander = BiasWander { bias_instability: [2e-5, 0.0, 3e-5], random_walk: [0.0, 4e-6, 1e-6] };

    /// The Allan variance is half the mean square of the difference of consecutive means.
    #[test]
    fn neighbouring_means_have_the_allan_variance_of_the_definitions() {
        for (axis, tau_s) in [(0, 0.5), (1, 3.0), (2, 100.0)] {
            let spans = [[7.0, 7.0 + tau_s], [7.0 + tau_s, 7.0 + 2.0 * tau_s]];
            let c = |i: usize, j: usize| UNIT.covariance(axis, spans[i], spans[j]);
            let (b, k) = (UNIT.bias_instability[axis], UNIT.random_walk[axis]);
            let expected = 2.0 * 2f64.ln() / PI * b * b + k * k * tau_s / 3.0;
            let allan = (c(0, 0) + c(1, 1) - 2.0 * c(0, 1)) / 2.0;
            assert!((allan / expected - 1.0).abs() < 1e-9, "{axis}: {allan:e} {expected:e}");
        }
    }

    #[test]
    fn means_of_all_parts_add_up_to_the_mean_of_the_recording() {
        let spans: Vec<[f64; 2]> = (0..10).map(|k| [f64::from(k) * 3.0, f64::from(k + 1) * 3.0]).collect();
        for axis in 0..3 {
            let covariance = UNIT.of_rests(axis, &spans, [0.0, 30.0]);
            let size = covariance[(0, 0)];
            for i in 0..10 {
                let sum: f64 = (0..10).map(|j| covariance[(i, j)]).sum();
                assert!(sum.abs() < 1e-9 * size, "{axis} {i}: {sum:e} of {size:e}");
            }
        }
    }
}
