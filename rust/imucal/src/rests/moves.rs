//! Moves between rests: what a calibration fits the gyroscope to, and what a control record judges it by.

use std::ops::Range;

use imucal_core::sensor::Triad;
use nalgebra::{Matrix2x3, Matrix3, Vector2, Vector3};

use crate::check::saturated_samples;
use crate::finding::Finding;
use crate::numerics::stats::sample_interval_s;
use crate::recording::Recording;
use crate::rests::noise_density::{NoiseDensity, random_walk_rad, variance_per_axis};
use crate::rests::tremor::{Hand, Sensors};
use crate::rests::unit_rest::{UnitRest, touches};

/// A step in time of more than this many sample intervals inside a move loses too much of the rotation.
const LONGEST_STEP: f64 = 2.5;

/// How much of an unsteady rest, next to the move, gives the direction of gravity, s.
const SPAN_S: f64 = 1.0;
const TENTHS: usize = 10;
/// A hand makes the gyroscope scatter by more than this many times its noise, and by more than this rate, rad/s.
const TREMBLING: f64 = 1.5;
const STILL_RADPS: f64 = 1e-3;
/// The integration of a sampled rate is no finer than this; without noise it alone is left.
pub(crate) const FINEST_RAD: f64 = 2e-5;

/// The way from one rest to the next, from the last sample of the one to the first sample of the other.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Move {
    /// Index of the recording.
    pub(crate) recording: usize,
    /// Index of the rest before and after, among all rests of all recordings.
    pub(crate) from: usize,
    pub(crate) to: usize,
    /// First and last sample, both included.
    pub(crate) first: usize,
    pub(crate) last: usize,
    /// Duration, s.
    pub(crate) duration_s: f64,
    /// Median time between its samples, s.
    pub(crate) interval_s: f64,
}

/// What the residual of a move depends on beside the gyroscope.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ends {
    /// Direction of gravity in the body at the rest before and after the move.
    pub(crate) before: Vector3<f64>,
    pub(crate) after: Vector3<f64>,
    /// Standard deviation of each component of the residual, rad.
    pub(crate) sigma_rad: f64,
}

impl Ends {
    /// Two rows across the direction of gravity after the move.
    pub(crate) fn across(&self) -> Matrix2x3<f64> {
        rows_across(&self.after)
    }

    /// The residual in rad: components of the carried minus the measured direction.
    pub(crate) fn residual(&self, rotation: &Matrix3<f64>) -> Vector2<f64> {
        self.across() * (rotation.tr_mul(&self.before) - self.after)
    }
}

/// Two directions across this one.
pub(crate) fn across(up: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let first = Vector3::ith(axis_aside(up), 1.0).cross(up).normalize();
    [first, up.cross(&first)]
}

/// The axis that directions across this one are made with: one that is well aside, and stays the same for a direction that is close,
/// where the smallest of three components may change between two that are both zero.
pub(crate) fn axis_aside(up: &Vector3<f64>) -> usize {
    const ASIDE: f64 = 0.6;
    // The smallest of three components of a unit vector is below 0.58.
    up.iter().position(|component| component.abs() < ASIDE).unwrap_or(0)
}

/// The same as rows.
pub(crate) fn rows_across(up: &Vector3<f64>) -> Matrix2x3<f64> {
    Matrix2x3::from_rows(&across(up).map(|direction| direction.transpose()))
}

/// A stretch between two rests that cannot be used, and why (a reason code).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Unusable {
    pub(crate) span: Move,
    pub(crate) reason: &'static str,
}

/// Saturated stretches of each recording; the samples are read again only where the checks have found some.
pub(crate) fn saturated_stretches(recordings: &[Recording<'_>], findings: &[Finding]) -> Vec<Vec<Range<usize>>> {
    let found = findings.iter().any(Finding::is_saturation);
    recordings.iter().map(|recording| if found { saturated_samples(recording) } else { Vec::new() }).collect()
}

/// The moves between neighbouring usable rests, and those that a gap or saturated samples spoil.
pub(crate) fn between(
    recordings: &[Recording<'_>],
    rests: &[UnitRest],
    usable: &[bool],
    saturated: &[Vec<Range<usize>>],
) -> (Vec<Move>, Vec<Unusable>) {
    let kept: Vec<usize> = (0..rests.len()).filter(|&k| usable[k]).collect();
    let (mut moves, mut unusable) = (Vec::new(), Vec::new());
    for pair in kept.windows(2) {
        let (from, to) = (pair[0], pair[1]);
        let recording = rests[from].recording;
        if recording != rests[to].recording {
            continue;
        }
        let (first, last) = (rests[from].rest.end - 1, rests[to].rest.first);
        let time_s = &recordings[recording].time_s[first..=last];
        let interval_s = sample_interval_s(time_s);
        let duration_s = time_s[time_s.len() - 1] - time_s[0];
        let span = Move { recording, from, to, first, last, duration_s, interval_s };
        if touches(&saturated[recording], &(first..last + 1)) {
            unusable.push(Unusable { span, reason: "saturation" });
        } else if time_s.windows(2).any(|t| t[1] - t[0] > LONGEST_STEP * interval_s) {
            unusable.push(Unusable { span, reason: "samples_missing" });
        } else {
            moves.push(span);
        }
    }
    (moves, unusable)
}

/// What the directions of gravity at the ends of the moves are computed with.
pub(crate) struct Directions<'a> {
    pub(crate) recordings: &'a [Recording<'a>],
    pub(crate) rests: &'a [UnitRest],
    /// Noise of each recording, raw units.
    pub(crate) noise: &'a [NoiseDensity],
    /// The hand that holds the unit, if one does, for each recording.
    pub(crate) hands: &'a [Option<Hand>],
    pub(crate) accelerometer: &'a Triad<f64>,
    /// The gyroscope, as far as it is known.
    pub(crate) gyroscope: &'a Triad<f64>,
}

/// What the accelerometer reads at one end of a move, and the variance of each component of the direction.
#[derive(Clone, Copy, Debug)]
pub(crate) struct End {
    /// Raw units.
    pub(crate) raw: Vector3<f64>,
    /// Whether it is the mean over the whole rest.
    pub(crate) steady: bool,
    /// From the mean over the whole rest, which also serves the accelerometer's fit, rad^2.
    pub(crate) shared_variance: f64,
    /// From noise that nothing else sees, rad^2.
    pub(crate) own_variance: f64,
}

impl Directions<'_> {
    /// The ends of each move, and of their standard deviation the part that the mean of the rest does not make, rad.
    pub(crate) fn ends_of(&self, moves: &[Move]) -> (Vec<Ends>, Vec<f64>) {
        moves
            .iter()
            .map(|m| {
                let [before, after] = self.readings(m, false);
                let walk =
                    random_walk_rad(&self.noise[m.recording].angular_rate, self.gyroscope.inverse(), m.duration_s);
                let own = walk * walk + before.own_variance + after.own_variance;
                let sigma_rad = (own + before.shared_variance + after.shared_variance).sqrt().max(FINEST_RAD);
                let up = |end: &End| self.accelerometer.correct(end.raw).normalize();
                (Ends { before: up(&before), after: up(&after), sigma_rad }, own.sqrt())
            })
            .unzip()
    }

    /// What the accelerometer reads before and after a move.
    ///
    /// Where `sensors_drift` may explain that a reading wanders, the gyroscope alone says whether a hand holds the unit.
    pub(crate) fn readings(&self, m: &Move, sensors_drift: bool) -> [End; 2] {
        let steady = |k: usize| {
            let UnitRest { recording, rest, .. } = &self.rests[k];
            self.hands[*recording].is_none() && (rest.is_steady() || (sensors_drift && !self.trembles(k)))
        };
        [self.reading(m.from, true, steady(m.from)), self.reading(m.to, false, steady(m.to))]
    }

    /// Whether the gyroscope feels a hand: more than its noise within a tenth of a second.
    fn trembles(&self, k: usize) -> bool {
        let UnitRest { recording, rest, .. } = &self.rests[k];
        let rates = self.recordings[*recording].angular_rate.part(rest.first..rest.end);
        let interval_s = (rest.end_s - rest.start_s) / (rates.len() - 1).max(1) as f64;
        let noise = self.noise[*recording].angular_rate / interval_s.sqrt();
        let window = ((0.1 / interval_s).round() as usize).clamp(2, rates.len());
        let (mut squares, mut count) = (Vector3::zeros(), 0.0);
        for window in rates.chunks_exact(window) {
            let mean: Vector3<f64> =
                window.iter().map(|w| Vector3::from(*w)).sum::<Vector3<f64>>() / window.len() as f64;
            squares += window.iter().map(|w| (Vector3::from(*w) - mean).map(|v| v * v)).sum::<Vector3<f64>>();
            count += (window.len() - 1) as f64;
        }
        let scatter = (self.gyroscope.inverse() * (squares / count).map(f64::sqrt)).abs();
        let floor = (self.gyroscope.inverse() * noise).abs().map(|n| (n * TREMBLING).max(STILL_RADPS));
        (0..3).any(|axis| scatter[axis] > floor[axis])
    }

    /// The reading of gravity at the last (`at_end`) or first sample of a rest.
    fn reading(&self, k: usize, at_end: bool, steady: bool) -> End {
        let UnitRest { recording, rest, bias, .. } = &self.rests[k];
        let mean = &rest.specific_force;
        let force = self.accelerometer.correct(mean.mean);
        let noise = mean.variance_of_mean.map(f64::sqrt);
        let variance = variance_per_axis(self.accelerometer.inverse(), &noise) / force.norm_squared();
        if steady {
            return End { raw: mean.mean, steady: true, shared_variance: variance, own_variance: 0.0 };
        }
        if let Some(hand) = &self.hands[*recording] {
            let sensors = Sensors { accelerometer: self.accelerometer, gyroscope: self.gyroscope };
            let force = hand.force_at(&self.recordings[*recording], rest, sensors, *bias, at_end);
            let raw = self.accelerometer.measure(force);
            return End { raw, steady: false, shared_variance: 0.0, own_variance: hand.variance_rad2(rest) };
        }
        let (force, scatter, span_s) = self.tremor_free(k, at_end);
        let walk = random_walk_rad(&self.noise[*recording].angular_rate, self.gyroscope.inverse(), span_s);
        // The mean over a span of a random walk that is zero at its end has a third of the walk's variance.
        let raw = self.accelerometer.measure(force);
        End { raw, steady: false, shared_variance: 0.0, own_variance: scatter + walk * walk / 3.0 }
    }

    /// Mean of the last or first second of a rest, each sample turned by the gyroscope to the attitude at the end of it,
    /// the variance of that mean from the scatter of its tenths (rad^2), and the span, s.
    ///
    /// A hand that holds a pose trembles: the plain mean is not where the move starts. The mean rate of the rest is
    /// taken for the gyroscope's bias, so that a bias that depends on the pose does no harm.
    fn tremor_free(&self, k: usize, at_end: bool) -> (Vector3<f64>, f64, f64) {
        let UnitRest { recording, rest, .. } = &self.rests[k];
        let recording = &self.recordings[*recording];
        let samples = rest.end - rest.first;
        let interval_s = (rest.end_s - rest.start_s) / (samples - 1).max(1) as f64;
        let count = ((SPAN_S / interval_s).round() as usize).clamp(1, samples);
        let tenth = (count / TENTHS).max(1);
        let sensors = Sensors { accelerometer: self.accelerometer, gyroscope: self.gyroscope };
        let mut forces = sensors.along_gyroscope(recording, rest, rest.angular_rate.mean, at_end);
        let mut means = Vec::with_capacity(TENTHS);
        for _ in 0..(count / tenth) {
            let sum = forces.by_ref().take(tenth).sum::<Vector3<f64>>();
            means.push(sum / tenth as f64);
        }
        let groups = means.len() as f64;
        let mean = means.iter().sum::<Vector3<f64>>() / groups;
        let scatter = means.iter().map(|group| (group - mean).norm_squared()).sum::<f64>() / (groups - 1.0).max(1.0);
        (mean, scatter / 3.0 / groups / mean.norm_squared(), count as f64 * interval_s)
    }
}

/// Error of the gravity direction after a move: the angle between carried and measured, rad.
pub(crate) fn direction_error_rad(ends: &Ends, rotation: &Matrix3<f64>) -> f64 {
    let carried: Vector3<f64> = rotation.tr_mul(&ends.before);
    // The arc tangent keeps its digits for small angles, unlike the arc cosine.
    carried.cross(&ends.after).norm().atan2(carried.dot(&ends.after))
}
