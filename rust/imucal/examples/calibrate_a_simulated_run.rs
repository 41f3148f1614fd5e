//! Simulates a run with the unit of the paper cited in `docs/model.md`, calibrates this unit from the run, and compares
//! the result with the true parameters.
//!
//! `cargo run --release -p imucal --example calibrate_a_simulated_run`

use imucal::calibrate::{Options, calibrate, parameter_values};
use imucal::error::Error;
use imucal::frame::Frame;
use imucal::simulate::{Program, RandomMoves, Unit, simulate};
use imucal_core::calibration::Calibration;
use imucal_core::sensor::Triad;

fn main() -> Result<(), Error> {
    let unit = Unit::paper();
    let (rate_hz, gravity_mps2, seed) = (200.0, 9.80665, 7);
    let program = Program::random(&RandomMoves::default(), seed)?;
    let run = simulate(&program, &unit, rate_hz, gravity_mps2, seed)?;

    // For measured data, use Recording::try_new("run", &time_s, &specific_force, &angular_rate)?
    let outcome = calibrate(&[run.recording("run")], &Options::default())?;

    let triad = |sensor: &imucal::simulate::Sensor| {
        Triad::try_new(sensor.sensitivity, sensor.bias).map_err(|error| Error::Input(error.to_string()))
    };
    let truth = Calibration::new(triad(&unit.accelerometer)?, triad(&unit.gyroscope)?);
    let truth = parameter_values(&truth, Frame::Symmetric);
    println!("{:<22} {:>12} {:>10} {:>12}", "parameter", "value", "1 sigma", "truth");
    for (i, name) in outcome.names.iter().enumerate() {
        let sigma = outcome.covariance[i][i].sqrt();
        println!("{name:<22} {:>12.6} {sigma:>10.1e} {:>12.6}", outcome.values[i], truth[i]);
    }
    let figures = outcome.figures;
    println!(
        "{} rests, {} moves: gravity {:.5} m/s^2 rms, its direction {:.3} deg rms per move",
        figures.rests, figures.moves, figures.gravity_norm_rms_mps2, figures.gravity_direction_rms_deg
    );
    let verdict = outcome.verdict();
    println!("verdict: {}", verdict.name());
    for reason in verdict.reasons() {
        println!("  {reason}");
    }
    Ok(())
}
