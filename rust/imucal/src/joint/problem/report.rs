//! What the joint fit says.

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

/// The joint fit and what it leaves.
pub(crate) struct JointFit {
    pub(crate) model: Model,
    /// Of all parameters, symmetric frame.
    pub(crate) covariance: Mat<f64>,
    pub(crate) report: FitReport,
    pub(crate) scales: ResidualScales,
    /// How the biases were taken to wander.
    pub(crate) wander: Option<UnitWander>,
    /// Error of |f| at each rest and the standard deviation that noise explains, m/s^2; `None` for rests not used.
    pub(crate) norms: Vec<Option<(f64, f64)>>,
    /// Directions of gravity and rotation of each move.
    pub(crate) moves: Vec<(Ends, Matrix3<f64>)>,
    pub(crate) terms: Vec<TermEstimate>,
    /// Residuals and derivatives at its end.
    pub(crate) linear: Arc<Linear>,
    pub(crate) weights: Weights,
    pub(crate) priors: Vec<Prior>,
}

/// By how much residuals of each kind exceed what noise explains, and their standard deviations are widened; 1 where they do
/// not, or where there are none.
#[derive(Clone, Copy, Debug)]
pub struct ResidualScales {
    /// Norms of gravity at the rests.
    pub norms: f64,
    /// Directions of gravity carried over the moves.
    pub moves: f64,
    /// The force inside the moves.
    pub inside: f64,
    /// Attitudes against the encoders of the stand, at rests or in moves, whichever is larger.
    pub stand: f64,
}

/// One effect as it was estimated.
#[derive(Clone, Debug)]
pub struct TermEstimate {
    /// Its name.
    pub name: String,
    /// Linear parameters.
    pub values: Vec<f64>,
    /// Time constant or the like.
    pub shape: Option<f64>,
    /// Names of all its parameters, `<effect>_<parameter>`, the shape's last; a user's are numbered from 0.
    pub parameter_names: Vec<String>,
    /// Whether it is of the catalogue.
    pub in_catalogue: bool,
    /// `theta^T C^-1 theta` of its linear parameters: chi2 with as many degrees of freedom where the effect is absent.
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

/// Directions of gravity, what noise explains of their error, and the rotation of each move.
pub(crate) fn moves_of(linear: &Linear, weights: &Weights) -> Vec<(Ends, Matrix3<f64>)> {
    let ends = |m: &AtMove, sigma_rad: f64| Ends { before: m.before.up, after: m.after.up, sigma_rad };
    linear.moves.iter().zip(&weights.move_sigma_rad).map(|(m, sigma)| (ends(m, *sigma), m.pass.rotation)).collect()
}

/// `theta^T C^-1 theta`.
fn wald(covariance: &Mat<f64>, theta: &[f64]) -> f64 {
    use faer::prelude::Solve;
    let right = Mat::from_fn(theta.len(), 1, |i, _| theta[i]);
    let solved = covariance.col_piv_qr().solve(&right);
    (0..theta.len()).map(|i| theta[i] * solved[(i, 0)]).sum()
}
