//! Computes the residuals of the joint fit at given parameters, and their derivatives. They are not yet whitened.

use std::ops::Range;
use std::sync::Arc;

use imucal_core::effects::{Need, Sensor};
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use super::choices::Kinds;
use super::encoders::moves;
use super::inside;
use super::model::Model;
use super::move_ends::{AtMove, EndDirection, move_direction};
use super::pass::{EvaluatedTerms, Route};
use super::prepared::Prepared;
use super::rests::{BiasError, Force, Rate, Rests};
use super::terms::Terms;
use crate::error::Error;
use crate::joint::inside::{InsideNoise, Rows, count};
use crate::joint::lanes::Lanes;
use crate::joint::move_ends::{attitude_after, first_attitude};
use crate::numerics::workers::{in_order, threads_for};
use crate::parameters::{BASE, GYRO_BIAS, GYRO_SENSITIVITY};
use crate::rests::moves::{End, rows_across};
use crate::rests::unit_rest::{PropagatedMean, UnitRest};

/// One scalar residual, and its derivatives with respect to the parameters and the mean forces of the rests.
#[derive(Clone)]
pub(crate) struct Line {
    pub(crate) residual: f64,
    pub(crate) jacobian: Vec<f64>,
    /// Each rest whose mean force changes the residual: the index of the rest, and the derivative of the residual with
    /// respect to this mean force in raw units.
    pub(crate) by_means: Vec<(usize, Vector3<f64>)>,
    pub(crate) source: Source,
    /// Whether the residual belongs to the second or a later epoch of a long rest, or to the move that leads to such an
    /// epoch. Epochs are the parts into which a long rest is divided, because the biases drift during it.
    pub(crate) is_of_later_epoch: bool,
}

impl Line {
    /// First-order change of the residual for a small change of the parameters.
    pub(super) fn change(&self, change: &[f64]) -> f64 {
        self.jacobian.iter().zip(change).map(|(by, change)| by * change).sum()
    }
}

/// The rest or the move to which a residual belongs, by index. `Norm` is used for every residual of a rest: the norm of
/// its mean force, a component of its mean rate, or a component of its gravity direction relative to the stand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Source {
    Norm(usize),
    Move(usize),
}

/// All residuals, linearised at given parameters (model.md (18)). They are not yet whitened.
#[derive(Clone)]
pub(crate) struct Linear {
    pub(crate) model: Model,
    pub(crate) lines: Vec<Line>,
    /// For each rest that the fit uses: its index, and the residuals of its mean rate about x, y and z (measured minus
    /// predicted rate), raw units.
    pub(crate) rates: Vec<(usize, [Line; 3])>,
    pub(crate) moves: Arc<Vec<AtMove>>,
    /// Index and gravity direction of each rest that the fit uses.
    pub(super) directions: Vec<(usize, Arc<EndDirection>)>,
    /// Change of the parameters since the samples of the moves were last integrated; empty if the parameters have not
    /// changed, or if the fit does not use the force inside the moves. To first order, the residuals inside the moves
    /// are corrected by the product of their derivatives and this change.
    pub(super) change: Vec<f64>,
    kinds: Kinds,
}

/// Row ranges of three groups of residuals in the whitened matrices: forces inside the moves, gravity directions
/// relative to the stand, and attitudes relative to the stand. The rows of force norms, gravity directions after moves
/// and mean rates come first.
pub(crate) struct Groups {
    pub(crate) inside: Range<usize>,
    pub(crate) stand_rests: Range<usize>,
    pub(crate) stand_moves: Range<usize>,
}

impl Linear {
    /// Index and gravity direction of each rest that the fit uses.
    pub(crate) fn directions(&self) -> impl Iterator<Item = (usize, &Vector3<f64>)> {
        self.directions.iter().map(|(k, direction)| (*k, &direction.up))
    }

    /// Whether the force inside the moves contributes residuals.
    pub(crate) fn sees_inside(&self) -> bool {
        self.kinds.in_motion
    }

    /// Returns the linearisation after a small change `change` of the parameters. The residuals are updated to first
    /// order, and the derivatives stay unchanged.
    pub(super) fn moved(&self, change: &[f64], model: Model) -> Self {
        let inside = if self.kinds.in_motion { change } else { &[] };
        let mut moved = Self { model, change: inside.to_vec(), ..self.clone() };
        for line in moved.lines.iter_mut().chain(moved.rates.iter_mut().flat_map(|(_, lines)| lines)) {
            line.residual += line.change(change);
        }
        moved
    }

    /// Number of residuals of three kinds: force norms, gravity directions after moves, and mean rates. Their rows
    /// precede all other rows.
    pub(crate) fn head_rows(&self) -> usize {
        self.lines.len() + 3 * self.rates.len()
    }

    pub(crate) fn groups(&self) -> Groups {
        let start = self.head_rows();
        let inside: usize = if self.kinds.in_motion {
            self.moves.iter().map(|m| inside::count(&m.pass, self.kinds.encoders)).sum()
        } else {
            0
        };
        let rests = if self.kinds.encoders { 2 * self.directions.len() } else { 0 };
        let count = |m: &AtMove| moves::count(&m.pass);
        let moves: usize = if self.kinds.encoders { self.moves.iter().map(count).sum() } else { 0 };
        let (a, b, c) = (start + inside, start + inside + rests, start + inside + rests + moves);
        Groups { inside: start..a, stand_rests: a..b, stand_moves: b..c }
    }

    /// Returns, for each rest and move, the row ranges of its whitened residuals after those of the mean rates: the
    /// forces inside each move, the gravity direction at each rest relative to the stand, and the attitudes inside each
    /// move relative to the stand.
    pub(super) fn rows_beyond_rates(&self) -> Vec<(Source, Range<usize>)> {
        let mut row = self.head_rows();
        let mut found = Vec::new();
        let mut next = |source: Source, count: usize| {
            found.push((source, row..row + count));
            row += count;
        };
        let moves = || self.moves.iter().enumerate();
        if self.kinds.in_motion {
            moves().for_each(|(k, m)| next(Source::Move(k), inside::count(&m.pass, self.kinds.encoders)));
        }
        if self.kinds.encoders {
            self.directions.iter().for_each(|(k, _)| next(Source::Norm(*k), 2));
            moves().for_each(|(k, m)| next(Source::Move(k), moves::count(&m.pass)));
        }
        found
    }

    /// Kind of each row of the whitened residuals, as an index: 0 for force norms, 2 to 4 for mean rates about x, y and
    /// z. The other kinds are [`MOVE_DIRECTIONS`], [`INSIDE`], [`STAND_RESTS`], [`STAND_MOVES`], [`EPOCH_NORMS`],
    /// [`EPOCH_STEPS`] and [`EPOCH_RATES`].
    pub(crate) fn groups_of_rows(&self) -> Vec<usize> {
        let groups = self.groups();
        let lines = self.lines.iter().map(|line| match (line.source, line.is_of_later_epoch) {
            (Source::Norm(_), false) => 0,
            (Source::Move(_), false) => MOVE_DIRECTIONS,
            (Source::Norm(_), true) => EPOCH_NORMS,
            (Source::Move(_), true) => EPOCH_STEPS,
        });
        let of_axis = |(axis, line): (usize, &Line)| if line.is_of_later_epoch { EPOCH_RATES } else { 2 + axis };
        let rates = self.rates.iter().flat_map(|(_, lines)| lines.iter().enumerate().map(of_axis));
        let rest = [(INSIDE, groups.inside), (STAND_RESTS, groups.stand_rests), (STAND_MOVES, groups.stand_moves)];
        let rest = rest.into_iter().flat_map(|(group, range)| range.map(move |_| group));
        lines.chain(rates).chain(rest).collect()
    }
}

/// Index of a kind of residuals: gravity directions after moves. If the specific force inside the moves is used, these
/// residuals have the kind [`INSIDE`] instead.
pub(crate) const MOVE_DIRECTIONS: usize = 1;
/// Index of a kind of residuals: the specific force inside the moves. [`Linear::groups_of_rows`] lists the other kinds.
pub(crate) const INSIDE: usize = 5;
/// Index of a kind of residuals: gravity directions computed from the stand's encoder angles, minus the directions
/// measured at the rests.
pub(crate) const STAND_RESTS: usize = 6;
/// Index of a kind of residuals: attitudes inside the moves relative to the attitudes computed from the stand's encoder
/// angles.
pub(crate) const STAND_MOVES: usize = 7;
/// Index of a kind of residuals: force norms at the second and later epochs (parts) of long rests. They are separate
/// because they scatter less than the norms of different rests: all epochs of a rest have one attitude, but the norms
/// of different rests also contain model errors that depend on the attitude.
pub(crate) const EPOCH_NORMS: usize = 8;
/// Index of a kind of residuals: changes of the gravity direction between the epochs (parts) of a long rest.
pub(crate) const EPOCH_STEPS: usize = 9;
/// Index of a kind of residuals: mean rates at the second and later epochs (parts) of long rests, all axes.
pub(crate) const EPOCH_RATES: usize = 10;

/// Computing time per sample if a move is integrated with effects or with blocks (short intervals with a mean force),
/// relative to preintegration. Preintegration is used if there are neither effects nor blocks. The number of threads is
/// computed from the total computing time.
const COST: usize = 30;

impl Prepared<'_> {
    /// Computes the residuals and their derivatives at these parameters.
    pub(crate) fn linearise(&self, terms: &Terms<'_>, parameters: &[f64]) -> Result<Linear, Error> {
        let model = Model::of(parameters, terms)?;
        let terms = &*terms.with_histories(self.recordings, self.histories, &model.values);
        let rests = Rests::new(self, &model, terms);
        let ends: Vec<_> = (0..self.moves.len()).map(|index| rests.ends(index)).collect();
        let (has_blocks, evaluated) = (terms.kinds.look_inside(), EvaluatedTerms::new(&model, terms));
        let at_move = |index: usize, attitude, preintegrated| {
            let [before, after] = ends[index].clone();
            let route = Route { preintegrated, ..self.route(index, attitude, &before, has_blocks) };
            AtMove { pass: route.pass(&model, &evaluated), before, after }
        };
        // If all effects are zero, a first pass integrates only the rotations of the moves, which is fast. The
        // rotations give the attitude at every rest. The complete integration of the moves, which needs these
        // attitudes, then runs in parallel.
        let goes_ahead = evaluated.adds_nothing();
        let mut attitudes: Vec<Option<UnitQuaternion<f64>>> = vec![None; self.rests.len()];
        let mut moves: Vec<AtMove> = Vec::with_capacity(self.moves.len());
        let mut preintegrated = vec![None; self.moves.len()];
        let mut next_move = 0;
        for k in (0..self.rests.len()).filter(|&k| self.used[k] && terms.needs(Need::Attitude)) {
            let start = *attitudes[k].get_or_insert_with(|| first_attitude(&rests.forces[k].direction.up));
            // The rotation of each move gives the attitude at the rest after it.
            while let Some(m) = self.moves.get(next_move).filter(|m| m.from == k) {
                let [before, after] = &ends[next_move];
                let rotation = if goes_ahead {
                    let route = self.route(next_move, None, before, has_blocks);
                    if has_blocks {
                        route.rotation(&model.gyroscope)
                    } else {
                        preintegrated[next_move].insert(route.preintegrated_base(&model.gyroscope)).0
                    }
                } else {
                    moves.push(at_move(next_move, Some(start), None));
                    moves[next_move].pass.rotation
                };
                attitudes[m.to] = Some(attitude_after(&start, &rotation, &after.up));
                next_move += 1;
            }
        }
        if moves.is_empty() {
            let samples: usize = self.moves.iter().map(|m| m.last - m.first).sum();
            let cost = if terms.count > 0 || terms.kinds.look_inside() { COST } else { 1 };
            let at_move = |index: usize| at_move(index, attitudes[self.moves[index].from], preintegrated[index]);
            moves = in_order(threads_for(cost * samples), self.moves.len(), at_move);
        }
        Ok(self.lines(&model, terms, &rests, &attitudes, moves))
    }

    /// Computes the residuals from the forces at the rests, the attitudes of the rests, and the integrated moves.
    pub(super) fn lines(
        &self,
        model: &Model,
        terms: &Terms<'_>,
        rests: &Rests<'_>,
        attitudes: &[Option<UnitQuaternion<f64>>],
        moves: Vec<AtMove>,
    ) -> Linear {
        let by_mean = model.accelerometer.inverse();
        let mut directions = Vec::new();
        let (mut lines, mut rates) = (Vec::new(), Vec::new());
        let mut next_move = 0;
        for (k, force) in rests.forces.iter().enumerate().filter(|(k, _)| self.used[*k]) {
            let up = force.direction.up;
            lines.push(Line {
                residual: force.value.norm() - self.gravity_mps2,
                jacobian: force.jacobian.iter().map(|column| up.dot(column)).collect(),
                by_means: vec![(k, by_mean.tr_mul(&up))],
                source: Source::Norm(k),
                is_of_later_epoch: self.rests[k].is_later_epoch(),
            });
            while self.moves.get(next_move).is_some_and(|m| m.from == k) {
                if !terms.kinds.look_inside() {
                    lines.extend(self.move_lines(next_move, &moves[next_move], &rests.forces, by_mean));
                }
                next_move += 1;
            }
            directions.push((k, Arc::clone(&force.direction)));
            let rate = rests.rate(k, attitudes[k]);
            rates.push((k, self.rate_lines(k, &up, (&rate, rests.bias_error(k)), model, terms)));
        }
        let (model, moves, kinds) = (model.clone(), Arc::new(moves), terms.kinds);
        Linear { model, lines, rates, moves, directions, change: Vec::new(), kinds }
    }

    /// Computes the direction residual of a move: the propagated minus the measured gravity direction after the move,
    /// as two components perpendicular to the measured direction.
    fn move_lines(&self, index: usize, at_move: &AtMove, forces: &[Force], by_mean: &Matrix3<f64>) -> [Line; 2] {
        let m = &self.moves[index];
        let AtMove { pass, after, .. } = at_move;
        let across = rows_across(&after.up);
        let (residual, columns) = move_direction(at_move);
        let by_mean = |rest: usize, end: &End| -> Option<Matrix3<f64>> {
            let force = Some(&forces[rest]).filter(|_| end.steady && self.used[rest])?;
            let up = force.direction.up;
            Some((Matrix3::identity() - up * up.transpose()) * by_mean / force.value.norm())
        };
        let [end_before, end_after] = &self.ends[index];
        let from = by_mean(m.from, end_before).map(|by| (m.from, across * pass.rotation.transpose() * by));
        let to = by_mean(m.to, end_after).map(|by| (m.to, -across * by));
        [0, 1].map(|c| Line {
            residual: residual[c],
            jacobian: columns.iter().map(|column| column[c]).collect(),
            by_means: from.iter().chain(&to).map(|(rest, by)| (*rest, by.row(c).transpose())).collect(),
            source: Source::Move(index),
            is_of_later_epoch: m.is_within_rest(self.rests),
        })
    }

    fn rate_lines(
        &self,
        k: usize,
        up: &Vector3<f64>,
        (rate, bias_error): (&Rate, Option<BiasError>),
        model: &Model,
        terms: &Terms<'_>,
    ) -> [Line; 3] {
        let sensitivity = model.gyroscope.sensitivity();
        let UnitRest { rest, propagated, .. } = &self.rests[k];
        let mut residual = rest.angular_rate.mean - model.gyroscope.measure(rate.added);
        let mut by_bias = -Matrix3::identity();
        let mut turned_by_effects = vec![Vector3::zeros(); terms.count];
        if let Some((PropagatedMean { mean_s, .. }, error)) = propagated.as_ref().zip(bias_error) {
            // At a hand-held rest, the mean rotation rate of the hand was subtracted from the mean rate. The rotation
            // rate was computed from the gravity directions at the two ends of the rest, which were propagated with an
            // assumed gyroscope bias. The residual therefore depends on the difference between the bias of the model
            // and the assumed bias (model.md (27)).
            let across = Matrix3::identity() - up * up.transpose();
            let turned = sensitivity * across * (2.0 * mean_s / (rest.end_s - rest.start_s));
            residual += turned * error.value;
            by_bias += turned * model.gyroscope.inverse();
            for (turned_by, column) in turned_by_effects.iter_mut().zip(&error.columns) {
                *turned_by = turned * column;
            }
        }
        let mut jacobians = [0, 1, 2].map(|axis| {
            let mut jacobian = vec![0.0; terms.total()];
            for j in 0..3 {
                jacobian[GYRO_BIAS.start + j] = by_bias[(axis, j)];
                jacobian[GYRO_SENSITIVITY.start + 3 * axis + j] = -rate.added[j];
            }
            jacobian
        });
        for p in terms.parameters_of(Sensor::Gyroscope) {
            let seen = sensitivity * rate.columns[p] - turned_by_effects[p];
            jacobians.iter_mut().zip(&seen).for_each(|(jacobian, seen)| jacobian[BASE + p] = -seen);
        }
        let [x, y, z] = jacobians;
        [(x, residual.x), (y, residual.y), (z, residual.z)].map(|(jacobian, residual)| Line {
            residual,
            jacobian,
            by_means: Vec::new(),
            source: Source::Norm(k),
            is_of_later_epoch: self.rests[k].is_later_epoch(),
        })
    }
}

/// Residuals of the force inside the moves at given parameters, with their derivatives. The residuals of a move are
/// whitened only when a caller requests them with [`Insides::look`].
pub(crate) struct Insides {
    linear: Arc<Linear>,
    noise: Vec<InsideNoise>,
    gravity_mps2: f64,
    no_rows: Lanes,
}

impl Insides {
    /// Prepares the whitening of the residuals inside the moves; `None` if there are no moves.
    pub(super) fn new(linear: Arc<Linear>, noise: Vec<InsideNoise>, gravity_mps2: f64) -> Option<Self> {
        let no_rows = Lanes::inside(&linear.moves.first()?.pass);
        Some(Self { linear, noise, gravity_mps2, no_rows })
    }

    /// Number of moves.
    pub(crate) fn moves(&self) -> usize {
        self.linear.moves.len()
    }

    /// Number of residuals inside all moves.
    pub(crate) fn rows(&self) -> usize {
        self.linear.moves.iter().map(|at_move| count(&at_move.pass, false)).sum()
    }

    /// Matrix without rows. It defines the position of each derivative and of the residual within a row.
    pub(crate) fn no_rows(&self) -> &Lanes {
        &self.no_rows
    }

    /// Overwrites `lanes` with the whitened residuals inside move `k` and their derivatives, one row per residual.
    pub(crate) fn look(&self, k: usize, lanes: &mut Lanes) {
        let at_move = &self.linear.moves[k];
        lanes.resize(count(&at_move.pass, false));
        Rows::side_by_side(lanes).write_move(at_move, &self.noise[k], self.gravity_mps2);
        if self.linear.change.iter().any(|change| *change != 0.0) {
            lanes.change(&self.linear.change);
        }
    }
}
