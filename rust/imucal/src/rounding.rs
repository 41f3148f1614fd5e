//! Error of the mean of rounded samples (model.md (37)).
//!
//! A converter rounds every reading to a multiple of its quantisation step q (LSB). If the noise of a sample is far
//! above q, rounding adds white noise of variance q^2 / 12. If the noise is below q, the mean over a rest has a
//! rounding error. For noise of standard deviation sigma, this error d depends only on the true mean m and does not
//! decrease with averaging:
//!
//! ```text
//! d(m) = q sum_h (-1)^h / (pi h) exp(-2 pi^2 h^2 s^2) sin(2 pi h m / q),      s = sigma / q
//! E d^2 = q^2 sum_h exp(-4 pi^2 h^2 s^2) / (2 pi^2 h^2)                       over all m
//! cov(d_k, d_l) = rms_k rms_l cos(2 pi D) exp(-2 D^2),                        D = (mean_k - mean_l) / q
//! ```
//!
//! The sums are over all integers h > 0. For rest k, d_k is the error, rms_k the square root of its mean square, and
//! mean_k the mean reading (Widrow and Kollar, Quantization Noise, Cambridge University Press 2008, chapters 4 and
//! 5). Rests with equal readings have equal errors. The standard deviation of rounded samples differs from sigma, so
//! sigma is estimated from the relative frequencies of the levels at rest.

pub(crate) mod step;

use std::f64::consts::{PI, SQRT_2};

use statrs::function::erf::erfc;

/// Standard deviation of rounded samples above which rounding needs no treatment, in steps. The noise is then above
/// 0.58 steps, the rms rounding error of a mean is below 3e-4 steps, and the variance of the samples includes q^2 /
/// 12.
pub(crate) const LEAST_SCATTER: f64 = 0.65;
/// Distance D between two readings, in steps, at which the factor exp(-2 D^2) in cov(d_k, d_l) is exp(-1/2). The factor
/// makes the covariance small for readings more than a step apart, because the phase of the cosine is then not known
/// accurately.
const CORRELATED: f64 = 0.5;
/// Smallest and largest trial value of the standard deviation of the noise, in steps. With the smallest value, nearly
/// all samples of a rest are equal. With the largest value, rounding causes no error of the mean.
const NOISE: [f64; 2] = [0.02, 1.0];
/// Number of trial standard deviations of the noise. Consecutive values differ by 14 %.
const NOISES: usize = 31;
/// Number of trial values of the true mean over which the likelihood is averaged.
const MEANS: usize = 24;
/// Maximum distance of a trial value of the true mean from the mean of the samples, in steps.
const REACH: f64 = 0.75;
/// The likelihood is negligible if its natural logarithm is more than this amount below the maximum.
const NEGLIGIBLE: f64 = 12.0;
/// Standard deviation of the prior of ln(a / b), where a and b are the standard deviations of the noise of two axes.
/// The prior states that the axes have similar noise. With a narrower prior, the levels of one axis have more
/// influence on the estimated noise of another axis.
const SIMILAR: f64 = 0.3;
/// Maximum relative difference between two quantisation steps that count as equal.
const EQUAL_STEPS: f64 = 1e-3;

/// Rounding of one axis in one recording, raw units. All numbers are zero if the readings are not quantised, or if the
/// noise is so far above the quantisation step that rounding causes no error of means.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Rounding {
    /// Quantisation step of the converter (LSB).
    pub step: f64,
    /// Standard deviation of the noise of one sample before rounding.
    pub noise: f64,
    /// Variance of the rounding error of the mean of a rest. It does not depend on the duration of the rest.
    pub error_variance: f64,
    /// Whether the reading of a rest determines its rounding error. Equal readings then have equal errors. False for a
    /// force whose samples all have one level, because the true force may be anywhere within half a step of this level.
    /// True for a rate even if its samples all have one level, because the true rate is zero at every rest.
    pub is_determined: bool,
}

/// Number of samples at each quantisation level, for a group of rests with nearly equal mean readings.
#[derive(Clone, Debug)]
pub(crate) struct Levels {
    /// Mean of the readings, steps.
    pub(crate) mean: f64,
    /// Each level, in steps, and its number of independent samples.
    pub(crate) counts: Vec<(i64, f64)>,
}

impl Rounding {
    /// Rounding for known noise with the standard deviation `noise`; used in predictions. `None` if rounding causes no
    /// error of the mean of a rest.
    pub(crate) fn of_noise(step: f64, noise: f64) -> Option<Self> {
        let coarse = step > 0.0 && (noise / step).hypot(1.0 / 12f64.sqrt()) < LEAST_SCATTER;
        coarse.then(|| Self {
            step,
            noise,
            error_variance: step * step * error_variance(noise / step),
            is_determined: true,
        })
    }

    /// Rounding of the three axes of a sensor. For each axis, `axes` contains the quantisation step and the numbers of
    /// samples at each level at the rests, or `None` if the noise of the axis is not below its step.
    ///
    /// The noise of each axis is estimated from the levels that occur at rest. The estimate of the variance of this
    /// noise is the mean of a grid of trial variances, weighted by their likelihood. The unknown true means are
    /// eliminated from the likelihood (see `log_likelihood`). The levels of the other axes contribute to the
    /// likelihood, because the axes of a triad usually have similar noise. If each axis has only one level, all small
    /// trial values are equally likely, and the error variance is the mean over all of them.
    pub(crate) fn of_levels(axes: [Option<(f64, Vec<Levels>)>; 3]) -> [Self; 3] {
        let noises: [f64; NOISES] = std::array::from_fn(tried_noise);
        let likelihoods = axes.each_ref().map(|axis| {
            let (step, groups) = axis.as_ref()?;
            let log = noises.map(|noise| groups.iter().map(|levels| levels.log_likelihood(noise)).sum::<f64>());
            let largest = log.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            Some((*step, log.map(|log| (log - largest).exp())))
        });
        std::array::from_fn(|axis| {
            let Some((step, own)) = likelihoods[axis] else { return Self::default() };
            let mut weights = own;
            for (_, other) in likelihoods
                .iter()
                .enumerate()
                .filter(|(k, _)| *k != axis)
                .filter_map(|(_, l)| l.as_ref())
                .filter(|(other, _)| (other / step - 1.0).abs() < EQUAL_STEPS)
            {
                let similar = |k: usize| -> f64 {
                    let apart = |j: usize| (noises[j] / noises[k]).ln() / SIMILAR;
                    (0..NOISES).map(|j| other[j] * (-0.5 * apart(j).powi(2)).exp()).sum()
                };
                weights = std::array::from_fn(|k| weights[k] * similar(k));
            }
            let all: f64 = weights.iter().sum();
            let mean = |of: &dyn Fn(f64) -> f64| (0..NOISES).map(|k| weights[k] * of(noises[k])).sum::<f64>() / all;
            Self {
                step,
                noise: step * mean(&|noise| noise * noise).sqrt(),
                error_variance: step * step * mean(&error_variance),
                is_determined: true,
            }
        })
    }

    /// Whether rounding causes an error of the means of the rests.
    pub fn is_coarse(&self) -> bool {
        self.error_variance > 0.0
    }

    /// Whether the rounding error of a mean exceeds 3 % of a step. Means over short intervals of a slowly varying
    /// force then have correlated rounding errors, which are not white noise.
    pub(crate) fn is_not_white_in_moves(&self) -> bool {
        self.error_variance > (0.03 * self.step).powi(2)
    }

    /// Variance of the error of one sample while the true value passes through many quantisation steps. Noise and
    /// rounding errors are then independent. `colour` is the factor c for coloured noise (model.md (10)).
    pub(crate) fn sweeping_variance(&self, colour: f64) -> f64 {
        self.noise * self.noise * colour + self.step * self.step / 12.0
    }

    /// Covariance of the rounding errors of two mean readings.
    pub(crate) fn covariance(&self, reading: f64, other: &Self, other_reading: f64) -> f64 {
        let product = self.error_variance * other.error_variance;
        // Recordings with different measurement ranges have independent errors.
        if product == 0.0 || (self.step / other.step - 1.0).abs() > EQUAL_STEPS {
            return 0.0;
        }
        let apart = (reading - other_reading) / self.step;
        product.sqrt() * (2.0 * PI * apart).cos() * (-0.5 * (apart / CORRELATED).powi(2)).exp()
    }
}

/// Trial standard deviation `k` of the noise, in quantisation steps. Consecutive trial values have a constant ratio.
fn tried_noise(k: usize) -> f64 {
    NOISE[0] * (NOISE[1] / NOISE[0]).powf(k as f64 / (NOISES - 1) as f64)
}

/// Mean of the squared rounding error over all true means, in squared steps. `noise` is the standard deviation of the
/// noise in steps.
fn error_variance(noise: f64) -> f64 {
    // For noise of 0.02 steps or more, the terms beyond the 60th are negligible. Without noise, the sum of 60 terms is
    // 1 % below the limit 1 / 12.
    let term = |h: f64| (-4.0 * (PI * h * noise).powi(2)).exp() / (2.0 * (PI * h).powi(2));
    (1..=60).map(|h| term(f64::from(h))).sum()
}

/// Logarithm of the expected share of samples at a level. `distance` is the distance of the true mean from the level,
/// and `noise` the standard deviation of the noise, both in steps.
fn ln_share(distance: f64, noise: f64) -> f64 {
    // For levels far from the mean, the difference of two small erfc values is accurate. The difference of two values
    // near one would lose digits.
    let beyond = |distance: f64| 0.5 * erfc(distance / (SQRT_2 * noise));
    let near = (distance - 0.5) / (SQRT_2 * noise);
    // Beyond 26, erfc is below the smallest number, and its first asymptotic term is accurate to 0.1 %. The logarithm
    // of such a share is finite, so the likelihood has one maximum even for noise that is far too small for the levels.
    const SMALL: f64 = 25.0;
    if near < SMALL {
        (beyond(distance - 0.5) - beyond(distance + 0.5)).ln()
    } else {
        -near * near - (2.0 * PI.sqrt() * near).ln()
    }
}

impl Levels {
    /// Log-likelihood of the levels for noise of this standard deviation. Let L be the likelihood for a given true
    /// mean. The true mean is unknown, so it is eliminated in two ways: ln of the maximum of L, and ln of the average
    /// of L, both over the true mean. The result is the mean of these two values, because both are biased if only two
    /// levels occur. The maximum is then equal for all small noise, and the average is proportional to the noise.
    fn log_likelihood(&self, noise: f64) -> f64 {
        let of_mean = |mean: f64| -> f64 {
            let term = |(level, count): &(i64, f64)| count * ln_share((mean - *level as f64).abs(), noise);
            self.counts.iter().map(term).sum()
        };
        // The logarithm of the likelihood is concave, so a ternary search finds the maximum.
        let (mut low, mut high) = (self.mean - REACH, self.mean + REACH);
        for _ in 0..40 {
            let third = (high - low) / 3.0;
            if of_mean(low + third) < of_mean(high - third) { low += third } else { high -= third }
        }
        let best = (low + high) / 2.0;
        let largest = of_mean(best);
        // The ends of the interval outside which the likelihood is negligible.
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
mod tests {
    use super::*;

    #[test]
    fn the_variance_of_the_error_has_the_known_limits() {
        assert!((error_variance(1e-3) - 1.0 / 12.0).abs() < 1e-3);
        for noise in [0.25, 0.4, 0.6] {
            let first = (-2.0 * (PI * noise).powi(2)).exp() / (SQRT_2 * PI);
            assert!((error_variance(noise).sqrt() / first - 1.0).abs() < 1e-3, "{noise}");
        }
    }

    /// Expected numbers of samples at each level, for 300 samples of each mean.
    fn levels(means: &[f64], noise: f64) -> Vec<Levels> {
        let of_mean = |&mean: &f64| {
            let beyond = |distance: f64| 0.5 * erfc(distance / (SQRT_2 * noise));
            let share = |level: i64| beyond(level as f64 - 0.5 - mean) - beyond(level as f64 + 0.5 - mean);
            let counts: Vec<(i64, f64)> = (-5..6)
                .map(|level| (level, (300.0 * share(level)).round()))
                .filter(|(_, count)| *count > 0.0)
                .collect();
            let all: f64 = counts.iter().map(|(_, count)| count).sum();
            Levels { mean: counts.iter().map(|(level, count)| *level as f64 * count).sum::<f64>() / all, counts }
        };
        means.iter().map(of_mean).collect()
    }

    #[test]
    fn the_noise_is_that_of_the_levels() {
        let means: Vec<f64> = (0..20).map(|k| (f64::from(k) * 0.618).fract()).collect();
        for noise in [0.06, 0.15, 0.25, 0.4] {
            let [found, _, _] = Rounding::of_levels([Some((2.0, levels(&means, noise))), None, None]);
            assert!((found.noise / (2.0 * noise) - 1.0).abs() < 0.2, "{noise}: {found:?}");
            assert!((found.error_variance / (4.0 * error_variance(noise)) - 1.0).abs() < 0.4, "{noise}: {found:?}");
        }
    }

    /// Near the limit of coarse rounding, small trial noise cannot explain levels two steps from the mean. The
    /// likelihood is then tiny, and it still has one maximum over the true mean.
    #[test]
    fn the_likelihood_of_small_noise_is_finite_and_smaller_with_levels_far_from_the_mean() {
        for shift in (0..100).map(|k| f64::from(k) * 1e-3) {
            let counts = vec![(0, 190.0), (1, 1640.0), (2, 1460.0), (3, 190.0), (4, 20.0)];
            let levels = Levels { mean: 1.45 + shift, counts };
            let likelihoods: Vec<f64> = (0..NOISES - 4).map(|k| levels.log_likelihood(tried_noise(k))).collect();
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

    #[test]
    fn a_single_level_leaves_an_error_near_the_bound_unless_another_axis_shows_the_noise() {
        let single = || Some((1.0, levels(&[0.02], 0.01)));
        let [alone, ..] = Rounding::of_levels([single(), None, None]);
        assert!((0.04..1.0 / 12.0).contains(&alone.error_variance), "{alone:?}");
        let other = Some((1.0, levels(&[0.3, 0.45], 0.15)));
        let [beside, ..] = Rounding::of_levels([single(), other, None]);
        assert!(beside.noise > 1.2 * alone.noise && beside.error_variance < alone.error_variance, "{beside:?}");
    }

    #[test]
    fn rests_with_equal_readings_share_the_error() {
        let rounding = Rounding { step: 0.5, noise: 0.1, error_variance: 0.01, is_determined: true };
        let covariance = |apart: f64| rounding.covariance(3.0, &rounding, 3.0 + apart) / 0.01;
        assert!((covariance(0.0) - 1.0).abs() < 1e-12);
        assert!(covariance(0.25) < -0.5 && covariance(5.0).abs() < 1e-12);
        assert_eq!(rounding.covariance(3.0, &Rounding { step: 1.0, ..rounding }, 3.0), 0.0);
    }
}
