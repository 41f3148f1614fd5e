//! Calibration of an accelerometer from a table of mean readings. The table has one row for each rest.
//!
//! A table contains no samples from which noise could be measured. The noise of the means is therefore given by the
//! user, or estimated from the residuals.

use imucal_core::sensor::Triad;
use nalgebra::{Matrix3, Vector3};

use super::accelerometer_alone::{AccelerometerOutcome, of_accelerometer, refuse_options};
use super::offer::{Reduced, with_offer};
use super::unit_data::refuse_errors;
use super::{Options, check_options};
use crate::check::{check_accelerometer_gains, check_rests};
use crate::error::Error;
use crate::evaluate::rest_report;
use crate::held::{HeldParameter, StageRows};
use crate::numerics::stats::rms;
use crate::parameters::ACCEL;
use crate::recording::{RawUnit, Recording, Samples};
use crate::rests::rest::{Rest, RestMean};
use crate::rests::unit_rest::rests_of_means;
use crate::two_stage::accelerometer::{self, AccelerometerFit};
use crate::two_stage::ellipsoid::Start;

/// If the table does not contain the noise of the means, a first fit assumes this standard deviation of the means. It
/// is given as a fraction of (largest reading - smallest reading) / 2 of the axis with the largest difference. The
/// value is so large that no row is excluded as an outlier. With a larger value, the fit would be refused, because
/// noise alone could explain the differences between the readings.
const FIRST_GUESS: f64 = 0.015;
/// Noise of the means (standard deviation), m/s^2, that a trial fit assumes if the table has too few rows and does not
/// state the noise. If the trial fit succeeds with a model with fewer parameters, the error message proposes to give
/// the noise and to use this model.
const ASSUMED_NOISE_MPS2: f64 = 0.01;

/// Mean readings at rest, one row for each rest.
#[derive(Clone, Copy, Debug)]
pub struct MeanReadings<'a> {
    /// Name of the table in messages.
    pub name: &'a str,
    /// Mean accelerometer readings, in `accel_unit`.
    pub specific_force: &'a [[f64; 3]],
    /// Mean gyroscope readings, in `gyro_unit`; `None` without a gyroscope.
    pub angular_rate: Option<&'a [[f64; 3]]>,
    /// Unit of `specific_force`.
    pub accel_unit: RawUnit,
    /// Unit of `angular_rate`.
    pub gyro_unit: RawUnit,
    /// Standard deviation of the accelerometer means.
    pub noise: MeanNoise<'a>,
}

/// Standard deviation of the mean readings of an accelerometer.
#[derive(Clone, Copy, Debug)]
pub enum MeanNoise<'a> {
    /// Standard deviation of each mean and axis, in the unit of the means.
    Each(&'a [[f64; 3]]),
    /// One standard deviation for all means, m/s^2.
    Common(f64),
    /// The standard deviation is not known and is estimated from the residuals.
    Unknown,
}

/// Bias of a gyroscope: its mean reading over all rests.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RestBias {
    /// Mean of the gyroscope readings of all rows of the table, raw units.
    pub value: Vector3<f64>,
    /// Standard deviation of `value`, computed from the scatter of the rows, raw units; NaN for a single row.
    pub std: Vector3<f64>,
}

/// Calibrates an accelerometer from mean readings. If the table contains gyroscope means, the gyroscope bias is also
/// determined. The other parameters of the gyroscope cannot be determined without moves.
///
/// # Errors
/// The errors of [`calibrate_accelerometer`](super::calibrate_accelerometer). [`Error::NotEnoughMotion`] is also
/// returned if the table has only as many rows as there are free parameters and the noise of the means is not known.
/// The residuals are then zero, so they do not show the noise.
pub fn calibrate_means(
    table: &MeanReadings<'_>,
    options: &Options<'_>,
) -> Result<(AccelerometerOutcome, Option<RestBias>), Error> {
    refuse_options(options)?;
    require_finite(table)?;
    match of_table(table, options) {
        Err(Error::NotEnoughMotion(words)) => Err(Error::NotEnoughMotion(with_way_out(table, options, words))),
        outcome => Ok((outcome?, table.angular_rate.map(bias_of))),
    }
}

/// Returns the error message `words`, followed by the name of a model with fewer parameters that the table determines.
/// If the noise of the means is unknown, the message may state that the user must also give this noise. No model is
/// named if the noise is the only missing information, because `words` already asks for the noise.
fn with_way_out(table: &MeanReadings<'_>, options: &Options<'_>, words: String) -> String {
    let of_noise_given = |options: &Options<'_>| {
        let noise = MeanNoise::Common(ASSUMED_NOISE_MPS2);
        matches!(table.noise, MeanNoise::Unknown).then(|| of_table(&MeanReadings { noise, ..*table }, options).ok())?
    };
    if of_noise_given(options).is_some() {
        return words;
    }
    let fit = |options: &Options<'_>| match of_table(table, options) {
        Ok(outcome) => outcome.as_reduced(),
        Err(_) => {
            let reduced = of_noise_given(options)?.as_reduced()?;
            Some(Reduced { condition: Some("if the noise of the means is given (noise_mps2=..., --noise)"), ..reduced })
        }
    };
    with_offer(options, &words, fit).unwrap_or(words)
}

/// Calibrates the accelerometer from the table, as a part of [`calibrate_means`]. Error messages do not offer a model
/// with fewer parameters.
fn of_table(table: &MeanReadings<'_>, options: &Options<'_>) -> Result<AccelerometerOutcome, Error> {
    // For the checks, the rows are converted to a recording in which each rest is one sample.
    let time_s: Vec<f64> = (0..table.specific_force.len()).map(|row| row as f64).collect();
    let recording = Recording {
        accel_unit: table.accel_unit,
        ..Recording::try_new(table.name, &time_s, table.specific_force, Samples::Absent(time_s.len()))?
    };
    check_options(&[recording], options)?;
    let ranges: Vec<_> = (0..recording.len()).map(|row| row..row + 1).collect();
    let mut findings = check_rests(&recording, &ranges, options.gravity_mps2);
    refuse_errors(&findings)?;
    let held = of_accelerometer(options.priors.held([nominal_of(table, options), Some(1.0)])?);
    let fitted = fit(table, &held, options)?;
    let rests: Vec<&Rest> = fitted.rests.iter().collect();
    let reports = rests_of_means(&fitted.rests)
        .iter()
        .zip(&fitted.fit.used)
        .map(|(rest, used)| {
            let excluded = (!used).then_some("contradicts_other_rests");
            rest_report(rest, &fitted.fit.triad, options.gravity_mps2, excluded)
        })
        .collect();
    let mut outcome = AccelerometerOutcome::of_fit(&fitted.fit, &rests, reports, &held, options)?;
    outcome.noise_from_residuals_mps2 = fitted.noise_from_residuals_mps2;
    let gains = check_accelerometer_gains(&recording, &outcome.triad);
    refuse_errors(gains.as_slice())?;
    findings.extend(gains);
    outcome.findings = findings;
    Ok(outcome)
}

struct Fitted {
    fit: AccelerometerFit,
    rests: Vec<Rest>,
    noise_from_residuals_mps2: Option<f64>,
}

/// Fits the accelerometer to the means, each weighted with its noise. There are three cases:
///
/// * The table contains the noise of each mean. One fit is sufficient.
/// * The user gave one standard deviation for all means, in m/s^2. The sensitivity from a first fit converts this value
///   to raw units.
/// * The noise is unknown. It is computed from the residuals of a first fit.
fn fit(table: &MeanReadings<'_>, held: &[HeldParameter], options: &Options<'_>) -> Result<Fitted, Error> {
    let held = &StageRows::new(held, ACCEL);
    let fit_with = |variances: &dyn Fn(usize) -> Vector3<f64>| {
        let rests: Vec<Rest> =
            table.specific_force.iter().enumerate().map(|(row, mean)| rest(row, mean, variances(row))).collect();
        let nominal = options
            .accel_nominal
            .map(|scale| Start { sensitivity: Matrix3::from_diagonal_element(scale), bias: Vector3::zeros() });
        let all: Vec<&Rest> = rests.iter().collect();
        let is_si = table.accel_unit == RawUnit::Si;
        let fit = accelerometer::fit(&all, options.gravity_mps2, nominal, is_si, held)?;
        Ok::<_, Error>((fit, rests))
    };
    if let MeanNoise::Each(std) = table.noise {
        let (fit, rests) = fit_with(&|row| Vector3::from(std[row]).map(|std| std * std))?;
        return Ok(Fitted { fit, rests, noise_from_residuals_mps2: None });
    }
    let of_rows = |pick: fn(&Vector3<f64>, &Vector3<f64>) -> Vector3<f64>| {
        table.specific_force.iter().map(|row| Vector3::from(*row)).reduce(|a, b| pick(&a, &b)).unwrap_or_default()
    };
    let size = (of_rows(|a, b| a.sup(b)) - of_rows(|a, b| a.inf(b))).max() / 2.0;
    let (first, _) = fit_with(&|_| Vector3::repeat((FIRST_GUESS * size).powi(2)))?;
    let (noise, is_known) = match table.noise {
        MeanNoise::Common(noise) => (noise, true),
        _ => (noise_of_residuals(table, &first, options)?, false),
    };
    let raw = scales(&first.triad).map(|scale| (noise * scale).powi(2));
    let (fit, rests) = fit_with(&|_| raw)?;
    Ok(Fitted { fit, rests, noise_from_residuals_mps2: (!is_known).then_some(noise) })
}

/// Nominal sensitivity of the accelerometer, raw units per m/s^2; `None` if it is not known.
fn nominal_of(table: &MeanReadings<'_>, options: &Options<'_>) -> Option<f64> {
    if table.accel_unit == RawUnit::Si { Some(1.0) } else { options.accel_nominal }
}

/// Scale of each axis, raw units per m/s^2.
fn scales(triad: &Triad<f64>) -> Vector3<f64> {
    Vector3::from_fn(|axis, _| triad.sensitivity().row(axis).norm())
}

/// Computes the standard deviation of the norm of a mean force, m/s^2, from the residuals of a fit.
fn noise_of_residuals(table: &MeanReadings<'_>, fit: &AccelerometerFit, options: &Options<'_>) -> Result<f64, Error> {
    let free = fit.report.degrees_of_freedom;
    let rows = table.specific_force.len();
    if free == 0 {
        return Err(Error::NotEnoughMotion(format!(
            "{}: {rows} rows determine the parameters exactly, so the noise of the means does not follow from the \
             residuals: give their standard deviation (noise_mps2=..., --noise), or add rows in other poses",
            table.name
        )));
    }
    let error = |row: &[f64; 3]| fit.triad.correct((*row).into()).norm() - options.gravity_mps2;
    let size = rms(table.specific_force.iter().map(error));
    Ok(size * (rows as f64 / free as f64).sqrt())
}

fn rest(row: usize, mean: &[f64; 3], variance_of_mean: Vector3<f64>) -> Rest {
    let none = Vector3::repeat(f64::NAN);
    Rest {
        first: row,
        end: row + 1,
        start_s: f64::NAN,
        end_s: f64::NAN,
        unsteadiness: f64::NAN,
        specific_force: RestMean { mean: (*mean).into(), variance_of_mean, rounding: Default::default() },
        angular_rate: RestMean { mean: none, variance_of_mean: none, rounding: Default::default() },
    }
}

fn bias_of(rates: &[[f64; 3]]) -> RestBias {
    let count = rates.len() as f64;
    let rows = || rates.iter().map(|row| Vector3::from(*row));
    let value = rows().sum::<Vector3<f64>>() / count;
    let squares = rows().map(|row| (row - value).component_mul(&(row - value))).sum::<Vector3<f64>>();
    // For a single row, 0 / 0 gives NaN.
    RestBias { value, std: (squares / (count - 1.0) / count).map(f64::sqrt) }
}

/// Returns an error if the columns of the table have different lengths, if a value is not finite, or if a noise is not
/// positive.
fn require_finite(table: &MeanReadings<'_>) -> Result<(), Error> {
    let rows = table.specific_force.len();
    let columns = [
        ("specific_force", Some(table.specific_force)),
        ("angular_rate", table.angular_rate),
        ("specific_force_std", if let MeanNoise::Each(std) = table.noise { Some(std) } else { None }),
    ];
    for (name, values) in columns.into_iter().filter_map(|(name, values)| Some((name, values?))) {
        if values.len() != rows {
            return Err(Error::Input(format!(
                "{}: {name} has {} rows, specific_force {rows}: one row for each rest is needed",
                table.name,
                values.len()
            )));
        }
        let is_wrong = |row: &[f64; 3]| {
            row.iter().any(|value| !value.is_finite() || (name == "specific_force_std" && *value <= 0.0))
        };
        if let Some(row) = values.iter().position(is_wrong) {
            return Err(Error::Input(format!(
                "{}: {name} in row {} is {:?}: every mean is a number, and every standard deviation a positive one",
                table.name,
                row + 1,
                values[row]
            )));
        }
    }
    match table.noise {
        MeanNoise::Common(noise) if !(noise > 0.0 && noise.is_finite()) => Err(Error::Input(format!(
            "{}: the noise of the means is {noise} m/s^2: a positive number is needed",
            table.name
        ))),
        _ => Ok(()),
    }
}
