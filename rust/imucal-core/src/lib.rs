//! The part of IMU calibration that runs on the device: `no_std`, no allocator, one dependency (nalgebra).
//!
//! An accelerometer measures specific force (m/s^2; a still one reads +g on the axis that points up), a gyroscope
//! measures angular rate (rad/s). Neither is perfect. Per triad this crate knows one linear model,
//!
//! ```text
//! measured = sensitivity * true + bias
//! ```
//!
//! with a 3x3 sensitivity that holds scale and misalignment, and its inverse, which is what the device applies:
//!
//! ```text
//! true = sensitivity^-1 * (measured - bias)
//! ```
//!
//! What a sensor does beyond that, such as a gyroscope that feels force, is in the catalogue of [`effects`].
//!
//! [`sensor`] is one triad, [`calibration`] is both with their effects, [`integrate`] turns corrected rates into a rotation,
//! [`rest`] finds the stretches in which the unit lies still, and [`so3`] has the rotations and says their conventions.
//! Everything is generic over the float: `f32` for a small processor, `f64` for the same numbers as on the desk.
//!
//! ```
//! use imucal_core::{calibration::Calibration, integrate::Integrator, sensor::Triad};
//! use nalgebra::{Matrix3, Vector3};
//!
//! // The constants come from a calibration file.
//! let accelerometer = Triad::try_new(Matrix3::identity(), Vector3::new(0.3, -0.1, 0.0))?;
//! let gyroscope = Triad::try_new(Matrix3::from_diagonal_element(0.98), Vector3::new(0.01, 0.0, 0.0))?;
//! let calibration = Calibration::new(accelerometer, gyroscope);
//!
//! // A turn about z at 1 rad/s for one second, sampled at 100 Hz.
//! let raw_rate = Vector3::new(0.01, 0.0, 0.98);
//! let raw_force = Vector3::new(0.3, -0.1, 9.80665);
//! let mut turn = Integrator::new();
//! for _ in 0..=100 {
//!     let (rate, _force) = calibration.correct(raw_rate, raw_force);
//!     turn.push(0.01, rate);
//! }
//! assert!((turn.rotation().angle() - 1.0_f64).abs() < 1e-12);
//! # Ok::<(), imucal_core::sensor::SensorError>(())
//! ```
//!
//! # What it does not do
//!
//! It does not estimate a calibration: that is the crate `imucal`, on a desk. It does not estimate attitude, position or a
//! running bias: it is no navigation filter. It does not check samples: a NaN that goes in comes out. It reads no files
//! and no clock; time steps are the caller's.
//!
//! # Features
//!
//! `std` (default) and `libm` only choose where square roots and sines come from. On a device use
//! `default-features = false, features = ["libm"]`.
#![no_std]

pub mod calibration;
pub mod effects;
pub mod integrate;
pub mod rest;
pub mod sensor;
pub mod so3;

/// Standard gravity, m/s^2: what datasheets mean by g.
pub const STANDARD_GRAVITY_MPS2: f64 = 9.80665;

/// Rate of the Earth against the stars, rad/s: that of WGS 84.
pub const EARTH_RATE_RADPS: f64 = 7.292115e-5;
