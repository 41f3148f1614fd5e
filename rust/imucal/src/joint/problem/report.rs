//! Result of the joint fit.

use std::sync::Arc;

use faer::Mat;
use nalgebra::Matrix3;

use super::Joint;
use crate::error::Error;
use crate::joint::linear::{Linear, Source};
use crate::joint::model::Model;
use crate::joint::move_ends::AtMove;
use crate::joint::start::Prior;
use crate::joint::terms::Terms;
use crate::joint::wander::UnitWander;
use crate::joint::weights::Weights;
use crate::numerics::fit_report::FitReport;
use crate::numerics::lsq::Termination;
use crate::numerics::lsq::{self, Solution};
use crate::parameters::BASE;
use crate::rests::moves::Ends;

/// Result of the joint fit, with its residuals.
pub(crate) struct JointFit {
    pub(crate) model: Model,
    /// Covariance of all parameters, in the symmetric frame.
    pub(crate) covariance: Mat<f64>,
    pub(crate) report: FitReport,
    pub(crate) scales: ResidualScales,
    /// Model of the variation of the biases; `None` for constant biases.
    pub(crate) wander: Option<UnitWander>,
    /// Error of |f| at each rest and its standard deviation from noise, m/s^2; `None` for rests that are not used.
    pub(crate) norms: Vec<Option<(f64, f64)>>,
    /// Directions of gravity and rotation of each move.
    pub(crate) moves: Vec<(Ends, Matrix3<f64>)>,
    pub(crate) terms: Vec<TermEstimate>,
    /// Residuals and derivatives at the end of the fit.
    pub(crate) linear: Arc<Linear>,
    pub(crate) weights: Weights,
    pub(crate) priors: Vec<Prior>,
}

/// Factors on the standard deviations of each kind of residual, where its scatter exceeds the noise; 1 if it does not,
/// or if there are no such residuals.
#[derive(Clone, Copy, Debug)]
pub struct ResidualScales {
    /// Factor of the norms of gravity at the rests.
    pub norms: f64,
    /// Factor of the directions of gravity propagated over the moves.
    pub moves: f64,
    /// Factor of the forces inside the moves.
    pub inside: f64,
    /// Factor of the attitudes relative to the encoders of the stand: the larger one of rests and moves.
    pub stand: f64,
}

/// An estimated effect.
#[derive(Clone, Debug)]
pub struct TermEstimate {
    /// Name of the effect.
    pub name: String,
    /// Values of the linear parameters.
    pub values: Vec<f64>,
    /// Value of the shape, such as a time constant.
    pub shape: Option<f64>,
    /// Names of all parameters, `<effect>_<parameter>`, the shape last; those of a user-defined effect are numbered
    /// from 0.
    pub parameter_names: Vec<String>,
    /// Whether the effect is in the catalogue.
    pub in_catalogue: bool,
    /// Wald statistic `theta^T C^-1 theta` of the linear parameters. Without the effect it is chi-square distributed,
    /// with as many degrees of freedom as linear parameters.
    pub statistic: f64,
}

impl JointFit {
    pub(crate) fn new(
        problem: &Joint<'_>,
        terms: &Terms<'_>,
        solution: Solution,
        (iterations, have_settled): (u64, bool),
    ) -> Result<Self, Error> {
        let linear = problem.linear(&solution.parameters)?;
        let model = &linear.model;
        let covariance = lsq::covariance(&solution.jacobian);
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
        let scales = &problem.weights.scales;
        let mut report = FitReport { inflation: scales.largest(), iterations, ..FitReport::of(&solution) };
        if report.termination == Termination::Converged && !have_settled {
            report.termination = Termination::WeightsNotSettled;
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
            report,
            scales,
            wander,
            norms,
            moves,
            terms: estimates,
            weights: problem.weights.clone(),
            priors: problem.priors.clone(),
            linear,
        })
    }
}

/// Directions of gravity, their standard deviation from noise, and the rotation of each move.
pub(crate) fn moves_of(linear: &Linear, weights: &Weights) -> Vec<(Ends, Matrix3<f64>)> {
    let ends = |m: &AtMove, sigma_rad: f64| Ends { before: m.before.up, after: m.after.up, sigma_rad };
    linear.moves.iter().zip(&weights.move_sigma_rad).map(|(m, sigma)| (ends(m, *sigma), m.pass.rotation)).collect()
}

/// The Wald statistic `theta^T C^-1 theta`.
fn wald(covariance: &Mat<f64>, theta: &[f64]) -> f64 {
    use faer::prelude::Solve;
    let right = Mat::from_fn(theta.len(), 1, |i, _| theta[i]);
    let solved = covariance.col_piv_qr().solve(&right);
    (0..theta.len()).map(|i| theta[i] * solved[(i, 0)]).sum()
}
