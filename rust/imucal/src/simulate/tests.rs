//! Tests of complete simulated runs.

mod record;

use imucal_core::calibration::Calibration;
use imucal_core::effects::{Effect, EffectValues, State, Surroundings};
use imucal_core::sensor::Triad;
use imucal_core::so3;
use imucal_core::temperature_memory::TemperatureMemory;
use nalgebra::{UnitQuaternion, Vector3};

use super::*;
use crate::correct::temperature_history_of;
use crate::simulate::motion::gyroscope_delay_s;

const GRAVITY_MPS2: f64 = 9.80665;

fn random_run(unit: &Unit, rate_hz: f64, seed: u64) -> Simulation {
    let program = Program::random(&RandomMoves::default(), 1).unwrap();
    simulate(&program, unit, rate_hz, GRAVITY_MPS2, seed).unwrap()
}

/// Returns mean and standard deviation of (measured - ideal) for each axis of a simulated run.
fn error_statistics(measured: &[[f64; 3]], ideal: impl Fn(usize) -> Vector3<f64>) -> [(f64, f64); 3] {
    [0, 1, 2].map(|axis| {
        let errors: Vec<f64> = (0..measured.len()).map(|i| measured[i][axis] - ideal(i)[axis]).collect();
        let n = errors.len() as f64;
        let mean = errors.iter().sum::<f64>() / n;
        let variance = errors.iter().map(|error| (error - mean).powi(2)).sum::<f64>() / n;
        (mean, variance.sqrt())
    })
}

#[test]
fn an_ideal_unit_says_the_truth() {
    let run = random_run(&Unit::ideal(), 100.0, 1);
    assert_eq!(run.specific_force, run.true_specific_force);
    assert_eq!(run.angular_rate, run.true_angular_rate);
    for force in &run.true_specific_force {
        assert!((Vector3::from(*force).norm() - GRAVITY_MPS2).abs() < 1e-13);
    }
    assert_eq!(run.recording("run").len(), 32_000);
}

/// Integration by the midpoint rule has an error of second order. The error must therefore be small, and it must be a
/// quarter as large at twice the sampling rate.
#[test]
fn integrating_the_true_rate_gives_the_attitude() {
    let error_rad = |rate_hz: f64| {
        let program = Program::random(&RandomMoves { moves: 5, ..RandomMoves::default() }, 2).unwrap();
        // The run is sampled at twice the rate `rate_hz` of the integration, so that every second sample is the
        // midpoint of an integration step.
        let run = simulate(&program, &Unit::ideal(), 2.0 * rate_hz, GRAVITY_MPS2, 0).unwrap();
        let stand_rad = run.stand_rad.as_ref().unwrap();
        let mut attitude = UnitQuaternion::identity();
        let mut worst = 0.0_f64;
        for i in (0..run.time_s.len() - 2).step_by(2) {
            attitude *= UnitQuaternion::from_scaled_axis(Vector3::from(run.true_angular_rate[i + 1]) / rate_hz);
            let truth = gimbal::rotation_world_from_body(&stand_rad[i + 2].into());
            worst = worst.max(attitude.angle_to(&truth));
        }
        worst
    };
    let (coarse, fine) = (error_rad(1000.0), error_rad(2000.0));
    assert!(fine < 1e-5, "{fine} rad");
    assert!((coarse / fine - 4.0).abs() < 0.1, "{coarse} rad, {fine} rad");
}

#[test]
fn measured_is_sensitivity_times_true_plus_bias_plus_noise_of_the_stated_size() {
    let mut unit = Unit::paper();
    unit.accelerometer.converter = None;
    unit.gyroscope.converter = None;
    for rate_hz in [100.0, 400.0] {
        let run = random_run(&unit, rate_hz, 5);
        let n = run.time_s.len() as f64;
        for (sensor, measured, truth) in [
            (&unit.accelerometer, &run.specific_force, &run.true_specific_force),
            (&unit.gyroscope, &run.angular_rate, &run.true_angular_rate),
        ] {
            let std = sensor.noise_density * rate_hz.sqrt();
            let ideal = |i: usize| sensor.sensitivity * Vector3::from(truth[i]) + sensor.bias;
            for (mean, found) in error_statistics(measured, ideal) {
                assert!((found / std - 1.0).abs() < 5.0 / (2.0 * n).sqrt(), "{found}, not {std}");
                assert!(mean.abs() < 5.0 * std / n.sqrt());
            }
        }
    }
}

#[test]
fn noise_is_white_and_differs_between_channels() {
    let mut unit = Unit::ideal();
    unit.accelerometer.noise_density = 1.0;
    unit.gyroscope.noise_density = 1.0;
    let program = Program::try_new(vec![Step::hold(1000.0)]).unwrap();
    let run = simulate(&program, &unit, 100.0, GRAVITY_MPS2, 9).unwrap();
    let n = run.time_s.len();
    let channel = |c: usize| -> Vec<f64> {
        match c {
            0..=2 => (0..n).map(|i| run.specific_force[i][c] - run.true_specific_force[i][c]).collect(),
            _ => (0..n).map(|i| run.angular_rate[i][c - 3]).collect(),
        }
    };
    let channels: Vec<Vec<f64>> = (0..6).map(channel).collect();
    let correlation = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>() / (100.0 * n as f64);
    let bound = 5.0 / (n as f64).sqrt();
    for a in 0..6 {
        assert!(correlation(&channels[a], &channels[a][1..]).abs() < bound, "channel {a}");
        for b in 0..a {
            assert!(correlation(&channels[a], &channels[b]).abs() < bound, "channels {a} and {b}");
        }
    }
}

#[test]
fn same_seed_same_bytes() {
    let run = random_run(&Unit::paper(), 100.0, 11);
    assert_eq!(run, random_run(&Unit::paper(), 100.0, 11));
    assert_ne!(run.angular_rate, random_run(&Unit::paper(), 100.0, 12).angular_rate);
    // The noise of the gyroscope must not depend on the noise of the accelerometer.
    let mut quiet = Unit::paper();
    quiet.accelerometer = Sensor::ideal();
    assert_eq!(run.angular_rate, random_run(&quiet, 100.0, 11).angular_rate);
}

#[test]
fn counts_are_whole_and_the_papers_run_does_not_clip() {
    let unit = Unit::paper();
    let run = random_run(&unit, 100.0, 3);
    for (sensor, measured) in [(unit.accelerometer, &run.specific_force), (unit.gyroscope, &run.angular_rate)] {
        let converter = sensor.converter.unwrap();
        let rail = 2_f64.powi(converter.bits as i32 - 1) - 1.0;
        for value in measured.as_flattened() {
            let counts = value / converter.lsb;
            assert!((counts - counts.round()).abs() < 1e-9);
            assert!(counts.abs() < rail);
        }
    }
}

#[test]
fn arguments_that_cannot_be_used_are_refused() {
    let program = Program::try_new(vec![Step::hold(1.0)]).unwrap();
    for rate_hz in [0.0, -1.0, f64::NAN, f64::INFINITY, 1e-9, 1e12] {
        assert!(simulate(&program, &Unit::ideal(), rate_hz, GRAVITY_MPS2, 0).is_err(), "{rate_hz} Hz");
    }
    for gravity_mps2 in [0.0, -9.8, f64::NAN] {
        assert!(simulate(&program, &Unit::ideal(), 100.0, gravity_mps2, 0).is_err(), "{gravity_mps2} m/s^2");
    }
}

/// Creates the setup of a simulated run at 100 Hz with this motion, unit and temperature, without faults.
fn hand_setup<'a>(motion: &'a Motion, unit: &'a Unit, temperature: &'a Temperature) -> Setup<'a> {
    Setup {
        motion,
        unit,
        rate_hz: 100.0,
        gravity_mps2: GRAVITY_MPS2,
        temperature,
        faults: Faults::none(),
        added: None,
        seed: 4,
        threads: None,
    }
}

fn hand_motion() -> Motion {
    let moves = HandMoves { poses: 6, tremor_rad: 1e-3, ..HandMoves::default() };
    Motion::Tumble(Tumble::random(&moves, 1).unwrap())
}

fn stand_motion() -> Motion {
    let program = Program::random(&RandomMoves { moves: 6, ..RandomMoves::default() }, 4).unwrap();
    let stand = Stand { base_tilt_rad: [0.01, -0.02], encoder_noise_rad: 1e-4, ..Stand::perfect() };
    Motion::Stand { program, stand }
}

fn warming() -> Temperature {
    Temperature::try_new(vec![0.0, 10.0, 30.0], vec![20.0, 35.0, 30.0]).unwrap()
}

/// The effect in its plain form, which is the form with the fewest parameters. Each parameter has its typical size.
fn typical(effect: &'static Effect<f64>) -> EffectValues<f64> {
    let values: Vec<f64> = effect.parameters[..effect.plain].iter().map(|parameter| parameter.typical).collect();
    EffectValues::try_new(effect, &values, effect.shape.map(|shape| shape.typical)).unwrap()
}

fn with_everything() -> Unit {
    let mut unit = Unit::paper();
    for sensor in [&mut unit.accelerometer, &mut unit.gyroscope] {
        sensor.bias_instability = 1e-3;
        sensor.random_walk = Vector3::new(1e-4, 2e-4, 3e-4);
        sensor.noise_in_motion = 2.0;
    }
    unit.gyroscope.low_pass = Some(LowPass { bandwidth_hz: 40.0 });
    unit.gyroscope.averaging = true;
    for name in ["gyro_g_sensitivity", "gyro_bias_warmup", "accel_lever_arm", "encoder_eccentricity"] {
        unit.effects.push(typical(Effect::find(name).unwrap())).unwrap();
    }
    unit
}

#[test]
fn each_effect_alone_is_what_the_calibration_says_of_the_true_state() {
    let temperature = warming();
    for motion in [hand_motion(), stand_motion()] {
        for effect in Effect::<f64>::catalogue() {
            let mut unit = Unit::paper();
            for sensor in [&mut unit.accelerometer, &mut unit.gyroscope] {
                (sensor.noise_density, sensor.converter) = (0.0, None);
            }
            let plain = run(&hand_setup(&motion, &unit, &temperature)).unwrap();
            unit.effects.push(typical(effect)).unwrap();
            let run = run(&hand_setup(&motion, &unit, &temperature)).unwrap();
            let triad = |sensor: &Sensor| Triad::try_new(sensor.sensitivity, sensor.bias).unwrap();
            let mut calibration = Calibration::new(triad(&unit.accelerometer), triad(&unit.gyroscope));
            calibration.effects = unit.effects;
            let memory = TemperatureMemory::new(&unit.effects);
            let history: Vec<_> = temperature_history_of(memory, &run.time_s, &run.temperature_degc).collect();
            for i in 0..run.time_s.len() {
                let state = State {
                    angular_rate: run.true_angular_rate[i].into(),
                    specific_force: run.true_specific_force[i].into(),
                    surroundings: Surroundings {
                        angular_acceleration: Some(run.true_angular_acceleration[i].into()),
                        mean_angular_acceleration: motion
                            .mean_angular_acceleration(run.time_s[i], gyroscope_delay_s(&unit.effects)),
                        rotation_world_from_body: so3::from_wxyz(run.rotation_world_from_body[i]),
                        temperature_difference_k: Some(run.temperature_degc[i] - REFERENCE_TEMPERATURE_DEGC),
                        temperature_history: Some(history[i]),
                        time_s: Some(run.time_s[i]),
                        stand: None,
                    },
                };
                let (rate, force) = calibration.measure(&state);
                assert!((Vector3::from(run.angular_rate[i]) - rate).norm() < 1e-14, "{} at sample {i}", effect.name);
                assert!((Vector3::from(run.specific_force[i]) - force).norm() < 1e-13, "{} at sample {i}", effect.name);
            }
            let on_unit = run.angular_rate != plain.angular_rate || run.specific_force != plain.specific_force;
            let on_encoders = run.stand_rad != plain.stand_rad;
            let is_encoders = effect.sensor == imucal_core::effects::Sensor::Encoder;
            assert_eq!(on_unit, !is_encoders, "{}", effect.name);
            assert_eq!(on_encoders, is_encoders && run.stand_rad.is_some(), "{}", effect.name);
        }
    }
}

#[test]
fn truth_of_a_run_is_that_of_its_motion() {
    let (motion, unit, temperature) = (hand_motion(), Unit::ideal(), warming());
    let run = run(&hand_setup(&motion, &unit, &temperature)).unwrap();
    for (i, time_s) in run.time_s.iter().enumerate() {
        let moment = motion.at(*time_s);
        let force = moment.rotation_world_from_body.inverse() * (moment.acceleration + Vector3::z() * GRAVITY_MPS2);
        assert!((Vector3::from(run.true_specific_force[i]) - force).norm() < 1e-13);
        assert_eq!(Vector3::from(run.true_angular_rate[i]), moment.angular_rate);
        assert_eq!(Vector3::from(run.true_angular_acceleration[i]), moment.angular_acceleration);
        assert_eq!(run.rotation_world_from_body[i], so3::to_wxyz(&moment.rotation_world_from_body));
        assert_eq!(run.temperature_degc[i], temperature.at(*time_s));
    }
    assert_eq!((run.rests, run.stand_rad), (motion.rests(), None));
}

#[test]
fn the_same_bytes_on_any_number_of_threads() {
    let (unit, temperature) = (with_everything(), warming());
    let faults = Faults { missing_share: 0.01, duplicated_share: 0.02, clock_rate_error: 1e-3, clock_jitter_s: 1e-4 };
    for motion in [hand_motion(), stand_motion()] {
        let on = |threads| {
            let threads = NonZeroUsize::new(threads);
            run(&Setup { faults, threads, rate_hz: 1000.0, ..hand_setup(&motion, &unit, &temperature) }).unwrap()
        };
        let alone = on(1);
        assert!(alone.time_s.len() > 30_000);
        for threads in [0, 2, 3] {
            assert_eq!(alone, on(threads), "{threads} threads");
        }
    }
}
