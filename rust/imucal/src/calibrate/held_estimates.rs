//! Estimates of parameters with a prior: how much the recordings determine these parameters, and which part of the
//! covariance is due to the priors (model.md (40)).
//!
//! ```text
//! B = (C H^T) (C H^T)^T,     share of the priors in the variance of parameter j: B_jj / C_jj
//! ```
//!
//! C is the covariance of the estimated parameters, and B is the part of C that is due to the priors. Each prior adds a
//! residual to the fit: the difference between parameter and prior, divided by the standard deviation of the prior. H
//! contains the derivatives of these residuals with respect to the parameters.

use std::f64::consts::FRAC_PI_2;

use faer::Mat;
use imucal_core::sensor::Triad;
use nalgebra::{Matrix3, SMatrix, Vector3};

use crate::held::{GROUPS, HeldParameter, PriorCost, PriorSource};
use crate::joint::force_by_parameters;
use crate::parameters::{ACCEL, GYRO_SENSITIVITY};

/// A held parameter (a parameter with a prior) is reported as not determined by the recordings if (variance due to the
/// priors) / (variance of the parameter) is above this value. The recordings then contain less information about the
/// parameter than the priors.
const MAX_PRIOR_SHARE: f64 = 0.5;
/// A contradiction between the recordings and a prior is reported if |value from the recordings - prior| is above this
/// number of standard deviations of this difference. Without a contradiction, the difference exceeds this limit with a
/// probability of 6e-7.
const MAX_CONTRADICTION: f64 = 5.0;

/// One held parameter with its prior and its estimate.
#[derive(Clone, Debug)]
pub struct HeldEstimate {
    /// The held parameter with the value and the standard deviation of its prior.
    pub prior: HeldParameter,
    /// Estimate from the recordings and the prior, in the unit of the prior.
    pub estimate: f64,
    /// Standard deviation of the estimate, in the unit of the prior.
    pub sigma: f64,
    /// Share of the variance of the estimate that is due to the priors. It is 1 if the recordings contain no
    /// information about the parameter, and near 0 if they determine it accurately.
    pub prior_share: f64,
    /// Difference between the prior value and the value from the recordings alone, in standard deviations of this
    /// difference. `None` if the standard deviation of the value from the recordings alone is not smaller than the
    /// typical spread of the parameter among MEMS sensors. For an accelerometer without a gyroscope, it is always
    /// `None`.
    pub contradiction: Option<f64>,
}

impl HeldEstimate {
    /// Whether the recordings contain more information about the parameter than the priors.
    pub(super) fn is_determined(&self) -> bool {
        self.prior_share <= MAX_PRIOR_SHARE
    }

    /// Whether the recordings do not determine the parameter, and its prior is the default for MEMS sensors.
    pub(super) fn is_unknown(&self) -> bool {
        self.prior.source == PriorSource::Default && !self.is_determined()
    }

    /// Whether the recordings contradict the prior.
    pub(super) fn is_contradicted(&self) -> bool {
        self.contradiction.is_some_and(|sigmas| sigmas.abs() > MAX_CONTRADICTION)
    }
}

/// Returns the estimates of the held parameters `held`, and the part B of the covariance that is due to their priors.
/// Both are computed from the parameters and the covariance of a fit with these held parameters. `residuals` is empty
/// or has one entry for each held parameter: the residual (estimate - prior value) divided by its standard deviation,
/// and one minus the leverage of this residual. One minus the leverage is the variance of the residual divided by the
/// variance of the prior.
pub(super) fn held_estimates(
    (parameters, covariance): (&[f64], &Mat<f64>),
    held: &[HeldParameter],
    residuals: &[Option<(f64, f64)>],
) -> (Vec<HeldEstimate>, Mat<f64>) {
    let n = covariance.ncols();
    let mut rows = Mat::<f64>::zeros(held.len(), n);
    for (row, held) in held.iter().enumerate() {
        held.row(parameters).derivatives.into_iter().for_each(|(p, by)| rows[(row, p)] += by);
    }
    let by_prior = covariance * rows.transpose();
    let between = &rows * &by_prior;
    let estimate = |k: usize| {
        let variance = between[(k, k)];
        let from_priors: f64 = (0..held.len()).map(|other| between[(k, other)].powi(2)).sum();
        HeldEstimate {
            estimate: held[k].estimate(parameters),
            sigma: held[k].sigma * variance.sqrt(),
            prior_share: (from_priors / variance).min(1.0),
            contradiction: residuals.get(k).copied().flatten().and_then(|residual| contradiction(&held[k], residual)),
            prior: held[k].clone(),
        }
    };
    ((0..held.len()).map(estimate).collect(), &by_prior * by_prior.transpose())
}

/// Returns the difference between the prior value and the value from the recordings alone, in standard deviations of
/// this difference. `None` if the standard deviation of the value from the recordings alone is not smaller than the
/// typical spread of the parameter among MEMS sensors. If the recordings determine the parameter so poorly, their
/// information about it comes only from the nonlinearity of the model, and is no evidence against the prior. `residual`
/// is (estimate - prior value) divided by its standard deviation, and `free` is one minus the leverage of `residual`.
/// (estimate - prior value) is proportional to (value from the recordings - prior value). Both differences are equal if
/// each is divided by its standard deviation, so `residual` is the result.
fn contradiction(held: &HeldParameter, (residual, free): (f64, f64)) -> Option<f64> {
    let of_recordings = held.sigma * ((1.0 - free) / free).sqrt();
    held.usual.is_none_or(|usual| of_recordings < usual).then_some(residual)
}

/// Computes the error of a measured gravity direction and the error of a measured rotation by 90 deg if the errors of
/// the parameters have the covariance `covariance` (symmetric frame). Each error is a standard deviation, averaged
/// (rms) over the gravity directions or rotation axes that [`directions`] returns.
pub(super) fn prior_cost(covariance: &Mat<f64>, accelerometer: &Triad<f64>, gyroscope: &Triad<f64>) -> PriorCost {
    let block = |first: usize| SMatrix::<f64, 9, 9>::from_fn(|i, j| covariance[(first + i, first + j)]);
    let (force, rate) = (block(ACCEL.start), block(GYRO_SENSITIVITY.start));
    let directions = directions();
    let mean = |variance: &dyn Fn(&Vector3<f64>) -> f64| {
        (directions.iter().map(variance).sum::<f64>() / directions.len() as f64).max(0.0).sqrt().to_degrees()
    };
    let gravity = |up: &Vector3<f64>| {
        // The direction error that a bias causes is inversely proportional to the magnitude of the force. Standard
        // gravity is used as this magnitude.
        let g = super::STANDARD_GRAVITY_MPS2;
        let across = (Matrix3::identity() - up * up.transpose()) * force_by_parameters(accelerometer, &(up * g)) / g;
        (across * force * across.transpose()).trace()
    };
    let turned = |axis: &Vector3<f64>| {
        let by = SMatrix::<f64, 3, 9>::from_fn(|row, p| gyroscope.inverse()[(row, p / 3)] * axis[p % 3] * FRAC_PI_2);
        (by * rate * by.transpose()).trace()
    };
    PriorCost { gravity_direction_deg: mean(&gravity), rotation_deg: mean(&turned) }
}

/// Returns the unit vectors from the centre of a cube to its faces, edges and corners.
fn directions() -> Vec<Vector3<f64>> {
    let signs = [-1.0, 0.0, 1.0];
    let all = signs.into_iter().flat_map(|x| signs.into_iter().flat_map(move |y| signs.map(|z| Vector3::new(x, y, z))));
    all.filter(|v| v.norm() > 0.0).map(|v| v.normalize()).collect()
}

/// Lists the names of the parameters in `held` for a message. `all` contains all held parameters. A group such as
/// `accel_scale` contains the parameters whose names have this beginning, for example `accel_scale_x`. A group
/// is listed by its name if `all` contains at least two of its parameters and `held` contains the same parameters.
pub(super) fn listed(held: &[&HeldEstimate], all: &[HeldEstimate]) -> String {
    let mut names = Vec::new();
    for group in GROUPS {
        let is_of = |h: &&HeldEstimate| h.prior.name.rsplit_once('_').is_some_and(|(own, _)| own == group);
        let own: Vec<&HeldEstimate> = held.iter().copied().filter(|h| is_of(h)).collect();
        if own.len() > 1 && own.len() == all.iter().filter(|h| is_of(h)).count() {
            names.push(group.to_owned());
        } else {
            names.extend(own.iter().map(|h| h.prior.name.clone()));
        }
    }
    names.join(", ")
}
