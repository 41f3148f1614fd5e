//! Detects biases that changed between the calibration recordings and the control recordings.
//!
//! ```text
//! |f_k| - g = u_k . d_a + noise,     mean rate at rest k = d_g + noise,     k over the rests of the control recordings
//! ```
//!
//! f_k is the mean specific force at rest k, u_k is the direction of f_k, and g is local gravity. f_k and the mean
//! rates are corrected by the calibration. d_a and d_g are the changes of the accelerometer and gyroscope biases from
//! the session of the calibration recordings to the session of the control recordings. An effect that is missing from
//! the model causes almost equal errors in both sessions. The biases of the calibration contain the mean of these
//! errors, so the effect is rarely mistaken for a change of the biases.

use imucal_core::calibration::Calibration;
use imucal_core::sensor::Triad;
use nalgebra::{Matrix3, Vector3};

use crate::calibrate::{CorrectedSamples, Outcome};
use crate::evaluate::{Evaluation, RestReport};
use crate::numerics::stats::p_value;
use crate::recording::Recording;
use crate::rests::noise_density::variance_by_axis;

/// Minimum number of rests in the control recordings for the changes of the biases to be estimated. It is twice the
/// number of unknowns per sensor (the changes of three bias components).
const LEAST_RESTS: usize = 6;
/// Maximum p-value of a significant change of one sensor's biases.
const SIGNIFICANCE: f64 = 1e-6;
/// A change of the bias is reported only if, on any axis, |change| > LEAST_SIZE x scatter. The scatter is the standard
/// deviation of the bias from rest to rest within the control recordings. A smaller change hardly increases the errors
/// of corrected signals, because biases scatter by a similar amount within a recording.
const LEAST_SIZE: f64 = 3.0;
/// Minimum value of the smallest eigenvalue of the mean of `u u^T` over the rests, where u is the direction up. Below
/// this value, not all components of a change are observable. The eigenvalue is 1/3 for directions distributed
/// uniformly over the sphere.
const LEAST_SPREAD: f64 = 0.02;
/// For the accelerometer and for the gyroscope: the index of the first bias component among the parameters of a
/// calibration.
const BIASES: [usize; 2] = [0, 9];

/// Change of the biases from the calibration recordings to the control recordings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SessionStep {
    /// Change of the accelerometer's bias, m/s^2; `None` if it is not significant.
    pub accelerometer_mps2: Option<[f64; 3]>,
    /// Change of the gyroscope's bias, rad/s; `None` if it is not significant.
    pub gyroscope_radps: Option<[f64; 3]>,
    /// The smaller of the p-values of the significant changes.
    pub p_value: f64,
    /// Mean temperature of the control recordings minus mean temperature of the calibration recordings, K. `None` if
    /// any recording has no temperature.
    pub temperature_change_k: Option<f64>,
}

/// Change of the biases of one sensor, and the covariance of this change. The field `scatter` is the standard
/// deviation, from rest to rest, of the residuals after subtraction of the change.
struct Change {
    value: Vector3<f64>,
    covariance: Matrix3<f64>,
    scatter: Vector3<f64>,
}

impl Change {
    /// The change and its p-value. `None` if the change is not significant, or if it is at most [`LEAST_SIZE`] x
    /// scatter on all axes.
    fn significant(self) -> Option<(Vector3<f64>, f64)> {
        let solved = self.covariance.cholesky()?.solve(&self.value);
        let chance = p_value(self.value.dot(&solved), 3);
        let is_large = self.value.iter().zip(&self.scatter).any(|(value, scatter)| value.abs() > LEAST_SIZE * scatter);
        (chance < SIGNIFICANCE && is_large).then_some((self.value, chance))
    }
}

impl SessionStep {
    /// Estimates the changes of the biases of both sensors; `None` if neither change is significant. `is_corrected` is
    /// true if the mean readings at the rests in `evaluation` are already corrected, which is the case if the
    /// calibration has effects.
    pub(super) fn find(
        outcome: &Outcome,
        evaluation: &Evaluation,
        is_corrected: bool,
        [recordings, control]: [&[Recording<'_>]; 2],
    ) -> Option<Self> {
        let rests: Vec<&RestReport> = evaluation.rests.iter().filter(|rest| rest.excluded.is_none()).collect();
        if rests.len() < LEAST_RESTS {
            return None;
        }
        let Calibration { accelerometer, gyroscope, .. } = &outcome.calibration;
        let corrected = |triad: &Triad<f64>, mean: Vector3<f64>| if is_corrected { mean } else { triad.correct(mean) };
        let of_calibration = |triad: &Triad<f64>, first: usize| {
            let raw = Matrix3::from_fn(|i, j| outcome.covariance[first + i][first + j]);
            triad.inverse() * raw * triad.inverse().transpose()
        };
        let force = change_of_norms(&rests, |rest| corrected(accelerometer, rest.mean_specific_force));
        let rounding = |rest: &RestReport| {
            let inverse = if is_corrected { &Matrix3::identity() } else { gyroscope.inverse() };
            variance_by_axis(inverse, &rest.rate_rounding)
        };
        let rate = change_of_means(&rests, |rest| corrected(gyroscope, rest.mean_angular_rate), rounding);
        let with = |change: Change, triad: &Triad<f64>, first: usize| {
            Change { covariance: change.covariance + of_calibration(triad, first), ..change }.significant()
        };
        let force = force.and_then(|change| with(change, accelerometer, BIASES[0]));
        let rate = with(rate, gyroscope, BIASES[1]);
        let p_value = [force, rate].into_iter().flatten().map(|(_, chance)| chance).reduce(f64::min)?;
        let change = mean_degc(control).zip(mean_degc(recordings)).map(|(after, before)| after - before);
        Some(Self {
            accelerometer_mps2: force.map(|(value, _)| value.into()),
            gyroscope_radps: rate.map(|(value, _)| value.into()),
            p_value,
            temperature_change_k: change,
        })
    }

    fn changes(&self) -> [Vector3<f64>; 2] {
        [self.accelerometer_mps2, self.gyroscope_radps].map(|change| change.unwrap_or_default().into())
    }

    /// The given calibration with the biases that the sensors had in the control recordings.
    pub(super) fn calibration(&self, calibration: &Calibration<f64>) -> Option<Calibration<f64>> {
        let [force, rate] = self.changes();
        let moved = |triad: &Triad<f64>, change: Vector3<f64>| {
            Triad::try_new(*triad.sensitivity(), triad.bias() + triad.sensitivity() * change).ok()
        };
        let mut own = *calibration;
        own.accelerometer = moved(&calibration.accelerometer, force)?;
        own.gyroscope = moved(&calibration.gyroscope, rate)?;
        Some(own)
    }

    /// Converts samples corrected with the biases of the calibration to samples corrected with the biases of the
    /// control recordings.
    pub(super) fn corrected(&self, samples: &[CorrectedSamples]) -> Vec<CorrectedSamples> {
        let [force, rate] = self.changes();
        let less =
            |values: &[[f64; 3]], by: Vector3<f64>| values.iter().map(|v| (Vector3::from(*v) - by).into()).collect();
        samples.iter().map(|(of_rate, of_force)| (less(of_rate, rate), less(of_force, force))).collect()
    }
}

/// Change of the accelerometer's bias, by a least-squares fit to the norms of the specific force at the rests. `None`
/// if the directions of gravity at the rests do not determine all components of the change.
fn change_of_norms(rests: &[&RestReport], force: impl Fn(&RestReport) -> Vector3<f64>) -> Option<Change> {
    let (mut normal, mut right, mut spread) = (Matrix3::zeros(), Vector3::zeros(), Matrix3::zeros());
    for rest in rests {
        let up = force(rest).normalize();
        let weight = rest.norm_sigma_mps2.powi(-2);
        normal += weight * up * up.transpose();
        right += weight * rest.norm_error_mps2 * up;
        spread += up * up.transpose() / rests.len() as f64;
    }
    if spread.symmetric_eigenvalues().min() < LEAST_SPREAD {
        return None;
    }
    let inverse = normal.try_inverse()?;
    let value = inverse * right;
    let squares = |rest: &&RestReport| {
        let left = rest.norm_error_mps2 - force(rest).normalize().dot(&value);
        [left * left, (left / rest.norm_sigma_mps2).powi(2)]
    };
    let sums = rests.iter().map(squares).fold([0.0; 2], |sum, of| [sum[0] + of[0], sum[1] + of[1]]);
    let free = (rests.len() - 3) as f64;
    let covariance = inverse * (sums[1] / free).max(1.0);
    Some(Change { value, covariance, scatter: Vector3::repeat((sums[0] / free).sqrt()) })
}

/// Change of the gyroscope's bias: the mean of the corrected rates at the rests. The correction has already subtracted
/// the bias of the calibration. The error of the mean consists of the scatter between rests and of the rounding error.
/// The rounding error is common to all rests of a session (model.md (37)). `rounding` returns the variance of the
/// rounding error. The variance of the mean is doubled, because the bias of the calibration is a mean over the
/// calibration recordings and is assumed to have the same variance.
fn change_of_means(
    rests: &[&RestReport],
    rate: impl Fn(&RestReport) -> Vector3<f64>,
    rounding: impl Fn(&RestReport) -> Vector3<f64>,
) -> Change {
    let count = rests.len() as f64;
    let value = rests.iter().map(|rest| rate(rest)).sum::<Vector3<f64>>() / count;
    let squares: Vector3<f64> = rests.iter().map(|rest| (rate(rest) - value).map(|v| v * v)).sum();
    let (scatter, common) =
        (squares / (count - 1.0), rests.iter().map(|rest| rounding(rest)).sum::<Vector3<f64>>() / count);
    let variance = 2.0 * (scatter / count + common);
    Change { value, covariance: Matrix3::from_diagonal(&variance), scatter: (scatter + common).map(f64::sqrt) }
}

/// Mean temperature of all recordings; `None` if any recording has no temperature.
fn mean_degc(recordings: &[Recording<'_>]) -> Option<f64> {
    let mean = |recording: &Recording<'_>| {
        let finite = recording.temperature_degc?.iter().filter(|degc| degc.is_finite());
        let (sum, count) = finite.fold((0.0, 0.0), |(sum, count), degc| (sum + degc, count + 1.0));
        (count > 0.0).then_some(sum / count)
    };
    let means: Vec<f64> = recordings.iter().map(mean).collect::<Option<_>>()?;
    Some(means.iter().sum::<f64>() / means.len().max(1) as f64)
}
