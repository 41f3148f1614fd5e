//! Effects on the motor angles that the encoders of a stand read.
//!
//! ```text
//! encoder_eccentricity   s_mk sin(k q_m) + c_mk cos(k q_m),   summed over k: plain form k = 1, full form k = 1 and 2
//! encoder_time_offset    q(t + tau) - q(t) = tau dq/dt + O(tau^2)
//! encoder_backlash       b_m d_m,                             d_m is the sign of the last motion of motor m
//! ```
//!
//! The plain form of an effect is the form with the fewest parameters, and the full form has all parameters. q_m is the
//! true angle of motor m, and q the vector of the three angles. The parameters are s_mk and c_mk, the time offset tau,
//! and the backlash b_m. The readings after motions in opposite directions differ by 2 b_m. If an encoder disk is off
//! centre by 1 % of its radius, the angle has an error with an amplitude of 0.01 rad and a period of one revolution. If
//! the disk is oval, the error has a period of half a revolution. Component m of the error of an effect belongs to the
//! encoder of motor m. Motor 1 is the outermost motor.

use super::{Alias, DEGREE, Effect, Need, Parameter, Sensor, StandState, State, Terms, effect, parameters};
use nalgebra::{RealField, Vector3};

/// Parameter names of `encoder_eccentricity`. Each name consists of the function (`sin` or `cos`), the number of the
/// motor, and the number of periods per revolution.
const HARMONICS: [&str; 12] = [
    "sin_1_1", "cos_1_1", "sin_2_1", "cos_2_1", "sin_3_1", "cos_3_1", //
    "sin_1_2", "cos_1_2", "sin_2_2", "cos_2_2", "sin_3_2", "cos_3_2",
];
/// Parameter names of an effect with one parameter for each motor.
const MOTORS: [&str; 3] = ["1", "2", "3"];

impl<F: RealField + Copy> Effect<F> {
    pub(super) const ENCODER: &'static [&'static Self] =
        &[Self::ENCODER_ECCENTRICITY, Self::ENCODER_TIME_OFFSET, Self::ENCODER_BACKLASH];

    /// `encoder_eccentricity`: error `s_m sin q_m + c_m cos q_m` of the angle q_m of motor m, with the parameters s_m
    /// and c_m. The full form also contains these two terms for the angle 2 q_m.
    pub const ENCODER_ECCENTRICITY: &'static Self = &effect! {
        number: 0,
        name: "encoder_eccentricity",
        sensor: Sensor::Encoder,
        parameters: &parameters(HARMONICS, "rad", 0.02 * DEGREE),
        plain: 6,
        shape: None,
        reads: &[],
        needs: &[Need::Stand],
        formula: "s_m sin q_m + c_m cos q_m, full form + the same of 2 q_m",
        observable: "rests at many angles of each motor, all around",
        aliases: &[Alias {
            with: "a motor's zero",
            told_apart_by: "half a turn or more: over a small angle the cosine is a constant",
        }],
        field: |state, _, terms| eccentricity(state, terms),
    };

    /// `encoder_time_offset`: error `tau dq/dt` of the motor angles q. The reading at the time t is q(t + tau).
    pub const ENCODER_TIME_OFFSET: &'static Self = &effect! {
        number: 0,
        name: "encoder_time_offset",
        sensor: Sensor::Encoder,
        parameters: &[Parameter { name: "tau", unit: "s", typical: 2e-3 }],
        plain: 1,
        shape: None,
        reads: &[],
        needs: &[Need::Stand],
        formula: "tau dq/dt",
        observable: "turns with encoder angles",
        aliases: &[Alias {
            with: "a delay of both sensors",
            told_apart_by: "no measurement: only the difference of the two delays is observable",
        }],
        field: |state, _, terms| terms.column(stand(state).rate_radps),
    };

    /// `encoder_backlash`: error `b_m d_m` of the angle of motor m, with the parameter b_m and the sign d_m of the last
    /// motion of this motor.
    pub const ENCODER_BACKLASH: &'static Self = &effect! {
        number: 0,
        name: "encoder_backlash",
        sensor: Sensor::Encoder,
        parameters: &parameters(MOTORS, "rad", 0.05 * DEGREE),
        plain: 3,
        shape: None,
        reads: &[],
        needs: &[Need::Stand],
        formula: "b_m d_m, d_m the sign of the last motion of motor m",
        observable: "rests at one angle that is reached from both sides",
        aliases: &[Alias { with: "a motor's zero", told_apart_by: "turns of both signs" }],
        field: |state, _, terms| terms.axes(stand(state).direction),
    };
}

#[inline(always)]
fn eccentricity<F: RealField + Copy>(state: &State<F>, terms: &mut impl Terms<F>) {
    // If the state of the stand is unknown, the effect must be zero. In this case, `stand` returns zero angles. The
    // sines are then zero, and the factor `known` sets the cosines to zero.
    let known = if state.surroundings.stand.is_some() { F::one() } else { F::zero() };
    let angles = stand(state).angle_rad;
    for (motor, angle_rad) in angles.iter().enumerate() {
        let (sine, cosine) = angle_rad.sin_cos();
        terms.column(Vector3::ith(motor, sine));
        terms.column(Vector3::ith(motor, cosine * known));
    }
    for (motor, angle_rad) in angles.iter().enumerate() {
        let (sine, cosine) = angle_rad.sin_cos();
        terms.column(Vector3::ith(motor, (sine + sine) * cosine));
        terms.column(Vector3::ith(motor, (cosine * cosine - sine * sine) * known));
    }
}

fn stand<F: RealField + Copy>(state: &State<F>) -> StandState<F> {
    state.surroundings.stand.unwrap_or(StandState::still(Vector3::zeros()))
}
