//! Model of one triad: the three nearly orthogonal sensor axes of an accelerometer or of a gyroscope (`docs/model.md`
//! (1)).
//!
//! ```text
//! raw  = sensitivity * true + bias
//! true = sensitivity^-1 * (raw - bias)
//! ```
//!
//! Row i of the sensitivity is the direction of sensor axis i in the body frame, multiplied by the scale of this axis.
//! For raw data in SI units the sensitivity is close to the identity. For raw data in counts the sensitivity is in lsb
//! per SI unit, and the bias is in counts.

use crate::vector::{add, cross, dot, magnitude, product, sub};
use core::{error::Error, fmt};
use nalgebra::{Matrix3, RealField, Vector3};

/// Sensitivity and bias of one triad. The inverse of the sensitivity is also stored, because the correction uses it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Triad<F: RealField + Copy> {
    sensitivity: Matrix3<F>,
    bias: Vector3<F>,
    inverse: Matrix3<F>,
}

impl<F: RealField + Copy> Triad<F> {
    /// Creates a triad from its 3x3 sensitivity (raw unit per SI unit) and its bias (raw unit).
    ///
    /// A left-handed sensitivity (negative determinant) is accepted, because the axes of a unit may be left-handed.
    ///
    /// # Errors
    /// [`SensorError::NotFinite`] if an entry is infinite or NaN, [`SensorError::Singular`] if the axes are in one
    /// plane.
    pub fn try_new(sensitivity: Matrix3<F>, bias: Vector3<F>) -> Result<Self, SensorError> {
        if !(is_finite(&sensitivity) && bias.x.is_finite() && bias.y.is_finite() && bias.z.is_finite()) {
            return Err(SensorError::NotFinite);
        }
        let inverse = invert(&sensitivity)?;
        Ok(Self { sensitivity, bias, inverse })
    }

    /// Creates a triad from its inverse sensitivity (SI unit per raw unit) and its bias (raw unit).
    /// [`correct`](Self::correct) uses exactly this inverse, so there are no rounding errors from an inversion.
    ///
    /// # Errors
    /// The errors of [`try_new`](Self::try_new).
    pub fn from_inverse(inverse: Matrix3<F>, bias: Vector3<F>) -> Result<Self, SensorError> {
        let turned_round = Self::try_new(inverse, bias)?;
        Ok(Self { sensitivity: turned_round.inverse, bias, inverse })
    }

    /// The triad without errors, for raw data in SI units. Raw values then equal true values.
    pub fn identity() -> Self {
        Self { sensitivity: Matrix3::identity(), bias: Vector3::zeros(), inverse: Matrix3::identity() }
    }

    /// Reading of the triad, in raw units and without noise, for a true value in SI units.
    #[inline]
    pub fn measure(&self, true_value: Vector3<F>) -> Vector3<F> {
        add(&product(&self.sensitivity, &true_value), &self.bias)
    }

    /// True value, in SI units and in the body frame, for a reading of the triad in raw units.
    #[inline]
    pub fn correct(&self, raw: Vector3<F>) -> Vector3<F> {
        product(&self.inverse, &sub(&raw, &self.bias))
    }

    /// The matrix `sensitivity` in `raw = sensitivity * true + bias`, raw unit per SI unit.
    #[inline]
    pub fn sensitivity(&self) -> &Matrix3<F> {
        &self.sensitivity
    }

    /// Reading of the triad when the true value is zero, in raw units.
    #[inline]
    pub fn bias(&self) -> &Vector3<F> {
        &self.bias
    }

    /// Inverse of the sensitivity, SI unit per raw unit; [`correct`](Self::correct) applies it.
    #[inline]
    pub fn inverse(&self) -> &Matrix3<F> {
        &self.inverse
    }
}

/// Reasons why a sensitivity and a bias cannot be used as a [`Triad`].
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum SensorError {
    /// An entry of the sensitivity or the bias is infinite or NaN.
    NotFinite,
    /// The three sensor axes are in one plane, so the component perpendicular to this plane is not measured.
    Singular {
        /// Volume of the parallelepiped that the three sensor axes span after each is scaled to length one: 1 for
        /// orthogonal axes and 0 for axes in one plane.
        volume: f64,
    },
}

impl fmt::Display for SensorError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFinite => f.write_str("an entry of the sensitivity or the bias is not a finite number"),
            Self::Singular { volume } => write!(
                f,
                "the sensitivity has no inverse: its axes, scaled to length one, span a volume of {volume:e} (1 if \
                 orthogonal); give three axes that do not lie in one plane and are not zero"
            ),
        }
    }
}

impl Error for SensorError {}

/// Inverse of a 3x3 matrix: the adjugate divided by the determinant. The columns of the adjugate are cross products of
/// the rows.
fn invert<F: RealField + Copy>(m: &Matrix3<F>) -> Result<Matrix3<F>, SensorError> {
    let x = Vector3::new(m.m11, m.m12, m.m13);
    let y = Vector3::new(m.m21, m.m22, m.m23);
    let z = Vector3::new(m.m31, m.m32, m.m33);
    let (a, b, c) = (cross(&y, &z), cross(&z, &x), cross(&x, &y));
    let determinant = dot(&x, &a);
    let inverse = Matrix3::new(
        a.x / determinant,
        b.x / determinant,
        c.x / determinant,
        a.y / determinant,
        b.y / determinant,
        c.y / determinant,
        a.z / determinant,
        b.z / determinant,
        c.z / determinant,
    );

    // The determinant divided by the product of the row lengths is zero if the axes are in one plane. This quotient
    // does not depend on the raw unit.
    let lengths = dot(&x, &x).sqrt() * dot(&y, &y).sqrt() * dot(&z, &z).sqrt();
    let rounding: F = nalgebra::convert::<f64, F>(64.0) * F::default_epsilon();
    if magnitude(determinant) > rounding * lengths && is_finite(&inverse) {
        Ok(inverse)
    } else {
        let volume = if lengths > F::zero() { magnitude(determinant / lengths) } else { F::zero() };
        Err(SensorError::Singular { volume: volume.to_subset().unwrap_or(0.0) })
    }
}

fn is_finite<F: RealField + Copy>(m: &Matrix3<F>) -> bool {
    let row = |x: F, y: F, z: F| x.is_finite() && y.is_finite() && z.is_finite();
    row(m.m11, m.m12, m.m13) && row(m.m21, m.m22, m.m23) && row(m.m31, m.m32, m.m33)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The accelerometer of the paper cited in docs/model.md, in units of g.
    fn paper_accelerometer() -> (Matrix3<f64>, Vector3<f64>) {
        (
            Matrix3::new(0.9804, 0.0012, 0.0055, 0.0012, 0.9727, 0.0043, 0.0055, 0.0043, 0.9921),
            Vector3::new(-0.0427, 0.0241, 0.0402),
        )
    }

    #[test]
    fn a_perfect_triad_changes_nothing() {
        let v = Vector3::new(0.1, -9.8, 3.0);
        assert_eq!(Triad::identity().measure(v), v);
        assert_eq!(Triad::<f64>::try_new(Matrix3::identity(), Vector3::zeros()), Ok(Triad::identity()));
        assert_eq!(Triad::identity().correct(v), v);
    }

    #[test]
    fn a_bias_and_a_scale_move_the_reading_as_written() {
        let triad = Triad::try_new(Matrix3::from_diagonal(&Vector3::new(2.0, 1.0, 1.0)), Vector3::new(0.5, 0.0, 0.0));
        assert_eq!(triad.map(|t| t.measure(Vector3::new(3.0, 4.0, 5.0))), Ok(Vector3::new(6.5, 4.0, 5.0)));
    }

    #[test]
    fn correct_undoes_measure() -> Result<(), SensorError> {
        let (sensitivity, bias) = paper_accelerometer();
        let triad = Triad::try_new(sensitivity, bias)?;
        let f = Vector3::new(0.6, -0.48, 0.64);
        assert!((triad.correct(triad.measure(f)) - f).norm() < 3e-16);
        Ok(())
    }

    #[test]
    fn correct_undoes_measure_in_counts_and_f32() -> Result<(), SensorError> {
        // A 24-bit gyroscope with 240000 lsb per rad/s and an offset of 32768 counts. Its axes are misaligned by about
        // 1 deg, and the y axis is reversed.
        let sensitivity = Matrix3::new(2.4e5f32, 4e3, 0.0, 0.0, -2.4e5, 4e3, 4e3, 0.0, 2.4e5);
        let triad = Triad::try_new(sensitivity, Vector3::new(32768.0, 32768.0, 32768.0))?;
        let w = Vector3::new(0.3, -0.02, 2.0);
        assert!((triad.correct(triad.measure(w)) - w).norm() < 5e-7);
        Ok(())
    }

    #[test]
    fn the_inverse_is_good_to_rounding() -> Result<(), SensorError> {
        let (sensitivity, bias) = paper_accelerometer();
        for unit in [1e-6, 1.0, 16384.0, 1e9] {
            let triad = Triad::try_new(sensitivity * unit, bias)?;
            assert!((triad.inverse() * triad.sensitivity() - Matrix3::identity()).norm() < 5e-16);
        }
        Ok(())
    }

    #[test]
    fn axes_in_one_plane_are_refused() {
        let flat = Matrix3::new(1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0);
        for unit in [1e-9, 1.0, 1e9] {
            let refused = Triad::try_new(flat * unit, Vector3::zeros());
            assert!(matches!(refused, Err(SensorError::Singular { volume }) if volume < 1e-14), "{refused:?}");
        }
        assert_eq!(
            Triad::<f64>::try_new(Matrix3::zeros(), Vector3::zeros()),
            Err(SensorError::Singular { volume: 0.0 })
        );
    }

    #[test]
    fn what_is_not_finite_is_refused() {
        for bad in [f64::NAN, f64::INFINITY] {
            let mut sensitivity = Matrix3::identity();
            sensitivity[(1, 2)] = bad;
            assert_eq!(Triad::try_new(sensitivity, Vector3::zeros()), Err(SensorError::NotFinite));
            let bias = Vector3::new(0.0, bad, 0.0);
            assert_eq!(Triad::try_new(Matrix3::identity(), bias), Err(SensorError::NotFinite));
        }
    }
}
