//! What the motion does not determine, in words.
//!
//! A design is judged against errors that every real model has (half a mg at a rest, 0.2 deg in a move), not against noise
//! alone: a small noise must not make three nearly equal poses look like enough. A direction in parameter space that
//! such errors would move by more than a hundredth of the sensitivity counts as not determined (model.md (12)).

use faer::Mat;
use nalgebra::Vector3;

use crate::error::Error;
use crate::lsq;

/// Unmodelled error of |f| at a rest, m/s^2.
const REST_ERROR_MPS2: f64 = 0.005;
/// Unmodelled error of the gravity direction after a move, rad.
const MOVE_ERROR_RAD: f64 = 0.0035;
/// A parameter that such errors move by more than this share of the sensitivity is not determined.
const LARGEST_SHIFT: f64 = 0.01;
/// An axis that no rest brings this close to the vertical is said to be missing.
const FACE_LIMIT_DEG: f64 = 40.0;
const AXES: [&str; 3] = ["x", "y", "z"];

/// Names of the accelerometer's parameters in words, in the order of the symmetric fit.
const ACCELEROMETER_WORDS: [&str; 9] = [
    "bias x",
    "bias y",
    "bias z",
    "scale x",
    "scale y",
    "scale z",
    "misalignment xy",
    "misalignment xz",
    "misalignment yz",
];
/// Names of the gyroscope's nine entries in words, row by row.
const GYROSCOPE_WORDS: [&str; 9] = [
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

/// The message for rests so few or so alike that no sphere passes through them.
pub(crate) fn too_few_poses(rests: usize) -> String {
    format!(
        "{rests} rests do not determine scale, misalignment and bias of the accelerometer: at least 9 different poses \
         are needed; hold the unit still with each axis up and down, and in some poses in between"
    )
}

/// Refuses rests that leave a direction of the nine accelerometer parameters open.
///
/// `design` is the Jacobian of |f| in m/s^2 with respect to biases in units of what gravity reads and entries in units of the
/// sensitivity; `up` are the directions of gravity at the rests.
pub(crate) fn check_accelerometer(design: &Mat<f64>, up: &[Vector3<f64>]) -> Result<(), Error> {
    let open = undetermined(design, REST_ERROR_MPS2)?;
    if open.is_empty() {
        return Ok(());
    }
    Err(Error::NotEnoughMotion(format!(
        "{} rests do not determine the accelerometer's {}: {}",
        up.len(),
        names(&open, &ACCELEROMETER_WORDS),
        missing_poses(up)
    )))
}

/// Refuses moves that leave a direction of the nine gyroscope entries open.
///
/// `design` is the Jacobian of the move residuals in rad with respect to entries in units of the sensitivity;
/// `turned_rad` says how far the unit turned about each axis, and is only asked where something is missing.
pub(crate) fn check_gyroscope(
    design: &Mat<f64>,
    turned_rad: impl FnOnce() -> Vector3<f64>,
    moves: usize,
) -> Result<(), Error> {
    let open = undetermined(design, MOVE_ERROR_RAD)?;
    if open.is_empty() {
        return Ok(());
    }
    let turned_rad = turned_rad();
    let largest = turned_rad.max();
    // Entry (i, j) acts on turns about axis j: an idle axis leaves its whole column open.
    let column_open = |j: usize| open.iter().filter(|&&p| p % 3 == j).count() >= 2;
    let idle: Vec<&str> =
        (0..3).filter(|&j| column_open(j) && turned_rad[j] < 0.3 * largest).map(|j| AXES[j]).collect();
    let advice = if largest < 0.3 {
        "the unit hardly turns: add moves of 90 deg or more about each axis".to_owned()
    } else if idle.is_empty() {
        "add moves of 90 deg or more about different axes, each between two rests in different poses".to_owned()
    } else {
        let axes = idle.join(" and ");
        format!("hardly any turn about body {axes}: add moves of 90 deg or more about {axes}")
    };
    Err(Error::NotEnoughMotion(format!(
        "{moves} moves do not determine the gyroscope's {}: {advice}",
        names(&open, &GYROSCOPE_WORDS)
    )))
}

/// Columns of `design` that take part in a direction which an error of `typical_error` in each row may move by more than
/// [`LARGEST_SHIFT`].
fn undetermined(design: &Mat<f64>, typical_error: f64) -> Result<Vec<usize>, Error> {
    let (values, vectors) = lsq::singular(design)?;
    let least = typical_error / LARGEST_SHIFT;
    let open = |j: &usize| {
        (0..values.len())
            .filter(|&k| values[k].is_nan() || values[k] < least)
            .map(|k| vectors[(*j, k)].powi(2))
            .sum::<f64>()
            > 0.05
    };
    Ok((0..design.ncols()).filter(open).collect())
}

fn names(open: &[usize], words: &[&str]) -> String {
    let listed: Vec<&str> = open.iter().map(|&j| words[j]).collect();
    listed.join(", ")
}

/// Which poses to add, from how close each half axis has come to the vertical.
fn missing_poses(up: &[Vector3<f64>]) -> String {
    let closest = |axis: usize, sign: f64| {
        let cosine = up.iter().map(|u| sign * u[axis]).fold(-1.0, f64::max);
        cosine.clamp(-1.0, 1.0).acos().to_degrees()
    };
    let mut missing = Vec::new();
    for axis in 0..3 {
        let (upwards, downwards) = (closest(axis, 1.0), closest(axis, -1.0));
        let name = AXES[axis];
        if upwards > FACE_LIMIT_DEG && downwards > FACE_LIMIT_DEG {
            missing.push(format!(
                "no rest with {name} within 40 deg of vertical (closest {:.0} deg): add rests with {name} up and with {name} down",
                upwards.min(downwards)
            ));
        } else if upwards > FACE_LIMIT_DEG || downwards > FACE_LIMIT_DEG {
            let (way, angle) = if upwards > FACE_LIMIT_DEG { ("up", upwards) } else { ("down", downwards) };
            missing.push(format!("no rest with {name} {way} (closest {angle:.0} deg): add one"));
        }
    }
    if missing.is_empty() {
        return "every axis has been up and down, but poses in between are missing: add rests with edges and corners up".into();
    }
    missing.join("; ")
}
