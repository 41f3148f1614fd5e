//! Estimates the noise of one sensor axis: the noise parameters with their confidence bands, and the Allan deviations
//! of the samples.

use std::num::NonZeroUsize;

use statrs::distribution::{ChiSquared, ContinuousCDF};

use super::cosines::{Layout, Power};
use super::departures::{Blocks, Component, NoiseModel};
use super::likelihood::{Fit, Likelihood};
use super::power_law::{FLICKER, KINDS, PerKind, QUANTISATION, WALK, WHITE, allan_variance, degrees_of_freedom};
use crate::cancellation::checkpoint;
use crate::error::Error;
use crate::noise::allan::{overlapping_deviations, quarter_octave_factors};
use crate::recording::Samples;

/// The noise model does not fit if the measured power in an octave deviates from the power of the model by more than
/// this number of standard deviations. For noise that agrees with the model, the probability of such a deviation is
/// about 6e-7 per octave.
pub(super) const MISFIT: f64 = 5.0;
/// Quantisation noise is included in the model if it increases 2 ln L by more than this value, where L is the
/// likelihood. The value is the 99.9 % quantile of chi-square with one degree of freedom. If the record contains no
/// quantisation noise, the probability of such an increase is therefore at most 0.001.
const QUANTISATION_GAIN: f64 = 10.83;
/// If a filter has changed the noise at high frequencies, the fit omits this number of octaves, counted from half the
/// sampling rate downwards. The fit with 6 omitted octaves is tried before the fit with 11. The spectrum is computed in
/// stages of five octaves. If the filter reduces the power at high frequencies, all powers of a stage change, because
/// the cosine transform of a window of only 32 values has wide side lobes. Therefore one or two complete stages are
/// omitted (5 or 10 octaves). The first octave of the next stage is also omitted, because this stage transforms means
/// of filtered samples.
const FILTERED: [u32; 2] = [6, 11];
/// The white noise is estimated only if the size of a count is at most this multiple of the standard deviation of a
/// sample. This standard deviation includes the white noise and the rounding error. With larger counts, rounding errors
/// depend on the signal and are not white.
const COARSEST_COUNT: f64 = 2.0;
/// The averaging time of an Allan deviation is at most the duration of the record divided by this number.
const LONGEST_SHARE: usize = 3;

/// Estimate of the parameter of one kind of noise, for example of the white noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Maximum-likelihood estimate; `None` if the record contains no significant noise of this kind.
    pub value: Option<f64>,
    /// Standard deviation of the error of `value`; `None` if there is no value.
    pub std: Option<f64>,
    /// Lower end of the 95 % confidence band; zero if there is no value.
    pub low: f64,
    /// Upper end of the 95 % confidence band. If `value` is `None`, this end is an upper limit of the parameter. It is
    /// infinite for a constant axis.
    pub high: f64,
}

/// A point of the Allan plot: the Allan deviation at one averaging time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AllanPoint {
    /// Averaging time, s.
    pub tau_s: f64,
    /// Overlapping Allan deviation, in the unit of the samples.
    pub deviation: f64,
    /// Lower end of the 95 % confidence band of `deviation`.
    pub low: f64,
    /// Upper end of the 95 % confidence band of `deviation`.
    pub high: f64,
    /// Equivalent degrees of freedom of the Allan deviation, computed from the fitted noise model.
    pub dof: f64,
    /// Allan deviation that the fitted noise model predicts, in the unit of the samples.
    pub model: f64,
}

/// Noise of one axis. In the descriptions of the fields, v is the unit of the samples.
#[derive(Clone, Debug)]
pub struct AxisNoise {
    /// Coefficient N of the white noise (noise density), v/sqrt(Hz).
    pub noise_density: Estimate,
    /// Coefficient B of the flicker noise (bias instability), v.
    pub bias_instability: Estimate,
    /// Coefficient K of the rate random walk, v/s/sqrt(Hz).
    pub random_walk: Estimate,
    /// Coefficient Q of the quantisation noise of an integrated output, v s.
    pub quantisation: Estimate,
    /// Size of a count of the converter, v (the unit of the samples). It equals the smallest step between samples, and
    /// it is zero for a constant axis.
    pub lsb: f64,
    /// Whether the standard deviation of a sample due to white noise and rounding is less than half a count. This field
    /// is also true for a constant axis.
    pub is_below_lsb: bool,
    /// Shortest period of the fitted part of the noise, s. At shorter periods, the power deviates from the model,
    /// usually because of a filter.
    pub shortest_period_s: f64,
    /// Deviation of the power spectrum from the model in the octave with the largest deviation, in standard deviations.
    pub misfit: f64,
    /// Allan deviations at about four averaging times per octave.
    pub allan: Vec<AllanPoint>,
}

impl AxisNoise {
    /// Identifies the noise in the column `axis` of `rows`, the samples of a rest. Also detects steps and drifts of the
    /// mean of this column, with the samples divided into `blocks`. If there are too few samples for a detection,
    /// `blocks` is `None`.
    pub(super) fn identify(
        rows: Samples<'_>,
        axis: usize,
        rate_hz: f64,
        layout: &Layout,
        blocks: Option<&Blocks>,
    ) -> Result<(Self, Vec<Component>), Error> {
        let values = rows.axis(axis);
        let lsb = smallest_step(values.clone());
        checkpoint();
        let powers = layout.powers(values.clone());
        let model = Model::of(&powers, lsb * lsb / 12.0);
        let theta = &model.best.theta;
        let counts = (theta[WHITE] + model.rounding).sqrt() * COARSEST_COUNT;
        let is_constant = lsb == 0.0;
        let is_below_lsb = is_constant || counts < lsb;

        let estimates: [Estimate; KINDS] = std::array::from_fn(|kind| {
            // Factor that converts the parameter from a time unit of one sampling interval to a time unit of one
            // second.
            let unit = match kind {
                WHITE => rate_hz.sqrt().recip(),
                FLICKER => 1.0,
                WALK => rate_hz.sqrt(),
                _ => rate_hz.recip(),
            };
            let estimate = model.estimate(&powers, kind, unit);
            match (is_below_lsb, kind) {
                (false, _) => estimate,
                // For a constant axis, the size of a count is unknown, so the data give no upper limit of the noise.
                (true, _) if is_constant => estimate.bounded(f64::INFINITY),
                (true, WHITE) => estimate.bounded((model.rounding / rate_hz).sqrt()),
                (true, _) => estimate.bounded(0.0),
            }
        });
        // A drift increases the deviation of the powers from the noise model. `Model::of` may therefore omit so many
        // octaves that the drift cannot be detected in the remaining octaves. The search for drifts therefore omits at
        // most six octaves, the smaller number in `FILTERED`.
        let filtered = model.filtered.min(FILTERED[0]);
        let noise = NoiseModel { kinds: model.kinds, rounding: model.rounding, filtered };
        let components = match blocks {
            Some(blocks) if !is_constant => blocks.components(values.clone(), &noise, rate_hz),
            _ => Vec::new(),
        };
        let noise = Self {
            noise_density: estimates[WHITE],
            bias_instability: estimates[FLICKER],
            random_walk: estimates[WALK],
            quantisation: estimates[QUANTISATION],
            lsb,
            is_below_lsb,
            shortest_period_s: 2.0 * f64::from(1_u32 << model.filtered) / rate_hz,
            misfit: model.misfit,
            allan: allan_points(values, &model, rate_hz)?,
        };
        Ok((noise, components))
    }
}

impl Estimate {
    /// Removes the value from the estimate. This is used for an axis whose noise is below a count, because a value
    /// would then be meaningless. The upper end of the confidence band becomes sqrt(high^2 + least^2). For white noise,
    /// `least` is the noise density of the rounding error. For other kinds of noise, `least` is zero.
    fn bounded(self, least: f64) -> Self {
        Self { value: None, std: None, low: 0.0, high: self.high.hypot(least) }
    }
}

/// Noise model of an axis, fitted to its power spectrum.
struct Model {
    best: Fit,
    /// For each kind of noise: whether the model contains it.
    kinds: [bool; KINDS],
    /// Variance of the error of a sample due to rounding to counts.
    rounding: f64,
    /// Number of octaves, directly below half the sampling rate, that the fit omits.
    filtered: u32,
    misfit: f64,
}

impl Model {
    /// Fits a model with white noise, bias instability and random walk to the spectrum `powers`. Quantisation noise is
    /// included if it is significant. If the model deviates from the measured power in an octave, the highest octaves
    /// are omitted, provided that the model then agrees with all remaining octaves.
    fn of(powers: &[Power], rounding: f64) -> Self {
        let whole = Self::above(powers, rounding, 0);
        if whole.misfit.abs() <= MISFIT {
            return whole;
        }
        let cut = FILTERED.map(|filtered| Self::above(powers, rounding, filtered));
        cut.into_iter().find(|model| model.misfit.abs() <= MISFIT).unwrap_or(whole)
    }

    fn above(powers: &[Power], rounding: f64, filtered: u32) -> Self {
        let used = fitted(powers, filtered);
        let fit = |kinds| Likelihood { powers: &used, rounding, kinds }.fit();
        let mut kinds = [true, true, true, false];
        let mut best = fit(kinds);
        let with = fit([true; KINDS]);
        if best.deviance - with.deviance > QUANTISATION_GAIN {
            (kinds, best) = ([true; KINDS], with);
        }
        let likelihood = Likelihood { powers: &used, rounding, kinds };
        let lowest = used.iter().map(Power::octave).max().unwrap_or(0);
        let misfit = (filtered..=lowest)
            .map(|wanted| likelihood.excess(&best.theta, |power| power.octave() == wanted))
            .fold(0.0, |worst: f64, excess| if excess.abs() > worst.abs() { excess } else { worst });
        Self { best, kinds, rounding, filtered, misfit }
    }

    /// Computes the parameter of the noise kind `kind` as sqrt(theta) x `unit`. theta is the maximum-likelihood
    /// estimate of the square of the parameter, with the sampling interval as the unit of time. `unit` converts
    /// sqrt(theta) to the unit of the parameter, with seconds as the unit of time.
    fn estimate(&self, powers: &[Power], kind: usize, unit: f64) -> Estimate {
        let used = fitted(powers, self.filtered);
        let mut likelihood = Likelihood { powers: &used, rounding: self.rounding, kinds: self.kinds };
        let mut best = self.best;
        if !self.kinds[kind] {
            likelihood.kinds[kind] = true;
            best = likelihood.fit();
        }
        let band = likelihood.band(&best, kind);
        let (low, high) = (unit * band.low.sqrt(), unit * band.high.sqrt());
        let theta = best.theta[kind];
        if !self.kinds[kind] || band.low <= 0.0 || theta <= 0.0 {
            return Estimate { value: None, std: None, low: 0.0, high };
        }
        let std = likelihood.standard_deviations(&best.theta)[kind];
        let value = unit * theta.sqrt();
        Estimate { value: Some(value), std: Some(0.5 * value * std / theta), low, high }
    }
}

fn fitted(powers: &[Power], filtered: u32) -> Vec<Power> {
    powers.iter().filter(|power| power.octave() >= filtered).copied().collect()
}

/// Smallest difference between consecutive values that exceeds floating-point rounding errors; zero for constant
/// values.
fn smallest_step(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let (low, high) = values.clone().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (v.min(l), v.max(h)));
    let rounding = 1e-9 * (high - low).max(low.abs() * 1e-6);
    let steps = values.clone().zip(values.skip(1)).map(|(a, b)| (b - a).abs()).filter(|step| *step > rounding);
    let smallest = steps.fold(f64::INFINITY, f64::min);
    if smallest.is_finite() { smallest } else { 0.0 }
}

fn allan_points(
    values: impl ExactSizeIterator<Item = f64> + Clone,
    model: &Model,
    rate_hz: f64,
) -> Result<Vec<AllanPoint>, Error> {
    let samples = values.len();
    let mut factors = quarter_octave_factors(samples);
    factors.retain(|m| m * LONGEST_SHARE <= samples);
    let deviations = overlapping_deviations(values, &factors, NonZeroUsize::MIN)?;
    let mut theta: PerKind = model.best.theta;
    theta[WHITE] += model.rounding;
    let point = |(&m, deviation): (&usize, f64)| {
        let dof = degrees_of_freedom(&theta, m, samples);
        let [most, least] = [0.975, 0.025].map(|probability| (dof / chi_square_quantile(dof, probability)).sqrt());
        AllanPoint {
            tau_s: m as f64 / rate_hz,
            deviation,
            low: deviation * most,
            high: deviation * least,
            dof,
            model: allan_variance(&theta, m).max(0.0).sqrt(),
        }
    };
    Ok(factors.iter().zip(deviations).map(point).collect())
}

/// Quantile of the chi-square distribution with `dof` degrees of freedom, for a `probability` of 0.025 or 0.975. At 100
/// degrees of freedom and above, the approximation by Wilson and Hilferty is used. Its relative error is at most 1e-4.
fn chi_square_quantile(dof: f64, probability: f64) -> f64 {
    if let (true, Ok(distribution)) = (dof < 100.0, ChiSquared::new(dof)) {
        return distribution.inverse_cdf(probability);
    }
    // The ends of a 95 % band are the quantiles at 2.5 % and 97.5 %. For the standard normal distribution, these
    // quantiles are -1.959964 and 1.959964.
    let normal = if probability > 0.5 { 1.959_963_985 } else { -1.959_963_985 };
    let ninth = 2.0 / (9.0 * dof);
    dof * (1.0 - ninth + normal * ninth.sqrt()).powi(3)
}
