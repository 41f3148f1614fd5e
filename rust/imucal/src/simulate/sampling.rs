//! Signal path from the sensing element to the samples: a low-pass filter, followed by point sampling or averaging.
//!
//! ```text
//! point      y_i = x(t_i)
//! averaging  y_i = (1 / T) * (integral of x from t_i - T to t_i),    T = 1 / rate
//! low pass   |H(f)|^2 = 1 / (1 + (f / bandwidth)^4),         a Butterworth filter of second order
//! ```
//!
//! x is the signal before sampling, y_i the sample at the time t_i, and H the frequency response of the filter.
//! Averaging delays the signal by T / 2. Averaging, filtering, and the noise that is added before them are simulated at
//! an internal rate above the sampling rate. The integral is computed by the trapezoidal rule. The filter is
//! discretised by the bilinear transform with prewarping, so that the gain is exact at the bandwidth frequency. Point
//! samples without a filter are simulated at the sampling rate.

use std::f64::consts::{PI, SQRT_2};

use nalgebra::Vector3;

/// A low-pass filter before sampling.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LowPass {
    /// Frequency at which the power gain is one half, Hz.
    pub bandwidth_hz: f64,
}

/// Minimum number of internal time steps per sample of a sensor with averaging or a filter.
pub(super) const MIN_STEPS: usize = 8;
/// Maximum number of internal time steps per sample. A filter whose bandwidth would need more steps is refused.
pub(super) const MAX_STEPS: usize = 64;
/// Number of internal steps per period of a sine at the bandwidth of the filter. With this number, the frequency
/// distortion of the bilinear transform is small.
const STEPS_PER_PERIOD: f64 = 16.0;

impl LowPass {
    /// Number of internal steps per sample that this filter needs at the sampling rate `rate_hz`, Hz.
    pub(super) fn steps(&self, rate_hz: f64) -> usize {
        ((STEPS_PER_PERIOD * self.bandwidth_hz / rate_hz).ceil() as usize).max(MIN_STEPS)
    }
}

/// The low-pass filter of a triad in discrete time, with its state.
pub(super) struct Filter {
    b: f64,
    a_1: f64,
    a_2: f64,
    state: [Vector3<f64>; 2],
}

impl Filter {
    /// A filter in its steady state for a constant `input`.
    pub(super) fn new(low_pass: &LowPass, rate_hz: f64, input: &Vector3<f64>) -> Self {
        // Second-order Butterworth low pass 1 / (1 + sqrt(2) s + s^2), where s is the Laplace variable divided by the
        // angular bandwidth. The bilinear transform replaces s by (1 - q) / (k (1 + q)), where q is the delay by one
        // internal step.
        let k = (PI * low_pass.bandwidth_hz / rate_hz).tan();
        let scale = (1.0 + SQRT_2 * k + k * k).recip();
        let (b, a_1, a_2) = (k * k * scale, 2.0 * (k * k - 1.0) * scale, (1.0 - SQRT_2 * k + k * k) * scale);
        Self { b, a_1, a_2, state: [input * (1.0 - b), input * (b - a_2)] }
    }

    /// Advances the filter by one internal step and returns its output for this `input` (transposed direct form II).
    #[inline]
    pub(super) fn next(&mut self, input: &Vector3<f64>) -> Vector3<f64> {
        let output = input * self.b + self.state[0];
        self.state[0] = input * (2.0 * self.b) - output * self.a_1 + self.state[1];
        self.state[1] = input * self.b - output * self.a_2;
        output
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    #[test]
    fn gain_is_the_butterworth_filters() {
        // The bandwidth is far below the internal rate, so the gain is close to the gain of the analogue filter. At the
        // bandwidth frequency, the gain is exact.
        let (rate_hz, bandwidth_hz) = (1000.0, 10.0);
        for frequency_hz in [1.0, 5.0, 10.0, 20.0, 40.0] {
            let mut filter = Filter::new(&LowPass { bandwidth_hz }, rate_hz, &Vector3::zeros());
            let mut power = 0.0;
            for i in 0..4000 {
                let output = filter.next(&Vector3::repeat((TAU * frequency_hz * f64::from(i) / rate_hz).sin())).x;
                // In the second half, the transient has decayed. This half contains whole periods of every frequency.
                if i >= 2000 {
                    power += output * output / 1000.0;
                }
            }
            let expected = 1.0 / (1.0 + (frequency_hz / bandwidth_hz).powi(4));
            let warp = 2e-2 * (frequency_hz / 40.0).powi(2);
            assert!((power / expected - 1.0).abs() < 1e-6 + warp, "{frequency_hz} Hz: {power}, not {expected}");
        }
    }

    #[test]
    fn a_constant_passes_from_the_first_step() {
        let input = Vector3::new(1.0, -2.0, 3.0);
        let mut filter = Filter::new(&LowPass { bandwidth_hz: 20.0 }, 800.0, &input);
        for _ in 0..100 {
            assert!((filter.next(&input) - input).norm() < 1e-13);
        }
    }
}
