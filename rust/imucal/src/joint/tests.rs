//! Tests of the joint fit with simulated data. An effect in data without noise must be either estimated correctly or
//! refused with the reason. A coarsely quantised accelerometer axis must not prevent a good fit.

use imucal_core::calibration::Calibration;
use imucal_core::effects::{Effect, EffectSet, EffectValues, State, Surroundings};
use imucal_core::sensor::Triad;
use nalgebra::Vector3;

use super::EffectChoice;
use crate::calibrate::{Options, Outcome, calibrate, parameter_values};
use crate::error::Error;
use crate::frame::Frame;
use crate::numerics::lsq::Termination;
use crate::recording::{REFERENCE_TEMPERATURE_DEGC, Recording};
use crate::simulate::motion::{Motion, gyroscope_delay_s};
use crate::simulate::stand::Stand;
use crate::simulate::{Program, RandomMoves, Simulation, Unit, simulate};

/// True parameters of the stand, rad: mount rotation (3), base tilt (2), non-orthogonality of the axes (2), and zero of
/// the second motor (1).
pub(super) const STAND_RAD: [f64; 8] = [0.02, -0.03, 0.05, 0.01, -0.02, 0.005, -0.003, 0.004];

/// Samples of a simulated unit without noise, on a stand with geometric errors and with a varying temperature.
pub(super) struct Run {
    pub(super) time_s: Vec<f64>,
    pub(super) force: Vec<[f64; 3]>,
    pub(super) rate: Vec<[f64; 3]>,
    pub(super) temperature: Vec<f64>,
    pub(super) stand: Vec<[f64; 3]>,
}

impl Run {
    pub(super) fn new(moves: &RandomMoves, rate_hz: f64, effects: &EffectSet<f64>) -> Self {
        let program = Program::random(moves, 1).unwrap();
        let unit = Unit::paper();
        let samples = (program.duration_s() * rate_hz) as usize;
        let stand = Stand {
            mount_rotation_rad: Vector3::from_column_slice(&STAND_RAD[..3]),
            base_tilt_rad: [STAND_RAD[3], STAND_RAD[4]],
            non_orthogonality_rad: [STAND_RAD[5], STAND_RAD[6]],
            ..Stand::perfect()
        };
        let motion = Motion::Stand { program, stand: stand.clone() };
        let mut run = Self { time_s: vec![], force: vec![], rate: vec![], temperature: vec![], stand: vec![] };
        for i in 0..samples {
            let time_s = i as f64 / rate_hz;
            let moment = motion.at(time_s);
            let temperature_degc = 30.0 + 15.0 * (time_s / 50.0).sin();
            let state = State {
                angular_rate: moment.angular_rate,
                specific_force: moment.rotation_world_from_body.inverse() * Vector3::new(0.0, 0.0, 9.80665),
                surroundings: Surroundings {
                    angular_acceleration: Some(moment.angular_acceleration),
                    mean_angular_acceleration: motion.mean_angular_acceleration(time_s, gyroscope_delay_s(effects)),
                    rotation_world_from_body: Some(moment.rotation_world_from_body),
                    temperature_difference_k: Some(temperature_degc - REFERENCE_TEMPERATURE_DEGC),
                    temperature_history: None,
                    time_s: Some(time_s),
                    stand: moment.stand,
                },
            };
            let (on_rate, on_force) = effects.at(&state);
            run.time_s.push(time_s);
            let seen =
                |sensor: &crate::simulate::Sensor, v: Vector3<f64>| (sensor.sensitivity * v + sensor.bias).into();
            run.force.push(seen(&unit.accelerometer, state.specific_force + on_force));
            run.rate.push(seen(&unit.gyroscope, state.angular_rate + on_rate));
            run.temperature.push(temperature_degc);
            // The encoder of the second motor counts the angle from its own zero. Its errors also depend on the angle
            // from this zero.
            let mut angles = moment.stand.unwrap();
            angles.angle_rad.y -= STAND_RAD[7];
            run.stand.push(stand.read_encoders(&angles, effects, Vector3::zeros()).into());
        }
        run
    }

    pub(super) fn recording(&self) -> Recording<'_> {
        let mut recording = Recording::try_new("run", &self.time_s, &self.force, &self.rate).unwrap();
        recording.temperature_degc = Some(&self.temperature);
        recording.stand_rad = Some(&self.stand);
        recording
    }
}

/// Simulates samples of random moves and rests on the stand with one effect, at 1 kHz. The motion is the gyroscope
/// program of the paper cited in docs/model.md.
fn run(values: &EffectValues<f64>) -> Run {
    let mut effects = EffectSet::none();
    effects.push(*values).unwrap();
    Run::new(&RandomMoves::default(), 1000.0, &effects)
}

fn typical(effect: &'static Effect<f64>, count: usize) -> EffectValues<f64> {
    let values: Vec<f64> = effect.parameters[..count]
        .iter()
        .enumerate()
        .map(|(k, parameter)| parameter.typical * if k % 2 == 0 { 1.0 } else { -0.7 })
        .collect();
    EffectValues::try_new(effect, &values, effect.shape.map(|_| 80.0)).unwrap()
}

fn estimate(run: &Run, effect: &'static Effect<f64>, full: bool) -> Result<Outcome, Error> {
    let options = Options {
        effects: vec![if full { EffectChoice::full(effect) } else { EffectChoice::plain(effect) }],
        ..Options::default()
    };
    calibrate(&[run.recording()], &options)
}

/// Largest error of the linear parameters divided by the largest parameter, and the relative error of the shape
/// parameter (a time constant).
fn errors(outcome: &Outcome, truth: &EffectValues<f64>) -> (f64, f64) {
    let found = &outcome.effects[0];
    let size = truth.values().iter().fold(0.0, |largest: f64, v| largest.max(v.abs()));
    let pairs = found.values.iter().zip(truth.values());
    let values = pairs.map(|(found, truth)| (found - truth).abs() / size).fold(0.0, f64::max);
    let shape = found.shape.zip(truth.shape()).map_or(0.0, |(found, truth)| (found / truth - 1.0).abs());
    (values, shape)
}

/// Tests one effect of each of four kinds: on the gyroscope, with a time constant, on the force inside moves, and on
/// the encoders. The Python tests cover the whole catalogue.
#[test]
fn effects_come_back() {
    for name in ["gyro_g_sensitivity", "accel_bias_warmup", "accel_size_effect", "encoder_eccentricity"] {
        let effect = Effect::find(name).unwrap();
        let truth = typical(effect, effect.parameters.len());
        let (values, shape) = errors(&estimate(&run(&truth), effect, true).unwrap(), &truth);
        assert!(values < 1e-5 && shape < 1e-5, "{name}: {values:e} {shape:e}");
    }
}

/// At rest, the squares of the three force components add up to g^2. For each of the three rate components, equal
/// coefficients of these squares are therefore equivalent to a bias. Only forces with a norm other than g would
/// distinguish them from a bias, and a stand does not produce such forces.
#[test]
fn what_a_stand_does_not_show_is_refused_with_the_reason() {
    let effect = Effect::find("gyro_g2_sensitivity").unwrap();
    let error = estimate(&run(&typical(effect, effect.plain)), effect, false).unwrap_err();
    let Error::NotEnoughMotion(message) = error else { panic!("{error}") };
    assert!(message.starts_with("3 of 9 directions of gyro_g2_sensitivity"), "{message}");
    assert!(message.contains("gyro_bias is told apart by forces far from g"), "{message}");
}

#[test]
fn an_effect_needs_its_columns() {
    let r = run(&typical(Effect::find("gyro_bias_drift").unwrap(), 3));
    let recording = Recording::try_new("run", &r.time_s, &r.force, &r.rate).unwrap();
    for (name, column) in [("accel_bias_temperature", "temp_degc"), ("encoder_backlash", "stand_1")] {
        let effects = vec![EffectChoice::plain(Effect::find(name).unwrap())];
        let error = calibrate(&[recording], &Options { effects, ..Options::default() }).unwrap_err();
        assert!(matches!(&error, Error::Input(message) if message.contains(column)), "{error}");
    }
}

/// Simulates runs, changes one accelerometer axis, and requires three properties of the joint fit: it converges, it
/// does not increase the standard deviations far above the noise, and its estimates agree with the truth.
fn require_good_with_one_changed_axis(change: impl Fn(&mut Simulation, usize)) {
    let unit = Unit::paper();
    let triad = |sensor: &crate::simulate::Sensor| Triad::try_new(sensor.sensitivity, sensor.bias).unwrap();
    let truth = Calibration::new(triad(&unit.accelerometer), triad(&unit.gyroscope));
    let truth = parameter_values(&truth, Frame::Symmetric);
    for (seed, axis) in (1..5).flat_map(|seed| [0, 1, 2].map(|axis| (seed, axis))) {
        let program = Program::random(&RandomMoves::default(), seed).unwrap();
        let mut run = simulate(&program, &unit, 100.0, 9.80665, seed).unwrap();
        change(&mut run, axis);
        let found = calibrate(&[run.recording("run")], &Options::default()).unwrap();
        let (scales, report) = (found.joint_scales.unwrap(), found.joint_fit.unwrap());
        assert_eq!(report.termination, Termination::Converged, "seed {seed}, axis {axis}: {report:?}");
        assert!(scales.norms < 4.0 && scales.moves < 4.0, "seed {seed}, axis {axis}: {scales:?}");
        for (p, (value, truth)) in found.values.iter().zip(truth).enumerate() {
            let error = (value - truth) / found.covariance[p][p].sqrt();
            assert!(error.abs() < 5.0, "seed {seed}, axis {axis}, {}: {error:.1} sigma", found.names[p]);
        }
    }
}

/// One axis of the accelerometer is quantised coarsely. Its rounding error affects the norm and the gravity direction
/// of a rest. The whitening removes this common error only if the standard deviation of the error is increased by the
/// same factor in both residuals.
#[test]
fn one_coarse_accelerometer_axis_leaves_a_good_fit() {
    for step in [0.1, 0.2, 0.3] {
        require_good_with_one_changed_axis(|run, axis| {
            run.specific_force.iter_mut().for_each(|force| force[axis] = (force[axis] / step).round() * step);
        });
    }
}
