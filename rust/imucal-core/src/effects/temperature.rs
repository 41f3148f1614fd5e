//! Effects of temperature on bias and scale.
//!
//! ```text
//! *_bias_temperature     k_i dT + q_i dT^2 + c_i dT^3
//! *_scale_temperature   (k_i dT + q_i dT^2 + c_i dT^3) v_i
//! ```
//!
//! Each effect can be used with 3, 6 or 9 parameters. With 3 parameters, it has only the linear terms (plain form),
//! with 6 parameters also the quadratic terms, and with 9 parameters also the cubic terms.
//!
//! k_i, q_i and c_i are the parameters of axis i. dT is the temperature minus the reference temperature, in kelvin. The
//! sensitivity and the bias of the calibration are valid at the reference temperature. v is the angular rate w for the
//! gyroscope and the specific force f for the accelerometer.

use super::{AXES, Alias, DEGREE, Effect, Need, Parameter, Sensor, State, Terms, effect, parameters, same};
use crate::{STANDARD_GRAVITY_MPS2, vector::scaled};
use nalgebra::{RealField, Vector3};

const HEAT_AND_COOL: &str = "a run that heats and cools again";
/// Temperature difference, in kelvin, at which the linear, quadratic and cubic terms of an effect with typical
/// parameters are equal.
const BEND_K: f64 = 50.0;
/// Typical temperature coefficient of a gyroscope bias: 0.015 deg/s per kelvin.
pub(super) const GYROSCOPE: f64 = 0.015 * DEGREE;
/// Typical temperature coefficient of an accelerometer bias: 0.2 mg per kelvin.
pub(super) const ACCELEROMETER: f64 = 0.2e-3 * STANDARD_GRAVITY_MPS2;

impl<F: RealField + Copy> Effect<F> {
    #[cfg(feature = "catalogue")]
    pub(super) const TEMPERATURE: &'static [&'static Self] = &[
        Self::GYRO_BIAS_TEMPERATURE,
        Self::GYRO_SCALE_TEMPERATURE,
        Self::ACCEL_BIAS_TEMPERATURE,
        Self::ACCEL_SCALE_TEMPERATURE,
    ];

    /// `gyro_bias_temperature`: bias change `k_i dT + q_i dT^2 + c_i dT^3` of axis i with the parameters k_i,
    /// q_i and c_i. dT is the temperature minus the reference temperature, in kelvin.
    pub const GYRO_BIAS_TEMPERATURE: &'static Self = &effect! {
        number: 12,
        name: "gyro_bias_temperature",
        sensor: Sensor::Gyroscope,
        parameters: &cubic(["rad/s/K", "rad/s/K^2", "rad/s/K^3"], GYROSCOPE),
        plain: 3,
        shape: None,
        reads: &[],
        needs: &[Need::Temperature],
        formula: "k_i dT + q_i dT^2 + c_i dT^3",
        observable: "rests at several temperatures",
        aliases: &[
            Alias { with: "gyro_bias_drift", told_apart_by: HEAT_AND_COOL },
            Alias { with: "gyro_bias_warmup", told_apart_by: HEAT_AND_COOL },
        ],
        field: |state, _, terms| bias(state, terms),
    };

    /// `gyro_scale_temperature`: error `(k_i dT + q_i dT^2 + c_i dT^3) w_i` of axis i with the parameters k_i, q_i
    /// and c_i. dT is the temperature minus the reference temperature, in kelvin, and w is the angular rate.
    pub const GYRO_SCALE_TEMPERATURE: &'static Self = &effect! {
        number: 13,
        name: "gyro_scale_temperature",
        sensor: Sensor::Gyroscope,
        // Typical value: 300 ppm per kelvin.
        parameters: &cubic(["1/K", "1/K^2", "1/K^3"], 300e-6),
        plain: 3,
        shape: None,
        reads: &[Sensor::Gyroscope],
        needs: &[Need::Temperature],
        formula: "(k_i dT + q_i dT^2 + c_i dT^3) w_i",
        observable: "turns at several temperatures",
        aliases: &[Alias { with: "gyro_scale_drift", told_apart_by: HEAT_AND_COOL }],
        field: |state, _, terms| scale(&state.angular_rate, state, terms),
    };

    /// `accel_bias_temperature`: bias change `k_i dT + q_i dT^2 + c_i dT^3` of axis i with the parameters k_i,
    /// q_i and c_i. dT is the temperature minus the reference temperature, in kelvin.
    pub const ACCEL_BIAS_TEMPERATURE: &'static Self = &effect! {
        number: 14,
        name: "accel_bias_temperature",
        sensor: Sensor::Accelerometer,
        parameters: &cubic(["m/s^2/K", "m/s^2/K^2", "m/s^2/K^3"], ACCELEROMETER),
        plain: 3,
        shape: None,
        reads: &[],
        needs: &[Need::Temperature],
        formula: "k_i dT + q_i dT^2 + c_i dT^3",
        observable: "rests of many orientations at several temperatures",
        aliases: &[
            Alias { with: "accel_bias_drift", told_apart_by: HEAT_AND_COOL },
            Alias { with: "accel_bias_warmup", told_apart_by: HEAT_AND_COOL },
        ],
        field: |state, _, terms| bias(state, terms),
    };

    /// `accel_scale_temperature`: error `(k_i dT + q_i dT^2 + c_i dT^3) f_i` of axis i with the parameters k_i,
    /// q_i and c_i. dT is the temperature minus the reference temperature, in kelvin, and f is the specific force.
    pub const ACCEL_SCALE_TEMPERATURE: &'static Self = &effect! {
        number: 15,
        name: "accel_scale_temperature",
        sensor: Sensor::Accelerometer,
        // Typical value: 100 ppm per kelvin.
        parameters: &cubic(["1/K", "1/K^2", "1/K^3"], 100e-6),
        plain: 3,
        shape: None,
        reads: &[Sensor::Accelerometer],
        needs: &[Need::Temperature],
        formula: "(k_i dT + q_i dT^2 + c_i dT^3) f_i",
        observable: "rests of many orientations at several temperatures",
        aliases: &[Alias {
            with: "accel_bias_temperature",
            told_apart_by: "each axis up and down at each temperature",
        }],
        field: |state, _, terms| scale(&state.specific_force, state, terms),
    };
}

/// Creates the parameters of an effect whose error on each axis is a cubic polynomial in the temperature difference,
/// without a constant term. `typical` is the typical size of the linear coefficient.
const fn cubic(units: [&'static str; 3], typical: f64) -> [Parameter; 9] {
    by_degree([["x_square", "y_square", "z_square"], ["x_cube", "y_cube", "z_cube"]], units, typical)
}

/// Creates the nine parameters of an effect: for each axis, the coefficients of three consecutive powers of the
/// temperature difference. `typical` is the typical size of the coefficients of the lowest power. `higher` contains the
/// names of the coefficients of the two higher powers.
pub(super) const fn by_degree(
    higher: [[&'static str; 3]; 2],
    units: [&'static str; 3],
    typical: f64,
) -> [Parameter; 9] {
    let [x, y, z] = parameters(AXES, units[0], typical);
    let [xx, yy, zz] = parameters(higher[0], units[1], typical / BEND_K);
    let [xxx, yyy, zzz] = parameters(higher[1], units[2], typical / (BEND_K * BEND_K));
    [x, y, z, xx, yy, zz, xxx, yyy, zzz]
}

#[inline(always)]
fn bias<F: RealField + Copy>(state: &State<F>, terms: &mut impl Terms<F>) {
    let difference = state.surroundings.temperature_difference_k.unwrap_or(F::zero());
    let square = difference * difference;
    terms.axes(same(difference));
    terms.axes(same(square));
    terms.axes(same(square * difference));
}

#[inline(always)]
fn scale<F: RealField + Copy>(v: &Vector3<F>, state: &State<F>, terms: &mut impl Terms<F>) {
    let difference = state.surroundings.temperature_difference_k.unwrap_or(F::zero());
    let square = difference * difference;
    terms.axes(scaled(v, difference));
    terms.axes(scaled(v, square));
    terms.axes(scaled(v, square * difference));
}
