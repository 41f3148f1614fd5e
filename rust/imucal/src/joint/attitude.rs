//! Attitude through a recording, for the effects that depend on it.
//!
//! Gravity gives the tilt at every rest, the gyroscope the heading from one to the next. North is not known: the heading
//! of the first rest is that of the smallest turn that puts its gravity upright.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

/// The attitude of the first rest, from the direction of gravity there.
pub(crate) fn first(up: &Vector3<f64>) -> UnitQuaternion<f64> {
    upright(up)
}

/// The attitude after a move, put upright by the gravity measured there.
pub(crate) fn after(start: &UnitQuaternion<f64>, rotation: &Matrix3<f64>, up: &Vector3<f64>) -> UnitQuaternion<f64> {
    let carried = start * UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*rotation));
    upright(&(carried * up)) * carried
}

/// The smallest turn that takes `up` to the z axis.
fn upright(up: &Vector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::rotation_between(up, &Vector3::z())
        .unwrap_or_else(|| UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI))
}
