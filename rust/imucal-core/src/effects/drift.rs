//! Effects that change bias and scale with time.
//!
//! ```text
//! *_bias_drift        k_i t
//! *_bias_warmup       k_i exp(-t / tau)      tau is the time constant (the shape)
//! gyro_scale_drift    k_i t w_i
//! ```
//!
//! k_i is the parameter of axis i, and w_i the angular rate about this axis. t is the time, s, since an instant that
//! the calibration defines. For a warm-up, this instant is power-on.

use super::{AXES, Alias, DEGREE, Effect, Need, Parameter, Sensor, State, Terms, effect, parameters, same};
use crate::{STANDARD_GRAVITY_MPS2, vector::scaled};
use nalgebra::RealField;

const HEAT_AND_COOL: &str = "a run that heats and cools again";
const LONGER: &str = "a run of several time constants";
/// Shape (nonlinear parameter) of the warm-up effects: the time constant of self-heating, typically 100 s for a small
/// package.
const TAU: Option<Parameter> = Some(Parameter { name: "tau", unit: "s", typical: 100.0 });

impl<F: RealField + Copy> Effect<F> {
    #[cfg(feature = "catalogue")]
    pub(super) const DRIFT: &'static [&'static Self] = &[
        Self::GYRO_BIAS_DRIFT,
        Self::GYRO_BIAS_WARMUP,
        Self::GYRO_SCALE_DRIFT,
        Self::ACCEL_BIAS_DRIFT,
        Self::ACCEL_BIAS_WARMUP,
    ];

    /// `gyro_bias_drift`: bias change `k_i t` of axis i at the time t, with the parameter k_i.
    pub const GYRO_BIAS_DRIFT: &'static Self = &effect! {
        number: 16,
        name: "gyro_bias_drift",
        sensor: Sensor::Gyroscope,
        // Typical value: 0.01 deg/s per 100 s.
        parameters: &parameters(AXES, "rad/s/s", 0.01 * DEGREE / 100.0),
        plain: 3,
        shape: None,
        reads: &[],
        needs: &[Need::Time],
        formula: "k_i t",
        observable: "rests early and late",
        aliases: &[
            Alias { with: "gyro_bias_temperature", told_apart_by: HEAT_AND_COOL },
            Alias { with: "gyro_bias_warmup", told_apart_by: LONGER },
        ],
        field: |state, _, terms| terms.axes(same(time(state))),
    };

    /// `gyro_bias_warmup`: bias change `k_i exp(-t / tau)` of axis i at the time t after power-on, with the parameter
    /// k_i and the time constant tau.
    pub const GYRO_BIAS_WARMUP: &'static Self = &effect! {
        number: 17,
        name: "gyro_bias_warmup",
        sensor: Sensor::Gyroscope,
        // Typical value: 0.05 deg/s at power-on.
        parameters: &parameters(AXES, "rad/s", 0.05 * DEGREE),
        plain: 3,
        shape: TAU,
        reads: &[],
        needs: &[Need::Time],
        formula: "k_i exp(-t / tau)",
        observable: "rests starting at power-on",
        aliases: &[
            Alias { with: "gyro_bias_temperature", told_apart_by: HEAT_AND_COOL },
            Alias { with: "gyro_bias_drift", told_apart_by: LONGER },
        ],
        field: |state, tau, terms| bias_warmup(state, tau, terms),
    };

    /// `gyro_scale_drift`: error `k_i t w_i` of axis i at the time t, with the parameter k_i and the angular rate w.
    pub const GYRO_SCALE_DRIFT: &'static Self = &effect! {
        number: 18,
        name: "gyro_scale_drift",
        sensor: Sensor::Gyroscope,
        // Typical value: a scale change of 500 ppm per 100 s.
        parameters: &parameters(AXES, "1/s", 500e-6 / 100.0),
        plain: 3,
        shape: None,
        reads: &[Sensor::Gyroscope],
        needs: &[Need::Time],
        formula: "k_i t w_i",
        observable: "turns early and late",
        aliases: &[Alias { with: "gyro_scale_temperature", told_apart_by: HEAT_AND_COOL }],
        field: |state, _, terms| terms.axes(scaled(&state.angular_rate, time(state))),
    };

    /// `accel_bias_drift`: bias change `k_i t` of axis i at the time t, with the parameter k_i.
    pub const ACCEL_BIAS_DRIFT: &'static Self = &effect! {
        number: 19,
        name: "accel_bias_drift",
        sensor: Sensor::Accelerometer,
        // Typical value: 0.5 mg per 100 s.
        parameters: &parameters(AXES, "m/s^2/s", 0.5e-3 * STANDARD_GRAVITY_MPS2 / 100.0),
        plain: 3,
        shape: None,
        reads: &[],
        needs: &[Need::Time],
        formula: "k_i t",
        observable: "rests of many orientations, early and late",
        aliases: &[
            Alias { with: "accel_bias_temperature", told_apart_by: HEAT_AND_COOL },
            Alias { with: "accel_bias_warmup", told_apart_by: LONGER },
        ],
        field: |state, _, terms| terms.axes(same(time(state))),
    };

    /// `accel_bias_warmup`: bias change `k_i exp(-t / tau)` of axis i at the time t after power-on, with the parameter
    /// k_i and the time constant tau.
    pub const ACCEL_BIAS_WARMUP: &'static Self = &effect! {
        number: 20,
        name: "accel_bias_warmup",
        sensor: Sensor::Accelerometer,
        // Typical value: 1 mg at power-on.
        parameters: &parameters(AXES, "m/s^2", 1e-3 * STANDARD_GRAVITY_MPS2),
        plain: 3,
        shape: TAU,
        reads: &[],
        needs: &[Need::Time],
        formula: "k_i exp(-t / tau)",
        observable: "rests of many orientations, starting at power-on",
        aliases: &[
            Alias { with: "accel_bias_temperature", told_apart_by: HEAT_AND_COOL },
            Alias { with: "accel_bias_drift", told_apart_by: LONGER },
        ],
        field: |state, tau, terms| bias_warmup(state, tau, terms),
    };
}

fn time<F: RealField + Copy>(state: &State<F>) -> F {
    state.surroundings.time_s.unwrap_or(F::zero())
}

#[inline(always)]
fn bias_warmup<F: RealField + Copy>(state: &State<F>, tau: F, terms: &mut impl Terms<F>) {
    // If the time is unknown, the unit has probably been switched on for a long time, so the warm-up is assumed to be
    // complete.
    let left = state.surroundings.time_s.map_or(F::zero(), |time_s| (-time_s / tau).exp());
    terms.axes(same(left));
}
