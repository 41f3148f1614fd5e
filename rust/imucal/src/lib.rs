//! IMU calibration.
pub mod error;
pub mod recording;
pub mod simulate;
