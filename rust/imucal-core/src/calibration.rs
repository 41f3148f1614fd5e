//! Calibration of a unit. It consists of the accelerometer triad and the gyroscope triad in a common body frame, and of
//! effects.
//!
//! ```text
//! raw_force = T_A (force + effects) + b_A      force and effects in m/s^2
//! raw_rate  = T_G (rate  + effects) + b_G      rate and effects in rad/s
//! ```
//!
//! T_A and T_G are the sensitivities, and b_A and b_G are the biases. Effects are errors that sensitivity and bias do
//! not describe. Effects on the encoders of a stand are ignored here, because the stand is not part of the unit.
//!
//! The correction is `T^-1 (raw - b)`, followed by [`EffectSet::remove`] if there are effects (`docs/model.md` (16)).
//!
//! The body frame is orthogonal and fixed to the accelerometer. It is the `symmetric` or the `triangular` frame of
//! `docs/model.md` (2), depending on the form of the accelerometer's sensitivity. The correction is the same
//! computation for both frames.

use crate::{
    effects::{EffectSet, State, Surroundings},
    sensor::Triad,
};
use nalgebra::{RealField, Vector3};

/// Both triads of a unit, and its effects.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Calibration<F: RealField + Copy> {
    /// Accelerometer: specific force, m/s^2.
    pub accelerometer: Triad<F>,
    /// Gyroscope: angular rate, rad/s.
    pub gyroscope: Triad<F>,
    /// Errors that sensitivity and bias do not describe.
    pub effects: EffectSet<F>,
}

impl<F: RealField + Copy> Calibration<F> {
    /// A calibration without effects.
    pub fn new(accelerometer: Triad<F>, gyroscope: Triad<F>) -> Self {
        Self { accelerometer, gyroscope, effects: EffectSet::none() }
    }

    /// The calibration of a unit without errors, for raw data in SI units. Raw values then equal true values.
    pub fn identity() -> Self {
        Self::new(Triad::identity(), Triad::identity())
    }

    /// The noise-free readings `(rate, force)` of the sensors, in raw units, if the true state of the unit is `state`.
    pub fn measure(&self, state: &State<F>) -> (Vector3<F>, Vector3<F>) {
        let (on_rate, on_force) = self.effects.at(state);
        (
            self.gyroscope.measure(state.angular_rate + on_rate),
            self.accelerometer.measure(state.specific_force + on_force),
        )
    }

    /// Corrects one raw sample: returns the true `(rate, force)` in the body frame, rad/s and m/s^2.
    ///
    /// Effects that depend on quantities other than rate and force, such as the temperature, are not removed. Use
    /// [`correct_at`](Self::correct_at) to remove all effects.
    #[inline]
    pub fn correct(&self, raw_rate: Vector3<F>, raw_force: Vector3<F>) -> (Vector3<F>, Vector3<F>) {
        if self.effects.is_empty() {
            (self.gyroscope.correct(raw_rate), self.accelerometer.correct(raw_force))
        } else {
            self.correct_at(raw_rate, raw_force, &Surroundings::unknown())
        }
    }

    /// Corrects one raw sample. `surroundings` contains the quantities other than rate and force on which effects may
    /// depend, for example temperature and time. Returns the true `(rate, force)` in the body frame, rad/s and m/s^2.
    ///
    /// Both results are NaN if the effects are too large to be removed (see [`EffectSet::remove`]).
    pub fn correct_at(
        &self,
        raw_rate: Vector3<F>,
        raw_force: Vector3<F>,
        surroundings: &Surroundings<F>,
    ) -> (Vector3<F>, Vector3<F>) {
        let (seen_rate, seen_force) = (self.gyroscope.correct(raw_rate), self.accelerometer.correct(raw_force));
        if self.effects.is_empty() {
            return (seen_rate, seen_force);
        }
        self.effects.remove(seen_rate, seen_force, surroundings)
    }

    /// Corrects one raw sample as [`correct_at`](Self::correct_at) does, and also removes effects that the caller
    /// defines. `own` returns the errors that these effects add to the true rate (rad/s) and to the true force (m/s^2),
    /// in the body frame.
    ///
    /// ```
    /// use imucal_core::{calibration::Calibration, effects::Surroundings};
    /// use nalgebra::Vector3;
    ///
    /// // A gyroscope whose x bias changes by 0.02 rad/s per volt of its supply.
    /// let supply_v = 3.5;
    /// let (raw_rate, raw_force) = (Vector3::new(0.104, 0.0, 0.0), Vector3::new(0.0, 0.0, 9.8));
    /// let (rate, _) = Calibration::<f32>::identity().correct_with(
    ///     raw_rate,
    ///     raw_force,
    ///     &Surroundings::unknown(),
    ///     |_state| (Vector3::new(0.02 * (supply_v - 3.3), 0.0, 0.0), Vector3::zeros()),
    /// );
    /// assert!((rate.x - 0.1).abs() < 1e-6);
    /// ```
    pub fn correct_with(
        &self,
        raw_rate: Vector3<F>,
        raw_force: Vector3<F>,
        surroundings: &Surroundings<F>,
        own: impl Fn(&State<F>) -> (Vector3<F>, Vector3<F>),
    ) -> (Vector3<F>, Vector3<F>) {
        let (seen_rate, seen_force) = (self.gyroscope.correct(raw_rate), self.accelerometer.correct(raw_force));
        self.effects.remove_with(seen_rate, seen_force, surroundings, own)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        effects::{Effect, EffectValues, MAX_PARAMETERS, Sensor},
        sensor::SensorError,
        so3,
        temperature_memory::TemperatureHistory,
    };
    use nalgebra::{Matrix3, convert};

    #[test]
    fn each_triad_corrects_its_own_sensor() -> Result<(), SensorError> {
        let calibration = Calibration::new(
            Triad::try_new(Matrix3::from_diagonal_element(2.0), Vector3::new(1.0, 0.0, 0.0))?,
            Triad::try_new(Matrix3::from_diagonal_element(4.0), Vector3::new(0.0, 0.0, 3.0))?,
        );
        let (rate, force) = calibration.correct(Vector3::new(4.0, 8.0, 7.0), Vector3::new(5.0, 2.0, 6.0));
        assert_eq!(rate, Vector3::new(1.0, 2.0, 1.0));
        assert_eq!(force, Vector3::new(2.0, 1.0, 3.0));
        Ok(())
    }

    #[test]
    fn a_perfect_unit_changes_nothing() {
        let (rate, force) = (Vector3::new(0.1f32, 0.2, -0.3), Vector3::new(0.0, 9.8, 0.1));
        assert_eq!(Calibration::identity().correct(rate, force), (rate, force));
    }

    /// A unit with misaligned axes. Its raw force is in SI units, and its raw rate is in counts.
    fn unit() -> Calibration<f64> {
        let accelerometer = Matrix3::new(0.9804, 0.0012, 0.0055, 0.0012, 0.9727, 0.0043, 0.0055, 0.0043, 0.9921);
        let gyroscope = Matrix3::new(0.9771, 0.0097, -0.006, -0.0084, 1.0309, -0.0031, 0.0087, 0.0036, 1.003);
        Calibration::new(
            Triad::try_new(accelerometer, Vector3::new(-0.42, 0.24, 0.39)).unwrap(),
            Triad::try_new(gyroscope * 4775.0, Vector3::new(32777.0, 32459.0, 32511.0)).unwrap(),
        )
    }

    /// The state of a unit that rotates at 250 deg/s and accelerates. Its temperature is 17 K below the reference
    /// temperature.
    fn fast_state() -> State<f64> {
        State {
            angular_rate: Vector3::new(2.9, -2.6, 1.9),
            specific_force: Vector3::new(6.1, -4.4, 6.5),
            surroundings: Surroundings {
                angular_acceleration: Some(Vector3::new(-12.0, 31.0, 8.0)),
                mean_angular_acceleration: None,
                rotation_world_from_body: Some(so3::exp(&Vector3::new(0.4, -1.1, 0.7))),
                temperature_difference_k: Some(-17.0),
                temperature_history: Some(TemperatureHistory {
                    rate_kps: 0.05,
                    direction: 1.0,
                    gyroscope_lag_k: -3.0,
                    accelerometer_lag_k: -1.5,
                }),
                time_s: Some(240.0),
                stand: None,
            },
        }
    }

    /// The effects that act on a sensor of the unit, and not on the encoders of a stand.
    fn catalogue<F: RealField + Copy>() -> impl Iterator<Item = &'static Effect<F>> {
        Effect::catalogue().filter(|effect| effect.sensor != Sensor::Encoder)
    }

    /// The effect in its full form, with all its parameters. The magnitude of each parameter is `times` its typical
    /// size. The second of every three parameters is negative, and the other parameters are positive.
    fn typical<F: RealField + Copy>(effect: &'static Effect<F>, times: f64) -> EffectValues<F> {
        let mut values = [F::zero(); MAX_PARAMETERS];
        for (k, (value, parameter)) in values.iter_mut().zip(effect.parameters).enumerate() {
            let sign = if k % 3 == 1 { -1.0 } else { 1.0 };
            *value = convert(sign * times * parameter.typical);
        }
        let shape = effect.shape.map(|shape| convert(shape.typical));
        EffectValues::try_new(effect, &values[..effect.parameters.len()], shape).unwrap()
    }

    fn with(effects: &[EffectValues<f64>]) -> Calibration<f64> {
        let mut calibration = unit();
        for effect in effects {
            calibration.effects.push(*effect).unwrap();
        }
        calibration
    }

    fn comes_back(calibration: &Calibration<f64>, state: &State<f64>) -> f64 {
        let (raw_rate, raw_force) = calibration.measure(state);
        let (rate, force) = calibration.correct_at(raw_rate, raw_force, &state.surroundings);
        ((rate - state.angular_rate).norm() / state.angular_rate.norm())
            .max((force - state.specific_force).norm() / state.specific_force.norm())
    }

    #[test]
    fn every_effect_acts_and_is_taken_away_again() {
        let state = fast_state();
        for effect in catalogue() {
            for times in [1.0, 3.0] {
                let calibration = with(&[typical(effect, times)]);
                assert_ne!(calibration.measure(&state), unit().measure(&state), "{}", effect.name);
                // The raw counts have a large offset. The rounding errors of these large numbers remain in the
                // corrected value. The limit 1e-14, relative to the true value, allows for these errors.
                assert!(comes_back(&calibration, &state) < 1e-14, "{} at {times} times", effect.name);
            }
        }
    }

    #[test]
    fn twelve_effects_at_once_are_taken_away_again() {
        for first in [0, 10, 19] {
            let mut calibration = unit();
            for effect in catalogue().skip(first).take(12) {
                calibration.effects.push(typical(effect, 1.0)).unwrap();
            }
            assert!(comes_back(&calibration, &fast_state()) < 1e-14);
        }
    }

    #[test]
    fn a_pass_shrinks_the_error_by_the_slope_of_the_effect() {
        // The slope of an effect is the derivative of the error that the effect adds with respect to the quantity that
        // the sensor measures (rate or force). Each iteration of the correction multiplies the remaining error by about
        // the slope. Most accelerometer effects (all except the lever-arm and the size effect) do not depend on the
        // rate, so the force converges first. The error of the force then no longer contributes to the error of the
        // rate. The slope of a gyroscope effect therefore does not include the derivative with respect to force.
        let step = 1e-6;
        let slope = |effect: &'static Effect<f64>, times: f64| {
            let (values, state) = (typical(effect, times), fast_state());
            let column = |i| {
                let (mut up, mut down, d) = (state, state, Vector3::ith(i, step));
                match effect.sensor {
                    Sensor::Gyroscope => {
                        (up.angular_rate, down.angular_rate) = (up.angular_rate + d, down.angular_rate - d)
                    }
                    Sensor::Accelerometer => {
                        (up.specific_force, down.specific_force) = (up.specific_force + d, down.specific_force - d);
                    }
                    Sensor::Encoder => unreachable!("not of the unit"),
                }
                (values.at(&up) - values.at(&down)) / (2.0 * step)
            };
            Matrix3::from_columns(&[column(0), column(1), column(2)]).norm()
        };
        for effect in catalogue() {
            assert!(slope(effect, 1.0) < 0.02, "{}: {}", effect.name, slope(effect, 1.0));
            assert!(slope(effect, 3.0) < 0.06, "{}: {}", effect.name, slope(effect, 3.0));
        }
    }

    #[test]
    fn the_derivative_by_the_parameters_is_the_field_through_the_sensitivity() {
        let state = fast_state();
        for effect in catalogue() {
            let base = typical(effect, 1.0);
            let mut columns = [Vector3::zeros(); MAX_PARAMETERS];
            effect.field(&state, base.shape().unwrap_or(1.0), &mut columns);
            for (k, parameter) in effect.parameters.iter().enumerate() {
                // The measurement is linear in the parameters, so the difference quotient of a large step has only
                // rounding errors.
                let step = 1e3 * parameter.typical;
                let measured = |sign: f64| {
                    let mut values = [0.0; MAX_PARAMETERS];
                    values[..effect.parameters.len()].copy_from_slice(base.values());
                    values[k] += sign * step;
                    let moved =
                        EffectValues::try_new(effect, &values[..effect.parameters.len()], base.shape()).unwrap();
                    with(&[moved]).measure(&state)
                };
                let (up, down) = (measured(1.0), measured(-1.0));
                let (difference, triad) = match effect.sensor {
                    Sensor::Gyroscope => (up.0 - down.0, unit().gyroscope),
                    Sensor::Accelerometer => (up.1 - down.1, unit().accelerometer),
                    Sensor::Encoder => unreachable!("not of the unit"),
                };
                let expected = triad.sensitivity() * columns[k];
                let error = (difference / (2.0 * step) - expected).norm();
                assert!(error < 1e-9 * expected.norm(), "{} {}: {error:e}", effect.name, parameter.name);
            }
        }
    }

    #[test]
    fn f32_corrects_to_its_rounding() {
        let state = fast_state();
        for (single, double) in catalogue::<f32>().zip(catalogue::<f64>()) {
            let truth = Calibration { effects: with(&[typical(double, 1.0)]).effects, ..Calibration::identity() };
            let (raw_rate, raw_force) = truth.measure(&state);
            let mut device = Calibration::<f32>::identity();
            device.effects.push(typical(single, 1.0)).unwrap();
            let surroundings = Surroundings {
                angular_acceleration: state.surroundings.angular_acceleration.map(|value| value.cast()),
                mean_angular_acceleration: state.surroundings.mean_angular_acceleration.map(|value| value.cast()),
                rotation_world_from_body: state.surroundings.rotation_world_from_body.map(|value| value.cast()),
                temperature_difference_k: Some(-17.0),
                temperature_history: Some(TemperatureHistory {
                    rate_kps: 0.05,
                    direction: 1.0,
                    gyroscope_lag_k: -3.0,
                    accelerometer_lag_k: -1.5,
                }),
                time_s: Some(240.0),
                stand: None,
            };
            let (rate, force) = device.correct_at(raw_rate.cast(), raw_force.cast(), &surroundings);
            assert!((rate.cast() - state.angular_rate).norm() < 1e-6, "{}: {rate:?}", single.name);
            assert!((force.cast() - state.specific_force).norm() < 3e-6, "{}: {force:?}", single.name);
        }
    }

    #[test]
    fn rest_and_zero_settle_too() {
        // The iteration of the correction ends when the change of rate and force is small relative to the measured
        // values and the effects. Two states are difficult for this criterion. At rest, the error that an effect adds
        // is larger than the rate. In free fall, the magnitude of the force is zero.
        for effect in catalogue() {
            for specific_force in [Vector3::zeros(), Vector3::new(0.0, 0.0, 9.80665)] {
                let state = State { angular_rate: Vector3::zeros(), specific_force, ..fast_state() };
                let calibration =
                    Calibration { effects: with(&[typical(effect, 3.0)]).effects, ..Calibration::identity() };
                let (raw_rate, raw_force) = calibration.measure(&state);
                let (rate, force) = calibration.correct_at(raw_rate, raw_force, &state.surroundings);
                assert!(rate.norm() < 1e-15, "{}: {rate:?}", effect.name);
                assert!((force - specific_force).norm() < 1e-14, "{}: {force:?}", effect.name);
            }
        }
    }

    #[test]
    fn without_surroundings_the_known_effects_are_taken_away() {
        let known = typical(Effect::find("gyro_g_sensitivity").unwrap(), 1.0);
        let unknown = typical(Effect::find("gyro_bias_temperature").unwrap(), 1.0);
        let state = State { surroundings: Surroundings::unknown(), ..fast_state() };
        let (raw_rate, raw_force) = with(&[known]).measure(&state);
        let (rate, force) = with(&[known, unknown]).correct(raw_rate, raw_force);
        assert!((rate - state.angular_rate).norm() < 1e-13);
        assert!((force - state.specific_force).norm() < 1e-13);
    }

    #[test]
    fn without_effects_the_correction_is_that_of_the_triads_to_the_last_bit() {
        let (rate, force) = (Vector3::new(31000.0, 40000.0, 32768.0), Vector3::new(0.3, -9.7, 1.1));
        let triads = (unit().gyroscope.correct(rate), unit().accelerometer.correct(force));
        assert_eq!(unit().correct(rate, force), triads);
        assert_eq!(unit().correct_at(rate, force, &fast_state().surroundings), triads);
    }
}
