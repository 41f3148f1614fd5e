//! Detects clock faults and excess noise inside moves. The tests use fourth differences of five consecutive angular
//! rates. Motion is smooth and contributes almost nothing to fourth differences, so these contain only noise and timing
//! errors. Two findings are reported:
//!
//! ```text
//! clock_irregular         evenly spaced sampling instants explain the rates inside moves better than the uneven time
//!                         stamps do, or the variance of fourth differences grows by (jitter dw/dt)^2, w: angular rate
//! noise_grows_in_motion   the variance of fourth differences is larger inside moves than at rest
//! ```

use imucal_core::sensor::Triad;
use nalgebra::Vector3;

use crate::calibrate::Outcome;
use crate::check;
use crate::finding::{Finding, general};
use crate::numerics::stats::{median, sample_interval_s};
use crate::recording::Recording;
use crate::rests::noise_density::variance_by_axis;
use crate::rounding::step::step_of;

/// A fault is reported only if its inclusion in the model changes chi2, or 2 ln L (L: likelihood), by at least this
/// value. The value corresponds to 5 sigma with one degree of freedom.
const SIGNIFICANT: f64 = 25.0;
/// Time-stamp errors are ignored if they increase the noise variance of the angular rate inside moves by less than this
/// fraction.
const HARMLESS: f64 = 0.1;
/// A fault explains the residuals of moves if the variance that it adds to the rates is at least this share of the
/// excess variance of the residuals. Each variance is in multiples of its noise variance. Wrong sampling instants and
/// white noise increase the variance of the rates and that of the residuals by about the same multiple. The share is
/// small because the largest errors of the rates are left out as outliers ([`JUMP`]).
const EXPLAINS: f64 = 0.25;
/// Half-width of the five-point stencil of a fourth difference, samples.
const REACH: usize = 2;
/// Distance between two independent fourth differences, samples. Two fourth differences at this distance share no
/// sample.
const APART: usize = 2 * REACH + 1;
/// Euclidean norm of the weights 1, -4, 6, -4, 1 of a fourth difference. A fourth difference of white noise, divided by
/// this norm, has the standard deviation of the noise.
const FOURTH: f64 = 8.366_600_265_340_756;
/// Median absolute value of a standard normal variable. Dividing the median absolute value of normal samples with mean
/// zero by it gives their standard deviation.
const MEDIAN: f64 = 0.6745;
/// Threshold for outliers, in standard deviations of a fourth difference. Larger fourth differences are excluded,
/// because single wrong samples cause them.
const JUMP: f64 = 5.0;
/// Smallest trial value of the jitter (standard deviation of time-stamp errors): log10(jitter / sample interval). The
/// largest trial value is the sample interval.
const SMALLEST_JITTER: f64 = -3.0;
/// Number of trial standard deviations of the time-stamp jitter, equally spaced on a logarithmic scale.
const JITTERS: usize = 60;

/// Tests the time stamps of each recording for errors. If no recording has such errors, tests the recordings for excess
/// noise inside moves instead. `outcome` is the result of a fit to these recordings. If `must_explain` is true, only
/// faults that explain at least the share [`EXPLAINS`] of the excess variance of the residuals of moves are reported.
pub(super) fn clock_and_noise_faults(
    outcome: &Outcome,
    recordings: &[Recording<'_>],
    must_explain: bool,
) -> Vec<Finding> {
    let differences: Vec<Differences> =
        (0..recordings.len()).map(|k| Differences::of(outcome, recordings, k)).collect();
    let least_excess = match outcome.joint_scales {
        Some(scales) if must_explain => EXPLAINS * (scales.moves.powi(2) - 1.0),
        _ => 0.0,
    };
    let each = || differences.iter().zip(recordings);
    let clock: Vec<Finding> = each().filter_map(|(own, recording)| own.stamp_fault(recording, least_excess)).collect();
    if !clock.is_empty() {
        return clock;
    }
    match outcome.joint_scales {
        Some(scales) if scales.moves > 1.0 && scales.norms <= 1.0 => {
            each().filter_map(|(own, recording)| own.noise_fault(recording, scales.moves, least_excess)).collect()
        }
        _ => Vec::new(),
    }
}

/// Fourth differences of the angular rates inside the moves of one recording, for all three axes. They are scaled so
/// that white noise has the same standard deviation in the fourth differences as in the rates.
struct Differences {
    /// Fourth differences of the angular rate, without outliers, divided by sigma. Sigma is the root sum of squares of
    /// the standard deviation of fourth differences at rest and of the rounding error in a move.
    noise: Vec<f64>,
    /// Angular acceleration divided by the sigma of the field `noise`, 1/s.
    slopes: Vec<f64>,
    /// Fourth differences of the time stamps, s.
    stamps_s: Vec<f64>,
}

impl Differences {
    fn of(outcome: &Outcome, recordings: &[Recording<'_>], index: usize) -> Self {
        let recording = &recordings[index];
        let rests = outcome.rests.iter().filter(|rest| rest.recording == index && rest.excluded.is_none());
        let moves = outcome.moves.iter().filter(|m| m.recording == index && m.excluded.is_none());
        let apart = |first: usize, end: usize| (first..end.saturating_sub(2 * REACH)).step_by(APART);
        let rates = Rates::new(recording, &outcome.calibration.gyroscope);
        let at_rest: Vec<Vector3<f64>> =
            rests.flat_map(|rest| apart(rest.first, rest.end)).map(|k| rates.fourth_difference(k)).collect();
        let sigma = match noise_limits(&at_rest) {
            Some(limits) => deviations_within(&at_rest, &limits),
            None => Vector3::repeat(1.0),
        };
        // At rest, the sensor's filter makes consecutive samples nearly equal. Rounding then gives all of them the same
        // error, which fourth differences do not contain. In a move, rounding errors act as white noise, so the
        // variance of rounding errors is added to sigma^2.
        let steps = Vector3::from_fn(|axis, _| step_of(recording.angular_rate, axis).unwrap_or(0.0));
        let rounding = variance_by_axis(outcome.calibration.gyroscope.inverse(), &(steps / 12f64.sqrt()));
        let sigma = sigma.zip_map(&rounding, |sigma, variance| sigma.hypot(variance.sqrt()));
        let inside: Vec<usize> = moves.flat_map(|m| apart(m.first, m.last)).collect();
        let in_moves: Vec<Vector3<f64>> = inside.iter().map(|&k| rates.fourth_difference(k)).collect();
        let limits = noise_limits(&in_moves).unwrap_or(Vector3::repeat(f64::INFINITY));
        let mut all = Self { noise: Vec::new(), slopes: Vec::new(), stamps_s: Vec::new() };
        for (&k, difference) in inside.iter().zip(&in_moves) {
            let (slope, stamp_s) = (rates.smooth_slope(k), fourth_difference(|i| recording.time_s[k + i]));
            for axis in (0..3).filter(|&axis| difference[axis].abs() <= limits[axis]) {
                all.noise.push(difference[axis] / sigma[axis]);
                all.slopes.push(slope[axis] / sigma[axis]);
                all.stamps_s.push(stamp_s);
            }
        }
        all
    }

    /// Reports time stamps that differ from the true sampling instants. This fault is detected if evenly spaced
    /// sampling instants explain the angular rates better than the time stamps do. `least_excess` is the smallest
    /// variance of the resulting rate errors that is reported, as a multiple of the noise variance.
    fn stamp_fault(&self, recording: &Recording<'_>, least_excess: f64) -> Option<Finding> {
        // Expected value of each fourth difference, in standard deviations of the noise, if the samples were taken at
        // the recorded, uneven time stamps. If they were taken at even intervals, the expected value is zero.
        let late: Vec<f64> = self.slopes.iter().zip(&self.stamps_s).map(|(slope, stamp)| slope * stamp).collect();
        if late.is_empty() || mean_square(&late) < HARMLESS.max(least_excess) {
            return None;
        }
        let gain: f64 = self.noise.iter().zip(&late).map(|(noise, late)| (noise - late).powi(2) - noise.powi(2)).sum();
        (gain > SIGNIFICANT).then(|| {
            let spread_ms = 1e3 * standard_deviation(&self.stamps_s);
            Finding {
                columns: vec!["time_s".into()],
                count: 1,
                value: spread_ms,
                unit: "ms",
                message: format!(
                    "time stamps scatter by {} ms (1 sigma) and angular rates inside moves do not follow them: the samples \
                     were taken at more even instants",
                    general(spread_ms, 2)
                ),
                way_out: check::stamps_from_sensor(recording),
                ..Finding::warning("clock_irregular", recording.name)
            }
        })
    }

    /// Reports why residuals of moves exceed noise while residuals of rests do not. The two tested causes are jitter of
    /// the time stamps, and gyroscope noise that is larger in motion. `widened` is the factor by which the calibration
    /// increased the standard deviations of the residuals of moves. `least_excess` is the smallest variance of the
    /// additional rate errors that is reported, as a multiple of the noise variance.
    fn noise_fault(&self, recording: &Recording<'_>, widened: f64, least_excess: f64) -> Option<Finding> {
        if self.noise.is_empty() {
            return None;
        }
        let factor = mean_square(&self.noise);
        let log_likelihood = |variance: &dyn Fn(usize) -> f64| {
            let term = |(k, noise): (usize, &f64)| variance(k).ln() + noise.powi(2) / variance(k);
            -0.5 * self.noise.iter().enumerate().map(term).sum::<f64>()
        };
        let interval_s = sample_interval_s(recording.time_s);
        let step = -SMALLEST_JITTER / (JITTERS - 1) as f64;
        let jitters_s = (0..JITTERS).map(|k| interval_s * 10f64.powf(SMALLEST_JITTER + step * k as f64));
        let of_jitter =
            jitters_s.map(|jitter_s| (jitter_s, log_likelihood(&|k| 1.0 + (self.slopes[k] * jitter_s).powi(2))));
        let first_best = |best: (f64, f64), other: (f64, f64)| if other.1 > best.1 { other } else { best };
        let (jitter_s, by_jitter) = of_jitter.reduce(first_best)?;
        let by_noise = log_likelihood(&|_| factor);
        if factor <= 1.0 + least_excess || 2.0 * (by_jitter.max(by_noise) - log_likelihood(&|_| 1.0)) < SIGNIFICANT {
            return None;
        }
        let fault = |code| Finding { count: 1, ..Finding::warning(code, recording.name) };
        if by_jitter > by_noise {
            let jitter_ms = 1e3 * jitter_s;
            return Some(Finding {
                columns: vec!["time_s".into()],
                value: jitter_ms,
                unit: "ms",
                message: format!(
                    "noise inside moves grows with the angular acceleration, as if samples were taken {} ms (1 sigma) off \
                     their time stamps",
                    general(jitter_ms, 2)
                ),
                way_out: "let the sensor's clock trigger each sample, and take the time stamp from this clock".into(),
                ..fault("clock_irregular")
            });
        }
        let times = factor.sqrt();
        Some(Finding {
            value: times,
            unit: "1",
            message: format!(
                "the noise of the gyroscope is {} times larger inside moves than at rest; the calibration increases the \
                 standard deviations of the residuals of moves by a factor of {}",
                general(times, 2),
                general(widened, 2)
            ),
            way_out:
                "look for what vibrates while the unit rotates, because the noise in motion differs from the noise \
                 at rest"
                    .into(),
            ..fault("noise_grows_in_motion")
        })
    }
}

/// The angular rates of one recording, corrected by a calibration.
struct Rates<'a> {
    recording: &'a Recording<'a>,
    gyroscope: &'a Triad<f64>,
    /// Mean sample interval, s. Derivatives are computed with this interval instead of the time stamps, because the
    /// time stamps themselves are tested.
    step_s: f64,
}

impl<'a> Rates<'a> {
    fn new(recording: &'a Recording<'a>, gyroscope: &'a Triad<f64>) -> Self {
        let [start_s, end_s] = recording.span_s();
        Self { recording, gyroscope, step_s: (end_s - start_s) / (recording.len() - 1) as f64 }
    }

    fn at(&self, k: usize) -> Vector3<f64> {
        self.gyroscope.correct(Vector3::from(self.recording.angular_rate.at(k)))
    }

    /// Fourth difference of the five samples from `first` on.
    fn fourth_difference(&self, first: usize) -> Vector3<f64> {
        let rates: [Vector3<f64>; APART] = std::array::from_fn(|i| self.at(first + i));
        Vector3::from_fn(|axis, _| fourth_difference(|i| rates[i][axis]))
    }

    /// Angular acceleration: mean of the central differences of the angular rate at the five samples of a fourth
    /// difference, rad/s^2. Central differences at the first two and the last two samples of the recording count as
    /// zero.
    fn smooth_slope(&self, first: usize) -> Vector3<f64> {
        let last = self.recording.len() - 1;
        let centres = (first..first + APART).filter(|k| (REACH..=last - REACH).contains(k));
        let slope = |k: usize| (self.at(k + 1) - self.at(k - 1)) / (2.0 * self.step_s);
        centres.map(slope).sum::<Vector3<f64>>() / APART as f64
    }
}

fn fourth_difference(value: impl Fn(usize) -> f64) -> f64 {
    (value(0) - 4.0 * value(1) + 6.0 * value(2) - 4.0 * value(3) + value(4)) / FOURTH
}

/// Threshold above which the magnitude of a fourth difference is an outlier, for each axis. It is computed from the
/// median of these magnitudes; `None` if there are no fourth differences.
fn noise_limits(differences: &[Vector3<f64>]) -> Option<Vector3<f64>> {
    let limit = |axis: usize| {
        let mut sizes: Vec<f64> = differences.iter().map(|difference| difference[axis].abs()).collect();
        let typical = median(&mut sizes) / MEDIAN;
        // If most fourth differences are zero, rounding to counts dominates. A step of one count is then no outlier, so
        // the limit is infinite.
        if typical > 0.0 { JUMP * typical } else { f64::INFINITY }
    };
    (!differences.is_empty()).then(|| Vector3::from_fn(|axis, _| limit(axis)))
}

/// Standard deviation of the fourth differences whose magnitude is within the limits, for each axis.
fn deviations_within(differences: &[Vector3<f64>], limits: &Vector3<f64>) -> Vector3<f64> {
    Vector3::from_fn(|axis, _| {
        let sizes = differences.iter().map(|difference| difference[axis]);
        let within: Vec<f64> = sizes.filter(|size| size.abs() <= limits[axis]).collect();
        mean_square(&within).sqrt()
    })
}

fn mean_square(values: &[f64]) -> f64 {
    values.iter().map(|value| value * value).sum::<f64>() / values.len() as f64
}

fn standard_deviation(values: &[f64]) -> f64 {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt()
}
