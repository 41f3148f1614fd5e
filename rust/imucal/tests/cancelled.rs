//! A cancelled calculation returns an error, and a later one is not affected.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test")]

use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicUsize, Ordering};

use imucal::calibrate::{Options, calibrate};
use imucal::cancellation::Cancellation;
use imucal::check::check_columns;
use imucal::error::Error;
use imucal::evaluate::evaluate;
use imucal::gap::{GapOptions, Progress, find_gap};
use imucal::noise;
use imucal::plan::{Axis, Goal, Limits, Search, Sensors, optimal};
use imucal::rests::Segments;
use imucal::simulate::{Program, RandomMoves, Simulation, Unit, simulate};

const GRAVITY_MPS2: f64 = 9.80665;

fn run() -> Simulation {
    let program = Program::random(&RandomMoves { moves: 20, ..RandomMoves::default() }, 1).unwrap();
    simulate(&program, &Unit::paper(), 50.0, GRAVITY_MPS2, 1).unwrap()
}

fn limits() -> Limits {
    let axis = Axis { max_rate_radps: 2.0, max_acceleration_radps2: 5.0, range_rad: None };
    Limits {
        axes: [Some(axis); 3],
        settle_s: 0.1,
        min_rest_s: 1.0,
        min_move_s: 0.5,
        forbidden: Vec::new(),
        pose_step_rad: 0.1,
        most_moves: 100,
        in_hand: false,
    }
}

fn ends_at_once<T>(name: &str, work: impl FnOnce() -> Result<T, Error>) {
    let cancellation = Cancellation::new();
    cancellation.cancel();
    match cancellation.run(work) {
        Err(Error::Cancelled) => {}
        Err(error) => panic!("{name}: {error}"),
        Ok(_) => panic!("{name} was not cancelled"),
    }
}

#[test]
fn every_calculation_can_be_cancelled() {
    let simulation = run();
    let recordings = [simulation.recording("run")];
    let options = Options::default();
    let unit = Unit::paper();
    let program = Program::random(&RandomMoves::default(), 1).unwrap();
    let outcome = calibrate(&recordings, &options).unwrap();
    let still = noise::Options { min_rest_s: 1.0, cut_steps: false };
    let search = Search { goal: Goal::MostIn { duration_s: 300.0 }, seed: 1, proposals: 1 << 40 };
    ends_at_once("simulate", || simulate(&program, &unit, 100.0, GRAVITY_MPS2, 1));
    ends_at_once("check", || Ok(check_columns(&recordings[0])));
    ends_at_once("rests", || {
        check_columns(&recordings[0]);
        Segments::find(&recordings[0], 1.0)
    });
    ends_at_once("calibrate", || calibrate(&recordings, &options));
    ends_at_once("evaluate", || evaluate(&outcome.calibration, None, &recordings, GRAVITY_MPS2, 1.0));
    ends_at_once("gap", || find_gap(&recordings, &[], &options, &GapOptions::default()));
    ends_at_once("noise", || noise::identify(&recordings[0], &still, NonZeroUsize::MIN));
    ends_at_once("plan", || optimal(&Sensors::of(&unit, 100.0, GRAVITY_MPS2), &limits(), &search));
    // Cancellation leaves nothing behind that a later calculation would see.
    let again = calibrate(&recordings, &options).unwrap();
    assert_eq!(again.values, outcome.values);
}

#[test]
fn a_search_ends_between_its_steps() {
    let simulation = run();
    let recordings = [simulation.recording("run")];
    let cancellation = Cancellation::new();
    let steps = AtomicUsize::new(0);
    let progress = |_: Progress<'_>| {
        if steps.fetch_add(1, Ordering::Relaxed) == 1 {
            cancellation.cancel();
        }
        Ok(())
    };
    let options = GapOptions { progress: Some(&progress), ..GapOptions::default() };
    let found = cancellation.run(|| find_gap(&recordings, &[], &Options::default(), &options));
    assert!(matches!(found, Err(Error::Cancelled)));
    assert_eq!(steps.load(Ordering::Relaxed), 2);
}
