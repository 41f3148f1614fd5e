//! Checks whether the noise densities and the biases at the rests have values that no real sensor has. If they do and
//! the unit is hand-held, the check is repeated with noise densities that do not contain the tremor of the hand.

use imucal_core::sensor::Triad;

use crate::check::{RestNoise, check_noise};
use crate::finding::Finding;
use crate::numerics::stats::quantile;
use crate::recording::Recording;
use crate::rests::noise_density::NoiseDensity;
use crate::rests::rest::Rest;
use crate::rests::segment::Segments;
use crate::rests::tremor::{Hand, Sensors};

impl Segments {
    /// Findings about noise densities and biases that no real sensor has. There are no findings if every rest is
    /// unsteady (hand-held), because the densities then contain the tremor of the hand. A rest is unsteady if its
    /// samples scatter more than the samples in the quietest parts of the recording. If the tremor is equally strong in
    /// the whole recording, every rest therefore appears steady. In this case, the tremor is detected by the
    /// correlation between both sensors, and the check uses densities that are computed without the tremor.
    pub fn check_noise(&self, recording: &Recording<'_>) -> Vec<Finding> {
        let steady: Vec<&Rest> = self.rests.iter().filter(|rest| rest.is_steady()).collect();
        if steady.is_empty() {
            return Vec::new();
        }
        let column = |density: f64, means: &dyn Fn(&Rest) -> f64| {
            let mut means: Vec<f64> = steady.iter().map(|rest| means(rest)).collect();
            RestNoise { density: Some(density), mean: Some(quantile(&mut means, 0.5)) }
        };
        let of = |noise: &NoiseDensity| {
            let columns = std::array::from_fn(|k| match k {
                0..3 => column(noise.specific_force[k], &|rest| rest.specific_force.mean[k]),
                _ => column(noise.angular_rate[k - 3], &|rest| rest.angular_rate.mean[k - 3]),
            });
            check_noise(recording, &columns)
        };
        let findings = of(&self.noise_density);
        let has_both = !recording.specific_force.is_absent() && !recording.angular_rate.is_absent();
        // Both sensors are needed to separate hand tremor from noise.
        if findings.is_empty() || !has_both {
            return findings;
        }
        let nominal = Triad::identity();
        let sensors = Sensors { accelerometer: &nominal, gyroscope: &nominal };
        let all: Vec<&Rest> = self.rests.iter().collect();
        Hand::of(recording, &all, sensors).map_or(findings, |hand| of(&hand.noise))
    }
}
