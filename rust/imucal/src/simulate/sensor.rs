//! From what a triad undergoes to what it says.
//!
//! ```text
//! measured = convert(sensitivity * true + bias + noise_density sqrt(rate_hz) n),    n ~ N(0, 1), independent
//! ```
//!
//! Point samples: a sample sees the true value at its own instant. White noise of density N then has the discrete
//! standard deviation N sqrt(rate) (a mean over T has N / sqrt(T) at every rate): the Allan deviation's and the
//! angle random walk's convention, not the one-sided bandwidth's N sqrt(rate / 2).

use nalgebra::Vector3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::unit::Sensor;

/// One triad at work, sample by sample.
pub(super) struct Sampler<'a> {
    sensor: &'a Sensor,
    noise_std: f64,
    noise: [ChaCha8Rng; 3],
}

impl<'a> Sampler<'a> {
    /// `noise` has one generator per axis.
    pub(super) fn new(sensor: &'a Sensor, rate_hz: f64, noise: [ChaCha8Rng; 3]) -> Self {
        Self { sensor, noise_std: sensor.noise_density * rate_hz.sqrt(), noise }
    }

    /// The next sample.
    #[inline]
    pub(super) fn measure(&mut self, truth: &Vector3<f64>) -> [f64; 3] {
        let mut measured = self.sensor.sensitivity * truth + self.sensor.bias;
        for (value, generator) in measured.iter_mut().zip(&mut self.noise) {
            *value += self.noise_std * generator.sample::<f64, _>(StandardNormal);
        }
        match self.sensor.converter {
            Some(converter) => measured.map(|value| converter.convert(value)).into(),
            None => measured.into(),
        }
    }
}
