//! Extracts the noise at rest as signals that identify a recording.
//!
//! The noise of a sensor never repeats, but a motion may, because a stand can run one program many times. Therefore
//! only samples at rest are used. Second differences of consecutive samples are taken, because they suppress tremor,
//! drift and bias. Each rest is tapered with a Hann window, which confines periodic vibration (mains, motors) to few
//! frequencies. The second differences of each axis are divided by their scale, so units and gains have no effect.

use std::ops::Range;

use crate::numerics::stats::{median, quantile};
use crate::recording::Recording;

/// Number of signals. Three of them are sums of one accelerometer axis and one gyroscope axis. The fourth is the sum of
/// the squares of all axes, which does not depend on the order and the signs of the axes.
pub(super) const SIGNALS: usize = 4;

/// Scaled second differences are clipped to this absolute value. Without this limit, a wrong sample or a knock would
/// hide the noise that two recordings have in common.
const CLIP: f32 = 3.0;
/// Quantile of the absolute second differences that defines the scale of an axis (its noise). After rounding to coarse
/// counts, fewer than a fifth of the second differences may be nonzero. The scale is then zero, and the axis counts as
/// free of noise.
const SCALE_QUANTILE: f64 = 0.8;
/// The [`SCALE_QUANTILE`] of |x| for a standard normal x. The same quantile of measured differences is divided by this
/// value to obtain a standard deviation.
const SCALE_OF_NORMAL: f64 = 1.28;
/// An axis is used only if (scale of its second differences) / |largest reading| is above this value. Smaller
/// differences are rounding errors of the arithmetic.
const MIN_SCALE: f64 = 1e-9;
/// Number of samples at rest from which the scale of an axis is estimated. If there are more samples, a subset of at
/// least this number and less than twice this number is used. The error of the scale is then below 3 %. If there are
/// fewer samples, all of them are used.
const SCALE_SAMPLES: usize = 4096;
/// Two sampling rates count as equal if their relative difference is at most this value. Clocks of one unit agree to
/// about 1e-4, and different nominal sampling rates differ by more.
const SAME_RATE: f64 = 2e-3;

/// A recording with the index ranges of its rests.
#[derive(Clone, Copy)]
pub struct AtRest<'a> {
    /// The recording.
    pub recording: &'a Recording<'a>,
    /// Index ranges of the rests, in ascending order.
    pub rests: &'a [Range<usize>],
}

/// Combines each recording with the list of the index ranges of its rests. `rests` contains one list for each
/// recording.
pub fn at_rest<'a>(recordings: &'a [Recording<'a>], rests: &'a [Vec<Range<usize>>]) -> Vec<AtRest<'a>> {
    recordings.iter().zip(rests).map(|(recording, rests)| AtRest { recording, rests }).collect()
}

/// The signals ([`SIGNALS`]) of all recordings that have the same sampling rate, concatenated.
pub(super) struct Tape {
    pub(super) rate_hz: f64,
    pub(super) signals: [Vec<f32>; SIGNALS],
    /// For each recording on the tape: its index in the list of recordings, and its range of samples on the tape.
    pub(super) parts: Vec<(usize, Range<usize>)>,
}

/// Position of a recording: the index of its tape, and its range of samples on this tape.
#[derive(Clone)]
pub(super) struct OnTape {
    pub(super) tape: usize,
    pub(super) range: Range<usize>,
}

impl Tape {
    /// Concatenates the recordings, in the order `order`, to one tape per sampling rate. Also returns the position of
    /// each recording.
    pub(super) fn of(recordings: &[AtRest<'_>], order: &[usize]) -> (Vec<Self>, Vec<OnTape>) {
        let mut tapes: Vec<Self> = Vec::new();
        let mut places = vec![OnTape { tape: 0, range: 0..0 }; recordings.len()];
        for &index in order {
            let rate_hz = mean_rate_hz(recordings[index].recording.time_s);
            let known = tapes.iter().position(|tape| is_same_rate(tape.rate_hz, rate_hz));
            let tape = known.unwrap_or_else(|| {
                tapes.push(Self { rate_hz, signals: std::array::from_fn(|_| Vec::new()), parts: Vec::new() });
                tapes.len() - 1
            });
            let range = tapes[tape].append(&recordings[index]);
            tapes[tape].parts.push((index, range.clone()));
            places[index] = OnTape { tape, range };
        }
        (tapes, places)
    }

    pub(super) fn len(&self) -> usize {
        self.signals[0].len()
    }

    fn append(&mut self, at_rest: &AtRest<'_>) -> Range<usize> {
        let AtRest { recording, rests } = *at_rest;
        let start = self.len();
        for signal in &mut self.signals {
            signal.resize(start + recording.len(), 0.0);
        }
        let scales = Axes::of(at_rest);
        let inner = |rest: &Range<usize>| inner(rest, recording);
        let (mut energy, mut count) = (0.0_f64, 0_usize);
        for samples in rests.iter().map(inner) {
            for (i, taper) in samples.clone().zip(hann(samples.len())) {
                let scaled = scales.second_difference(recording, i);
                for axis in 0..3 {
                    self.signals[axis][start + i] = taper * (scaled[axis] + scaled[3 + axis]);
                }
                let squares: f32 = scaled.iter().map(|value| value * value).sum();
                self.signals[3][start + i] = squares;
                energy += f64::from(squares);
                count += 1;
            }
        }
        let mean = (energy / count.max(1) as f64) as f32;
        for samples in rests.iter().map(inner) {
            let squares = &mut self.signals[3][start + samples.start..][..samples.len()];
            for (squares, taper) in squares.iter_mut().zip(hann(samples.len())) {
                *squares = taper * (*squares - mean);
            }
        }
        start..self.len()
    }
}

/// Computes a Hann window of `length` samples. A recurrence computes the cosines, which is much faster than evaluating
/// each cosine.
fn hann(length: usize) -> impl Iterator<Item = f32> {
    let step = std::f64::consts::TAU / length.max(1) as f64;
    let twice = 2.0 * step.cos();
    let (mut before, mut cosine) = ((-0.5 * step).cos(), (0.5 * step).cos());
    (0..length).map(move |_| {
        let weight = (0.5 - 0.5 * cosine) as f32;
        (before, cosine) = (cosine, twice * cosine - before);
        weight
    })
}

pub(super) fn is_same_rate(first_hz: f64, second_hz: f64) -> bool {
    (first_hz / second_hz - 1.0).abs() < SAME_RATE
}

/// Computes the mean sampling rate without gaps, Hz; NaN for less than two samples. Time steps of more than three times
/// the median are ignored.
fn mean_rate_hz(time_s: &[f64]) -> f64 {
    let stride = (time_s.len() / SCALE_SAMPLES).max(1);
    let mut steps: Vec<f64> = time_s.windows(2).step_by(stride).map(|pair| pair[1] - pair[0]).collect();
    let longest = 3.0 * median(&mut steps);
    let (mut sum, mut count) = (0.0, 0_usize);
    for step in time_s.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step < longest) {
        sum += step;
        count += 1;
    }
    count as f64 / sum
}

/// Reciprocal of the noise scale of each axis, accelerometer first. It is zero for an axis without noise.
struct Axes([f64; 6]);

impl Axes {
    fn of(at_rest: &AtRest<'_>) -> Self {
        let AtRest { recording, rests } = *at_rest;
        let inner = |rest: &Range<usize>| inner(rest, recording);
        let all: usize = rests.iter().map(|rest| inner(rest).len()).sum();
        let stride = (all / SCALE_SAMPLES).max(1);
        let mut differences: [Vec<f64>; 6] = Default::default();
        let mut largest = [0.0_f64; 6];
        for i in rests.iter().flat_map(inner).step_by(stride) {
            let (middle, difference) = (row(recording, i), second_difference(recording, i));
            for axis in 0..6 {
                largest[axis] = largest[axis].max(middle[axis].abs());
                differences[axis].push(difference[axis].abs());
            }
        }
        Self(std::array::from_fn(|axis| {
            let scale = quantile(&mut differences[axis], SCALE_QUANTILE) / SCALE_OF_NORMAL;
            if scale > MIN_SCALE * largest[axis] { 1.0 / scale } else { 0.0 }
        }))
    }

    /// Second difference of each axis at `sample`, divided by the noise scale of the axis and clipped.
    fn second_difference(&self, recording: &Recording<'_>, sample: usize) -> [f32; 6] {
        let difference = second_difference(recording, sample);
        std::array::from_fn(|axis| ((difference[axis] * self.0[axis]) as f32).clamp(-CLIP, CLIP))
    }
}

/// The samples of a rest for which a second difference exists. It does not exist for the first and the last sample of a
/// recording.
fn inner(rest: &Range<usize>, recording: &Recording<'_>) -> Range<usize> {
    let start = rest.start.max(1);
    start..rest.end.min(recording.len().saturating_sub(1)).max(start)
}

fn row(recording: &Recording<'_>, sample: usize) -> [f64; 6] {
    // The channels of an absent sensor are set to zero, so that the scale of their noise is zero and they are not used.
    let [[fx, fy, fz], [wx, wy, wz]] = [recording.specific_force, recording.angular_rate]
        .map(|rows| if rows.is_absent() { [0.0; 3] } else { rows.at(sample) });
    [fx, fy, fz, wx, wy, wz]
}

fn second_difference(recording: &Recording<'_>, sample: usize) -> [f64; 6] {
    let (before, middle, after) = (row(recording, sample - 1), row(recording, sample), row(recording, sample + 1));
    std::array::from_fn(|axis| before[axis] - 2.0 * middle[axis] + after[axis])
}
