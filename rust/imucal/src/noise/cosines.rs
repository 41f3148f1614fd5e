//! Computes the power spectrum of a record by cosine transforms. The elements of the cosine transform of power-law
//! noise are uncorrelated, exactly or nearly (section (31) of `docs/model.md`).
//!
//! ```text
//! z_j = sqrt(2 / W) sum over t = 0 to W - 1 of y_t cos(pi j (t + 1/2) / W),    j = 1 to W - 1
//! ```
//!
//! A window consists of W consecutive values y, and z_j is its cosine transform. The z_j of a window are exactly
//! independent if the values y are white noise, a random walk, or means of consecutive samples of such noise. A Fourier
//! transform does not have this property, because the difference between the two ends of a random walk leaks into all
//! frequencies. For flicker noise, the z_j are only nearly independent, but the variances of the z_j that are computed
//! here are exact.
//!
//! A long record is processed in stages. The first stage has windows of 32 samples. The next stage has windows of 32
//! values, each of which is the mean of a window of the first stage, and so on. The last stage is a single window with
//! fewer than 2048 values. In every stage before the last, the power z_j^2 of each j is averaged over all windows.

use std::f64::consts::PI;

use super::power_law::{KINDS, PerKind, mean_covariance};
use crate::cancellation::checkpoint;

/// Number W of values in a window, in every stage except the last.
const WINDOW: usize = 32;
const HALF: usize = WINDOW / 2;
/// If a stage has fewer values than this number, they are transformed as one window, and this stage is the last one.
/// The values are the samples of the record or the window means of the previous stage.
const LAST_WINDOW: usize = 2048;
/// After this number of windows, the transform tests whether the calculation was cancelled. Transforming this number of
/// windows takes less than a millisecond.
const WINDOWS_PER_CHECKPOINT: usize = 1024;
/// Relative width of the frequency bands over which the powers of the last window are averaged.
const POOLED_SHARE: f64 = 0.03;

/// Mean power of the spectrum at a frequency. `dof` x (this power) / (expected power) has a chi-square distribution
/// with `dof` degrees of freedom.
#[derive(Clone, Copy, Debug)]
pub(super) struct Power {
    pub(super) value: f64,
    pub(super) dof: f64,
    /// For each kind of noise: the expected power if only this noise is present and its parameter is one.
    pub(super) expected: PerKind,
    /// Frequency in periods per sample.
    pub(super) frequency: f64,
}

impl Power {
    /// Number of octaves by which the frequency is below half the sampling rate, rounded down; 0 in the highest octave.
    pub(super) fn octave(&self) -> u32 {
        (-(2.0 * self.frequency).log2()).floor().max(0.0) as u32
    }
}

/// The stages of the cosine transform of a record of given length (see the module documentation), with the expected
/// powers of each stage.
pub(super) struct Layout {
    stages: Vec<Stage>,
}

struct Stage {
    /// Number of windows.
    windows: usize,
    /// Number of values in a window.
    width: usize,
    /// Number of samples of the record whose mean is one value of a window.
    length: f64,
    /// Expected values of the powers z_j^2 of the cosine transform of a window, for j = 1, 2, ...
    expected: Vec<PerKind>,
}

impl Layout {
    /// The stages of the transform for a record of `samples` samples.
    pub(super) fn new(samples: usize) -> Self {
        let mut stages = Vec::new();
        let (mut left, mut length) = (samples, 1.0);
        while left >= LAST_WINDOW {
            left /= WINDOW;
            stages.push(Stage { windows: left, width: WINDOW, length, expected: expected_powers(length, WINDOW) });
            length *= WINDOW as f64;
        }
        stages.push(Stage { windows: 1, width: left, length, expected: expected_powers(length, left) });
        Self { stages }
    }

    /// Powers of the spectrum of a record. `values` must have as many samples as the record for which this layout was
    /// created.
    pub(super) fn powers(&self, values: impl Iterator<Item = f64>) -> Vec<Power> {
        let mut powers = Vec::new();
        let Some((last, before)) = self.stages.split_last() else {
            return powers;
        };
        let tables = Tables::new();
        let mut means: Option<Vec<f64>> = None;
        let mut values = Some(values);
        for stage in before {
            let (sums, next) = match (means.take(), values.take()) {
                (Some(means), _) => tables.pass(means.into_iter(), stage.windows),
                (None, Some(values)) => tables.pass(values, stage.windows),
                (None, None) => break,
            };
            for (k, (sum, expected)) in sums.iter().zip(&stage.expected).enumerate() {
                powers.push(stage.power(k + 1, sum / stage.windows as f64, stage.windows as f64, *expected));
            }
            means = Some(next);
        }
        let window = means.or_else(|| values.map(Iterator::collect)).unwrap_or_default();
        powers.extend(pooled(&squared_cosines(&window), &last.expected, last.length));
        powers
    }
}

impl Stage {
    fn power(&self, j: usize, value: f64, dof: f64, expected: PerKind) -> Power {
        Power { value, dof, expected, frequency: j as f64 / (2.0 * self.width as f64 * self.length) }
    }
}

/// The powers of one window, averaged over frequency bands of the relative width [`POOLED_SHARE`]. `squares` contains
/// the powers z_j^2 of the cosine transform of the window for j = 1, 2, ..., and `expected` contains their expected
/// values. Each value of the window is a mean over `length` samples.
pub(super) fn pooled(squares: &[f64], expected: &[PerKind], length: f64) -> Vec<Power> {
    let width = squares.len() + 1;
    let mut powers = Vec::new();
    let mut first = 1;
    while first < width {
        let count = ((first as f64 * POOLED_SHARE) as usize).max(1).min(width - first);
        let places = first - 1..first - 1 + count;
        let mean = |values: &mut dyn Iterator<Item = f64>| values.sum::<f64>() / count as f64;
        powers.push(Power {
            value: mean(&mut squares[places.clone()].iter().copied()),
            dof: count as f64,
            expected: std::array::from_fn(|kind| mean(&mut expected[places.clone()].iter().map(|e| e[kind]))),
            frequency: (first as f64 + (count - 1) as f64 / 2.0) / (2.0 * width as f64 * length),
        });
        first += count;
    }
    powers
}

/// Expected power z_j^2 of the cosine transform of a window of W values, for j = 1 to W - 1:
///
/// ```text
/// E z_j^2 = c_0 + (2 / W) sum over d = 1 to W - 1 of c_d ((W - d) cos(a d) - sin(a d) / sin(a)),    a = pi j / W
/// ```
///
/// Each value of the window is a mean over `length` samples, and c_d is the covariance of two values of the window
/// whose indices differ by d. Adding a constant to all c_d does not change the result.
pub(super) fn expected_powers(length: f64, width: usize) -> Vec<PerKind> {
    let covariance: Vec<PerKind> = (0..width).map(|d| mean_covariance(length, d as f64)).collect();
    let table: Vec<(f64, f64)> = (0..2 * width).map(|k| (PI * k as f64 / width as f64).sin_cos()).collect();
    (1..width)
        .map(|j| {
            let mut power = covariance[0];
            let sine = table[j].0;
            let mut at = 0;
            for d in 1..width {
                at = (at + j) % (2 * width);
                let (sin, cos) = table[at];
                let factor = 2.0 / width as f64 * ((width - d) as f64 * cos - sin / sine);
                (0..KINDS).for_each(|kind| power[kind] += factor * covariance[d][kind]);
            }
            power
        })
        .collect()
}

/// The squares z_j^2 of the cosine transform of one window.
fn squared_cosines(window: &[f64]) -> Vec<f64> {
    let width = window.len();
    let table: Vec<f64> = (0..4 * width).map(|k| (PI * k as f64 / (2.0 * width as f64)).cos()).collect();
    let origin = window.first().copied().unwrap_or(0.0);
    (1..width)
        .map(|j| {
            let mut at = j;
            let mut sum = 0.0;
            for value in window {
                sum += (value - origin) * table[at];
                at = (at + 2 * j) % (4 * width);
            }
            sum * sum * 2.0 / width as f64
        })
        .collect()
}

/// Cosines sqrt(2 / W) cos(pi j (t + 1/2) / W) of the transform of a window of W = 32 values. The first index is the
/// position t in the first half of the window. The second index is k, for j = 2 k + 2 in `even` and j = 2 k + 1 in
/// `odd`. For even j, the transform uses the sum of the first half and the mirrored second half. For odd j, the
/// transform uses the difference of the two halves.
struct Tables {
    even: [[f64; HALF]; HALF],
    odd: [[f64; HALF]; HALF],
}

impl Tables {
    fn new() -> Self {
        let cosine = |j: usize, t: usize| {
            (2.0 / WINDOW as f64).sqrt() * (PI * j as f64 * (t as f64 + 0.5) / WINDOW as f64).cos()
        };
        Self {
            even: std::array::from_fn(|t| std::array::from_fn(|k| cosine(2 * k + 2, t))),
            odd: std::array::from_fn(|t| std::array::from_fn(|k| cosine(2 * k + 1, t))),
        }
    }

    /// Transforms the first `windows` windows of `values`. Returns, for each j, the sum of the powers z_j^2 over all
    /// windows, and the mean of each window.
    fn pass(&self, mut values: impl Iterator<Item = f64>, windows: usize) -> ([f64; WINDOW - 1], Vec<f64>) {
        let mut sums = [0.0; WINDOW - 1];
        let mut means = Vec::with_capacity(windows);
        for number in 0..windows {
            if number % WINDOWS_PER_CHECKPOINT == 0 {
                checkpoint();
            }
            let mut window = [0.0; WINDOW];
            window.iter_mut().zip(&mut values).for_each(|(place, value)| *place = value);
            let origin = window[0];
            let (mut even, mut odd, mut total) = ([0.0; HALF], [0.0; HALF], 0.0);
            for t in 0..HALF {
                let (front, back) = (window[t] - origin, window[WINDOW - 1 - t] - origin);
                total += front + back;
                for k in 0..HALF {
                    even[k] += (front + back) * self.even[t][k];
                    odd[k] += (front - back) * self.odd[t][k];
                }
            }
            for k in 0..HALF {
                sums[2 * k] += odd[k] * odd[k];
                // The last even index, j = 32, is skipped, because all its cosines are zero.
                if k < HALF - 1 {
                    sums[2 * k + 1] += even[k] * even[k];
                }
            }
            means.push(origin + total / WINDOW as f64);
        }
        (sums, means)
    }
}

#[cfg(test)]
mod tests {
    use super::super::power_law::{FLICKER, QUANTISATION, WALK, WHITE};
    use super::*;

    /// For the element z_j = v^T y of the cosine transform of a window y, where v is a vector of cosines, the expected
    /// power must equal v^T C v. C is the covariance matrix of the window.
    #[test]
    fn expected_powers_are_quadratic_forms_of_the_covariance() {
        let (width, length) = (24, 5.0);
        let powers = expected_powers(length, width);
        for j in 1..width {
            let v: Vec<f64> = (0..width)
                .map(|t| (2.0 / width as f64).sqrt() * (PI * j as f64 * (t as f64 + 0.5) / width as f64).cos())
                .collect();
            for kind in [WHITE, FLICKER, WALK, QUANTISATION] {
                let mut form = 0.0;
                for t in 0..width {
                    for u in 0..width {
                        form += v[t] * v[u] * mean_covariance(length, t.abs_diff(u) as f64)[kind];
                    }
                }
                assert!((powers[j - 1][kind] / form - 1.0).abs() < 1e-9, "{kind} {j}: {} {form}", powers[j - 1][kind]);
            }
        }
    }

    #[test]
    fn powers_of_a_random_walk_are_those_of_its_steps() {
        // By summation by parts, element z_j of a random walk equals (element j of the sine transform of its steps) /
        // (2 sin(pi j / (2 W))). The steps are independent with variance one, so the elements of their sine transform
        // also have variance one.
        let width = 100;
        for (j, power) in expected_powers(1.0, width).iter().enumerate() {
            let sine = 2.0 * (PI * (j + 1) as f64 / (2.0 * width as f64)).sin();
            assert!((power[WALK] * sine * sine - 1.0).abs() < 1e-9);
            assert!((power[WHITE] - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn the_fast_pass_and_the_plain_sum_agree() {
        let values: Vec<f64> = (0..WINDOW).map(|t| 9.8 + ((t * t) as f64).sin()).collect();
        let (sums, means) = Tables::new().pass(values.iter().copied(), 1);
        for (fast, plain) in sums.iter().zip(squared_cosines(&values)) {
            assert!((fast - plain).abs() < 1e-12);
        }
        assert!((means[0] - values.iter().sum::<f64>() / WINDOW as f64).abs() < 1e-13);
    }

    #[test]
    fn a_record_has_all_its_degrees_of_freedom() {
        for samples in [100, 2047, 65_536] {
            let values = (0..samples).map(|i| ((i * i) as f64).sin());
            let powers = Layout::new(samples).powers(values.clone());
            let total: f64 = powers.iter().map(|p| p.dof).sum();
            assert_eq!(total, samples as f64 - 1.0);
            // Parseval's theorem: the weighted sum of the powers equals the sum of squares about the mean.
            let mean = values.clone().sum::<f64>() / samples as f64;
            let square: f64 = values.map(|v| (v - mean) * (v - mean)).sum();
            let mut weighted = 0.0;
            for power in &powers {
                // Each value of a later stage is a mean over several samples, so white noise has a smaller expected
                // power in later stages. Each power is therefore divided by its expected power before the stages are
                // added.
                weighted += power.value * power.dof / power.expected[WHITE];
            }
            assert!((weighted / square - 1.0).abs() < 1e-9, "{samples}: {weighted} {square}");
        }
    }
}
