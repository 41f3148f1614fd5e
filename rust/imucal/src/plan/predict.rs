//! Predicts the accuracy of a calibration before anything is recorded.

use faer::Mat;
use faer::linalg::solvers::Solve;

use super::information_filter::InformationFilter;
use super::propagation::{EDGE_S, MoveInformation, RestInformation};
use super::sensors::Sensors;
use crate::error::Error;
use crate::simulate::Motion;

/// Predicted accuracy of a calibration from a run.
#[derive(Clone, Debug, PartialEq)]
pub struct Prediction {
    /// Standard deviation of each parameter in SI units, in the order of [`Sensors`]: first the 21 parameters of the
    /// triads (three-axis sensors), then the parameters of the effects. A parameter that the motion does not determine
    /// has the standard deviation of its default prior. This standard deviation is a tenth of the mean scale for a
    /// sensitivity, a tenth of the reading at 1 g or at 1 rad/s for a bias, and ten times the typical size for a
    /// parameter of an effect. If the user gave a narrower prior, this prior replaces the default prior.
    pub sigma: Vec<f64>,
    /// Number of rests that are long enough for rest detection.
    pub rests: usize,
}

/// Predicts the standard deviations of the parameters that the joint fit estimates from the given motions of one unit.
/// Each motion is a separate recording.
///
/// * `min_rest_s`: minimum duration of a rest for rest detection, s.
/// * `settle_s`: time after each move in which samples are not used, s.
/// * `in_hand`: whether a person holds the unit, so that the unit trembles and its mean rate at a rest is not zero.
///
/// # Errors
/// [`Error::NotEnoughMotion`] if a motion has no rest of `min_rest_s` or more; [`Error::Fit`] if the information matrix
/// is singular.
pub fn predict(
    sensors: &Sensors,
    motions: &[Motion],
    min_rest_s: f64,
    settle_s: f64,
    in_hand: bool,
) -> Result<Prediction, Error> {
    let n = sensors.parameters();
    let (mut information, mut found) = (Mat::zeros(n, n), 0);
    let count = motions.iter().map(|motion| rests(motion, min_rest_s, settle_s).len()).sum();
    for motion in motions {
        let rests = rests(motion, min_rest_s, settle_s);
        if rests.is_empty() {
            return Err(Error::NotEnoughMotion(format!(
                "the motion has no rest of {min_rest_s} s or more: hold the poses for longer"
            )));
        }
        let mut filter = InformationFilter::new(n);
        for (k, rest) in rests.iter().enumerate() {
            let middle_s = (rest.start_s + rest.end_s) / 2.0;
            RestInformation::new(sensors, &motion.at(middle_s), middle_s, in_hand).add_to(
                &mut filter,
                rest.used_s,
                count,
            );
            if let Some(next) = rests.get(k + 1) {
                let move_s = next.start_s - rest.end_s;
                MoveInformation::new(sensors, rest.end_s, move_s, settle_s, |time_s| motion.at(time_s))
                    .propagate(&mut filter);
            }
        }
        information += filter.information();
        found += rests.len();
    }
    let covariance = covariance(&information, &sensors.prior_precision()).ok_or_else(|| {
        Error::Fit("the information matrix of the motion is singular: check the noise densities of the unit".into())
    })?;
    Ok(Prediction { sigma: (0..n).map(|p| covariance[(p, p)].sqrt()).collect(), rests: found })
}

struct RestSpan {
    start_s: f64,
    end_s: f64,
    used_s: f64,
}

/// The rests that are long enough for rest detection. `used_s` is the duration of a rest without `EDGE_S` at each end
/// that is adjacent to a move, and also without `settle_s` after the preceding move.
fn rests(motion: &Motion, min_rest_s: f64, settle_s: f64) -> Vec<RestSpan> {
    let duration_s = motion.duration_s();
    let span = |(start_s, end_s): (f64, f64)| {
        let at_start = if start_s > 0.0 { EDGE_S + settle_s } else { 0.0 };
        let at_end = if end_s < duration_s { EDGE_S } else { 0.0 };
        RestSpan { start_s, end_s, used_s: end_s - start_s - at_start - at_end }
    };
    motion.rests().into_iter().map(span).filter(|rest| rest.used_s >= min_rest_s).collect()
}

/// Inverse of `information + diag(prior)`, where `prior` contains the prior precisions; `None` if this sum is not
/// positive definite.
pub(super) fn covariance(information: &Mat<f64>, prior: &[f64]) -> Option<Mat<f64>> {
    let n = prior.len();
    let size: Vec<f64> = (0..n).map(|p| (information[(p, p)] + prior[p]).sqrt()).collect();
    let normal = scaled(information, prior, &size);
    let solved = normal.llt(faer::Side::Lower).ok()?.solve(&Mat::<f64>::identity(n, n));
    Some(Mat::from_fn(n, n, |i, j| solved[(i, j)] / (size[i] * size[j])))
}

/// `ln det(information + diag(prior))`, where `prior` contains the prior precisions; `None` if this sum is not positive
/// definite.
pub(super) fn log_determinant(information: &Mat<f64>, prior: &[f64]) -> Option<f64> {
    let n = prior.len();
    let size: Vec<f64> = (0..n).map(|p| (information[(p, p)] + prior[p]).sqrt()).collect();
    let factor = scaled(information, prior, &size).llt(faer::Side::Lower).ok()?;
    let diagonal = (0..n).map(|p| factor.L()[(p, p)].ln()).sum::<f64>();
    Some(2.0 * (diagonal + size.iter().map(|size| size.ln()).sum::<f64>()))
}

/// The matrix `information + diag(prior)`, where `prior` contains the prior precisions, scaled so that all diagonal
/// entries are one.
fn scaled(information: &Mat<f64>, prior: &[f64], size: &[f64]) -> Mat<f64> {
    Mat::from_fn(prior.len(), prior.len(), |i, j| {
        (information[(i, j)] + if i == j { prior[i] } else { 0.0 }) / (size[i] * size[j])
    })
}
