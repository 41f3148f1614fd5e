//! Computes the time derivative of noisy data. The data are smoothed as far as the motion permits (model.md (16)).
//!
//! The derivative at a sample is the derivative of a polynomial of fourth degree. The polynomial is chosen so that its
//! means over five consecutive intervals ("boxes") equal the means of the data. The derivative is therefore a weighted
//! sum of the five means of the data, with weights that satisfy
//!
//! ```text
//! sum_j weight_j mean_j((t - t_k)^m) = 1 for m = 1,   = 0 for m = 0, 2, 3 and 4
//! ```
//!
//! t_k is the time of the sample, mean_j is the mean over the samples of box j, and weight_j is the weight of the mean
//! of the data over box j.
//!
//! The noise of the derivative is inversely proportional to the power 3/2 of the box width. The truncation error, which
//! depends on the motion, increases with the fourth power of the width. Several widths are tried. The boxes are widened
//! as long as noise alone explains the change of the derivative from one width to the next (after Lepski, Theory of
//! Probability and its Applications 35, 1991, 454-466). The chosen width is one step below the widest accepted width,
//! so the truncation error is an eighth of the error with the widest accepted width. If all widths that are tried are
//! accepted, the widest is chosen.

mod stencil;

use std::borrow::Cow;
use std::sync::OnceLock;

use nalgebra::Vector3;

use stencil::{BOXES, Stencil, Steps, Sums};

use crate::numerics::stats::{MEDIAN_SIZE, median};

/// Shortest width of the boxes (averaging intervals) that is tried, s. If the sampling interval is longer, the
/// narrowest boxes contain one sample. With boxes narrower than this limit, the error of the derivative due to noise
/// exceeds any truncation error.
const NARROWEST_S: f64 = 2e-3;
/// Largest width of the boxes (averaging intervals) that is tried, s. With wider boxes, a polynomial of fourth degree
/// does not describe the motion over five boxes.
const WIDEST_S: f64 = 0.1;
/// Ratio of consecutive box widths that are tried. With 1.7, the truncation error changes by a factor of eight from one
/// width to the next.
const WIDER: f64 = 1.7;
/// Minimum number of samples with which the box width is determined from the data. With fewer samples, noise and motion
/// cannot be separated, and each box has one sample.
const FEWEST: usize = 4 * BOXES;
/// The noise is estimated from fourth differences. In long data, only a subset of at least this number of differences
/// is used. Such a subset gives the noise with an accuracy of one per cent.
const ENOUGH: usize = 100_000;

/// A rule for the differentiation of data that were sampled at given times.
pub(crate) struct Derivative<'a> {
    /// Times of the samples without repetitions, s.
    time_s: Cow<'a, [f64]>,
    /// For each sample, the index of its time in `time_s`. If several samples have the same time, only the first of
    /// them is used. The list is empty if all times are distinct.
    places: Vec<usize>,
    stencil: Stencil,
}

/// Width of the boxes (averaging intervals) as a number of samples. The width is determined when it is first needed,
/// and then kept.
#[derive(Default)]
pub(crate) struct Width(OnceLock<usize>);

impl Width {
    /// Returns the differentiation rule with the widest boxes (groups of averaged samples) that do not distort the
    /// motion. `values` is evaluated only in the first call, which determines the width.
    pub(crate) fn derivative<'a>(
        &self,
        time_s: &'a [f64],
        values: impl FnOnce() -> Vec<Vector3<f64>>,
    ) -> Derivative<'a> {
        let mut derivative = Derivative::narrow(time_s);
        let stride = *self.0.get_or_init(|| derivative.smoothed(&values()).stride);
        if stride > 1 {
            derivative.stencil = derivative.stencil.with(&derivative.time_s, stride);
        }
        derivative
    }
}

impl<'a> Derivative<'a> {
    /// Differentiation rule without smoothing: the polynomial passes through neighbouring samples, at most five.
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

    /// Differentiation rule with the widest boxes (averaging intervals) that the motion in `values` permits.
    pub(crate) fn smooth(time_s: &'a [f64], values: &[Vector3<f64>]) -> Self {
        let mut derivative = Self::narrow(time_s);
        derivative.stencil = derivative.smoothed(values);
        derivative
    }

    /// Returns the stencil (five boxes and their weights) with the widest boxes that the motion in `values` permits.
    fn smoothed(&self, values: &[Vector3<f64>]) -> Stencil {
        let (values, times, narrow) = (self.distinct(values), &self.time_s, &self.stencil);
        let (n, interval_s) = (values.len(), narrow.steps.interval_s);
        if n < FEWEST || interval_s <= 0.0 {
            return narrow.clone();
        }
        let (sums, sigma) = (Sums::new(&values), noise(narrow.steps, times, &values));
        let widest = ((WIDEST_S / interval_s) as usize).min(n / BOXES).max(1);
        let mut stride = ((NARROWEST_S / interval_s).round() as usize).clamp(1, widest);
        let (mut chosen, mut last) = (narrow.clone(), narrow.with(times, stride));
        loop {
            stride = (stride + 1).max((stride as f64 * WIDER).round() as usize);
            if stride > widest {
                return last;
            }
            let wider = last.with(times, stride);
            if !wider.agrees(&last, (times, &sums), &sigma) {
                return chosen;
            }
            chosen = std::mem::replace(&mut last, wider);
        }
    }

    /// The derivative of `values` with respect to time at each sample, per second. The result is empty if fewer than
    /// two times are distinct.
    pub(crate) fn of(&self, values: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
        let distinct = self.distinct(values);
        if distinct.len() < 2 {
            return Vec::new();
        }
        let slopes = self.stencil.slopes(&self.time_s, &Sums::new(&distinct));
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

/// Standard deviation of the white noise of a sample, for each axis. It is computed from fourth divided differences of
/// the samples, because smooth motion hardly changes these differences.
fn noise(steps: Steps, time_s: &[f64], values: &[Vector3<f64>]) -> Vector3<f64> {
    let apart = (values.len() / ENOUGH).max(1);
    let of_even = steps.are_even.then(|| weights_of_noise(&[0.0, 1.0, 2.0, 3.0, 4.0]));
    Vector3::from_fn(|axis, _| {
        let values: Vec<f64> = values.iter().map(|v| v[axis]).collect();
        let size = |weights: &[f64; BOXES], v: &[f64]| v.iter().zip(weights).map(|(v, w)| v * w).sum::<f64>().abs();
        let windows = values.windows(BOXES).step_by(apart);
        let mut sizes: Vec<f64> = match &of_even {
            Some(weights) => windows.map(|v| size(weights, v)).collect(),
            None => {
                time_s.windows(BOXES).step_by(apart).zip(windows).map(|(t, v)| size(&weights_of_noise(t), v)).collect()
            }
        };
        sizes.retain(|size| size.is_finite());
        if sizes.is_empty() { 0.0 } else { median(&mut sizes) / MEDIAN_SIZE }
    })
}

/// Weights with which the values at the five times `t` enter their fourth divided difference. The weights are scaled so
/// that the sum of their squares is one. The weighted sum then has the same variance as the white noise of a value.
fn weights_of_noise(t: &[f64]) -> [f64; BOXES] {
    let others = |j: usize| (0..BOXES).filter(move |i| *i != j);
    let weights: [f64; BOXES] = std::array::from_fn(|j| others(j).map(|i| t[j] - t[i]).product::<f64>().recip());
    let norm = weights.iter().map(|w| w * w).sum::<f64>().sqrt();
    weights.map(|weight| weight / norm)
}

#[cfg(test)]
mod tests;
