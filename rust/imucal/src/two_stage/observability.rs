//! What a motion does not determine (model.md (12)).
//!
//! ```text
//! C = (J^T J + 1 / 10^2)^-1,     undetermined: C_jj > 1
//! ```
//!
//! J is the design over errors that every real model has (half a mg at a rest, 0.2 deg in a move) and times a hundredth of the
//! parameters' size. Noise alone would be the wrong measure: a small noise must not make three nearly equal poses look like
//! enough. No parameter is taken to be off by more than a tenth of its size, which is the second term.

use faer::Mat;
use nalgebra::Vector3;

use crate::error::Error;
use crate::numerics::lsq;
use crate::parameters::{self, ACCELEROMETER, WORDS};

/// Unmodelled error of |f| at a rest, m/s^2.
pub(crate) const REST_ERROR_MPS2: f64 = 0.005;
/// Unmodelled error of the gravity direction after a move, rad.
pub(crate) const MOVE_ERROR_RAD: f64 = 0.0035;
/// A parameter that such errors move by more than this share of its size is not determined.
pub(crate) const LARGEST_SHIFT: f64 = 0.01;
/// No parameter is further from nominal, in units of its size.
pub(crate) const FARTHEST: f64 = 0.1;
/// A parameter that makes up this much of the square of an open direction is open by itself.
const BY_ITSELF: f64 = 0.95;
/// Open parameters are traded off against each other from this correlation within the open directions on.
const TRADED: f64 = 0.1;
/// An axis that no rest brings this close to the vertical is said to be missing.
const FACE_LIMIT_DEG: f64 = 40.0;
const AXES: [&str; 3] = ["x", "y", "z"];

/// What a design leaves open.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Open {
    /// Columns that are not determined.
    pub(crate) columns: Vec<usize>,
    /// Groups of them of which some combinations are determined, and how many.
    pub(crate) traded: Vec<(Vec<usize>, usize)>,
}

impl Open {
    /// What `design` leaves open: rows in units of the errors of real units, columns for a hundredth of each parameter's size.
    pub(crate) fn of(design: &Mat<f64>) -> Result<Self, Error> {
        let (values, vectors) = lsq::singular(design)?;
        let loosest = LARGEST_SHIFT / FARTHEST;
        let n = design.ncols();
        let shift = |j: usize| {
            let part = |k: usize| vectors[(j, k)].powi(2) / (values[k].powi(2) + loosest * loosest);
            (0..n).map(part).sum::<f64>()
        };
        let columns: Vec<usize> = (0..n).filter(|&j| shift(j) > 1.0).collect();
        // Projection on the directions that are open.
        let open: Vec<usize> = (0..n).filter(|&k| values[k] < 1.0).collect();
        let projection = |i: usize, j: usize| open.iter().map(|&k| vectors[(i, k)] * vectors[(j, k)]).sum::<f64>();
        Ok(Self { traded: traded(&columns, projection), columns })
    }

    /// "of accelerometer bias z and accelerometer scale z 1 combination is determined", for each group.
    fn traded_words(&self) -> Vec<String> {
        let name = |&j: &usize| {
            let sensor = if j < ACCELEROMETER { "accelerometer" } else { "gyroscope" };
            format!("{sensor} {}", WORDS[j])
        };
        let of_group = |(members, determined): &(Vec<usize>, usize)| {
            let names: Vec<String> = members.iter().map(name).collect();
            let (last, others) = names.split_last()?;
            let count =
                if *determined == 1 { "1 combination is".into() } else { format!("{determined} combinations are") };
            Some(format!("of {} and {last} {count} determined", others.join(", ")))
        };
        self.traded.iter().filter_map(of_group).collect()
    }

    /// What is open of the accelerometer, and of the gyroscope.
    pub(crate) fn names(&self) -> [Vec<&'static str>; 2] {
        [true, false].map(|accelerometer| {
            self.columns.iter().filter(|&&j| (j < ACCELEROMETER) == accelerometer).map(|&j| WORDS[j]).collect()
        })
    }

    /// The words for what `rests` and `moves` leave open, and for what to add; `None` if nothing is.
    pub(crate) fn explain(&self, rests: usize, moves: usize, poses: &str, turns: &str) -> Option<String> {
        let [accelerometer, gyroscope] = self.names();
        let mut parts = Vec::new();
        if !accelerometer.is_empty() {
            parts.push(format!(
                "{rests} rests do not determine the accelerometer's {}: {poses}",
                accelerometer.join(", ")
            ));
        }
        if !gyroscope.is_empty() {
            parts.push(format!("{moves} moves do not determine the gyroscope's {}: {turns}", gyroscope.join(", ")));
        }
        if parts.is_empty() {
            return None;
        }
        parts.extend(self.traded_words());
        Some(parts.join("; "))
    }
}

/// Groups of open columns that hang together in the open directions, with the number of combinations that are determined.
fn traded(columns: &[usize], projection: impl Fn(usize, usize) -> f64) -> Vec<(Vec<usize>, usize)> {
    let mut left: Vec<usize> = columns.iter().copied().filter(|&j| projection(j, j) < BY_ITSELF).collect();
    let mut groups = Vec::new();
    while let Some(first) = left.pop() {
        let mut group = vec![first];
        let mut next = 0;
        while next < group.len() {
            let i = group[next];
            let hangs_on = |&j: &usize| projection(i, j).abs() > TRADED * (projection(i, i) * projection(j, j)).sqrt();
            let (joined, others): (Vec<usize>, Vec<usize>) = left.into_iter().partition(hangs_on);
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

/// The words for rests that alone do not determine the accelerometer; `None` if they do.
///
/// `design` is the Jacobian of |f| in m/s^2 with respect to biases in units of what gravity reads and entries in units of the
/// sensitivity; `up` are the directions of gravity at the rests.
pub(crate) fn check_accelerometer(design: &Mat<f64>, up: &[Vector3<f64>]) -> Result<(), Error> {
    let open = Open::of(&in_hundredths(design, REST_ERROR_MPS2))?;
    match open.explain(up.len(), 0, &missing_poses(up), "") {
        Some(words) => Err(Error::NotEnoughMotion(words)),
        None => Ok(()),
    }
}

/// Refuses moves that leave an entry of the gyroscope open, given the accelerometer.
///
/// `design` is the Jacobian of the move residuals in rad with respect to entries in units of the sensitivity.
pub(crate) fn check_gyroscope(design: &Mat<f64>, moves: usize) -> Result<(), Error> {
    let open = Open::of(&in_hundredths(design, MOVE_ERROR_RAD))?;
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

/// The message for rests so few or so alike that no sphere passes through them.
pub(crate) fn no_start(rests: usize) -> String {
    format!(
        "{rests} rests do not determine the accelerometer's {}: {}",
        parameters::words(false).join(", "),
        too_few_poses()
    )
}

/// What to add where rests do not even suggest the scale of an accelerometer in counts.
pub(crate) fn too_few_poses() -> String {
    "at least 9 different poses are needed; hold the unit still with each axis up and down, and in some poses in between".into()
}

/// Which poses to add, from how close each half axis has come to the vertical.
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

const OTHER_AXES: &str = "add moves of 90 deg or more about different axes, each between two rests in different poses";

/// Which turns to add. `open` are the gyroscope's entries that stay open with the accelerometer known; `turned_rad` says how far
/// the unit turned about each axis.
pub(crate) fn missing_turns(open: &[usize], turned_rad: &Vector3<f64>) -> String {
    if open.is_empty() {
        return "the poses that the accelerometer needs determine these, too".into();
    }
    let largest = turned_rad.max();
    if largest < 0.3 {
        return "the unit hardly turns: add moves of 90 deg or more about each axis".into();
    }
    // Entry (i, j) acts on turns about axis j: an idle axis leaves its whole column open.
    let column_open = |j: usize| open.iter().filter(|&&p| p % 3 == j).count() >= 2;
    let idle: Vec<&str> =
        (0..3).filter(|&j| column_open(j) && turned_rad[j] < 0.3 * largest).map(|j| AXES[j]).collect();
    if idle.is_empty() {
        return OTHER_AXES.into();
    }
    let axes = idle.join(" and ");
    format!("hardly any turn about body {axes}: add moves of 90 deg or more about {axes}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn design(rows: &[&[f64]]) -> Mat<f64> {
        Mat::from_fn(rows.len(), rows[0].len(), |i, j| rows[i][j])
    }

    #[test]
    fn open_by_itself_or_traded_off() {
        // The first column is seen, the second is not, of the others only the sum is.
        let open = Open::of(&design(&[&[50.0, 0.0, 0.0, 0.0], &[0.0, 0.0, 40.0, 40.0]])).unwrap();
        assert_eq!(open, Open { columns: vec![1, 2, 3], traded: vec![(vec![2, 3], 1)] });
        let words = open.explain(7, 0, "add rests", "").unwrap();
        assert_eq!(
            words,
            "7 rests do not determine the accelerometer's bias y, bias z, scale x: add rests; of accelerometer bias z and \
             accelerometer scale x 1 combination is determined"
        );
    }

    #[test]
    fn a_small_part_in_an_open_direction_does_no_harm() {
        // A tenth of the second, at most, times 0.05 is less than a hundredth of the first.
        let open = |part: f64| Open::of(&design(&[&[50.0, 50.0 * part]])).unwrap().columns;
        assert_eq!(open(0.05), [1]);
        assert_eq!(open(0.2), [0, 1]);
    }

    #[test]
    fn a_full_design_leaves_nothing_open() {
        let open = Open::of(&design(&[&[2.0, 1.0], &[-1.0, 2.0]])).unwrap();
        assert_eq!(open, Open::default());
        assert_eq!(open.explain(9, 8, "", ""), None);
    }
}
