//! A calibrated unit: an accelerometer triad and a gyroscope triad in one body frame.
//!
//! ```text
//! force = T_A^-1 (raw_force - b_A)      m/s^2
//! rate  = T_G^-1 (raw_rate  - b_G)      rad/s
//! ```
//!
//! The body frame is orthogonal and fixed to the accelerometer. Which of the two usual ones it is (`symmetric` or
//! `triangular`) is in the sensitivities; the correction does not need to know.

use crate::sensor::Triad;
use nalgebra::{RealField, Vector3};

/// Both triads of a unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Calibration<F: RealField + Copy> {
    /// Specific force, m/s^2.
    pub accelerometer: Triad<F>,
    /// Angular rate, rad/s.
    pub gyroscope: Triad<F>,
}

impl<F: RealField + Copy> Calibration<F> {
    /// The perfect unit in SI units: raw and true are the same.
    pub fn identity() -> Self {
        Self { accelerometer: Triad::identity(), gyroscope: Triad::identity() }
    }

    /// True `(rate, force)` in the body frame, rad/s and m/s^2, of one raw sample.
    #[inline]
    pub fn correct(&self, raw_rate: Vector3<F>, raw_force: Vector3<F>) -> (Vector3<F>, Vector3<F>) {
        (self.gyroscope.correct(raw_rate), self.accelerometer.correct(raw_force))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sensor::SensorError;
    use nalgebra::Matrix3;

    #[test]
    fn each_triad_corrects_its_own_sensor() -> Result<(), SensorError> {
        let calibration = Calibration {
            accelerometer: Triad::try_new(Matrix3::from_diagonal_element(2.0), Vector3::new(1.0, 0.0, 0.0))?,
            gyroscope: Triad::try_new(Matrix3::from_diagonal_element(4.0), Vector3::new(0.0, 0.0, 3.0))?,
        };
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
