//! Computes the expected errors of calibration parameters, and the changes of the corrected signals that parameter
//! errors cause. The signals are averaged over one second.

use std::ops::Range;

use faer::Mat;
use faer::linalg::solvers::Solve;
use imucal_core::effects::{Columns, Effect, MAX_PARAMETERS, Need, Sensor, State, Surroundings};
use imucal_core::temperature_memory::{TemperatureHistory, TemperatureMemory};
use nalgebra::{Matrix3, Vector3};

use crate::calibrate::{Outcome, TermEstimate, UserField};
use crate::correct::{angular_acceleration, is_left_in_data, temperature_history_of};
use crate::error::Error;
use crate::frame::Frame;
use crate::recording::{REFERENCE_TEMPERATURE_DEGC, Recording, Samples};

/// Length of the windows over which corrected signals are averaged, s. Calibration errors vary as slowly as the motion,
/// so averaging over one second hardly changes them. White noise of density N has the standard deviation N / sqrt(1 s)
/// after averaging.
pub(super) const WINDOW_S: f64 = 1.0;
/// Lower bound of the estimated size of an effect, as a fraction of the typical size of this effect.
const LEAST_SIZE: f64 = 0.01;
/// Number of fixed-point iterations that estimate the size of an effect. It is larger than needed for convergence.
const SIZE_ITERATIONS: usize = 30;
/// Step of the numerical derivative with respect to a time constant, as a share of the time constant.
const SHAPE_STEP: f64 = 0.01;

/// Corrected angular rate x, y, z, rad/s, and specific force x, y, z, m/s^2.
pub(super) type Signals = [f64; 6];

/// The estimated parameters of a calibration. A parameter with a standard deviation of zero was not estimated and is
/// omitted.
pub(super) struct Parameters {
    /// Index of each estimated parameter in the list of all parameters of the calibration. This list also contains
    /// parameters that were not estimated.
    places: Vec<usize>,
    /// Standard deviations, in the units of the parameters.
    sigma: Vec<f64>,
    correlation: Mat<f64>,
}

/// The windows of one second into which a recording is divided, as ranges of samples.
pub(super) struct Windows {
    samples: Vec<Range<usize>>,
}

impl Windows {
    /// Divides a recording into consecutive complete windows from the first sample on. A recording shorter than one
    /// window gives one window.
    pub(super) fn of(time_s: &[f64]) -> Self {
        let (Some(&start), Some(&end)) = (time_s.first(), time_s.last()) else {
            return Self { samples: Vec::new() };
        };
        let count = (((end - start) / WINDOW_S) as usize).max(1);
        let sample = |edge: usize| time_s.partition_point(|time| *time < start + WINDOW_S * edge as f64);
        Self { samples: (0..count).map(|k| sample(k)..sample(k + 1)).collect() }
    }

    pub(super) fn count(&self) -> usize {
        self.samples.len()
    }

    /// Mean of `row` over the samples of each window; NaN for windows without samples.
    pub(super) fn means(&self, row: impl Fn(usize) -> Vector3<f64>) -> Vec<Vector3<f64>> {
        let mean = |samples: &Range<usize>| samples.clone().map(&row).sum::<Vector3<f64>>() / samples.len() as f64;
        self.samples.iter().map(mean).collect()
    }
}

impl Parameters {
    pub(super) fn of(outcome: &Outcome) -> Self {
        let covariance = &outcome.covariance;
        let places: Vec<usize> = (0..covariance.len()).filter(|&p| covariance[p][p] > 0.0).collect();
        let sigma: Vec<f64> = places.iter().map(|&p| covariance[p][p].sqrt()).collect();
        let correlation =
            Mat::from_fn(places.len(), places.len(), |i, j| covariance[places[i]][places[j]] / (sigma[i] * sigma[j]));
        Self { places, sigma, correlation }
    }

    pub(super) fn count(&self) -> usize {
        self.places.len()
    }

    /// For each parameter: the change of the corrected signals in each window if this parameter changes by its standard
    /// deviation. The shape is (P, windows) for P parameters.
    ///
    /// `corrected` is `recording` after correction. `user_fields` contains, for each user-defined effect, the sensor on
    /// which it acts, and the error of this sensor per unit of each parameter at each sample of `corrected`. Effects
    /// are evaluated at the corrected signals instead of the true signals. The difference is negligible, because
    /// effects are small compared with the signals.
    pub(super) fn slopes(
        &self,
        outcome: &Outcome,
        recording: &Recording<'_>,
        corrected: &Recording<'_>,
        windows: &Windows,
        user_fields: &[(Sensor, &[f64])],
    ) -> Result<Vec<Vec<Signals>>, Error> {
        let mut slopes = sensor_slopes(outcome, recording, windows);
        slopes.extend(effect_slopes(outcome, corrected, windows, user_fields)?);
        let scaled = |(&place, &sigma): (&usize, &f64)| {
            slopes[place].iter().map(|signals| signals.map(|slope| slope * sigma)).collect()
        };
        Ok(self.places.iter().zip(&self.sigma).map(scaled).collect())
    }

    /// Expected errors of the parameters, and the covariance of these errors. Each error is divided by the standard
    /// deviation of its parameter. `typical` are the typical sizes of the linear parameters of each effect.
    ///
    /// In the fit, the standard deviation of an effect's prior is at least the typical size of the effect
    /// (docs/model.md (23)). If the estimated effect is smaller, the result is computed for a narrower prior whose
    /// standard deviation is the estimated size. The narrower prior also reduces the uncertainty in directions of
    /// parameter space that the data do not determine.
    pub(super) fn expected_errors(&self, outcome: &Outcome, typical: &[Vec<f64>]) -> (Vec<f64>, Mat<f64>) {
        let (mut errors, mut covariance) = (vec![0.0; self.count()], self.correlation.clone());
        let mut first = 21;
        for (term, typical) in outcome.effects.iter().zip(typical) {
            let of_effect = first..first + term.values.len();
            first += term.parameter_names.len();
            let own: Vec<usize> = (0..self.count()).filter(|&k| of_effect.contains(&self.places[k])).collect();
            if own.is_empty() {
                continue;
            }
            let in_sigma = |k: usize, value: f64| value / self.sigma[k];
            let values: Vec<f64> =
                own.iter().map(|&k| in_sigma(k, outcome.values[self.places[k]]) - errors[k]).collect();
            let typical: Vec<f64> =
                own.iter().map(|&k| in_sigma(k, typical[self.places[k] - of_effect.start])).collect();
            let (shift, narrowed) = narrowed(&covariance, &own, &values, &typical);
            errors.iter_mut().zip(shift).for_each(|(error, shift)| *error += shift);
            covariance = narrowed;
        }
        (errors, covariance)
    }
}

/// Returns the expected errors and the covariance of all parameters for a narrower prior of one effect. `own` are the
/// indices of the parameters of this effect. `values` are the estimates of these parameters and `typical` their typical
/// sizes, each divided by the parameter's standard deviation. The prior of each parameter of this effect has the
/// standard deviation s x typical size. The factor s is the estimated size of the effect relative to its typical size,
/// at most 1. It is the same for all parameters of the effect.
fn narrowed(covariance: &Mat<f64>, own: &[usize], values: &[f64], typical: &[f64]) -> (Vec<f64>, Mat<f64>) {
    let (n, p) = (covariance.nrows(), own.len());
    let (mut square, mut shift, mut narrowed) = (1.0f64, vec![0.0; n], covariance.clone());
    for _ in 0..SIZE_ITERATIONS {
        let of_own = || own.iter().zip(values).zip(typical);
        let visible: f64 =
            of_own().map(|((&k, _), typical)| 1.0 - narrowed[(k, k)] / (square * typical * typical)).sum();
        let size: f64 = of_own().map(|((&k, value), typical)| ((value - shift[k]) / typical).powi(2)).sum();
        square = (size / visible.max(1e-3)).clamp(LEAST_SIZE * LEAST_SIZE, 1.0);
        let weight: Vec<f64> = typical.iter().map(|typical| (1.0 / square - 1.0).sqrt() / typical).collect();
        let across = Mat::from_fn(n, p, |i, j| covariance[(i, own[j])] * weight[j]);
        let within = Mat::from_fn(p, p, |i, j| f64::from(u8::from(i == j)) + weight[i] * across[(own[i], j)]);
        narrowed = covariance - &across * within.partial_piv_lu().solve(across.transpose());
        shift =
            (0..n).map(|i| (0..p).map(|j| narrowed[(i, own[j])] * weight[j] * weight[j] * values[j]).sum()).collect();
    }
    (shift, narrowed)
}

/// Derivatives of the corrected signals in each window with respect to the 21 base parameters (sensitivities and
/// biases).
fn sensor_slopes(outcome: &Outcome, recording: &Recording<'_>, windows: &Windows) -> Vec<Vec<Signals>> {
    let seen = |raw: Samples<'_>, triad: &imucal_core::sensor::Triad<f64>| {
        windows.means(|sample| triad.correct(Vector3::from(raw.at(sample))))
    };
    let (accelerometer, gyroscope) = (&outcome.calibration.accelerometer, &outcome.calibration.gyroscope);
    let (force, rate) = (seen(recording.specific_force, accelerometer), seen(recording.angular_rate, gyroscope));
    let free = outcome.frame.free_entries();
    (0..21)
        .map(|p| match p {
            0..3 => by_bias(accelerometer.inverse(), p, force.len(), Sensor::Accelerometer),
            3..9 => {
                let (i, j) = free[p - 3];
                let mut slope = by_sensitivity(accelerometer.inverse(), (i, j), &force, Sensor::Accelerometer);
                if outcome.frame == Frame::Symmetric && i != j {
                    let mirrored = by_sensitivity(accelerometer.inverse(), (j, i), &force, Sensor::Accelerometer);
                    slope
                        .iter_mut()
                        .flatten()
                        .zip(mirrored.iter().flatten())
                        .for_each(|(slope, other)| *slope += other);
                }
                slope
            }
            9..12 => by_bias(gyroscope.inverse(), p - 9, rate.len(), Sensor::Gyroscope),
            _ => by_sensitivity(gyroscope.inverse(), ((p - 12) / 3, (p - 12) % 3), &rate, Sensor::Gyroscope),
        })
        .collect()
}

/// Derivative with respect to the bias on axis i. With the sensitivity matrix T, the bias b and the unit vector e_i,
/// `corrected = T^-1 (raw - b)`, so `d corrected / d b_i = -T^-1 e_i`.
fn by_bias(inverse: &Matrix3<f64>, i: usize, windows: usize, sensor: Sensor) -> Vec<Signals> {
    vec![signals(-inverse.column(i), sensor); windows]
}

/// Derivative with respect to element ij of the sensitivity matrix T: `d corrected / d T_ij = -T^-1 e_i corrected_j`,
/// with the unit vector e_i.
fn by_sensitivity(
    inverse: &Matrix3<f64>,
    (i, j): (usize, usize),
    corrected: &[Vector3<f64>],
    sensor: Sensor,
) -> Vec<Signals> {
    corrected.iter().map(|corrected| signals(-inverse.column(i) * corrected[j], sensor)).collect()
}

/// Derivatives of the corrected signals with respect to the parameters of each effect. The linear parameters come
/// first, then the time constant.
fn effect_slopes(
    outcome: &Outcome,
    corrected: &Recording<'_>,
    windows: &Windows,
    user_fields: &[(Sensor, &[f64])],
) -> Result<Vec<Vec<Signals>>, Error> {
    let states = states(corrected);
    let mut user_fields = user_fields.iter();
    let mut slopes = Vec::new();
    for term in &outcome.effects {
        match Effect::<f64>::find(&term.name).filter(|_| term.in_catalogue) {
            Some(effect) if is_left_in_data(effect) => {
                slopes.extend(vec![vec![[0.0; 6]; windows.count()]; term.parameter_names.len()]);
            }
            Some(effect) => slopes.extend(catalogue_slopes(effect, term, (corrected, &states), windows)),
            None => {
                let missing = || Error::Input(format!("the field of {} is missing", term.name));
                let (sensor, columns) = user_fields.next().ok_or_else(missing)?;
                let width = term.values.len();
                if columns.len() != states.len() * 3 * width {
                    return Err(missing());
                }
                for k in 0..width {
                    let field = |sample: usize| Vector3::from_fn(|axis, _| columns[(3 * sample + axis) * width + k]);
                    slopes.push(windows.means(field).into_iter().map(|mean| signals(-mean, *sensor)).collect());
                }
            }
        }
    }
    Ok(slopes)
}

fn catalogue_slopes(
    effect: &Effect<f64>,
    term: &TermEstimate,
    (corrected, states): (&Recording<'_>, &[State<f64>]),
    windows: &Windows,
) -> Vec<Vec<Signals>> {
    let fields_for = |shape: Option<f64>| -> Vec<Columns<f64>> {
        let history = temperature_history(corrected, effect, shape);
        let field = |(k, state): (usize, &State<f64>)| {
            let mut columns: Columns<f64> = [Vector3::zeros(); MAX_PARAMETERS];
            let mut state = *state;
            state.surroundings.temperature_history = history.get(k).copied();
            effect.field(&state, shape.unwrap_or(1.0), &mut columns);
            columns
        };
        states.iter().enumerate().map(field).collect()
    };
    let fields = fields_for(term.shape);
    let slope = |of_sample: &dyn Fn(usize) -> Vector3<f64>| {
        windows.means(of_sample).into_iter().map(|mean| signals(-mean, effect.sensor)).collect()
    };
    let mut slopes: Vec<Vec<Signals>> = (0..term.values.len()).map(|k| slope(&|sample| fields[sample][k])).collect();
    if let Some(shape) = term.shape {
        let step = SHAPE_STEP * shape;
        let changed = fields_for(Some(shape + step));
        slopes.push(slope(&|sample| {
            let by_parameter = changed[sample].iter().zip(&fields[sample]).zip(&term.values);
            by_parameter.map(|((changed, plain), value)| (changed - plain) * (*value / step)).sum()
        }));
    }
    slopes
}

/// The temperature history at each sample for an effect with this time constant; empty if the effect does not depend on
/// the temperature history.
fn temperature_history(
    corrected: &Recording<'_>,
    effect: &Effect<f64>,
    shape: Option<f64>,
) -> Vec<TemperatureHistory<f64>> {
    match corrected.temperature_degc {
        Some(degc) if effect.needs.contains(&Need::TemperatureHistory) => {
            let memory = TemperatureMemory::with_time_constants(shape, shape);
            temperature_history_of(memory, corrected.time_s, degc).collect()
        }
        _ => Vec::new(),
    }
}

/// The states at which the fields of the effects (signal errors per unit of each parameter) are evaluated. A state
/// consists of the corrected signals, the angular acceleration, the time since the first sample in s, and the
/// temperature.
fn states(corrected: &Recording<'_>) -> Vec<State<f64>> {
    let rate: Vec<[f64; 3]> = corrected.angular_rate.iter().collect();
    let acceleration = angular_acceleration(corrected.time_s, &rate);
    let start_s = corrected.time_s.first().copied().unwrap_or(0.0);
    let state = |sample: usize| State {
        angular_rate: Vector3::from(rate[sample]),
        specific_force: Vector3::from(corrected.specific_force.at(sample)),
        surroundings: Surroundings {
            time_s: Some(corrected.time_s[sample] - start_s),
            angular_acceleration: acceleration.get(sample).map(|value| Vector3::from(*value)),
            temperature_difference_k: corrected.temperature_degc.map(|degc| degc[sample] - REFERENCE_TEMPERATURE_DEGC),
            ..Surroundings::unknown()
        },
    };
    (0..corrected.len()).map(state).collect()
}

/// Change of the corrected signals if the signal of `sensor` changes by `change` and the signal of the other sensor
/// does not change.
fn signals(change: Vector3<f64>, sensor: Sensor) -> Signals {
    let [x, y, z] = change.into();
    match sensor {
        Sensor::Gyroscope => [x, y, z, 0.0, 0.0, 0.0],
        Sensor::Accelerometer => [0.0, 0.0, 0.0, x, y, z],
        Sensor::Encoder => [0.0; 6],
    }
}

/// Typical sizes of the linear parameters of each effect of a calibration, SI units.
pub(super) fn typical_sizes(outcome: &Outcome, user_fields: &[UserField<'_>]) -> Vec<Vec<f64>> {
    let mut user_fields = user_fields.iter();
    let of = |term: &TermEstimate| match Effect::<f64>::find(&term.name).filter(|_| term.in_catalogue) {
        Some(effect) => effect.parameters.iter().map(|parameter| parameter.typical).collect(),
        None => user_fields.next().map(|field| field.typical.clone()).unwrap_or_default(),
    };
    outcome.effects.iter().map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::{EffectChoice, Options, calibrate};
    use crate::correct::correct;
    use crate::simulate::{Program, RandomMoves, Unit, simulate};
    use imucal_core::calibration::Calibration;
    use imucal_core::effects::EffectValues;
    use imucal_core::sensor::Triad;

    /// The calibration with the parameter at index `place` increased by `change`.
    fn changed(outcome: &Outcome, place: usize, change: f64) -> Calibration<f64> {
        let mut values = outcome.values.clone();
        values[place] += change;
        let free = Frame::Symmetric.free_entries();
        let mut force = *outcome.calibration.accelerometer.sensitivity();
        for (k, (i, j)) in free.into_iter().enumerate() {
            (force[(i, j)], force[(j, i)]) = (values[3 + k], values[3 + k]);
        }
        let triad = |sensitivity, bias: &[f64]| Triad::try_new(sensitivity, Vector3::from_column_slice(bias)).unwrap();
        let mut calibration = Calibration::new(
            triad(force, &values[..3]),
            triad(Matrix3::from_row_slice(&values[12..21]), &values[9..12]),
        );
        let mut first = 21;
        for term in &outcome.effects {
            let (linear, shape) = values[first..first + term.parameter_names.len()].split_at(term.values.len());
            first += term.parameter_names.len();
            let effect = Effect::find(&term.name).unwrap();
            calibration.effects.push(EffectValues::try_new(effect, linear, shape.first().copied()).unwrap()).unwrap();
        }
        calibration
    }

    #[test]
    fn slopes_are_differences_of_corrected_signals() {
        let effects = ["gyro_g_sensitivity", "gyro_bias_warmup", "accel_scale_quadratic"];
        let run =
            simulate(&Program::random(&RandomMoves::default(), 4).unwrap(), &Unit::paper(), 50.0, 9.80665, 4).unwrap();
        let recording = run.recording("run");
        let choice = |name: &&str| EffectChoice::plain(Effect::find(name).unwrap());
        let options = Options { effects: effects.iter().map(choice).collect(), ..Options::default() };
        let outcome = calibrate(&[recording], &options).unwrap();
        let (parameters, windows) = (Parameters::of(&outcome), Windows::of(recording.time_s));
        assert_eq!(parameters.count(), 21 + 9 + 4 + 3);
        let means = |calibration: &Calibration<f64>| {
            let (rate, force) = correct(&recording, calibration);
            let [rate, force] = [rate, force].map(|rows| windows.means(|sample| Vector3::from(rows[sample])));
            rate.into_iter().zip(force).map(|(w, f)| [w.x, w.y, w.z, f.x, f.y, f.z]).collect::<Vec<Signals>>()
        };
        let (rate, force) = correct(&recording, &outcome.calibration);
        let corrected = Recording { angular_rate: (&rate).into(), specific_force: (&force).into(), ..recording };
        let slopes = parameters.slopes(&outcome, &recording, &corrected, &windows, &[]).unwrap();
        for ((place, sigma), slope) in parameters.places.iter().zip(&parameters.sigma).zip(&slopes) {
            let step = 1e-2 * sigma;
            let (above, below) = (means(&changed(&outcome, *place, step)), means(&changed(&outcome, *place, -step)));
            let size = slope.iter().flatten().fold(0.0f64, |most, value| most.max(value.abs()));
            for (k, ((above, below), slope)) in above.iter().zip(&below).zip(slope).enumerate() {
                for axis in 0..6 {
                    let numeric = (above[axis] - below[axis]) / (2.0 * step) * sigma;
                    // The derivatives with respect to the base parameters are computed without effects. Effects would
                    // change these derivatives by about 1 %.
                    assert!(
                        (numeric - slope[axis]).abs() < 0.02 * size + 1e-12,
                        "{} window {k} axis {axis}: {numeric:e} {:e}",
                        outcome.names[*place],
                        slope[axis]
                    );
                }
            }
        }
    }

    #[test]
    fn an_effect_smaller_than_typical_narrows_its_prior_in_all_directions() {
        let covariance = Mat::from_fn(3, 3, |i, j| if i == j { 1.0 } else { 0.0 });
        // The first parameter is observable, and its estimate is near zero. The second parameter is not observable, so
        // its standard deviation equals the prior width.
        let (shift, narrowed) = narrowed(&covariance, &[0, 1], &[0.1, 0.0], &[10.0, 1.0]);
        assert!(narrowed[(1, 1)] < 0.1 && narrowed[(2, 2)] == 1.0, "{}", narrowed[(1, 1)]);
        assert!(shift[0].abs() < 0.1 && shift[2] == 0.0, "{shift:?}");
    }
}
