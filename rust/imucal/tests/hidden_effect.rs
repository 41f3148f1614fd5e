//! A search through the public interface: what it names, what it refuses, and that results depend on their arguments
//! alone.

#![allow(clippy::unwrap_used, reason = "a test")]

use imucal::calibrate::{Checked, EffectChoice, Options};
use imucal::gap::{GapOptions, Verdict, find_gap, search};
use imucal::recording::Recording;
use imucal::simulate::{Program, RandomMoves, Simulation, Unit, simulate};
use imucal_core::STANDARD_GRAVITY_MPS2;
use imucal_core::effects::{Effect, EffectValues};

const HIDDEN: &str = "gyro_g_sensitivity";
const VALUES: [f64; 9] = [2e-4, -1e-4, 0.0, 1e-4, 3e-4, -2e-4, 0.0, 1e-4, -3e-4];

/// A run with this effect, or without any.
fn run(effect: Option<&str>, seed: u64) -> Simulation {
    let mut unit = Unit::paper();
    if let Some(name) = effect {
        let values = EffectValues::try_new(Effect::find(name).unwrap(), &VALUES, None).unwrap();
        unit.effects.push(values).unwrap();
    }
    let program = Program::random(&RandomMoves::default(), seed).unwrap();
    simulate(&program, &unit, 100.0, STANDARD_GRAVITY_MPS2, seed).unwrap()
}

/// Without the angles of the stand.
fn by_itself<'a>(made: &'a Simulation, name: &'a str) -> Recording<'a> {
    Recording { stand_rad: None, ..made.recording(name) }
}

fn candidates() -> Vec<EffectChoice> {
    [HIDDEN, "accel_scale_quadratic"].map(|name| EffectChoice::plain(Effect::find(name).unwrap())).into()
}

#[test]
fn a_hidden_effect_is_named_and_its_values_are_found() {
    let (made, judges) = (run(Some(HIDDEN), 1), run(Some(HIDDEN), 2));
    let options = GapOptions { candidates: Some(candidates()), ..GapOptions::default() };
    let (run, control) = ([by_itself(&made, "run")], [by_itself(&judges, "control")]);
    let gap = find_gap(&run, &control, &Options::default(), &options).unwrap();
    assert_eq!(gap.verdict, Verdict::Named);
    let analysis = gap.analysis.unwrap();
    assert!(analysis.unseen.before > 3.0 && analysis.unseen.after < 1.5, "{:?}", analysis.unseen);
    let outcome = analysis.after.unwrap().outcome;
    assert_eq!(outcome.effects.len(), 1);
    for (k, value) in outcome.effects[0].values.iter().enumerate() {
        let sigma = outcome.covariance[21 + k][21 + k].sqrt();
        assert!((value - VALUES[k]).abs() < 4.0 * sigma, "{k}: {value} +- {sigma}");
    }
}

#[test]
fn a_clean_unit_misses_nothing_and_without_a_control_record_moves_are_held_out() {
    let made = run(None, 3);
    let options = GapOptions { candidates: Some(candidates()), ..GapOptions::default() };
    let gap = find_gap(&[by_itself(&made, "run")], &[], &Options::default(), &options).unwrap();
    assert_eq!(gap.verdict, Verdict::NothingMissing);
    let analysis = gap.analysis.unwrap();
    assert!(analysis.after.is_none() && analysis.before.outcome.held_out.is_some());
}

#[test]
fn recordings_with_faults_are_a_verdict_of_their_own() {
    let mut made = run(None, 4);
    made.angular_rate[5000][1] = f64::NAN;
    let gap = find_gap(&[by_itself(&made, "run")], &[], &Options::default(), &GapOptions::default()).unwrap();
    assert_eq!((gap.verdict, gap.analysis.is_none()), (Verdict::DataFault, true));
    assert_eq!(gap.faults[0].code, "non_finite");
}

#[test]
fn a_calibration_does_not_depend_on_an_earlier_search() {
    let made = run(Some(HIDDEN), 5);
    let recordings = [by_itself(&made, "run")];
    let options = Options { effects: candidates()[..1].to_vec(), ..Options::default() };
    let fresh = Checked::try_new(&recordings, &options).unwrap();
    let before = fresh.calibrate(&options.model(), None).unwrap();
    let searched = Checked::try_new(&recordings, &options).unwrap();
    search(&searched, &candidates(), &[], false).unwrap();
    let after = searched.calibrate(&options.model(), None).unwrap();
    assert_eq!((before.values, before.covariance), (after.values, after.covariance));
}
