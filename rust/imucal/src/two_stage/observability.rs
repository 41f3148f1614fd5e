//! Finds the parameters that the poses and rotations of a recording do not determine (model.md (12)).
//!
//! ```text
//! C = (J^T J + I / 10^2)^-1,     parameter j is undetermined if C_jj > 1
//! ```
//!
//! C is the covariance of the parameters that model errors cause, in units of 1 % of the size of each parameter. A
//! parameter is therefore undetermined if model errors change it by more than 1 % of its size. J is the design matrix.
//! The rows of J are divided by the model errors that every real unit has: half a mg at a rest, and 0.2 deg in a move.
//! Each column of J is multiplied by 1 % of the size of its parameter. The size of an accelerometer bias is the reading
//! at 1 g, and the size of an entry of a sensitivity is the mean scale. The rows are not divided by sensor noise,
//! because if the noise is small, three nearly equal poses would seem sufficient.
//!
//! I is the identity matrix. The term I / 10^2 is a prior of each parameter about its nominal value. The standard
//! deviation of the prior is a tenth of the size of the parameter, which is 10 in units of 1 % of this size.

use faer::Mat;
use nalgebra::Vector3;

use crate::error::Error;
use crate::finding::counted;
use crate::numerics::lsq;
use crate::parameters::{self, ACCELEROMETER, WORDS};

/// Model error of the norm |f| of the mean specific force at a rest of a real unit, m/s^2 (half a mg).
pub(crate) const REST_ERROR_MPS2: f64 = 0.005;
/// Model error of the gravity direction after a move of a real unit, rad (0.2 deg).
pub(crate) const MOVE_ERROR_RAD: f64 = 0.0035;
/// A parameter is determined if the model errors [`REST_ERROR_MPS2`] and [`MOVE_ERROR_RAD`] change it by at most this
/// fraction of its size.
pub(crate) const LARGEST_SHIFT: f64 = 0.01;
/// Standard deviation of the prior of a parameter about its nominal value, as a fraction of its size.
pub(crate) const FARTHEST: f64 = 0.1;
/// The unit vector along an undetermined parameter is projected onto the unobservable subspace of the parameter space.
/// If the squared length of this projection is at least this value, the parameter is unobservable by itself. Otherwise,
/// the parameter may belong to a group of parameters of which only linear combinations are observable.
const OWN_SHARE: f64 = 0.95;
/// Two undetermined parameters i and j belong to the same group if the magnitude of their correlation exceeds this
/// value. Only linear combinations of the parameters of a group are observable. The correlation is
/// `P_ij / sqrt(P_ii P_jj)`, where P is the projection matrix onto the unobservable subspace.
const TRADED: f64 = 0.1;
/// In a pose, an axis counts as up or down if the angle between the axis and the vertical is at most this limit, deg.
const FACE_LIMIT_DEG: f64 = 40.0;
/// Recommendation if each of the six faces was up at some rest, but poses with an edge or a corner up are missing.
pub(crate) const EDGES_AND_CORNERS: &str = "add rests with edges and corners up";
/// Alternative recommendation for a unit with a gyroscope, which measures the rotations between the faces. Four turns
/// about each axis while this axis is horizontal bring every face up. They also separate the misalignment of the
/// accelerometer from the scale of the gyroscope (model.md (5)).
pub(crate) const OR_ROLL: &str = ", or roll the unit over its faces: four turns of 90 deg about each axis while that \
                                  axis is level, with a rest after each";
const AXES: [&str; 3] = ["x", "y", "z"];

/// The parameters that a design matrix does not determine.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Open {
    /// Columns of the design matrix whose parameters are not determined.
    pub(crate) columns: Vec<usize>,
    /// Groups of columns. The parameters of a group are not determined individually, but some of their linear
    /// combinations are. The number of these combinations is stored with each group.
    pub(crate) traded: Vec<(Vec<usize>, usize)>,
}

impl Open {
    /// Finds the parameters that the design matrix `design` does not determine. The rows of `design` are divided by the
    /// model errors of a real unit, and each column is multiplied by 1 % of the size of its parameter.
    pub(crate) fn of(design: &Mat<f64>) -> Result<Self, Error> {
        let (values, vectors) = lsq::singular(design)?;
        let loosest = LARGEST_SHIFT / FARTHEST;
        let n = design.ncols();
        let shift = |j: usize| {
            let part = |k: usize| vectors[(j, k)].powi(2) / (values[k].powi(2) + loosest * loosest);
            (0..n).map(part).sum::<f64>()
        };
        let columns: Vec<usize> = (0..n).filter(|&j| shift(j) > 1.0).collect();
        // Directions in parameter space whose singular value is below one are unobservable. `projection` returns an
        // entry of the projection matrix onto these directions.
        let open: Vec<usize> = (0..n).filter(|&k| values[k] < 1.0).collect();
        let projection = |i: usize, j: usize| open.iter().map(|&k| vectors[(i, k)] * vectors[(j, k)]).sum::<f64>();
        Ok(Self { traded: traded(&columns, projection), columns })
    }

    /// Removes the parameters with the columns `held` from the undetermined parameters, because these parameters have
    /// priors. Groups that contain a parameter with a prior are also removed.
    pub(crate) fn without(self, held: &[usize]) -> Self {
        let is_left = |j: &usize| !held.contains(j);
        let columns: Vec<usize> = self.columns.into_iter().filter(is_left).collect();
        let traded = self.traded.into_iter().filter(|(members, _)| members.iter().all(is_left)).collect();
        Self { columns, traded }
    }

    /// One phrase for each group, for example "only 1 independent combination of accelerometer bias z and accelerometer
    /// scale z is observable".
    fn group_phrases(&self) -> Vec<String> {
        let name = |&j: &usize| {
            let sensor = if j < ACCELEROMETER { "accelerometer" } else { "gyroscope" };
            format!("{sensor} {}", WORDS[j])
        };
        let of_group = |(members, determined): &(Vec<usize>, usize)| {
            let names: Vec<String> = members.iter().map(name).collect();
            let (last, others) = names.split_last()?;
            let (plural, verb) = if *determined == 1 { ("", "is") } else { ("s", "are") };
            let others = others.join(", ");
            Some(format!("only {determined} independent combination{plural} of {others} and {last} {verb} observable"))
        };
        self.traded.iter().filter_map(of_group).collect()
    }

    /// Names of the undetermined parameters of the accelerometer and of the gyroscope.
    pub(crate) fn names(&self) -> [Vec<&'static str>; 2] {
        [true, false].map(|accelerometer| {
            self.columns.iter().filter(|&&j| (j < ACCELEROMETER) == accelerometer).map(|&j| WORDS[j]).collect()
        })
    }

    /// Message with the undetermined parameters and the recommendations `poses` (for the accelerometer) and `turns`
    /// (for the gyroscope); `None` if all parameters are determined.
    pub(crate) fn explain(&self, rests: usize, moves: usize, poses: &str, turns: &str) -> Option<String> {
        let [accelerometer, gyroscope] = self.names();
        let mut parts = Vec::new();
        if !accelerometer.is_empty() {
            parts.push(format!(
                "{} not determine the accelerometer's {}: {poses}",
                items_do(rests, "rest"),
                accelerometer.join(", ")
            ));
        }
        if !gyroscope.is_empty() {
            parts.push(format!(
                "{} not determine the gyroscope's {}: {turns}",
                items_do(moves, "move"),
                gyroscope.join(", ")
            ));
        }
        if parts.is_empty() {
            return None;
        }
        parts.extend(self.group_phrases());
        Some(parts.join("; "))
    }
}

/// Groups the undetermined parameters `columns` that are correlated with each other ([`TRADED`]). `projection` returns
/// the entries of the projection matrix onto the unobservable directions. Each group is returned with the number of
/// linear combinations of its parameters that are determined.
fn traded(columns: &[usize], projection: impl Fn(usize, usize) -> f64) -> Vec<(Vec<usize>, usize)> {
    let mut left: Vec<usize> = columns.iter().copied().filter(|&j| projection(j, j) < OWN_SHARE).collect();
    let mut groups = Vec::new();
    while let Some(first) = left.pop() {
        let mut group = vec![first];
        let mut next = 0;
        while next < group.len() {
            let i = group[next];
            let is_coupled =
                |&j: &usize| projection(i, j).abs() > TRADED * (projection(i, i) * projection(j, j)).sqrt();
            let (joined, others): (Vec<usize>, Vec<usize>) = left.into_iter().partition(is_coupled);
            group.extend(joined);
            left = others;
            next += 1;
        }
        let open: f64 = group.iter().map(|&j| projection(j, j)).sum();
        let determined = group.len().saturating_sub(open.round() as usize);
        if group.len() > 1 && determined > 0 {
            group.sort_unstable();
            groups.push((group, determined));
        }
    }
    groups.sort();
    groups
}

/// Returns an error if the rests do not determine all accelerometer parameters that have no prior.
///
/// `design` is the Jacobian of |f| at the rests, m/s^2, with respect to the nine parameters. |f| is the norm of the
/// mean specific force. In the Jacobian, the unit of a bias is the reading at 1 g, and the unit of an entry of the
/// sensitivity is the mean scale. `up` contains the gravity directions at the rests. `held` contains the columns of
/// parameters with a prior.
///
/// # Errors
/// [`Error::NotEnoughMotion`] names the parameters and the poses to add.
pub(crate) fn check_accelerometer(design: &Mat<f64>, up: &[Vector3<f64>], held: &[usize]) -> Result<(), Error> {
    let open = Open::of(&in_hundredths(design, REST_ERROR_MPS2))?.without(held);
    match open.explain(up.len(), 0, &missing_poses(up), "") {
        Some(words) => Err(Error::NotEnoughMotion(words)),
        None => Ok(()),
    }
}

/// Returns an error if the moves do not determine all entries of the gyroscope sensitivity that have no prior. The
/// accelerometer is assumed to be known.
///
/// `design` is the Jacobian of the direction residuals of the moves, rad, with respect to the entries of the
/// sensitivity. In the Jacobian, the unit of an entry is the mean scale. `held` contains the columns of entries with a
/// prior.
///
/// # Errors
/// [`Error::NotEnoughMotion`] names the entries and the moves to add.
pub(crate) fn check_gyroscope(design: &Mat<f64>, moves: usize, held: &[usize]) -> Result<(), Error> {
    let open = Open::of(&in_hundredths(design, MOVE_ERROR_RAD))?.without(held);
    if open.columns.is_empty() {
        return Ok(());
    }
    let names: Vec<&str> = open.columns.iter().map(|&j| parameters::words(true)[j]).collect();
    Err(Error::NotEnoughMotion(format!(
        "{moves} moves do not determine the gyroscope's {}: {OTHER_AXES}",
        names.join(", ")
    )))
}

fn in_hundredths(design: &Mat<f64>, typical_error: f64) -> Mat<f64> {
    let unit = LARGEST_SHIFT / typical_error;
    Mat::from_fn(design.nrows(), design.ncols(), |i, j| design[(i, j)] * unit)
}

/// Message for rests that are too few or too similar to determine a sphere.
pub(crate) fn no_start(rests: usize) -> String {
    format!(
        "{rests} rests do not determine the accelerometer's {}: {}",
        parameters::words(false).join(", "),
        too_few_poses()
    )
}

/// Recommendation for an accelerometer with readings in counts if the rests do not determine its scale.
pub(crate) fn too_few_poses() -> String {
    "at least 9 different poses are needed; hold the unit still with each axis up and down, and in some poses in \
     between"
        .into()
}

/// Recommends poses to add, so that each body axis points up at one rest and down at another (within
/// [`FACE_LIMIT_DEG`]). `up` contains the gravity directions at the rests.
pub(crate) fn missing_poses(up: &[Vector3<f64>]) -> String {
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
                "no rest with {name} within 40 deg of vertical (closest {:.0} deg): add rests with {name} up and with \
                 {name} down",
                upwards.min(downwards)
            ));
        } else if upwards > FACE_LIMIT_DEG || downwards > FACE_LIMIT_DEG {
            let (way, angle) = if upwards > FACE_LIMIT_DEG { ("up", upwards) } else { ("down", downwards) };
            missing.push(format!("no rest with {name} {way} (closest {angle:.0} deg): add one"));
        }
    }
    if missing.is_empty() {
        return format!("every axis has been up and down, but poses in between are missing: {EDGES_AND_CORNERS}");
    }
    missing.join("; ")
}

const OTHER_AXES: &str = "add moves of 90 deg or more about different axes, each between two rests in different poses";

/// Recommends rotations to add. `open` contains the entries of the gyroscope sensitivity that are not determined even
/// with a known accelerometer. `turned_rad` is the total rotation about each axis, rad.
pub(crate) fn missing_turns(open: &[usize], turned_rad: &Vector3<f64>) -> String {
    if open.is_empty() {
        return "the poses recommended for the accelerometer also determine these parameters".into();
    }
    let largest = turned_rad.max();
    if largest < 0.3 {
        return "the unit hardly rotates: add moves of 90 deg or more about each axis".into();
    }
    // Only a rotation about axis j determines entry (i, j) of the sensitivity. If the unit does not rotate about axis
    // j, no entry in column j is determined.
    let column_open = |j: usize| open.iter().filter(|&&p| p % 3 == j).count() >= 2;
    let idle: Vec<&str> =
        (0..3).filter(|&j| column_open(j) && turned_rad[j] < 0.3 * largest).map(|j| AXES[j]).collect();
    if idle.is_empty() {
        return OTHER_AXES.into();
    }
    let axes = idle.join(" and ");
    format!("hardly any rotation about body {axes}: add moves of 90 deg or more about {axes}")
}

/// Subject and auxiliary verb of a sentence, such as "1 rest does" or "6 rests do".
fn items_do(count: usize, noun: &str) -> String {
    format!("{} {}", counted(count, noun), if count == 1 { "does" } else { "do" })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn design(rows: &[&[f64]]) -> Mat<f64> {
        Mat::from_fn(rows.len(), rows[0].len(), |i, j| rows[i][j])
    }

    #[test]
    fn undetermined_by_itself_or_in_combination() {
        // Only the first parameter and the sum of the last two parameters are observable.
        let open = Open::of(&design(&[&[50.0, 0.0, 0.0, 0.0], &[0.0, 0.0, 40.0, 40.0]])).unwrap();
        assert_eq!(open, Open { columns: vec![1, 2, 3], traded: vec![(vec![2, 3], 1)] });
        let words = open.explain(7, 0, "add rests", "").unwrap();
        assert_eq!(
            words,
            "7 rests do not determine the accelerometer's bias y, bias z, scale x: add rests; only 1 independent \
             combination of accelerometer bias z and accelerometer scale x is observable"
        );
    }

    #[test]
    fn a_small_component_in_an_unobservable_direction_is_tolerated() {
        // With its prior, the second parameter may deviate by a tenth of its size. For `part` = 0.05, this deviation
        // changes the first parameter by less than a hundredth of its size, so the first parameter is determined.
        let open = |part: f64| Open::of(&design(&[&[50.0, 50.0 * part]])).unwrap().columns;
        assert_eq!(open(0.05), [1]);
        assert_eq!(open(0.2), [0, 1]);
    }

    #[test]
    fn a_full_design_determines_all_parameters() {
        let open = Open::of(&design(&[&[2.0, 1.0], &[-1.0, 2.0]])).unwrap();
        assert_eq!(open, Open::default());
        assert_eq!(open.explain(9, 8, "", ""), None);
    }
}
