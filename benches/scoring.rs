//! Duration of scoring all candidate effects, compared with one integration pass over the same recording.
//!
//! The recording is that of gap_speed.py: the paper's run at 200 Hz, hand-held (A) and on a stand (A', where forces
//! inside moves are used). The duration of scoring is the difference between all candidates and none.
//! `cargo bench --bench scoring` prints the milliseconds of a pass and of scoring for each recording, separated by
//! tabs; gap_speed.py runs it for docs/results/speed.md.

use std::hint::black_box;
use std::process::ExitCode;
use std::time::Instant;

use imucal::calibrate::{Checked, EffectChoice, Options};
use imucal::error::Error;
use imucal::gap::{search, smallest_visible};
use imucal::preintegration::{RateSegment, SampleTimes};
use imucal::recording::{REFERENCE_TEMPERATURE_DEGC, Recording};
use imucal::simulate::{
    Faults, HandMoves, Motion, Program, RandomMoves, Setup, Simulation, Stand, Temperature, Tumble, Unit, run,
};
use imucal_core::effects::Effect;
use imucal_core::sensor::Triad;

const RATE_HZ: f64 = 200.0;
const HOLD_S: f64 = 5.26;
const MOVE_S: f64 = 2.03;
const MOVES: usize = 45;
const ROUNDS: usize = 25;

fn record(motion: &Motion) -> Result<Simulation, Error> {
    run(&Setup {
        motion,
        unit: &Unit::paper(),
        rate_hz: RATE_HZ,
        gravity_mps2: imucal::calibrate::STANDARD_GRAVITY_MPS2,
        temperature: &Temperature::constant(REFERENCE_TEMPERATURE_DEGC),
        faults: Faults::none(),
        added: None,
        seed: 1,
        threads: None,
    })
}

/// Rotation and sums over all samples, in as many segments as the run has moves.
fn pass(recording: &Recording<'_>, triad: &Triad<f64>) -> f64 {
    let length = recording.len() / MOVES;
    let of_segment = |k: usize| {
        let range = k * length..(k + 1) * length;
        RateSegment::linear(recording.angular_rate.slice(range.clone()), SampleTimes::Even(1.0 / RATE_HZ))
            .preintegrate(triad)
            .bias_sum
            .m11
    };
    (0..MOVES).map(of_segment).sum()
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Milliseconds of one pass, and of scoring all candidates relative to the model without effects.
fn times_ms(motion: &Motion) -> Result<[f64; 2], Error> {
    let made = record(motion)?;
    let mut recording = made.recording("run");
    recording.temperature_degc = None;
    recording.stand_rad = None;
    let recordings = [recording];
    let options = Options::default();
    let all: Vec<EffectChoice> = Effect::catalogue().map(EffectChoice::plain).collect();
    let checked = Checked::try_new(&recordings, &options)?;
    checked.calibrate(&options.model(), None)?;
    let is_hand_moved = search(&checked, &all, &[], false)?.is_hand_moved;
    let mut rounds: Vec<[f64; 3]> = Vec::new();
    for _ in 0..ROUNDS {
        let timed = |work: &dyn Fn() -> Result<(), Error>| {
            let start = Instant::now();
            work().map(|()| start.elapsed().as_secs_f64() * 1e3)
        };
        let scored = |candidates: &[EffectChoice]| {
            smallest_visible(&checked, candidates, is_hand_moved).map(|visible| drop(black_box(visible)))
        };
        let passed = || {
            black_box(pass(&recordings[0], &Triad::identity()));
            Ok(())
        };
        rounds.push([timed(&passed)?, timed(&|| scored(&[]))?, timed(&|| scored(&all))?]);
    }
    let of = |value: &dyn Fn(&[f64; 3]) -> f64| median(rounds.iter().map(value).collect());
    Ok([of(&|round| round[0]), of(&|round| round[2] - round[1])])
}

fn table() -> Result<(), Error> {
    let hand = HandMoves { poses: MOVES + 1, hold_s: HOLD_S, move_s: MOVE_S, ..HandMoves::default() };
    let moves = RandomMoves { moves: MOVES, hold_s: HOLD_S, move_s: MOVE_S, ..RandomMoves::default() };
    let kinds = [
        ("A", Motion::Tumble(Tumble::random(&hand, 1)?)),
        ("A'", Motion::Stand { program: Program::random(&moves, 1)?, stand: Stand::perfect() }),
    ];
    for (kind, motion) in &kinds {
        let [pass_ms, scoring_ms] = times_ms(motion)?;
        println!("{kind}\t{pass_ms:.4}\t{scoring_ms:.4}");
    }
    Ok(())
}

fn main() -> ExitCode {
    match table() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("{error}");
            ExitCode::FAILURE
        }
    }
}
