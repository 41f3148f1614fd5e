//! Estimates the sway of the hand that holds a unit, and adds it to the error variances of the rests (model.md (27)).
//!
//! Sway is the translational acceleration of the hand, typically at frequencies of 0.3 to 3 Hz. At a hand-held rest, it
//! changes the mean force and the gravity direction at both ends of the rest. It is too slow to change the fourth
//! differences from which the noise of the sensors is estimated. Sway is therefore estimated as follows. The force
//! samples of a rest are rotated to one attitude with the gyroscope, which removes the tremor. The rest is divided into
//! windows, and the following contrast is computed in each window:
//!
//! ```text
//! s = (mean at the start) + (mean at the end) - 2 (mean over the window)
//! ```
//!
//! The means at the start and at the end have the same exponential weights as the gravity direction at an end of a
//! rest. A constant force and a linear change of the force cancel in the contrast. An error of the gyroscope bias
//! causes such a linear change, so the bias need not be known. The variance of the contrast due to sensor noise is
//! known. If the contrasts have a significantly larger variance, the excess variance is attributed to sway.

use nalgebra::{Matrix3, Vector3};

use crate::numerics::fit_report::significance_limit;
use crate::recording::Recording;
use crate::rests::rest::Rest;
use crate::rests::tremor::{Hand, ROOM, Sensors};

/// Number of iterations in which the sway is estimated. The averaging time constant of the gravity directions depends
/// on the sway, and the density of the sway is estimated at this time constant. The relative error of the density
/// halves with each iteration.
const PASSES: usize = 4;
/// Minimum number of samples of a window. Shorter rests are not used. The averaging time constant may be below the
/// sampling interval if the gyroscope is much noisier than the accelerometer. Without this minimum, windows of a few
/// time constants could then contain no sample.
const LEAST_SAMPLES: usize = 8;
/// At a rest of duration T, the variance of the mean force due to sway is
/// `MEAN_FORCE` x (variance of the velocity) / T^2. The mean acceleration is the difference of the velocities at both
/// ends, divided by T. The factor would therefore be 2 if these velocities were independent and their variance were
/// known exactly. The estimated variance of the velocity is too small for sway with periods above 2 s, so a larger
/// factor is used.
const MEAN_FORCE: f64 = 3.0;

impl Hand {
    /// Includes the sway at `rests` in the errors of the gravity directions and of the mean forces. Changes nothing if
    /// sensor noise explains the contrasts of the forces.
    pub(super) fn add_sway(&mut self, recording: &Recording<'_>, rests: &[&Rest], sensors: Sensors<'_>) {
        let white_rad2_s = self.tilt_rad2_s;
        let square = |rest: &&Rest| sensors.accelerometer.correct(rest.specific_force.mean).norm_squared();
        let force2 = rests.iter().map(square).sum::<f64>() / rests.len() as f64;
        for _ in 0..PASSES {
            let Some(sway) = Sway::of(recording, rests, sensors, self) else { break };
            self.tilt_rad2_s = white_rad2_s + sway.across / force2;
            self.sway_m2_per_s2 = sway.along;
            self.least_turn_rad2 = self.turn_rad2;
        }
    }

    /// Variance of each component of the mean force of a rest of this duration due to sway, (m/s^2)^2.
    pub(super) fn sway_variance(&self, duration_s: f64) -> f64 {
        MEAN_FORCE * self.sway_m2_per_s2 / (duration_s * duration_s)
    }
}

/// Significant sway at the rests of a recording.
struct Sway {
    /// Spectral density of the force perpendicular to gravity that sway adds to the sensor noise, (m/s^2)^2 s. Each
    /// component of the mean force at an end of a rest has the variance (this density) / (2 a) due to sway, where a is
    /// the averaging time constant.
    across: f64,
    /// Variance of the velocity of the hand along gravity, m^2/s^2.
    along: f64,
}

impl Sway {
    /// Estimates the sway from the contrasts of all `rests`. `None` if sensor noise explains the contrasts.
    fn of(recording: &Recording<'_>, rests: &[&Rest], sensors: Sensors<'_>, hand: &Hand) -> Option<Self> {
        let inverse = sensors.accelerometer.inverse();
        let density = hand.noise.specific_force.map(|density| density * density);
        let density = inverse * Matrix3::from_diagonal(&density) * inverse.transpose();
        let (mut chi2, mut windows) = (0.0, 0.0);
        let mut sway = Self { across: 0.0, along: 0.0 };
        for rest in rests.iter().filter(|rest| rest.end - rest.first >= LEAST_SAMPLES) {
            let forces: Vec<Vector3<f64>> =
                sensors.along_gyroscope(recording, rest, *sensors.gyroscope.bias(), false).collect();
            let duration_s = rest.end_s - rest.start_s;
            let interval_s = duration_s / (forces.len() - 1).max(1) as f64;
            let averaging_s = hand.averaging_s(rest);
            // The quotient is rounded down. Without the small addition, a rounding error could make an integer quotient
            // smaller by one.
            let count = (duration_s / (ROOM * averaging_s) + 1e-6).max(1.0) as usize;
            let count = count.min(forces.len() / LEAST_SAMPLES);
            let samples = forces.len() / count;
            let contrast = Contrast::of(samples, interval_s / averaging_s);
            let noise = contrast.squares / interval_s;
            // The weighted integral of an oscillation with a short period depends only on the steps of the weights at
            // the ends of the window. With the averaging time constant a, the weights of one exponential mean have the
            // step 1 / a at one end. The weights of the contrast have the step 1 / a - 2 / (duration of the window) at
            // both ends. The variance of an exponential mean is therefore the variance of the contrast, divided by
            // `of_mean`.
            let step = 1.0 - 2.0 * averaging_s / (samples as f64 * interval_s);
            let of_mean = 2.0 * step * step;
            for (k, window) in forces.chunks_exact(samples).take(count).enumerate() {
                let mean = window.iter().sum::<Vector3<f64>>() / samples as f64;
                let up = mean.normalize();
                let rotated: Vector3<f64> = contrast.weights.iter().zip(window).map(|(w, force)| force * *w).sum();
                let across2 = (rotated - up * up.dot(&rotated)).norm_squared();
                // The rotation with the gyroscope is a linear approximation, which changes the magnitude of the force.
                // The magnitudes are therefore computed from the samples before this rotation.
                let force = |i| sensors.accelerometer.correct(Vector3::from(recording.specific_force.at(i)));
                let first = rest.first + k * samples;
                let along: f64 = contrast.weights.iter().enumerate().map(|(i, w)| force(first + i).norm() * w).sum();
                let density_along = up.dot(&(density * up));
                let walk = hand.walk_rad2_per_s * mean.norm_squared() * contrast.squared_tails * interval_s;
                let noise_along = density_along * noise;
                let noise_across = (density.trace() - density_along) / 2.0 * noise + walk;
                chi2 += across2 / noise_across + along * along / noise_along;
                windows += 1.0;
                sway.across += (across2 / 2.0 - noise_across) / of_mean * 2.0 * averaging_s;
                sway.along += (along * along - noise_along) / of_mean * averaging_s * averaging_s;
            }
        }
        // Each window contains two contrasts perpendicular to gravity and one contrast along gravity.
        let contrasts = 3.0 * windows;
        (chi2 > contrasts * significance_limit(contrasts))
            .then(|| Self { across: (sway.across / windows).max(0.0), along: (sway.along / windows).max(0.0) })
    }
}

/// Weights with which the samples of a window are summed to its contrast.
struct Contrast {
    weights: Vec<f64>,
    /// Sum of the squared weights: the variance of the contrast of white noise with the variance 1.
    squares: f64,
    /// Sum over all samples of (sum of the weights from this sample to the end of the window)^2: the variance of the
    /// contrast of a random walk whose increments have the variance 1.
    squared_tails: f64,
}

impl Contrast {
    /// The weights for a window of `samples` samples. `step` is the sampling interval, divided by the time constant of
    /// the exponential weights.
    fn of(samples: usize, step: f64) -> Self {
        let fading: Vec<f64> = (0..samples).map(|i| (-step * i as f64).exp()).collect();
        let total: f64 = fading.iter().sum();
        let at_ends = fading.iter().zip(fading.iter().rev()).map(|(from_start, from_end)| from_start + from_end);
        let weights: Vec<f64> = at_ends.map(|sum| sum / total - 2.0 / samples as f64).collect();
        let tails = weights.iter().rev().scan(0.0, |tail, weight| {
            *tail += weight;
            Some(*tail)
        });
        let squared_tails = tails.map(|tail| tail * tail).sum();
        Self { squares: weights.iter().map(|weight| weight * weight).sum(), squared_tails, weights }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rests::example::{GRAVITY_MPS2, hand, simulated, triads};
    use crate::rests::segment::Segments;
    use crate::rests::tremor::hands;
    use crate::rests::unit_rest::{UnitRest, rests_of};
    use crate::simulate::Unit;
    use crate::simulate::motion::Motion;
    use crate::simulate::tumble::{HandMoves, Tumble};

    /// Accelerations of 0.3 to 3 Hz at the times `time_s`, with the standard deviation `std` on each axis, m/s^2.
    fn sway(time_s: &[f64], std: f64) -> Vec<Vector3<f64>> {
        const WAVES: usize = 30;
        let golden = (5_f64.sqrt() - 1.0) / 2.0;
        let wave = |t: f64, k: usize| {
            let (hz, phase) = (0.3 + 2.7 * (k as f64 * golden).fract(), (k * k) as f64 * golden);
            (std::f64::consts::TAU * (hz * t + phase)).sin()
        };
        let at = |t: &f64, axis: usize| (0..WAVES).map(|k| wave(*t, 1 + axis * WAVES + k)).sum::<f64>();
        let scale = std / (WAVES as f64 / 2.0).sqrt();
        time_s.iter().map(|t| Vector3::from_fn(|axis, _| at(t, axis) * scale)).collect()
    }

    /// Simulates a hand-held run, and adds sway with the standard deviation `std` on each axis, m/s^2. Returns the
    /// model of the hand without the estimated sway, the model with the estimated sway, the rests, and the added sway,
    /// m/s^2.
    fn held(unit: &Unit, std: f64) -> (Hand, Hand, Vec<UnitRest>, Vec<Vector3<f64>>) {
        let moves = HandMoves { tremor_rad: 0.2_f64.to_radians(), hold_s: 3.0, ..HandMoves::default() };
        let motion = Motion::Tumble(Tumble::random(&moves, 2).unwrap());
        let mut run = simulated(&motion, unit, 100.0, 3);
        let added = sway(&run.time_s, std);
        run.specific_force.iter_mut().zip(&added).for_each(|(force, sway)| {
            *force = (Vector3::from(*force) + unit.accelerometer.sensitivity * sway).into();
        });
        let recording = run.recording("run");
        let without = hand(&recording, unit).unwrap();
        let segments = Segments::find(&recording, 1.0).unwrap();
        let [accelerometer, gyroscope] = &triads(unit);
        let mut noise = [segments.noise_density];
        let mut rests = rests_of(&[segments]);
        let used = vec![true; rests.len()];
        let sensors = Sensors { accelerometer, gyroscope };
        let with = hands(&[recording], &mut rests, &used, &mut noise, sensors)[0].unwrap();
        (without, with, rests, added)
    }

    #[test]
    fn the_errors_of_rests_contain_sway() {
        for std in [0.01, 0.03] {
            let (without, hand, rests, added) = held(&Unit::paper(), std);
            let (mut of_ends, mut of_means, mut stated_ends, mut stated_means) = (0.0, 0.0, 0.0, 0.0);
            for UnitRest { rest, .. } in &rests {
                let own = &added[rest.first..rest.end];
                let averaging_s = hand.averaging_s(rest);
                let weight = |i: usize| (-0.01 * i as f64 / averaging_s).exp();
                let total: f64 = (0..own.len()).map(weight).sum();
                let from_start: Vector3<f64> = own.iter().enumerate().map(|(i, v)| v * weight(i)).sum();
                let from_end: Vector3<f64> = own.iter().rev().enumerate().map(|(i, v)| v * weight(i)).sum();
                of_ends += (from_start.norm_squared() + from_end.norm_squared()) / (6.0 * total * total);
                let white = without.tilt_rad2_s / (2.0 * averaging_s) + hand.walk_rad2_per_s * averaging_s / 2.0;
                stated_ends += (hand.variance_rad2(rest) - white) * GRAVITY_MPS2.powi(2);
                of_means += (own.iter().sum::<Vector3<f64>>() / own.len() as f64).norm_squared() / 3.0;
                stated_means += hand.sway_variance(rest.end_s - rest.start_s);
            }
            // The tolerance allows for the random error of a variance that is estimated from 40 rests.
            let (ends, means) = (stated_ends / of_ends, stated_means / of_means);
            assert!((0.75..2.0).contains(&ends) && (0.75..3.0).contains(&means), "{std} m/s^2: {ends} {means}");
        }
    }

    #[test]
    fn without_sway_nothing_changes() {
        let (without, hand, rests, _) = held(&Unit::paper(), 0.0);
        assert_eq!(hand.tilt_rad2_s, without.tilt_rad2_s);
        for UnitRest { rest, .. } in &rests {
            let white = hand.noise.specific_force.map(|density| density * density / (rest.end_s - rest.start_s));
            assert_eq!(rest.specific_force.variance_of_mean, white);
        }
    }

    #[test]
    fn windows_have_samples_if_the_time_constant_is_below_the_sampling_interval() {
        let mut unit = Unit::paper();
        unit.accelerometer.noise_density = 1e-6;
        unit.gyroscope.noise_density = 1e-3;
        let (_, hand, rests, _) = held(&unit, 0.0);
        assert!(rests.iter().all(|rest| hand.averaging_s(&rest.rest) < 0.01));
    }
}
