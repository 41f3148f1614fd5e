//! Reports why a fit ended, and whether its result is an optimum.
//!
//! The gradient test uses the decrease of chi2 that the linear model at the result predicts for an undamped step,
//!
//! ```text
//! |P r|^2,   P is the projection onto the column space of the Jacobian J, r are the whitened residuals
//! ```
//!
//! The predicted decrease does not depend on the units of the parameters. A parameter at a distance of one standard
//! deviation from its optimum contributes one to this decrease.

use faer::Mat;

use crate::numerics::lsq::{Solution, Termination, singular_of_triangle};

/// A fit has converged if the predicted decrease of chi2 is at most this limit. If chi2 / (degrees of freedom) is above
/// 1, the decrease is first divided by this ratio. At the limit, every parameter of the linear model is within a tenth
/// of a standard deviation of its optimum. A distance of a tenth of a standard deviation increases the rms error of a
/// parameter by half a per cent.
const LARGEST_DECREASE: f64 = 1e-2;

/// Quality of a fit, and the reason for its end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FitReport {
    /// Sum of the squared residuals. Each residual is divided by the standard deviation of its noise.
    pub chi2: f64,
    /// Number of residuals minus number of parameters.
    pub degrees_of_freedom: usize,
    /// Factor by which the standard deviations of the parameters are increased. It exceeds 1 only if chi2 is above
    /// its expected value by more than three standard deviations, so that noise does not explain the residuals.
    pub inflation: f64,
    /// Number of iterations of the solver.
    pub iterations: u64,
    /// Reason for the end of the fit.
    pub termination: Termination,
    /// Decrease of chi2 that the linear model at the result predicts for an undamped step.
    pub predicted_decrease: f64,
}

impl FitReport {
    /// The report of the fit that ended with `solution`.
    pub(crate) fn of(solution: &Solution) -> Self {
        let degrees_of_freedom = solution.residuals.nrows().saturating_sub(solution.parameters.len());
        // Even without model errors, chi2 / dof scatters about one with a standard deviation of sqrt(2 / dof). If the
        // standard deviations of the parameters were increased for every ratio chi2 / dof above one, they would be too
        // large on average.
        let reduced = solution.chi2 / degrees_of_freedom.max(1) as f64;
        let predicted_decrease = predicted_decrease(&solution.residuals, &solution.jacobian);
        let passes = predicted_decrease <= LARGEST_DECREASE * reduced.max(1.0);
        Self {
            chi2: solution.chi2,
            degrees_of_freedom,
            inflation: if reduced > significance_limit(degrees_of_freedom.max(1) as f64) {
                reduced.sqrt()
            } else {
                1.0
            },
            iterations: solution.iterations,
            termination: match solution.termination {
                Termination::NotFinite => Termination::NotFinite,
                _ if passes => Termination::Converged,
                // The solver ended because the last step was negligible. However, the step was so short only because of
                // strong damping, and the gradient test shows that the optimum is not reached.
                Termination::Converged => Termination::Stalled,
                other => other,
            },
            predicted_decrease,
        }
    }

    /// Explains why the result of the fit `name` is not an optimum; `None` if the fit has converged.
    pub fn reason(&self, name: &str) -> Option<String> {
        let Self { iterations, predicted_decrease, .. } = self;
        let why = match self.termination {
            Termination::Converged => return None,
            Termination::Stalled => format!(
                "stalled after {iterations} iterations: no step decreases chi2, although its gradient predicts a decrease \
                 by {predicted_decrease:.1e}"
            ),
            Termination::IterationLimit => format!(
                "reached its limit of {iterations} iterations, and its gradient predicts a further decrease of chi2 by \
                 {predicted_decrease:.1e}"
            ),
            Termination::NotFinite => format!("has residuals that are not finite after {iterations} iterations"),
            Termination::WeightsNotSettled => {
                format!("ended after {iterations} iterations with weights of its residuals that had not settled")
            }
            Termination::FieldsNotSettled => {
                return Some(format!(
                    "{name} ended with the field of a user-defined effect that still changed from fit to fit: the result \
                     is not its optimum; the field depends too strongly on the corrected rate and force, or has a kink \
                     there: make it a smooth function of them"
                ));
            }
        };
        Some(format!(
            "{name} {why}: the result is not its optimum; estimate fewer effects, or record more poses and moves"
        ))
    }
}

/// Largest value of chi2 / (degrees of freedom) that noise explains: three standard deviations above the expected value
/// of one.
pub(crate) fn significance_limit(degrees_of_freedom: f64) -> f64 {
    1.0 + 3.0 * (2.0 / degrees_of_freedom).sqrt()
}

/// Decrease of chi2, `|P r|^2`, that the linear model predicts. r are the residuals, and P is the projection onto the
/// column space of the Jacobian.
fn predicted_decrease(residuals: &Mat<f64>, jacobian: &Mat<f64>) -> f64 {
    /// The predicted decrease omits directions in parameter space (right singular vectors of the Jacobian) whose
    /// singular value is at most this number x the largest singular value, because the residuals do not determine them.
    const DETERMINED: f64 = 1e-12;
    let Some((projected, values)) = singular_of_triangle(residuals, jacobian) else {
        return f64::INFINITY;
    };
    let largest = values.iter().fold(0.0, |largest: f64, value| largest.max(*value));
    projected.iter().zip(&values).filter(|(_, value)| **value > DETERMINED * largest).map(|(part, _)| part * part).sum()
}

#[cfg(test)]
mod tests;
