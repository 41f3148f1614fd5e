//! The derivative by time of columns that hold noise, as smooth as their motion allows.
//!
//! At each sample it is that of the polynomial of fourth degree whose means over five boxes in a row are those of the values:
//!
//! ```text
//! sum_j weight_j mean over box j of (t - t_k)^m = 1 for m = 1, 0 for m = 0, 2, 3, 4
//! ```
//!
//! Its noise falls with the power 3/2 of the width of a box, the error of a motion grows with the fourth. So boxes are widened
//! as long as what they say differs from what the narrower ones say by no more than noise (after Lepski, Theory of Probability and
//! its Applications 35, 1991, 454-466), and then narrowed again by one step, where the motion's error is an eighth of that.

use std::borrow::Cow;
use std::sync::OnceLock;

use nalgebra::{SMatrix, SVector, Vector3, Vector4};

use crate::segment::sample_interval_s;
use crate::stats::{MEDIAN_SIZE, median};

/// Boxes whose means give the polynomial.
const BOXES: usize = 5;
/// The narrowest box, s, or one sample: closer values differ by more noise than motion.
const NARROWEST_S: f64 = 2e-3;
/// The widest: no motion stays a polynomial for five of these, s.
const WIDEST_S: f64 = 0.1;
/// From one width to the next.
const WIDER: f64 = 1.7;
/// Of the squares that noise explains of a difference.
const AGREE: f64 = 2.0;
/// Every stretch as long as this has to agree, s, and of as many boxes at least.
const STRETCH_S: f64 = 1.0;
const STRETCH_BOXES: usize = 20;
/// At so many places of it.
const MOST_LOOKS: usize = 100;
/// Fewer samples do not tell noise from motion.
const FEWEST: usize = 4 * BOXES;
/// So many differences say what noise is to a per cent.
const ENOUGH: usize = 100_000;
/// Steps that differ by a smaller share are even.
const EVEN: f64 = 1e-9;

/// How a derivative is taken at given times.
pub(crate) struct Derivative<'a> {
    time_s: Cow<'a, [f64]>,
    /// Of samples at one time the first counts: the place of each sample among those. Empty where all count.
    places: Vec<usize>,
    stencil: Stencil,
}

/// Samples in a box, once it is known how smooth a motion is.
#[derive(Default)]
pub(crate) struct Width(OnceLock<usize>);

impl Width {
    /// As smooth as the motion in the values allows, which are asked for the first time.
    pub(crate) fn derivative<'a>(
        &self,
        time_s: &'a [f64],
        values: impl FnOnce() -> Vec<Vector3<f64>>,
    ) -> Derivative<'a> {
        let stride = *self.0.get_or_init(|| Derivative::smooth(time_s, &values()).stencil.stride);
        let mut derivative = Derivative::narrow(time_s);
        if stride > 1 {
            derivative.stencil = derivative.stencil.with(&derivative.time_s, stride);
        }
        derivative
    }
}

impl<'a> Derivative<'a> {
    /// By the polynomials through neighbouring samples.
    pub(crate) fn narrow(time_s: &'a [f64]) -> Self {
        let is_again = |k: usize| k > 0 && time_s[k] == time_s[k - 1];
        let (mut distinct, mut places) = (Cow::Borrowed(time_s), Vec::new());
        if (0..time_s.len()).any(is_again) {
            distinct = (0..time_s.len()).filter(|k| !is_again(*k)).map(|k| time_s[k]).collect();
            let place = |seen: &mut usize, k: usize| {
                *seen += usize::from(!is_again(k));
                Some(*seen - 1)
            };
            places = (0..time_s.len()).scan(0, place).collect();
        }
        let stencil = Stencil::narrow(&distinct);
        Self { time_s: distinct, places, stencil }
    }

    /// As smooth as the motion in `values` allows.
    pub(crate) fn smooth(time_s: &'a [f64], values: &[Vector3<f64>]) -> Self {
        let mut derivative = Self::narrow(time_s);
        let values = derivative.distinct(values);
        let times = &derivative.time_s;
        let (n, interval_s) = (values.len(), derivative.stencil.steps.interval_s);
        if n < FEWEST || interval_s <= 0.0 {
            return derivative;
        }
        let (sums, sigma) = (Sums::new(&values), noise(derivative.stencil.steps, times, &values));
        let widest = ((WIDEST_S / interval_s) as usize).min(n / BOXES).max(1);
        let mut stride = ((NARROWEST_S / interval_s).round() as usize).clamp(1, widest);
        let mut last = derivative.stencil.with(times, stride);
        loop {
            stride = (stride + 1).max((stride as f64 * WIDER).round() as usize);
            if stride > widest {
                derivative.stencil = last;
                return derivative;
            }
            let wider = last.with(times, stride);
            if !wider.agrees(&last, (times, &sums), &sigma) {
                return derivative;
            }
            derivative.stencil = std::mem::replace(&mut last, wider);
        }
    }

    /// The derivative of values at these times, one for each; none for a single one.
    pub(crate) fn of(&self, values: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
        let distinct = self.distinct(values);
        if distinct.len() < 2 {
            return Vec::new();
        }
        let sums = Sums::new(&distinct);
        let slopes: Vec<Vector3<f64>> =
            (0..distinct.len()).map(|k| self.stencil.at(&self.time_s, k).slope(&sums)).collect();
        if self.places.is_empty() { slopes } else { self.places.iter().map(|place| slopes[*place]).collect() }
    }

    fn distinct<'v>(&self, values: &'v [Vector3<f64>]) -> Cow<'v, [Vector3<f64>]> {
        let is_first = |k: &usize| *k == 0 || self.places[*k] != self.places[k - 1];
        match self.places.is_empty() {
            true => values.into(),
            false => (0..values.len()).filter(is_first).map(|k| values[k]).collect(),
        }
    }
}

/// White noise of a sample on each axis, from fourth divided differences: motion is too smooth to show in them.
fn noise(steps: Steps, time_s: &[f64], values: &[Vector3<f64>]) -> Vector3<f64> {
    let mut sizes: [Vec<f64>; 3] = [const { Vec::new() }; 3];
    let apart = (values.len() / ENOUGH).max(1);
    let of_even = steps.are_even.then(|| weights_of_noise(&[0.0, 1.0, 2.0, 3.0, 4.0]));
    for (t, v) in time_s.windows(BOXES).zip(values.windows(BOXES)).step_by(apart) {
        let weights = of_even.unwrap_or_else(|| weights_of_noise(t));
        let difference: Vector3<f64> = v.iter().zip(weights).map(|(v, w)| v * w).sum();
        sizes.iter_mut().zip(&difference).for_each(|(sizes, d)| sizes.extend(d.is_finite().then(|| d.abs())));
    }
    let [x, y, z] = sizes.map(|mut sizes| if sizes.is_empty() { 0.0 } else { median(&mut sizes) / MEDIAN_SIZE });
    Vector3::new(x, y, z)
}

/// What values at these times add to their divided difference, all squares together being one.
fn weights_of_noise(t: &[f64]) -> [f64; BOXES] {
    let others = |j: usize| (0..BOXES).filter(move |i| *i != j);
    let weights: [f64; BOXES] = std::array::from_fn(|j| others(j).map(|i| t[j] - t[i]).product::<f64>().recip());
    let norm = weights.iter().map(|w| w * w).sum::<f64>().sqrt();
    weights.map(|weight| weight / norm)
}

/// Running sums of values, and after them how many are missing: four numbers side by side are added at once.
struct Sums(Vec<Vector4<f64>>);

impl Sums {
    fn new(values: &[Vector3<f64>]) -> Self {
        let mut sums = Vec::with_capacity(values.len() + 1);
        let mut sum = Vector4::zeros();
        sums.push(sum);
        for value in values {
            sum += if value.iter().all(|v| v.is_finite()) { value.push(0.0) } else { Vector4::w() };
            sums.push(sum);
        }
        Self(sums)
    }
}

/// The steps in time.
#[derive(Clone, Copy)]
struct Steps {
    interval_s: f64,
    are_even: bool,
}

/// Boxes of one width.
struct Stencil {
    steps: Steps,
    /// Samples in a box.
    stride: usize,
    boxes: usize,
    /// The weights away from the ends, where steps are even.
    inside: Option<[f64; BOXES]>,
}

impl Stencil {
    /// A sample in each box.
    fn narrow(time_s: &[f64]) -> Self {
        let interval_s = if time_s.len() > 1 { sample_interval_s(time_s) } else { 0.0 };
        let is_even = |w: &[f64]| ((w[1] - w[0]) - interval_s).abs() <= EVEN * interval_s;
        let steps = Steps { interval_s, are_even: time_s.windows(2).all(is_even) };
        Self { steps, stride: 1, boxes: 0, inside: None }.with(time_s, 1)
    }

    /// So many samples in each box, at the same times.
    fn with(&self, time_s: &[f64], stride: usize) -> Self {
        let boxes = (time_s.len() / stride).min(BOXES);
        let mut stencil = Self { steps: self.steps, stride, boxes, inside: None };
        if self.steps.are_even && boxes == BOXES {
            stencil.inside = Some(stencil.weights(time_s, stencil.before(), 0));
        }
        stencil
    }

    /// Samples of the boxes before the one that they are about.
    fn before(&self) -> usize {
        self.stride / 2 + self.boxes / 2 * self.stride
    }

    /// The first sample of the boxes about sample `k`: at the ends those that have room there.
    fn first(&self, samples: usize, k: usize) -> usize {
        k.saturating_sub(self.before()).min(samples - self.boxes * self.stride)
    }

    /// The boxes about sample `k`.
    fn at(&self, time_s: &[f64], k: usize) -> Boxes {
        let first = self.first(time_s.len(), k);
        let weights = match self.inside {
            Some(weights) if first + self.before() == k => weights,
            _ => self.weights(time_s, k, first),
        };
        Boxes { first, stride: self.stride, count: self.boxes, weights }
    }

    /// The weights at sample `k` of boxes from sample `first` on; NaN where times do not determine them.
    fn weights(&self, time_s: &[f64], k: usize, first: usize) -> [f64; BOXES] {
        let unit_s = self.stride as f64 * self.steps.interval_s;
        // With fewer boxes the polynomial is of a lower degree.
        let mut powers = SMatrix::<f64, BOXES, BOXES>::identity();
        for (j, mut column) in powers.column_iter_mut().enumerate().take(self.boxes) {
            column.fill(0.0);
            for t in &time_s[first + j * self.stride..][..self.stride] {
                let mut power = 1.0 / self.stride as f64;
                for m in 0..self.boxes {
                    column[m] += power;
                    power *= (t - time_s[k]) / unit_s;
                }
            }
        }
        let mut slope = SVector::<f64, BOXES>::zeros();
        slope[1] = 1.0 / unit_s;
        powers.lu().solve(&slope).map_or([f64::NAN; BOXES], Into::into)
    }

    /// Whether the slopes of both differ by no more than noise of `sigma` makes of it, in every stretch and on every axis.
    fn agrees(&self, narrower: &Self, (time_s, sums): (&[f64], &Sums), sigma: &Vector3<f64>) -> bool {
        let n = time_s.len();
        let length = ((STRETCH_S / self.steps.interval_s) as usize).max(STRETCH_BOXES * self.stride);
        let inside = self.before()..(n + self.before() + 1).saturating_sub(self.boxes * self.stride);
        let count = inside.len().div_ceil(length).max(1);
        // Neighbouring slopes are of nearly the same samples.
        let apart = (self.stride / 2).max(length / MOST_LOOKS).max(1);
        let both = |k: usize| (self.at(time_s, k), narrower.at(time_s, k));
        let noise_of = |(wide, narrow): (Boxes, Boxes)| wide.noise_of_difference(&narrow);
        // Of even steps it is the same everywhere.
        let of_even = self.inside.map(|_| noise_of(both(self.before())));
        (0..count).all(|part| {
            let range = inside.start + part * inside.len() / count..inside.start + (part + 1) * inside.len() / count;
            let (mut squares, mut explained) = (Vector3::zeros(), 0.0);
            for (wide, narrow) in range.step_by(apart).map(both) {
                let difference = wide.slope(sums) - narrow.slope(sums);
                if difference.iter().all(|d| d.is_finite()) {
                    squares += difference.map(|d| d * d);
                    explained += of_even.unwrap_or_else(|| noise_of((wide, narrow)));
                }
            }
            (0..3).all(|axis| squares[axis] <= AGREE * explained * sigma[axis].powi(2))
        })
    }
}

/// Boxes in a row and what each adds to a derivative.
struct Boxes {
    first: usize,
    stride: usize,
    count: usize,
    weights: [f64; BOXES],
}

impl Boxes {
    /// NaN if a value is missing.
    fn slope(&self, sums: &Sums) -> Vector3<f64> {
        let edge = |j: usize| &sums.0[self.first + j * self.stride];
        if edge(0).w != edge(self.count).w {
            return Vector3::repeat(f64::NAN);
        }
        let sum = |j: usize| edge(j + 1) - edge(j);
        // Of what differs from the middle: a large bias is no reason for a large rounding error.
        let middle = sum(self.count / 2);
        let slope: Vector4<f64> = (0..self.count).map(|j| (sum(j) - middle) * self.weights[j]).sum();
        slope.xyz() / self.stride as f64
    }

    /// The variance of the difference to narrower ones for values with noise of one.
    fn noise_of_difference(&self, narrower: &Self) -> f64 {
        let of = |boxes: &Self, k: usize| {
            let place = k.checked_sub(boxes.first).map(|k| k / boxes.stride);
            place.and_then(|j| boxes.weights.get(j)).map_or(0.0, |weight| weight / boxes.stride as f64)
        };
        let end = self.first + BOXES * self.stride;
        (self.first..end).map(|k| (of(self, k) - of(narrower, k)).powi(2)).sum()
    }
}

#[cfg(test)]
mod tests;
