//! Computes the covariance of biases that vary from rest to rest, from their bias instability and random walk (model.md
//! (28)).
//!
//! ```text
//! C_kl = cov(mean of b over rest k, mean of b over rest l),   b measured from its mean over the recording
//! covariance of b(t), b(s), up to a constant:   -B^2/pi ln |t - s|  -  K^2/2 |t - s|
//! ```
//!
//! b is the bias of one axis, t and s are times, B is the bias instability, and K is the random walk of the axis. The
//! covariance of b(t) and b(s) is defined up to an additive constant. This constant cancels in C_kl, because b is
//! measured from its mean over the recording. A large B can be estimated from the scatter of the mean rates of the
//! rests. A smaller B, and any K, can only be given in the unit's profile. The bias parameter of the fit is the mean
//! bias over the recording. The bias in a move is the mean of the biases at the adjacent rests.

use std::f64::consts::PI;

use faer::Mat;

use crate::error::Error;

/// Maximum number of residuals (force norms, gravity directions after moves and mean rates) for which the full
/// covariance is factorised. The time of the factorisation grows with the third power of this number. If a fit has more
/// of these residuals, errors that are correlated from rest to rest are neglected, and a unit's profile with varying
/// biases is refused.
pub(super) const MOST_ROWS: usize = 6000;

/// Model of the variation of the biases from rest to rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Wander {
    /// The biases are constant. If the mean rates scatter more than their noise explains, the excess is modelled as
    /// independent from rest to rest.
    Constant,
    /// The bias instability of the gyroscope is estimated from the mean rates. It is used if the scatter of the mean
    /// rates has a larger likelihood with bias instability than with errors that are independent from rest to rest.
    Seen,
    Known(UnitWander),
}

impl Wander {
    /// Bias variation known from the unit's datasheet or noise recording; constant biases if `known` is `None`.
    pub(crate) fn of(known: Option<UnitWander>) -> Self {
        known.map_or(Self::Constant, Self::Known)
    }
}

/// Bias variation of one sensor, axes x, y and z, SI units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BiasWander {
    /// Bias instability B, SI unit: the minimum of the Allan deviation is `sqrt(2 ln 2 / pi) B`.
    pub bias_instability: [f64; 3],
    /// Random walk K, SI unit per sqrt(s): the Allan deviation is `K sqrt(tau / 3)`.
    pub random_walk: [f64; 3],
}

/// Bias variation of both sensors of a unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UnitWander {
    /// Accelerometer, m/s^2.
    pub accelerometer: BiasWander,
    /// Gyroscope, rad/s.
    pub gyroscope: BiasWander,
}

impl UnitWander {
    /// Bias variation of a unit whose gyroscope has these bias instabilities, rad/s. The random walk of the gyroscope
    /// is zero, and the biases of the accelerometer are constant.
    pub(crate) fn of_gyroscope(bias_instability: [f64; 3]) -> Self {
        let none = BiasWander { bias_instability: [0.0; 3], random_walk: [0.0; 3] };
        Self { accelerometer: none, gyroscope: BiasWander { bias_instability, ..none } }
    }

    /// # Errors
    /// [`Error::Input`] if a number is negative or not finite.
    pub fn check(&self) -> Result<(), Error> {
        for (name, wander) in [("accelerometer", &self.accelerometer), ("gyroscope", &self.gyroscope)] {
            for value in wander.bias_instability.iter().chain(&wander.random_walk) {
                if !(value.is_finite() && *value >= 0.0) {
                    return Err(Error::Input(format!(
                        "bias_instability or random_walk of the {name} is {value}: give non-negative numbers in SI units"
                    )));
                }
            }
        }
        Ok(())
    }
}

impl BiasWander {
    /// Whether the bias of an axis varies.
    pub(super) fn varies(&self, axis: usize) -> bool {
        self.bias_instability[axis] > 0.0 || self.random_walk[axis] > 0.0
    }

    /// Integrates the covariance function of the bias of one axis twice with respect to the time lag, and returns the
    /// value at `lag_s`.
    fn integrated(&self, axis: usize, lag_s: f64) -> f64 {
        let lag_s = lag_s.abs();
        if lag_s == 0.0 {
            return 0.0;
        }
        let flicker = lag_s * lag_s / 2.0 * (lag_s.ln() - 1.5);
        let (b, k) = (self.bias_instability[axis], self.random_walk[axis]);
        -b * b / PI * flicker - k * k / 12.0 * lag_s.powi(3)
    }

    /// Computes the covariance of the mean bias over the time interval `[a, b]` and the mean bias over `[c, d]`, up to
    /// an additive constant.
    fn covariance(&self, axis: usize, [a, b]: [f64; 2], [c, d]: [f64; 2]) -> f64 {
        let g = |lag_s: f64| self.integrated(axis, lag_s);
        (g(d - a) - g(c - a) - g(d - b) + g(c - b)) / ((b - a) * (d - c))
    }

    /// Computes the covariance of the mean biases of one axis at the rests of one recording. Each mean bias is taken
    /// relative to the mean bias over the interval `whole`.
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

    /// The Allan variance must be half the mean squared difference of the mean biases over two consecutive intervals.
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
