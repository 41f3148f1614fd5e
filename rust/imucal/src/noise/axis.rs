//! One axis: its figures, how sure they are, and its Allan deviations.

use std::num::NonZeroUsize;

use statrs::distribution::{ChiSquared, ContinuousCDF};

use super::cosines::{Layout, Power};
use super::likelihood::{Fit, Likelihood};
use super::power_law::{FLICKER, KINDS, PerKind, QUANTISATION, WALK, WHITE, allan_variance, degrees_of_freedom};
use crate::error::Error;
use crate::noise::allan::{octave_factors, overlapping_deviations};
use crate::recording::Samples;

/// Standard deviations by which the powers of an octave may be off the model: by chance once in 10^6.
pub(super) const MISFIT: f64 = 5.0;
/// What quantisation must explain to be called that, twice the logarithm of the likelihood: one in 1000 by chance.
const QUANTISATION_GAIN: f64 = 10.83;
/// Octaves of frequency, from half the rate down, that are left out where a filter has coloured the noise. A window of 32 values
/// has sharp ends, and what is missing at high frequencies is missing in all of its cosines: whole stages go, of five octaves
/// each, and the octave where the means of the next one are still blind to what they average.
const FILTERED: [u32; 2] = [6, 11];
/// Without rounding errors that depend on the signal, a count is at most this many standard deviations of the noise.
const COARSEST_COUNT: f64 = 2.0;
/// The longest tau is this share of the record.
const LONGEST_SHARE: usize = 3;

/// One figure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// The maximum-likelihood estimate; `None` where the record does not show that there is any.
    pub value: Option<f64>,
    /// Its standard deviation.
    pub std: Option<f64>,
    /// Begin of the 95 % band, zero where there is no value.
    pub low: f64,
    /// End of the 95 % band: what the record excludes where there is no value. Infinite for an axis that is constant.
    pub high: f64,
}

/// One point of the Allan plot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AllanPoint {
    /// Averaging time, s.
    pub tau_s: f64,
    /// Overlapping Allan deviation.
    pub deviation: f64,
    /// Begin of its 95 % band.
    pub low: f64,
    /// End of its 95 % band.
    pub high: f64,
    /// Equivalent degrees of freedom, of the fitted model.
    pub dof: f64,
    /// Allan deviation of the fitted model.
    pub model: f64,
}

/// The noise of one axis, v being the unit of its samples.
#[derive(Clone, Debug)]
pub struct AxisNoise {
    /// White noise N, v/sqrt(Hz).
    pub noise_density: Estimate,
    /// Flicker coefficient B, v.
    pub bias_instability: Estimate,
    /// Rate random walk K, v/s/sqrt(Hz).
    pub random_walk: Estimate,
    /// Quantisation Q of an integrated output, v s.
    pub quantisation: Estimate,
    /// One count of the converter: the smallest step between samples, v; zero for a constant.
    pub lsb: f64,
    /// Whether white noise is less than half a count.
    pub is_below_lsb: bool,
    /// Shortest period that was fitted, s: faster noise has been filtered, or is not of these kinds for another reason.
    pub shortest_period_s: f64,
    /// By how many standard deviations the powers of an octave are off the model, the worst one.
    pub misfit: f64,
    /// Allan deviations over octaves of tau.
    pub allan: Vec<AllanPoint>,
}

impl AxisNoise {
    /// Of one column of the samples of a rest.
    pub(super) fn identify(rows: Samples<'_>, axis: usize, rate_hz: f64, layout: &Layout) -> Result<Self, Error> {
        let values = rows.axis(axis);
        let lsb = smallest_step(values.clone());
        let powers = layout.powers(values.clone());
        let model = Model::of(&powers, lsb * lsb / 12.0);
        let theta = &model.best.theta;
        let counts = (theta[WHITE] + model.rounding).sqrt() * COARSEST_COUNT;
        let is_constant = lsb == 0.0;
        let is_below_lsb = is_constant || counts < lsb;

        let estimates: [Estimate; KINDS] = std::array::from_fn(|kind| {
            // From a parameter per sample to a figure per second.
            let unit = match kind {
                WHITE => rate_hz.sqrt().recip(),
                FLICKER => 1.0,
                WALK => rate_hz.sqrt(),
                _ => rate_hz.recip(),
            };
            let estimate = model.estimate(&powers, kind, unit);
            match (is_below_lsb, kind) {
                (false, _) => estimate,
                // A constant does not even say how large its counts are.
                (true, _) if is_constant => estimate.bounded(f64::INFINITY),
                (true, WHITE) => estimate.bounded((model.rounding / rate_hz).sqrt()),
                (true, _) => estimate.bounded(0.0),
            }
        });
        Ok(Self {
            noise_density: estimates[WHITE],
            bias_instability: estimates[FLICKER],
            random_walk: estimates[WALK],
            quantisation: estimates[QUANTISATION],
            lsb,
            is_below_lsb,
            shortest_period_s: 2.0 * f64::from(1_u32 << model.filtered) / rate_hz,
            misfit: model.misfit,
            allan: allan_points(values, &model, rate_hz)?,
        })
    }
}

impl Estimate {
    /// Without a value, because it would mean nothing; the band ends at `least` or later.
    fn bounded(self, least: f64) -> Self {
        Self { value: None, std: None, low: 0.0, high: self.high.hypot(least) }
    }
}

/// The kinds of noise that explain the powers of an axis.
struct Model {
    best: Fit,
    kinds: [bool; KINDS],
    rounding: f64,
    /// Octaves that are left out at the high end.
    filtered: u32,
    misfit: f64,
}

impl Model {
    /// White noise, bias instability and random walk; quantisation if it explains much; without the highest octaves if that
    /// makes all others fit.
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
        let lowest = used.iter().map(octave).max().unwrap_or(0);
        let misfit = (filtered..=lowest)
            .map(|wanted| likelihood.excess(&best.theta, |power| octave(power) == wanted))
            .fold(0.0, |worst: f64, excess| if excess.abs() > worst.abs() { excess } else { worst });
        Self { best, kinds, rounding, filtered, misfit }
    }

    /// One figure: `unit` times the root of its parameter.
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

/// Octave of a frequency below half the rate: 0 for the highest.
fn octave(power: &Power) -> u32 {
    (-(2.0 * power.frequency).log2()).floor().max(0.0) as u32
}

fn fitted(powers: &[Power], filtered: u32) -> Vec<Power> {
    powers.iter().filter(|power| octave(power) >= filtered).copied().collect()
}

/// The smallest step between neighbours that is more than rounding; zero for a constant.
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
    let mut factors = octave_factors(samples);
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

/// By Wilson and Hilferty where the degrees of freedom are many, right to 1e-5 there.
fn chi_square_quantile(dof: f64, probability: f64) -> f64 {
    if let (true, Ok(distribution)) = (dof < 100.0, ChiSquared::new(dof)) {
        return distribution.inverse_cdf(probability);
    }
    // 1.959964 is the normal quantile of 0.975; the bands here are of 95 %.
    let normal = if probability > 0.5 { 1.959_963_985 } else { -1.959_963_985 };
    let ninth = 2.0 / (9.0 * dof);
    dof * (1.0 - ninth + normal * ninth.sqrt()).powi(3)
}
