//! Computes the design matrix of the joint fit without performing a fit. The matrix shows which parameters are
//! determined if rests and moves are used together. The least-squares values of these parameters are the start values
//! of a fit (model.md (12)).

use std::ops::Range;

use faer::Mat;
use imucal_core::sensor::Triad;

use crate::error::Error;
use crate::joint::{Line, Model, Prepared, Source, Terms};
use crate::numerics::lsq;
use crate::parameters::{ACCELEROMETER, BASE};
use crate::two_stage::observability::{LARGEST_SHIFT, MOVE_ERROR_RAD, Open, REST_ERROR_MPS2};

/// Maximum number of Gauss-Newton steps from the nominal parameters to the least-squares values. After the second step,
/// the distance from the least-squares values is at most as large as the error due to noise, so the third step is a
/// margin.
const STEPS: usize = 3;
/// Maximum change of a parameter in a Gauss-Newton step, as a fraction of the parameter's size (see [`sizes`]). If a
/// step changes a parameter by more, the data are faulty, and the step is not applied.
pub(super) const FAR_OFF: f64 = 0.3;

/// The design matrix: the Jacobian of the residuals with respect to the 18 parameters [`OBSERVED`] (all base parameters
/// except the gyroscope bias). The row of a residual is divided by the typical model error that a real unit has at a
/// rest or after a move ([`REST_ERROR_MPS2`] or [`MOVE_ERROR_RAD`]). The column of a parameter is multiplied by a
/// hundredth of the size of the parameter (`sizes`). The row of a prior is divided by the standard deviation of the
/// prior.
#[derive(Default)]
pub(super) struct Design {
    /// Rows of the matrix, with one column for each entry of [`OBSERVED`]. The rows of the residuals are first,
    /// followed by the rows of the priors.
    rows: Vec<[f64; 18]>,
    /// Residuals, one for each row of the matrix and divided by the same number as the row.
    residuals: Vec<f64>,
    /// The residuals and their derivatives before the division by the model error. A [`Line`] is one residual with its
    /// derivatives. The priors are not included.
    lines: Vec<Line>,
}

impl Design {
    fn at(prepared: &Prepared<'_>, terms: &Terms<'_>, parameters: &[f64], sizes: &[f64]) -> Result<Self, Error> {
        let lines = prepared.linearise(terms, parameters)?.lines;
        let error = |line: &Line| if matches!(line.source, Source::Norm(_)) { REST_ERROR_MPS2 } else { MOVE_ERROR_RAD };
        let row = |line: &Line| OBSERVED.map(|p| line.jacobian[p] * sizes[p] * LARGEST_SHIFT / error(line));
        let (mut rows, mut residuals): (Vec<_>, Vec<_>) =
            lines.iter().map(|line| (row(line), line.residual / error(line))).unzip();
        for held in prepared.held {
            let prior = held.row(parameters);
            let by = |p: usize| prior.derivatives.iter().filter(|(own, _)| *own == p).map(|(_, by)| by).sum::<f64>();
            rows.push(OBSERVED.map(|p| by(p) * sizes[p] * LARGEST_SHIFT));
            residuals.push(prior.residual);
        }
        Ok(Self { rows, residuals, lines })
    }

    /// Returns the design matrix, and the parameters at which it is computed. Determined parameters have their
    /// least-squares values, and all others their nominal values. The matrix at the nominal values of all parameters
    /// would not be suitable: these values differ from the true values by a few per cent, and this error would rotate
    /// the unobservable directions of the parameter space by a few hundredths of a radian. Determined parameters could
    /// then count as not determined.
    pub(super) fn near(
        prepared: &Prepared<'_>,
        terms: &Terms<'_>,
        model: &Model,
        sizes: &[f64],
    ) -> Result<(Self, Vec<f64>), Error> {
        let mut parameters = model.parameters();
        let mut design = Self::at(prepared, terms, &parameters, sizes)?;
        for _ in 0..STEPS {
            let step = design.step()?;
            // If a step changes a parameter by more than [`FAR_OFF`] of its size, the unit has wrong axes or other
            // faults. The step is then not applied, and the previous design is the result.
            if !step.iter().all(|change| (change * LARGEST_SHIFT).abs() < FAR_OFF) {
                break;
            }
            for (change, p) in step.iter().zip(OBSERVED) {
                parameters[p] += change * LARGEST_SHIFT * sizes[p];
            }
            design = Self::at(prepared, terms, &parameters, sizes)?;
        }
        Ok((design, parameters))
    }

    /// Finds the parameters that rests and moves together do not determine, as indices into [`OBSERVED`].
    pub(super) fn open(&self) -> Result<Open, Error> {
        Open::of(&self.matrix())
    }

    /// Finds the parameters of the accelerometer that the norms of the specific force at the rests do not determine.
    pub(super) fn open_to_rests(&self) -> Result<Open, Error> {
        self.open_to(0..ACCELEROMETER, |source| matches!(source, Source::Norm(_)))
    }

    /// Finds the entries of the gyroscope sensitivity that the moves do not determine, even if the accelerometer is
    /// known.
    pub(super) fn open_to_moves(&self) -> Result<Open, Error> {
        self.open_to(ACCELEROMETER..OBSERVED.len(), |source| matches!(source, Source::Move(_)))
    }

    /// Returns the parameters that are not determined by the residuals for which `is_used` is true. Only the parameters
    /// in the columns `columns` of the matrix are considered; all others are assumed to be known.
    fn open_to(&self, columns: Range<usize>, is_used: impl Fn(Source) -> bool) -> Result<Open, Error> {
        let rows: Vec<&[f64; 18]> =
            self.rows.iter().zip(&self.lines).filter(|(_, line)| is_used(line.source)).map(|(row, _)| row).collect();
        Open::of(&Mat::from_fn(rows.len(), columns.len(), |i, j| rows[i][columns.start + j]))
    }

    fn matrix(&self) -> Mat<f64> {
        Mat::from_fn(self.rows.len(), 18, |i, j| self.rows[i][j])
    }

    /// Computes the Gauss-Newton step of each parameter, in hundredths of the size of the parameter. In unobservable
    /// directions of the parameter space, the step is zero.
    fn step(&self) -> Result<[f64; 18], Error> {
        let (values, vectors) = lsq::singular(&self.matrix())?;
        let mut step = [0.0; 18];
        for k in (0..18).filter(|&k| values[k] >= 1.0) {
            let seen: f64 = self
                .rows
                .iter()
                .zip(&self.residuals)
                .map(|(row, residual)| residual * (0..18).map(|j| row[j] * vectors[(j, k)]).sum::<f64>())
                .sum();
            for (j, change) in step.iter_mut().enumerate() {
                *change -= vectors[(j, k)] * seen / values[k].powi(2);
            }
        }
        Ok(step)
    }
}

/// Indices, among the 21 parameters, of the parameters in the design matrix. The gyroscope bias is not included,
/// because the mean rates at the rests determine it directly.
pub(super) const OBSERVED: [usize; 18] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 13, 14, 15, 16, 17, 18, 19, 20];

/// Size of each parameter, raw units, with which its changes are compared. The size of a sensitivity is the mean scale.
/// The size of a bias is the reading at 1 g (accelerometer) or at 1 rad/s (gyroscope).
pub(super) fn sizes(model: &Model, gravity_mps2: f64) -> [f64; BASE] {
    let scale = |triad: &Triad<f64>| triad.sensitivity().norm() / 3f64.sqrt();
    let (accelerometer, gyroscope) = (scale(&model.accelerometer), scale(&model.gyroscope));
    std::array::from_fn(|p| match p {
        0..3 => accelerometer * gravity_mps2,
        3..9 => accelerometer,
        _ => gyroscope,
    })
}
