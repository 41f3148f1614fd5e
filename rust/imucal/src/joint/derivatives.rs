//! Tests that compare the derivatives of the whitened residuals with central differences, for every kind of residual
//! and every kind of parameter.

use std::sync::Arc;

use imucal_core::effects::{Effect, EffectSet, Need, Sensor};

use super::choices::{EffectChoice, Kinds, UserField};
use super::model::Model;
use super::prepared::Prepared;
use super::problem::Joint;
use super::terms::{Term, Terms};
use super::tests::{Run, STAND_RAD};
use crate::calibrate::prepare;
use crate::parameters::{BASE, GYRO_BIAS, GYRO_SENSITIVITY, STAND_PARAMETERS};
use crate::simulate::motion::Motion;
use crate::simulate::tumble::{HandMoves, Tumble};
use crate::simulate::{Faults, RandomMoves, Setup, Temperature, Unit};

/// Simulates a run without noise and calls `work` with the inputs of a fit to this run. The fit estimates `effects` in
/// their full forms (with all parameters) and one user-defined effect. The start values of all effects are zero, and
/// each time constant starts at its typical value.
fn with(effects: &[&str], kinds: Kinds, rate_hz: f64, work: impl FnOnce(&Prepared<'_>, &Terms<'_>, Vec<f64>)) {
    let run = Run::new(&RandomMoves { moves: 12, hold_s: 1.5, ..RandomMoves::default() }, rate_hz, &EffectSet::none());
    let wave = |time_s: &f64| [0.0, 1.0, 2.0].map(|phase| (3.0 * time_s + phase).sin());
    let field: Vec<f64> = run.time_s.iter().flat_map(wave).collect();
    let effects: Vec<EffectChoice> =
        effects.iter().map(|name| EffectChoice::full(Effect::find(name).unwrap())).collect();
    let fields = [UserField { name: "own", sensor: Sensor::Gyroscope, typical: vec![1e-3], columns: vec![&field] }];
    let terms = Terms::try_new(&effects, &fields, &[run.time_s.len()], kinds).unwrap();
    prepare(&[run.recording()], kinds, |prepared, accelerometer, gyroscope| {
        // The residuals of gravity directions are components along vectors that rotate with the measured gravity
        // direction. The Jacobian neglects this rotation, so its error is proportional to the residual. With the true
        // stand parameters, the residuals are small, and so is this error.
        let stand = if kinds.encoders { STAND_RAD.to_vec() } else { Vec::new() };
        let values = super::start::start_values(&terms);
        let model = Model { accelerometer: *accelerometer, gyroscope: *gyroscope, values, stand };
        work(prepared, &terms, model.parameters());
        Ok(())
    })
    .unwrap();
}

/// The derivatives of the residuals with respect to biases and sensitivities are correct for a simulated hand-held
/// unit.
#[test]
fn derivatives_in_a_hand_meet_central_differences() {
    let moves = HandMoves { poses: 15, tremor_rad: 0.05_f64.to_radians(), ..HandMoves::default() };
    let motion = Motion::Tumble(Tumble::random(&moves, 2).unwrap());
    let run = crate::simulate::run(&Setup {
        motion: &motion,
        unit: &Unit::paper(),
        rate_hz: 200.0,
        gravity_mps2: 9.80665,
        temperature: &Temperature::constant(25.0),
        faults: Faults::none(),
        added: None,
        seed: 3,
        threads: None,
    })
    .unwrap();
    let recording = run.recording("run");
    let kinds = Kinds { in_motion: false, encoders: false };
    let terms = Terms::try_new(&[], &[], &[recording.len()], kinds).unwrap();
    prepare(&[recording], kinds, |prepared, accelerometer, gyroscope| {
        assert!(prepared.rests.iter().all(|rest| rest.propagated.is_some()));
        let values = super::start::start_values(&terms);
        let model = Model { accelerometer: *accelerometer, gyroscope: *gyroscope, values, stand: Vec::new() };
        let problem = Joint::new(prepared, &terms, &model.parameters()).unwrap();
        check(&problem, &terms, &model.parameters(), |_| 2e-4);
        Ok(())
    })
    .unwrap();
}

/// The error of a Jacobian column is divided by the largest entry of the column, but at least by a lower limit. At this
/// limit, a change of the parameter by ten typical sizes changes a whitened residual by this value. Without the limit,
/// the relative error of a column near zero would be very large.
const SEEN: f64 = 1e-3;

/// For each parameter: the error of its column of the Jacobian. It is the largest entry of |column - central
/// difference|, divided by the largest entry of the column.
///
/// The step of the difference is limited: it changes a whitened residual by at most one, and is at most the typical
/// size of an effect's parameter.
fn errors(problem: &Joint<'_>, terms: &Terms<'_>, parameters: &[f64]) -> Vec<f64> {
    let jacobian = problem.whitened(parameters).unwrap().1;
    let at = |p: usize, step: f64| {
        let mut changed = parameters.to_vec();
        changed[p] += step;
        // The residuals are linearised again here. For nearby parameters, `problem.whitened` would return a first-order
        // update with unchanged derivatives.
        problem.whiten(&problem.prepared.linearise(terms, &changed).unwrap()).0
    };
    let typical: Vec<f64> = terms.all.iter().flat_map(Term::typical).collect();
    let largest = |values: &mut dyn Iterator<Item = f64>| values.map(f64::abs).fold(0.0, f64::max);
    (0..parameters.len())
        .map(|p| {
            let most = p.checked_sub(BASE).and_then(|k| typical.get(k).copied()).unwrap_or(f64::INFINITY);
            let size = largest(&mut (0..jacobian.nrows()).map(|i| jacobian[(i, p)])).max(SEEN / (10.0 * most));
            let step = (1.0 / size).min(most);
            let difference = (at(p, step) - at(p, -step)) / (2.0 * step);
            largest(&mut (0..jacobian.nrows()).map(|i| difference[(i, 0)] - jacobian[(i, p)])) / size
        })
        .collect()
}

fn name(terms: &Terms<'_>, p: usize) -> String {
    let names = terms.all.iter().flat_map(Term::parameter_names);
    let base = (0..BASE).map(|p| format!("base {p}"));
    base.chain(names).nth(p).unwrap_or_else(|| format!("stand {}", p - BASE - terms.count))
}

/// Asserts that the error of each Jacobian column p (see [`errors`]) is below `tolerance(p)`.
fn check(problem: &Joint<'_>, terms: &Terms<'_>, parameters: &[f64], tolerance: impl Fn(usize) -> f64) {
    for (p, error) in errors(problem, terms, parameters).into_iter().enumerate() {
        assert!(error < tolerance(p), "{:?} {}: {error:e}", terms.kinds, name(terms, p));
    }
}

/// Effects that are tested with all kinds of residuals.
const FEW: [&str; 4] = ["gyro_g_sensitivity", "earth_rate", "accel_scale_temperature", "accel_bias_warmup"];

/// If all effects are zero, the derivatives are accurate, except those of the attitudes inside moves relative to the
/// stand. These derivatives have larger errors, because they are evaluated only at the attitude of the stand in the
/// middle of a 40 ms block.
#[test]
fn derivatives_meet_central_differences() {
    const NONE: (bool, bool) = (false, false);
    let runs = [(NONE, 100.0), ((true, false), 100.0), ((false, true), 100.0), ((true, true), 100.0)];
    for ((in_motion, encoders), rate_hz) in runs.into_iter().chain([(NONE, 400.0), ((true, false), 400.0)]) {
        // Each effect is tested with the residuals that it needs. Effects of the encoders need encoders, and effects of
        // the angular acceleration need the force inside moves. All other effects are tested with rests and moves only.
        // The effects in `FEW` are tested with all kinds of residuals.
        let seen = |effect: &&'static Effect<f64>| {
            let own = match effect.sensor {
                Sensor::Encoder => encoders,
                _ if effect.needs.contains(&Need::AngularAcceleration) => in_motion,
                _ => !in_motion && !encoders,
            };
            own || FEW.contains(&effect.name)
        };
        let names: Vec<&str> = Effect::<f64>::catalogue().filter(seen).map(|effect| effect.name).collect();
        with(&names, Kinds { in_motion, encoders }, rate_hz, |prepared, terms, parameters| {
            let problem = Joint::new(prepared, terms, &parameters).unwrap();
            assert_eq!(parameters.len(), BASE + terms.count + if encoders { STAND_PARAMETERS } else { 0 });
            check(&problem, terms, &parameters, |p| {
                let stand = p >= BASE + terms.count;
                let encoder = |k: usize| terms.sensors[k] == Sensor::Encoder;
                let kinked = name(terms, p).starts_with("gyro_scale_asymmetry");
                match p.checked_sub(BASE) {
                    _ if stand => 0.03,
                    Some(k) if encoder(k) => 0.03,
                    // The derivative is evaluated in the middle of a segment. It does not resolve a sign change of the
                    // rate inside the segment, nor the instant at which the motors stop accelerating.
                    Some(_) if kinked || in_motion || encoders => 5e-4,
                    _ => 2e-4,
                }
            });
        });
    }
}

/// The residuals inside moves can be whitened move by move, or together with all other residuals in one matrix. Both
/// methods give the same values, also after a first-order update of the linearisation.
#[test]
fn what_stands_apart_is_whitened_alike() {
    let kinds = Kinds { in_motion: true, encoders: false };
    with(
        &["gyro_g_sensitivity", "accel_lever_arm", "encoder_time_offset"],
        kinds,
        100.0,
        |prepared, terms, parameters| {
            let problem = Joint::new(prepared, terms, &parameters).unwrap();
            let mut change = vec![0.0; parameters.len()];
            (change[GYRO_BIAS.start], change[BASE]) = (1e-4, 2e-5);
            let moved = {
                let changed: Vec<f64> = parameters.iter().zip(&change).map(|(p, by)| p + by).collect();
                let linear = prepared.linearise(terms, &parameters).unwrap();
                linear.moved(&change, Model::of(&changed, terms).unwrap())
            };
            for linear in [prepared.linearise(terms, &parameters).unwrap(), moved].map(Arc::new) {
                let (residual, jacobian) = problem.whiten(&linear);
                let (head, insides) = problem.whiten_apart(&linear);
                let insides = insides.unwrap();
                let (mut lanes, mut first) = (insides.no_rows().clone(), head.rows());
                for k in 0..insides.moves() {
                    insides.look(k, &mut lanes);
                    for p in 0..=parameters.len() {
                        for (i, number) in lanes.column(p).enumerate() {
                            let row = first + i;
                            let known = if p < parameters.len() { jacobian[(row, p)] } else { residual[(row, 0)] };
                            assert!(
                                (number - known).abs() <= 1e-12 * known.abs().max(1.0),
                                "{row} {p}: {number} {known}"
                            );
                        }
                    }
                    first += lanes.rows();
                }
                assert_eq!((first, first - head.rows()), (jacobian.nrows(), insides.rows()));
                let is_alike = |p: usize, known: &[f64]| head.column(p).zip(known).all(|(own, known)| own == *known);
                assert!(is_alike(0, jacobian.col_as_slice(0)) && is_alike(parameters.len(), residual.col_as_slice(0)));
            }
        },
    );
}

/// An effect is computed from the corrected rate and force, which depend on the parameters of the sensors. The Jacobian
/// neglects this dependence. The relative error of the Jacobian is therefore about as large as the derivative of the
/// effect with respect to the rate and the force. For a delay or a lever arm of typical size, the error is largest in
/// the columns of the gyroscope sensitivity. A change of the sensitivity changes the time derivative of the rate, on
/// which both effects depend, and the square of the rate, on which the effect of a lever arm also depends.
#[test]
fn derivatives_at_an_effect_leave_its_slope_out() {
    for name in [
        "gyro_g_sensitivity",
        "gyro_scale_cubic",
        "gyro_bias_warmup",
        "gyro_time_offset",
        "accel_scale_quadratic",
        "accel_bias_warmup",
        "accel_lever_arm",
        "encoder_time_offset",
    ] {
        let effect = Effect::find(name).unwrap();
        let kinds = Kinds::needed_by(&[EffectChoice::full(effect)]);
        with(&[name], kinds, 100.0, |prepared, terms, mut parameters| {
            for (k, typical) in terms.all[0].typical().into_iter().enumerate() {
                parameters[BASE + k] = if k % 2 == 0 { typical } else { -0.7 * typical };
            }
            if let Some(shape) = effect.shape {
                parameters[BASE + terms.all[0].linear] = 0.8 * shape.typical;
            }
            let problem = Joint::new(prepared, terms, &parameters).unwrap();
            let follows = |p: usize| kinds.in_motion && GYRO_SENSITIVITY.contains(&p);
            check(&problem, terms, &parameters, |p| if follows(p) { 0.5 } else { 0.05 });
        });
    }
}
