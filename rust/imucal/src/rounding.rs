//! Computes the error of the mean of rounded samples (model.md (37)).
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
//! The sums are over all integers h > 0, and E is the mean over all true means m. For rest k, d_k is the error, rms_k
//! is the square root of E d_k^2, and mean_k is the mean reading (Widrow and Kollar, Quantization Noise, Cambridge
//! University Press 2008, chapters 4 and 5). Rests with equal readings have equal errors. The standard deviation of
//! rounded samples differs from sigma, so sigma is estimated from the relative frequencies of the levels (multiples of
//! q) at rest.

pub(crate) mod levels;
pub(crate) mod step;

use std::f64::consts::PI;

use levels::{Levels, Likelihood, NOISES, RestNoise, trial_noise};

/// Standard deviation of rounded samples, in quantisation steps, above which the rounding error of a mean is neglected.
/// The noise before rounding is then above 0.58 steps, and the rms rounding error of a mean is below 3e-4 steps.
/// Rounding then only adds one twelfth of the squared step to the variance of the samples.
pub(crate) const LEAST_SCATTER: f64 = 0.65;
/// Distance D between two readings, in steps, at which the factor exp(-2 D^2) in the covariance of their rounding
/// errors (see the module documentation) is exp(-1/2). If two readings are more than a step apart, the phase 2 pi D of
/// the cosine is not known accurately, so the factor reduces the covariance to nearly zero.
const CORRELATED: f64 = 0.5;
/// Standard deviation of the prior of ln(a / b), where a and b are the standard deviations of the noise of two axes.
/// The prior states that the axes have similar noise. With a narrower prior, the readings of one axis have more
/// influence on the estimated noise of another axis.
const SIMILAR: f64 = 0.3;
/// The rounding error of a mean is neglected if its rms value is at most this number of steps. If the noise is above
/// 0.58 steps, the rounding error is smaller than this limit.
const NEGLECTED: f64 = 3e-4;
/// Two quantisation steps are treated as equal if their relative difference is at most this number.
const EQUAL_STEPS: f64 = 1e-3;

/// Noise and rounding errors of one axis, raw units: either for one rest, or for the noise that most rests of a
/// recording have in common. All numbers are zero if the readings are not quantised, or if the noise is so far above
/// the quantisation step that rounding causes no error of the mean of a rest.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Rounding {
    /// Quantisation step of the converter (LSB).
    pub step: f64,
    /// Standard deviation of the noise of one sample before rounding.
    pub noise: f64,
    /// Variance of the rounding error in the mean reading of a rest. It does not depend on the duration of the rest.
    pub error_variance: f64,
    /// Whether the reading of a rest determines its rounding error. Equal readings then have equal errors. False for a
    /// force whose samples are all at one level (multiple of `step`), because the true force may be anywhere within
    /// half a step of this level. True for a rate even if its samples are all at one level, because the true rate is
    /// zero at every rest, so that the converter has nearly the same input (the bias) at all rests.
    pub is_determined: bool,
}

/// Rounding errors of one axis in one recording.
#[derive(Clone, Debug, Default)]
pub(crate) struct AxisRounding {
    /// Rounding errors for the noise that most rests have in common.
    pub(crate) common: Rounding,
    /// Rounding errors at each rest; empty if the noise of the axis is not below its step.
    pub(crate) at_rests: Vec<Rounding>,
}

impl Rounding {
    /// Computes the rounding errors for noise with the known standard deviation `noise`; used in predictions. `None` if
    /// rounding causes no error of the mean of a rest.
    pub(crate) fn of_noise(step: f64, noise: f64) -> Option<Self> {
        let coarse = step > 0.0 && (noise / step).hypot(1.0 / 12f64.sqrt()) < LEAST_SCATTER;
        coarse.then(|| Self {
            step,
            noise,
            error_variance: step * step * error_variance(noise / step),
            is_determined: true,
        })
    }

    /// Computes the rounding errors of the three axes of a sensor. For each axis, `axes` contains the quantisation step
    /// and, for each rest, the number of samples at each level (multiple of the step); `None` if the noise of the axis
    /// is not below its step.
    ///
    /// The noise that most rests have in common is estimated from the levels that occur at these rests. The axes of a
    /// triad usually have similar noise, so the levels of the other axes also contribute to the likelihood of the
    /// common noise.
    ///
    /// If a rest has less noise than most rests, its rounding error is computed from its own noise. This error is
    /// larger, because the rounding error of a mean increases as the noise decreases. If a rest has more noise, a short
    /// disturbance may have caused the larger scatter. The rounding error of this rest is then computed from the common
    /// noise, because most samples of the rest are undisturbed.
    pub(crate) fn of_levels(axes: [Option<(f64, Vec<Levels>)>; 3]) -> [AxisRounding; 3] {
        let axes = axes.map(|axis| axis.map(|(step, rests)| (step, RestNoise::of(&rests))));
        std::array::from_fn(|axis| {
            let Some((step, noise)) = &axes[axis] else { return AxisRounding::default() };
            let others = axes.iter().enumerate().filter(|(other, _)| *other != axis).filter_map(|(_, l)| l.as_ref());
            let mut weights = noise.common.map(f64::exp);
            for (_, other) in others.filter(|(other, _)| (other / step - 1.0).abs() < EQUAL_STEPS) {
                let similar = |k: usize| -> f64 {
                    let apart = |j: usize| (trial_noise(j) / trial_noise(k)).ln() / SIMILAR;
                    (0..NOISES).map(|j| (other.common[j] - 0.5 * apart(j).powi(2)).exp()).sum()
                };
                weights = std::array::from_fn(|k| weights[k] * similar(k));
            }
            let common = Self::of_likelihood(*step, &weights);
            let at_rest = |own: &Option<Likelihood>| {
                let own = own.map(|own| Self::of_likelihood(*step, &own.map(f64::exp)));
                own.filter(|own| own.error_variance > common.error_variance).unwrap_or(common)
            };
            AxisRounding { common, at_rests: noise.others.iter().map(at_rest).collect() }
        })
    }

    /// Computes the rounding errors for unknown noise. The variance of the noise and the error variance are means over
    /// the trial values of the noise, weighted by their likelihood. If all samples are at one level (multiple of the
    /// step), all small trial values are equally likely.
    fn of_likelihood(step: f64, weights: &[f64; NOISES]) -> Self {
        let all: f64 = weights.iter().sum();
        let mean = |of: &dyn Fn(f64) -> f64| (0..NOISES).map(|k| weights[k] * of(trial_noise(k))).sum::<f64>() / all;
        Self {
            step,
            noise: step * mean(&|noise| noise * noise).sqrt(),
            error_variance: step * step * mean(&error_variance),
            is_determined: true,
        }
    }

    /// Whether rounding causes an error of the means of the rests that is not negligible.
    pub fn is_coarse(&self) -> bool {
        self.error_variance > (NEGLECTED * self.step).powi(2)
    }

    /// Whether the rounding error of a mean exceeds 3 % of a step. Means over short intervals of a slowly varying
    /// force then have correlated rounding errors, which are not white noise.
    pub(crate) fn is_not_white_in_moves(&self) -> bool {
        self.error_variance > (0.03 * self.step).powi(2)
    }

    /// Variance of one sample of white noise that has the same density as the noise and the rounding errors together,
    /// squared raw units. It holds while the true value passes through many quantisation steps, because noise and
    /// rounding errors are then independent. `colour` is the factor by which the correlation of the noise increases the
    /// variance of a mean (model.md (10)).
    pub(crate) fn sweeping_variance(&self, colour: f64) -> f64 {
        self.noise * self.noise * colour + self.step * self.step / 12.0
    }

    /// Covariance of the rounding errors of two mean readings.
    pub(crate) fn covariance(&self, reading: f64, other: &Self, other_reading: f64) -> f64 {
        let product = self.error_variance * other.error_variance;
        // Recordings with different steps have different measurement ranges. Their rounding errors are independent.
        if product == 0.0 || (self.step / other.step - 1.0).abs() > EQUAL_STEPS {
            return 0.0;
        }
        let apart = (reading - other_reading) / self.step;
        product.sqrt() * (2.0 * PI * apart).cos() * (-0.5 * (apart / CORRELATED).powi(2)).exp()
    }
}

/// Mean square of the rounding error of a mean reading, averaged over all values of the true mean, in squared steps.
/// `noise` is the standard deviation of the noise in steps.
fn error_variance(noise: f64) -> f64 {
    // For noise of 0.02 steps or more, the terms beyond the 60th are negligible. Without noise, the sum of 60 terms is
    // 1 % below the limit 1 / 12.
    let term = |h: f64| (-4.0 * (PI * h * noise).powi(2)).exp() / (2.0 * (PI * h).powi(2));
    (1..=60).map(|h| term(f64::from(h))).sum()
}

#[cfg(test)]
mod tests {
    use std::f64::consts::SQRT_2;

    use super::levels::tests::levels;
    use super::*;

    #[test]
    fn the_variance_of_the_error_has_the_known_limits() {
        assert!((error_variance(1e-3) - 1.0 / 12.0).abs() < 1e-3);
        for noise in [0.25, 0.4, 0.6] {
            let first = (-2.0 * (PI * noise).powi(2)).exp() / (SQRT_2 * PI);
            assert!((error_variance(noise).sqrt() / first - 1.0).abs() < 1e-3, "{noise}");
        }
    }

    /// Computes the rounding errors of the first axis of a sensor, for the noise that most rests have in common. `axis`
    /// contains the levels of this axis, and `other` the levels of the second axis.
    fn common(axis: Option<(f64, Vec<Levels>)>, other: Option<(f64, Vec<Levels>)>) -> Rounding {
        let [found, ..] = Rounding::of_levels([axis, other, None]);
        found.common
    }

    #[test]
    fn the_noise_is_that_of_the_levels() {
        let means: Vec<f64> = (0..20).map(|k| f64::from(k) * 1.618).collect();
        for noise in [0.06, 0.15, 0.25, 0.4] {
            let found = common(Some((2.0, levels(&means, noise))), None);
            assert!((found.noise / (2.0 * noise) - 1.0).abs() < 0.2, "{noise}: {found:?}");
            assert!((found.error_variance / (4.0 * error_variance(noise)) - 1.0).abs() < 0.4, "{noise}: {found:?}");
        }
    }

    /// Simulates 22 rests, of which two have more noise than the others, for several ratios of the noise. An estimate
    /// from all 22 rests together would be dominated by these two rests.
    #[test]
    fn few_rests_with_other_noise_leave_the_noise_of_most() {
        let means = [0.37; 20];
        for noise in [0.1, 0.2, 0.3] {
            for other in [0.45, 0.6, 1.0, 2.0] {
                let rests = [levels(&means, noise), levels(&[0.37, 0.41], other)].concat();
                let [found, ..] = Rounding::of_levels([Some((1.0, rests)), None, None]);
                let undisturbed = common(Some((1.0, levels(&means, noise))), None);
                assert!((found.common.noise / undisturbed.noise - 1.0).abs() < 0.02, "{noise} {other}: {found:?}");
                assert!(found.at_rests.iter().all(|rest| *rest == found.common), "{noise} {other}: {found:?}");
            }
        }
    }

    #[test]
    fn few_quiet_rests_have_the_larger_error_that_their_own_noise_leaves() {
        let rests = [levels(&[0.37; 20], 0.7), levels(&[0.3, 0.02], 0.2)].concat();
        let [found, ..] = Rounding::of_levels([Some((1.0, rests)), None, None]);
        assert!(!found.common.is_coarse(), "{found:?}");
        let (most, few) = found.at_rests.split_at(20);
        assert!(most.iter().all(|rest| *rest == found.common), "{found:?}");
        assert!(few.iter().all(|rest| rest.error_variance > 0.3 * error_variance(0.2)), "{found:?}");
    }

    #[test]
    fn a_single_level_leaves_an_error_near_the_bound_unless_another_axis_shows_the_noise() {
        let single = || Some((1.0, levels(&[0.02], 0.01)));
        let alone = common(single(), None);
        assert!((0.04..1.0 / 12.0).contains(&alone.error_variance), "{alone:?}");
        let other = Some((1.0, levels(&[0.3, 0.45], 0.15)));
        let beside = common(single(), other);
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
