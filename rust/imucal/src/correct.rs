//! Correcting a whole recording, with the surroundings of each sample that it has.
//!
//! ```text
//! seen = T^-1 (measured - b)
//! true <- seen - sum_c Phi_c(true) theta_c      model.md (16)
//! ```
//!
//! The fields depend on more than rate and force. A recording gives the time since its first sample, the temperature less
//! [`REFERENCE_TEMPERATURE_DEGC`] where there is a column, and the angular acceleration as the derivative of the seen rate
//! ([`angular_acceleration`]). It gives no attitude and no angles of a stand: the Earth's rate, which a gyroscope rightly
//! measures, stays in the data.

use crate::recording::{REFERENCE_TEMPERATURE_DEGC, Recording};
use imucal_core::calibration::Calibration;
use imucal_core::effects::Surroundings;
use nalgebra::Vector3;

/// True `(angular_rate, specific_force)` of every sample, rad/s and m/s^2 in the body frame.
///
/// A sample is NaN where it was NaN before, and where the effects are too large to be undone. An effect of temperature is
/// left out without a temperature column, and one of angular acceleration with a single sample.
pub fn correct(recording: &Recording<'_>, calibration: &Calibration<f64>) -> (Vec<[f64; 3]>, Vec<[f64; 3]>) {
    let start_s = recording.time_s.first().copied().unwrap_or(0.0);
    let acceleration = if calibration.effects.is_empty() {
        Vec::new()
    } else {
        let seen = |raw: &[f64; 3]| <[f64; 3]>::from(calibration.gyroscope.correct(Vector3::from(*raw)));
        angular_acceleration(recording.time_s, &recording.angular_rate.iter().map(seen).collect::<Vec<_>>())
    };
    let samples = recording.angular_rate.iter().zip(recording.specific_force).zip(recording.time_s).enumerate();
    let corrected = samples.map(|(i, ((rate, force), time_s))| {
        let temperature = recording.temperature_degc.and_then(|column| column.get(i));
        let surroundings = Surroundings {
            angular_acceleration: acceleration.get(i).map(|value| Vector3::from(*value)),
            temperature_difference_k: temperature.map(|degc| degc - REFERENCE_TEMPERATURE_DEGC),
            time_s: Some(time_s - start_s),
            ..Surroundings::unknown()
        };
        let (rate, force) = calibration.correct_at(Vector3::from(*rate), Vector3::from(*force), &surroundings);
        (<[f64; 3]>::from(rate), <[f64; 3]>::from(force))
    });
    corrected.unzip()
}

/// Derivative of the angular rate by time, rad/s^2: central differences, one row for each sample; none for a single sample.
///
/// With the slopes `s_k` over the steps `h_k` it is `(h_k s_(k-1) + h_(k-1) s_k) / (h_(k-1) + h_k)`, and at both ends what
/// continues it. That is exact for a rate that is a parabola in time, and otherwise wrong by `h^2 / 6` times the third
/// derivative. It is taken once, from the rate as it is seen: repeated on the corrected rate, a delay of more than a sampling
/// interval would amplify the noise at each pass. Two equal times give NaN.
pub fn angular_acceleration(time_s: &[f64], angular_rate: &[[f64; 3]]) -> Vec<[f64; 3]> {
    let rate = |i: usize| Vector3::from(angular_rate[i]);
    let step = |k: usize| time_s[k + 1] - time_s[k];
    let slope = |k: usize| (rate(k + 1) - rate(k)) / step(k);
    let inner = |i: usize| (slope(i - 1) * step(i) + slope(i) * step(i - 1)) / (step(i - 1) + step(i));
    let n = time_s.len().min(angular_rate.len());
    (0..n)
        .filter(|_| n > 1)
        .map(|i| match i {
            _ if n == 2 => slope(0),
            0 => slope(0) * 2.0 - inner(1),
            _ if i == n - 1 => slope(n - 2) * 2.0 - inner(n - 2),
            _ => inner(i),
        })
        .map(<[f64; 3]>::from)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use imucal_core::effects::{Effect, EffectValues, State};
    use imucal_core::sensor::Triad;
    use nalgebra::Matrix3;

    /// Uneven steps between 5 and 15 ms.
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

    /// The largest errors of rate and force after `unit` has measured and corrected a run of parabolas in time.
    fn round_trip(unit: &Calibration<f64>, with_temperature: bool) -> (f64, f64) {
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
            let errors = round_trip(&unit(name, &[0.1, -0.2, 0.3], shape), true);
            assert!(errors.0 < 1e-13 && errors.1 < 1e-13, "{name}: {errors:?}");
        }
        let errors = round_trip(&unit("gyro_bias_temperature", &[1e-3, 2e-3, -1e-3], None), true);
        assert!(errors.0 < 1e-13, "{errors:?}");
    }

    #[test]
    fn a_lever_arm_is_taken_away_to_rounding_where_the_rate_is_a_parabola() {
        // The lever arm is of the accelerometer, so that the seen rate is the true one; ends included.
        let errors = round_trip(&unit("accel_lever_arm", &[0.02, -0.03, 0.05], None), false);
        assert!(errors.0 < 1e-13 && errors.1 < 1e-11, "{errors:?}");
    }

    #[test]
    fn a_delay_is_taken_away_but_for_its_square() {
        // The derivative is that of the late rate: tau^2 times the second derivative, 2 rad/s^3, is left.
        let tau = 1e-3;
        let (error, _) = round_trip(&unit("gyro_time_offset", &[tau], None), false);
        assert!(error < 1.01 * 2.0 * tau * tau, "{error}");
    }

    #[test]
    fn without_a_temperature_column_its_effects_are_left_out() {
        let errors = round_trip(&unit("gyro_bias_temperature", &[1e-3, 2e-3, -1e-3], None), false);
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
    fn the_derivative_of_a_parabola_is_exact_at_every_sample() {
        let time_s = uneven_time(50);
        let rate: Vec<[f64; 3]> = time_s.iter().map(|t| [2.0, t - 70.0, (t - 70.0) * (t - 70.0)]).collect();
        for (t, row) in time_s.iter().zip(angular_acceleration(&time_s, &rate)) {
            let expected = Vector3::new(0.0, 1.0, 2.0 * (t - 70.0));
            assert!((Vector3::from(row) - expected).amax() < 1e-11, "{t}: {row:?}");
        }
    }

    #[test]
    fn the_derivative_of_a_sine_is_wrong_by_the_square_of_the_step() {
        // h^2 / 6 times the third derivative inside, h^2 / 3 at both ends.
        let (h, frequency) = (1e-3, 2.0 * std::f64::consts::PI);
        let time_s: Vec<f64> = (0..2000).map(|i| i as f64 * h).collect();
        let rate: Vec<[f64; 3]> = time_s.iter().map(|t| [(frequency * t + 0.4).sin(); 3]).collect();
        let error = |i: usize, row: [f64; 3]| (row[0] - frequency * (frequency * time_s[i] + 0.4).cos()).abs();
        let third = frequency.powi(3);
        for (i, row) in angular_acceleration(&time_s, &rate).into_iter().enumerate() {
            let limit = if i == 0 || i == 1999 { third / 3.0 } else { third / 6.0 };
            assert!(error(i, row) < 1.01 * limit * h * h, "{i}: {:e}", error(i, row));
        }
    }

    #[test]
    fn few_samples_have_the_derivative_that_they_allow() {
        assert!(angular_acceleration(&[], &[]).is_empty());
        assert!(angular_acceleration(&[1.0], &[[1.0; 3]]).is_empty());
        assert_eq!(angular_acceleration(&[1.0, 1.5], &[[1.0; 3], [2.0; 3]]), [[2.0; 3]; 2]);
        let same_time = angular_acceleration(&[1.0, 1.0], &[[1.0; 3], [1.0; 3]]);
        assert!(same_time[0][0].is_nan());
    }
}
