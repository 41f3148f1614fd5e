//! Simulates a unit with an effect, searches for the effect, and prints the verdict.
//!
//! `cargo run --release -p imucal --example find_a_hidden_effect`

use imucal::calibrate::{Options, STANDARD_GRAVITY_MPS2};
use imucal::error::Error;
use imucal::gap::{GapOptions, find_gap};
use imucal::recording::Recording;
use imucal::simulate::{Program, RandomMoves, Simulation, Unit, simulate};
use imucal_core::effects::{Effect, EffectValues};

/// The simulated effect is the sensitivity of the gyroscope to specific force. `VALUES` is its 3x3 matrix, row by row,
/// rad/s per m/s^2.
const HIDDEN: &str = "gyro_g_sensitivity";
const VALUES: [f64; 9] = [2e-4, -1e-4, 0.0, 1e-4, 3e-4, -2e-4, 0.0, 1e-4, -3e-4];
const RATE_HZ: f64 = 100.0;

fn record(unit: &Unit, seed: u64) -> Result<Simulation, Error> {
    simulate(&Program::random(&RandomMoves::default(), seed)?, unit, RATE_HZ, STANDARD_GRAVITY_MPS2, seed)
}

fn main() -> Result<(), Error> {
    let input = |error: &dyn std::fmt::Display| Error::Input(error.to_string());
    let effect = Effect::find(HIDDEN).ok_or_else(|| input(&HIDDEN))?;
    let mut unit = Unit::paper();
    let hidden = EffectValues::try_new(effect, &VALUES, None).map_err(|error| input(&error))?;
    unit.effects.push(hidden).map_err(|error| input(&error))?;

    // The angles of the stand are removed, because few users have a stand with encoders.
    let (run, control) = (record(&unit, 1)?, record(&unit, 2)?);
    let [run, control] =
        [run.recording("run"), control.recording("control")].map(|made| Recording { stand_rad: None, ..made });
    let gap = find_gap(&[run], &[control], &Options::default(), &GapOptions::default())?;

    println!("verdict: {}", gap.verdict.name());
    let Some(analysis) = gap.analysis else { return Ok(()) };
    println!("chi2 per degree of freedom on the control recording, without effects: {:.2}", analysis.unseen.before);
    println!("with the accepted effects: {:.2}", analysis.unseen.after);
    for score in &analysis.effects {
        println!("{}: log Bayes factor {:.0}", score.name, score.log_bayes_factor);
    }
    for estimate in analysis.after.iter().flat_map(|fit| &fit.outcome.effects) {
        for (name, value) in estimate.parameter_names.iter().zip(&estimate.values) {
            println!("{name:<24} {value:>10.2e}");
        }
    }
    Ok(())
}
