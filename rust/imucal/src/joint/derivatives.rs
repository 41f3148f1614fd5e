//! Derivatives of the whitened residuals against central differences, for every kind of row and every kind of column.

use std::f64::consts::PI;

use faer::Mat;
use imucal_core::effects::{Effect, Sensor};
use nalgebra::Vector3;

use super::encoders::STAND_PARAMETERS;
use super::model::{BASE, Model};
use super::problem::{Joint, Prepared};
use super::terms::{EffectChoice, Kinds, Terms, UserField};
use crate::calibrate::{Options, prepare};
use crate::recording::Recording;
use crate::simulate::motion::Motion;
use crate::simulate::stand::Stand;
use crate::simulate::{Program, RandomMoves, Unit};

const RATE_HZ: f64 = 100.0;

/// A run of the paper's unit with warm-up, one field of a user, and the angles of a crooked stand.
struct Run {
    time_s: Vec<f64>,
    force: Vec<[f64; 3]>,
    rate: Vec<[f64; 3]>,
    temperature: Vec<f64>,
    stand: Vec<[f64; 3]>,
    field: Vec<f64>,
}

impl Run {
    fn new() -> Self {
        let program = Program::random(&RandomMoves { moves: 16, ..RandomMoves::default() }, 1).unwrap();
        let unit = Unit::paper();
        let stand = Stand { mount_rotation_rad: Vector3::new(0.02, -0.03, 0.05), ..Stand::perfect() };
        let samples = (program.duration_s() * RATE_HZ) as usize;
        let motion = Motion::Stand { program, stand };
        let mut run =
            Self { time_s: vec![], force: vec![], rate: vec![], temperature: vec![], stand: vec![], field: vec![] };
        for i in 0..samples {
            let time_s = i as f64 / RATE_HZ;
            let moment = motion.at(time_s);
            let force = moment.rotation_world_from_body.inverse() * Vector3::new(0.0, 0.0, 9.80665);
            let seen =
                |sensor: &crate::simulate::Sensor, v: Vector3<f64>| (sensor.sensitivity * v + sensor.bias).into();
            run.time_s.push(time_s);
            run.force.push(seen(&unit.accelerometer, force));
            run.rate.push(seen(&unit.gyroscope, moment.angular_rate));
            run.temperature.push(25.0 + 15.0 * (time_s / 40.0).sin());
            run.stand.push(moment.stand.unwrap().angle_rad.into());
            run.field.extend((0..3).map(|axis| (time_s / 20.0 + PI / 2.0 * f64::from(axis)).sin()));
        }
        run
    }
}

/// The whole catalogue and a user's field in one fit.
fn with_all(kinds: Kinds, work: impl FnOnce(&Prepared<'_>, &Terms<'_>, Vec<f64>)) {
    let run = Run::new();
    let mut recording = Recording::try_new("run", &run.time_s, &run.force, &run.rate).unwrap();
    recording.temperature_degc = Some(&run.temperature);
    recording.stand_rad = Some(&run.stand);
    let effects: Vec<EffectChoice> = Effect::catalogue().map(|effect| EffectChoice { effect, full: true }).collect();
    let fields = [UserField { name: "own", sensor: Sensor::Gyroscope, typical: vec![1e-3], columns: vec![&run.field] }];
    let terms = Terms::try_new(&effects, &fields, &[run.time_s.len()], kinds).unwrap();
    prepare(&[recording], &Options::default(), kinds, |prepared, accelerometer, gyroscope| {
        let model = Model {
            accelerometer: *accelerometer,
            gyroscope: *gyroscope,
            values: super::start_values(&terms),
            stand: super::start_stand(prepared, accelerometer),
        };
        work(prepared, &terms, model.parameters());
        Ok(())
    })
    .unwrap();
}

/// The largest error of each column against a central difference, as a share of the column's largest entry.
///
/// Steps change a whitened residual by one at most, or an effect by its typical size.
fn errors(problem: &Joint<'_>, parameters: &[f64]) -> Vec<f64> {
    let jacobian = problem.whitened(parameters).unwrap().1;
    let at = |p: usize, step: f64| {
        let mut changed = parameters.to_vec();
        changed[p] += step;
        problem.whitened(&changed).unwrap().0
    };
    let largest = |m: &Mat<f64>, column: usize| (0..m.nrows()).map(|i| m[(i, column)].abs()).fold(0.0, f64::max);
    (0..parameters.len())
        .map(|p| {
            let size = largest(&jacobian, p);
            if size == 0.0 {
                // Without its effect a time constant does nothing; a difference has to agree.
                return largest(&(at(p, 1.0) - at(p, -1.0)), 0);
            }
            let step = 1.0 / size;
            let difference = (at(p, step) - at(p, -step)) / (2.0 * step);
            let errors = (0..jacobian.nrows()).map(|i| (difference[(i, 0)] - jacobian[(i, p)]).abs());
            errors.fold(0.0, f64::max) / size
        })
        .collect()
}

fn name(terms: &Terms<'_>, p: usize) -> String {
    if p < BASE {
        return format!("base {p}");
    }
    let names: Vec<String> = terms.all.iter().flat_map(|term| term.parameter_names()).collect();
    names.get(p - BASE).cloned().unwrap_or_else(|| format!("stand {}", p - BASE - names.len()))
}

#[test]
fn derivatives_meet_central_differences() {
    for in_motion in [false, true] {
        for encoders in [false, true] {
            with_all(Kinds { in_motion, encoders }, |prepared, terms, parameters| {
                let problem = Joint::new(prepared, terms, &parameters).unwrap();
                let extra = if encoders { STAND_PARAMETERS } else { 0 };
                assert_eq!(parameters.len(), BASE + terms.count + extra);
                for (p, error) in errors(&problem, &parameters).into_iter().enumerate() {
                    println!("{in_motion} {encoders} {}: {error:.1e}", name(terms, p));
                }
            });
        }
    }
}
