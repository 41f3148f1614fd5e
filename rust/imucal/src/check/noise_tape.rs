//! Extraction of the noise at rest as signals that identify a recording.
//!
//! The noise of a sensor never repeats, but a motion may, because a stand can run one program many times. Therefore
//! only samples at rest are used. Second differences suppress tremor, drift and bias. Each rest is tapered with a Hann
//! window, which confines periodic vibration (mains, motors) to few frequencies. The second differences of each axis
//! are divided by their scale, so units and gains have no effect. Knocks and wrong samples are left out: one of them in
//! each of two recordings would otherwise correlate like common noise.

use std::ops::Range;

use crate::numerics::stats::{median, quantile};
use crate::recording::Recording;

/// Number of signals. Three of them are sums of one accelerometer axis and one gyroscope axis. The fourth is the sum of
/// the squares of all axes, which does not depend on the order and the signs of the axes.
pub(super) const SIGNALS: usize = 4;

/// Scaled second differences of one axis are clipped to this absolute value.
const CLIP: f32 = 3.0;
/// Number of samples before a sample, and after it, over which the mean square of the scaled second differences is
/// taken.
const NEIGHBOURS: usize = 8;
/// Quantile of the squares of a recording to which the squares in the fourth signal are clipped. A square is the sum of
/// the squared scaled second differences of all axes at one sample.
const LARGE_SQUARE: f64 = 0.95;
/// A sample is part of a short pulse (knock or wrong sample) if its square is larger than this multiple of the quantile
/// [`LARGE_SQUARE`]. The peaks of a periodic vibration are smaller, because they belong to the largest squares of the
/// recording themselves. Vibration with omitted peaks would correlate like two pulses.
const PULSE: f32 = 3.0;
/// This number of samples before a short pulse, and after it, is not used either.
const BESIDE_PULSE: usize = 2;
/// Quantile of the mean squares of a recording (see [`NEIGHBOURS`]) that is compared with [`LOUD`].
const LARGE_MEAN: f64 = 0.9;
/// A sample is not used if the mean square of its neighbours is larger than this multiple of the quantile
/// [`LARGE_MEAN`].
const LOUD: f64 = 1.6;
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
        let recording = at_rest.recording;
        let start = self.len();
        for signal in &mut self.signals {
            signal.resize(start + recording.len(), 0.0);
        }
        let axes = Axes::of(at_rest);
        let rests: Vec<Range<usize>> = at_rest.rests.iter().map(|rest| inner(rest, recording)).collect();
        let mut squares: Vec<Vec<f32>> = Vec::with_capacity(rests.len());
        for rest in &rests {
            let square_at = |(i, taper): (usize, f32)| {
                let scaled = axes.second_difference(recording, i);
                let clipped = scaled.map(|value| value.clamp(-CLIP, CLIP));
                for axis in 0..3 {
                    self.signals[axis][start + i] = taper * (clipped[axis] + clipped[3 + axis]);
                }
                scaled.iter().map(|value| value * value).sum::<f32>()
            };
            squares.push(rest.clone().zip(hann(rest.len())).map(square_at).collect());
        }
        let usual = Usual::of(&squares);
        let mut energy = 0.0_f64;
        let mut quiet: Vec<(usize, f32)> = Vec::new();
        for (rest, squares) in rests.iter().zip(&squares) {
            let samples = rest.clone().zip(hann(rest.len())).zip(squares).zip(usual.are_quiet(squares));
            for (((i, taper), square), is_quiet) in samples {
                let square = square.min(usual.square);
                if is_quiet {
                    self.signals[3][start + i] = square;
                    energy += f64::from(square);
                    quiet.push((start + i, taper));
                } else {
                    self.signals[..3].iter_mut().for_each(|signal| signal[start + i] = 0.0);
                }
            }
        }
        let mean = (energy / quiet.len().max(1) as f64) as f32;
        for (place, taper) in quiet {
            let square = &mut self.signals[3][place];
            *square = taper * (*square - mean);
        }
        start..self.len()
    }
}

/// The largest squares and mean squares of a recording that are not caused by short pulses.
struct Usual {
    /// The quantile [`LARGE_SQUARE`] of the squares.
    square: f32,
    /// The quantile [`LARGE_MEAN`] of the mean squares over successive samples.
    mean: f64,
}

impl Usual {
    /// `squares` has one list for each rest.
    fn of(squares: &[Vec<f32>]) -> Self {
        let mean = |part: &[f32]| f64::from(part.iter().sum::<f32>()) / part.len() as f64;
        let mut all: Vec<f64> = squares.iter().flatten().copied().map(f64::from).collect();
        let mut means: Vec<f64> = squares.iter().flat_map(|rest| rest.chunks(2 * NEIGHBOURS + 1)).map(mean).collect();
        Self { square: quantile(&mut all, LARGE_SQUARE) as f32, mean: quantile(&mut means, LARGE_MEAN) }
    }

    /// For each sample of a rest: whether no short pulse is close to it, and the mean square of its neighbours is not
    /// above [`LOUD`].
    fn are_quiet(&self, squares: &[f32]) -> Vec<bool> {
        // A square that is not a number belongs to a pulse, too.
        let is_pulse: Vec<bool> =
            squares.iter().map(|square| square.is_nan() || *square > PULSE * self.square).collect();
        // For each sample: the sum of `squares` over all samples before it, and the number of these samples. Samples of
        // a short pulse are omitted.
        let mut before = vec![(0.0_f64, 0_usize)];
        for (square, is_pulse) in squares.iter().zip(&is_pulse) {
            let (sum, count) = before[before.len() - 1];
            before.push(if *is_pulse { (sum, count) } else { (sum + f64::from(*square), count + 1) });
        }
        let around = |i: usize, reach: usize| i.saturating_sub(reach)..(i + reach + 1).min(squares.len());
        let is_quiet = |i: usize| {
            let Range { start, end } = around(i, NEIGHBOURS);
            let (from, to) = (before[start], before[end]);
            let is_loud = to.0 - from.0 > LOUD * self.mean * (to.1 - from.1) as f64;
            !is_loud && !is_pulse[around(i, BESIDE_PULSE)].contains(&true)
        };
        (0..squares.len()).map(is_quiet).collect()
    }
}

/// Hann window of `length` samples. A recurrence computes the cosines, which is much faster than evaluating each
/// cosine.
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

/// Mean sampling rate without gaps, Hz; NaN for less than two samples. Time steps of more than three times the median
/// are ignored.
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

    /// Second difference of each axis at `sample`, divided by the noise scale of the axis.
    fn second_difference(&self, recording: &Recording<'_>, sample: usize) -> [f32; 6] {
        let difference = second_difference(recording, sample);
        std::array::from_fn(|axis| (difference[axis] * self.0[axis]) as f32)
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
