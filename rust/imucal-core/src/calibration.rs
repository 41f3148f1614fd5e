//! A calibrated unit: an accelerometer triad and a gyroscope triad in one body frame, and what the two do not explain.
//!
//! ```text
//! raw_force = T_A (force + effects) + b_A      m/s^2
//! raw_rate  = T_G (rate  + effects) + b_G      rad/s
//! ```
//!
//! Without effects the correction is `T^-1 (raw - b)`. With them it is [`EffectSet::remove`] after that.
//!
//! The body frame is orthogonal and fixed to the accelerometer. Which of the two usual ones it is (`symmetric` or
//! `triangular`) is in the sensitivities; the correction does not need to know.

use crate::{
    effects::{EffectSet, State, Surroundings},
    sensor::Triad,
};
use nalgebra::{RealField, Vector3};

/// Both triads of a unit, and its effects.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Calibration<F: RealField + Copy> {
    /// Specific force, m/s^2.
    pub accelerometer: Triad<F>,
    /// Angular rate, rad/s.
    pub gyroscope: Triad<F>,
    /// What the triads do not explain.
    pub effects: EffectSet<F>,
}

impl<F: RealField + Copy> Calibration<F> {
    /// A unit without effects.
    pub fn new(accelerometer: Triad<F>, gyroscope: Triad<F>) -> Self {
        Self { accelerometer, gyroscope, effects: EffectSet::none() }
    }

    /// The perfect unit in SI units: raw and true are the same.
    pub fn identity() -> Self {
        Self::new(Triad::identity(), Triad::identity())
    }

    /// Raw `(rate, force)`, without noise, of a true state.
    pub fn measure(&self, state: &State<F>) -> (Vector3<F>, Vector3<F>) {
        let (on_rate, on_force) = self.effects.at(state);
        (
            self.gyroscope.measure(state.angular_rate + on_rate),
            self.accelerometer.measure(state.specific_force + on_force),
        )
    }

    /// True `(rate, force)` in the body frame, rad/s and m/s^2, of one raw sample.
    ///
    /// Of the effects only those act that depend on nothing but rate and force: see [`correct_at`](Self::correct_at).
    #[inline]
    pub fn correct(&self, raw_rate: Vector3<F>, raw_force: Vector3<F>) -> (Vector3<F>, Vector3<F>) {
        self.correct_at(raw_rate, raw_force, &Surroundings::unknown())
    }

    /// True `(rate, force)` in the body frame, rad/s and m/s^2, of one raw sample in known surroundings.
    ///
    /// Both are NaN where the effects are too large to be undone: see [`EffectSet::remove`].
    #[inline]
    pub fn correct_at(
        &self,
        raw_rate: Vector3<F>,
        raw_force: Vector3<F>,
        surroundings: &Surroundings<F>,
    ) -> (Vector3<F>, Vector3<F>) {
        let (rate, force) = (self.gyroscope.correct(raw_rate), self.accelerometer.correct(raw_force));
        if self.effects.is_empty() { (rate, force) } else { self.effects.remove(rate, force, surroundings) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::SensorError;
    use nalgebra::Matrix3;

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
}
