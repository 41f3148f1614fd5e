//! Predicts the errors that signals have after correction by a calibration without effects, and after correction by a
//! calibration with effects. The prediction does not need the true signals.
//!
//! ```text
//! after^2 = noise^2 + E |D e|^2,   before^2 = noise^2 + E |d + D e|^2          model.md (35)
//! ```
//!
//! All quantities refer to signals averaged over one second, so white noise of density N contributes N / sqrt(1 s). `E`
//! is the expectation, and |.|^2 is the mean square over the axes and the seconds of the recordings. `e` is the vector
//! of parameter errors of the calibration with effects. `D` is the Jacobian of the corrected signals with respect to
//! the parameters. `d` is the difference between the signals corrected without and with the effects, so d + D e is the
//! error after correction without the effects.

use faer::Mat;
use imucal_core::calibration::Calibration;
use imucal_core::effects::Sensor;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::parameter_uncertainty::{Parameters, Signals, WINDOW_S, Windows, typical_sizes};
use super::residual_channels::noise_densities;
use crate::calibrate::{Outcome, UserField};
use crate::correct::{correct, is_left_in_data};
use crate::error::Error;
use crate::numerics::stats::quantile;
use crate::recording::Recording;

/// Averaging time before the correction, s. Means over this time are corrected instead of single samples, because this
/// is faster. The predicted errors hardly change, because calibration errors vary as slowly as the motion.
const BRIEF_MEAN_S: f64 = 0.1;
/// Number of random draws from which the 95 % interval of the improvement factor ([`PredictedError::factor`]) is
/// computed.
const DRAWS: usize = 1000;
/// Seed of the random draws. It is fixed, so that results are reproducible.
const SEED: u64 = 1;
/// Probabilities of the quantiles at the ends of the 95 % interval.
const INTERVAL: [f64; 2] = [0.025, 0.975];
/// The squared noise density N^2 is estimated from the differences between consecutive means over 0.25 s, on three axes
/// (docs/model.md (10)). The variance of this estimate is var(N^2) = N^4 x NOISE_VARIANCE_S / T, where T is the total
/// duration of the rests, s.
const NOISE_VARIANCE_S: f64 = 0.25;
/// Lower bound of the mean squared error and of the mean squared noise in a random draw, as a share of the expected
/// mean squared noise. Without this bound, random products of noise and errors could make the mean squared error of a
/// draw negative.
const LEAST_MEAN_SQUARE: f64 = 0.1;

/// Predicted errors of the corrected angular rate and specific force.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PredictedErrors {
    /// Error of the angular rate, rad/s.
    pub angular_rate: PredictedError,
    /// Error of the specific force, m/s^2.
    pub specific_force: PredictedError,
}

/// Root mean square error of a corrected signal that is averaged over one second. The mean square is taken over the
/// seconds and the axes (docs/model.md (35)).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PredictedError {
    /// Error after correction without the effects, in the unit of the signal.
    pub before: f64,
    /// Error after correction with the effects, in the unit of the signal.
    pub after: f64,
    /// `before / after`.
    pub factor: f64,
    /// Lower end of the 95 % confidence interval of `factor` on these recordings.
    pub factor_low: f64,
    /// Upper end of the 95 % confidence interval of `factor` on these recordings.
    pub factor_high: f64,
}

/// Data that the caller computes if a calibration has user-defined effects: the corrected [`BriefMeans`] of each
/// recording, and the fields (signal errors per unit of each parameter) of the user-defined effects.
#[derive(Clone, Copy)]
pub struct UserCorrection<'a> {
    /// [`BriefMeans`] corrected by the calibration without the effects, SI units, body frame.
    pub before: &'a [Recording<'a>],
    /// [`BriefMeans`] corrected by the calibration with the effects, SI units, body frame.
    pub after: &'a [Recording<'a>],
    /// Fields of the user-defined effects, in the order in which the calibration with effects lists the effects. The
    /// fields are evaluated at the samples of `after`.
    pub fields: &'a [UserField<'a>],
}

/// A recording, averaged over consecutive intervals of 0.1 s.
#[derive(Clone, Debug)]
pub struct BriefMeans {
    /// Number of samples in each mean. An incomplete last interval is omitted.
    pub samples: usize,
    time_s: Vec<f64>,
    specific_force: Vec<[f64; 3]>,
    angular_rate: Vec<[f64; 3]>,
    temperature_degc: Option<Vec<f64>>,
}

impl BriefMeans {
    /// Averages time, specific force, angular rate and temperature of a recording.
    pub fn of(recording: &Recording<'_>) -> Self {
        let samples = brief_samples(recording.time_s);
        let mean = |values: &[f64]| -> Vec<f64> {
            values.chunks_exact(samples).map(|part| sum(part) / samples as f64).collect()
        };
        let mean_rows = |rows: crate::recording::Samples<'_>| -> Vec<[f64; 3]> {
            let axes = [0, 1, 2].map(|axis| mean(&rows.axis(axis).collect::<Vec<f64>>()));
            (0..axes[0].len()).map(|k| [axes[0][k], axes[1][k], axes[2][k]]).collect()
        };
        Self {
            samples,
            time_s: mean(recording.time_s),
            specific_force: mean_rows(recording.specific_force),
            angular_rate: mean_rows(recording.angular_rate),
            temperature_degc: recording.temperature_degc.map(mean),
        }
    }

    /// Returns a recording whose samples are the means. It has the units of the recording `of` and contains no angles
    /// of the stand.
    pub fn recording<'a>(&'a self, of: &Recording<'a>) -> Recording<'a> {
        Recording {
            time_s: &self.time_s,
            specific_force: (&self.specific_force).into(),
            angular_rate: (&self.angular_rate).into(),
            temperature_degc: self.temperature_degc.as_deref(),
            stand_rad: None,
            ..*of
        }
    }
}

/// Sum with small rounding errors. The mean time of an interval can coincide with the edge of a one-second window. A
/// larger rounding error of this mean would assign the interval to the wrong window.
fn sum(values: &[f64]) -> f64 {
    values.split_first().map_or(0.0, |(first, others)| first + pairwise_sum(others))
}

/// Pairwise summation; ranges of at most 128 values are summed with eight partial sums (Higham, SIAM Journal on
/// Scientific Computing 14, 1993, 783-799).
fn pairwise_sum(values: &[f64]) -> f64 {
    const EIGHT: usize = 8;
    const FEW: usize = 128;
    if values.len() < EIGHT {
        return values.iter().fold(0.0, |sum, value| sum + value);
    }
    if values.len() > FEW {
        let half = values.len() / 2;
        let (left, right) = values.split_at(half - half % EIGHT);
        return pairwise_sum(left) + pairwise_sum(right);
    }
    let (eights, others) = values.as_chunks::<EIGHT>();
    let mut sums = [0.0; EIGHT];
    for eight in eights {
        sums.iter_mut().zip(eight).for_each(|(sum, value)| *sum += value);
    }
    let [a, b, c, d, e, f, g, h] = sums;
    let of_eights = ((a + b) + (c + d)) + ((e + f) + (g + h));
    others.iter().fold(of_eights, |sum, value| sum + value)
}

/// Number of samples in a mean over [`BRIEF_MEAN_S`].
fn brief_samples(time_s: &[f64]) -> usize {
    let (Some(first), Some(last)) = (time_s.first(), time_s.last()) else { return 1 };
    let step_s = (last - first) / time_s.len().saturating_sub(1).max(1) as f64;
    if step_s > 0.0 { ((BRIEF_MEAN_S / step_s).round_ties_even() as usize).max(1) } else { 1 }
}

/// Predicted errors of signals that are corrected by the calibrations `before` and `after`. `recordings` contain raw
/// samples. `user` is required if a calibration has user-defined effects.
///
/// # Errors
/// [`Error::Input`] if the contents of `user` do not match the recordings and the effects of `after`.
pub fn predicted_errors(
    before: &Calibration<f64>,
    after: &Outcome,
    recordings: &[Recording<'_>],
    user: Option<&UserCorrection<'_>>,
) -> Result<PredictedErrors, Error> {
    let parameters = Parameters::of(after);
    // Each parameter has a column: the change of the corrected signals in each window if the parameter changes by one
    // standard deviation. The last column is the difference between the signals corrected by `before` and by `after`.
    let mut columns: Vec<Vec<Signals>> = vec![Vec::new(); parameters.count() + 1];
    for (index, recording) in recordings.iter().enumerate() {
        let means = BriefMeans::of(recording);
        let brief = means.recording(recording);
        let [own_before, own_after] = [before, &after.calibration].map(|calibration| correct(&brief, calibration));
        let corrected = [(&own_before, user.map(|user| user.before)), (&own_after, user.map(|user| user.after))];
        let corrected = corrected.map(|((rate, force), given)| match given {
            Some(given) => given.get(index).filter(|given| given.len() == brief.len()).copied().ok_or_else(|| {
                Error::Input(format!("{}: its corrected means are missing or of another length", recording.name))
            }),
            None => Ok(Recording { specific_force: force.into(), angular_rate: rate.into(), ..brief }),
        });
        let [corrected_before, corrected_after] = corrected;
        let (corrected_before, corrected_after) = (corrected_before?, corrected_after?);
        let windows = Windows::of(brief.time_s);
        let fields: Vec<(Sensor, &[f64])> = user
            .map_or(&[][..], |user| user.fields)
            .iter()
            .map(|field| (field.sensor, field.columns.get(index).copied().unwrap_or_default()))
            .collect();
        let slopes = parameters.slopes(after, &brief, &corrected_after, &windows, &fields)?;
        let difference = difference(&corrected_before, &corrected_after, &windows);
        columns.iter_mut().zip(slopes.into_iter().chain([difference])).for_each(|(all, own)| all.extend(own));
    }
    let typical = typical_sizes(after, user.map_or(&[], |user| user.fields));
    let (errors, covariance) = parameters.expected_errors(after, &typical);
    let rest_s: f64 = after.rests.iter().map(|rest| rest.end_s - rest.start_s).sum();
    let draws = Draws::new(errors.len());
    let [angular_rate, specific_force] = noise_mean_squares(after);
    let signal = |noise: f64, axes: std::ops::Range<usize>| {
        let (gram, count) = mean_products(&columns, axes);
        let relative_variance = NOISE_VARIANCE_S / rest_s;
        Signal { noise, gram, errors: &errors, covariance: &covariance, count, relative_variance }.predict(&draws)
    };
    Ok(PredictedErrors { angular_rate: signal(angular_rate, 0..3)?, specific_force: signal(specific_force, 3..6)? })
}

/// Difference between the signals corrected by the two calibrations, in each window.
fn difference(before: &Recording<'_>, after: &Recording<'_>, windows: &Windows) -> Vec<Signals> {
    let means = |recording: &Recording<'_>| {
        let [rate, force] = [recording.angular_rate, recording.specific_force];
        let [rate, force] = [rate, force].map(|rows| windows.means(|sample| nalgebra::Vector3::from(rows.at(sample))));
        rate.into_iter().zip(force)
    };
    means(before)
        .zip(means(after))
        .map(|(before, after)| {
            let (rate, force) = (before.0 - after.0, before.1 - after.1);
            [rate.x, rate.y, rate.z, force.x, force.y, force.z]
        })
        .collect()
}

/// For each pair of columns: the mean of the product of the two columns over all windows and the given axes. The second
/// result is the number of values in each mean. The value of a window on an axis is omitted if any column is not finite
/// there.
fn mean_products(columns: &[Vec<Signals>], axes: std::ops::Range<usize>) -> (Mat<f64>, usize) {
    let windows = columns.first().map_or(0, Vec::len);
    let (mut sums, mut count) = (Mat::<f64>::zeros(columns.len(), columns.len()), 0);
    for window in 0..windows {
        for axis in axes.clone() {
            let row: Vec<f64> = columns.iter().map(|column| column[window][axis]).collect();
            if row.iter().all(|value| value.is_finite()) {
                count += 1;
                for (i, a) in row.iter().enumerate() {
                    row.iter().enumerate().for_each(|(j, b)| sums[(i, j)] += a * b);
                }
            }
        }
    }
    (sums * faer::Scale(1.0 / count as f64), count)
}

/// Mean square of the noise of the angular rate and of the specific force, both averaged over one second. The noise
/// includes the bias instability of the gyroscope, and effects that the correction does not remove.
///
/// The Earth's rate counts as an error of the angular rate, because the correction does not remove it and its
/// body-frame components change with attitude.
fn noise_mean_squares(after: &Outcome) -> [f64; 2] {
    let (accelerometer, gyroscope) = noise_densities(after);
    let mean_square = |values: &[f64]| values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64;
    let instability = after.bias_instability_radps.map_or(0.0, |instability| mean_square(&instability));
    let left: f64 = after
        .calibration
        .effects
        .iter()
        .filter(|values| is_left_in_data(values.effect()) && values.effect().sensor == Sensor::Gyroscope)
        .map(|values| mean_square(values.values()))
        .sum();
    [
        mean_square(gyroscope.as_slice()) / WINDOW_S + instability + left,
        mean_square(accelerometer.as_slice()) / WINDOW_S,
    ]
}

/// Noise, error covariances and signal changes from which the error of one signal (angular rate or specific force) is
/// predicted.
struct Signal<'a> {
    /// Mean squared noise of a one-second average.
    noise: f64,
    /// (P+1, P+1) mean products of signal changes, for P parameters. Each of the first P rows and columns belongs to
    /// the signal change if one parameter changes by its standard deviation. The last row and column belong to the
    /// difference between the signals corrected without and with the effects.
    gram: Mat<f64>,
    /// (P,) expected errors of the parameters, in standard deviations.
    errors: &'a [f64],
    /// (P, P) covariance of the parameter errors, in squared standard deviations.
    covariance: &'a Mat<f64>,
    /// Number of one-second averages, over all windows and axes.
    count: usize,
    /// Variance of the estimate `noise`, divided by `noise`^2.
    relative_variance: f64,
}

/// Standard normal random numbers. The predictions for angular rate and specific force use the same numbers.
struct Draws {
    /// (P, draws) standard normal numbers from which the parameter errors are computed.
    parameters: Mat<f64>,
    /// (P+1, draws) standard normal numbers from which the mean products of the noise with each signal change (see
    /// [`Signal::gram`]) are computed.
    products: Mat<f64>,
    /// (draws,) standard normal numbers from which the deviations of the mean squared noise from its expected value are
    /// computed.
    noise: Vec<f64>,
}

impl Draws {
    fn new(parameters: usize) -> Self {
        let mut generator = ChaCha8Rng::seed_from_u64(SEED);
        let mut normal = || StandardNormal.sample(&mut generator);
        Self {
            parameters: Mat::from_fn(parameters, DRAWS, |_, _| normal()),
            products: Mat::from_fn(parameters + 1, DRAWS, |_, _| normal()),
            noise: (0..DRAWS).map(|_| normal()).collect(),
        }
    }
}

impl Signal<'_> {
    fn predict(&self, draws: &Draws) -> Result<PredictedError, Error> {
        let parameters = self.errors.len();
        let pairs = (0..parameters).flat_map(|i| (0..parameters).map(move |j| (i, j)));
        let of_covariance: f64 = pairs.map(|(i, j)| self.gram[(i, j)] * self.covariance[(i, j)]).sum();
        let expected = |difference: f64| (self.noise + self.square(self.errors, difference) + of_covariance).sqrt();
        let (before, after) = (expected(1.0), expected(0.0));
        let mut factors = self.factors(draws)?;
        let [factor_low, factor_high] = INTERVAL.map(|probability| quantile(&mut factors, probability));
        Ok(PredictedError { before, after, factor: before / after, factor_low, factor_high })
    }

    /// Mean square of the sum of two terms. The first term is the signal change due to the parameter errors `errors`.
    /// The second term is `difference` (0 or 1) x the difference between the signals corrected without and with the
    /// effects.
    fn square(&self, errors: &[f64], difference: f64) -> f64 {
        let at = |i: usize| errors.get(i).copied().unwrap_or(difference);
        let all = 0..=errors.len();
        all.clone().map(|i| at(i) * all.clone().map(|j| self.gram[(i, j)] * at(j)).sum::<f64>()).sum()
    }

    /// Improvement factor for each random draw of parameter errors and noise.
    fn factors(&self, draws: &Draws) -> Result<Vec<f64>, Error> {
        let parameters = self.errors.len();
        let errors = root(self.covariance)? * &draws.parameters;
        let products = root(&self.gram)? * &draws.products;
        let scale = (self.noise / self.count as f64).sqrt();
        let deviation = (2.0 / self.count as f64 + self.relative_variance).sqrt();
        let factor = |draw: usize| {
            let own: Vec<f64> = (0..parameters).map(|p| self.errors[p] + errors[(p, draw)]).collect();
            let noise = self.noise * (1.0 + deviation * draws.noise[draw]).max(LEAST_MEAN_SQUARE);
            let mean_square = |difference: f64| {
                let with_noise: f64 = (0..parameters).map(|p| own[p] * products[(p, draw)]).sum::<f64>()
                    + difference * products[(parameters, draw)];
                let square = self.square(&own, difference) + 2.0 * scale * with_noise + noise;
                square.max(LEAST_MEAN_SQUARE * self.noise)
            };
            (mean_square(1.0) / mean_square(0.0)).sqrt()
        };
        Ok((0..DRAWS).map(factor).collect())
    }
}

/// Symmetric square root of a positive semidefinite covariance.
fn root(covariance: &Mat<f64>) -> Result<Mat<f64>, Error> {
    let eigen = covariance
        .self_adjoint_eigen(faer::Side::Lower)
        .map_err(|_| Error::Fit("the covariance of the parameters has no eigenvalues: check the data".into()))?;
    let (vectors, n) = (eigen.U(), covariance.nrows());
    let scaled = Mat::from_fn(n, n, |i, k| vectors[(i, k)] * eigen.S()[k].max(0.0).sqrt());
    Ok(scaled * vectors.transpose())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::{EffectChoice, Options, calibrate};
    use crate::simulate::{Program, RandomMoves, Simulation, Unit, simulate};
    use imucal_core::effects::{Effect, EffectValues};

    fn run(effect: &'static Effect<f64>, values: &[f64]) -> Simulation {
        let mut unit = Unit::paper();
        unit.effects.push(EffectValues::try_new(effect, values, None).unwrap()).unwrap();
        simulate(&Program::random(&RandomMoves::default(), 2).unwrap(), &unit, 100.0, 9.80665, 2).unwrap()
    }

    fn calibrated(recording: &Recording<'_>, effects: &[&'static Effect<f64>]) -> Outcome {
        let effects = effects.iter().map(|effect| EffectChoice::plain(effect)).collect();
        calibrate(&[*recording], &Options { effects, ..Options::default() }).unwrap()
    }

    #[test]
    fn an_effect_in_the_model_reduces_the_error_of_its_sensor_alone() {
        let effect = Effect::find("gyro_g_sensitivity").unwrap();
        let run = run(effect, &[3e-4, 0.0, 0.0, 0.0, -3e-4, 0.0, 0.0, 0.0, 3e-4]);
        let recording = run.recording("run");
        let (before, after) = (calibrated(&recording, &[]), calibrated(&recording, &[effect]));
        let found = predicted_errors(&before.calibration, &after, &[recording], None).unwrap();
        let PredictedErrors { angular_rate: rate, specific_force: force } = found;
        assert!(rate.factor > 2.0 && rate.factor_low < rate.factor && rate.factor < rate.factor_high, "{rate:?}");
        assert!(force.factor_low < 1.02 && force.factor_high > 0.98, "{force:?}");
        // The expected error is a g-sensitivity of 3e-4 rad/s per m/s^2 times the rms of gravity on one axis, g /
        // sqrt(3).
        assert!((rate.before - 3e-4 * 9.8 / 3f64.sqrt()).abs() < 0.3 * rate.before, "{rate:?}");
    }

    #[test]
    fn brief_means_are_means_of_a_tenth_of_a_second() {
        let time_s: Vec<f64> = (0..25).map(|k| f64::from(k) * 0.01).collect();
        let rows: Vec<[f64; 3]> = (0..25).map(|k| [f64::from(k), 1.0, 0.0]).collect();
        let recording = Recording::try_new("run", &time_s, &rows, &rows).unwrap();
        let means = BriefMeans::of(&recording);
        let brief = means.recording(&recording);
        assert_eq!((means.samples, brief.len()), (10, 2));
        assert!((brief.time_s[1] - 0.145).abs() < 1e-12);
        assert_eq!(brief.angular_rate.at(1), [14.5, 1.0, 0.0]);
    }

    #[test]
    fn the_root_of_a_singular_covariance_reproduces_it() {
        let factor = Mat::from_fn(4, 2, |i, j| (i + 1) as f64 - 1.5 * j as f64);
        let covariance = &factor * factor.transpose();
        let root = root(&covariance).unwrap();
        assert!((&root * root.transpose() - covariance).norm_max() < 1e-12);
    }
}
