//! Detects the rests in a recording (model.md (11)).
//!
//! For each window of half a second, a statistic is computed: variance / noise variance, averaged over the six
//! channels. A window is at rest if its statistic is below a threshold. At 400 Hz and above, the samples are first
//! averaged over 3.5 to 5 ms. The user specifies neither an initial rest nor a threshold. The noise variance is
//! estimated from the quietest windows. The threshold is chosen from the widest range of thresholds that give the same
//! number of rests. The sum of squared residuals of a calibration is not used for this choice, because this sum is
//! always smaller if there are fewer rests. Hand-held rests after a rest on a table have their own noise variance and
//! threshold.

mod blocks;
mod edges;
pub(crate) mod epochs;
mod levels;
mod steadiness;
mod threshold;

use std::ops::Range;

use imucal_core::STANDARD_GRAVITY_MPS2;
use imucal_core::calibration::Calibration;
use imucal_core::sensor::Triad;
use nalgebra::{Vector3, Vector6};

use crate::error::Error;
use crate::finding::Finding;
use crate::numerics::stats::sample_interval_s;
use crate::recording::{RawUnit, Recording, Samples};
use crate::rests::noise_density::{NoiseDensity, variance_by_axis};
use crate::rests::rest::{Rest, RestMean, UNSTEADY};
use crate::rests::rounded::{Roundings, noise_below_lsb, of_channel, of_rounded};
use crate::rounding::{Rounding, step};
use blocks::{Block, Blocks, mean, sum_blocks};
use edges::{calm, onset, settle, trim};
use epochs::{LONG_REST_S, cut, joined};
use levels::rests_of_all_levels;
use steadiness::{Steadiness, Stretch, gravity_wanders};
use threshold::window_statistic;

/// Length of a block of consecutive samples, s. The ends of rests are determined with this time resolution.
const BLOCK_S: f64 = 0.05;
/// Number of blocks in a window, which is therefore 0.5 s long.
const WINDOW_BLOCKS: usize = 10;
/// Threshold of the window statistic (variance / noise variance), with the range of thresholds from which it was
/// chosen.
#[derive(Clone, Debug)]
pub struct Threshold {
    /// The threshold. A window is at rest if its statistic (variance / noise variance, averaged over the channels) is
    /// below this value. If hand-held rests follow a rest on a table, their threshold is a multiple of the variance of
    /// hand-held rests. This field then contains their threshold, converted approximately to a multiple of the noise
    /// variance.
    pub factor: f64,
    /// Lower end of the range from which the threshold was chosen. All thresholds in this range give the same number n
    /// of rests. Of all ranges with a constant n, the chosen range has approximately the largest product ln(upper end /
    /// lower end) x ln n.
    pub stable_from: f64,
    /// Upper end of the range from which the threshold was chosen.
    pub stable_to: f64,
    /// Noise floor: standard deviation of the noise of one sample, raw units, in the order gyroscope x, y, z,
    /// accelerometer x, y, z.
    pub noise_floor: Vector6<f64>,
    /// Length of the windows in which the statistic is computed, s.
    pub window_s: f64,
}

/// Result of the rest detection for one recording.
#[derive(Clone, Debug)]
pub struct Segments {
    /// Rests in chronological order.
    pub rests: Vec<Rest>,
    /// The epochs of each rest (model.md (41)). A long rest is divided into epochs, each with its own mean. The list is
    /// empty for a rest that is so short that one mean describes it.
    pub epochs: Vec<Vec<Rest>>,
    /// Intervals at rest that are shorter than the minimum duration of a rest, as index ranges of samples.
    pub too_short: Vec<Range<usize>>,
    /// The chosen threshold, and the range of thresholds from which it was chosen.
    pub threshold: Threshold,
    /// White-noise densities estimated from the rests. If the noise of a channel is below the quantisation step, the
    /// density is valid during moves: it then contains the noise before rounding and the white noise that rounding
    /// adds.
    pub noise_density: NoiseDensity,
    /// For each channel, the quantisation step, and the statistics of the rounding errors at a rest with usual noise
    /// (the noise that most rests have in common). The order is gyroscope x, y, z, accelerometer x, y, z.
    pub rounding: [Rounding; 6],
}

/// Default of the minimum duration of a rest, s. Users hold the unit in a pose for more than this duration, and pauses
/// within a move are shorter.
pub const MIN_REST_S: f64 = 1.0;
/// Maximum accepted value of `min_rest_s`, s. A larger value is refused, because it probably has the wrong unit.
const LONGEST_MIN_REST_S: f64 = 3600.0;

impl Segments {
    /// Finds all rests of at least `min_rest_s` seconds. Both sensors are used. If the recording has only one sensor,
    /// this sensor is used.
    ///
    /// # Errors
    /// * [`Error::Input`] if `min_rest_s` is not between 0 and 3600 s.
    /// * [`Error::NotEnoughMotion`] if there is no rest.
    pub fn find(recording: &Recording<'_>, min_rest_s: f64) -> Result<Self, Error> {
        if !(min_rest_s > 0.0 && min_rest_s <= LONGEST_MIN_REST_S) {
            return Err(Error::Input(format!("min_rest_s = {min_rest_s}: give a duration in s, such as 1")));
        }
        let sensors = [recording.angular_rate, recording.specific_force].map(|rows| !rows.is_absent());
        let recording = &doubled(recording);
        let dt_s = sample_interval_s(recording.time_s);
        let block_samples = ((BLOCK_S / dt_s).round() as usize).max(1);
        let sums = sum_blocks(recording, block_samples);
        let Blocks { samples: blocks, variances, averaged, steps } = &sums;
        let averaged = *averaged as f64;
        let min_blocks = ((min_rest_s / (block_samples as f64 * dt_s)).round() as usize).max(2);
        if blocks.len() < WINDOW_BLOCKS.max(min_blocks) {
            return Err(no_rest(recording, min_rest_s));
        }
        let step_of = |channel: usize| {
            let (rows, axis) = of_channel(recording, channel);
            step::step_of(rows, axis)
        };
        let steps = steps / averaged.sqrt();
        let (statistic, floor, coarse) = window_statistic(variances, &steps, step_of);
        let (threshold, still) = rests_of_all_levels(variances, &steps, &statistic, &floor, &coarse, min_blocks);
        // Without an accelerometer, a change of the gravity direction cannot be detected. An infinite magnitude of
        // gravity disables the tilt check.
        let gravity = if sensors[1] { gravity_size(recording, blocks) } else { f64::INFINITY };
        let block_s = block_samples as f64 * dt_s;
        // Number of blocks in `LONG_REST_S`, but at least the number of blocks in a window. The lower limit is needed
        // at very low sampling rates, where a block may be longer than `LONG_REST_S`.
        let long_blocks = ((LONG_REST_S / block_s).round() as usize).max(WINDOW_BLOCKS);
        let still: Vec<_> = still
            .iter()
            .map(|range| settle(calm(trim(range, statistic.len()), &statistic), blocks, &coarse))
            .filter(|range| !range.is_empty() && !gravity_wanders(&blocks[range.clone()], gravity, long_blocks))
            .collect();
        let still = joined(recording, still, block_samples, block_s, &(floor * averaged).map(f64::sqrt));
        let (long, short): (Vec<_>, Vec<_>) =
            still.iter().cloned().zip(around(&still, blocks.len())).partition(|(range, _)| range.len() >= min_blocks);
        if long.is_empty() {
            return Err(no_rest(recording, min_rest_s));
        }
        let stretch = |range: &Range<usize>| Stretch::of(range, blocks, &statistic, &coarse);
        let mut stretches: Vec<Stretch> = long.iter().map(|(range, _)| stretch(range)).collect();
        let samples = |r: Range<usize>| r.start * block_samples..r.end * block_samples;
        let degc = |range: Range<usize>| mean_temperature(&recording.temperature_degc?[samples(range)]);
        let epochs_of = |rest: &Stretch| -> Vec<Stretch> {
            // Only steady rests are divided into epochs. On a vibrating support or in a hand, the epochs would not have
            // the same pose.
            if rest.is_steady() { cut(&rest.blocks, block_s, degc).iter().map(stretch).collect() } else { Vec::new() }
        };
        let epochs: Vec<Vec<Stretch>> = stretches.iter().map(epochs_of).collect();
        let settled = Steadiness::of(described(&stretches, &epochs));
        // Tremor masks the exact ends of hand-held rests. Therefore only the ends of steady rests are refined.
        for ((rest, epochs), (_, within)) in stretches.iter_mut().zip(&epochs).zip(&long) {
            if settled.unsteadiness_of(rest, epochs) < UNSTEADY {
                let range = onset(rest.blocks.clone(), within, blocks, &coarse);
                if range != rest.blocks {
                    *rest = stretch(&range);
                }
            }
        }
        let epochs: Vec<Vec<Stretch>> = stretches.iter().map(epochs_of).collect();
        let steadiness = Steadiness::of(described(&stretches, &epochs));
        let of = |stretch: &Stretch, epochs: &[Stretch]| Rest {
            unsteadiness: steadiness.unsteadiness_of(stretch, epochs),
            ..rest(recording, stretch, block_samples, steadiness.colour(stretch))
        };
        let mut rests: Vec<Rest> = stretches.iter().zip(&epochs).map(|(whole, epochs)| of(whole, epochs)).collect();
        let each = |epochs: &Vec<Stretch>| epochs.iter().map(|epoch| of(epoch, &[])).collect();
        let mut rests_of_epochs: Vec<Vec<Rest>> = epochs.iter().map(each).collect();
        let colour = &steadiness.steady_colour;
        let colour = &of_rounded(colour, &coarse);
        let rested: Vec<&Rest> = described(&rests, &rests_of_epochs).collect();
        let roundings = Roundings::of(recording, &rested, &coarse, colour);
        let rounding = roundings.common();
        let mut index = 0;
        for (rest, epochs) in rests.iter_mut().zip(&mut rests_of_epochs) {
            // A rest that is divided into epochs has the rounding statistics of its first epoch.
            roundings.set(recording, rest, index);
            epochs.iter_mut().enumerate().for_each(|(k, epoch)| roundings.set(recording, epoch, index + k));
            index += epochs.len().max(1);
        }
        let sample_variance = floor * averaged;
        let mut variance = steadiness.noise_variance(described(&stretches, &epochs)).unwrap_or(sample_variance);
        // At rest, the scatter of rounded samples depends on where the mean lies between two multiples of the step. In
        // moves, the samples pass through many multiples, so rounding adds the variance step^2 / 12 to the noise. The
        // variance in moves is used for channels whose rounding errors are not negligible.
        for channel in (0..6).filter(|&channel| rounding[channel].is_coarse()) {
            variance[channel] = rounding[channel].sweeping_variance(colour[channel]);
        }
        let density = variance.map(|variance| (variance * dt_s).sqrt());
        let mut found = Self {
            noise_density: NoiseDensity {
                angular_rate: density.fixed_rows::<3>(0).into(),
                specific_force: density.fixed_rows::<3>(3).into(),
            },
            too_short: short.into_iter().map(|(range, _)| samples(range)).collect(),
            threshold: Threshold {
                factor: threshold.factor,
                stable_from: threshold.from,
                stable_to: threshold.to,
                noise_floor: sample_variance.map(f64::sqrt),
                window_s: (WINDOW_BLOCKS * block_samples) as f64 * dt_s,
            },
            rests,
            epochs: rests_of_epochs,
            rounding,
        };
        found.blank(sensors);
        Ok(found)
    }

    /// Mutable references to all rests and to all epochs of rests, through which their means are changed.
    fn means(&mut self) -> impl Iterator<Item = &mut Rest> {
        self.rests.iter_mut().chain(self.epochs.iter_mut().flatten())
    }

    /// Sets all results for a missing sensor to NaN, and the rounding errors of its channels to zero. The two values of
    /// `is_there` state whether the gyroscope and the accelerometer were recorded.
    fn blank(&mut self, is_there: [bool; 2]) {
        let none = Vector3::repeat(f64::NAN);
        let of_none = RestMean { mean: none, variance_of_mean: none, rounding: Default::default() };
        for channel in (0..6).filter(|channel| !is_there[channel / 3]) {
            self.threshold.noise_floor[channel] = f64::NAN;
            self.rounding[channel] = Rounding::default();
        }
        if !is_there[0] {
            self.noise_density.angular_rate = none;
            self.means().for_each(|rest| rest.angular_rate = of_none);
        }
        if !is_there[1] {
            self.noise_density.specific_force = none;
            self.means().for_each(|rest| rest.specific_force = of_none);
        }
    }
}

/// The recording with the channels of the missing sensor replaced by copies of the channels of the existing sensor. The
/// window statistic is a mean over the channels, so with these copies it equals the statistic of the existing sensor
/// alone.
fn doubled<'a>(recording: &Recording<'a>) -> Recording<'a> {
    let (force, rate) = (recording.specific_force, recording.angular_rate);
    Recording {
        specific_force: if force.is_absent() { rate } else { force },
        angular_rate: if rate.is_absent() { force } else { rate },
        ..*recording
    }
}

impl Threshold {
    /// Describes the threshold in one sentence for the user.
    pub fn explain(&self, rests: usize) -> String {
        format!(
            "a {:.2} s window is at rest if its variance is below {:.1} times the noise variance; every threshold from {:.1} \
             to {:.1} gives {rests} rests, the widest range with a constant number of rests (widths are weighted \
             by the logarithm of this number)",
            self.window_s, self.factor, self.stable_from, self.stable_to
        )
    }
}

impl Segments {
    /// Reports axes whose noise is far below the step of the converter, so that the rounding error of the mean over a
    /// rest exceeds the noise of this mean.
    pub fn noise_below_lsb(&self, recording: &Recording<'_>) -> Option<Finding> {
        noise_below_lsb(recording, &self.rests, &self.rounding)
    }

    /// Index ranges of the samples of each rest.
    pub(crate) fn ranges(&self) -> Vec<Range<usize>> {
        self.rests.iter().map(|rest| rest.first..rest.end).collect()
    }

    /// Replaces the means and the noise of the raw samples by the means and the noise of corrected samples, in SI
    /// units. `corrected` contains the samples after correction with `calibration`.
    pub(crate) fn correct(&mut self, corrected: &Recording<'_>, calibration: &Calibration<f64>) {
        let mean = |rows: Samples<'_>| rows.iter().map(Vector3::from).sum::<Vector3<f64>>() / rows.len() as f64;
        let turned = |triad: &Triad<f64>, std: Vector3<f64>| variance_by_axis(triad.inverse(), &std);
        for rest in &mut self.rests {
            let range = rest.first..rest.end;
            rest.specific_force.mean = mean(corrected.specific_force.slice(range.clone()));
            rest.angular_rate.mean = mean(corrected.angular_rate.slice(range));
            for (mean, triad) in [
                (&mut rest.specific_force, &calibration.accelerometer),
                (&mut rest.angular_rate, &calibration.gyroscope),
            ] {
                mean.variance_of_mean = turned(triad, mean.whole_variance().map(f64::sqrt));
                mean.rounding = Default::default();
            }
        }
        let noise = &mut self.noise_density;
        noise.specific_force = turned(&calibration.accelerometer, noise.specific_force).map(f64::sqrt);
        noise.angular_rate = turned(&calibration.gyroscope, noise.angular_rate).map(f64::sqrt);
    }
}

/// The intervals that one mean describes: the epochs (parts) of each long rest, and each rest that is not divided into
/// epochs.
fn described<'a, T>(rests: &'a [T], epochs: &'a [Vec<T>]) -> impl Iterator<Item = &'a T> {
    let of = |(rest, epochs): (&'a T, &'a Vec<T>)| if epochs.is_empty() { std::slice::from_ref(rest) } else { epochs };
    rests.iter().zip(epochs).flat_map(of)
}

/// Mean of the temperatures that are finite, degC; `None` if no temperature is finite.
fn mean_temperature(degc: &[f64]) -> Option<f64> {
    let known = || degc.iter().filter(|degc| degc.is_finite());
    let count = known().count();
    (count > 0).then(|| known().sum::<f64>() / count as f64)
}

/// For each interval at rest: the range of blocks from the end of the previous interval to the start of the next
/// interval.
fn around(still: &[Range<usize>], blocks: usize) -> impl Iterator<Item = Range<usize>> + '_ {
    let before = std::iter::once(0).chain(still.iter().map(|range| range.end));
    let after = still.iter().skip(1).map(|range| range.start).chain([blocks]);
    before.zip(after).map(|(start, end)| start..end)
}

/// Magnitude of gravity in raw units. For raw counts, it is estimated from the range of the mean forces of half-second
/// windows, as the larger of two norms: the norm of half this range, and the norm of the midpoint of this range. The
/// estimate is more often too large than too small, even if the counts have an offset. A value that is too large only
/// makes the check for a tilt less strict.
fn gravity_size(recording: &Recording<'_>, blocks: &[Block]) -> f64 {
    if recording.accel_unit == RawUnit::Si {
        return STANDARD_GRAVITY_MPS2;
    }
    let (mut low, mut high) = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
    for window in blocks.chunks_exact(WINDOW_BLOCKS) {
        let force: Vector3<f64> = mean(window).fixed_rows::<3>(3).into();
        low = low.inf(&force);
        high = high.sup(&force);
    }
    ((high - low) / 2.0).norm().max(((high + low) / 2.0).norm())
}

fn no_rest(recording: &Recording<'_>, min_rest_s: f64) -> Error {
    Error::NotEnoughMotion(format!(
        "{}: no rest of {min_rest_s} s or more in {} samples: hold the unit still in each pose for 2 s or longer, \
         or pass a shorter min_rest_s",
        recording.name,
        recording.len()
    ))
}

fn rest(recording: &Recording<'_>, stretch: &Stretch, block_samples: usize, colour: &Vector6<f64>) -> Rest {
    let sum = &stretch.whole;
    let first = stretch.blocks.start * block_samples;
    let end = first + sum.count();
    let mean = sum.mean();
    let variance_of_mean = sum.variance().component_mul(colour) / sum.count() as f64;
    let triad = |offset: usize| RestMean {
        mean: mean.fixed_rows::<3>(offset).into_owned(),
        variance_of_mean: variance_of_mean.fixed_rows::<3>(offset).into_owned(),
        rounding: Default::default(),
    };
    Rest {
        first,
        end,
        start_s: recording.time_s[first],
        end_s: recording.time_s[end - 1],
        unsteadiness: 1.0,
        angular_rate: triad(0),
        specific_force: triad(3),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::{Program, RandomMoves, Simulation, Unit, simulate};

    fn run(rate_hz: f64, noise: f64) -> Simulation {
        let program = Program::random(&RandomMoves { moves: 8, ..RandomMoves::default() }, 3).unwrap();
        let mut unit = Unit::paper();
        for sensor in [&mut unit.accelerometer, &mut unit.gyroscope] {
            sensor.noise_density *= noise;
            sensor.converter = None;
        }
        simulate(&program, &unit, rate_hz, 9.81, 5).unwrap()
    }

    #[test]
    fn finds_the_true_rests_at_any_rate_and_noise() {
        for (rate_hz, noise) in [(25.0, 1.0), (100.0, 0.1), (100.0, 10.0), (1000.0, 1.0), (1000.0, 0.0)] {
            let run = run(rate_hz, noise);
            let found = Segments::find(&run.recording("run"), 1.0).unwrap();
            assert_eq!(found.rests.len(), run.rests.len(), "{rate_hz} Hz, noise x {noise}");
            for (rest, (start_s, end_s)) in found.rests.iter().zip(&run.rests) {
                // The motors accelerate and decelerate smoothly, so the detected ends of a rest deviate from the true
                // ends.
                assert!(rest.start_s > start_s - 0.25 && rest.start_s < start_s + 0.4, "{} {start_s}", rest.start_s);
                assert!(rest.end_s < end_s + 0.25 && rest.end_s > end_s - 0.4, "{} {end_s}", rest.end_s);
            }
        }
    }

    /// If a part of a move's rotation is assigned to a rest, the integrated rotation of the move lacks this part. All
    /// estimated scales of the gyroscope are then too small.
    #[test]
    fn the_slow_beginning_of_a_move_that_drowns_in_noise_is_the_moves() {
        for (rate_hz, noise) in [(25.0, 3.0), (128.0, 1.0), (128.0, 3.0), (128.0, 10.0), (1000.0, 3.0)] {
            let run = run(rate_hz, noise);
            let found = Segments::find(&run.recording("run"), 1.0).unwrap().rests;
            assert_eq!(found.len(), run.rests.len());
            let kept = |from_s: f64, to_s: f64| {
                let moving =
                    run.time_s.iter().zip(&run.true_angular_rate).filter(|(t, _)| (from_s..=to_s).contains(*t));
                moving.map(|(_, rate)| Vector3::from(*rate)).sum::<Vector3<f64>>().norm() / rate_hz
            };
            let ends = found
                .iter()
                .zip(&run.rests)
                .flat_map(|(rest, (start_s, end_s))| [kept(rest.start_s, *start_s), kept(*end_s, rest.end_s)]);
            let mean_rad = ends.sum::<f64>() / (2 * found.len()) as f64;
            // Mean rotation angle of a move that is wrongly assigned to one end of a rest, divided by the angle random
            // walk over a move of 2 s.
            let share = mean_rad / (noise * Unit::paper().gyroscope.noise_density * 2_f64.sqrt());
            assert!(share < 0.02, "{rate_hz} Hz, noise x {noise}: {share}");
            let lasting =
                |times: &mut dyn Iterator<Item = (f64, f64)>| times.map(|(start, end)| end - start).sum::<f64>();
            let left = lasting(&mut found.iter().map(|rest| (rest.start_s, rest.end_s)));
            let lost = 1.0 - left / lasting(&mut run.rests.iter().copied());
            assert!(lost < 0.01, "{rate_hz} Hz, noise x {noise}: {lost}");
        }
    }

    #[test]
    fn the_noise_density_is_that_of_the_unit() {
        let found = Segments::find(&run(200.0, 1.0).recording("run"), 1.0).unwrap();
        let unit = Unit::paper();
        for axis in 0..3 {
            // The noise density is estimated from means over 0.25 s. With 45 s of rests, the estimate for each axis has
            // a standard deviation of about 7 %.
            let rate = found.noise_density.angular_rate[axis] / unit.gyroscope.noise_density;
            let force = found.noise_density.specific_force[axis] / unit.accelerometer.noise_density;
            assert!((rate - 1.0).abs() < 0.27 && (force - 1.0).abs() < 0.27, "{rate} {force}");
        }
    }

    #[test]
    fn a_tumble_without_rest_is_said_to_have_none() {
        let time: Vec<f64> = (0..2000).map(|k| f64::from(k) * 0.01).collect();
        let force: Vec<[f64; 3]> = time.iter().map(|t| [9.8 * (3.0 * t).sin(), 9.8 * (3.0 * t).cos(), 0.0]).collect();
        let rate: Vec<[f64; 3]> = time.iter().map(|t| [(7.0 * t).sin(), (5.0 * t).cos(), 3.0]).collect();
        let recording = Recording::try_new("tumble", &time, &force, &rate).unwrap();
        let segments = Segments::find(&recording, 1.0);
        assert!(matches!(segments, Err(Error::NotEnoughMotion(_))), "{segments:?}");
    }
}
