//! Correction of a whole recording by a calibration.
//!
//! ```text
//! seen = T^-1 (measured - b)
//! true <- seen - sum_c Phi_c(true) theta_c      model.md (16)
//! ```
//!
//! T is the sensitivity and b the bias of a triad. `seen` is the true value plus the effects. Phi_c is the field of
//! effect c: the derivatives of the error that the effect adds, with respect to the parameters theta_c of the effect.
//! The second line is repeated until `true` converges, because the fields depend on `true`.
//!
//! Effects may depend on other quantities in addition to rate and force. A recording provides the time since its first
//! sample. If it has a temperature column, it also provides the temperature minus [`REFERENCE_TEMPERATURE_DEGC`], and
//! the temperature history. The derivative of the rate provides the angular acceleration ([`angular_acceleration`]). A
//! recording provides neither the attitude nor the angles of a stand. The rate of the Earth is not removed, because the
//! attitude is not known. This rate is not an error of the gyroscope, because a gyroscope measures the rate relative to
//! inertial space.

use crate::cancellation::checkpoint;
use crate::error::Error;
use crate::numerics::derivative::Derivative;
use crate::recording::{REFERENCE_TEMPERATURE_DEGC, Recording};
use imucal_core::calibration::Calibration;
use imucal_core::effects::{Effect, EffectSet, Need, Sensor, Surroundings};
use imucal_core::temperature_memory::{TemperatureHistory, TemperatureMemory};
use nalgebra::Vector3;

/// Number of samples between two checks for a cancellation. The correction of this number of samples takes about a
/// millisecond.
const SAMPLES_PER_CHECKPOINT: usize = 4096;

/// Whether a correction cannot remove an effect from the data. Such an effect acts on the encoders of a stand, or
/// depends on a quantity that no recording contains (for example the attitude).
pub fn is_left_in_data(effect: &Effect<f64>) -> bool {
    let is_given = |need: &Need| {
        matches!(need, Need::Time | Need::Temperature | Need::TemperatureHistory | Need::AngularAcceleration)
    };
    effect.sensor == Sensor::Encoder || !effect.needs.iter().all(is_given)
}

/// Corrects every sample. Returns the true `(angular_rate, specific_force)`, rad/s and m/s^2, in the body frame.
///
/// A corrected sample is NaN if the raw sample is NaN, or if the effects are too large to be removed. Effects of
/// temperature are removed only if there is a temperature column. Effects of angular acceleration are removed only if
/// the recording has more than one sample.
pub fn correct(recording: &Recording<'_>, calibration: &Calibration<f64>) -> (Vec<[f64; 3]>, Vec<[f64; 3]>) {
    correct_from(None, recording, calibration)
}

/// Returns an error for a recording that lacks a quantity on which an effect of the calibration depends.
///
/// # Errors
/// [`Error::Input`] in two cases. First, an effect depends on temperature, and there is no temperature column. Second,
/// an effect depends on the angular acceleration, and the recording has a single sample or decreasing times.
pub fn require_surroundings(recording: &Recording<'_>, calibration: &Calibration<f64>) -> Result<(), Error> {
    let name = recording.name;
    for effect in calibration.effects.iter().map(|values| values.effect()) {
        let refused = |words: String| Err(Error::Input(words));
        if effect.needs.contains(&Need::Temperature) && recording.temperature_degc.is_none() {
            return refused(format!(
                "{name} has no temperature_degc (temp_degc in a file) and {} depends on it: record the temperature, or leave \
                 the effect out of the calibration",
                effect.name
            ));
        }
        if !effect.needs.contains(&Need::AngularAcceleration) {
            continue;
        }
        if recording.len() == 1 {
            return refused(format!(
                "{name} has one sample and {} depends on angular acceleration: give two",
                effect.name
            ));
        }
        let is_forward = |pair: &[f64]| pair[1] - pair[0] >= 0.0;
        if let Some(k) = recording.time_s.windows(2).position(|pair| !is_forward(pair)) {
            return refused(format!(
                "{name}: time_s goes back from sample {k} to {} and {} depends on angular acceleration: give times in their \
                 order",
                k + 1,
                effect.name
            ));
        }
    }
    Ok(())
}

/// Corrects a part of a longer recording, as [`correct`] does. `start_s` is the time of the first sample of the longer
/// recording. `start_s` is `None` if the part starts with this sample.
pub fn correct_from(
    start_s: Option<f64>,
    recording: &Recording<'_>,
    calibration: &Calibration<f64>,
) -> (Vec<[f64; 3]>, Vec<[f64; 3]>) {
    let start_s = start_s.or(recording.time_s.first().copied()).unwrap_or(0.0);
    let accelerations = |rate: &[[f64; 3]]| angular_acceleration(recording.time_s, rate);
    if !calibration.effects.iter().any(|values| values.effect().needs.contains(&Need::AngularAcceleration)) {
        return correct_with(start_s, recording, calibration, &[], &[]);
    }
    let seen = |raw: [f64; 3]| <[f64; 3]>::from(calibration.gyroscope.correct(Vector3::from(raw)));
    let rate: Vec<[f64; 3]> = recording.angular_rate.iter().map(seen).collect();
    // The angular acceleration is the derivative of the true rate, which is known only after the correction. The first
    // correction uses the rate before effects are removed, and the second correction uses the corrected rate. For a
    // gyroscope with the delay tau, the remaining error is `tau^3 / 6` times the third derivative of the rate. Further
    // iterations would amplify noise.
    let of_seen = accelerations(&rate);
    let (rate, _) = correct_with(start_s, recording, calibration, &of_seen, &of_seen);
    correct_with(start_s, recording, calibration, &accelerations(&rate), &of_seen)
}

/// Corrects every sample with the given angular accelerations, rad/s^2. `acceleration` contains the derivatives of the
/// corrected rate. `seen_acceleration` contains the derivatives of the measured rate, which is delayed if the gyroscope
/// has a delay. The mean of both derivatives approximates the mean angular acceleration over the delay. The error of
/// this approximation is proportional to the square of the delay. Both slices are empty if the angular acceleration is
/// unknown.
fn correct_with(
    start_s: f64,
    recording: &Recording<'_>,
    calibration: &Calibration<f64>,
    acceleration: &[[f64; 3]],
    seen_acceleration: &[[f64; 3]],
) -> (Vec<[f64; 3]>, Vec<[f64; 3]>) {
    let history = temperature_history(recording, &calibration.effects);
    let samples = recording.angular_rate.iter().zip(recording.specific_force.iter()).zip(recording.time_s).enumerate();
    let corrected = samples.map(|(i, ((rate, force), time_s))| {
        if i % SAMPLES_PER_CHECKPOINT == 0 {
            checkpoint();
        }
        let temperature = recording.temperature_degc.and_then(|column| column.get(i));
        let acceleration_of = |rows: &[[f64; 3]]| rows.get(i).map(|value| Vector3::from(*value));
        let [now, seen] = [acceleration, seen_acceleration].map(acceleration_of);
        let surroundings = Surroundings {
            angular_acceleration: now,
            mean_angular_acceleration: now.zip(seen).map(|(now, seen)| (now + seen) / 2.0),
            temperature_difference_k: temperature.map(|degc| degc - REFERENCE_TEMPERATURE_DEGC),
            temperature_history: history.get(i).copied(),
            time_s: Some(time_s - start_s),
            ..Surroundings::unknown()
        };
        let (rate, force) = calibration.correct_at(Vector3::from(rate), Vector3::from(force), &surroundings);
        (<[f64; 3]>::from(rate), <[f64; 3]>::from(force))
    });
    corrected.unzip()
}

/// Computes the temperature history at each sample, from the first sample on: the derivative of the temperature, the
/// direction of its last change, and the lags of both sensors. Empty if no effect depends on the temperature history,
/// or if the recording has no temperature.
pub(crate) fn temperature_history(recording: &Recording<'_>, effects: &EffectSet<f64>) -> Vec<TemperatureHistory<f64>> {
    let needs_history = effects.iter().any(|member| member.effect().has_need(Need::TemperatureHistory));
    match recording.temperature_degc {
        Some(degc) if needs_history => {
            temperature_history_of(TemperatureMemory::new(effects), recording.time_s, degc).collect()
        }
        _ => Vec::new(),
    }
}

/// Computes the temperature history at each sample: the derivative of the temperature, the direction of its last
/// change, and the lags of both sensors. `memory` contains the filters that compute it, and must not have received a
/// temperature before.
pub fn temperature_history_of<'t>(
    mut memory: TemperatureMemory<f64>,
    time_s: &'t [f64],
    temperature_degc: &'t [f64],
) -> impl Iterator<Item = TemperatureHistory<f64>> + 't {
    let steps = time_s.iter().scan(None, |last: &mut Option<f64>, time_s| {
        Some(last.replace(*time_s).map_or(0.0, |last_s| (time_s - last_s).max(0.0)))
    });
    steps.zip(temperature_degc).map(move |(step_s, degc)| memory.update(step_s, degc - REFERENCE_TEMPERATURE_DEGC))
}

/// Computes the derivative of the angular rate with respect to time, rad/s^2, one row per sample; empty for a single
/// sample.
///
/// It is the derivative of a polynomial through the mean rates in five consecutive time intervals. The intervals are as
/// long as the motion permits, between 2 ms (at least one sample) and 0.1 s (`docs/model.md` (16)). Time steps may be
/// uneven. Samples with equal time stamps count as one sample and get equal derivatives.
pub fn angular_acceleration(time_s: &[f64], angular_rate: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let rate: Vec<Vector3<f64>> = angular_rate.iter().map(|row| Vector3::from(*row)).collect();
    Derivative::smooth(time_s, &rate).of(&rate).into_iter().map(<[f64; 3]>::from).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use imucal_core::effects::{Effect, EffectValues, State};
    use imucal_core::sensor::Triad;
    use nalgebra::Matrix3;

    #[test]
    fn samples_at_one_time_have_one_slope() {
        let mut time_s = uneven_time(20);
        time_s[7] = time_s[6];
        let rate: Vec<[f64; 3]> = time_s.iter().map(|t| [2.0 * t, -t, 0.0]).collect();
        for slope in angular_acceleration(&time_s, &rate) {
            assert!((Vector3::from(slope) - Vector3::new(2.0, -1.0, 0.0)).norm() < 1e-9, "{slope:?}");
        }
    }

    /// The times of `n` samples, s, with uneven steps between 6 and 14 ms.
    fn uneven_time(n: usize) -> Vec<f64> {
        (0..n).map(|i| 70.0 + 0.01 * i as f64 + 0.0025 * (i as f64 * 1.7).sin()).collect()
    }

    fn unit(name: &str, values: &[f64], shape: Option<f64>) -> Calibration<f64> {
        let triad = |scale: f64, bias: f64| {
            let sensitivity = Matrix3::new(1.0, 0.01, 0.0, -0.02, 0.98, 0.0, 0.0, 0.01, 1.03) * scale;
            Triad::try_new(sensitivity, Vector3::new(bias, -bias, 0.0)).unwrap()
        };
        let mut unit = Calibration::new(triad(1.0, 0.1), triad(4000.0, 30.0));
        unit.effects.push(EffectValues::try_new(Effect::find(name).unwrap(), values, shape).unwrap()).unwrap();
        unit
    }

    /// Simulates the samples that `unit` measures during a motion, corrects them, and returns the largest errors of
    /// rate and force. Rate and force of the motion are quadratic in time. The gyroscope has a delay of `delay_s`, if
    /// the unit has the effect `gyro_time_offset`.
    fn round_trip(unit: &Calibration<f64>, delay_s: f64, with_temperature: bool) -> (f64, f64) {
        let time_s = uneven_time(200);
        let temperature: Vec<f64> = time_s.iter().map(|t| 20.0 + 3.0 * (t - 70.0)).collect();
        let truth: Vec<_> = time_s
            .iter()
            .zip(&temperature)
            .map(|(t, degc)| {
                let t = t - time_s[0];
                State {
                    angular_rate: Vector3::new(1.0 - t, 2.0 * t, t * t - 1.0),
                    specific_force: Vector3::new(3.0, -9.0 + t, 2.0),
                    surroundings: Surroundings {
                        angular_acceleration: Some(Vector3::new(-1.0, 2.0, 2.0 * t)),
                        mean_angular_acceleration: Some(Vector3::new(-1.0, 2.0, 2.0 * t - delay_s)),
                        temperature_difference_k: with_temperature.then_some(degc - REFERENCE_TEMPERATURE_DEGC),
                        time_s: Some(t),
                        ..Surroundings::unknown()
                    },
                }
            })
            .collect();
        let (rate, force): (Vec<[f64; 3]>, Vec<[f64; 3]>) = truth
            .iter()
            .map(|state| unit.measure(state))
            .map(|(rate, force)| (<[f64; 3]>::from(rate), <[f64; 3]>::from(force)))
            .unzip();
        let recording = Recording {
            temperature_degc: with_temperature.then_some(temperature.as_slice()),
            ..Recording::try_new("run", &time_s, &force, &rate).unwrap()
        };
        let (rate, force) = correct(&recording, unit);
        assert_eq!((rate.len(), force.len()), (200, 200));
        let error = |got: &[f64; 3], expected: &Vector3<f64>| (Vector3::from(*got) - expected).amax();
        truth.iter().zip(rate.iter().zip(&force)).fold((0.0, 0.0), |worst: (f64, f64), (state, (rate, force))| {
            (worst.0.max(error(rate, &state.angular_rate)), worst.1.max(error(force, &state.specific_force)))
        })
    }

    #[test]
    fn time_is_counted_from_the_first_sample_and_temperature_from_the_reference() {
        for (name, shape) in [("gyro_bias_drift", None), ("gyro_bias_warmup", Some(0.7)), ("accel_bias_drift", None)] {
            let errors = round_trip(&unit(name, &[0.1, -0.2, 0.3], shape), 0.0, true);
            assert!(errors.0 < 1e-13 && errors.1 < 1e-13, "{name}: {errors:?}");
        }
        let errors = round_trip(&unit("gyro_bias_temperature", &[1e-3, 2e-3, -1e-3], None), 0.0, true);
        assert!(errors.0 < 1e-13, "{errors:?}");
    }

    #[test]
    fn a_lever_arm_is_taken_away_to_rounding_where_the_rate_is_a_parabola() {
        // The lever arm affects only the accelerometer, so the measured rate equals the true rate. The numerical
        // derivative of this parabola is exact at every sample, also at the first and the last one.
        let errors = round_trip(&unit("accel_lever_arm", &[0.02, -0.03, 0.05], None), 0.0, false);
        assert!(errors.0 < 1e-13 && errors.1 < 1e-11, "{errors:?}");
    }

    #[test]
    fn a_delay_is_taken_away_but_for_its_cube() {
        // The error that remains is proportional to the third derivative of the rate. It is zero here, because the rate
        // is a parabola in time.
        for delay_s in [2e-3, 25e-3, -25e-3] {
            let (error, _) = round_trip(&unit("gyro_time_offset", &[delay_s], None), delay_s, false);
            assert!(error < 1e-11, "{delay_s}: {error}");
        }
    }

    #[test]
    fn without_a_temperature_column_its_effects_are_left_out() {
        let errors = round_trip(&unit("gyro_bias_temperature", &[1e-3, 2e-3, -1e-3], None), 0.0, false);
        assert!(errors.0 < 1e-13, "{errors:?}");
    }

    #[test]
    fn the_earths_rate_stays_in_the_data() {
        let plain = Calibration::<f64>::identity();
        let mut with_earth = plain;
        let effect = Effect::find("earth_rate").unwrap();
        with_earth.effects.push(EffectValues::try_new(effect, &[1e-4, 0.0, 1e-4], None).unwrap()).unwrap();
        let (rate, force) = ([[0.1, 0.2, 0.3], [0.2, 0.1, 0.0]], [[0.0, 0.0, 9.8]; 2]);
        let recording = Recording::try_new("run", &[0.0, 0.01], &force, &rate).unwrap();
        assert_eq!(correct(&recording, &with_earth), (rate.to_vec(), force.to_vec()));
        assert_eq!(correct(&recording, &plain), (rate.to_vec(), force.to_vec()));
    }

    #[test]
    fn the_derivative_of_a_quartic_is_exact_at_every_sample() {
        // The derivative averages samples over intervals and tries several widths of these intervals. The narrowest
        // interval contains one sample if the time steps are 10 ms, and five samples if they are 0.4 ms.
        for stretch in [1.0, 0.04] {
            let time_s: Vec<f64> = uneven_time(60).iter().map(|t| stretch * (t - 70.0)).collect();
            let rate: Vec<[f64; 3]> = time_s.iter().map(|t| [2.0, t - 3.0 * t * t, t.powi(4)]).collect();
            for (t, row) in time_s.iter().zip(angular_acceleration(&time_s, &rate)) {
                let expected = Vector3::new(0.0, 1.0 - 6.0 * t, 4.0 * t.powi(3));
                assert!((Vector3::from(row) - expected).amax() < 1e-12, "{t}: {row:?}");
            }
        }
    }

    #[test]
    fn any_number_of_samples_has_a_derivative() {
        for n in 2..80 {
            let time_s: Vec<f64> = (0..n).map(|i| f64::from(i) * 3e-4).collect();
            let rate: Vec<[f64; 3]> = time_s.iter().map(|t| [5.0 * t; 3]).collect();
            let slopes = angular_acceleration(&time_s, &rate);
            assert_eq!(slopes.len(), time_s.len());
            assert!(slopes.iter().flatten().all(|slope| (slope - 5.0).abs() < 1e-11), "{n}: {slopes:?}");
        }
    }

    #[test]
    fn few_samples_have_the_derivative_that_they_allow() {
        assert!(angular_acceleration(&[], &[]).is_empty());
        assert!(angular_acceleration(&[1.0], &[[1.0; 3]]).is_empty());
        assert_eq!(angular_acceleration(&[1.0, 1.5], &[[1.0; 3], [2.0; 3]]), [[2.0; 3]; 2]);
        let parabola = angular_acceleration(&[0.0, 1.0, 3.0], &[[0.0; 3], [1.0; 3], [9.0; 3]]);
        assert!(
            parabola.iter().zip([0.0, 2.0, 6.0]).all(|(row, slope)| (row[0] - slope).abs() < 1e-14),
            "{parabola:?}"
        );
        assert!(angular_acceleration(&[1.0, 1.0], &[[1.0; 3], [1.0; 3]]).is_empty());
    }
}
