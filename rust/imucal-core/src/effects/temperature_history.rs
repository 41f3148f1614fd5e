//! Effects of the temperature history on the biases. At the same temperature, these effects differ between heating and
//! cooling.
//!
//! ```text
//! *_bias_temperature_lag          (k_i + q_i dT + c_i dT^2) (T_tau - T)     tau dT_tau/dt = T - T_tau, tau the shape
//! *_bias_temperature_rate         (k_i + q_i dT + c_i dT^2) dT/dt
//! *_bias_temperature_hysteresis   (k_i + q_i dT + c_i dT^2) s
//! ```
//!
//! Each effect can be used with 3, 6 or 9 parameters. With 3 parameters, it has only the k_i, with 6 parameters also
//! the q_i, and with 9 parameters also the c_i.
//!
//! k_i, q_i and c_i are the parameters of axis i. T is the temperature, and dT is T minus the reference temperature, in
//! kelvin. T_tau is T after a first-order low-pass with the time constant tau (the shape). s is the direction of the
//! last temperature change, from -1 (cooling) to 1 (heating). [`TemperatureMemory`](super::temperature_memory) computes
//! T_tau - T, dT/dt and s.
//!
//! A unit may have both the lag effect and `*_bias_temperature`. Let a be the linear coefficient of
//! `*_bias_temperature`, and k the coefficient k_i of the lag effect. The sum of the two linear terms is then
//! `a T + k (T_tau - T)` plus a constant. If k = a, the sum equals `a T_tau` plus this constant, so the bias follows a
//! temperature that lags the thermometer. If k and a have opposite signs, the bias follows a temperature that leads
//! the thermometer.

use super::temperature::{ACCELEROMETER, GYROSCOPE, by_degree};
use super::temperature_memory::TemperatureHistory;
use super::{Alias, Effect, Need, Parameter, Sensor, State, Surroundings, Terms, effect, same};
use nalgebra::RealField;

#[cfg(feature = "catalogue")]
const OBSERVABLE: &str = "rests while the temperature rises and while it falls";
const SEVERAL_RATES: &str = "temperature changes of several rates and durations";
/// Shape (nonlinear parameter) of the lag effects: the time constant, typically 60 s for a sensor on a board.
const TAU: Option<Parameter> = Some(Parameter { name: "tau", unit: "s", typical: 60.0 });
/// Typical value of (coefficient of dT/dt) / (coefficient of T) of a bias, s. If the temperature changes slowly, such a
/// bias follows a temperature that leads the thermometer by this time.
const AHEAD_S: f64 = 60.0;
/// Typical hysteresis as a temperature, in kelvin: half the difference between the biases while heating and while
/// cooling, divided by the temperature coefficient of the bias.
const WIDTH_K: f64 = 2.0;

impl<F: RealField + Copy> Effect<F> {
    #[cfg(feature = "catalogue")]
    pub(super) const TEMPERATURE_HISTORY: &'static [&'static Self] = &[
        Self::GYRO_BIAS_TEMPERATURE_LAG,
        Self::GYRO_BIAS_TEMPERATURE_RATE,
        Self::GYRO_BIAS_TEMPERATURE_HYSTERESIS,
        Self::ACCEL_BIAS_TEMPERATURE_LAG,
        Self::ACCEL_BIAS_TEMPERATURE_RATE,
        Self::ACCEL_BIAS_TEMPERATURE_HYSTERESIS,
    ];

    /// `gyro_bias_temperature_lag`: bias change `(k_i + q_i dT + c_i dT^2) (T_tau - T)` of axis i with the parameters
    /// k_i, q_i and c_i. T_tau is the temperature T after a low-pass with the time constant tau, and dT is T minus the
    /// reference temperature.
    pub const GYRO_BIAS_TEMPERATURE_LAG: &'static Self = &effect! {
        number: 26,
        name: "gyro_bias_temperature_lag",
        sensor: Sensor::Gyroscope,
        parameters: &graded(["rad/s/K", "rad/s/K^2", "rad/s/K^3"], GYROSCOPE),
        plain: 3,
        shape: TAU,
        reads: &[],
        needs: &[Need::Temperature, Need::TemperatureHistory],
        formula: "(k_i + q_i dT + c_i dT^2) (T_tau - T), tau dT_tau/dt = T - T_tau",
        observable: OBSERVABLE,
        aliases: &[
            Alias { with: "gyro_bias_temperature", told_apart_by: SEVERAL_RATES },
            Alias { with: "gyro_bias_temperature_rate", told_apart_by: SEVERAL_RATES },
            Alias { with: "gyro_bias_temperature_hysteresis", told_apart_by: SEVERAL_RATES },
        ],
        field: |state, _, terms| powers(state, |history| history.gyroscope_lag_k, terms),
    };

    /// `gyro_bias_temperature_rate`: bias change `(k_i + q_i dT + c_i dT^2) dT/dt` of axis i with the parameters k_i,
    /// q_i and c_i. dT is the temperature minus the reference temperature, in kelvin. dT/dt is the rate of change of
    /// the temperature, in kelvin per second.
    pub const GYRO_BIAS_TEMPERATURE_RATE: &'static Self = &effect! {
        number: 27,
        name: "gyro_bias_temperature_rate",
        sensor: Sensor::Gyroscope,
        parameters: &graded(["rad/s/(K/s)", "rad/s/(K/s)/K", "rad/s/(K/s)/K^2"], GYROSCOPE * AHEAD_S),
        plain: 3,
        shape: None,
        reads: &[],
        needs: &[Need::Temperature, Need::TemperatureHistory],
        formula: "(k_i + q_i dT + c_i dT^2) dT/dt",
        observable: OBSERVABLE,
        aliases: &[
            Alias { with: "gyro_bias_temperature_lag", told_apart_by: SEVERAL_RATES },
            Alias { with: "gyro_bias_temperature_hysteresis", told_apart_by: SEVERAL_RATES },
        ],
        field: |state, _, terms| powers(state, |history| history.rate_kps, terms),
    };

    /// `gyro_bias_temperature_hysteresis`: bias change `(k_i + q_i dT + c_i dT^2) s` of axis i with the parameters k_i,
    /// q_i and c_i. dT is the temperature minus the reference temperature, in kelvin. s is the direction of the
    /// temperature change: 1 while heating, -1 while cooling.
    pub const GYRO_BIAS_TEMPERATURE_HYSTERESIS: &'static Self = &effect! {
        number: 28,
        name: "gyro_bias_temperature_hysteresis",
        sensor: Sensor::Gyroscope,
        parameters: &graded(["rad/s", "rad/s/K", "rad/s/K^2"], GYROSCOPE * WIDTH_K),
        plain: 3,
        shape: None,
        reads: &[],
        needs: &[Need::Temperature, Need::TemperatureHistory],
        formula: "(k_i + q_i dT + c_i dT^2) s, s = 1 heating, -1 cooling",
        observable: OBSERVABLE,
        aliases: &[
            Alias { with: "gyro_bias_temperature_lag", told_apart_by: SEVERAL_RATES },
            Alias { with: "gyro_bias_temperature_rate", told_apart_by: SEVERAL_RATES },
        ],
        field: |state, _, terms| powers(state, |history| history.direction, terms),
    };

    /// `accel_bias_temperature_lag`: bias change `(k_i + q_i dT + c_i dT^2) (T_tau - T)` of axis i with the parameters
    /// k_i, q_i and c_i. T_tau is the temperature T after a low-pass with the time constant tau, and dT is T minus the
    /// reference temperature.
    pub const ACCEL_BIAS_TEMPERATURE_LAG: &'static Self = &effect! {
        number: 29,
        name: "accel_bias_temperature_lag",
        sensor: Sensor::Accelerometer,
        parameters: &graded(["m/s^2/K", "m/s^2/K^2", "m/s^2/K^3"], ACCELEROMETER),
        plain: 3,
        shape: TAU,
        reads: &[],
        needs: &[Need::Temperature, Need::TemperatureHistory],
        formula: "(k_i + q_i dT + c_i dT^2) (T_tau - T), tau dT_tau/dt = T - T_tau",
        observable: OBSERVABLE,
        aliases: &[
            Alias { with: "accel_bias_temperature", told_apart_by: SEVERAL_RATES },
            Alias { with: "accel_bias_temperature_rate", told_apart_by: SEVERAL_RATES },
            Alias { with: "accel_bias_temperature_hysteresis", told_apart_by: SEVERAL_RATES },
        ],
        field: |state, _, terms| powers(state, |history| history.accelerometer_lag_k, terms),
    };

    /// `accel_bias_temperature_rate`: bias change `(k_i + q_i dT + c_i dT^2) dT/dt` of axis i with the parameters k_i,
    /// q_i and c_i. dT is the temperature minus the reference temperature, in kelvin. dT/dt is the rate of change of
    /// the temperature, in kelvin per second.
    pub const ACCEL_BIAS_TEMPERATURE_RATE: &'static Self = &effect! {
        number: 30,
        name: "accel_bias_temperature_rate",
        sensor: Sensor::Accelerometer,
        parameters: &graded(["m/s^2/(K/s)", "m/s^2/(K/s)/K", "m/s^2/(K/s)/K^2"], ACCELEROMETER * AHEAD_S),
        plain: 3,
        shape: None,
        reads: &[],
        needs: &[Need::Temperature, Need::TemperatureHistory],
        formula: "(k_i + q_i dT + c_i dT^2) dT/dt",
        observable: OBSERVABLE,
        aliases: &[
            Alias { with: "accel_bias_temperature_lag", told_apart_by: SEVERAL_RATES },
            Alias { with: "accel_bias_temperature_hysteresis", told_apart_by: SEVERAL_RATES },
        ],
        field: |state, _, terms| powers(state, |history| history.rate_kps, terms),
    };

    /// `accel_bias_temperature_hysteresis`: bias change `(k_i + q_i dT + c_i dT^2) s` of axis i with the parameters
    /// k_i, q_i and c_i. dT is the temperature minus the reference temperature, in kelvin. s is the direction of the
    /// temperature change: 1 while heating, -1 while cooling.
    pub const ACCEL_BIAS_TEMPERATURE_HYSTERESIS: &'static Self = &effect! {
        number: 31,
        name: "accel_bias_temperature_hysteresis",
        sensor: Sensor::Accelerometer,
        parameters: &graded(["m/s^2", "m/s^2/K", "m/s^2/K^2"], ACCELEROMETER * WIDTH_K),
        plain: 3,
        shape: None,
        reads: &[],
        needs: &[Need::Temperature, Need::TemperatureHistory],
        formula: "(k_i + q_i dT + c_i dT^2) s, s = 1 heating, -1 cooling",
        observable: OBSERVABLE,
        aliases: &[
            Alias { with: "accel_bias_temperature_lag", told_apart_by: SEVERAL_RATES },
            Alias { with: "accel_bias_temperature_rate", told_apart_by: SEVERAL_RATES },
        ],
        field: |state, _, terms| powers(state, |history| history.direction, terms),
    };
}

/// For each axis, the parameters of an effect of the temperature history: the coefficients of a quadratic polynomial in
/// the temperature difference. `typical` is the typical size of the constant term.
const fn graded(units: [&'static str; 3], typical: f64) -> [Parameter; 9] {
    by_degree([["x_linear", "y_linear", "z_linear"], ["x_square", "y_square", "z_square"]], units, typical)
}

/// Adds the terms of one variable v of the temperature history (lag, rate or direction): v, v dT and v dT^2, where dT
/// is the temperature difference. `variable` returns v. The terms are zero if the history or the temperature is
/// unknown.
#[inline(always)]
fn powers<F: RealField + Copy>(
    state: &State<F>,
    variable: impl Fn(&TemperatureHistory<F>) -> F,
    terms: &mut impl Terms<F>,
) {
    let Surroundings { temperature_difference_k, temperature_history, .. } = &state.surroundings;
    let difference = temperature_difference_k.unwrap_or(F::zero());
    let cause = match (temperature_difference_k, temperature_history) {
        (Some(_), Some(history)) => variable(history),
        _ => F::zero(),
    };
    terms.axes(same(cause));
    terms.axes(same(cause * difference));
    terms.axes(same(cause * difference * difference));
}
