//! Computes the derivative of noisy data with stencils. A stencil consists of consecutive boxes (averaging intervals)
//! with equal numbers of samples. A polynomial is chosen so that its means over the boxes equal the means of the data.
//! The derivative at a sample is the slope of this polynomial.

use std::iter::StepBy;
use std::ops::Range;

use nalgebra::{SMatrix, Vector3, Vector4};
use pulp::{Simd, WithSimd};

use crate::numerics::instructions::Instructions;
use crate::numerics::stats::sample_interval_s;

/// Number of boxes (averaging intervals) of a stencil. The means over five boxes determine a polynomial of fourth
/// degree.
pub(super) const BOXES: usize = 5;
/// Two derivatives that are computed with different box widths agree if the mean square of their difference is at most
/// this multiple of the mean square expected from noise.
const AGREE: f64 = 2.0;
/// Length of the segments in which two derivatives are compared, s. The derivatives must agree in every segment.
const STRETCH_S: f64 = 1.0;
/// Minimum length of the segments in which two derivatives are compared, in widths of the wider boxes.
const STRETCH_BOXES: usize = 20;
/// Approximate number of samples at which two derivatives are compared in a segment. Fewer samples are compared if they
/// would be less than half a box width apart.
const MOST_LOOKS: usize = 100;
/// Time steps are treated as equal if each of them deviates from their mean by at most this share of the mean. The
/// limit permits rounding errors.
const EVEN: f64 = 1e-9;

/// Cumulative sums of the values. The first value that is not missing is subtracted from all values, because a large
/// bias would cause rounding errors. The fourth component is the number of missing values so far. Vectors of four
/// components are also suitable for addition by SIMD instructions.
pub(super) struct Sums(Vec<Vector4<f64>>);

impl Sums {
    pub(super) fn new(values: &[Vector3<f64>]) -> Self {
        let is_there = |value: &&Vector3<f64>| value.iter().all(|v| v.is_finite());
        let bias = values.iter().find(is_there).copied().unwrap_or_default();
        let mut sums = Vec::with_capacity(values.len() + 1);
        let mut sum = Vector4::zeros();
        sums.push(sum);
        for value in values {
            sum += if is_there(&value) { (value - bias).push(0.0) } else { Vector4::w() };
            sums.push(sum);
        }
        Self(sums)
    }
}

/// Sampling interval of the data, and whether all time steps are equal.
#[derive(Clone, Copy)]
pub(super) struct Steps {
    /// Sampling interval, s: the mean of equal steps, otherwise the median.
    pub(super) interval_s: f64,
    /// Whether all time steps are equal.
    pub(super) are_even: bool,
}

impl Steps {
    fn of(time_s: &[f64]) -> Self {
        let [first, .., last] = *time_s else { return Self { interval_s: 0.0, are_even: true } };
        let mean_s = (last - first) / (time_s.len() - 1) as f64;
        let are_even = time_s.windows(2).all(|w| ((w[1] - w[0]) - mean_s).abs() <= EVEN * mean_s);
        Self { interval_s: if are_even { mean_s } else { sample_interval_s(time_s) }, are_even }
    }
}

/// A stencil with boxes (averaging intervals) of a given number of samples.
#[derive(Clone)]
pub(super) struct Stencil {
    pub(super) steps: Steps,
    /// Number of samples in a box.
    pub(super) stride: usize,
    /// Number of boxes. It is smaller than [`BOXES`] if the data have too few samples for five boxes.
    boxes: usize,
    /// Weights for equal time steps; `None` if the time steps are not equal.
    even: Option<Even>,
}

/// Weights of a stencil for equal time steps. These weights are the same at all samples.
#[derive(Clone)]
struct Even {
    /// Weights of the means over the boxes in each coefficient of the polynomial.
    polynomial: Polynomial,
    /// Weights of the means over the boxes. The weighted sum of the means is the slope at the middle sample.
    weights: [f64; BOXES],
    /// Weights of the cumulative sums at the edges of the boxes. The weighted sum of the cumulative sums is also the
    /// slope at the middle sample.
    edges: Edges,
}

/// Matrix with the weights of the means over the boxes (rows) in each coefficient of the polynomial (columns). The
/// variable of the polynomial is time in box widths. This time is zero at the middle sample of the stencil if the time
/// steps are equal, otherwise at the sample at which the derivative is computed.
type Polynomial = SMatrix<f64, BOXES, BOXES>;
/// Weights of the cumulative sums at the edges of consecutive boxes. The weighted sum of the cumulative sums is the
/// slope of the polynomial.
type Edges = [f64; BOXES + 1];

/// Converts weights of the means over the boxes to weights of the cumulative sums at the edges of the boxes.
fn edges(weights: &[f64; BOXES], stride: usize) -> Edges {
    std::array::from_fn(|edge| {
        let before = edge.checked_sub(1).map_or(0.0, |j| weights[j]);
        (before - weights.get(edge).unwrap_or(&0.0)) / stride as f64
    })
}

impl Stencil {
    /// The stencil with one sample in each box, for data at the times `time_s`.
    pub(super) fn narrow(time_s: &[f64]) -> Self {
        Self { steps: Steps::of(time_s), stride: 1, boxes: 0, even: None }.with(time_s, 1)
    }

    /// A stencil for the same data as this stencil, but with `stride` samples in each box.
    pub(super) fn with(&self, time_s: &[f64], stride: usize) -> Self {
        let boxes = (time_s.len() / stride).min(BOXES);
        let mut stencil = Self { steps: self.steps, stride, boxes, even: None };
        if self.steps.are_even && boxes == BOXES {
            stencil.even = stencil.powers(time_s, stencil.before(), 0).try_inverse().map(|polynomial| {
                let weights = stencil.slope_of(&polynomial, 0.0);
                Even { polynomial, weights, edges: edges(&weights, stride) }
            });
        }
        stencil
    }

    /// Number of samples from the start of the stencil to its middle sample. The derivative is computed at the middle
    /// sample, except near the ends of the data.
    fn before(&self) -> usize {
        self.stride / 2 + self.boxes / 2 * self.stride
    }

    /// Index of the first sample of the stencil for sample `k`. Near the ends of the data, the stencil is shifted so
    /// that it is inside the data.
    fn first(&self, samples: usize, k: usize) -> usize {
        k.saturating_sub(self.before()).min(samples - self.boxes * self.stride)
    }

    /// Returns the boxes (averaging intervals) from which the derivative at sample `k` is computed, and their weights.
    pub(super) fn at(&self, time_s: &[f64], k: usize) -> Boxes {
        let first = self.first(time_s.len(), k);
        let middle = first + self.before();
        let weights = match &self.even {
            Some(even) if middle == k => even.weights,
            Some(even) => self.slope_of(&even.polynomial, (k as f64 - middle as f64) / self.stride as f64),
            None => {
                let powers = self.powers(time_s, k, first).try_inverse();
                powers.map_or([f64::NAN; BOXES], |polynomial| self.slope_of(&polynomial, 0.0))
            }
        };
        Boxes { first, stride: self.stride, count: self.boxes, weights }
    }

    /// Index range of the samples at which the stencil can be centred without extending beyond the ends of the data.
    fn inside(&self, samples: usize) -> Range<usize> {
        self.before()..(samples + self.before() + 1).saturating_sub(self.boxes * self.stride)
    }

    /// The derivative at each sample, per second. `sums` contains the cumulative sums of the data.
    pub(super) fn slopes(&self, time_s: &[f64], sums: &Sums) -> Vec<Vector3<f64>> {
        let one_by_one = |range: Range<usize>| range.map(|k| self.at(time_s, k).slope(sums));
        let (n, inside) = (time_s.len(), self.inside(time_s.len()));
        if self.even.is_none() {
            return one_by_one(0..n).collect();
        }
        let mut slopes = Vec::with_capacity(n);
        slopes.extend(one_by_one(0..inside.start));
        // The centred stencil has the same weights at all samples of this range.
        let boxes = self.at(time_s, inside.start);
        Instructions::Best.run(Slopes { sums, boxes, places: inside.len(), slopes: &mut slopes });
        slopes.extend(one_by_one(inside.end..n));
        slopes
    }

    /// The weights of the stencil that is centred at a sample; `None` if the time steps are not equal.
    fn run(&self) -> Option<Run> {
        self.even.as_ref().map(|even| Run { before: self.before(), stride: self.stride, edges: even.edges })
    }

    /// Width of a box (averaging interval), s.
    fn width_s(&self) -> f64 {
        self.stride as f64 * self.steps.interval_s
    }

    /// Returns the means of 1, t, t^2, ... (rows) over each box (columns). t is the time since sample `k`, in box
    /// widths. The boxes begin at sample `first`. If there are fewer than five boxes, the polynomial has a lower
    /// degree.
    fn powers(&self, time_s: &[f64], k: usize, first: usize) -> Polynomial {
        let mut powers = Polynomial::identity();
        for (j, mut column) in powers.column_iter_mut().enumerate().take(self.boxes) {
            column.fill(0.0);
            for t in &time_s[first + j * self.stride..][..self.stride] {
                let mut power = 1.0 / self.stride as f64;
                let since = (t - time_s[k]) / self.width_s();
                for m in 0..self.boxes {
                    column[m] += power;
                    power *= since;
                }
            }
        }
        powers
    }

    /// Returns the weights of the means over the boxes that give the slope of `polynomial` at the time `at`. The slope
    /// is per second, and `at` is in box widths.
    fn slope_of(&self, polynomial: &Polynomial, at: f64) -> [f64; BOXES] {
        std::array::from_fn(|j| {
            let slope = (1..self.boxes).rev().fold(0.0, |slope, m| slope * at + m as f64 * polynomial[(j, m)]);
            slope / self.width_s()
        })
    }

    /// Whether noise with the standard deviation `sigma` explains the difference between the slopes of this stencil and
    /// of a narrower stencil. The noise must explain the difference in every segment of the data and on every axis.
    pub(super) fn agrees(&self, narrower: &Self, (time_s, sums): (&[f64], &Sums), sigma: &Vector3<f64>) -> bool {
        let n = time_s.len();
        let length = ((STRETCH_S / self.steps.interval_s) as usize).max(STRETCH_BOXES * self.stride);
        let inside = self.inside(n);
        let count = inside.len().div_ceil(length).max(1);
        // Slopes at neighbouring samples are highly correlated, so a comparison every half box width is sufficient.
        let apart = (self.stride / 2).max(length / MOST_LOOKS).max(1);
        let both = |k: usize| (self.at(time_s, k), narrower.at(time_s, k));
        let noise_of = |(wide, narrow): (Boxes, Boxes)| wide.noise_of_difference(&narrow);
        // With equal time steps, the noise of the difference between the slopes has the same variance at all samples.
        let runs = self.run().zip(narrower.run());
        let of_even = runs.map(|(wide, narrow)| ([wide, narrow], noise_of(both(self.before()))));
        (0..count).all(|part| {
            let range = inside.start + part * inside.len() / count..inside.start + (part + 1) * inside.len() / count;
            let (squares, explained) = match &of_even {
                Some((runs, noise)) => {
                    let (squares, looks) = Instructions::Best.run(Squares { sums, runs, places: range.step_by(apart) });
                    (squares, looks as f64 * noise)
                }
                None => {
                    let (mut squares, mut explained) = ([0.0; 3], 0.0);
                    for (wide, narrow) in range.step_by(apart).map(both) {
                        let difference = wide.slope(sums) - narrow.slope(sums);
                        if difference.iter().all(|d| d.is_finite()) {
                            (0..3).for_each(|axis| squares[axis] += difference[axis] * difference[axis]);
                            explained += noise_of((wide, narrow));
                        }
                    }
                    (squares, explained)
                }
            };
            (0..3).all(|axis| squares[axis] <= AGREE * explained * sigma[axis].powi(2))
        })
    }
}

/// A stencil for equal time steps. It is centred at a sample and has the same weights at all samples.
struct Run {
    /// Number of samples from the start of the stencil to the sample at which the derivative is computed.
    before: usize,
    stride: usize,
    edges: Edges,
}

/// Computation of the differences between the slopes of a wide and of a narrow stencil at the samples `places`. The
/// first result is the sum of the squared differences for each axis. The second result is the number of differences. A
/// sample is omitted if a value in the boxes of the wide stencil is missing.
struct Squares<'a> {
    sums: &'a Sums,
    runs: &'a [Run; 2],
    places: StepBy<Range<usize>>,
}

impl WithSimd for Squares<'_> {
    type Output = ([f64; 3], usize);

    #[inline(always)] // compiled for the widest SIMD registers of the processor
    fn with_simd<S: Simd>(self, _: S) -> Self::Output {
        let Self { sums: Sums(sums), runs: [wide, narrow], places } = self;
        let (mut squares, mut looks) = ([0.0; 4], 0);
        for k in places {
            let mut difference = [0.0; 4];
            let own = &sums[k - wide.before..];
            if own[0].w != own[BOXES * wide.stride].w {
                continue;
            }
            add(own, wide, 1.0, &mut difference);
            add(&sums[k - narrow.before..], narrow, -1.0, &mut difference);
            (0..4).for_each(|lane| squares[lane] += difference[lane] * difference[lane]);
            looks += 1;
        }
        ([squares[0], squares[1], squares[2]], looks)
    }
}

/// Computation of the slopes at `places` consecutive samples. The stencil is shifted from sample to sample.
struct Slopes<'a> {
    sums: &'a Sums,
    boxes: Boxes,
    places: usize,
    slopes: &'a mut Vec<Vector3<f64>>,
}

impl WithSimd for Slopes<'_> {
    type Output = ();

    #[inline(always)] // compiled for the widest SIMD registers of the processor
    fn with_simd<S: Simd>(self, _: S) {
        let Self { sums, mut boxes, places, slopes } = self;
        for _ in 0..places {
            slopes.push(boxes.slope(sums));
            boxes.first += 1;
        }
    }
}

/// Adds the slope of the stencil `run`, multiplied by `times`, to `to`. `sums` contains the cumulative sums from the
/// start of the stencil on.
#[inline(always)] // compiled for the SIMD registers of the caller
fn add(sums: &[Vector4<f64>], run: &Run, times: f64, to: &mut [f64; 4]) {
    for (edge, share) in run.edges.iter().enumerate() {
        let (sum, share) = (&sums[edge * run.stride], times * share);
        for lane in 0..4 {
            to[lane] += share * sum[lane];
        }
    }
}

/// The boxes (averaging intervals) from which the derivative at one sample is computed, and the weight of the mean over
/// each box.
pub(super) struct Boxes {
    /// Index of the first sample of the first box.
    first: usize,
    stride: usize,
    /// Number of boxes, at most five.
    count: usize,
    weights: [f64; BOXES],
}

impl Boxes {
    /// The derivative, per second. It is NaN if a value in the boxes is missing.
    #[inline(always)] // compiled for the SIMD registers of the caller
    pub(super) fn slope(&self, sums: &Sums) -> Vector3<f64> {
        let edge = |j: usize| &sums.0[self.first + j * self.stride];
        if edge(0).w != edge(self.count).w {
            return Vector3::repeat(f64::NAN);
        }
        let sum = |j: usize| edge(j + 1) - edge(j);
        // Means are taken relative to the middle box, because a common offset would cause rounding errors.
        let middle = sum(self.count / 2);
        let slope: Vector4<f64> = (0..self.count).map(|j| (sum(j) - middle) * self.weights[j]).sum();
        slope.xyz() / self.stride as f64
    }

    /// Variance of the difference between the slopes of this stencil and of a narrower stencil, for data that are white
    /// noise of unit variance.
    fn noise_of_difference(&self, narrower: &Self) -> f64 {
        let of = |boxes: &Self, k: usize| {
            let place = k.checked_sub(boxes.first).map(|k| k / boxes.stride);
            place.and_then(|j| boxes.weights.get(j)).map_or(0.0, |weight| weight / boxes.stride as f64)
        };
        let end = self.first + BOXES * self.stride;
        (self.first..end).map(|k| (of(self, k) - of(narrower, k)).powi(2)).sum()
    }
}
