//! Effects of motion: angular acceleration, delays, lever arms inside the unit, and the rotation of the Earth.
//!
//! ```text
//! gyro_angular_acceleration   D dw/dt
//! gyro_time_offset            w(t - tau) - w(t) = -tau dw/dt + O(tau^2)
//! earth_rate                  R_wb^T Omega
//! accel_lever_arm             L r,                          L = [dw/dt]x + [w]x [w]x
//! accel_size_effect           (0, (L r_y)_y, (L r_z)_z)
//! ```
//!
//! A sensor at position r measures `dw/dt x r + w x (w x r)` in addition to the force at the origin of the body frame.
//! The size effect describes an accelerometer whose axes have different positions; the origin is the position of the x
//! axis.

use super::{AXES, Alias, Columns, ENTRIES, Effect, Need, Parameter, Sensor, State, parameters, set_entries};
use crate::{EARTH_RATE_RADPS, so3::hat};
use nalgebra::{Matrix3, RealField, UnitQuaternion, Vector3};

impl<F: RealField + Copy> Effect<F> {
    pub(super) const DYNAMICS: &'static [Self] = &[
        Self {
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
            columns: |state, _, columns| set_entries(angular_acceleration(state), columns),
        },
        Self {
            name: "gyro_time_offset",
            sensor: Sensor::Gyroscope,
            parameters: &[Parameter { name: "tau", unit: "s", typical: 2e-3 }],
            plain: 1,
            shape: None,
            reads: &[],
            needs: &[Need::AngularAcceleration],
            formula: "-tau dw/dt",
            observable: "forces during turns, the accelerometer being the clock",
            aliases: &[
                Alias { with: "a delay of the accelerometer", told_apart_by: "nothing: only the difference is seen" },
                Alias { with: "gyro_angular_acceleration", told_apart_by: "turns about three axes" },
            ],
            columns: |state, _, columns| columns[0] = -angular_acceleration(state),
        },
        Self {
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
            columns: earth_rate,
        },
        Self {
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
            columns: lever_arm,
        },
        Self {
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
            columns: size_effect,
        },
    ];
}

fn earth_rate<F: RealField + Copy>(state: &State<F>, _: F, columns: &mut Columns<F>) {
    let world_from_body = state.surroundings.rotation_world_from_body.map(UnitQuaternion::to_rotation_matrix);
    for (i, column) in columns.iter_mut().take(3).enumerate() {
        *column = world_from_body.map_or_else(Vector3::zeros, |matrix| matrix.matrix().row(i).transpose());
    }
}

fn lever_arm<F: RealField + Copy>(state: &State<F>, _: F, columns: &mut Columns<F>) {
    let lever = lever(state);
    for (k, column) in columns.iter_mut().take(3).enumerate() {
        *column = lever.column(k).into_owned();
    }
}

fn size_effect<F: RealField + Copy>(state: &State<F>, _: F, columns: &mut Columns<F>) {
    let lever = lever(state);
    for (k, column) in columns.iter_mut().take(6).enumerate() {
        let axis = 1 + k / 3;
        *column = Vector3::ith(axis, lever[(axis, k % 3)]);
    }
}

fn angular_acceleration<F: RealField + Copy>(state: &State<F>) -> Vector3<F> {
    state.surroundings.angular_acceleration.unwrap_or_else(Vector3::zeros)
}

/// The matrix L in `dw/dt x r + w x (w x r) = L r`, 1/s^2.
fn lever<F: RealField + Copy>(state: &State<F>) -> Matrix3<F> {
    let rate = hat(&state.angular_rate);
    hat(&angular_acceleration(state)) + rate * rate
}
