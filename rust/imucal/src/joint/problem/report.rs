//! Result of a joint fit.

use std::sync::Arc;

use faer::Mat;
use nalgebra::Matrix3;

use super::Joint;
use crate::error::Error;
use crate::held::HeldParameter;
use crate::joint::linear::{Linear, Source};
use crate::joint::model::Model;
use crate::joint::move_ends::AtMove;
use crate::joint::start::{Prior, ShapePrior};
use crate::joint::terms::Terms;
use crate::joint::wander::UnitWander;
use crate::joint::weights::Weights;
use crate::numerics::fit_report::FitReport;
use crate::numerics::lsq::Termination;
use crate::numerics::lsq::{self, Solution};
use crate::numerics::second_order;
use crate::parameters::BASE;
use crate::rests::moves::Ends;

/// Result of a joint fit, with its residuals and weights.
pub(crate) struct JointFit {
    pub(crate) model: Model,
    /// Covariance of all parameters in the symmetric frame (the body frame in which the accelerometer sensitivity is a
    /// symmetric matrix). `second_order` is already added.
    pub(crate) covariance: Mat<f64>,
    /// Mean square of the second-order errors of the estimated parameters. These errors are due to the uncertainty of
    /// the held parameters (parameters with a prior, `crate::held`). `None` without held parameters.
    pub(crate) second_order: Option<Mat<f64>>,
    pub(crate) report: FitReport,
    pub(crate) scales: ResidualScales,
    /// Bias instability and random walk of the biases that the weights of the residuals assume; `None` for constant
    /// biases.
    pub(crate) wander: Option<UnitWander>,
    /// Residual of the norm |f| of the specific force at each rest, and its standard deviation from noise, m/s^2;
    /// `None` for rests that are not used.
    pub(crate) norms: Vec<Option<(f64, f64)>>,
    /// For each move: the gravity directions at its ends, and its rotation.
    pub(crate) moves: Vec<(Ends, Matrix3<f64>)>,
    pub(crate) terms: Vec<TermEstimate>,
    /// Residuals and Jacobian at the end of the fit.
    pub(crate) linear: Arc<Linear>,
    pub(crate) weights: Weights,
    pub(crate) priors: Vec<Prior>,
    pub(crate) shapes: Vec<ShapePrior>,
}

/// Ratio of scatter to noise for each kind of residuals. The fit multiplies the standard deviations of the residuals by
/// this ratio. The ratio is 1 if noise explains the residuals of the kind, or if the fit uses no residuals of the kind.
#[derive(Clone, Copy, Debug)]
pub struct ResidualScales {
    /// Ratio for the norms of the specific force at the rests.
    pub norms: f64,
    /// Ratio for the propagated gravity directions after the moves.
    pub moves: f64,
    /// Ratio for the specific force inside the moves.
    pub inside: f64,
    /// Ratio for attitudes relative to the encoders of the stand: the larger of the ratios for rests and for moves.
    pub stand: f64,
}

/// Estimate of one effect.
#[derive(Clone, Debug)]
pub struct TermEstimate {
    /// Name of the effect.
    pub name: String,
    /// Values of the linear parameters, in the units of the effect.
    pub values: Vec<f64>,
    /// Value of the nonlinear parameter, for example a time constant; `None` if there is none.
    pub shape: Option<f64>,
    /// Names of all parameters, `<effect>_<parameter>`, with the nonlinear parameter last. The parameters of a
    /// user-defined effect are numbered from 0.
    pub parameter_names: Vec<String>,
    /// Whether the effect is in the catalogue.
    pub in_catalogue: bool,
    /// Wald statistic `theta^T C^-1 theta` of the linear parameters theta with covariance C. If the true theta is zero,
    /// it has a chi2 distribution with as many degrees of freedom as there are linear parameters.
    pub statistic: f64,
}

impl JointFit {
    pub(crate) fn new(
        problem: &Joint<'_>,
        terms: &Terms<'_>,
        solution: Solution,
        (iterations, ending): (u64, Option<Termination>),
    ) -> Result<Self, Error> {
        let linear = problem.linear(&solution.parameters)?;
        let model = &linear.model;
        let mut covariance = lsq::covariance(&solution.jacobian);
        let second_order = problem.second_order(&linear, &solution, &covariance)?;
        if let Some(own) = &second_order {
            covariance += own;
        }
        require_finite(&solution.parameters, &covariance)?;
        let mut norms = vec![None; problem.prepared.rests.len()];
        let sigma = |k: usize| crate::rests::rest::sigma_norm(&problem.prepared.rests[k].rest, &model.accelerometer);
        for line in &linear.lines {
            if let Source::Norm(k) = line.source {
                norms[k] = Some((line.residual, sigma(k)));
            }
        }
        let estimates = terms
            .all
            .iter()
            .map(|term| {
                let own = BASE + term.first..BASE + term.first + term.linear;
                let block = Mat::from_fn(term.linear, term.linear, |i, j| covariance[(own.start + i, own.start + j)]);
                TermEstimate {
                    name: term.name().to_owned(),
                    values: solution.parameters[own.clone()].to_vec(),
                    shape: term.has_shape().then(|| solution.parameters[own.end]),
                    parameter_names: term.parameter_names(),
                    in_catalogue: term.effect().is_some(),
                    statistic: wald(&block, &solution.parameters[own]),
                }
            })
            .collect();
        let scales = &problem.weights.widening.scales;
        let mut report = FitReport { inflation: scales.largest(), iterations, ..FitReport::of(&solution) };
        // The gradient test shows whether the last minimisation has converged, but not whether the weights have
        // converged. If the weights have not converged, `ending` contains the reason.
        if let Some(ending) = ending.filter(|_| report.termination == Termination::Converged) {
            report.termination = ending;
        }
        let scales = ResidualScales {
            norms: scales.norms,
            moves: scales.moves,
            inside: scales.inside,
            stand: scales.stand_rests.max(scales.stand_moves),
        };
        let moves = moves_of(&linear, &problem.weights);
        let wander = problem.wander(model);
        Ok(Self {
            model: model.clone(),
            covariance,
            second_order,
            report,
            scales,
            wander,
            norms,
            moves,
            terms: estimates,
            weights: problem.weights.clone(),
            priors: problem.priors.clone(),
            shapes: problem.shapes.clone(),
            linear,
        })
    }
}

impl Joint<'_> {
    /// Computes the mean square of the second-order errors of the estimated parameters, which are due to the
    /// uncertainty of the held parameters (parameters with a prior, `crate::held`). `None` without held parameters.
    /// Also `None` if the only priors are those of an accelerometer that was calibrated earlier, because their standard
    /// deviations are so small that second-order errors are negligible. `covariance` is the covariance of the
    /// parameters without second-order errors.
    fn second_order(
        &self,
        linear: &Linear,
        found: &Solution,
        covariance: &Mat<f64>,
    ) -> Result<Option<Mat<f64>>, Error> {
        let held = self.prepared.held;
        if held.iter().all(HeldParameter::is_combination) {
            return Ok(None);
        }
        let first = linear.groups().stand_moves.end;
        // The samples are integrated again, because a first-order update does not contain second-order terms.
        let residuals_at = |parameters: &[f64]| Ok(self.whiten(&self.prepared.linearise(self.terms, parameters)?).0);
        let gain = covariance * found.jacobian.transpose();
        second_order::mean_square(found, &gain, first..first + held.len(), residuals_at).map(Some)
    }
}

/// Returns an error if a parameter or its covariance is not finite. The fit has then diverged.
fn require_finite(parameters: &[f64], covariance: &Mat<f64>) -> Result<(), Error> {
    if parameters.iter().all(|value| value.is_finite()) && covariance.is_all_finite() {
        return Ok(());
    }
    let message = "the joint fit diverged: its parameters or their covariance are not finite: leave effects out, check \
                   units, or leave out the recording or the axis that differs from the others";
    Err(Error::Fit(message.into()))
}

/// Collects, for each move: the gravity directions at its ends, the rotation, and the standard deviation of the
/// direction residual from noise only.
pub(crate) fn moves_of(linear: &Linear, weights: &Weights) -> Vec<(Ends, Matrix3<f64>)> {
    let ends = |m: &AtMove, sigma_rad: f64| Ends { before: m.before.up, after: m.after.up, sigma_rad };
    linear.moves.iter().zip(&weights.move_sigma_rad).map(|(m, sigma)| (ends(m, *sigma), m.pass.rotation)).collect()
}

/// Wald statistic `theta^T C^-1 theta` of parameters theta with the covariance C.
fn wald(covariance: &Mat<f64>, theta: &[f64]) -> f64 {
    use faer::prelude::Solve;
    let right = Mat::from_fn(theta.len(), 1, |i, _| theta[i]);
    let solved = covariance.col_piv_qr().solve(&right);
    (0..theta.len()).map(|i| theta[i] * solved[(i, 0)]).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fit_that_is_not_finite_is_a_named_error() {
        let (parameters, covariance) = (vec![1.0, 2.0], Mat::<f64>::identity(2, 2));
        assert!(require_finite(&parameters, &covariance).is_ok());
        for value in [f64::NAN, f64::INFINITY] {
            let mut unknown = covariance.clone();
            unknown[(1, 0)] = value;
            let fits = [(vec![1.0, value], covariance.clone()), (parameters.clone(), unknown)];
            for (parameters, covariance) in fits {
                let error = require_finite(&parameters, &covariance).unwrap_err();
                assert!(matches!(&error, Error::Fit(message) if message.contains("not finite")), "{error}");
            }
        }
    }
}
