//! Tests how many times a calibration integrates the samples of its moves.

use super::*;
use crate::preintegration::STEPS_TAKEN;
use crate::simulate::{Program, RandomMoves, Unit, simulate};

/// Calibrates a simulated run with the two-stage fit, and then with the joint fit. Returns how many times each
/// calibration integrates the samples of all moves. The second number includes the two-stage fit from which the joint
/// fit starts.
fn passes(seed: u64) -> [f64; 2] {
    let program = Program::random(&RandomMoves::default(), seed).unwrap();
    let run = simulate(&program, &Unit::paper(), 100.0, 9.80665, seed).unwrap();
    [false, true].map(|joint| {
        STEPS_TAKEN.set(0);
        let outcome = calibrate(&[run.recording("run")], &Options { joint, ..Options::default() }).unwrap();
        let steps: usize = outcome.moves.iter().map(|m| m.last - m.first).sum();
        STEPS_TAKEN.get() as f64 / steps as f64
    })
}

#[test]
fn the_samples_are_read_three_times() {
    let all: Vec<[f64; 2]> = (1..=3).map(passes).collect();
    assert!(all.iter().all(|[two_stages, joint]| *two_stages <= 3.0 && *joint - *two_stages <= 3.0), "{all:?}");
}
