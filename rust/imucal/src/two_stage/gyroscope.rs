//! Fits the gyroscope in the second stage of the two-stage fit. The bias is estimated from the rests, and the
//! sensitivity from the moves between consecutive rests (model.md (7), (8)).
//!
//! ```text
//! r_k = E_k (R_k^T u_k - u_(k+1)) / sigma_k
//! ```
//!
//! r_k is the residual of move k. u_k and u_(k+1) are the gravity directions in the body frame at the rests before and
//! after move k. R_k is the rotation over the move, integrated from the gyroscope rates. The two rows of E_k span the
//! plane perpendicular to u_(k+1). sigma_k is the standard deviation, rad, of each of the two components of
//! `E_k (R_k^T u_k - u_(k+1))`. The component along u_(k+1) is omitted, because a rotation about gravity is not
//! observable. The nine entries of the sensitivity T are ordered by rows, `T_xx, T_xy, ... T_zz`.

mod bias;

use std::cell::RefCell;
use std::rc::Rc;

use faer::Mat;
use imucal_core::sensor::Triad;
use imucal_core::so3::{self, hat};
use nalgebra::{Matrix3, Vector2, Vector3};

use crate::error::Error;
use crate::held::StageRows;
use crate::numerics::fit_report::FitReport;
use crate::numerics::lsq::Termination;
use crate::numerics::lsq::{self, Residuals, Solution};
use crate::numerics::robust;
use crate::numerics::stats::rms;
use crate::numerics::workers::{in_order, threads_for};
use crate::preintegration::{Preintegrated, RateSegment};
use crate::recording::Recording;
use crate::rests::moves::{Ends, Move};
use crate::two_stage::observability::{self, MOVE_ERROR_RAD};

pub(crate) use bias::{GyroscopeBias, bias_from_rests};

/// Result of the gyroscope fit.
#[derive(Clone, Debug)]
pub(crate) struct GyroscopeFit {
    /// The fitted gyroscope.
    pub(crate) triad: Triad<f64>,
    /// For each move, whether the fit uses it. The other moves were excluded as outliers.
    pub(crate) used: Vec<bool>,
    /// Preintegration of each move with the fitted gyroscope: the rotation over the move, and the integrals from which
    /// the derivatives of this rotation are computed.
    pub(crate) preintegrated: Vec<Preintegrated>,
    /// Gain of the fit: the negative derivatives of the nine entries of T (rows) with respect to errors of the
    /// direction residuals in rad (columns, two per move). The columns of moves that are not used are zero.
    pub(crate) gain: Mat<f64>,
    pub(crate) report: FitReport,
}

/// The moves to which the gyroscope is fitted, with the result of their most recent preintegration.
pub(crate) struct PreintegratedMoves<'a> {
    /// Raw gyroscope samples of each move.
    segments: Vec<RateSegment<'a>>,
    bias: Vector3<f64>,
    held: &'a StageRows<'a>,
    /// Result of the most recent preintegration; `None` before the first preintegration.
    last: RefCell<Option<Rc<Linearised>>>,
}

/// All moves, preintegrated with one estimate of the gyroscope.
struct Linearised {
    triad: Triad<f64>,
    preintegrated: Vec<Preintegrated>,
}

/// If the rms direction error over the moves, rad, of a start value or of a first fit is below this limit, this start
/// value or fit is assumed to be close to the global minimum. No further start values are then tried.
const CLOSE_RAD: f64 = 0.05;
/// For a slightly different sensitivity, a preintegration is corrected to first order instead of integrating the
/// samples again. This is done if, for each move, the squared angle of the correction (rad^2) is at most this value
/// times the standard deviation of the direction residual (rad). The squared angle is the size of the neglected
/// second-order term.
const MAX_SECOND_ORDER: f64 = 1e-9;

impl<'a> PreintegratedMoves<'a> {
    pub(crate) fn new(
        recordings: &[Recording<'a>],
        moves: &[Move],
        bias: Vector3<f64>,
        held: &'a StageRows<'a>,
    ) -> Self {
        let segments = moves.iter().map(|m| RateSegment::of(&recordings[m.recording], m.first, m.last)).collect();
        Self { segments, bias, held, last: RefCell::new(None) }
    }

    /// Returns a first estimate of the gyroscope. The fit starts from the start value with the smallest rms direction
    /// error. If the direction errors of this fit are large, fits from the other start values are also tried.
    ///
    /// # Errors
    /// [`Error::Fit`] if `starts` is empty, or if the fitted sensitivity is singular or not finite.
    pub(crate) fn first_estimate(&self, ends: &[Ends], starts: &[Matrix3<f64>]) -> Result<Triad<f64>, Error> {
        let problem = self.weighed(ends);
        let mut candidates: Vec<(f64, Vec<f64>)> = Vec::new();
        for start in starts {
            let start = start.transpose().as_slice().to_vec();
            let misfit_rad = problem.direction_rms_rad(&start);
            candidates.push((misfit_rad, start));
            if misfit_rad < CLOSE_RAD {
                break;
            }
        }
        candidates.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut best: Option<Solution> = None;
        for (_, start) in &candidates {
            let solution = lsq::minimize(&problem, start, lsq::ROUGH)?;
            if best.as_ref().is_none_or(|best| solution.chi2 < best.chi2) {
                best = Some(solution);
            }
            if best.as_ref().is_some_and(|best| problem.misfit_rad(&best.residuals) < CLOSE_RAD) {
                break;
            }
        }
        let best = best.ok_or_else(|| Error::Fit("the fit of the gyroscope has no start value".into()))?;
        // Observability is not tested here, because the scale of this first estimate may still be wrong by a large
        // factor. The final fit tests whether the moves determine all entries of the sensitivity.
        triad_of(&best.parameters, self.bias)
    }

    /// Fits the nine entries of the gyroscope's sensitivity matrix, starting from the estimate `first`. Moves that
    /// contradict all other moves are excluded one by one (model.md (14)). If `is_start` is true, the result is only
    /// the start value of the joint fit. The residuals then contain errors of the accelerometer's start value, so no
    /// move is excluded here, and the joint fit excludes outliers instead.
    ///
    /// # Errors
    /// * [`Error::NotEnoughMotion`] if the moves do not determine all entries.
    /// * [`Error::Fit`] if the result is not finite.
    pub(crate) fn fit(&self, ends: &[Ends], first: &Triad<f64>, is_start: bool) -> Result<GyroscopeFit, Error> {
        let mut used = vec![true; self.segments.len()];
        let mut problem = self.weighed(ends);
        let mut parameters = first.sensitivity().transpose().as_slice().to_vec();
        loop {
            let solution = lsq::minimize(&problem, &parameters, lsq::EXACT)?;
            let triad = triad_of(&solution.parameters, self.bias)?;
            problem.check(&triad, &solution)?;
            let scores = robust::leave_one_out(&solution.residuals, &solution.jacobian, 2);
            match robust::worst_outlier(&scores[..problem.rows.len()], 2) {
                Some(item) if !is_start && robust::may_exclude(&used, 9) => {
                    used[problem.rows[item]] = false;
                    problem.rows.remove(item);
                    parameters = solution.parameters;
                }
                _ => return Ok(problem.finish(used, triad, solution)),
            }
        }
    }

    fn weighed<'b>(&'b self, ends: &'b [Ends]) -> Weighed<'b> {
        Weighed { moves: self, ends, rows: (0..self.segments.len()).collect() }
    }

    /// Preintegrates all moves with the gyroscope `triad`. If a first-order correction of the most recent
    /// preintegration is accurate enough ([`MAX_SECOND_ORDER`]), it is used, and the samples are not integrated again.
    fn preintegrated(&self, triad: &Triad<f64>, ends: &[Ends]) -> Rc<Linearised> {
        let known = self.last.borrow().clone();
        if let Some(moved) = known.and_then(|last| last.moved(triad, ends)) {
            return moved;
        }
        let segments = &self.segments;
        let threads = threads_for(segments.iter().map(RateSegment::samples).sum());
        let preintegrated = in_order(threads, segments.len(), |k| segments[k].preintegrate(triad));
        let new = Rc::new(Linearised { triad: *triad, preintegrated });
        *self.last.borrow_mut() = Some(Rc::clone(&new));
        new
    }
}

impl Linearised {
    /// Corrects these preintegrated moves to first order for a slightly different gyroscope sensitivity; `None` if the
    /// neglected second-order term is too large ([`MAX_SECOND_ORDER`]).
    fn moved(self: Rc<Self>, triad: &Triad<f64>, ends: &[Ends]) -> Option<Rc<Self>> {
        if self.triad == *triad {
            return Some(self);
        }
        // T_old is the sensitivity with which these moves were preintegrated, and T_new is the sensitivity of `triad`.
        // The inverse of T_new is (I + `change`) T_old^-1, and both gyroscopes have the same bias b. The angular rate
        // w = T^-1 (measured rate - b) therefore changes by `change` * w.
        let change = triad.inverse() * self.triad.sensitivity() - Matrix3::identity();
        let mut preintegrated = self.preintegrated.clone();
        for (preintegrated, ends) in preintegrated.iter_mut().zip(ends) {
            let turn: Vector3<f64> = (0..3).map(|j| preintegrated.sensitivity_sums[j] * change.column(j)).sum();
            if turn.norm_squared() > MAX_SECOND_ORDER * ends.sigma_rad {
                return None;
            }
            preintegrated.rotation = so3::exp(&turn).to_rotation_matrix().matrix() * preintegrated.rotation;
        }
        Some(Rc::new(Self { triad: *triad, preintegrated }))
    }
}

pub(crate) fn triad_of(entries: &[f64], bias: Vector3<f64>) -> Result<Triad<f64>, Error> {
    triad_with(&Matrix3::from_row_slice(entries), bias)
}

pub(crate) fn triad_with(sensitivity: &Matrix3<f64>, bias: Vector3<f64>) -> Result<Triad<f64>, Error> {
    Triad::try_new(*sensitivity, bias).map_err(|error| Error::Fit(format!("gyroscope: {error}")))
}

/// Computes the derivative of a move's direction residual (rad) with respect to the nine entries of the sensitivity T
/// and the three biases; a 2 x 12 matrix.
pub(crate) fn residual_gradient(ends: &Ends, preintegrated: &Preintegrated, triad: &Triad<f64>) -> [Vector2<f64>; 12] {
    let propagated_up = preintegrated.rotation.tr_mul(&ends.before);
    // R is the rotation over the move, and u is the gravity direction before the move. An attitude error `delta` at the
    // end of the move (a small rotation vector in the body frame at the end) changes the propagated gravity direction
    // R^T u by [R^T u]x delta. A change of an entry T_ij changes the attitude by delta = -R^T G_j T^-1 e_i, see
    // `preintegration.rs`.
    let by_turn = -(ends.across() * hat(&propagated_up) * preintegrated.rotation.transpose());
    std::array::from_fn(|p| match p {
        0..9 => by_turn * (preintegrated.sensitivity_sums[p % 3] * triad.inverse().column(p / 3)),
        _ => by_turn * (preintegrated.bias_sum * triad.inverse().column(p - 9)),
    })
}

/// The weighted least-squares problem of the gyroscope fit, which [`lsq::minimize`] solves.
struct Weighed<'a> {
    moves: &'a PreintegratedMoves<'a>,
    ends: &'a [Ends],
    /// Indices of the moves that the fit uses.
    rows: Vec<usize>,
}

impl Weighed<'_> {
    /// Rms over the moves of the direction error (norm of the direction residual) for these parameters, rad.
    fn direction_rms_rad(&self, parameters: &[f64]) -> f64 {
        let Ok(triad) = triad_of(parameters, self.moves.bias) else {
            return f64::INFINITY;
        };
        let at = self.moves.preintegrated(&triad, self.ends);
        rms(self.rows.iter().map(|&k| self.ends[k].residual(&at.preintegrated[k].rotation).norm()))
    }

    /// Rms over the moves of the direction error, rad. The argument `residuals` contains the direction residuals
    /// divided by their standard deviations.
    fn misfit_rad(&self, residuals: &Mat<f64>) -> f64 {
        let norm = |row: usize| residuals[(2 * row, 0)].hypot(residuals[(2 * row + 1, 0)]);
        rms(self.rows.iter().enumerate().map(|(row, &k)| norm(row) * self.ends[k].sigma_rad))
    }

    fn finish(&self, used: Vec<bool>, triad: Triad<f64>, solution: Solution) -> GyroscopeFit {
        let row_gain = lsq::gain(&solution.jacobian);
        let mut gain = Mat::zeros(9, 2 * self.ends.len());
        for (row, &k) in self.rows.iter().enumerate() {
            for c in 0..2 {
                for i in 0..9 {
                    gain[(i, 2 * k + c)] = row_gain[(i, 2 * row + c)] / self.ends[k].sigma_rad;
                }
            }
        }
        let preintegrated = self.moves.preintegrated(&triad, self.ends).preintegrated.clone();
        GyroscopeFit { preintegrated, triad, used, gain, report: FitReport::of(&solution) }
    }

    /// Returns an error if a residual is not finite, or if the moves do not determine all entries of the sensitivity
    /// that have no prior.
    fn check(&self, triad: &Triad<f64>, solution: &Solution) -> Result<(), Error> {
        if solution.termination == Termination::NotFinite {
            return Err(Error::Fit(
                "the gyroscope fit has residuals that are not finite: check the units of the rates".into(),
            ));
        }
        let scale = triad.sensitivity().norm() / 3f64.sqrt();
        let design = Mat::from_fn(solution.jacobian.nrows(), 9, |row, j| {
            let unit = self.rows.get(row / 2).map_or(MOVE_ERROR_RAD, |k| self.ends[*k].sigma_rad);
            solution.jacobian[(row, j)] * unit * scale
        });
        observability::check_gyroscope(&design, self.rows.len(), &self.moves.held.columns())
    }
}

impl Residuals for Weighed<'_> {
    fn evaluate(&self, parameters: &[f64], residuals: &mut Mat<f64>, jacobian: &mut Mat<f64>) {
        let Ok(triad) = triad_of(parameters, self.moves.bias) else {
            residuals.fill(f64::NAN); // the solver then takes a shorter step
            return;
        };
        let at = self.moves.preintegrated(&triad, self.ends);
        for (row, &k) in self.rows.iter().enumerate() {
            let (ends, preintegrated) = (&self.ends[k], &at.preintegrated[k]);
            let residual = ends.residual(&preintegrated.rotation) / ends.sigma_rad;
            let gradient = residual_gradient(ends, preintegrated, &triad);
            for c in 0..2 {
                residuals[(2 * row + c, 0)] = residual[c];
                for j in 0..9 {
                    jacobian[(2 * row + c, j)] = gradient[j][c] / ends.sigma_rad;
                }
            }
        }
        self.moves.held.write(parameters, 2 * self.rows.len(), residuals, jacobian);
    }

    fn count(&self) -> usize {
        2 * self.rows.len() + self.moves.held.count()
    }
}
