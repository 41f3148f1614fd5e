//! The gyroscope: bias from the rests, sensitivity by carrying gravity from rest to rest (model.md (7), (8)).
//!
//! ```text
//! r_k = E_k (R_k^T u_k - u_(k+1)) / sigma_k
//! ```
//!
//! u are the directions of gravity at the two rests of a move, R_k the rotation between them from the integrated gyroscope, and
//! the two rows of E_k span the plane across u_(k+1): a rotation about gravity is invisible. The nine entries are
//! ordered row by row, `T_xx, T_xy, ... T_zz`.

mod bias;

use faer::Mat;
use imucal_core::sensor::Triad;
use imucal_core::so3::hat;
use nalgebra::{Matrix3, Vector2, Vector3};

use crate::carry::{Carried, Path};
use crate::error::Error;
use crate::lsq::{self, FitReport, Residuals, Solution, Termination};
use crate::moves::{Ends, Move};
use crate::observability;
use crate::recording::Recording;
use crate::robust;
use crate::stats::rms;

pub(crate) use bias::{GyroscopeBias, bias_from_rests};

/// The fitted gyroscope.
#[derive(Clone, Debug)]
pub(crate) struct GyroscopeFit {
    pub(crate) triad: Triad<f64>,
    /// Which of the moves the fit uses.
    pub(crate) used: Vec<bool>,
    /// Rotation and sums of every move at the solution.
    pub(crate) carried: Vec<Carried>,
    /// Entries per error of each used residual in rad, 9 x 2 moves; zero columns for unused moves.
    pub(crate) gain: Mat<f64>,
    pub(crate) report: FitReport,
}

/// A first estimate from the start value with the smallest misfit; from the others too if that ends far from the data.
pub(crate) fn first_estimate(
    recordings: &[Recording<'_>],
    moves: &[Move],
    ends: &[Ends],
    bias: Vector3<f64>,
    starts: &[Matrix3<f64>],
) -> Result<Triad<f64>, Error> {
    let problem = Carrying::new(recordings, moves, ends, bias);
    let mut starts: Vec<(f64, Vec<f64>)> = starts
        .iter()
        .map(|start| start.transpose().as_slice().to_vec())
        .map(|start| (if starts.len() > 1 { problem.direction_rms_rad(&start) } else { 0.0 }, start))
        .collect();
    starts.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut best: Option<Solution> = None;
    for (_, start) in &starts {
        let solution = lsq::minimize(&problem, start, lsq::ROUGH)?;
        if best.as_ref().is_none_or(|best| solution.chi2 < best.chi2) {
            best = Some(solution);
        }
        if best.as_ref().is_some_and(|best| problem.direction_rms_rad(&best.parameters) < CLOSE_RAD) {
            break;
        }
    }
    let best = best.ok_or_else(|| Error::Fit("no start value for the gyroscope".into()))?;
    // Whether the moves determine all entries is for the fit to judge: here the scale may still be far off.
    triad_of(&best.parameters, bias)
}

/// Fits the nine entries from a first estimate; moves that contradict all others are left out.
pub(crate) fn fit(
    recordings: &[Recording<'_>],
    moves: &[Move],
    ends: &[Ends],
    first: &Triad<f64>,
) -> Result<GyroscopeFit, Error> {
    let bias = *first.bias();
    let mut used = vec![true; moves.len()];
    let mut problem = Carrying::new(recordings, moves, ends, bias);
    let mut parameters = first.sensitivity().transpose().as_slice().to_vec();
    loop {
        let solution = lsq::minimize(&problem, &parameters, lsq::EXACT)?;
        let triad = triad_of(&solution.parameters, bias)?;
        problem.check(&triad, &solution)?;
        let scores = robust::leave_one_out(&solution.residuals, &solution.jacobian, 2);
        match robust::worst_outlier(&scores, 2) {
            Some(item) if robust::may_exclude(&used, 9) => {
                used[problem.rows[item]] = false;
                problem.rows.remove(item);
                parameters = solution.parameters;
            }
            _ => return finish(&problem, used, triad, solution),
        }
    }
}

fn finish(
    problem: &Carrying<'_>,
    used: Vec<bool>,
    triad: Triad<f64>,
    solution: Solution,
) -> Result<GyroscopeFit, Error> {
    let row_gain = lsq::gain(&solution.jacobian);
    let mut gain = Mat::zeros(9, 2 * problem.paths.len());
    for (row, &k) in problem.rows.iter().enumerate() {
        for c in 0..2 {
            for i in 0..9 {
                gain[(i, 2 * k + c)] = row_gain[(i, 2 * row + c)] / problem.ends[k].sigma_rad;
            }
        }
    }
    let carried = problem.paths.iter().map(|path| path.carry(&triad));
    Ok(GyroscopeFit { carried: carried.collect(), triad, used, gain, report: solution.report() })
}

pub(crate) fn triad_of(entries: &[f64], bias: Vector3<f64>) -> Result<Triad<f64>, Error> {
    triad_with(&Matrix3::from_row_slice(entries), bias)
}

pub(crate) fn triad_with(sensitivity: &Matrix3<f64>, bias: Vector3<f64>) -> Result<Triad<f64>, Error> {
    Triad::try_new(*sensitivity, bias).map_err(|error| Error::Fit(format!("gyroscope: {error}")))
}

/// Derivative of a move's residual in rad with respect to the nine entries and the three biases, 2 x 12.
pub(crate) fn residual_gradient(ends: &Ends, carried: &Carried, triad: &Triad<f64>) -> [Vector2<f64>; 12] {
    let carried_up = carried.rotation.tr_mul(&ends.before);
    // A turn delta of the end attitude moves the carried direction by [R^T u]x delta.
    let by_turn = -(ends.across() * hat(&carried_up) * carried.rotation.transpose());
    std::array::from_fn(|p| match p {
        0..9 => by_turn * (carried.sensitivity_sums[p % 3] * triad.inverse().column(p / 3)),
        _ => by_turn * (carried.bias_sum * triad.inverse().column(p - 9)),
    })
}

struct Carrying<'a> {
    /// The samples of every move.
    paths: Vec<Path<'a>>,
    ends: &'a [Ends],
    bias: Vector3<f64>,
    /// The moves that take part.
    rows: Vec<usize>,
}

/// A fit that leaves less than this (rms) has found the right valley.
const CLOSE_RAD: f64 = 0.05;

impl<'a> Carrying<'a> {
    fn new(recordings: &[Recording<'a>], moves: &[Move], ends: &'a [Ends], bias: Vector3<f64>) -> Self {
        let paths = moves.iter().map(|m| Path::of(&recordings[m.recording], m.first, m.last)).collect();
        Self { paths, ends, bias, rows: (0..moves.len()).collect() }
    }

    /// Rms of the residuals in rad.
    fn direction_rms_rad(&self, parameters: &[f64]) -> f64 {
        let Ok(triad) = triad_of(parameters, self.bias) else {
            return f64::INFINITY;
        };
        let rotation = |k: usize| self.paths[k].rotation(&triad);
        rms(self.rows.iter().map(|&k| self.ends[k].residual(&rotation(k)).norm()))
    }

    /// Refuses moves that do not determine all nine entries.
    fn check(&self, triad: &Triad<f64>, solution: &Solution) -> Result<(), Error> {
        if solution.termination == Termination::NotFinite {
            return Err(Error::Fit("the gyroscope fit left the range of numbers: check the units of the rates".into()));
        }
        let scale = triad.sensitivity().norm() / 3f64.sqrt();
        let design = Mat::from_fn(solution.jacobian.nrows(), 9, |row, j| {
            solution.jacobian[(row, j)] * self.ends[self.rows[row / 2]].sigma_rad * scale
        });
        observability::check_gyroscope(&design, self.rows.len())
    }
}

impl Residuals for Carrying<'_> {
    fn evaluate(&self, parameters: &[f64], residuals: &mut Mat<f64>, jacobian: &mut Mat<f64>) {
        let Ok(triad) = triad_of(parameters, self.bias) else {
            residuals.fill(f64::NAN); // the solver takes a shorter step
            return;
        };
        for (row, &k) in self.rows.iter().enumerate() {
            let ends = &self.ends[k];
            let carried = self.paths[k].carry(&triad);
            let residual = ends.residual(&carried.rotation) / ends.sigma_rad;
            let gradient = residual_gradient(ends, &carried, &triad);
            for c in 0..2 {
                residuals[(2 * row + c, 0)] = residual[c];
                for j in 0..9 {
                    jacobian[(2 * row + c, j)] = gradient[j][c] / ends.sigma_rad;
                }
            }
        }
    }

    fn count(&self) -> usize {
        2 * self.rows.len()
    }
}
