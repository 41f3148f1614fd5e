//! Estimates the noise of one axis at the rests from the numbers of samples at each quantisation level (model.md (37)).

use std::collections::BTreeMap;
use std::f64::consts::{PI, SQRT_2};

use statrs::function::erf::erfc;

/// Rests are assumed to have the same true mean if their mean readings differ by less than this number of quantisation
/// steps. The readings of a gyroscope are nearly equal at all rests. A separate unknown true mean for each rest would
/// make large noise seem too likely, so the estimate of the noise would be too large.
const SAME_READING: f64 = 0.15;
/// A level (multiple of the quantisation step) that is more than 1.5 steps from the mean is omitted if it has at most
/// this share of the samples, or at most one independent sample. Such samples are due to a jolt or a transmission
/// error, and a single such sample would dominate the estimated noise.
const FOREIGN: f64 = 1e-3;
/// A rest counts as at most this number of independent samples when its noise is compared with the noise of other
/// rests. With this number of samples, a rest contradicts a trial value of the noise only if the noise of the rest
/// differs from the trial value by more than about 14 %, which is the spacing of the trial values.
const COMPARED: f64 = 300.0;
/// A rest contradicts a trial value of the noise if the log-likelihood of the rest at this value is more than this
/// amount below the maximum log-likelihood of the rest. This corresponds to four standard deviations. The trial values
/// are compared by the sum, over the rests, of (maximum log-likelihood) - (log-likelihood). In the sum, the
/// contribution of each rest is limited to this amount, so that no single rest can exclude a trial value.
const CONTRADICTION: f64 = 8.0;
/// Smallest and largest trial value of the standard deviation of the noise, in steps. With the smallest value, nearly
/// all samples of a rest are equal. With the largest value, rounding causes no error of the mean.
const NOISE: [f64; 2] = [0.02, 1.0];
/// Number of trial standard deviations of the noise. Consecutive values differ by 14 %.
pub(super) const NOISES: usize = 31;
/// Number of trial values of the true mean over which the likelihood is averaged.
const MEANS: usize = 24;
/// Maximum distance of a trial value of the true mean from the mean of the samples, in steps.
const REACH: f64 = 0.75;
/// The likelihood is negligible if its natural logarithm is more than this amount below the maximum.
const NEGLIGIBLE: f64 = 12.0;

/// Numbers of samples at each quantisation level, for a rest or for a group of rests with nearly equal mean readings.
#[derive(Clone, Debug, Default)]
pub(crate) struct Levels {
    /// Mean of the readings, steps.
    mean: f64,
    /// Each level, in steps, and its number of independent samples. The noise is correlated, so each sample is
    /// equivalent to only 1/c independent samples. c is the factor by which this correlation increases the variance of
    /// a mean (model.md (10)).
    counts: BTreeMap<i64, f64>,
}

/// For each trial value of the noise: the logarithm of its likelihood minus the largest of these logarithms.
pub(super) type Likelihood = [f64; NOISES];

/// Noise of the rests of one axis.
pub(super) struct RestNoise {
    /// Likelihood of the noise that most rests have in common.
    pub(super) common: Likelihood,
    /// For each rest: the likelihood of its noise if this noise differs from the common noise, otherwise `None`.
    pub(super) others: Vec<Option<Likelihood>>,
}

impl RestNoise {
    /// Finds the trial value of the noise that the rests contradict least. The common noise is then estimated from all
    /// rests that do not contradict this value.
    ///
    /// The plain product of the likelihoods of all rests is not used. Suppose that a few rests have large noise and all
    /// others small noise. The levels far from the mean that occur at these few rests are nearly impossible with small
    /// noise, so the product would be large only for large noise.
    pub(super) fn of(rests: &[Levels]) -> Self {
        let alone: Vec<Likelihood> =
            rests.iter().map(Levels::compared).map(|rest| relative(|noise| rest.log_likelihood(noise))).collect();
        let agreement = |k: usize| alone.iter().map(|rest| rest[k].max(-CONTRADICTION)).sum::<f64>();
        let best = (0..NOISES).max_by(|a, b| agreement(*a).total_cmp(&agreement(*b))).unwrap_or_default();
        let contradicts = |rest: &Likelihood| rest[best] < -CONTRADICTION;
        let agreeing = rests.iter().zip(&alone).filter(|(_, alone)| !contradicts(alone)).map(|(rest, _)| rest);
        let groups = groups(agreeing.collect());
        Self {
            common: relative(|noise| groups.iter().map(|group| group.log_likelihood(noise)).sum()),
            others: alone.into_iter().map(|rest| Some(rest).filter(contradicts)).collect(),
        }
    }
}

/// Evaluates a log-likelihood at all trial values of the noise, and subtracts its maximum.
fn relative(log_likelihood: impl Fn(f64) -> f64) -> Likelihood {
    let log: Likelihood = std::array::from_fn(|k| log_likelihood(trial_noise(k)));
    let largest = log.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    log.map(|log| log - largest)
}

/// Joins rests with nearly equal mean readings into groups, and omits levels that are far from the mean and have hardly
/// any samples ([`FOREIGN`]).
fn groups(mut rests: Vec<&Levels>) -> Vec<Levels> {
    rests.sort_by(|a, b| a.mean.total_cmp(&b.mean));
    let same = rests.chunk_by(|a, b| b.mean - a.mean < SAME_READING);
    same.map(|rests| Levels::of(rests.iter().flat_map(|rest| rest.iter())).without_foreign()).collect()
}

/// Trial standard deviation `k` of the noise, in quantisation steps. Consecutive trial values have a constant ratio.
pub(super) fn trial_noise(k: usize) -> f64 {
    NOISE[0] * (NOISE[1] / NOISE[0]).powf(k as f64 / (NOISES - 1) as f64)
}

/// Logarithm of the expected share of samples at a level. `distance` is the distance of the true mean from the level,
/// and `noise` the standard deviation of the noise, both in steps.
fn ln_share(distance: f64, noise: f64) -> f64 {
    // The difference of two small erfc values is accurate for levels far from the mean, where erf is close to one and a
    // difference of two erf values would lose digits.
    let beyond = |distance: f64| 0.5 * erfc(distance / (SQRT_2 * noise));
    let near = (distance - 0.5) / (SQRT_2 * noise);
    // For arguments above about 26.5, erfc is below the smallest normal number of double precision. From 25 on, the
    // first term of its asymptotic series is therefore used, which is accurate to 0.1 %. Its logarithm is finite, so
    // the likelihood has one maximum even if the trial noise is far too small for the levels that occur.
    const SMALL: f64 = 25.0;
    if near < SMALL {
        (beyond(distance - 0.5) - beyond(distance + 0.5)).ln()
    } else {
        -near * near - (2.0 * PI.sqrt() * near).ln()
    }
}

impl Levels {
    /// Sums the numbers of independent samples at each level. `samples` contains pairs of a level and a number.
    pub(crate) fn of(samples: impl Iterator<Item = (i64, f64)>) -> Self {
        let mut counts = BTreeMap::new();
        samples.for_each(|(level, count)| *counts.entry(level).or_insert(0.0) += count);
        let of = |value: &dyn Fn(i64) -> f64| counts.iter().map(|(level, count)| value(*level) * count).sum::<f64>();
        Self { mean: of(&|level| level as f64) / of(&|_| 1.0), counts }
    }

    /// Each level with its number of independent samples.
    fn iter(&self) -> impl Iterator<Item = (i64, f64)> + '_ {
        self.counts.iter().map(|(level, count)| (*level, *count))
    }

    /// Number of independent samples.
    fn samples(&self) -> f64 {
        self.counts.values().sum()
    }

    /// Removes the levels that are far from the mean and have hardly any samples ([`FOREIGN`]). The field `mean`
    /// remains the mean of all samples.
    fn without_foreign(mut self) -> Self {
        let few = (FOREIGN * self.samples()).max(1.0);
        self.counts.retain(|level, count| (*level as f64 - self.mean).abs() < 1.5 || *count > few);
        self
    }

    /// Prepares the levels of one rest for the comparison with other rests. Levels far from the mean with hardly any
    /// samples are removed, and the counts are scaled so that their sum is at most [`COMPARED`].
    fn compared(&self) -> Self {
        let mut levels = self.clone().without_foreign();
        let share = (COMPARED / levels.samples()).min(1.0);
        levels.counts.values_mut().for_each(|count| *count *= share);
        levels
    }

    /// Log-likelihood of the levels for noise of this standard deviation. Let L be the likelihood for a given true
    /// mean. The true mean is unknown, so it is eliminated in two ways: ln of the maximum of L, and ln of the average
    /// of L, both over the true mean. The result is the mean of these two values, because both are biased if only two
    /// levels occur: the maximum is equal for all small noise and so favours noise near zero, and the average is
    /// proportional to the noise and so favours large noise.
    pub(super) fn log_likelihood(&self, noise: f64) -> f64 {
        let of_mean = |mean: f64| -> f64 {
            let term = |(level, count): (i64, f64)| count * ln_share((mean - level as f64).abs(), noise);
            self.iter().map(term).sum()
        };
        // The logarithm of the likelihood is concave, so a ternary search finds the maximum.
        let (mut low, mut high) = (self.mean - REACH, self.mean + REACH);
        for _ in 0..40 {
            let third = (high - low) / 3.0;
            if of_mean(low + third) < of_mean(high - third) { low += third } else { high -= third }
        }
        let best = (low + high) / 2.0;
        let largest = of_mean(best);
        // `end` returns one end of the interval of true means outside which the likelihood is negligible.
        let end = |far: f64| {
            let (mut inside, mut outside) = (best, far);
            for _ in 0..24 {
                let middle = (inside + outside) / 2.0;
                if largest - of_mean(middle) < NEGLIGIBLE { inside = middle } else { outside = middle }
            }
            outside
        };
        let (first, last) = (end(self.mean - REACH), end(self.mean + REACH));
        let mean = |k: usize| first + (last - first) * (k as f64 + 0.5) / MEANS as f64;
        let sum: f64 = (0..MEANS).map(|k| (of_mean(mean(k)) - largest).exp()).sum();
        largest + 0.5 * (sum * (last - first) / MEANS as f64).ln()
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// For each true mean in `means`, computes how many of the 300 samples of a rest are expected at each level. Means
    /// and the standard deviation `noise` are in steps.
    pub(in crate::rounding) fn levels(means: &[f64], noise: f64) -> Vec<Levels> {
        let of_mean = |&mean: &f64| {
            let beyond = |distance: f64| 0.5 * erfc(distance / (SQRT_2 * noise));
            let share = |level: i64| beyond(level as f64 - 0.5 - mean) - beyond(level as f64 + 0.5 - mean);
            let near = mean.round() as i64;
            Levels::of(
                (near - 9..near + 10)
                    .map(|level| (level, (300.0 * share(level)).round()))
                    .filter(|(_, count)| *count > 0.0),
            )
        };
        means.iter().map(of_mean).collect()
    }

    /// If the noise is nearly large enough to neglect rounding, levels two steps from the mean occur. Small trial noise
    /// cannot explain these levels. The likelihood of this noise is then tiny, but as a function of the true mean it
    /// still has only one maximum.
    #[test]
    fn the_likelihood_of_small_noise_is_finite_and_smaller_with_levels_far_from_the_mean() {
        for shift in (0..100).map(|k| f64::from(k) * 1e-3) {
            let counts = BTreeMap::from([(0, 190.0), (1, 1640.0), (2, 1460.0), (3, 190.0), (4, 20.0)]);
            let levels = Levels { mean: 1.45 + shift, counts };
            let likelihoods: Vec<f64> = (0..NOISES - 4).map(|k| levels.log_likelihood(trial_noise(k))).collect();
            assert!(likelihoods.iter().all(|l| l.is_finite()), "{shift}: {likelihoods:?}");
            assert!(likelihoods.is_sorted(), "{shift}: {likelihoods:?}");
        }
    }

    #[test]
    fn the_logarithm_of_a_share_continues_where_the_share_is_zero() {
        // The distance from the mean beyond which `ln_share` uses the asymptotic series.
        let noise = 0.02;
        let limit = 0.5 + 25.0 * SQRT_2 * noise;
        let (before, after) = (ln_share(limit - 1e-9, noise), ln_share(limit + 1e-9, noise));
        assert!((before - after).abs() < 1e-3, "{before} {after}");
        assert!(ln_share(4.0, noise).is_finite() && ln_share(4.0, noise) < ln_share(3.9, noise));
    }
}
