//! Where each parameter stands among all: accelerometer bias (3) and sensitivity (6, symmetric frame), gyroscope bias (3) and
//! sensitivity (9, row by row), then those of the terms, then those of the stand.

use std::ops::Range;

/// Number of base parameters.
pub(crate) const BASE: usize = 21;
pub(crate) const ACCEL: Range<usize> = 0..9;
pub(crate) const GYRO_BIAS: Range<usize> = 9..12;
pub(crate) const GYRO_SENSITIVITY: Range<usize> = 12..21;
/// Number of parameters of the stand, where it takes part: mount, tilt of the base, angles between its axes.
pub(crate) const STAND_PARAMETERS: usize = 7;
