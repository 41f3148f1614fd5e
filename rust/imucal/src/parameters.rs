//! Order and names of the calibration parameters of an inertial measurement unit.
//!
//! The parameter vector contains, in this order: accelerometer bias (3 parameters), accelerometer sensitivity (6),
//! gyroscope bias (3), gyroscope sensitivity (9, row by row), parameters of the effects, and parameters of a stand with
//! encoders. In the symmetric body frame, the accelerometer sensitivity is a symmetric matrix, so it has six
//! parameters. In the triangular body frame, it is a lower triangular matrix, also with six parameters. An effect is a
//! sensor error that bias and sensitivity do not describe, for example a dependence on temperature.

use imucal_core::calibration::Calibration;
use std::ops::Range;

use crate::frame::{Frame, SYMMETRIC};

/// Number of base parameters: the biases and sensitivities of the accelerometer and the gyroscope.
pub(crate) const BASE: usize = 21;
pub(crate) const ACCEL: Range<usize> = 0..9;
pub(crate) const GYRO_BIAS: Range<usize> = 9..12;
pub(crate) const GYRO_SENSITIVITY: Range<usize> = 12..21;
/// Number of parameters of a stand with encoders: mount rotation (3), base tilt (2), angles between the axes (2), and
/// zero error (angle offset) of the second motor (1).
pub(crate) const STAND_PARAMETERS: usize = 8;

/// Readable names, for messages, of all base parameters except the gyroscope bias: the nine parameters of the
/// accelerometer in the symmetric frame, and the nine entries of the gyroscope sensitivity row by row. The gyroscope
/// bias is not included, because the mean rates at the rests determine it directly.
pub(crate) const WORDS: [&str; 18] = [
    "bias x",
    "bias y",
    "bias z",
    "scale x",
    "scale y",
    "scale z",
    "misalignment xy",
    "misalignment xz",
    "misalignment yz",
    "scale x",
    "misalignment xy",
    "misalignment xz",
    "misalignment yx",
    "scale y",
    "misalignment yz",
    "misalignment zx",
    "misalignment zy",
    "scale z",
];
pub(crate) const ACCELEROMETER: usize = 9;

/// Readable names of the nine parameters of the accelerometer or, if `gyroscope` is true, of the nine entries of the
/// gyroscope sensitivity.
pub(crate) fn words(gyroscope: bool) -> &'static [&'static str] {
    if gyroscope { &WORDS[ACCELEROMETER..] } else { &WORDS[..ACCELEROMETER] }
}

/// Readable names of the accelerometer parameters or, if `gyroscope` is true, of the entries of the gyroscope
/// sensitivity. Only parameters that affect the readings of the selected `axes` are returned.
pub(crate) fn of_axes(gyroscope: bool, axes: [bool; 3]) -> Vec<&'static str> {
    let acts = |j: usize| match j {
        _ if gyroscope => axes[j / 3],
        0..6 => axes[j % 3],
        _ => axes[SYMMETRIC[j - 3].0] || axes[SYMMETRIC[j - 3].1],
    };
    (0..9).filter(|&j| acts(j)).map(|j| words(gyroscope)[j]).collect()
}

/// Names of the 21 base parameters, in the order that the start of this file defines.
pub fn parameter_names(frame: Frame) -> [String; 21] {
    const AXES: [char; 3] = ['x', 'y', 'z'];
    let free = frame.free_entries();
    std::array::from_fn(|p| match p {
        0..3 => format!("accel_bias_{}", AXES[p]),
        3..9 => format!("accel_sensitivity_{}{}", AXES[free[p - 3].0], AXES[free[p - 3].1]),
        9..12 => format!("gyro_bias_{}", AXES[p - 9]),
        _ => format!("gyro_sensitivity_{}{}", AXES[(p - 12) / 3], AXES[(p - 12) % 3]),
    })
}

/// Values of the 21 base parameters, in the order that the start of this file defines.
pub fn parameter_values(calibration: &Calibration<f64>, frame: Frame) -> [f64; 21] {
    let (accelerometer, gyroscope) = (&calibration.accelerometer, &calibration.gyroscope);
    let free = frame.free_entries();
    std::array::from_fn(|p| match p {
        0..3 => accelerometer.bias()[p],
        3..9 => accelerometer.sensitivity()[free[p - 3]],
        9..12 => gyroscope.bias()[p - 9],
        _ => gyroscope.sensitivity()[((p - 12) / 3, (p - 12) % 3)],
    })
}
