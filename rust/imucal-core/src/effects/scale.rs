//! Effects of nonlinear sensors, whose reading is not a linear function of the measured quantity.
//!
//! ```text
//! *_scale_quadratic        k_i v_i^2
//! *_scale_cubic            k_i v_i^3
//! *_scale_asymmetry        k_i |v_i|
//! *_cross_axis_quadratic   sum of k_i,jl v_j v_l
//! ```
//!
//! v is the measured quantity: the angular rate w for the gyroscope, and the specific force f for the accelerometer.
//! k_i is the parameter of axis i, v_i the component of v along this axis, and k_i,jl the parameter of axis i for the
//! product v_j v_l. The cross-axis effect of the gyroscope has nine parameters: each axis depends on the three products
//! of two different components. The cross-axis effect of the accelerometer has fifteen parameters: each axis i depends
//! on all products of two components except f_i^2, which belongs to the quadratic scale effect.

use super::{AXES, Alias, DEGREE, Effect, Sensor, State, Terms, cross_products, effect, parameters, squares};
use crate::{
    STANDARD_GRAVITY_MPS2,
    vector::{each, magnitude},
};
use nalgebra::{RealField, Vector3};

const GYROSCOPE_PRODUCTS: [&str; 9] = ["x_yz", "x_xz", "x_xy", "y_yz", "y_xz", "y_xy", "z_yz", "z_xz", "z_xy"];
const ACCELEROMETER_PRODUCTS: [&str; 15] = [
    "x_yy", "x_zz", "x_yz", "x_xz", "x_xy", "y_xx", "y_zz", "y_yz", "y_xz", "y_xy", "z_xx", "z_yy", "z_yz", "z_xz",
    "z_xy",
];

/// Rate at which datasheets specify the nonlinearity of a gyroscope, rad/s. The typical parameters of the gyroscope
/// effects are computed from the nonlinearity at this rate.
const FULL_RATE: f64 = 250.0 * DEGREE;

impl<F: RealField + Copy> Effect<F> {
    #[cfg(feature = "catalogue")]
    pub(super) const SCALE: &'static [&'static Self] = &[
        Self::GYRO_SCALE_QUADRATIC,
        Self::GYRO_SCALE_CUBIC,
        Self::GYRO_SCALE_ASYMMETRY,
        Self::GYRO_CROSS_AXIS_QUADRATIC,
        Self::ACCEL_SCALE_QUADRATIC,
        Self::ACCEL_SCALE_CUBIC,
        Self::ACCEL_SCALE_ASYMMETRY,
        Self::ACCEL_CROSS_AXIS_QUADRATIC,
    ];

    /// `gyro_scale_quadratic`: error `k_i w_i^2` of axis i, with the parameter k_i and the angular rate w.
    pub const GYRO_SCALE_QUADRATIC: &'static Self = &effect! {
        number: 4,
        name: "gyro_scale_quadratic",
        sensor: Sensor::Gyroscope,
        // Typical value: 0.2 % of the rate at 250 deg/s.
        parameters: &parameters(AXES, "s/rad", 0.002 / FULL_RATE),
        plain: 3,
        shape: None,
        reads: &[Sensor::Gyroscope],
        needs: &[],
        formula: "k_i w_i^2",
        observable: "turns of both signs",
        aliases: &[Alias { with: "gyro_scale_asymmetry", told_apart_by: "turns at several rates" }],
        field: |state, _, terms| quadratic(&state.angular_rate, terms),
    };

    /// `gyro_scale_cubic`: error `k_i w_i^3` of axis i, with the parameter k_i and the angular rate w.
    pub const GYRO_SCALE_CUBIC: &'static Self = &effect! {
        number: 5,
        name: "gyro_scale_cubic",
        sensor: Sensor::Gyroscope,
        // Typical value: 0.5 % of the rate at 250 deg/s.
        parameters: &parameters(AXES, "s^2/rad^2", 0.005 / (FULL_RATE * FULL_RATE)),
        plain: 3,
        shape: None,
        reads: &[Sensor::Gyroscope],
        needs: &[],
        formula: "k_i w_i^3",
        observable: "turns at several rates",
        aliases: &[Alias { with: "gyro_scale", told_apart_by: "turns at several rates" }],
        field: |state, _, terms| cubic(&state.angular_rate, terms),
    };

    /// `gyro_scale_asymmetry`: error `k_i |w_i|` of axis i, with the parameter k_i and the angular rate w.
    pub const GYRO_SCALE_ASYMMETRY: &'static Self = &effect! {
        number: 6,
        name: "gyro_scale_asymmetry",
        sensor: Sensor::Gyroscope,
        // Typical value: 0.2 % of the rate.
        parameters: &parameters(AXES, "1", 0.002),
        plain: 3,
        shape: None,
        reads: &[Sensor::Gyroscope],
        needs: &[],
        formula: "k_i |w_i|",
        observable: "turns of both signs",
        aliases: &[Alias { with: "gyro_scale_quadratic", told_apart_by: "turns at several rates" }],
        field: |state, _, terms| asymmetry(&state.angular_rate, terms),
    };

    /// `gyro_cross_axis_quadratic`: error `k_i,yz wy wz + k_i,xz wx wz + k_i,xy wx wy` of axis i, with the parameters
    /// k_i,jl and the angular rate w.
    pub const GYRO_CROSS_AXIS_QUADRATIC: &'static Self = &effect! {
        number: 7,
        name: "gyro_cross_axis_quadratic",
        sensor: Sensor::Gyroscope,
        parameters: &parameters(GYROSCOPE_PRODUCTS, "s/rad", 1e-4),
        plain: 9,
        shape: None,
        reads: &[Sensor::Gyroscope],
        needs: &[],
        formula: "k_i,yz wy wz + k_i,xz wx wz + k_i,xy wx wy",
        observable: "turns about axes between the sensor axes",
        aliases: &[],
        field: |state, _, terms| terms.entries(cross_products(&state.angular_rate)),
    };

    /// `accel_scale_quadratic`: error `k_i f_i^2` of axis i, with the parameter k_i and the specific force f.
    pub const ACCEL_SCALE_QUADRATIC: &'static Self = &effect! {
        number: 8,
        name: "accel_scale_quadratic",
        sensor: Sensor::Accelerometer,
        // Typical value: 2e-3 of the force at 1 g.
        parameters: &parameters(AXES, "1/(m/s^2)", 2e-3 / STANDARD_GRAVITY_MPS2),
        plain: 3,
        shape: None,
        reads: &[Sensor::Accelerometer],
        needs: &[],
        formula: "k_i f_i^2",
        observable: "rests with each axis up, down and between",
        aliases: &[
            Alias { with: "accel_scale_asymmetry", told_apart_by: "rests every 15 deg" },
            Alias {
                with: "accel_cross_axis_quadratic",
                told_apart_by: "a stand whose angles are known: the norm of f alone does not distinguish them",
            },
        ],
        field: |state, _, terms| quadratic(&state.specific_force, terms),
    };

    /// `accel_scale_cubic`: error `k_i f_i^3` of axis i, with the parameter k_i and the specific force f.
    pub const ACCEL_SCALE_CUBIC: &'static Self = &effect! {
        number: 9,
        name: "accel_scale_cubic",
        sensor: Sensor::Accelerometer,
        // Typical value: 2e-3 of the force at 1 g.
        parameters: &parameters(AXES, "1/(m/s^2)^2", 2e-3 / (STANDARD_GRAVITY_MPS2 * STANDARD_GRAVITY_MPS2)),
        plain: 3,
        shape: None,
        reads: &[Sensor::Accelerometer],
        needs: &[],
        formula: "k_i f_i^3",
        observable: "rests every 15 deg, weakly",
        aliases: &[Alias { with: "accel_scale", told_apart_by: "rests every 15 deg, or forces above g" }],
        field: |state, _, terms| cubic(&state.specific_force, terms),
    };

    /// `accel_scale_asymmetry`: error `k_i |f_i|` of axis i, with the parameter k_i and the specific force f.
    pub const ACCEL_SCALE_ASYMMETRY: &'static Self = &effect! {
        number: 10,
        name: "accel_scale_asymmetry",
        sensor: Sensor::Accelerometer,
        // Typical value: 0.1 % of the force.
        parameters: &parameters(AXES, "1", 0.001),
        plain: 3,
        shape: None,
        reads: &[Sensor::Accelerometer],
        needs: &[],
        formula: "k_i |f_i|",
        observable: "rests with each axis up, down and between",
        aliases: &[Alias { with: "accel_scale_quadratic", told_apart_by: "rests every 15 deg" }],
        field: |state, _, terms| asymmetry(&state.specific_force, terms),
    };

    /// `accel_cross_axis_quadratic`: error of axis i, the sum of `k_i,jl f_j f_l` over all products of two components
    /// of the specific force f except f_i^2, with the parameters k_i,jl.
    pub const ACCEL_CROSS_AXIS_QUADRATIC: &'static Self = &effect! {
        number: 11,
        name: "accel_cross_axis_quadratic",
        sensor: Sensor::Accelerometer,
        // Typical value: an error of 1e-3 g if both components of the product are 1 g.
        parameters: &parameters(ACCELEROMETER_PRODUCTS, "1/(m/s^2)", 1e-3 / STANDARD_GRAVITY_MPS2),
        plain: 15,
        shape: None,
        reads: &[Sensor::Accelerometer],
        needs: &[],
        formula: "sum of k_i,jl f_j f_l over all products but f_i^2",
        observable: "rests on a stand whose angles are known",
        aliases: &[Alias {
            with: "accel_scale_quadratic",
            told_apart_by: "a stand whose angles are known: the norm of f alone does not distinguish them",
        }],
        field: |state, _, terms| accelerometer_cross_axis(state, terms),
    };
}

#[inline(always)]
fn quadratic<F: RealField + Copy>(v: &Vector3<F>, terms: &mut impl Terms<F>) {
    terms.axes(squares(v));
}

#[inline(always)]
fn cubic<F: RealField + Copy>(v: &Vector3<F>, terms: &mut impl Terms<F>) {
    terms.axes(each(&squares(v), v));
}

#[inline(always)]
fn asymmetry<F: RealField + Copy>(v: &Vector3<F>, terms: &mut impl Terms<F>) {
    terms.axes(Vector3::new(magnitude(v.x), magnitude(v.y), magnitude(v.z)));
}

#[inline(always)]
fn accelerometer_cross_axis<F: RealField + Copy>(state: &State<F>, terms: &mut impl Terms<F>) {
    let own = squares(&state.specific_force);
    let mixed = cross_products(&state.specific_force);
    for cause in [own.y, own.z, mixed.x, mixed.y, mixed.z] {
        terms.x(cause);
    }
    for cause in [own.x, own.z, mixed.x, mixed.y, mixed.z] {
        terms.y(cause);
    }
    for cause in [own.x, own.y, mixed.x, mixed.y, mixed.z] {
        terms.z(cause);
    }
}
