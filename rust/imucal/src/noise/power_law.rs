//! Computes covariances and the Allan variance of each kind of noise (section (30) of `docs/model.md`).
//!
//! Let x be the samples at a sampling rate of one, and p their cumulative sums. In general, the covariance of p is not
//! stationary, but the covariance of the second differences of p is stationary. The function s(k) replaces the
//! covariance of p: if `E p_i p_j` is set to `s(i - j)`, the covariances of all second differences of p are correct.
//!
//! ```text
//! white         x = n                       s(k) = -|k| / 2
//! flicker       x = (1 - z^-1)^(-1/2) n     s(k) = (2/pi) (h(j) (j^2/2 + j + 3/8) - (3/8) j^2 - j/2),
//!                                                   j = |k| - 1,  h(j) = 1 + 1/3 + ... + 1/(2j - 1)
//! random walk   x = (1 - z^-1)^-1 n         s(k) = (|k|^3 - |k|) / 12
//! quantisation  x = (1 - z^-1) n            s(k) = 1 for k = 0, else 0
//! ```
//!
//! n is white noise of variance one, and z^-1 is the delay by one sample. For flicker noise, s(0) = s(1) = 0. The
//! covariances of the second differences of p are exact, even if x itself has no stationary covariance. Flicker noise
//! is an example of such an x.

use std::f64::consts::{LN_2, PI};

/// Number of kinds of noise. All vectors of noise parameters have the order white, flicker, random walk, quantisation.
pub(super) const KINDS: usize = 4;
/// Index of white noise.
pub(super) const WHITE: usize = 0;
/// Index of flicker noise.
pub(super) const FLICKER: usize = 1;
/// Index of the random walk.
pub(super) const WALK: usize = 2;
/// Index of quantisation noise.
pub(super) const QUANTISATION: usize = 3;

/// One number for each kind of noise, in the order white, flicker, random walk, quantisation.
pub(super) type PerKind = [f64; KINDS];

/// The function s(k) for each kind of noise, generated from white noise n of variance one. s(k) replaces the covariance
/// of two cumulative sums whose indices differ by k samples (see the module documentation).
fn sums_covariance(k: f64) -> PerKind {
    let k = k.abs();
    let j = (k - 1.0).max(0.0);
    let flicker = 2.0 / PI * (odd_harmonic(j) * (j * j / 2.0 + j + 0.375) - 0.375 * j * j - j / 2.0);
    [-k / 2.0, flicker, (k * k * k - k) / 12.0, if k == 0.0 { 1.0 } else { 0.0 }]
}

/// The sum `1 + 1/3 + ... + 1/(2j - 1)`.
fn odd_harmonic(j: f64) -> f64 {
    const EULER: f64 = 0.577_215_664_901_532_9;
    if j < 32.0 {
        return (1..=j as u32).map(|i| 1.0 / f64::from(2 * i - 1)).sum();
    }
    let square = 1.0 / (j * j);
    // The asymptotic series of the sum for large j. The first omitted term is smaller than 1e-13.
    0.5 * (j.ln() + EULER + 2.0 * LN_2) + square * (1.0 / 48.0 + square * (-7.0 / 1920.0 + square * 31.0 / 16128.0))
}

fn combine(terms: &[(f64, f64)], divisor: f64) -> PerKind {
    let mut sum = [0.0; KINDS];
    for &(factor, k) in terms {
        let s = sums_covariance(k);
        (0..KINDS).for_each(|kind| sum[kind] += factor * s[kind] / divisor);
    }
    sum
}

/// Returns, for each kind of noise generated from n of variance one, the covariance of two means, each over `length`
/// samples. The second mean starts `lag` x `length` samples after the first. The result lacks an additive constant that
/// is the same for all lags, so only differences of the results for several lags are meaningful.
pub(super) fn mean_covariance(length: f64, lag: f64) -> PerKind {
    let at = |d: f64| (lag + d) * length;
    combine(&[(-1.0, at(1.0)), (2.0, at(0.0)), (-1.0, at(-1.0))], length * length)
}

/// Returns, for each kind of noise generated from n of variance one, the covariance of two differences that are `lag`
/// samples apart. Each difference is between two consecutive means over `factor` samples.
fn difference_covariance(factor: f64, lag: f64) -> PerKind {
    let at = |d: f64| lag + d * factor;
    combine(&[(1.0, at(-2.0)), (-4.0, at(-1.0)), (6.0, at(0.0)), (-4.0, at(1.0)), (1.0, at(2.0))], factor * factor)
}

/// Allan variance at an averaging time of `factor` samples. `parameters` contains, for each kind of noise, the variance
/// of the white noise n from which it is generated.
pub(super) fn allan_variance(parameters: &PerKind, factor: usize) -> f64 {
    dot(parameters, &difference_covariance(factor as f64, 0.0)) / 2.0
}

/// Equivalent degrees of freedom of the overlapping Allan variance of a record with `samples` samples:
///
/// ```text
/// edf = 2 E^2 / Var = c_0^2 n^2 / sum over |h| < n of (n - |h|) c_h^2
/// ```
///
/// E and Var are the expectation and the variance of the estimated Allan variance, which is computed from n differences
/// between consecutive means. c_h is the covariance of two of these differences whose indices differ by h. `factor` is
/// the averaging time in samples. If `factor` is 128 or more, only every (`factor` / 64)-th difference is used. The
/// omitted differences are so strongly correlated with the used differences that they would add no information.
pub(super) fn degrees_of_freedom(parameters: &PerKind, factor: usize, samples: usize) -> f64 {
    const PER_WINDOW: usize = 64;
    /// Two differences of consecutive means that are farther apart than this number of averaging times are treated as
    /// independent. The covariance of two differences decreases with the square of the distance between them.
    const WINDOWS: usize = 24;
    let stride = (factor / PER_WINDOW).max(1);
    let count = ((samples - 2 * factor) / stride + 1) as f64;
    let covariance = |lag: usize| dot(parameters, &difference_covariance(factor as f64, (lag * stride) as f64));
    let variance = covariance(0);
    let lags = (WINDOWS * factor / stride).min(count as usize - 1);
    let sum: f64 = (1..=lags).map(|lag| 2.0 * (count - lag as f64) * (covariance(lag) / variance).powi(2)).sum();
    count * count / (count + sum)
}

pub(super) fn dot(a: &PerKind, b: &PerKind) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn allan_variances_are_those_of_the_textbook() {
        for m in [1_usize, 2, 16, 1000] {
            let of = |kind: usize| {
                let mut parameters = [0.0; KINDS];
                parameters[kind] = 1.0;
                allan_variance(&parameters, m)
            };
            let m = m as f64;
            assert!((of(WHITE) * m - 1.0).abs() < 1e-12);
            assert!((of(WALK) / (m / 3.0 + 1.0 / (6.0 * m)) - 1.0).abs() < 1e-12);
            assert!((of(QUANTISATION) * m * m / 3.0 - 1.0).abs() < 1e-12);
            // Flicker noise is modelled as white noise that is integrated to half order. At short averaging times, the
            // Allan variance of this model is larger than that of exact 1/f noise. The difference decreases with the
            // square of the averaging time.
            let flat = 2.0 * LN_2 / PI;
            assert!((of(FLICKER) / flat - 1.0).abs() < 3.0 / (m * m), "{}", of(FLICKER));
        }
    }

    /// The variogram c(0) - c(k) of flicker noise, with the covariance c at lag k, must equal the variogram of
    /// half-order integrated white noise. The latter is computed from the power spectrum, where w is the angular
    /// frequency in rad per sample: `(1 / pi) integral of (1 - cos k w) / (2 sin(w / 2)) dw` from 0 to pi.
    #[test]
    fn flicker_has_the_variogram_of_its_power() {
        let steps = 200_000;
        for k in [1.0, 2.0, 5.0, 40.0, 100.0] {
            let integral: f64 = (0..steps)
                .map(|i| (f64::from(i) + 0.5) * PI / f64::from(steps))
                .map(|w| (1.0 - (k * w).cos()) / (2.0 * (w / 2.0).sin()))
                .sum::<f64>()
                / f64::from(steps);
            let c = |lag| mean_covariance(1.0, lag)[FLICKER];
            assert!((c(0.0) - c(k) - integral).abs() < 1e-7, "{k}: {}, not {integral}", c(0.0) - c(k));
        }
    }

    #[test]
    fn the_series_of_the_harmonic_number_meets_the_sum() {
        let sum: f64 = (1..=32).map(|i| 1.0 / f64::from(2 * i - 1)).sum();
        assert!((odd_harmonic(32.0) - sum).abs() < 1e-12);
    }

    /// Reference values from allantools 2024.6: `edf_greenhall` with d = 2, overlapping (Greenhall and Riley, 2003).
    #[test]
    fn degrees_of_freedom_are_those_of_greenhall_and_riley() {
        for (kind, m, samples, expected) in [
            (WHITE, 64, 100_000, 2341.524),
            (WHITE, 1000, 8_000, 9.82),
            (WHITE, 32_768, 120_000, 3.562),
            (FLICKER, 64, 100_000, 1832.108),
            (FLICKER, 2048, 120_000, 66.946),
            (FLICKER, 32_768, 120_000, 2.623),
            (WALK, 64, 100_000, 1446.577),
            (WALK, 1000, 8_000, 5.897),
            (WALK, 32_768, 120_000, 1.939),
        ] {
            let mut parameters = [0.0; KINDS];
            parameters[kind] = 1.0;
            let found = degrees_of_freedom(&parameters, m, samples);
            assert!((found / expected - 1.0).abs() < 0.01, "{kind}, {m} of {samples}: {found}, not {expected}");
        }
    }
}
