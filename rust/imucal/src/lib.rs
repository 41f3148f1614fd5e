//! Calibration of MEMS accelerometers and gyroscopes with gravity as the only reference.
//!
//! A cheap stand or a person turns the unit to many poses and holds it still in each pose. At rest, the norm of the
//! corrected specific force must equal gravity. This condition determines the nine parameters of the accelerometer.
//! Between two rests, the integrated gyroscope must propagate the direction of gravity from the first rest to the
//! second. This condition determines the twelve parameters of the gyroscope. A control recording that is not used in
//! any fit verifies the calibration of both sensors. Both sensors have a model of the following form, in which
//! `sensitivity` is a 3 x 3 matrix:
//!
//! ```text
//! measured = sensitivity * true + bias
//! ```
//!
//! ```
//! use imucal::calibrate::{Options, calibrate};
//! use imucal::verdict::Verdict;
//! use imucal::simulate::{Program, RandomMoves, Unit, simulate};
//!
//! # fn main() -> Result<(), imucal::error::Error> {
//! let (rate_hz, gravity_mps2, seed) = (100.0, 9.80665, 1);
//! let program = Program::random(&RandomMoves::default(), seed)?;
//! let run = simulate(&program, &Unit::paper(), rate_hz, gravity_mps2, seed)?;
//! let result = calibrate(&[run.recording("run")], &Options::default())?;
//!
//! for (i, name) in result.names.iter().enumerate() {
//!     println!("{name:24} {:12.6} +- {:.1e}", result.values[i], result.covariance[i][i].sqrt());
//! }
//! assert_eq!(result.verdict(), Verdict::Good);
//! assert!(result.figures.gravity_direction_rms_deg < 0.1);
//! # Ok(())
//! # }
//! ```
//!
//! Flow of data: a [`recording`] is [checked](check), its rests are detected ([`rests`]), the parameters of both
//! sensors are fitted ([`mod@calibrate`]), and the result is evaluated on other recordings ([`mod@evaluate`]).
//! [`mod@simulate`] generates recordings with known true parameters. Equation numbers in the sources refer to
//! docs/model.md.
//!
//! This crate does not read or write files and does not draw plots; the Python package does. The correction on a device
//! is in the crate `imucal-core`.

pub mod calibrate;
pub mod cancellation;
pub mod check;
pub mod correct;
pub mod error;
pub mod evaluate;
pub mod finding;
pub mod frame;
pub mod gap;
pub mod held;
pub mod joint;
pub mod noise;
pub mod number_columns;
pub mod numerics;
mod parameters;
pub mod plan;
#[doc(hidden)] // public only because two benchmarks, kernels.rs and scoring.rs, use it
pub mod preintegration;
pub mod recording;
pub mod rests;
mod rounding;
pub mod simulate;
mod two_stage;
pub mod verdict;

pub use numerics::fit_report::FitReport;
pub use numerics::lsq::Termination;
pub use rounding::Rounding;
