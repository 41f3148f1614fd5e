//! IMU calibration.
pub mod check;
pub mod error;
pub mod lsq;
pub mod recording;
pub mod simulate;
