//! The simulation as a whole.

use nalgebra::{UnitQuaternion, Vector3};

use super::*;

const GRAVITY_MPS2: f64 = 9.80665;

fn random_run(unit: &Unit, rate_hz: f64, seed: u64) -> Simulation {
    let program = Program::random(&RandomMoves::default(), 1).unwrap();
    simulate(&program, unit, rate_hz, GRAVITY_MPS2, seed).unwrap()
}

/// Mean and standard deviation of (measured - ideal) per axis.
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

/// Midpoint steps have an error of second order: it must be small, and a quarter at twice the rate.
#[test]
fn integrating_the_true_rate_gives_the_attitude() {
    let error_rad = |rate_hz: f64| {
        let program = Program::random(&RandomMoves { moves: 5, ..RandomMoves::default() }, 2).unwrap();
        // Twice the rate, so that every second sample is the midpoint of a step.
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
    // A channel's noise does not depend on the other sensor's.
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
