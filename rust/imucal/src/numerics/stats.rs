//! Computes probabilities of the chi2 distribution, quantiles, and robust means.

use std::cmp::Ordering;

use pulp::{Simd, WithSimd};

use crate::numerics::instructions::Instructions;
use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Probability that a chi2 variable with `dof` degrees of freedom exceeds `statistic`. It is 1 for zero degrees of
/// freedom.
pub fn p_value(statistic: f64, dof: usize) -> f64 {
    p_value_of(statistic, dof as f64)
}

/// Like [`p_value`], but the number of degrees of freedom need not be an integer.
pub(crate) fn p_value_of(statistic: f64, dof: f64) -> f64 {
    ChiSquared::new(dof).map_or(1.0, |distribution| distribution.sf(statistic.max(0.0)))
}

/// Median of the absolute value of a standard normal variable.
pub(crate) const MEDIAN_SIZE: f64 = 0.674_489_75;

/// Median of the values; NaN for an empty slice. The order of the slice changes.
pub(crate) fn median(values: &mut [f64]) -> f64 {
    quantile(values, 0.5)
}

/// The `q` quantile of the values by linear interpolation, with `q` from 0 to 1; NaN for an empty slice. The order of
/// the slice changes.
pub(crate) fn quantile(values: &mut [f64], q: f64) -> f64 {
    if values.is_empty() {
        return f64::NAN;
    }
    let position = q * (values.len() - 1) as f64;
    let below = position.floor() as usize;
    let (_, &mut low, above) = values.select_nth_unstable_by(below, f64::total_cmp);
    between(low, smallest(above), position - below as f64)
}

/// The [`quantile`] of `count` values. The values are computed when they are needed, so that not all of them are
/// stored. NaN values are ignored. `write(k, to)` writes the values with the indices `k`, `k + 1`, ... to the slice
/// `to`.
///
/// An evenly spaced sample of the values gives two limits. The quantile is between these limits with high probability,
/// so only the values between the limits are stored. If the quantile is outside the limits, all values are stored
/// (after Floyd and Rivest, Communications of the ACM 18, 1975, 165-172).
pub(crate) fn quantile_of(count: usize, write: impl Fn(usize, &mut [f64]), q: f64) -> f64 {
    // If there are fewer values than this number, all values are stored, which is faster.
    const FEWEST: usize = 2000;
    // For at least this number of values, wider limits are used, so that storing all values is almost never necessary.
    const MANY: usize = 100_000;
    let of_all = || {
        let mut all = vec![f64::NAN; count];
        write(0, &mut all);
        all.retain(|v| !v.is_nan());
        quantile(&mut all, q)
    };
    if count < FEWEST {
        return of_all();
    }
    let value = |k: usize| {
        let mut one = [f64::NAN];
        write(k, &mut one);
        one[0]
    };
    let step = (count as f64).cbrt() as usize;
    let mut sample: Vec<f64> = (0..count).step_by(step).map(value).filter(|v| !v.is_nan()).collect();
    if sample.is_empty() {
        return of_all();
    }
    // The quantile of all values is searched between two limits, which are quantiles of the sample. The lower limit is
    // the sample quantile at q - `margin`, and the upper limit is the sample quantile at q + `margin`. The share of all
    // values that are below the sample quantile at q scatters about q, because the sample is random. `margin` is `off`
    // standard deviations of this share. With `off` = 2.5, the quantile is outside the limits in about one case in a
    // hundred. Wider limits are slower on average, because more values between them are stored. For long records, the
    // limits are wider (4 standard deviations), because storing all values would be expensive.
    let off = if count < MANY { 2.5 } else { 4.0 };
    let last = (sample.len() - 1) as f64;
    let margin = off * (q * (1.0 - q) / sample.len() as f64).sqrt();
    let mut at = |share: f64| *sample.select_nth_unstable_by((share * last) as usize, ascending).1;
    let low = if q <= margin { f64::NEG_INFINITY } else { at(q - margin) };
    let high = if q >= 1.0 - margin { f64::INFINITY } else { at(q + margin) };
    let Census { below, up_to_low, up_to_high, all, mut inside } =
        Instructions::Best.run(Counting { count, write: &write, low, high });
    let position = q * all.saturating_sub(1) as f64;
    let rank = position.floor() as usize;
    if rank < below || rank + 1 >= up_to_high {
        return of_all();
    }
    // From here on, `low` is the value at the integer part of the quantile's rank, and `high` is the value at the next
    // rank. The quantile is interpolated between them.
    let (low, high) = match rank.checked_sub(up_to_low) {
        _ if rank + 1 < up_to_low => (low, low),
        None => (low, smallest(&inside).min(high)),
        Some(k) if k < inside.len() => {
            let (_, &mut value, above) = inside.select_nth_unstable_by(k, ascending);
            (value, smallest(above).min(high))
        }
        Some(_) => (high, high),
    };
    between(low, high, position - rank as f64)
}

/// Compares two numbers, which must not be NaN. It is faster than `f64::total_cmp`.
fn ascending(a: &f64, b: &f64) -> Ordering {
    a.partial_cmp(b).unwrap_or(Ordering::Equal)
}

/// The smallest value; infinity for an empty slice.
fn smallest(values: &[f64]) -> f64 {
    values.iter().fold(f64::INFINITY, |smallest, &v| if v < smallest { v } else { smallest })
}

/// Counts of the values below two limits, and a list of the values between the limits. Values equal to a limit are
/// counted but not stored. The reason is that the time steps of a regular clock are nearly all equal, and thus equal to
/// a limit. A list of these time steps would be long.
struct Census {
    /// Number of values below the lower limit.
    below: usize,
    /// Number of values up to and including the lower limit.
    up_to_low: usize,
    /// Number of values up to and including the upper limit.
    up_to_high: usize,
    /// Number of all values that are not NaN.
    all: usize,
    /// All values that are strictly between the limits.
    inside: Vec<f64>,
}

/// Counts the values for the [`Census`] with the widest vector instructions of the processor.
struct Counting<'a, W> {
    count: usize,
    write: &'a W,
    low: f64,
    high: f64,
}

impl<W: Fn(usize, &mut [f64])> WithSimd for Counting<'_, W> {
    type Output = Census;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Census {
        const PART: usize = 64;
        const FEW: usize = 8;
        let Self { count, write, low, high } = self;
        let mut census = Census { below: 0, up_to_low: 0, up_to_high: 0, all: 0, inside: Vec::new() };
        for start in (0..count).step_by(PART) {
            let mut values = [f64::NAN; PART];
            write(start, &mut values[..PART.min(count - start)]);
            let (mut below, mut up_to_low, mut below_high, mut up_to_high, mut all) = (0, 0, 0, 0, 0);
            for v in values {
                below += u64::from(v < low);
                up_to_low += u64::from(v <= low);
                below_high += u64::from(v < high);
                up_to_high += u64::from(v <= high);
                all += u64::from(!v.is_nan());
            }
            census.below += below as usize;
            census.up_to_low += up_to_low as usize;
            census.up_to_high += up_to_high as usize;
            census.all += all as usize;
            if below_high > up_to_low {
                // The loop has no branch for each value, because the processor would often mispredict such a branch.
                let (mut inside, mut kept) = ([0.0; PART], 0);
                for few in values.chunks_exact(FEW) {
                    if few.iter().fold(false, |any, v| any | ((*v > low) & (*v < high))) {
                        for &v in few {
                            inside[kept % PART] = v;
                            kept += usize::from((v > low) & (v < high));
                        }
                    }
                }
                census.inside.extend_from_slice(&inside[..kept]);
            }
        }
        census
    }
}

fn between(low: f64, high: f64, share: f64) -> f64 {
    if high.is_finite() { low + share * (high - low) } else { low }
}

/// Root mean square of the values; zero if there are no values.
pub(crate) fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (mut sum, mut count) = (0.0, 0usize);
    for value in values {
        sum += value * value;
        count += 1;
    }
    if count == 0 { 0.0 } else { (sum / count as f64).sqrt() }
}

/// Result of [`random_effects_mean`].
pub(crate) struct RandomEffectsMean {
    /// Weighted mean of the values.
    pub(crate) mean: f64,
    /// Weight of each value in the mean. The sum of the weights is one.
    pub(crate) weights: Vec<f64>,
    /// Estimated variance of the true values about their mean, without the variances of the measurement errors.
    pub(crate) between: f64,
}

/// Weighted mean of measured `values` whose true values may differ. `variances` contains the variances of the
/// measurement errors. If these errors explain the scatter of the values, the weights are the inverse variances. If the
/// scatter is much larger, the weights are nearly equal (DerSimonian and Laird, Controlled Clinical Trials 7, 1986,
/// 177-188; model.md (7)).
pub(crate) fn random_effects_mean(values: &[f64], variances: &[f64]) -> RandomEffectsMean {
    let fixed: Vec<f64> = variances.iter().map(|v| 1.0 / v).collect();
    let total: f64 = fixed.iter().sum();
    let mean = weighted_sum(&fixed, values) / total;
    let q: f64 = fixed.iter().zip(values).map(|(w, x)| w * (x - mean).powi(2)).sum();
    let spread = total - fixed.iter().map(|w| w * w).sum::<f64>() / total;
    let excess = q - (values.len() as f64 - 1.0);
    let between = if spread > 0.0 { (excess / spread).max(0.0) } else { 0.0 };
    let weights: Vec<f64> = variances.iter().map(|v| 1.0 / (v + between)).collect();
    let total: f64 = weights.iter().sum();
    RandomEffectsMean {
        mean: weighted_sum(&weights, values) / total,
        weights: weights.iter().map(|w| w / total).collect(),
        between,
    }
}

fn weighted_sum(weights: &[f64], values: &[f64]) -> f64 {
    weights.iter().zip(values).map(|(w, x)| w * x).sum()
}

/// Scalar product of two vectors. Four sums are accumulated independently. With a single sum, each addition would have
/// to wait for the result of the previous addition.
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let (a, b) = (a.chunks_exact(4), b.chunks_exact(4));
    let rest: f64 = a.remainder().iter().zip(b.remainder()).map(|(a, b)| a * b).sum();
    let mut sums = [0.0; 4];
    for (a, b) in a.zip(b) {
        for k in 0..4 {
            sums[k] += a[k] * b[k];
        }
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + rest
}

/// Median sampling interval, s; NaN for fewer than two samples.
pub fn sample_interval_s(time_s: &[f64]) -> f64 {
    quantile_of(time_s.len().saturating_sub(1), |k, to| steps_s(&time_s[k..], to), 0.5)
}

/// Computes the differences of consecutive time stamps, s, and writes the first `to.len()` of them to `to`.
pub(crate) fn steps_s(time_s: &[f64], to: &mut [f64]) {
    let times = time_s.iter().zip(time_s.get(1..).unwrap_or_default());
    to.iter_mut().zip(times).for_each(|(to, (before, after))| *to = after - before);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_interpolate() {
        assert_eq!(median(&mut [3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(&mut [4.0, 1.0, 2.0, 3.0]), 2.5);
        assert_eq!(quantile(&mut [0.0, 10.0], 0.1), 1.0);
        assert!(median(&mut []).is_nan());
        assert_eq!(rms([3.0, -3.0].into_iter()), 3.0);
    }

    #[test]
    fn a_quantile_of_many_values_is_that_of_all_of_them_kept() {
        let sequences: [fn(u64) -> f64; 5] = [
            |i| i as f64,
            |i| (i % 7) as f64,
            |_| 0.01,
            |i| if i.is_multiple_of(10) { f64::NAN } else { (i % 1000) as f64 },
            |i| if i.is_multiple_of(1000) { f64::INFINITY } else { -((i % 3) as f64) },
        ];
        let of = |count: usize, value: &dyn Fn(usize) -> f64, q: f64| {
            let write = |k: usize, to: &mut [f64]| to.iter_mut().enumerate().for_each(|(i, to)| *to = value(k + i));
            quantile_of(count, write, q)
        };
        for (k, sequence) in sequences.into_iter().enumerate() {
            let value = |i: usize| sequence((i as u64).wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 11);
            let mut kept: Vec<f64> = (0..50_000).map(value).filter(|v| !v.is_nan()).collect();
            for q in [0.0, 0.05, 0.1, 0.5, 0.51, 0.9, 0.999, 1.0] {
                assert_eq!(of(50_000, &value, q), quantile(&mut kept, q), "{k} {q}");
            }
        }
        // `quantile_of` first takes every 36th of these 50,000 values, and estimates limits of the quantile from them.
        // Here all values in this sample are 7, so the quantile of all values is outside the limits. It must be found
        // nevertheless.
        let value = |i: usize| if i.is_multiple_of(36) { 7.0 } else { i as f64 };
        assert_eq!(of(50_000, &value, 0.5), quantile(&mut (0..50_000).map(value).collect::<Vec<_>>(), 0.5));
        assert!(of(0, &|_| 1.0, 0.5).is_nan());
        assert!(of(9_000, &|_| f64::NAN, 0.5).is_nan());
    }

    #[test]
    fn equal_weights_where_values_differ_more_than_their_variances() {
        let values = [1.0, 3.0, 2.0, 4.0];
        let mean = random_effects_mean(&values, &[1e-6, 1.1e-6, 1e-6, 1.1e-6]);
        assert!((mean.mean - 2.5).abs() < 1e-3 && (mean.between - 5.0 / 3.0).abs() < 0.05, "{}", mean.between);
    }

    #[test]
    fn inverse_variance_weights_where_the_variances_explain_all() {
        let mean = random_effects_mean(&[1.0, 2.0], &[1.0, 4.0]);
        assert_eq!(mean.between, 0.0);
        assert!((mean.mean - 1.2).abs() < 1e-15 && (mean.weights[0] - 0.8).abs() < 1e-15);
    }
}
