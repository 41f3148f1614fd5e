//! Duration of a complete calibration: checks, rests, two-stage and joint fit, covariance
//! (`cargo bench --bench calibrate`).

use std::hint::black_box;
use std::process::ExitCode;

use criterion::Criterion;
use imucal::calibrate::{Options, calibrate};
use imucal::error::Error;
use imucal::simulate::{Program, RandomMoves, Unit, simulate};

fn bench(criterion: &mut Criterion) -> Result<(), Error> {
    let program = Program::random(&RandomMoves::default(), 1)?;
    let run = simulate(&program, &Unit::paper(), 200.0, 9.80665, 1)?;
    let recordings = [run.recording("run")];
    let options = Options::default();
    calibrate(&recordings, &options)?;
    criterion.bench_function("calibrate 320 s at 200 Hz", |b| {
        b.iter(|| calibrate(black_box(&recordings), &options).map(|outcome| outcome.values));
    });
    Ok(())
}

fn main() -> ExitCode {
    let mut criterion = Criterion::default().configure_from_args();
    match bench(&mut criterion) {
        Ok(()) => criterion.final_summary(),
        Err(error) => {
            eprintln!("{error}");
            return ExitCode::FAILURE;
        }
    }
    ExitCode::SUCCESS
}
