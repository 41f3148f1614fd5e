//! The joint least-squares problem: whitened residuals and their Jacobian for the solver.

mod nearby;
pub(super) mod report;
mod wandering;

use std::sync::Arc;

use faer::Mat;
use imucal_core::effects::Sensor;

use super::encoders::moves::{About, EncoderMove};
use super::encoders::{self, Encoders, StandModel};
use super::inside::Rows;
use super::lanes::Lanes;
use super::linear::{Insides, Linear, Source};
use super::model::Model;
use super::prepared::Prepared;
use super::start::{Prior, ShapePrior};
use super::terms::{Term, Terms};
use super::wander::{UnitWander, Wander};
use super::weights::{Weights, Widened, Widening};
use crate::cancellation::checkpoint;
use crate::error::Error;
use crate::held::HeldRow;
use crate::numerics::lsq::{self, Residuals, Solution};
use crate::parameters::{BASE, GYRO_BIAS, GYRO_SENSITIVITY};
use nearby::Nearby;
use report::JointFit;
use wandering::Wandering;

/// Least-squares problem of the joint fit, with fixed weights.
pub(crate) struct Joint<'a> {
    pub(crate) prepared: &'a Prepared<'a>,
    pub(super) terms: &'a Terms<'a>,
    pub(crate) weights: Weights,
    wandering: Option<Wandering>,
    /// Indices of the parameters that keep their start values.
    pub(crate) fixed: Vec<usize>,
    pub(super) priors: Vec<Prior>,
    /// Priors of the time constants.
    pub(super) shapes: Vec<ShapePrior>,
    pub(super) nearby: Nearby,
    rows: usize,
}

impl<'a> Joint<'a> {
    pub(crate) fn new(prepared: &'a Prepared<'a>, terms: &'a Terms<'a>, parameters: &[f64]) -> Result<Self, Error> {
        let linear = Arc::new(prepared.linearise(terms, parameters)?);
        let weights = Weights::of(prepared, terms, &linear);
        Self::with(prepared, terms, linear, weights)
    }

    /// The problem with weights from noise only. `linear` contains the residuals and derivatives from which the weights
    /// are computed.
    pub(crate) fn of_noise(
        prepared: &'a Prepared<'a>,
        terms: &'a Terms<'a>,
        linear: Arc<Linear>,
    ) -> Result<Self, Error> {
        let weights = Weights::of_noise(prepared, terms, &linear);
        Self::with(prepared, terms, linear, weights)
    }

    /// The problem with the final weights and priors of the fit `fit`.
    pub(crate) fn of_fit(prepared: &'a Prepared<'a>, terms: &'a Terms<'a>, fit: &JointFit) -> Result<Self, Error> {
        let mut problem = Self::with(prepared, terms, Arc::clone(&fit.linear), fit.weights.clone())?;
        problem.hold(fit.priors.clone());
        problem.rows += fit.shapes.len();
        problem.shapes.clone_from(&fit.shapes);
        Ok(problem)
    }

    fn with(
        prepared: &'a Prepared<'a>,
        terms: &'a Terms<'a>,
        linear: Arc<Linear>,
        weights: Weights,
    ) -> Result<Self, Error> {
        let rows = linear.groups().stand_moves.end + prepared.held.len();
        let nearby = Nearby::new(Arc::clone(&linear));
        let mut joint = Self {
            prepared,
            terms,
            weights,
            wandering: None,
            fixed: Vec::new(),
            priors: Vec::new(),
            shapes: Vec::new(),
            nearby,
            rows,
        };
        joint.let_biases_wander(&linear)?;
        Ok(joint)
    }

    fn let_biases_wander(&mut self, linear: &Linear) -> Result<(), Error> {
        self.wandering = None;
        let unit = self.wander(&linear.model);
        self.wandering = Wandering::new(self, linear, unit.as_ref())?;
        Ok(())
    }

    /// Returns the bias instability and random walk of the biases; `None` for constant biases. The values are from the
    /// unit's profile. Without a profile, the bias instability of the gyroscope is estimated from the mean rates.
    pub(crate) fn wander(&self, model: &Model) -> Option<UnitWander> {
        if let Wander::Known(unit) = self.prepared.wander {
            return Some(unit);
        }
        let raw = self.raw_scale(Sensor::Gyroscope, &model.parameters());
        let seen = self.weights.bias_instability();
        (seen != [0.0; 3]).then(|| UnitWander::of_gyroscope(seen.map(|b| b / raw)))
    }

    /// Replaces the weights by new weights, which are estimated from the residuals of the fit `found`.
    pub(crate) fn weigh_by(&mut self, found: &Solution) -> Result<(), Error> {
        let excess = self.excess_of(found, None)?;
        self.weigh_with(found, &excess)
    }

    /// Estimates by how much the residuals of the fit `found` exceed their noise. For the kinds of residuals in `kept`,
    /// the standard deviations are increased even if the excess is not significant.
    pub(super) fn excess_of(&self, found: &Solution, kept: Option<&Widened>) -> Result<Widening, Error> {
        let linear = self.linear(&found.parameters)?;
        Ok(self.weights.excess(self.prepared, &linear, found, kept))
    }

    /// Sets the weights for a given excess of the residuals over noise, at the parameters of the fit `found`.
    pub(super) fn weigh_with(&mut self, found: &Solution, excess: &Widening) -> Result<(), Error> {
        let linear = self.linear(&found.parameters)?;
        self.weights = Weights::with(self.prepared, self.terms, &linear, excess);
        self.let_biases_wander(&linear)
    }

    /// Sets the priors of effects whose parameters the recordings determine only in some directions.
    pub(crate) fn hold(&mut self, priors: Vec<Prior>) {
        self.rows += priors.iter().map(|prior| prior.typical.len()).sum::<usize>();
        self.priors = priors;
    }

    /// Sets a prior for each time constant, centred at its value in `parameters`. Without a prior, the data do not
    /// determine a time constant if its effect is absent or cannot be distinguished from a drift.
    pub(crate) fn hold_shapes(&mut self, parameters: &[f64]) {
        let place = |term: &Term<'_>| BASE + term.first + term.linear;
        let shapes = self.terms.all.iter().filter(|term| term.has_shape());
        self.shapes = shapes.map(|term| ShapePrior { place: place(term), centre: parameters[place(term)] }).collect();
        self.rows += self.shapes.len();
    }

    /// Adapts the widths (standard deviations) of the priors to the estimated parameters. Returns whether any width
    /// changed by more than 10 %.
    pub(crate) fn widen(&mut self, found: &Solution) -> bool {
        if self.priors.is_empty() {
            return false;
        }
        let covariance = lsq::covariance(&found.jacobian);
        let mut changed = false;
        for prior in &mut self.priors {
            let before = prior.width;
            prior.widen(&found.parameters, &covariance);
            changed |= (prior.width / before - 1.0).abs() > 0.1;
        }
        changed
    }

    /// Mean sensitivity of a sensor (root mean square over the axes), in raw units per SI unit.
    pub(crate) fn raw_scale(&self, sensor: Sensor, parameters: &[f64]) -> f64 {
        let entries = if sensor == Sensor::Gyroscope { &parameters[GYRO_SENSITIVITY] } else { &parameters[3..6] };
        (entries.iter().map(|e| e * e).sum::<f64>() / 3.0).sqrt()
    }

    /// Computes the whitened derivatives of force norms, gravity directions after moves and mean rates with respect to
    /// a separate bias at each rest, three columns per rest. The first matrix is for the gyroscope, the second for the
    /// accelerometer. The gyroscope bias in a move is the mean of the biases at the two adjacent rests.
    fn by_biases_of_rests(&self, linear: &Linear) -> [Mat<f64>; 2] {
        let (head, count) = (linear.lines.len(), 3 * self.prepared.rests.len());
        let rows = linear.head_rows();
        let (mut gyroscope, mut accelerometer) = (Mat::zeros(head, count), Mat::zeros(head, count));
        for (row, line) in linear.lines.iter().enumerate() {
            for (rest, by) in &line.by_means {
                for axis in 0..3 {
                    accelerometer[(row, 3 * rest + axis)] = -by[axis];
                }
            }
            if let Source::Move(k) = line.source {
                let m = &self.prepared.moves[k];
                for (rest, axis) in [m.from, m.to].into_iter().flat_map(|rest| (0..3).map(move |axis| (rest, axis))) {
                    gyroscope[(row, 3 * rest + axis)] += line.jacobian[GYRO_BIAS.start + axis] / 2.0;
                }
            }
        }
        let whole = |mut lines: Mat<f64>| {
            self.weights.whitening.apply(&mut lines);
            let mut all = Mat::zeros(rows, count);
            all.as_mut().subrows_mut(0, head).copy_from(&lines);
            all
        };
        let (mut gyroscope, accelerometer) = (whole(gyroscope), whole(accelerometer));
        for (k, (rest, _)) in linear.rates.iter().enumerate() {
            for (row, axis) in (0..3).flat_map(|row| (0..=row).map(move |axis| (row, axis))) {
                gyroscope[(head + 3 * k + row, 3 * rest + axis)] = -self.weights.rates[*rest][(row, axis)];
            }
        }
        [gyroscope, accelerometer]
    }

    /// Number of whitened residuals.
    pub(super) fn rows(&self) -> usize {
        self.rows
    }

    /// Applies the second whitening ([`Wandering`]) to `columns`. It accounts for errors that are correlated between
    /// rests: varying biases, rounding errors, and errors that depend on the attitude (pose errors). If there are no
    /// such errors, the columns do not change.
    pub(super) fn let_wander(&self, columns: &mut Mat<f64>) {
        if let Some(wandering) = &self.wandering {
            wandering.apply(columns);
        }
    }

    /// Columns of L^-1, where L is the Cholesky factor of the covariance of force norms, gravity directions after moves
    /// and mean rates. Column k is the change of the whitened residuals due to a unit error of the k-th of these
    /// residuals. A column is stored as the index of its first nonzero row and the values from that row on.
    pub(crate) fn whitened_units(&self, linear: &Linear) -> Vec<(usize, Vec<f64>)> {
        let head = linear.lines.len();
        let lines = (0..head).map(|row| (row, self.weights.whitening.unit(row)));
        let rates = linear.rates.iter().enumerate().flat_map(|(place, (k, _))| {
            let column = |axis: usize| self.weights.rates[*k].column(axis).iter().skip(axis).copied().collect();
            [0, 1, 2].map(|axis| (head + 3 * place + axis, column(axis)))
        });
        let columns: Vec<(usize, Vec<f64>)> = lines.chain(rates).collect();
        match &self.wandering {
            None => columns,
            Some(wandering) => wandering.apply_to_columns(&columns),
        }
    }

    /// Computes the whitened residuals and their Jacobian at `parameters`. The order of the rows is: force norms at
    /// rests and gravity directions after moves, mean rates at rests, force inside the moves, attitude relative to the
    /// stand, priors of base parameters, priors of effects, priors of time constants.
    pub(crate) fn whitened(&self, parameters: &[f64]) -> Result<(Mat<f64>, Mat<f64>), Error> {
        Ok(self.whiten(&*self.linear(parameters)?))
    }

    /// Whitens the residuals and the Jacobian of the linearisation `linear`.
    pub(crate) fn whiten(&self, linear: &Linear) -> (Mat<f64>, Mat<f64>) {
        let mut all = self.whiten_together(linear);
        let n = self.terms.total();
        let residual = all.subcols(n, 1).to_owned();
        all.truncate(self.rows, n);
        (residual, all)
    }

    /// Whitens the residuals and their Jacobian without priors. The result is stored row by row, with the residual as
    /// the last column. If the fit uses the force inside the moves but no stand, the residuals of this force are only
    /// in the second result, and are whitened only when they are requested.
    pub(crate) fn whiten_apart(&self, linear: &Arc<Linear>) -> (Lanes, Option<Insides>) {
        let rows = self.whiten_rows(linear);
        if self.terms.kinds.encoders || !self.terms.kinds.in_motion {
            return (rows, None);
        }
        let noise = self.weights.inside.clone();
        (rows, Insides::new(Arc::clone(linear), noise, self.prepared.gravity_mps2))
    }

    /// Whitens the force norms at rests, gravity directions after moves, and mean rates at rests, with their
    /// derivatives. With encoders, the residuals inside the moves and relative to the stand follow.
    fn whiten_rows(&self, linear: &Linear) -> Lanes {
        let n = self.terms.total();
        let (head, groups) = (linear.lines.len(), linear.groups());
        let count = if self.terms.kinds.encoders { groups.stand_moves.end } else { groups.inside.start };
        let mut rows = Lanes::zeros(n, count);
        // Zeroing a matrix of several hundred megabytes takes some tenths of a second. Afterwards, `checkpoint` ends
        // the calculation if it has been cancelled.
        checkpoint();
        for (row, line) in linear.lines.iter().enumerate() {
            let to = rows.row_mut(row);
            to[..n].copy_from_slice(&line.jacobian);
            to[n] = line.residual;
        }
        self.weights.whitening.apply_to_rows(rows.rows_mut(0..head));
        for (k, (rest, rates)) in linear.rates.iter().enumerate() {
            let whitening = &self.weights.rates[*rest];
            for (row, axis) in (0..3).flat_map(|row| (0..=row).map(move |axis| (row, axis))) {
                let (to, by) = (rows.row_mut(head + 3 * k + row), whitening[(row, axis)]);
                to.iter_mut().zip(&rates[axis].jacobian).for_each(|(to, from)| *to += by * from);
                to[n] += by * rates[axis].residual;
            }
        }
        if let Some(wandering) = &self.wandering {
            wandering.apply_to_rows(&mut rows);
        }
        if let Some(encoders) = self.prepared.encoders.as_ref().filter(|_| self.terms.kinds.encoders) {
            let mut write_row = |row: &mut usize, z: &[f64], sigma: f64| {
                rows.row_mut(*row).iter_mut().zip(z).for_each(|(to, value)| *to = value / sigma);
                *row += 1;
            };
            let (mut inside, mut against_stand) = (groups.inside.start, groups.stand_rests.start);
            self.stand_rows(encoders, linear, |about, z, sigma| match about {
                About::Force => write_row(&mut inside, z, sigma),
                About::Stand => write_row(&mut against_stand, z, sigma),
            });
        }
        rows
    }

    /// Whitens the Jacobian of all residuals and priors in one matrix. The last column contains the residuals.
    fn whiten_together(&self, linear: &Linear) -> Mat<f64> {
        let n = self.terms.total();
        let (rows, mut all) = (self.whiten_rows(linear), Mat::zeros(self.rows, n + 1));
        checkpoint();
        rows.copy_columns(0..=n, &mut all, 0);
        checkpoint();
        let mut row = rows.rows();
        if self.terms.kinds.in_motion && !self.terms.kinds.encoders {
            let first = row;
            let mut rows = Rows::new(&mut all, first);
            for (at_move, noise) in linear.moves.iter().zip(&self.weights.inside) {
                checkpoint();
                rows.write_move(at_move, noise, self.prepared.gravity_mps2);
            }
            row = rows.next();
            for (p, change) in linear.change.iter().enumerate().filter(|(_, change)| **change != 0.0) {
                (first..row).for_each(|at| all[(at, n)] += all[(at, p)] * change);
            }
        }
        let parameters = linear.model.parameters();
        for held in self.prepared.held {
            let HeldRow { residual, derivatives } = held.row(&parameters);
            derivatives.into_iter().for_each(|(p, by)| all[(row, p)] += by);
            all[(row, n)] = residual;
            row += 1;
        }
        for prior in &self.priors {
            for (k, typical) in prior.typical.iter().enumerate() {
                all[(row, prior.first + k)] = 1.0 / (prior.width * typical);
                all[(row, n)] = linear.model.values[prior.first - BASE + k] / (prior.width * typical);
                row += 1;
            }
        }
        for prior in &self.shapes {
            (all[(row, n)], all[(row, prior.place)]) = prior.residual(linear.model.values[prior.place - BASE]);
            row += 1;
        }
        for &p in &self.fixed {
            all.col_mut(p).fill(0.0);
        }
        all
    }
}

impl Joint<'_> {
    /// Computes the residuals relative to the stand and the residuals of the force inside the moves. `push` receives
    /// each residual with its derivatives, and its standard deviation. The standard deviation is 1 for residuals inside
    /// moves, which are already whitened.
    fn stand_rows(&self, encoders: &Encoders, linear: &Linear, mut push: impl FnMut(About, &[f64], f64)) {
        let (prepared, terms, model) = (self.prepared, self.terms, &linear.model);
        let stand = StandModel::of(&model.stand);
        for (k, direction) in &linear.directions {
            checkpoint();
            let angles = encoders.at_rest(*k, &prepared.rests[*k], &model.values, terms);
            for z in encoders::rest_rows(&angles, terms, &stand, direction) {
                push(About::Stand, &z, self.weights.stand_sigma_rad);
            }
        }
        for ((m, at_move), noise) in prepared.moves.iter().zip(linear.moves.iter()).zip(&self.weights.inside) {
            checkpoint();
            let angles = encoders.in_move(&prepared.recordings[m.recording], m, &model.values, terms);
            let rest = encoders.at_rest(m.from, &prepared.rests[m.from], &model.values, terms);
            let seen = EncoderMove { angles: &angles, rest: &rest, stand: &stand };
            seen.innovations(at_move, terms, (noise, self.weights.reading), prepared.gravity_mps2, |about, z| {
                push(about, z, 1.0)
            });
        }
    }
}

impl Residuals for Joint<'_> {
    fn evaluate(&self, parameters: &[f64], residuals: &mut Mat<f64>, jacobian: &mut Mat<f64>) {
        match self.whitened(parameters) {
            Ok((r, j)) => (*residuals, *jacobian) = (r, j),
            Err(_) => residuals.fill(f64::NAN), // the solver takes a shorter step
        }
    }

    fn count(&self) -> usize {
        self.rows
    }
}
