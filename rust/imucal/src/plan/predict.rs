//! What a motion determines, before anything is recorded.

use faer::Mat;
use faer::linalg::solvers::Solve;

use super::chain::Chain;
use super::leg::{EDGE_S, Leg, Still};
use super::sensors::Sensors;
use crate::error::Error;
use crate::simulate::Motion;

/// What a run will tell.
#[derive(Clone, Debug, PartialEq)]
pub struct Prediction {
    /// Standard deviation of each parameter, in the order of [`Sensors`]: 21, then those of the effects. What the motion leaves open
    /// has a tenth of its size.
    pub sigma: Vec<f64>,
    /// How many rests are long enough to be found.
    pub rests: usize,
}

/// Standard deviations that the joint fit will have after these motions of one unit, each in a recording of its own.
///
/// * `min_rest_s`: rests that are shorter are not found.
/// * `settle_s`: how much of each rest after a move is not used.
/// * `in_hand`: a hand holds the unit: it trembles, and the mean rate of a rest is not zero.
///
/// # Errors
/// [`Error::NotEnoughMotion`] if a motion has no rest, [`Error::Fit`] if the information has no inverse.
pub fn predict(
    sensors: &Sensors,
    motions: &[Motion],
    min_rest_s: f64,
    settle_s: f64,
    in_hand: bool,
) -> Result<Prediction, Error> {
    let n = sensors.parameters();
    let (mut information, mut found) = (Mat::zeros(n, n), 0);
    for motion in motions {
        let rests = rests(motion, min_rest_s, settle_s);
        if rests.is_empty() {
            return Err(Error::NotEnoughMotion(format!(
                "the motion has no rest of {min_rest_s} s or more: hold the poses for longer"
            )));
        }
        let mut chain = Chain::new(n);
        for (k, rest) in rests.iter().enumerate() {
            let middle_s = (rest.start_s + rest.end_s) / 2.0;
            Still::new(sensors, &motion.at(middle_s), middle_s, in_hand).see(&mut chain, rest.used_s);
            if let Some(next) = rests.get(k + 1) {
                let move_s = next.start_s - rest.end_s;
                Leg::new(sensors, rest.end_s, move_s, settle_s, |time_s| motion.at(time_s)).go(&mut chain);
            }
        }
        information += chain.information();
        found += rests.len();
    }
    let covariance = covariance(&information, &sensors.before_data()).ok_or_else(|| {
        Error::Fit("the information of the motion has no inverse: check the noise of the unit".into())
    })?;
    Ok(Prediction { sigma: (0..n).map(|p| covariance[(p, p)].sqrt()).collect(), rests: found })
}

struct RestSpan {
    start_s: f64,
    end_s: f64,
    used_s: f64,
}

/// The rests that are long enough to be found. The first one has no move before it, the last one none after it.
fn rests(motion: &Motion, min_rest_s: f64, settle_s: f64) -> Vec<RestSpan> {
    let duration_s = motion.duration_s();
    let span = |(start_s, end_s): (f64, f64)| {
        let before = if start_s > 0.0 { EDGE_S + settle_s } else { 0.0 };
        let after = if end_s < duration_s { EDGE_S } else { 0.0 };
        RestSpan { start_s, end_s, used_s: end_s - start_s - before - after }
    };
    motion.rests().into_iter().map(span).filter(|rest| rest.used_s >= min_rest_s).collect()
}

/// Inverse of the information, with what is known before any data.
pub(super) fn covariance(information: &Mat<f64>, before: &[f64]) -> Option<Mat<f64>> {
    let n = before.len();
    let size: Vec<f64> = (0..n).map(|p| (information[(p, p)] + before[p]).sqrt()).collect();
    let normal = scaled(information, before, &size);
    let solved = normal.llt(faer::Side::Lower).ok()?.solve(&Mat::<f64>::identity(n, n));
    Some(Mat::from_fn(n, n, |i, j| solved[(i, j)] / (size[i] * size[j])))
}

/// Logarithm of the determinant of the information, with what is known before any data.
pub(super) fn log_determinant(information: &Mat<f64>, before: &[f64]) -> Option<f64> {
    let n = before.len();
    let size: Vec<f64> = (0..n).map(|p| (information[(p, p)] + before[p]).sqrt()).collect();
    let factor = scaled(information, before, &size).llt(faer::Side::Lower).ok()?;
    let diagonal = (0..n).map(|p| factor.L()[(p, p)].ln()).sum::<f64>();
    Some(2.0 * (diagonal + size.iter().map(|size| size.ln()).sum::<f64>()))
}

/// With ones on the diagonal.
fn scaled(information: &Mat<f64>, before: &[f64], size: &[f64]) -> Mat<f64> {
    Mat::from_fn(before.len(), before.len(), |i, j| {
        (information[(i, j)] + if i == j { before[i] } else { 0.0 }) / (size[i] * size[j])
    })
}
