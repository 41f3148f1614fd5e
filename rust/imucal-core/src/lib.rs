//! The part of IMU calibration that runs on a device. The crate is `no_std`, needs no allocator, and has one dependency
//! (nalgebra).
//!
//! An accelerometer measures specific force, m/s^2. At rest, it reads +g on the axis that points up. A gyroscope
//! measures angular rate, rad/s. Both have errors of bias, scale and misalignment. This crate describes a triad (the
//! three axes of a sensor) by a linear model:
//!
//! ```text
//! measured = sensitivity * true + bias
//! ```
//!
//! The 3x3 sensitivity contains scale and misalignment. The device applies the inverse model:
//!
//! ```text
//! true = sensitivity^-1 * (measured - bias)
//! ```
//!
//! The catalogue of [`effects`] describes errors that this model does not contain, for example the g-sensitivity of a
//! gyroscope.
//!
//! * [`sensor`] is the model of one triad.
//! * [`calibration`] combines the triads of both sensors and the effects.
//! * [`integrate`] integrates corrected rates to a rotation.
//! * [`rest`] detects the intervals in which the unit is at rest.
//! * [`stored`] reads a calibration from its binary form.
//! * [`temperature_memory`] computes the temperature history, on which some effects depend.
//! * [`so3`] contains functions for rotations, and defines the conventions of rotations.
//!
//! All types are generic over the float type. `f32` is suitable for a small processor, and `f64` gives the same results
//! as the crate `imucal` on a PC.
//!
//! ```
//! use imucal_core::{calibration::Calibration, integrate::Integrator, sensor::Triad};
//! use nalgebra::{Matrix3, Vector3};
//!
//! // In practice, the sensitivities and the biases (m/s^2 and rad/s) are read from a calibration file.
//! let accelerometer = Triad::try_new(Matrix3::identity(), Vector3::new(0.3, -0.1, 0.0))?;
//! let gyroscope = Triad::try_new(Matrix3::from_diagonal_element(0.98), Vector3::new(0.01, 0.0, 0.0))?;
//! let calibration = Calibration::new(accelerometer, gyroscope);
//!
//! // A turn about z at 1 rad/s for one second, sampled at 100 Hz. A raw sample is sensitivity * true value + bias.
//! let step_s = 0.01;
//! let raw_rate = Vector3::new(0.01, 0.0, 0.98);
//! let raw_force = Vector3::new(0.3, -0.1, 9.80665);
//! let mut turn = Integrator::new();
//! for _ in 0..=100 {
//!     let (rate, _force) = calibration.correct(raw_rate, raw_force);
//!     turn.push(step_s, rate);
//! }
//! assert!((turn.rotation().angle() - 1.0_f64).abs() < 1e-12);
//! # Ok::<(), imucal_core::sensor::SensorError>(())
//! ```
//!
//! # What this crate does not do
//!
//! This crate does not estimate a calibration; the crate `imucal` does this on a PC. It is not a navigation filter,
//! because it estimates no attitude, position or bias at run time. It does not check samples, so a NaN in the input
//! gives a NaN in the output. It reads no files and no clock; the caller passes the time steps.
//!
//! # Features
//!
//! * `std` (default) and `libm` select the implementation of mathematical functions such as square root and sine. On a
//!   device without `std` use `default-features = false, features = ["libm"]`.
//! * `catalogue` (default) adds the data and functions of the [`effects`] that only estimation, simulation and reports
//!   need: names, units and texts, lookup by name, the derivatives of an effect's error with respect to its parameters,
//!   and the effects on the encoders of a stand. A device does not need this feature. The code of a device refers to
//!   effects by constants such as `Effect::GYRO_G_SENSITIVITY`, so that only the effects of its calibration take
//!   memory.
//!
//! # Panics
//!
//! [`calibration::Calibration::correct`], [`integrate::Integrator::push`] and [`rest::RestDetector::push`] contain no
//! panic at any optimisation level if debug assertions are off. A test verifies this: it links the functions with a
//! panic handler that calls an undefined function, so linking fails if one of the functions can panic.
#![no_std]

#[cfg(test)]
extern crate std;

pub mod calibration;
pub mod effects;
pub mod integrate;
pub mod rest;
pub mod sensor;
pub mod so3;
pub mod stored;
mod vector;

pub use effects::temperature_memory;

/// Standard gravity, m/s^2. It is the unit g in datasheets.
pub const STANDARD_GRAVITY_MPS2: f64 = 9.80665;

/// Rotation rate of the Earth relative to the stars, rad/s, as in WGS 84.
pub const EARTH_RATE_RADPS: f64 = 7.292115e-5;
