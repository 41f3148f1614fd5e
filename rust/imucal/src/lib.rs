//! Calibration of MEMS accelerometers and gyroscopes with gravity as the only reference.
//!
//! The unit is turned by a cheap stand, or by hand, and held still in many poses. At rest the accelerometer must read
//! gravity: an ellipsoid fit gives its nine parameters. Between two rests the integrated gyroscope must carry the first
//! direction of gravity to the second: that gives its twelve. A control recording that no fit has seen judges both.
//!
//! ```text
//! measured = sensitivity * true + bias
//! ```
//!
//! ```
//! use imucal::calibrate::{Options, calibrate};
//! use imucal::simulate::{Program, RandomMoves, Unit, simulate};
//!
//! # fn main() -> Result<(), imucal::error::Error> {
//! let program = Program::random(&RandomMoves::default(), 1)?;
//! let run = simulate(&program, &Unit::paper(), 100.0, 9.80665, 1)?;
//! let result = calibrate(&[run.recording("run")], &Options::default())?;
//!
//! for (i, name) in result.names.iter().enumerate() {
//!     println!("{name:24} {:12.6} +- {:.1e}", result.values[i], result.covariance[i][i].sqrt());
//! }
//! assert!(result.figures.gravity_direction_rms_deg < 0.1);
//! # Ok(())
//! # }
//! ```
//!
//! The path of the data: a [`recording`] is [checked](check), its rests are found ([`rests`]), both triads are fitted
//! ([`mod@calibrate`]), and the result is judged on other recordings ([`mod@evaluate`]). [`mod@simulate`] makes recordings
//! with a known truth. Equation numbers in the sources refer to docs/model.md.
//!
//! What this crate does not do: it reads and writes no files and plots nothing (the Python package does), and it does not
//! run on the device (`imucal-core` does).

pub mod calibrate;
pub mod check;
pub mod correct;
pub mod error;
pub mod evaluate;
pub mod finding;
pub mod frame;
pub mod gap;
pub mod joint;
pub mod noise;
pub mod numerics;
mod parameters;
pub mod plan;
#[doc(hidden)] // for the benchmark of the kernels
pub mod preintegration;
pub mod recording;
pub mod rests;
pub mod simulate;
mod two_stage;

pub use numerics::lsq::{FitReport, Termination};
