//! Every effect, simulated alone and without noise, comes back.

use imucal_core::effects::{Effect, EffectSet, EffectValues, Sensor, State, Surroundings};
use nalgebra::Vector3;

use super::EffectChoice;
use crate::calibrate::{Options, Outcome, calibrate};
use crate::error::Error;
use crate::recording::{REFERENCE_TEMPERATURE_DEGC, Recording};
use crate::simulate::motion::Motion;
use crate::simulate::stand::Stand;
use crate::simulate::{Program, RandomMoves, Unit};

struct Run {
    time_s: Vec<f64>,
    force: Vec<[f64; 3]>,
    rate: Vec<[f64; 3]>,
    temperature: Vec<f64>,
}

/// The paper's program and unit with one effect, 1 kHz, no noise, heated and cooled.
fn run(values: &EffectValues<f64>) -> Run {
    let program = Program::random(&RandomMoves::default(), 1).unwrap();
    let unit = Unit::paper();
    let mut effects = EffectSet::none();
    effects.push(*values).unwrap();
    let samples = (program.duration_s() * 1000.0) as usize;
    let motion = Motion::Stand { program, stand: Stand::perfect() };
    let mut run = Run { time_s: vec![], force: vec![], rate: vec![], temperature: vec![] };
    for i in 0..samples {
        let time_s = i as f64 / 1000.0;
        let moment = motion.at(time_s);
        let temperature_degc = 30.0 + 15.0 * (time_s / 50.0).sin();
        let state = State {
            angular_rate: moment.angular_rate,
            specific_force: moment.rotation_world_from_body.inverse() * Vector3::new(0.0, 0.0, 9.80665),
            surroundings: Surroundings {
                angular_acceleration: Some(moment.angular_acceleration),
                rotation_world_from_body: Some(moment.rotation_world_from_body),
                temperature_difference_k: Some(temperature_degc - REFERENCE_TEMPERATURE_DEGC),
                time_s: Some(time_s),
                stand: moment.stand,
            },
        };
        let (on_rate, on_force) = effects.at(&state);
        run.time_s.push(time_s);
        let seen = |sensor: &crate::simulate::Sensor, v: Vector3<f64>| (sensor.sensitivity * v + sensor.bias).into();
        run.force.push(seen(&unit.accelerometer, state.specific_force + on_force));
        run.rate.push(seen(&unit.gyroscope, state.angular_rate + on_rate));
        run.temperature.push(temperature_degc);
    }
    run
}

fn typical(effect: &'static Effect<f64>) -> EffectValues<f64> {
    let values: Vec<f64> = effect.parameters[..effect.plain]
        .iter()
        .enumerate()
        .map(|(k, parameter)| parameter.typical * if k % 2 == 0 { 1.0 } else { -0.7 })
        .collect();
    EffectValues::try_new(effect, &values, effect.shape.map(|_| 80.0)).unwrap()
}

fn estimate(run: &Run, effect: &'static Effect<f64>) -> Result<Outcome, Error> {
    let mut recording = Recording::try_new("run", &run.time_s, &run.force, &run.rate).unwrap();
    recording.temperature_degc = Some(&run.temperature);
    let options = Options { effects: vec![EffectChoice { effect, full: false }], ..Options::default() };
    calibrate(&[recording], &options)
}

#[test]
fn every_effect_comes_back() {
    for effect in Effect::<f64>::catalogue().filter(|effect| effect.sensor != Sensor::Encoder) {
        let truth = typical(effect);
        match estimate(&run(&truth), effect) {
            Err(error) => println!("{}: {error}", effect.name),
            Ok(outcome) => {
                let found = &outcome.effects[0];
                let size = truth.values().iter().fold(0.0f64, |m, v| m.max(v.abs()));
                let worst =
                    found.values.iter().zip(truth.values()).map(|(f, t)| (f - t).abs() / size).fold(0.0, f64::max);
                let shape = found.shape.map_or(0.0, |s| s / 80.0 - 1.0);
                println!(
                    "{}: {worst:.1e} shape {shape:.1e} its {} chi2 {:.1e}",
                    effect.name,
                    outcome.joint_fit.unwrap().iterations,
                    outcome.joint_fit.unwrap().chi2
                );
            }
        }
    }
}

#[test]
fn diagnose() {
    let effect = Effect::find("gyro_g_sensitivity").unwrap();
    let r = run(&typical(effect));
    let program = Program::random(&RandomMoves::default(), 1).unwrap();
    let recording = Recording::try_new("run", &r.time_s, &r.force, &r.rate).unwrap();
    let segments = crate::segment::Segments::find(&recording, 1.0).unwrap();
    println!("{:?}", segments.threshold);
    for (rest, (a, b)) in segments.rests.iter().zip(program.rests()).take(8) {
        println!(
            "{:.4} {:.4}  {:.1e} {:?}",
            rest.start_s - a,
            rest.end_s - b,
            rest.unsteadiness,
            rest.specific_force.variance_of_mean.map(f64::sqrt)
        );
    }
    let outcome = estimate(&r, effect).unwrap();
    for (m, rest) in outcome.moves.iter().zip(&outcome.rests).take(8) {
        println!("{:.2e} rad, {:.2e} m/s2", m.direction_error_deg.to_radians(), rest.norm_error_mps2);
    }
}
