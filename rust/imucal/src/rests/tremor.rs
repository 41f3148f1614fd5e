//! A unit that a hand holds: what trembles is the unit, not its sensors (model.md (27)).
//!
//! ```text
//! tremor^2 = 1/2 mean (f_i - f)^T (u x (phi_i - phi)) / |f|      phi_i turn of the gyroscope up to sample i
//! density^2 = dt / 70 mean (4th difference)^2
//! ```
//!
//! Accelerometer and gyroscope see the same tremor and have noise of their own, so what their wandering has in common is the
//! tremor's variance. Where it is more than a direction costs that is averaged along the gyroscope, no mean over a rest says
//! where a move begins, and the scatter within a rest is not the sensors' noise: that is left in differences of neighbouring
//! samples, which no hand can follow.

use imucal_core::sensor::Triad;
use nalgebra::{Matrix3, Vector3};
use pulp::{Arch, Simd, WithSimd};

use crate::numerics::fit_report::significance_limit;
use crate::numerics::stats::{median, quantile, random_effects_mean, sample_interval_s};
use crate::numerics::workers::{in_order, threads_for};
use crate::recording::{Recording, Samples};
use crate::rests::noise_density::{NoiseDensity, variance_per_axis};
use crate::rests::rest::Rest;
use crate::rests::unit_rest::{PropagatedMean, UnitRest};

/// Coefficients of the fourth difference and their sum of squares.
const DIFFERENCE: [f64; 5] = [1.0, -4.0, 6.0, -4.0, 1.0];
const SQUARES: f64 = 70.0;
/// Samples further from the end of a rest than this many averaging times have no weight.
const REACH: f64 = 5.0;
/// Share of the rests that a hand may hold without tremor.
const FEW: f64 = 0.1;
/// Averaging times that a rest has room for at least.
const ROOM: f64 = 6.0;

/// How a hand holds the unit in a recording.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hand {
    /// White noise of the sensors, raw units.
    pub(crate) noise: NoiseDensity,
    /// Variance of the turn about each axis from the first to the last sample of a rest, rad^2.
    turn_rad2: f64,
    /// Spectral density of the tilt that the accelerometer's noise makes, rad^2 s.
    tilt_rad2_s: f64,
    /// Of the rate that the gyroscope's noise makes, rad^2 / s.
    walk_rad2_per_s: f64,
}

/// Both sensors, as far as they are known.
#[derive(Clone, Copy)]
pub(crate) struct Sensors<'a> {
    pub(crate) accelerometer: &'a Triad<f64>,
    pub(crate) gyroscope: &'a Triad<f64>,
}

impl<'a> Sensors<'a> {
    /// The force at each sample of a rest, SI units, turned along the gyroscope to the first or last one, outwards from there.
    /// `bias` is that of the gyroscope.
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
    /// The hand that holds the unit in nearly all rests of a recording, if there is one.
    pub(crate) fn of(recording: &Recording<'_>, rests: &[&Rest], sensors: Sensors<'_>) -> Option<Self> {
        let dt_s = sample_interval_s(recording.time_s);
        let noise = NoiseDensity {
            specific_force: white_noise(recording.specific_force, rests) * dt_s.sqrt(),
            angular_rate: white_noise(recording.angular_rate, rests) * dt_s.sqrt(),
        };
        let threads = threads_for(recording.len());
        let wandering = |k: usize| common_wandering(recording, rests[k], sensors, dt_s);
        let mut tremors = in_order(threads, rests.len(), wandering);
        let force = rests.iter().map(|r| sensors.accelerometer.correct(r.specific_force.mean).norm()).sum::<f64>()
            / rests.len() as f64;
        let tilt = variance_per_axis(sensors.accelerometer.inverse(), &noise.specific_force) / (force * force);
        let walk = variance_per_axis(sensors.gyroscope.inverse(), &noise.angular_rate);
        let tremor_rad2 = median(&mut tremors);
        // Noise that a filter has coloured has hardly any fourth differences, and what force and turn have in common by chance is
        // more than it seems to cost; but by chance it is as often negative.
        let everywhere = quantile(&mut tremors, FEW) > 0.0;
        let trembles = tilt * walk > 0.0 && tremor_rad2 > (tilt * walk).sqrt() && everywhere;
        trembles.then_some(Self { noise, turn_rad2: 2.0 * tremor_rad2, tilt_rad2_s: tilt, walk_rad2_per_s: walk })
    }

    /// Standard deviation of the tremor about each axis, rad.
    pub(crate) fn tremor_rad(&self) -> f64 {
        (self.turn_rad2 / 2.0).sqrt()
    }

    /// Time constant of the weights with which the direction at the end of a rest is averaged along the gyroscope, s: that of
    /// the filter that weighs the one noise against the other, or what a short rest has room for.
    fn averaging_s(&self, rest: &Rest) -> f64 {
        (self.tilt_rad2_s / self.walk_rad2_per_s).sqrt().min((rest.end_s - rest.start_s) / ROOM)
    }

    /// Variance of each component of such a direction, rad^2: `r / (2 a) + q a / 2`.
    pub(crate) fn variance_rad2(&self, rest: &Rest) -> f64 {
        let averaging_s = self.averaging_s(rest);
        (self.tilt_rad2_s / averaging_s + self.walk_rad2_per_s * averaging_s) / 2.0
    }

    /// Variance of the turn across gravity that the gyroscope makes of its noise within a rest, less what the directions at its
    /// ends say of it, rad^2. The errors of these two directions are in it no longer: `q (T - 3 a) + r / a`.
    fn turn_variance_rad2(&self, rest: &Rest) -> f64 {
        let averaging_s = self.averaging_s(rest);
        let between_s = rest.end_s - rest.start_s - 3.0 * averaging_s;
        self.walk_rad2_per_s * between_s + self.tilt_rad2_s / averaging_s
    }

    /// The force at the first or last sample of a rest, SI units: samples turned there along the gyroscope, whose bias is
    /// `bias`, the less weight the further they are.
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

    /// Frees the means of a rest of the tremor: its noise is that of the sensors, and the mean rate has no longer in it what
    /// the unit turned from the first to the last sample. The turn about gravity is not known.
    /// What it turned across gravity is the result, rad.
    fn steady(&self, recording: &Recording<'_>, rest: &mut UnitRest, sensors: Sensors<'_>) -> Vector3<f64> {
        let UnitRest { rest: Rest { first, end, start_s, end_s, .. }, bias, .. } = *rest;
        let duration_s = end_s - start_s;
        let at = |at_end| self.force_at(recording, &rest.rest, sensors, bias, at_end).normalize();
        let (before, after) = (at(false), at(true));
        let up = (before + after).normalize();
        let rate = |sample: usize| Vector3::from(recording.angular_rate.at(sample));
        // By trapezoids, as the turn is that from the first to the last sample.
        let seen = (first..end).map(rate).sum::<Vector3<f64>>() - (rate(first) + rate(end - 1)) / 2.0;
        let turn = (after - before).cross(&up);
        let along = up * up.transpose();
        let across = Matrix3::identity() - along;
        let walk = self.walk_rad2_per_s * duration_s;
        let of_rate = (along * (walk + self.turn_rad2) + across * self.turn_variance_rad2(&rest.rest))
            / (duration_s * duration_s);
        let sensitivity = sensors.gyroscope.sensitivity();
        rest.rest.specific_force.variance_of_mean = self.noise.specific_force.map(|d| d * d / duration_s);
        rest.rest.angular_rate.mean = seen / (end - first - 1) as f64 - sensitivity * turn / duration_s;
        rest.rate_covariance = sensitivity * of_rate * sensitivity.transpose();
        rest.rest.angular_rate.variance_of_mean = rest.rate_covariance.diagonal();
        turn
    }
}

/// The hands that hold the unit, one entry for each recording; rests and noise are freed of what they do. Only rests that are
/// `used` say what: a slow turn is no tremor, and what reads like a bias there is none.
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
            .filter(|(rest, _)| rest.recording == index)
            .map(|(rest, &says)| OwnRest { rest, says })
            .collect();
        // Where most rests take no part it is no few slow turns: the bias is another in this recording.
        if 2 * own.iter().filter(|own| own.says).count() < own.len() {
            own.iter_mut().for_each(|own| own.says = true);
        }
        let saying: Vec<&Rest> = own.iter().filter(|own| own.says).map(|own| &own.rest.rest).collect();
        let mut hand = Hand::of(recording, &saying, sensors)?;
        noise[index] = hand.noise;
        own.iter_mut().for_each(|own| own.rest.bias = *sensors.gyroscope.bias());
        // About gravity it turns as far as about the two axes across, of which the errors of the directions are taken off.
        let turned = |own: &mut OwnRest<'_>| {
            let errors = 2.0 * hand.variance_rad2(&own.rest.rest);
            let turn = hand.steady(recording, own.rest, sensors);
            own.says.then_some(turn.norm_squared() / 2.0 - errors)
        };
        let turns: Vec<f64> = own.iter_mut().filter_map(turned).collect();
        hand.turn_rad2 = (turns.iter().sum::<f64>() / turns.len() as f64).max(0.0);
        // The covariances of the rates have that in them.
        own.iter_mut().for_each(|own| {
            hand.steady(recording, own.rest, sensors);
        });
        let bias = biases_of_poses(&mut own);
        own.iter_mut().for_each(|own| {
            own.rest.propagated = Some(PropagatedMean { mean_s: hand.averaging_s(&own.rest.rest), bias });
            hand.steady(recording, own.rest, sensors);
        });
        Some(hand)
    };
    recordings.iter().enumerate().map(of_recording).collect()
}

/// A rest of the recording in question, and whether it says anything about the hand.
struct OwnRest<'a> {
    rest: &'a mut UnitRest,
    says: bool,
}

/// The bias at each rest: the mean of all, and as much of its own as the rests differ beyond noise and chance. A pose may have
/// a bias of its own, but a mean rate that is taken for it takes a part of the turn, too.
/// The mean is the result.
fn biases_of_poses(rests: &mut [OwnRest<'_>]) -> Vector3<f64> {
    Vector3::from_fn(|axis, _| {
        let reading =
            |own: &OwnRest<'_>| (own.rest.rest.angular_rate.mean[axis], own.rest.rate_covariance[(axis, axis)]);
        let (values, variances): (Vec<f64>, Vec<f64>) = rests.iter().filter(|own| own.says).map(reading).unzip();
        let all = random_effects_mean(&values, &variances);
        let spread = values.iter().zip(&variances).map(|(value, variance)| (value - all.mean).powi(2) / variance);
        let free = values.len() as f64 - 1.0;
        let between = if spread.sum::<f64>() > free * significance_limit(free) { all.between } else { 0.0 };
        for own in rests.iter_mut() {
            let (value, variance) = reading(own);
            own.rest.bias[axis] = all.mean + (value - all.mean) * between / (between + variance);
        }
        all.mean
    })
}

/// What force and turn have in common within a rest, rad^2 about each axis: a turn of the body moves gravity in it.
fn common_wandering(recording: &Recording<'_>, rest: &Rest, sensors: Sensors<'_>, dt_s: f64) -> f64 {
    let samples = (rest.end - rest.first) as f64;
    let (mut turn, mut products) = (Vector3::zeros(), Matrix3::zeros());
    for i in rest.first..rest.end {
        turn += (Vector3::from(recording.angular_rate.at(i)) - rest.angular_rate.mean) * dt_s;
        products += (Vector3::from(recording.specific_force.at(i)) - rest.specific_force.mean) * turn.transpose();
    }
    // Raw covariance of force and turn; the mean of the force is that of the rest already.
    let both = sensors.accelerometer.inverse() * (products / samples) * sensors.gyroscope.inverse().transpose();
    let force = sensors.accelerometer.correct(rest.specific_force.mean);
    // f^T (u x phi) = u^T (phi x f)
    let cross = Vector3::new(both[(2, 1)] - both[(1, 2)], both[(0, 2)] - both[(2, 0)], both[(1, 0)] - both[(0, 1)]);
    cross.dot(&force) / (2.0 * force.norm_squared())
}

/// Standard deviation of the white noise of one sample, from fourth differences within the rests.
fn white_noise(rows: Samples<'_>, rests: &[&Rest]) -> Vector3<f64> {
    let squares = |k: usize| {
        let rows = rows.part(rests[k].first..rests[k].end);
        let count = (rows.len() + 1).saturating_sub(DIFFERENCE.len()) as f64;
        (Arch::new().dispatch(SquaredDifferences(&rows)), count)
    };
    let of_rests = in_order(threads_for(rows.len()), rests.len(), squares);
    let (sum, count) =
        of_rests.iter().fold((Vector3::zeros(), 0.0), |(sum, n), (squares, count)| (sum + squares, n + count));
    (sum / (SQUARES * f64::max(count, 1.0))).map(f64::sqrt)
}

/// Sum of the squared fourth differences of some rows, taken with the widest vectors that the processor has.
struct SquaredDifferences<'a>(&'a [[f64; 3]]);

impl WithSimd for SquaredDifferences<'_> {
    type Output = Vector3<f64>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Vector3<f64> {
        // Numbers of eight rows side by side.
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
    use crate::simulate::motion::Motion;
    use crate::simulate::tumble::{HandMoves, Tumble};
    use crate::simulate::{Faults, Program, RandomMoves, Setup, Stand, Temperature, Unit, run};

    fn found(motion: &Motion) -> Option<Hand> {
        let unit = Unit::paper();
        let setup = Setup {
            motion,
            unit: &unit,
            rate_hz: 200.0,
            gravity_mps2: 9.81,
            temperature: &Temperature::constant(25.0),
            faults: Faults::none(),
            added: None,
            seed: 3,
            threads: None,
        };
        let run = run(&setup).unwrap();
        let recording = run.recording("run");
        let segments = crate::rests::segment::Segments::find(&recording, 1.0).unwrap();
        let rests: Vec<&Rest> = segments.rests.iter().collect();
        let sensors = Sensors {
            accelerometer: &Triad::try_new(unit.accelerometer.sensitivity, unit.accelerometer.bias).unwrap(),
            gyroscope: &Triad::try_new(unit.gyroscope.sensitivity, unit.gyroscope.bias).unwrap(),
        };
        Hand::of(&recording, &rests, sensors)
    }

    #[test]
    fn a_stand_is_no_hand() {
        let program = Program::random(&RandomMoves { moves: 10, ..RandomMoves::default() }, 1).unwrap();
        assert!(found(&Motion::Stand { program, stand: Stand::perfect() }).is_none());
    }

    #[test]
    fn a_hand_is_known_by_its_tremor_and_the_noise_stays_that_of_the_sensors() {
        let tremor_rad = 0.05_f64.to_radians();
        let moves = HandMoves { poses: 15, tremor_rad, ..HandMoves::default() };
        let hand = found(&Motion::Tumble(Tumble::random(&moves, 2).unwrap())).unwrap();
        // From the variance of 15 rests about two axes each.
        assert!((hand.tremor_rad() / tremor_rad - 1.0).abs() < 0.2, "{:e}", hand.tremor_rad());
        let unit = Unit::paper();
        for axis in 0..3 {
            let rate = hand.noise.angular_rate[axis] / unit.gyroscope.noise_density;
            let force = hand.noise.specific_force[axis] / unit.accelerometer.noise_density;
            assert!((rate - 1.0).abs() < 0.05 && (force - 1.0).abs() < 0.05, "{rate} {force}");
        }
    }
}
