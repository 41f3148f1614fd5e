//! A time-varying attitude: a rotation with its angular rate and angular acceleration. The chain rule gives the product
//! of two such attitudes.
//!
//! ```text
//! R_ac = R_ab R_bc
//! w_ac = R_bc^T w_ab + w_bc                                  each rate is expressed in the frame of its second index
//! w_ac' = R_bc^T w_ab' + w_bc' + (R_bc^T w_ab) x w_bc        because d/dt (R_bc^T v) = R_bc^T v' - w_bc x (R_bc^T v)
//! ```
//!
//! R_ab rotates vectors from frame b to frame a, and w_ab is the angular rate of frame b relative to frame a. A prime
//! is a derivative with respect to time, and v is any vector. The derivatives are exact for a product of any number of
//! rotations.

use imucal_core::so3;
use nalgebra::{Quaternion, UnitQuaternion, Vector3};

use super::profile::Course;

/// Attitude of a moving frame relative to a reference frame. The rate and the acceleration are expressed in the moving
/// frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Attitude {
    /// Rotation from the moving frame to the reference frame.
    pub(super) rotation: UnitQuaternion<f64>,
    /// Angular rate, rad/s.
    pub(super) rate: Vector3<f64>,
    /// Derivative of the angular rate, rad/s^2.
    pub(super) acceleration: Vector3<f64>,
}

impl Attitude {
    /// A constant rotation.
    pub(super) fn fixed(rotation: UnitQuaternion<f64>) -> Self {
        Self { rotation, rate: Vector3::zeros(), acceleration: Vector3::zeros() }
    }

    /// A rotation about a fixed unit axis by a time-varying angle, rad.
    #[inline]
    pub(super) fn about(axis: Vector3<f64>, angle: Course) -> Self {
        let (sine, cosine) = (angle.value / 2.0).sin_cos();
        Self {
            rotation: UnitQuaternion::new_unchecked(Quaternion::from_parts(cosine, axis * sine)),
            rate: axis * angle.rate,
            acceleration: axis * angle.acceleration,
        }
    }

    /// A rotation about a fixed axis. Its rotation vector is `share * turn_rad`, rad, where `share` varies with time.
    #[inline]
    pub(super) fn along(turn_rad: &Vector3<f64>, share: Course) -> Self {
        Self {
            rotation: so3::exp(&(turn_rad * share.value)),
            rate: turn_rad * share.rate,
            acceleration: turn_rad * share.acceleration,
        }
    }

    /// A small rotation given by a time-varying vector.
    ///
    /// ```text
    /// p = vector / 2 = axis tan(angle / 2),   R = (1, p) / |(1, p)|,   w = 2 (p' - p x p') / (1 + p^2)
    /// ```
    ///
    /// R is the rotation as a unit quaternion (scalar part first), p its Rodrigues vector, and w its angular rate. A
    /// prime is a derivative with respect to time. For a small angle a of rotation, |vector| is about `a + a^3 / 12`.
    /// The formulas of rate and acceleration are simpler with `vector` than with a rotation vector.
    #[inline]
    pub(super) fn small(vector: &[Course; 3]) -> Self {
        let half = |part: fn(&Course) -> f64| Vector3::from([0, 1, 2].map(|axis| part(&vector[axis]) / 2.0));
        let (p, p_rate, p_acceleration) = (half(|c| c.value), half(|c| c.rate), half(|c| c.acceleration));
        let weight = 2.0 / (1.0 + p.norm_squared());
        let rate = (p_rate - p.cross(&p_rate)) * weight;
        Self {
            rotation: UnitQuaternion::new_unchecked(Quaternion::from_parts(1.0, p) * (weight / 2.0).sqrt()),
            rate,
            // This is the derivative of `rate`: p' x p' is zero, and the time derivative of `weight` is -weight^2 times
            // the dot product of p and p'.
            acceleration: (p_acceleration - p.cross(&p_acceleration)) * weight - rate * (weight * p.dot(&p_rate)),
        }
    }

    /// Returns the product of this attitude and `next`. `next` is the attitude of a third frame relative to the moving
    /// frame of this attitude.
    #[inline]
    pub(super) fn then(&self, next: &Self) -> Self {
        let carried = next.rotation.inverse_transform_vector(&self.rate);
        Self {
            rotation: self.rotation * next.rotation,
            rate: carried + next.rate,
            acceleration: next.rotation.inverse_transform_vector(&self.acceleration)
                + next.acceleration
                + carried.cross(&next.rate),
        }
    }

    /// Product `before * self * after` of this rotation and two constant rotations.
    #[inline]
    pub(super) fn between(&self, before: &UnitQuaternion<f64>, after: &UnitQuaternion<f64>) -> Self {
        Self {
            rotation: before * self.rotation * after,
            rate: after.inverse_transform_vector(&self.rate),
            acceleration: after.inverse_transform_vector(&self.acceleration),
        }
    }

    /// Transforms a direction from the reference frame, in which it is constant, to the moving frame. Returns the
    /// components of the direction in the moving frame, and their first and second time derivatives.
    #[inline]
    pub(super) fn seen(&self, direction: &Vector3<f64>) -> [Vector3<f64>; 3] {
        let value = self.rotation.inverse_transform_vector(direction);
        let rate = value.cross(&self.rate);
        [value, rate, rate.cross(&self.rate) + value.cross(&self.acceleration)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Three angles that vary sinusoidally with the time `t`, with different amplitudes, frequencies and phases.
    fn courses(t: f64) -> [Course; 3] {
        [(0.4, 1.3, 0.2), (0.7, 0.9, 1.1), (0.2, 2.1, 2.5)]
            .map(|(size, frequency, phase)| Course::sine(frequency, phase, t) * size)
    }

    /// Tests that rate, acceleration and a transformed direction of an attitude agree with central differences.
    fn is_differentiated(attitude: impl Fn(f64) -> Attitude) {
        let (h, direction) = (1e-4, Vector3::new(0.2, -0.5, 0.8));
        for i in 0..100 {
            let t = 0.1 * f64::from(i);
            let (before, now, after) = (attitude(t - h), attitude(t), attitude(t + h));
            let rate = so3::log(&(before.rotation.inverse() * after.rotation)) / (2.0 * h);
            assert!((rate - now.rate).norm() < 1e-7, "rate at {t} s");
            assert!(((after.rate - before.rate) / (2.0 * h) - now.acceleration).norm() < 1e-7, "acceleration at {t} s");
            let [seen, seen_rate, seen_acceleration] = now.seen(&direction);
            assert!((seen - now.rotation.inverse() * direction).norm() < 1e-15);
            for (part, expected) in [(0, seen_rate), (1, seen_acceleration)] {
                let change = after.seen(&direction)[part] - before.seen(&direction)[part];
                assert!((change / (2.0 * h) - expected).norm() < 1e-6, "direction at {t} s");
            }
            assert!((now.rotation.norm() - 1.0).abs() < 1e-15);
        }
    }

    #[test]
    fn every_link_alone_has_the_derivatives_of_its_rotation() {
        is_differentiated(|t| Attitude::about(Vector3::new(2.0, 3.0, -6.0) / 7.0, courses(t)[0]));
        is_differentiated(|t| Attitude::along(&Vector3::new(0.5, -1.0, 2.0), courses(t)[1]));
        is_differentiated(|t| Attitude::small(&courses(t)));
    }

    #[test]
    fn a_chain_has_the_derivatives_of_its_rotation() {
        is_differentiated(|t| {
            let [a, b, c] = courses(t);
            Attitude::fixed(so3::exp(&Vector3::new(0.1, 0.2, 0.3)))
                .then(&Attitude::about(Vector3::x(), a))
                .then(&Attitude::small(&[b, c, a]))
                .then(&Attitude::along(&Vector3::new(0.5, -1.0, 2.0), c))
                .between(&so3::exp(&Vector3::new(0.9, 0.1, 0.0)), &so3::exp(&Vector3::new(-0.7, 0.2, 0.3)))
        });
    }

    #[test]
    fn a_small_rotation_is_that_of_its_rotation_vector_to_third_order() {
        for size in [1e-3, 1e-2] {
            let vector = Vector3::new(0.6, 0.0, -0.8) * size;
            let still = [0, 1, 2].map(|axis| Course { value: vector[axis], rate: 0.0, acceleration: 0.0 });
            let off = so3::log(&Attitude::small(&still).rotation) - vector;
            assert!((off.norm() - size.powi(3) / 12.0).abs() < 1e-3 * size.powi(3) + 1e-16);
        }
    }
}
