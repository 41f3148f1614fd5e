//! Solves nonlinear least-squares problems: finds the parameters p that minimise the sum of squares |r(p)|^2 of the
//! residuals r. The method is that of Levenberg and Marquardt, with an analytic Jacobian J.
//!
//! The solver implements the `Solver` trait of the crate argmin, with the matrices of the crate faer. The `Executor` of
//! argmin runs the solver, and limits and counts the iterations. A step h minimises `|J h + r|^2 + lambda |D h|^2`. The
//! step is computed by QR decomposition of `[R; sqrt(lambda) D]`, where R is the triangular factor of the QR
//! decomposition of J. The diagonal matrix D contains, for each parameter, the largest norm that its column of J has
//! had so far. Because of D, the result does not depend on the units of the parameters.

use argmin::core::{Executor, IterState, KV, Problem, Solver, State, TerminationReason, TerminationStatus};
use faer::Mat;
use faer::prelude::SolveLstsq;

use crate::cancellation::checkpoint;
use crate::error::Error;

/// Residuals and their Jacobian as functions of the parameters.
pub(crate) trait Residuals {
    /// Writes the residuals (m x 1) and their Jacobian (m x n) at `parameters`.
    fn evaluate(&self, parameters: &[f64], residuals: &mut Mat<f64>, jacobian: &mut Mat<f64>);
    /// Number m of residuals.
    fn count(&self) -> usize;
}

/// Reason why a fit ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Termination {
    /// The result is an optimum: the gradient test of [`FitReport`](crate::numerics::fit_report::FitReport) is passed.
    Converged,
    /// No step decreases chi2, or the steps are negligible, but the gradient test is not passed.
    Stalled,
    /// The iteration limit was reached, and the gradient test is not passed.
    IterationLimit,
    /// A residual became NaN or infinite.
    NotFinite,
    /// The fit is repeated with updated weights of the residuals, and the weights still changed in the last repetition.
    WeightsNotSettled,
    /// The field of a user-defined effect (the derivatives of the sensor error with respect to the parameters of the
    /// effect) depends on the calibration. These derivatives still changed in the last repetition of the fit.
    FieldsNotSettled,
}

/// The end point of a fit, with its residuals and Jacobian.
#[derive(Clone, Debug)]
pub(crate) struct Solution {
    /// Parameters at the end of the fit.
    pub(crate) parameters: Vec<f64>,
    /// Residuals at the final parameters, m x 1.
    pub(crate) residuals: Mat<f64>,
    /// Jacobian of the residuals at the final parameters, m x n.
    pub(crate) jacobian: Mat<f64>,
    /// Sum of the squared residuals at the final parameters.
    pub(crate) chi2: f64,
    /// Number of iterations of the solver.
    pub(crate) iterations: u64,
    /// Reason for the end of the iterations, as the solver reports it. It does not depend on the gradient test of the
    /// fit report.
    pub(crate) termination: Termination,
}

impl Solution {
    /// A fit before its first iteration: the start parameters, with their residuals and Jacobian.
    pub(crate) fn at(parameters: &[f64], residuals: Mat<f64>, jacobian: Mat<f64>) -> Self {
        Self {
            parameters: parameters.to_vec(),
            chi2: sum_of_squares(&residuals),
            residuals,
            jacobian,
            iterations: 0,
            termination: Termination::IterationLimit,
        }
    }
}

/// Tolerance of a fit that gives a final result. Such a fit has converged if |D h| <= tolerance x |D p|, where h is the
/// last step and p the vector of parameters. The diagonal matrix D scales each parameter by the norm of its column of
/// the Jacobian. If the model describes the data, the steps decrease rapidly near the optimum, so the remaining
/// distance to the optimum is smaller than the last step by orders of magnitude.
pub(crate) const EXACT: f64 = 1e-10;
/// Tolerance of a fit that only gives a start value: the limit of the relative length |D h| / |D p| of the last step
/// (see [`EXACT`]).
pub(crate) const ROUGH: f64 = 1e-3;
/// Maximum number of iterations of a fit. A convergent fit needs far fewer iterations.
pub(crate) const ITERATION_LIMIT: u64 = 200;
/// Maximum damping lambda. If lambda exceeds this limit, the fit ends as stalled. With a larger lambda, a step would be
/// smaller than the rounding errors of the parameters.
const MAX_DAMPING: f64 = 1e16;

/// Minimises the sum of squared residuals from `start` until the relative length of a step is below `tolerance`.
pub(crate) fn minimize<R: Residuals>(problem: &R, start: &[f64], tolerance: f64) -> Result<Solution, Error> {
    minimize_within(problem, start, tolerance, ITERATION_LIMIT)
}

/// Minimises like [`minimize`], with at most `iterations` iterations.
pub(crate) fn minimize_within<R: Residuals>(
    problem: &R,
    start: &[f64],
    tolerance: f64,
    iterations: u64,
) -> Result<Solution, Error> {
    let solver = LevenbergMarquardt::new(problem.count(), start.len(), tolerance);
    let outcome = Executor::new(problem, solver)
        .configure(|state| state.param(start.to_vec()).max_iters(iterations))
        .timer(false)
        .run()
        .map_err(|error| Error::Fit(error.to_string()))?;
    let iterations = outcome.state.get_iter();
    let solver = outcome.solver;
    Ok(Solution {
        parameters: outcome.state.param.unwrap_or_default(),
        chi2: solver.chi2,
        residuals: solver.residuals,
        jacobian: solver.jacobian,
        iterations,
        termination: solver.termination.unwrap_or(Termination::IterationLimit),
    })
}

/// Covariance `(J^T J)^-1` of the parameters for whitened residuals. It is computed by QR of the Jacobian with scaled
/// columns.
///
/// The Jacobian must have full rank, which the caller has to check. With a lower rank, the entries of the result are
/// not finite.
pub(crate) fn covariance(jacobian: &Mat<f64>) -> Mat<f64> {
    let n = jacobian.ncols();
    let scale = column_norms(jacobian);
    // If J has fewer rows than columns, rows of zeros are added, so that R is square.
    let rows = jacobian.nrows();
    let scaled = Mat::from_fn(rows.max(n), n, |i, j| if i < rows { jacobian[(i, j)] / scale[j] } else { 0.0 });
    let qr = scaled.qr();
    let r_inverse = {
        let mut inverse = Mat::<f64>::identity(n, n);
        qr.thin_R().solve_upper_triangular_in_place(&mut inverse);
        inverse
    };
    let c = &r_inverse * r_inverse.transpose();
    Mat::from_fn(n, n, |i, j| c[(i, j)] / (scale[i] * scale[j]))
}

/// Matrix `(J^T J)^-1 J^T`. If the whitened residuals at fixed parameters change by d, the estimate changes by minus
/// this matrix times d, to first order.
pub(crate) fn gain(jacobian: &Mat<f64>) -> Mat<f64> {
    covariance(jacobian) * jacobian.transpose()
}

/// Leverages of the residuals: the diagonal of the projection matrix `J (J^T J)^-1 J^T`. Columns of the Jacobian that
/// are zero are ignored.
pub(crate) fn leverages(jacobian: &Mat<f64>) -> Vec<f64> {
    let (rows, norms) = (jacobian.nrows(), column_norms(jacobian));
    let own: Vec<usize> =
        (0..jacobian.ncols()).filter(|j| jacobian.col(*j).iter().any(|value| *value != 0.0)).collect();
    if rows < own.len() {
        return vec![1.0; rows];
    }
    let mut q = Mat::from_fn(rows, own.len(), |i, j| jacobian[(i, own[j])] / norms[own[j]]);
    // Q is computed as J R^-1. This product is several times faster than computing Q from the Householder reflectors.
    q.qr().thin_R().transpose().solve_lower_triangular_in_place(q.transpose_mut());
    let mut leverages = vec![0.0; rows];
    for j in 0..own.len() {
        leverages.iter_mut().zip(q.col_as_slice(j)).for_each(|(sum, value)| *sum += value * value);
    }
    // With nearly dependent columns, rounding errors could give leverages above one.
    leverages.iter().map(|leverage| leverage.min(1.0)).collect()
}

/// Singular values (descending) and right singular vectors (columns) of `matrix`, which may have any shape.
///
/// They are computed by an SVD of the factor R of the QR decomposition. If the SVD does not converge, they are computed
/// from the eigenvalues and eigenvectors of R^T R.
pub(crate) fn singular(matrix: &Mat<f64>) -> Result<(Vec<f64>, Mat<f64>), Error> {
    let n = matrix.ncols();
    let r = Mat::from_fn(n.max(matrix.nrows()), n, |i, j| if i < matrix.nrows() { matrix[(i, j)] } else { 0.0 })
        .qr()
        .thin_R()
        .to_owned();
    if let Ok(svd) = r.thin_svd() {
        let values = (0..n).map(|i| svd.S()[i]).collect();
        return Ok((values, svd.V().to_owned()));
    }
    let eigen = (r.transpose() * &r)
        .self_adjoint_eigen(faer::Side::Lower)
        .map_err(|_| Error::Fit("the singular value decomposition did not converge: check the data".into()))?;
    let values = (0..n).rev().map(|i| eigen.S()[i].max(0.0).sqrt()).collect();
    Ok((values, Mat::from_fn(n, n, |i, j| eigen.U()[(i, n - 1 - j)])))
}

/// Returns the components of the residuals along the left singular vectors of the Jacobian, and the singular values of
/// the Jacobian. The columns of the Jacobian are first scaled to unit length. `None` if a value is not finite.
pub(crate) fn singular_of_triangle(residuals: &Mat<f64>, jacobian: &Mat<f64>) -> Option<(Vec<f64>, Vec<f64>)> {
    let (n, norms) = (jacobian.ncols(), column_norms(jacobian));
    let rows = jacobian.nrows();
    let both = Mat::from_fn(rows.max(n + 1), n + 1, |i, j| match j {
        _ if i >= rows => 0.0,
        j if j < n => jacobian[(i, j)] / norms[j],
        _ => residuals[(i, 0)],
    });
    let r = both.qr().thin_R().to_owned();
    let svd = r.submatrix(0, 0, n, n).thin_svd().ok()?;
    let projected = svd.U().transpose() * r.submatrix(0, n, n, 1);
    let (projected, values): (Vec<f64>, Vec<f64>) = (0..n).map(|k| (projected[(k, 0)], svd.S()[k])).unzip();
    projected.iter().chain(&values).all(|value| value.is_finite()).then_some((projected, values))
}

fn column_norms(matrix: &Mat<f64>) -> Vec<f64> {
    (0..matrix.ncols()).map(|j| matrix.col(j).norm_l2()).map(|norm| if norm > 0.0 { norm } else { 1.0 }).collect()
}

fn sum_of_squares(residuals: &Mat<f64>) -> f64 {
    residuals.col(0).squared_norm_l2()
}

type FitState = IterState<Vec<f64>, (), (), (), (), f64>;

struct LevenbergMarquardt {
    residuals: Mat<f64>,
    jacobian: Mat<f64>,
    /// Residuals at the parameters after the step that is being tried.
    trial_residuals: Mat<f64>,
    trial_jacobian: Mat<f64>,
    /// Diagonal of D: for each parameter, the largest norm of its column of the Jacobian so far.
    scale: Vec<f64>,
    chi2: f64,
    tolerance: f64,
    lambda: f64,
    /// Factor by which lambda increases if the next step is rejected.
    growth: f64,
    termination: Option<Termination>,
}

impl LevenbergMarquardt {
    fn new(m: usize, n: usize, tolerance: f64) -> Self {
        Self {
            residuals: Mat::zeros(m, 1),
            jacobian: Mat::zeros(m, n),
            trial_residuals: Mat::zeros(m, 1),
            trial_jacobian: Mat::zeros(m, n),
            scale: vec![0.0; n],
            chi2: f64::INFINITY,
            tolerance,
            lambda: 1e-4,
            growth: 2.0,
            termination: None,
        }
    }

    /// The step h for the present damping lambda, and the decrease of chi2 that the linear model predicts for this
    /// step.
    fn step(&self) -> (Vec<f64>, f64) {
        let n = self.scale.len();
        // The residuals r are appended to J as a column. The factor R then contains Q^T r, and Q itself is not needed.
        let both = faer::concat![[self.jacobian, self.residuals]];
        let qr = both.qr();
        let r = qr.thin_R();
        let rows = r.nrows().min(n);
        let damped = Mat::from_fn(rows + n, n, |i, j| match i.checked_sub(rows) {
            None if i <= j => r[(i, j)],
            None => 0.0,
            Some(k) if k == j => self.lambda.sqrt() * self.scale[j],
            Some(_) => 0.0,
        });
        let rhs = Mat::from_fn(rows + n, 1, |i, _| if i < rows { -r[(i, n)] } else { 0.0 });
        let h = damped.col_piv_qr().solve_lstsq(&rhs);
        let predicted = &self.jacobian * h.subrows(0, n) + &self.residuals;
        let step: Vec<f64> = (0..n).map(|i| h[(i, 0)]).collect();
        (step, self.chi2 - sum_of_squares(&predicted))
    }

    fn length(&self, vector: &[f64]) -> f64 {
        vector.iter().zip(&self.scale).map(|(v, s)| (v * s).powi(2)).sum::<f64>().sqrt()
    }

    fn update_scale(&mut self) {
        let norms = column_norms(&self.jacobian);
        for (scale, norm) in self.scale.iter_mut().zip(norms) {
            *scale = scale.max(norm);
        }
    }
}

impl<R: Residuals> Solver<&R, FitState> for LevenbergMarquardt {
    fn name(&self) -> &str {
        "Levenberg-Marquardt"
    }

    fn init(
        &mut self,
        problem: &mut Problem<&R>,
        mut state: FitState,
    ) -> Result<(FitState, Option<KV>), argmin::core::Error> {
        let start = state.take_param().unwrap_or_default();
        let (residuals, jacobian) = (&mut self.residuals, &mut self.jacobian);
        problem.problem("evaluations", |p| {
            p.evaluate(&start, residuals, jacobian);
            Ok(())
        })?;
        self.chi2 = sum_of_squares(&self.residuals);
        self.update_scale();
        if !self.chi2.is_finite() {
            self.termination = Some(Termination::NotFinite);
        }
        Ok((state.param(start).cost(self.chi2), None))
    }

    fn next_iter(
        &mut self,
        problem: &mut Problem<&R>,
        mut state: FitState,
    ) -> Result<(FitState, Option<KV>), argmin::core::Error> {
        checkpoint();
        let current = state.take_param().unwrap_or_default();
        let (step, predicted) = self.step();
        let negligible = self.length(&step) <= self.tolerance * self.length(&current);
        let trial: Vec<f64> = current.iter().zip(&step).map(|(p, h)| p + h).collect();
        if negligible {
            // The residuals are not computed again after this last step. With the tolerance `EXACT`, the step changes
            // the residuals only by rounding errors. With the tolerance `ROUGH`, the result is only a start value of
            // another fit.
            self.termination = Some(Termination::Converged);
            return Ok((state.param(trial).cost(self.chi2), None));
        }
        let (residuals, jacobian) = (&mut self.trial_residuals, &mut self.trial_jacobian);
        problem.problem("evaluations", |p| {
            p.evaluate(&trial, residuals, jacobian);
            Ok(())
        })?;
        let chi2 = sum_of_squares(&self.trial_residuals);
        let ratio = (self.chi2 - chi2) / predicted;
        // Comparisons with NaN are false. A step with residuals that are not finite is therefore rejected.
        let accepted = chi2 < self.chi2;
        // Nielsen's update of lambda (IMM-REP-1999-05). It is a smooth function of the gain ratio (actual decrease of
        // chi2 divided by predicted decrease) and needs no thresholds.
        if accepted {
            std::mem::swap(&mut self.residuals, &mut self.trial_residuals);
            std::mem::swap(&mut self.jacobian, &mut self.trial_jacobian);
            self.chi2 = chi2;
            self.update_scale();
            self.lambda = (self.lambda * (1.0 - (2.0 * ratio - 1.0).powi(3)).max(1.0 / 3.0)).max(1e-20);
            self.growth = 2.0;
        } else {
            self.lambda *= self.growth;
            self.growth *= 2.0;
        }
        if !accepted && self.lambda > MAX_DAMPING {
            self.termination = Some(Termination::Stalled);
        }
        let next = if accepted { trial } else { current };
        Ok((state.param(next).cost(self.chi2), None))
    }

    fn terminate(&mut self, _state: &FitState) -> TerminationStatus {
        match self.termination {
            Some(_) => TerminationStatus::Terminated(TerminationReason::SolverConverged),
            None => TerminationStatus::NotTerminated,
        }
    }
}

#[cfg(test)]
mod tests;
