//! What the motion does not determine, in words.
//!
//! A design is judged against errors that every real model has (half a mg at a rest, 0.2 deg in a move), not against noise
//! alone: a small noise must not make three nearly equal poses look like enough. A direction in parameter space that
//! such errors would move by more than a hundredth of the sensitivity counts as not determined (model.md (12)).

use faer::Mat;
use nalgebra::Vector3;

use crate::accelerometer::{norm_and_gradient, parameters_of, triad_of};
use crate::ellipsoid::Start;
use crate::error::Error;
use crate::lsq;

/// Unmodelled error of |f| at a rest, m/s^2.
const REST_ERROR_MPS2: f64 = 0.005;
/// Unmodelled error of the gravity direction after a move, rad.
pub(crate) const MOVE_ERROR_RAD: f64 = 0.0035;
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
pub(crate) fn check_accelerometer(means: &[Vector3<f64>], start: &Start, gravity_mps2: f64) -> Result<(), Error> {
    let triad = triad_of(&parameters_of(start))?;
    let scale = start.sensitivity.trace() / 3.0;
    let gradients: Vec<_> = means.iter().map(|mean| norm_and_gradient(&triad, mean).1).collect();
    let design = Mat::from_fn(means.len(), 9, |k, j| {
        let typical = if j < 3 { 0.01 * gravity_mps2 } else { 0.01 };
        gradients[k][j] * typical * scale / REST_ERROR_MPS2
    });
    let open = undetermined(&design)?;
    if open.is_empty() {
        return Ok(());
    }
    let directions: Vec<Vector3<f64>> = means.iter().map(|mean| triad.correct(*mean).normalize()).collect();
    Err(Error::NotEnoughMotion(format!(
        "{} rests do not determine the accelerometer's {}: {}",
        means.len(),
        names(&open, &ACCELEROMETER_WORDS),
        missing_poses(&directions)
    )))
}

/// Refuses moves that leave a direction of the nine gyroscope entries open. `design` is the Jacobian of the move
/// residuals in rad with respect to the entries, each times `0.01 * scale`, over [`MOVE_ERROR_RAD`].
pub(crate) fn check_gyroscope(design: &Mat<f64>, turned_rad: Vector3<f64>, moves: usize) -> Result<(), Error> {
    let open = undetermined(design)?;
    if open.is_empty() {
        return Ok(());
    }
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

/// Columns of `design` that take part in a direction which is not determined (singular value below one).
pub(crate) fn undetermined(design: &Mat<f64>) -> Result<Vec<usize>, Error> {
    let (values, vectors) = lsq::singular(design)?;
    let open = |j: &usize| {
        (0..values.len())
            .filter(|&k| values[k].is_nan() || values[k] < 1.0)
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
