//! IMU calibration.
pub mod calibrate;
pub mod check;
pub mod error;
pub mod evaluate;
pub mod frame;
pub mod recording;
pub mod segment;
pub mod simulate;

mod accelerometer;
mod carry;
mod ellipsoid;
mod gyroscope;
mod kinematics;
mod lsq;
mod moves;
mod observability;
mod robust;
mod stats;
mod uncertainty;

pub use lsq::{FitReport, Termination};
