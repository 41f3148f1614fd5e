//! Tails of chi2, and robust statistics of small samples.

use statrs::distribution::{ChiSquared, ContinuousCDF};

/// Probability that chi2 with `dof` degrees of freedom exceeds `statistic`; 1 for none.
pub fn p_value(statistic: f64, dof: usize) -> f64 {
    ChiSquared::new(dof as f64).map_or(1.0, |distribution| distribution.sf(statistic.max(0.0)))
}

/// Median; NaN of an empty slice. Reorders the slice.
pub(crate) fn median(values: &mut [f64]) -> f64 {
    quantile(values, 0.5)
}

/// The value below which the share `q` of the values lies; NaN of an empty slice. Reorders the slice.
pub(crate) fn quantile(values: &mut [f64], q: f64) -> f64 {
    if values.is_empty() {
        return f64::NAN;
    }
    let position = q * (values.len() - 1) as f64;
    let below = position.floor() as usize;
    let (_, &mut low, above) = values.select_nth_unstable_by(below, f64::total_cmp);
    let high = above.iter().fold(f64::INFINITY, |least, &v| if v < least { v } else { least });
    between(low, high, position - below as f64)
}

/// [`quantile`] of values that are gone through three times, once to count them, instead of being kept; NaN is passed over.
///
/// A thousand of them, evenly spread, say between which two values the quantile very likely lies; only what lies there is
/// kept and sorted. Where the thousand are misleading all values are.
pub(crate) fn quantile_of(values: impl Iterator<Item = f64> + Clone, q: f64) -> f64 {
    const SAMPLES: usize = 1000;
    // Four standard deviations of a rank among so many.
    const MARGIN: f64 = 4.0 * 0.5 / 31.6;
    let values = values.filter(|v| !v.is_nan());
    let count = values.clone().count();
    if count <= 4 * SAMPLES {
        return quantile(&mut values.collect::<Vec<_>>(), q);
    }
    let mut sample: Vec<f64> = values.clone().step_by(count / SAMPLES).collect();
    sample.sort_unstable_by(f64::total_cmp);
    let at = |share: f64| sample[(share.clamp(0.0, 1.0) * (sample.len() - 1) as f64) as usize];
    let low = if q <= MARGIN { f64::NEG_INFINITY } else { at(q - MARGIN) };
    let high = if q >= 1.0 - MARGIN { f64::INFINITY } else { at(q + MARGIN) };
    // Ties are counted, for a clock has hardly any other steps.
    let (mut below, mut at_low, mut at_high, mut inside) = (0, 0, 0, Vec::new());
    for value in values.clone() {
        if value > low && value < high {
            inside.push(value);
        } else {
            below += usize::from(value < low);
            at_low += usize::from(value == low);
            at_high += usize::from(value == high && high > low);
        }
    }
    let position = q * (count - 1) as f64;
    let rank = position.floor() as usize;
    let (first_inside, first_high) = (below + at_low, below + at_low + inside.len());
    if rank < below || rank + 1 >= first_high + at_high {
        return quantile(&mut values.collect::<Vec<_>>(), q);
    }
    let mut ranked = |rank: usize| {
        if rank < first_inside {
            low
        } else if rank < first_high {
            *inside.select_nth_unstable_by(rank - first_inside, f64::total_cmp).1
        } else {
            high
        }
    };
    between(ranked(rank), ranked(rank + 1), position - rank as f64)
}

fn between(low: f64, high: f64, share: f64) -> f64 {
    if high.is_finite() { low + share * (high - low) } else { low }
}

/// Root mean square; zero of nothing.
pub(crate) fn rms(values: impl Iterator<Item = f64>) -> f64 {
    let (mut sum, mut count) = (0.0, 0usize);
    for value in values {
        sum += value * value;
        count += 1;
    }
    if count == 0 { 0.0 } else { (sum / count as f64).sqrt() }
}

/// A mean of values with known and different variances that may also differ from each other by more than that.
pub(crate) struct RandomEffectsMean {
    pub(crate) mean: f64,
    /// Weight of each value; they sum to one.
    pub(crate) weights: Vec<f64>,
    /// Variance between the values beyond their own.
    pub(crate) between: f64,
}

/// Random-effects mean: inverse-variance weights where `variances` explain the scatter, equal weights where it is much
/// larger (DerSimonian and Laird, Controlled Clinical Trials 7, 1986, 177-188).
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
        let many =
            |value: fn(u64) -> f64| (0..50_000u64).map(move |i| value(i.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 11));
        let sequences: [fn(u64) -> f64; 5] = [
            |i| i as f64,
            |i| (i % 7) as f64,
            |_| 0.01,
            |i| if i % 10 == 0 { f64::NAN } else { (i % 1000) as f64 },
            |i| if i % 1000 == 0 { f64::INFINITY } else { -((i % 3) as f64) },
        ];
        for (k, value) in sequences.into_iter().enumerate() {
            let mut kept: Vec<f64> = many(value).filter(|v| !v.is_nan()).collect();
            for q in [0.0, 0.05, 0.1, 0.5, 0.51, 0.9, 0.999, 1.0] {
                assert_eq!(quantile_of(many(value), q), quantile(&mut kept, q), "{k} {q}");
            }
        }
        // Ordered, with a stretch that an even sample cannot miss and one that it does.
        let steps = (0..50_000).map(|i| if (20_000..20_040).contains(&i) { -1.0 } else { f64::from(i / 5) });
        assert_eq!(quantile_of(steps.clone(), 0.5), quantile(&mut steps.collect::<Vec<_>>(), 0.5));
        assert!(quantile_of(std::iter::empty(), 0.5).is_nan());
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
