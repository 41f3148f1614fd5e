//! Detects the tremor of a hand-held unit, and separates it from sensor noise (model.md (27)).
//!
//! ```text
//! tremor^2 = mean of [(f_i - f)^T (u x (phi_i - phi))] / (2 |f|)      phi_i: rotation integrated up to sample i
//! density^2 = (dt / 70) mean of (4th difference)^2
//! ```
//!
//! f_i is the force at sample i, f and phi are the means of f_i and phi_i over the rest, u is the direction of gravity,
//! and dt is the sampling interval.
//!
//! Both sensors measure the same tremor, and their noise is independent. The first expression above is therefore the
//! variance of the tremor, without noise. The unit is classified as hand-held if the median of this variance over the
//! rests exceeds sqrt(r q), and if the variance is positive at nearly all rests. r is the spectral density of the tilt
//! error that accelerometer noise causes, and q is the spectral density of the rate error that gyroscope noise causes.
//! sqrt(r q) is the variance that sensor noise causes in the gravity direction at an end of a rest, if all samples are
//! rotated to the attitude at that end with the gyroscope and averaged. At a hand-held rest, the mean force does not
//! have the direction of gravity at the start of the next move, and the scatter of the samples is mainly tremor. Sensor
//! noise is therefore estimated from fourth differences of consecutive samples, because tremor is too slow to change
//! these differences.

use imucal_core::sensor::Triad;
use nalgebra::{Matrix3, Vector3};
use pulp::{Simd, WithSimd};

use crate::check::repeated_share;
use crate::numerics::fit_report::significance_limit;
use crate::numerics::instructions::Instructions;
use crate::numerics::stats::{median, quantile, random_effects_mean, sample_interval_s};
use crate::numerics::workers::{in_order, threads_for};
use crate::recording::{Recording, Samples};
use crate::rests::colour::colour_factor;
use crate::rests::noise_density::{NoiseDensity, variance_by_axis, variance_per_axis};
use crate::rests::rest::Rest;
use crate::rests::segment::epochs::LONG_REST_S;
use crate::rests::unit_rest::{PropagatedMean, UnitRest};

/// Coefficients of the fourth difference of five consecutive samples.
const DIFFERENCE: [f64; 5] = [1.0, -4.0, 6.0, -4.0, 1.0];
/// Sum of the squares of the coefficients of the fourth difference.
const SQUARES: f64 = 70.0;
/// Duration over which the samples at an end of a rest are averaged with exponential weights, in time constants of the
/// weights. Samples farther from this end are omitted, because the sum of their weights is below 1 %.
const REACH: f64 = 5.0;
/// In a hand-held recording, the estimated variance of the tremor is positive in nearly all rests. The constant is the
/// largest allowed share of rests with an estimate of zero or less (model.md (27)).
const FEW: f64 = 0.1;
/// The gravity direction at an end of a rest is averaged with a time constant of at most (duration of the rest) / ROOM
/// (model.md (27)). Only short rests reach this limit.
pub(super) const ROOM: f64 = 6.0;

/// Model of the tremor of the hand, and of the sensor noise, in a hand-held recording.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hand {
    /// White-noise densities of the sensors, without the tremor of the hand, raw units per sqrt(Hz).
    pub(crate) noise: NoiseDensity,
    /// Variance of the rotation of the hand about each axis from the first to the last sample of a rest, rad^2.
    pub(super) turn_rad2: f64,
    /// Lower bound of `turn_rad2`, rad^2; 0 without sway and without filtered noise. `turn_rad2` is computed from the
    /// gravity directions at both ends of a rest. With sway or filtered noise, the errors of these directions are known
    /// only roughly. The lower bound is then the variance of the rotation that the tremor alone causes.
    pub(super) least_turn_rad2: f64,
    /// Spectral density of the tilt error that accelerometer noise and sway cause, rad^2 s; r in model.md (27).
    pub(super) tilt_rad2_s: f64,
    /// Variance of the velocity of the hand along gravity at a rest, m^2/s^2; 0 without significant sway.
    pub(super) sway_m2_per_s2: f64,
    /// Spectral density of the rate error that gyroscope noise causes, rad^2/s; q in model.md (27).
    pub(super) walk_rad2_per_s: f64,
}

/// Current estimates of the calibration of both sensors.
#[derive(Clone, Copy)]
pub(crate) struct Sensors<'a> {
    pub(crate) accelerometer: &'a Triad<f64>,
    pub(crate) gyroscope: &'a Triad<f64>,
}

impl<'a> Sensors<'a> {
    /// Specific force of each sample of a rest, m/s^2, rotated with the integrated gyroscope rate to the attitude at
    /// one end of the rest: at the last sample if `at_end` is true, otherwise at the first. The iterator starts at that
    /// end of the rest. `bias` is the bias of the gyroscope, raw units.
    pub(crate) fn along_gyroscope(
        self,
        recording: &'a Recording<'a>,
        rest: &'a Rest,
        bias: Vector3<f64>,
        at_end: bool,
    ) -> impl Iterator<Item = Vector3<f64>> + 'a {
        let samples = rest.end - rest.first;
        let interval_s = (rest.end_s - rest.start_s) / (samples - 1).max(1) as f64;
        let step = if at_end { interval_s } else { -interval_s };
        let (mut turn, mut last_rate) = (Vector3::zeros(), None);
        (0..samples).map(move |i| {
            let sample = if at_end { rest.end - 1 - i } else { rest.first + i };
            let rate = self.gyroscope.inverse() * (Vector3::from(recording.angular_rate.at(sample)) - bias);
            turn += last_rate.replace(rate).map_or_else(Vector3::zeros, |last| (last + rate) * (step / 2.0));
            let force = self.accelerometer.correct(Vector3::from(recording.specific_force.at(sample)));
            force - turn.cross(&force)
        })
    }
}

impl Hand {
    /// Estimates the model of the tremor if the unit is hand-held at nearly all rests of a recording. Otherwise `None`.
    pub(crate) fn of(recording: &Recording<'_>, rests: &[&Rest], sensors: Sensors<'_>) -> Option<Self> {
        let dt_s = sample_interval_s(recording.time_s);
        // A row that repeats the previous sample contains no new noise. The fourth differences are therefore taken
        // between distinct samples and not between rows.
        let rows_per_sample = 1.0 / (1.0 - repeated_share(recording));
        let every = rows_per_sample.round() as usize;
        let density = |rows: Samples<'_>| white_noise(rows, rests, every) * (rows_per_sample * dt_s).sqrt();
        let noise = NoiseDensity {
            specific_force: density(recording.specific_force),
            angular_rate: density(recording.angular_rate),
        };
        let threads = threads_for(recording.len());
        let variance = |k: usize| tremor_variance_rad2(recording, rests[k], sensors, dt_s);
        let mut tremors = in_order(threads, rests.len(), variance);
        let force = rests.iter().map(|r| sensors.accelerometer.correct(r.specific_force.mean).norm()).sum::<f64>()
            / rests.len() as f64;
        let tilt = variance_per_axis(sensors.accelerometer.inverse(), &noise.specific_force) / (force * force);
        let walk = variance_per_axis(sensors.gyroscope.inverse(), &noise.angular_rate);
        let tremor_rad2 = median(&mut tremors);
        // Low-pass filtered noise has small fourth differences. The estimated noise densities and the threshold
        // sqrt(tilt x walk) are then too small, and a random correlation of force and rotation may exceed the
        // threshold. A random correlation is negative as often as positive. The estimated variance of the tremor must
        // therefore also be positive at nearly all rests.
        let everywhere = quantile(&mut tremors, FEW) > 0.0;
        let trembles = tilt * walk > 0.0 && tremor_rad2 > (tilt * walk).sqrt() && everywhere;
        let mut hand = trembles.then_some(Self {
            noise,
            turn_rad2: 2.0 * tremor_rad2,
            least_turn_rad2: 0.0,
            tilt_rad2_s: tilt,
            sway_m2_per_s2: 0.0,
            walk_rad2_per_s: walk,
        })?;
        // A low-pass filter reduces the fourth differences, so the accelerometer's noise density is too small. The
        // squared density is multiplied by a factor that corrects for the filter.
        if let Some(factor) = colour_factor(recording, rests, sensors.accelerometer, every, rows_per_sample * dt_s) {
            hand.noise.specific_force *= factor.sqrt();
            hand.tilt_rad2_s *= factor;
            hand.least_turn_rad2 = hand.turn_rad2;
        }
        (tremor_rad2 > (hand.tilt_rad2_s * walk).sqrt()).then_some(hand)
    }

    /// Standard deviation of the rotation angle of the tremor about each axis, rad.
    pub(crate) fn tremor_rad(&self) -> f64 {
        (self.turn_rad2 / 2.0).sqrt()
    }

    /// Averaging time constant of the gravity direction at an end of a rest, s. This direction is a mean over samples
    /// that the gyroscope rotates to the attitude at this end, with exponential weights. The time constant is
    /// `sqrt(r / q)` with r = `tilt_rad2_s` and q = `walk_rad2_per_s`. A Kalman filter that combines both sensors has
    /// this time constant in the steady state. In short rests, the time constant is limited to
    /// (duration of the rest) / [`ROOM`].
    pub(super) fn averaging_s(&self, rest: &Rest) -> f64 {
        (self.tilt_rad2_s / self.walk_rad2_per_s).sqrt().min((rest.end_s - rest.start_s) / ROOM)
    }

    /// Variance of each component of the gravity direction at an end of a rest, rad^2. It is `r / (2 a) + q a / 2`,
    /// with the averaging time constant a, r = `tilt_rad2_s` and q = `walk_rad2_per_s`.
    pub(crate) fn variance_rad2(&self, rest: &Rest) -> f64 {
        let averaging_s = self.averaging_s(rest);
        (self.tilt_rad2_s / averaging_s + self.walk_rad2_per_s * averaging_s) / 2.0
    }

    /// Variance, rad^2, of an angle about an axis perpendicular to gravity: the rotation that the integrated gyroscope
    /// gives over a rest, minus the rotation between the gravity directions at both ends of the rest. The variance is
    /// `q (T - 3 a) + r / a`, where T is the duration of the rest. The symbols a, r and q are defined at
    /// [`variance_rad2`](Self::variance_rad2). Gyroscope noise gives the integrated rotation the variance q T.
    /// Gyroscope noise in the two directions adds q a. Because this noise is correlated with the noise of the
    /// integrated rotation, 4 q a is subtracted.
    fn turn_variance_rad2(&self, rest: &Rest) -> f64 {
        let averaging_s = self.averaging_s(rest);
        let between_s = rest.end_s - rest.start_s - 3.0 * averaging_s;
        self.walk_rad2_per_s * between_s + self.tilt_rad2_s / averaging_s
    }

    /// Computes the specific force at the last sample of a rest if `at_end` is true, otherwise at its first sample,
    /// m/s^2. The force is a weighted mean of the samples, each of which the gyroscope rotates to the attitude at this
    /// end of the rest. The weight of a sample decreases exponentially with its distance in time from this end. `bias`
    /// is the bias of the gyroscope, raw units.
    pub(crate) fn force_at(
        &self,
        recording: &Recording<'_>,
        rest: &Rest,
        sensors: Sensors<'_>,
        bias: Vector3<f64>,
        at_end: bool,
    ) -> Vector3<f64> {
        let samples = rest.end - rest.first;
        let interval_s = (rest.end_s - rest.start_s) / (samples - 1).max(1) as f64;
        let averaging_s = self.averaging_s(rest);
        let count = ((REACH * averaging_s / interval_s).ceil() as usize).clamp(1, samples);
        let fade = (-interval_s / averaging_s).exp();
        let (mut sum, mut weights, mut weight) = (Vector3::zeros(), 0.0, 1.0);
        for force in sensors.along_gyroscope(recording, rest, bias, at_end).take(count) {
            sum += force * weight;
            weights += weight;
            weight *= fade;
        }
        sum / weights
    }

    /// Corrects the means of a rest for the tremor. The variance of the mean force is set to the variance that sensor
    /// noise and sway cause. The rotation of the hand from the first to the last sample, divided by the duration of the
    /// rest, is subtracted from the mean rate. The component of the rotation about gravity is unknown and not
    /// subtracted. Returns the subtracted rotation, rad.
    fn remove_tremor(&self, recording: &Recording<'_>, rest: &mut UnitRest, sensors: Sensors<'_>) -> Vector3<f64> {
        let UnitRest { rest: Rest { first, end, start_s, end_s, .. }, bias, .. } = *rest;
        let duration_s = end_s - start_s;
        let at = |at_end| self.force_at(recording, &rest.rest, sensors, bias, at_end).normalize();
        let (before, after) = (at(false), at(true));
        let up = (before + after).normalize();
        let rate = |sample: usize| Vector3::from(recording.angular_rate.at(sample));
        // The rotation extends from the first to the last sample, so the rates are summed by the trapezoidal rule.
        let seen = (first..end).map(rate).sum::<Vector3<f64>>() - (rate(first) + rate(end - 1)) / 2.0;
        let turn = (after - before).cross(&up);
        let along = up * up.transpose();
        let across = Matrix3::identity() - along;
        let walk = self.walk_rad2_per_s * duration_s;
        let of_rate = (along * (walk + self.turn_rad2) + across * self.turn_variance_rad2(&rest.rest))
            / (duration_s * duration_s);
        let sensitivity = sensors.gyroscope.sensitivity();
        let sway = Vector3::repeat(self.sway_variance(duration_s).sqrt());
        rest.rest.specific_force.variance_of_mean = self.noise.specific_force.map(|d| d * d / duration_s)
            + variance_by_axis(sensors.accelerometer.sensitivity(), &sway);
        rest.rest.angular_rate.mean = seen / (end - first - 1) as f64 - sensitivity * turn / duration_s;
        rest.rate_covariance = sensitivity * of_rate * sensitivity.transpose();
        rest.rest.angular_rate.variance_of_mean = rest.rate_covariance.diagonal();
        turn
    }
}

/// Estimates a model of the tremor of the hand for each recording, and corrects the rests and noise densities for the
/// tremor. Only rests for which `used` is true contribute to the model. The other rests may contain a slow rotation. A
/// slow rotation is not tremor, and the mean rate of such a rest is not the gyroscope bias.
pub(crate) fn hands(
    recordings: &[Recording<'_>],
    rests: &mut [UnitRest],
    used: &[bool],
    noise: &mut [NoiseDensity],
    sensors: Sensors<'_>,
) -> Vec<Option<Hand>> {
    let of_recording = |(index, recording): (usize, &Recording<'_>)| {
        let mut own: Vec<OwnRest<'_>> = rests
            .iter_mut()
            .zip(used)
            // Rests of several minutes are omitted. Nobody holds a unit still for so long, so these rests are not
            // hand-held. In such a long rest, a bias drift would be mistaken for tremor.
            .filter(|(rest, _)| rest.recording == index && rest.rest.end_s - rest.rest.start_s <= LONG_REST_S)
            .map(|(rest, &contributes)| OwnRest { rest, contributes })
            .collect();
        if own.is_empty() {
            return None;
        }
        // Slow rotations occur at only a few rests. If `used` excludes most rests of a recording, the cause is not a
        // slow rotation but a bias that differs from the biases in the other recordings. All rests then contribute.
        if 2 * own.iter().filter(|own| own.contributes).count() < own.len() {
            own.iter_mut().for_each(|own| own.contributes = true);
        }
        let contributing: Vec<&Rest> = own.iter().filter(|own| own.contributes).map(|own| &own.rest.rest).collect();
        let mut hand = Hand::of(recording, &contributing, sensors)?;
        hand.add_sway(recording, &contributing, sensors);
        noise[index] = hand.noise;
        own.iter_mut().for_each(|own| own.rest.bias = *sensors.gyroscope.bias());
        // `turn` is the rotation of the hand between both ends of the rest, about the two axes perpendicular to
        // gravity. The variance of the rotation about one of these axes is estimated as |`turn`|^2 / 2. This estimate
        // includes the errors of the gravity directions at both ends, so their variance is subtracted. The rotation
        // about gravity is unknown. It is assumed to have the same variance.
        let turned = |own: &mut OwnRest<'_>| {
            let errors = 2.0 * hand.variance_rad2(&own.rest.rest);
            let turn = hand.remove_tremor(recording, own.rest, sensors);
            own.contributes.then_some(turn.norm_squared() / 2.0 - errors)
        };
        let turns: Vec<f64> = own.iter_mut().filter_map(turned).collect();
        hand.turn_rad2 = (turns.iter().sum::<f64>() / turns.len() as f64).max(hand.least_turn_rad2);
        // The covariances of the mean rates depend on `turn_rad2`, the variance of the rotation, which is known only
        // now. The tremor is therefore removed a second time.
        own.iter_mut().for_each(|own| {
            hand.remove_tremor(recording, own.rest, sensors);
        });
        let (bias, shrunk) = biases_of_poses(&mut own);
        own.iter_mut().zip(shrunk).for_each(|(own, shrunk)| {
            own.rest.propagated = Some(PropagatedMean { mean_s: hand.averaging_s(&own.rest.rest), bias, shrunk });
            hand.remove_tremor(recording, own.rest, sensors);
        });
        Some(hand)
    };
    recordings.iter().enumerate().map(of_recording).collect()
}

/// A rest of the recording whose tremor is being estimated.
struct OwnRest<'a> {
    /// The rest, which is corrected in place.
    rest: &'a mut UnitRest,
    /// Whether the model of the tremor is estimated from this rest.
    contributes: bool,
}

/// Estimates the gyroscope bias at each rest. The bias may depend on the pose, but the mean rate of a rest also
/// contains rotation of the hand. The mean rate of each rest is therefore shrunk towards the mean over all rests by the
/// share v / (v + b). v is the variance of the error of this mean rate. b is the variance of the true bias over the
/// rests. The variance b is estimated from the scatter of the mean rates. It is zero if the errors of the mean rates
/// explain the scatter. Returns the mean bias of all rests, raw units, and the share of each rest.
fn biases_of_poses(rests: &mut [OwnRest<'_>]) -> (Vector3<f64>, Vec<Vector3<f64>>) {
    let mut shrunk = vec![Vector3::repeat(1.0); rests.len()];
    let bias = Vector3::from_fn(|axis, _| {
        let reading =
            |own: &OwnRest<'_>| (own.rest.rest.angular_rate.mean[axis], own.rest.rate_covariance[(axis, axis)]);
        let (values, variances): (Vec<f64>, Vec<f64>) = rests.iter().filter(|own| own.contributes).map(reading).unzip();
        let all = random_effects_mean(&values, &variances);
        let spread = values.iter().zip(&variances).map(|(value, variance)| (value - all.mean).powi(2) / variance);
        let free = values.len() as f64 - 1.0;
        let between = if spread.sum::<f64>() > free * significance_limit(free) { all.between } else { 0.0 };
        for (own, shrunk) in rests.iter_mut().zip(&mut shrunk) {
            let (value, variance) = reading(own);
            own.rest.bias[axis] = all.mean + (value - all.mean) * between / (between + variance);
            shrunk[axis] = variance / (between + variance);
        }
        all.mean
    });
    (bias, shrunk)
}

/// Variance of the tremor about each axis at a rest, rad^2. This variance equals the covariance between the tilt that
/// the accelerometer measures and the integrated rate of the gyroscope. Both signals contain the tremor, because a
/// rotation of the body changes the gravity direction in the body frame.
fn tremor_variance_rad2(recording: &Recording<'_>, rest: &Rest, sensors: Sensors<'_>, dt_s: f64) -> f64 {
    let samples = (rest.end - rest.first) as f64;
    let (mut turn, mut products) = (Vector3::zeros(), Matrix3::zeros());
    for i in rest.first..rest.end {
        turn += (Vector3::from(recording.angular_rate.at(i)) - rest.angular_rate.mean) * dt_s;
        products += (Vector3::from(recording.specific_force.at(i)) - rest.specific_force.mean) * turn.transpose();
    }
    // Covariance matrix of force and rotation. The mean force of the rest was subtracted from the force of each sample.
    let both = sensors.accelerometer.inverse() * (products / samples) * sensors.gyroscope.inverse().transpose();
    let force = sensors.accelerometer.correct(rest.specific_force.mean);
    // `cross` is the mean of phi x f, where f is the force and phi is the rotation `turn`. With the direction of
    // gravity u, the product in model.md (27) is f^T (u x phi) = u^T (phi x f).
    let cross = Vector3::new(both[(2, 1)] - both[(1, 2)], both[(0, 2)] - both[(2, 0)], both[(1, 0)] - both[(0, 1)]);
    cross.dot(&force) / (2.0 * force.norm_squared())
}

/// Standard deviation of the white noise of one sample on each axis, raw units. It is computed from fourth differences
/// of consecutive samples within the rests. Each sample occurs in `every` consecutive rows.
fn white_noise(rows: Samples<'_>, rests: &[&Rest], every: usize) -> Vector3<f64> {
    let squares = |k: usize| {
        let mut rows = rows.part(rests[k].first..rests[k].end);
        if every > 1 {
            rows = rows.iter().step_by(every).copied().collect();
        }
        let count = (rows.len() + 1).saturating_sub(DIFFERENCE.len()) as f64;
        (Instructions::Best.run(SquaredDifferences(&rows)), count)
    };
    let of_rests = in_order(threads_for(rows.len()), rests.len(), squares);
    let (sum, count) =
        of_rests.iter().fold((Vector3::zeros(), 0.0), |(sum, n), (squares, count)| (sum + squares, n + count));
    (sum / (SQUARES * f64::max(count, 1.0))).map(f64::sqrt)
}

/// Computation of the sum of the squared fourth differences of consecutive samples (rows of three axes), for each axis.
/// The computation uses the widest vector instructions of the processor.
struct SquaredDifferences<'a>(&'a [[f64; 3]]);

impl WithSimd for SquaredDifferences<'_> {
    type Output = Vector3<f64>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Vector3<f64> {
        // Eight rows of three values are processed together.
        const LANES: usize = 24;
        let count = 3 * (self.0.len() + 1).saturating_sub(DIFFERENCE.len());
        let numbers = self.0.as_flattened();
        let parts: [_; DIFFERENCE.len()] =
            std::array::from_fn(|i| numbers.get(3 * i..3 * i + count).unwrap_or(&[]).as_chunks::<LANES>());
        let mut squares = [0.0; LANES];
        let mut add = |of: [&[f64]; DIFFERENCE.len()]| {
            for (lane, square) in squares.iter_mut().enumerate().take(of[0].len()) {
                let difference: f64 = (0..DIFFERENCE.len()).map(|i| DIFFERENCE[i] * of[i][lane]).sum();
                *square += difference * difference;
            }
        };
        (0..parts[0].0.len()).for_each(|k| add(parts.map(|(full, _)| full[k].as_slice())));
        add(parts.map(|(_, rest)| rest));
        squares.as_chunks::<3>().0.iter().map(|row| Vector3::from(*row)).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rests::example::{self, simulated};
    use crate::simulate::motion::Motion;
    use crate::simulate::tumble::{HandMoves, Tumble};
    use crate::simulate::{Program, RandomMoves, Stand, Unit};

    /// Simulates a recording at 200 Hz, in which each sample occurs in `held` rows, and estimates the model of the
    /// tremor from it.
    fn found(motion: &Motion, held: usize) -> Option<Hand> {
        let unit = Unit::paper();
        let run = simulated(motion, &unit, 200.0, 3);
        let repeated = |rows: &[[f64; 3]]| rows.iter().flat_map(|row| vec![*row; held]).collect::<Vec<_>>();
        let (force, rate) = (repeated(&run.specific_force), repeated(&run.angular_rate));
        let time_s: Vec<f64> = (0..force.len()).map(|row| row as f64 / (200.0 * held as f64)).collect();
        example::hand(&Recording::try_new("run", &time_s, &force, &rate).unwrap(), &unit)
    }

    #[test]
    fn a_stand_is_no_hand() {
        let program = Program::random(&RandomMoves { moves: 10, ..RandomMoves::default() }, 1).unwrap();
        assert!(found(&Motion::Stand { program, stand: Stand::perfect() }, 1).is_none());
    }

    #[test]
    fn a_hand_is_known_by_its_tremor_and_the_noise_is_that_of_the_sensors_with_held_samples_too() {
        let tremor_rad = 0.05_f64.to_radians();
        let moves = HandMoves { poses: 15, tremor_rad, ..HandMoves::default() };
        let motion = Motion::Tumble(Tumble::random(&moves, 2).unwrap());
        for held in [1, 3] {
            let hand = found(&motion, held).unwrap();
            // The tolerance allows for the random error of a variance that is estimated from 15 rests and two axes.
            assert!((hand.tremor_rad() / tremor_rad - 1.0).abs() < 0.2, "{:e}", hand.tremor_rad());
            let unit = Unit::paper();
            for axis in 0..3 {
                let rate = hand.noise.angular_rate[axis] / unit.gyroscope.noise_density;
                let force = hand.noise.specific_force[axis] / unit.accelerometer.noise_density;
                assert!((rate - 1.0).abs() < 0.05 && (force - 1.0).abs() < 0.05, "{rate} {force}");
            }
        }
    }
}
