//! Finds the moves between consecutive rests, and computes the gravity directions at both ends of a move (model.md (7),
//! (8), (13)). The gyroscope is fitted to the moves of a calibration recording. A finished calibration is evaluated on
//! the moves of a control recording.

use std::ops::Range;

use imucal_core::sensor::Triad;
use nalgebra::{Matrix2x3, Matrix3, Vector2, Vector3};

use crate::check::saturated_samples;
use crate::finding::Finding;
use crate::numerics::stats::sample_interval_s;
use crate::recording::Recording;
use crate::rests::noise_density::{NoiseDensity, random_walk_rad, variance_per_axis};
use crate::rests::rest::at_least;
use crate::rests::tremor::{Hand, Sensors};
use crate::rests::unit_rest::{UnitRest, touches};

/// A move is used only if each of its time steps is at most this multiple of the median sampling interval (model.md
/// (7)). Over a longer time step, the rotation cannot be integrated accurately.
const LONGEST_STEP: f64 = 2.5;

/// In a recording without a tremor model ([`Hand`]), the gravity direction at an end of an unsteady (hand-held) rest is
/// computed from the part of the rest that is adjacent to this end. This constant is the duration of this part, s
/// (model.md (13)).
const SPAN_S: f64 = 1.0;
/// Number of equal parts into which the last or first second of an unsteady (hand-held) rest is divided. The variance
/// of the gravity direction is computed from the scatter of the means over these parts (model.md (13)).
const TENTHS: usize = 10;
/// In the test for hand tremor, a rest is classified as hand-held if the standard deviation of its rates within 0.1 s
/// exceeds this factor times the noise of the gyroscope. The factor is above 1 because the estimated noise is
/// uncertain.
const TREMBLING: f64 = 1.5;
/// In the test for hand tremor, a rest is never classified as hand-held if the standard deviation of its rates within
/// 0.1 s is below this limit, rad/s. Hand tremor causes larger rates. The limit prevents false detections in recordings
/// without noise.
const STILL_RADPS: f64 = 1e-3;
/// Lower bound of the standard deviation of the gravity-direction error after a move, rad. It is the size of the
/// numerical error that the integration of sampled rates causes. In simulated data without noise, the residual of a
/// move consists only of this numerical error.
pub(crate) const FINEST_RAD: f64 = 2e-5;

/// A move: the samples from the last sample of a rest to the first sample of the next rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Move {
    /// Index of the recording that contains the move.
    pub(crate) recording: usize,
    /// Index of the rest before the move, in the list of the rests of all recordings.
    pub(crate) from: usize,
    /// Index of the rest after the move, in the same list.
    pub(crate) to: usize,
    /// Index of the first sample of the move, which is the last sample of the rest before it.
    pub(crate) first: usize,
    /// Index of the last sample of the move (inclusive), which is the first sample of the rest after it.
    pub(crate) last: usize,
    /// Duration of the move, s.
    pub(crate) duration_s: f64,
    /// Median sampling interval within the move, s.
    pub(crate) interval_s: f64,
}

/// Measured gravity directions at both ends of a move, and the standard deviation of the residual of the move (model.md
/// (7), (8)).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ends {
    /// Unit vector of gravity in the body frame at the rest before the move.
    pub(crate) before: Vector3<f64>,
    /// Unit vector of gravity in the body frame at the rest after the move.
    pub(crate) after: Vector3<f64>,
    /// Standard deviation, rad, of each of the two components (perpendicular to gravity) of the residual of the move.
    pub(crate) sigma_rad: f64,
}

impl Ends {
    /// The projection matrix E of model.md (7). Its two rows are orthonormal vectors that are perpendicular to the
    /// direction of gravity after the move.
    pub(crate) fn across(&self) -> Matrix2x3<f64> {
        rows_across(&self.after)
    }

    /// Residual of the move, rad: the gravity direction that the gyroscope propagates from the start, minus the
    /// direction measured at the end, both projected with E. `rotation` is the rotation from the body frame at the end
    /// of the move to the body frame at its start.
    pub(crate) fn residual(&self, rotation: &Matrix3<f64>) -> Vector2<f64> {
        self.across() * (rotation.tr_mul(&self.before) - self.after)
    }
}

/// Two orthonormal vectors perpendicular to the unit vector `up`.
pub(crate) fn across(up: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let first = Vector3::ith(axis_aside(up), 1.0).cross(up).normalize();
    [first, up.cross(&first)]
}

/// Index of the coordinate axis from which [`across`] constructs the perpendicular vectors. It is the first axis that
/// is far from parallel to `up`, so a small change of `up` rarely changes the choice. The axis with the smallest
/// component of `up` would be a worse choice: if two components are near zero, noise decides which component is the
/// smallest.
pub(crate) fn axis_aside(up: &Vector3<f64>) -> usize {
    /// The component of `up` along the chosen axis must be below this limit in absolute value. Every unit vector has
    /// such an axis, because the smallest absolute value of its components is at most 1 / sqrt(3) = 0.58.
    const ASIDE: f64 = 0.6;
    up.iter().position(|component| component.abs() < ASIDE).unwrap_or(0)
}

/// The two vectors perpendicular to `up` that [`across`] returns, as rows of a matrix.
pub(crate) fn rows_across(up: &Vector3<f64>) -> Matrix2x3<f64> {
    Matrix2x3::from_rows(&across(up).map(|direction| direction.transpose()))
}

impl Move {
    /// Whether this interval connects two epochs of one long rest, so that the unit does not move. An epoch is a part
    /// of a long rest with its own mean.
    pub(crate) fn is_within_rest(&self, rests: &[UnitRest]) -> bool {
        rests[self.from].whole == rests[self.to].whole
    }

    /// This move, with the index of each epoch (part of a long rest) replaced by the index of the rest that contains
    /// it.
    pub(crate) fn between_rests(&self, rests: &[UnitRest]) -> Self {
        Self { from: rests[self.from].whole, to: rests[self.to].whole, ..*self }
    }
}

/// An interval between two rests that cannot be used as a move.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Unusable {
    /// The interval: its first and last sample, its duration, and the rests before and after it.
    pub(crate) span: Move,
    /// Why the interval cannot be used, as a code: `saturation` or `samples_missing`.
    pub(crate) reason: &'static str,
}

/// Index ranges of saturated samples in each recording. The samples are examined only if the checks have reported
/// saturation.
pub(crate) fn saturated_stretches(recordings: &[Recording<'_>], findings: &[Finding]) -> Vec<Vec<Range<usize>>> {
    let found = findings.iter().any(Finding::is_saturation);
    recordings.iter().map(|recording| if found { saturated_samples(recording) } else { Vec::new() }).collect()
}

/// The moves between consecutive usable rests, and the intervals between usable rests that are not usable as moves
/// because samples are missing or saturated.
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

/// Data and calibration from which the gravity directions at the ends of moves are computed.
pub(crate) struct Directions<'a> {
    pub(crate) recordings: &'a [Recording<'a>],
    pub(crate) rests: &'a [UnitRest],
    /// For each recording: white-noise densities of the sensors, raw units per sqrt(Hz).
    pub(crate) noise: &'a [NoiseDensity],
    /// For each recording: model of the tremor of the hand; `None` if the unit is not hand-held.
    pub(crate) hands: &'a [Option<Hand>],
    pub(crate) accelerometer: &'a Triad<f64>,
    /// Current estimate of the gyroscope's calibration.
    pub(crate) gyroscope: &'a Triad<f64>,
}

/// Accelerometer reading of gravity at one end of a move. The variance of each component of the gravity direction is
/// the sum of `shared_variance` and `own_variance`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct End {
    /// Reading of the accelerometer at this end of the move, raw units.
    pub(crate) raw: Vector3<f64>,
    /// Whether the reading is the mean over the whole rest, as for a rest on a rigid support. Otherwise, the reading is
    /// valid only at one end of the rest, because the attitude changes during the rest.
    pub(crate) steady: bool,
    /// First part of the variance, rad^2: noise of the mean over the whole rest. Three residuals depend on this mean:
    /// the residuals of the moves before and after the rest, and the residual of the norm of the mean force. Their
    /// errors are therefore correlated.
    pub(crate) shared_variance: f64,
    /// Second part of the variance, rad^2: noise that is contained only in the residual of this move.
    pub(crate) own_variance: f64,
}

impl Directions<'_> {
    /// Returns, for each move, the gravity directions at both ends and the standard deviation of the move's residual.
    /// The second result is, for each move, the standard deviation of those errors of the residual that are independent
    /// between moves, rad. It excludes the noise of the means over rests, because two moves share each mean.
    pub(crate) fn ends_of(&self, moves: &[Move]) -> (Vec<Ends>, Vec<f64>) {
        moves
            .iter()
            .map(|m| {
                let [before, after] = self.readings(m, false);
                let walk =
                    random_walk_rad(&self.noise[m.recording].angular_rate, self.gyroscope.inverse(), m.duration_s);
                let own = walk * walk + before.own_variance + after.own_variance;
                let sigma_rad = at_least(FINEST_RAD, (own + before.shared_variance + after.shared_variance).sqrt());
                let up = |end: &End| self.accelerometer.correct(end.raw).normalize();
                (Ends { before: up(&before), after: up(&after), sigma_rad }, own.sqrt())
            })
            .unzip()
    }

    /// Accelerometer readings of gravity at the start and at the end of a move, with their variances.
    ///
    /// `sensors_drift` is true if the mean force may change during a rest because the sensors drift. In this case, an
    /// unsteady rest is classified as hand-held only if the gyroscope also shows tremor.
    pub(crate) fn readings(&self, m: &Move, sensors_drift: bool) -> [End; 2] {
        let steady = |k: usize| {
            let UnitRest { recording, rest, .. } = &self.rests[k];
            self.hands[*recording].is_none() && (rest.is_steady() || (sensors_drift && !self.trembles(k)))
        };
        [self.reading(m.from, true, steady(m.from)), self.reading(m.to, false, steady(m.to))]
    }

    /// Whether the gyroscope shows that the unit is hand-held at rest `k`. This is the case if, on any axis, the
    /// standard deviation of the rates within 0.1 s is larger than sensor noise explains.
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

    /// Returns the accelerometer reading of gravity at one end of rest `k`, with its variance: at the last sample if
    /// `at_end` is true, otherwise at the first sample.
    fn reading(&self, k: usize, at_end: bool, steady: bool) -> End {
        let UnitRest { recording, rest, bias, .. } = &self.rests[k];
        let mean = &rest.specific_force;
        let force = self.accelerometer.correct(mean.mean);
        let variance_of = |raw: Vector3<f64>| {
            variance_per_axis(self.accelerometer.inverse(), &raw.map(f64::sqrt)) / force.norm_squared()
        };
        let variance = variance_of(mean.whole_variance());
        let rounding = variance_of(mean.rounding_std().map(|std| std * std));
        if steady {
            return End { raw: mean.mean, steady: true, shared_variance: variance, own_variance: 0.0 };
        }
        if let Some(hand) = &self.hands[*recording] {
            let sensors = Sensors { accelerometer: self.accelerometer, gyroscope: self.gyroscope };
            let force = hand.force_at(&self.recordings[*recording], rest, sensors, *bias, at_end);
            let raw = self.accelerometer.measure(force);
            return End { raw, steady: false, shared_variance: 0.0, own_variance: hand.variance_rad2(rest) + rounding };
        }
        let (force, scatter, span_s) = self.tremor_free(k, at_end);
        let walk = random_walk_rad(&self.noise[*recording].angular_rate, self.gyroscope.inverse(), span_s);
        // The error of the integrated rotation is a random walk. This error is zero at this end of the rest and has the
        // variance walk^2 at the other end of the averaged interval. The mean of the error over this interval has the
        // variance walk^2 / 3.
        let raw = self.accelerometer.measure(force);
        End { raw, steady: false, shared_variance: 0.0, own_variance: scatter + walk * walk / 3.0 + rounding }
    }

    /// Computes the mean force over the last second of rest `k` if `at_end` is true, otherwise over its first second.
    /// Each sample is rotated by the integrated gyroscope rate to the attitude at that end of the rest (model.md (13)).
    /// Returns the mean (m/s^2), the variance of its direction (rad^2), and the duration of the averaged interval (s).
    /// The variance is computed from the scatter of the means over ten parts of this interval.
    ///
    /// The attitude of a hand-held unit varies during a rest, so the mean without these rotations is not the gravity
    /// direction at that end. The mean rate of this rest is used as the gyroscope bias, so a bias that depends on the
    /// pose causes no error.
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

/// Error of the gravity direction after a move, rad: the angle between the direction that the gyroscope propagates and
/// the measured direction.
pub(crate) fn direction_error_rad(ends: &Ends, rotation: &Matrix3<f64>) -> f64 {
    let propagated: Vector3<f64> = rotation.tr_mul(&ends.before);
    // The arc tangent is accurate at small angles, whereas the arc cosine is not.
    propagated.cross(&ends.after).norm().atan2(propagated.dot(&ends.after))
}
