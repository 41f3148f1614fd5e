//! Compares every effect of the catalogue with numbers calculated by hand.

use super::*;
use crate::so3;
use core::f64::consts::{FRAC_PI_2, PI};

/// A state with small whole numbers, so that the expected values below can be checked by hand.
fn state() -> State<f64> {
    State {
        angular_rate: Vector3::new(0.5, -2.0, 3.0),
        specific_force: Vector3::new(4.0, -1.0, 8.0),
        surroundings: Surroundings {
            angular_acceleration: Some(Vector3::new(10.0, 20.0, -5.0)),
            mean_angular_acceleration: None,
            // The body's x axis points along the world's y axis.
            rotation_world_from_body: Some(so3::exp(&Vector3::new(0.0, 0.0, FRAC_PI_2))),
            temperature_difference_k: Some(10.0),
            temperature_history: Some(HISTORY),
            time_s: Some(50.0),
            stand: Some(StandState {
                // The sines of the angles are 0.6, 1 and 0; the cosines are 0.8, 0 and -1.
                angle_rad: Vector3::new(0.6_f64.asin(), FRAC_PI_2, PI),
                rate_radps: Vector3::new(2.0, 0.0, -4.0),
                direction: Vector3::new(1.0, 0.0, -1.0),
            }),
        },
    }
}

const HISTORY: TemperatureHistory<f64> =
    TemperatureHistory { rate_kps: 0.5, direction: -0.5, gyroscope_lag_k: -2.0, accelerometer_lag_k: 3.0 };
const TAU_S: f64 = 25.0;
/// The factor exp(-t / tau) of a warm-up at t = 50 s with tau = 25 s.
const LEFT: f64 = 0.135_335_283_236_612_7;

/// The error that each effect adds at [`state`] if its parameters are 1, 2, 3, ... The values are calculated by hand
/// from the formulas of the catalogue.
const BY_HAND: [(&str, [f64; 3]); 34] = [
    ("gyro_g_sensitivity", [26.0, 59.0, 92.0]),
    ("gyro_g2_sensitivity", [210.0 + 224.0, 453.0 + 284.0, 696.0 + 344.0]),
    ("gyro_scale_g_sensitivity", [2.0, 4.0, 72.0]),
    ("gyro_scale_quadratic", [0.25, 8.0, 27.0]),
    ("gyro_scale_cubic", [0.125, -16.0, 81.0]),
    ("gyro_scale_asymmetry", [0.5, 4.0, 9.0]),
    ("gyro_cross_axis_quadratic", [-6.0, -22.5, -39.0]),
    ("accel_scale_quadratic", [16.0, 2.0, 192.0]),
    ("accel_scale_cubic", [64.0, -2.0, 1536.0]),
    ("accel_scale_asymmetry", [4.0, 2.0, 24.0]),
    ("accel_cross_axis_quadratic", [213.0, 728.0, 472.0]),
    ("gyro_bias_temperature", [10.0 + 400.0 + 7000.0, 20.0 + 500.0 + 8000.0, 30.0 + 600.0 + 9000.0]),
    ("gyro_scale_temperature", [0.5 * 7410.0, -2.0 * 8520.0, 3.0 * 9630.0]),
    ("accel_bias_temperature", [7410.0, 8520.0, 9630.0]),
    ("accel_scale_temperature", [4.0 * 7410.0, -8520.0, 8.0 * 9630.0]),
    ("gyro_bias_temperature_lag", [-2.0 * 741.0, -2.0 * 852.0, -2.0 * 963.0]),
    ("gyro_bias_temperature_rate", [0.5 * 741.0, 0.5 * 852.0, 0.5 * 963.0]),
    ("gyro_bias_temperature_hysteresis", [-0.5 * 741.0, -0.5 * 852.0, -0.5 * 963.0]),
    ("accel_bias_temperature_lag", [3.0 * 741.0, 3.0 * 852.0, 3.0 * 963.0]),
    ("accel_bias_temperature_rate", [0.5 * 741.0, 0.5 * 852.0, 0.5 * 963.0]),
    ("accel_bias_temperature_hysteresis", [-0.5 * 741.0, -0.5 * 852.0, -0.5 * 963.0]),
    ("gyro_bias_drift", [50.0, 100.0, 150.0]),
    ("gyro_bias_warmup", [LEFT, 2.0 * LEFT, 3.0 * LEFT]),
    ("gyro_scale_drift", [25.0, -200.0, 450.0]),
    ("accel_bias_drift", [50.0, 100.0, 150.0]),
    ("accel_bias_warmup", [LEFT, 2.0 * LEFT, 3.0 * LEFT]),
    ("gyro_angular_acceleration", [35.0, 110.0, 185.0]),
    ("gyro_time_offset", [-10.0, -20.0, 5.0]),
    ("earth_rate", [2.0, -1.0, 3.0]),
    // For r = (1, 2, 3): dw/dt x r = (70, -35, 0) and w x (w x r) = (-10.5, -37.5, -23.25).
    ("accel_lever_arm", [59.5, -72.5, -23.25]),
    // The sensing element of the y axis is at (1, 2, 3), as above. The sensing element of the z axis is at (4, 5, 6).
    // For r = (4, 5, 6), dw/dt x r has the z component -30, and w x (w x r) has the z component -49.5.
    ("accel_size_effect", [0.0, -72.5, -79.5]),
    // The sines of twice the motor angles are 0.96, 0 and 0. The cosines of twice the motor angles are 0.28, -1 and 1.
    ("encoder_eccentricity", [0.6 + 1.6 + 6.72 + 2.24, 3.0 - 10.0, -6.0 + 12.0]),
    ("encoder_time_offset", [2.0, 0.0, -4.0]),
    ("encoder_backlash", [1.0, 0.0, -3.0]),
];

/// Name of the effect, smallest and largest number of parameters (plain and full form), and unit and typical size of
/// the first and of the last parameter.
type Numbers = (&'static str, usize, usize, (&'static str, f64), (&'static str, f64));
const NUMBERS: [Numbers; 34] = [
    ("gyro_g_sensitivity", 9, 9, ("rad/s/(m/s^2)", 1.779741e-4), ("rad/s/(m/s^2)", 1.779741e-4)),
    ("gyro_g2_sensitivity", 9, 18, ("rad/s/(m/s^2)^2", 7.259321e-8), ("rad/s/(m/s^2)^2", 7.259321e-8)),
    ("gyro_scale_g_sensitivity", 3, 3, ("1/(m/s^2)", 1.019716e-4), ("1/(m/s^2)", 1.019716e-4)),
    ("gyro_scale_quadratic", 3, 3, ("s/rad", 4.583662e-4), ("s/rad", 4.583662e-4)),
    ("gyro_scale_cubic", 3, 3, ("s^2/rad^2", 2.626245e-4), ("s^2/rad^2", 2.626245e-4)),
    ("gyro_scale_asymmetry", 3, 3, ("1", 2e-3), ("1", 2e-3)),
    ("gyro_cross_axis_quadratic", 9, 9, ("s/rad", 1e-4), ("s/rad", 1e-4)),
    ("accel_scale_quadratic", 3, 3, ("1/(m/s^2)", 2.039432e-4), ("1/(m/s^2)", 2.039432e-4)),
    ("accel_scale_cubic", 3, 3, ("1/(m/s^2)^2", 2.079642e-5), ("1/(m/s^2)^2", 2.079642e-5)),
    ("accel_scale_asymmetry", 3, 3, ("1", 1e-3), ("1", 1e-3)),
    ("accel_cross_axis_quadratic", 15, 15, ("1/(m/s^2)", 1.019716e-4), ("1/(m/s^2)", 1.019716e-4)),
    ("gyro_bias_temperature", 3, 9, ("rad/s/K", 2.617994e-4), ("rad/s/K^3", 1.047198e-7)),
    ("gyro_scale_temperature", 3, 9, ("1/K", 3e-4), ("1/K^3", 1.2e-7)),
    ("accel_bias_temperature", 3, 9, ("m/s^2/K", 1.961330e-3), ("m/s^2/K^3", 7.845320e-7)),
    ("accel_scale_temperature", 3, 9, ("1/K", 1e-4), ("1/K^3", 4e-8)),
    ("gyro_bias_temperature_lag", 3, 9, ("rad/s/K", 2.617994e-4), ("rad/s/K^3", 1.047198e-7)),
    ("gyro_bias_temperature_rate", 3, 9, ("rad/s/(K/s)", 1.570796e-2), ("rad/s/(K/s)/K^2", 6.283185e-6)),
    ("gyro_bias_temperature_hysteresis", 3, 9, ("rad/s", 5.235988e-4), ("rad/s/K^2", 2.094395e-7)),
    ("accel_bias_temperature_lag", 3, 9, ("m/s^2/K", 1.961330e-3), ("m/s^2/K^3", 7.845320e-7)),
    ("accel_bias_temperature_rate", 3, 9, ("m/s^2/(K/s)", 0.1176798), ("m/s^2/(K/s)/K^2", 4.707192e-5)),
    ("accel_bias_temperature_hysteresis", 3, 9, ("m/s^2", 3.922660e-3), ("m/s^2/K^2", 1.569064e-6)),
    ("gyro_bias_drift", 3, 3, ("rad/s/s", 1.745329e-6), ("rad/s/s", 1.745329e-6)),
    ("gyro_bias_warmup", 3, 3, ("rad/s", 8.726646e-4), ("rad/s", 8.726646e-4)),
    ("gyro_scale_drift", 3, 3, ("1/s", 5e-6), ("1/s", 5e-6)),
    ("accel_bias_drift", 3, 3, ("m/s^2/s", 4.903325e-5), ("m/s^2/s", 4.903325e-5)),
    ("accel_bias_warmup", 3, 3, ("m/s^2", 9.806650e-3), ("m/s^2", 9.806650e-3)),
    ("gyro_angular_acceleration", 9, 9, ("s", 1e-4), ("s", 1e-4)),
    ("gyro_time_offset", 1, 1, ("s", 2e-3), ("s", 2e-3)),
    ("earth_rate", 3, 3, ("rad/s", 7.292115e-5), ("rad/s", 7.292115e-5)),
    ("accel_lever_arm", 3, 3, ("m", 0.02), ("m", 0.02)),
    ("accel_size_effect", 6, 6, ("m", 0.002), ("m", 0.002)),
    ("encoder_eccentricity", 6, 12, ("rad", 3.490659e-4), ("rad", 3.490659e-4)),
    ("encoder_time_offset", 1, 1, ("s", 0.002), ("s", 0.002)),
    ("encoder_backlash", 3, 3, ("rad", 8.726646e-4), ("rad", 8.726646e-4)),
];

/// The effect with all its parameters (its full form), which have the values 1, 2, 3, ...
fn counting<F: RealField + Copy>(effect: &'static Effect<F>) -> EffectValues<F> {
    let values: [F; MAX_PARAMETERS] = core::array::from_fn(|k| nalgebra::convert(k as f64 + 1.0));
    let shape = effect.shape.map(|_| nalgebra::convert(TAU_S));
    EffectValues::try_new(effect, &values[..effect.parameters.len()], shape).unwrap()
}

fn sensor_by_name(effect: &Effect<f64>) -> Sensor {
    match effect.name.split_once('_') {
        Some(("accel", _)) => Sensor::Accelerometer,
        Some(("encoder", _)) => Sensor::Encoder,
        _ => Sensor::Gyroscope,
    }
}

#[test]
fn fields_change_with_what_they_read_and_nothing_else() {
    for effect in Effect::<f64>::catalogue() {
        let columns = |state: &State<f64>| {
            let mut columns = [Vector3::zeros(); MAX_PARAMETERS];
            effect.field(state, TAU_S, &mut columns);
            columns
        };
        let other = Vector3::new(-1.5, 0.25, -4.0);
        let changes = |state: State<f64>| columns(&state) != columns(&self::state());
        let reads = |sensor| effect.reads.contains(&sensor);
        assert_eq!(changes(State { angular_rate: other, ..state() }), reads(Sensor::Gyroscope), "{}", effect.name);
        assert_eq!(
            changes(State { specific_force: other, ..state() }),
            reads(Sensor::Accelerometer),
            "{}",
            effect.name
        );
    }
}

#[test]
fn every_field_is_what_its_formula_gives_by_hand() {
    assert!(Effect::<f64>::catalogue().map(|effect| effect.name).eq(BY_HAND.iter().map(|row| row.0)));
    for (effect, (name, expected)) in Effect::catalogue().zip(BY_HAND) {
        let got = counting(effect).at(&state());
        assert!((got - Vector3::from(expected)).amax() < 1e-14 * got.amax(), "{name}: {got:?} for {expected:?}");
        assert_eq!(effect.sensor, sensor_by_name(effect), "{name}");
    }
}

#[test]
fn counts_units_and_typical_sizes_are_those_of_the_datasheets() {
    for (effect, (name, plain, all, first, last)) in Effect::<f64>::catalogue().zip(NUMBERS) {
        assert_eq!((effect.name, effect.plain, effect.parameters.len()), (name, plain, all));
        for (parameter, (unit, typical)) in [(effect.parameters[0], first), (effect.parameters[all - 1], last)] {
            assert_eq!(parameter.unit, unit, "{name}");
            assert!((parameter.typical / typical - 1.0).abs() < 1e-6, "{name}: {parameter:?}");
        }
    }
}

#[test]
fn names_are_unique_and_lead_to_their_rows() {
    for effect in Effect::<f64>::catalogue() {
        assert_eq!(Effect::<f64>::find(effect.name).map(|found| found.formula), Some(effect.formula));
        assert_eq!(Effect::<f64>::catalogue().filter(|other| *other == effect).count(), 1, "{}", effect.name);
        for parameter in effect.parameters {
            let same = effect.parameters.iter().filter(|other| other.name == parameter.name);
            assert_eq!(same.count(), 1, "{}: {}", effect.name, parameter.name);
        }
    }
    assert_eq!(Effect::<f64>::find("gyro_g"), None);
    assert_eq!(Effect::<f64>::find(""), None);
}

#[test]
fn aliases_are_effects_or_what_the_model_has_besides_them() {
    let delays = ["a delay of the accelerometer", "a delay of both sensors"];
    let others = ["gyro_bias", "gyro_scale", "accel_scale", "a motor's zero"];
    for effect in Effect::<f64>::catalogue() {
        for alias in effect.aliases {
            let known = Effect::<f64>::find(alias.with).is_some()
                || others.contains(&alias.with)
                || delays.contains(&alias.with);
            assert!(known && alias.with != effect.name, "{}: {}", effect.name, alias.with);
        }
    }
}

#[test]
fn a_field_depends_on_what_it_needs_and_on_nothing_else_around_it() {
    for effect in Effect::<f64>::catalogue() {
        let known = counting(effect).at(&state());
        for need in [
            Need::AngularAcceleration,
            Need::Attitude,
            Need::Temperature,
            Need::TemperatureHistory,
            Need::Time,
            Need::Stand,
        ] {
            let mut without = state();
            match need {
                Need::AngularAcceleration => without.surroundings.angular_acceleration = None,
                Need::Attitude => without.surroundings.rotation_world_from_body = None,
                Need::Temperature => without.surroundings.temperature_difference_k = None,
                Need::TemperatureHistory => without.surroundings.temperature_history = None,
                Need::Time => without.surroundings.time_s = None,
                Need::Stand => without.surroundings.stand = None,
            }
            let changes = counting(effect).at(&without) != known;
            assert_eq!(changes, effect.needs.contains(&need), "{}: {need:?}", effect.name);
        }
    }
}

/// The crate `imucal` estimates the parameters of both sensors in one joint fit. This fit computes the attitude at a
/// rest from the corrected specific force at the rest. If an accelerometer effect depended on the attitude, the
/// correction of this force would need the attitude, so the computation would be circular.
#[test]
fn what_acts_on_the_force_needs_no_attitude() {
    for effect in Effect::<f64>::catalogue().filter(|effect| effect.sensor == Sensor::Accelerometer) {
        assert!(!effect.needs.contains(&Need::Attitude), "{}", effect.name);
    }
}

#[test]
fn terms_with_an_unknown_factor_are_left_out() {
    let unknown = State { surroundings: Surroundings::unknown(), ..state() };
    for effect in Effect::<f64>::catalogue().filter(|effect| !effect.needs.is_empty()) {
        let expected = match effect.name {
            // The centripetal term w x (w x r) does not depend on the unknown acceleration.
            "accel_lever_arm" => Vector3::new(-10.5, -37.5, -23.25),
            "accel_size_effect" => Vector3::new(0.0, -37.5, -49.5),
            _ => Vector3::zeros(),
        };
        assert_eq!(counting(effect).at(&unknown), expected, "{}", effect.name);
    }
}

#[test]
fn the_plain_form_is_the_full_one_with_the_rest_zero() {
    for effect in Effect::<f64>::catalogue() {
        let mut values = [0.0; MAX_PARAMETERS];
        values[..effect.plain].copy_from_slice(&counting(effect).values()[..effect.plain]);
        let shape = effect.shape.map(|_| TAU_S);
        let plain = EffectValues::try_new(effect, &values[..effect.plain], shape).unwrap();
        let full = EffectValues::try_new(effect, &values[..effect.parameters.len()], shape).unwrap();
        assert_eq!(plain.at(&state()), full.at(&state()), "{}", effect.name);
    }
}

#[test]
fn f32_gives_the_numbers_of_f64() {
    let wide = state();
    let narrow = State {
        angular_rate: wide.angular_rate.cast::<f32>(),
        specific_force: wide.specific_force.cast(),
        surroundings: Surroundings {
            angular_acceleration: wide.surroundings.angular_acceleration.map(|value| value.cast()),
            mean_angular_acceleration: wide.surroundings.mean_angular_acceleration.map(|value| value.cast()),
            rotation_world_from_body: wide.surroundings.rotation_world_from_body.map(|value| value.cast()),
            temperature_difference_k: Some(10.0),
            temperature_history: Some(TemperatureHistory {
                rate_kps: 0.5,
                direction: -0.5,
                gyroscope_lag_k: -2.0,
                accelerometer_lag_k: 3.0,
            }),
            time_s: Some(50.0),
            stand: wide.surroundings.stand.map(|stand| StandState {
                angle_rad: stand.angle_rad.cast(),
                rate_radps: stand.rate_radps.cast(),
                direction: stand.direction.cast(),
            }),
        },
    };
    for (single, double) in Effect::<f32>::catalogue().zip(Effect::<f64>::catalogue()) {
        let (got, expected) = (counting(single).at(&narrow).cast::<f64>(), counting(double).at(&wide));
        assert!((got - expected).amax() < 5e-7 * expected.amax(), "{}: {got:?}, {expected:?}", single.name);
    }
}

#[test]
fn what_encoders_read_has_the_field_as_its_derivative() {
    for effect in Effect::<f64>::catalogue().filter(|effect| effect.sensor == Sensor::Encoder) {
        let mut columns = [Vector3::zeros(); MAX_PARAMETERS];
        effect.field(&state(), 1.0, &mut columns);
        for (k, parameter) in effect.parameters.iter().enumerate() {
            let step = 1e3 * parameter.typical;
            let read = |sign: f64| {
                let mut values = [0.0; MAX_PARAMETERS];
                values[k] = sign * step;
                let mut set = EffectSet::none();
                set.push(EffectValues::try_new(effect, &values[..effect.parameters.len()], None).unwrap()).unwrap();
                set.on_encoders(&state())
            };
            let difference = (read(1.0) - read(-1.0)) / (2.0 * step);
            assert!((difference - columns[k]).norm() < 1e-15, "{} {}", effect.name, parameter.name);
        }
    }
}

#[test]
fn a_row_of_ones_own_is_an_effect_like_the_others() {
    static RUB: Effect<f64> = effect! {
        number: 0,
        name: "gyro_rub",
        sensor: Sensor::Gyroscope,
        parameters: &[Parameter { name: "c", unit: "rad/s", typical: 1e-3 }],
        plain: 1,
        shape: None,
        reads: &[Sensor::Gyroscope],
        needs: &[],
        formula: "c sign(wz) along z",
        observable: "turns about z of both signs",
        aliases: &[],
        field: |state, _, terms| terms.z(state.angular_rate.z.signum()),
    };
    let values = EffectValues::try_new(&RUB, &[2e-3], None).unwrap();
    assert_eq!(values.at(&state()), Vector3::new(0.0, 0.0, 2e-3));
}
