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
    if high.is_finite() { low + (position - below as f64) * (high - low) } else { low }
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
