//! Tremor: small rotations at all times, caused by a trembling hand or a vibrating table.
//!
//! ```text
//! R_wb(t) = (R_wb without the tremor) * R(v(t))
//! ```
//!
//! R_wb is the attitude (world from body). Each component of v is a sum of sines. R(v) is the rotation with the
//! Rodrigues vector v / 2, which is nearly the rotation with the rotation vector v.

use std::f64::consts::TAU;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use super::attitude::Attitude;
use super::moment::Moment;
use super::profile::Course;
use super::stream::Stream;

/// Frequency bands of hand tremor, from slow sway to physiological tremor at about 9 Hz. Each entry contains the lowest
/// and the highest frequency of the band, Hz, and the band's share of the variance.
const BANDS: [(f64, f64, f64); 3] = [(0.3, 0.8, 0.6), (1.5, 4.0, 0.3), (8.0, 11.0, 0.1)];

/// A tremor, with one sine for each frequency band about each axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tremor([[Sine; BANDS.len()]; 3]);

#[derive(Clone, Copy, Debug, PartialEq)]
struct Sine {
    amplitude_rad: f64,
    frequency_radps: f64,
    phase_rad: f64,
}

impl Tremor {
    /// Creates a random tremor with this standard deviation about each axis, rad. The same seed always gives the same
    /// tremor.
    pub fn random(tremor_rad: f64, seed: u64) -> Self {
        Self::drawn(tremor_rad, &mut Stream::Tremor.generator(seed))
    }

    pub(super) fn drawn(tremor_rad: f64, generator: &mut ChaCha8Rng) -> Self {
        Self([(); 3].map(|()| BANDS.map(|band| sine(band, tremor_rad, generator))))
    }

    pub(super) fn attitude(&self, time_s: f64) -> Attitude {
        Attitude::small(&self.0.map(|sines| {
            let parts =
                sines.map(|sine| Course::sine(sine.frequency_radps, sine.phase_rad, time_s) * sine.amplitude_rad);
            parts.into_iter().sum()
        }))
    }

    /// Adds the tremor to a motion without tremor.
    pub(super) fn shake(&self, moment: Moment, time_s: f64) -> Moment {
        moment.turned(&self.attitude(time_s))
    }

    pub(super) fn is_finite(&self) -> bool {
        self.0.as_flattened().iter().all(|sine| sine.amplitude_rad.is_finite() && sine.amplitude_rad >= 0.0)
    }
}

/// A sine with a random frequency in a frequency band and a random phase. Its variance is the band's share of the
/// variance of the tremor.
fn sine((low_hz, high_hz, share): (f64, f64, f64), tremor_rad: f64, generator: &mut ChaCha8Rng) -> Sine {
    Sine {
        amplitude_rad: tremor_rad * (2.0 * share).sqrt(),
        frequency_radps: TAU * generator.random_range(low_hz..high_hz),
        phase_rad: generator.random_range(0.0..TAU),
    }
}

#[cfg(test)]
mod tests {
    use imucal_core::so3;

    use super::*;
    use crate::simulate::{Motion, Program, RandomMoves, Stand};

    #[test]
    fn a_stand_that_trembles_never_rests_and_its_rates_are_derivatives() {
        let moves = RandomMoves { moves: 3, ..RandomMoves::default() };
        let stand = Stand { tremor: Some(Tremor::random(2e-3, 5)), ..Stand::perfect() };
        let motion = Motion::Stand { program: Program::random(&moves, 2).unwrap(), stand };
        let h = 1e-5;
        for i in 0..200 {
            let t = 0.05 + 0.05 * f64::from(i);
            let (before, now, after) = (motion.at(t - h), motion.at(t), motion.at(t + h));
            let turned = before.rotation_world_from_body.inverse() * after.rotation_world_from_body;
            assert!((so3::log(&turned) / (2.0 * h) - now.angular_rate).norm() < 1e-6, "{t} s");
            let change = (after.angular_rate - before.angular_rate) / (2.0 * h);
            // At a step of the motors' jerk, the central difference has an error of h / 4 times the size of the step.
            assert!((change - now.angular_acceleration).norm() < 1e-3, "{t} s: {change} {}", now.angular_acceleration);
            assert!(now.angular_rate.norm() > 0.0);
            assert_eq!(motion.still_until(t), None);
        }
    }
}
