//! Effects of motion: errors due to angular acceleration, delays, lever arms inside the unit, and the rotation of the
//! Earth.
//!
//! ```text
//! gyro_angular_acceleration   D dw/dt
//! gyro_time_offset            w(t - tau) - w(t) = -tau (mean of dw/dt from t - tau to t)
//! earth_rate                  R_wb^T Omega
//! accel_lever_arm             L r,                          L = [dw/dt]x + [w]x [w]x
//! accel_size_effect           (0, (L r_y)_y, (L r_z)_z)
//! ```
//!
//! w is the angular rate. The parameters are the matrix D, the delay tau, the Earth rate Omega in the world frame, and
//! the positions r, r_y and r_z. R_wb is the attitude (world from body), and `[v]x` is the matrix of the cross product
//! with v. An accelerometer at position r measures `dw/dt x r + w x (w x r)` in addition to the specific force at the
//! origin of the body frame. The size effect occurs because the sensing elements of the three axes of an accelerometer
//! are at different positions. r_y and r_z are the positions of the y and z elements relative to the x element.

use super::{AXES, Alias, ENTRIES, Effect, Need, Parameter, Sensor, State, Terms, effect, parameters};
use crate::{EARTH_RATE_RADPS, vector::neg};
use nalgebra::{Matrix3, RealField, UnitQuaternion, Vector3};

impl<F: RealField + Copy> Effect<F> {
    #[cfg(feature = "catalogue")]
    pub(super) const DYNAMICS: &'static [&'static Self] = &[
        Self::GYRO_ANGULAR_ACCELERATION,
        Self::GYRO_TIME_OFFSET,
        Self::EARTH_RATE,
        Self::ACCEL_LEVER_ARM,
        Self::ACCEL_SIZE_EFFECT,
    ];

    /// `gyro_angular_acceleration`: error `D dw/dt` of the rate, with the angular rate w and the matrix D of the
    /// parameters.
    pub const GYRO_ANGULAR_ACCELERATION: &'static Self = &effect! {
        number: 21,
        name: "gyro_angular_acceleration",
        sensor: Sensor::Gyroscope,
        parameters: &parameters(ENTRIES, "s", 1e-4),
        plain: 9,
        shape: None,
        reads: &[],
        needs: &[Need::AngularAcceleration],
        formula: "D dw/dt",
        observable: "forces during turns that speed up and slow down; from rest to rest it nearly integrates to zero",
        aliases: &[Alias {
            with: "gyro_time_offset",
            told_apart_by: "turns about three axes: a delay is the same multiple of the identity for all",
        }],
        field: |state, _, terms| terms.entries(angular_acceleration(state)),
    };

    /// `gyro_time_offset`: error `w(t - tau) - w(t)` of the rate, with the angular rate w and the delay tau. The error
    /// equals -tau times the mean of dw/dt from t - tau to t.
    pub const GYRO_TIME_OFFSET: &'static Self = &effect! {
        number: 22,
        name: "gyro_time_offset",
        sensor: Sensor::Gyroscope,
        parameters: &[Parameter { name: "tau", unit: "s", typical: 2e-3 }],
        plain: 1,
        shape: None,
        reads: &[],
        needs: &[Need::AngularAcceleration],
        formula: "w(t - tau) - w(t)",
        observable: "forces during turns; the delay is relative to the accelerometer",
        aliases: &[
            Alias {
                with: "a delay of the accelerometer",
                told_apart_by: "no measurement: only the difference of the two delays is observable",
            },
            Alias { with: "gyro_angular_acceleration", told_apart_by: "turns about three axes" },
        ],
        field: |state, _, terms| terms.column(neg(&mean_angular_acceleration(state))),
    };

    /// `earth_rate`: rate `R_wb^T Omega` in the body frame, with the attitude R_wb (world from body) and the rate Omega
    /// of the Earth in the world frame.
    pub const EARTH_RATE: &'static Self = &effect! {
        number: 23,
        name: "earth_rate",
        sensor: Sensor::Gyroscope,
        parameters: &parameters(AXES, "rad/s", EARTH_RATE_RADPS),
        plain: 3,
        shape: None,
        reads: &[],
        needs: &[Need::Attitude],
        formula: "R_wb^T Omega, Omega in the world frame",
        observable: "the gyroscope's mean in long rests of many orientations and headings",
        aliases: &[Alias {
            with: "gyro_g_sensitivity",
            told_apart_by: "the latitude: the vertical part is an isotropic g-sensitivity",
        }],
        field: |state, _, terms| earth_rate(state, terms),
    };

    /// `accel_lever_arm`: specific force `dw/dt x r + w x (w x r)`, with the angular rate w and the sensor position r.
    pub const ACCEL_LEVER_ARM: &'static Self = &effect! {
        number: 24,
        name: "accel_lever_arm",
        sensor: Sensor::Accelerometer,
        parameters: &parameters(AXES, "m", 20e-3),
        plain: 3,
        shape: None,
        reads: &[Sensor::Gyroscope],
        needs: &[Need::AngularAcceleration],
        formula: "dw/dt x r + w x (w x r)",
        observable: "forces during turns about two axes or more",
        aliases: &[Alias { with: "accel_size_effect", told_apart_by: "turns about three axes" }],
        field: |state, _, terms| lever_arm(state, terms),
    };

    /// `accel_size_effect`: force `(dw/dt x r_i + w x (w x r_i))_i` on axis i = y, z, with the angular rate w. r_i is
    /// the position of the sensing element of axis i relative to the sensing element of the x axis.
    pub const ACCEL_SIZE_EFFECT: &'static Self = &effect! {
        number: 25,
        name: "accel_size_effect",
        sensor: Sensor::Accelerometer,
        parameters: &parameters(["yx", "yy", "yz", "zx", "zy", "zz"], "m", 2e-3),
        plain: 6,
        shape: None,
        reads: &[Sensor::Gyroscope],
        needs: &[Need::AngularAcceleration],
        formula: "(dw/dt x r_i + w x (w x r_i))_i, i = y, z; r_x = 0",
        observable: "forces during turns about three axes",
        aliases: &[Alias { with: "accel_lever_arm", told_apart_by: "turns about three axes" }],
        field: |state, _, terms| size_effect(state, terms),
    };
}

#[inline(always)]
fn earth_rate<F: RealField + Copy>(state: &State<F>, terms: &mut impl Terms<F>) {
    let world_from_body = state.surroundings.rotation_world_from_body.map(UnitQuaternion::to_rotation_matrix);
    for i in 0..3 {
        terms.column(world_from_body.map_or_else(Vector3::zeros, |matrix| matrix.matrix().row(i).transpose()));
    }
}

#[inline(always)]
fn lever_arm<F: RealField + Copy>(state: &State<F>, terms: &mut impl Terms<F>) {
    let lever = lever(state);
    terms.column(Vector3::new(lever.m11, lever.m21, lever.m31));
    terms.column(Vector3::new(lever.m12, lever.m22, lever.m32));
    terms.column(Vector3::new(lever.m13, lever.m23, lever.m33));
}

#[inline(always)]
fn size_effect<F: RealField + Copy>(state: &State<F>, terms: &mut impl Terms<F>) {
    let lever = lever(state);
    for cause in [lever.m21, lever.m22, lever.m23] {
        terms.y(cause);
    }
    for cause in [lever.m31, lever.m32, lever.m33] {
        terms.z(cause);
    }
}

fn angular_acceleration<F: RealField + Copy>(state: &State<F>) -> Vector3<F> {
    state.surroundings.angular_acceleration.unwrap_or(Vector3::new(F::zero(), F::zero(), F::zero()))
}

fn mean_angular_acceleration<F: RealField + Copy>(state: &State<F>) -> Vector3<F> {
    state.surroundings.mean_angular_acceleration.unwrap_or_else(|| angular_acceleration(state))
}

/// The matrix `L = [dw/dt]x + [w]x [w]x`, 1/s^2, where `[v]x` is the matrix of the cross product with v. An
/// accelerometer at position r measures the additional force `L r` if the unit rotates at the angular rate w.
fn lever<F: RealField + Copy>(state: &State<F>) -> Matrix3<F> {
    let (w, a) = (state.angular_rate, angular_acceleration(state));
    let (xx, yy, zz) = (w.x * w.x, w.y * w.y, w.z * w.z);
    let (xy, xz, yz) = (w.x * w.y, w.x * w.z, w.y * w.z);
    Matrix3::new(-zz - yy, xy - a.z, xz + a.y, xy + a.z, -zz - xx, yz - a.x, xz - a.y, yz + a.x, -yy - xx)
}
