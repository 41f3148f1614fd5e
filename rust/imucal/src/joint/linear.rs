//! The residuals of the joint fit and their derivatives at given parameters.

use std::ops::Range;
use std::sync::Arc;

use imucal_core::effects::{Need, Sensor, Surroundings};
use nalgebra::{Matrix3, UnitQuaternion, Vector2, Vector3};

use super::attitude;
use super::encoders::{self, Encoders};
use super::inside::{self, EndDirection};
use super::model::{ACCEL, BASE, GYRO_BIAS, GYRO_SENSITIVITY, Model, force_by_parameters, moments};
use super::pass::{Pass, Route};
use super::terms::{Kinds, Terms};
use super::wander::Wander;
use crate::error::Error;
use crate::moves::{Carried, End, Move, UnitRest, rows_across};
use crate::recording::Recording;
use crate::segment::NoiseDensity;
use crate::workers::{in_order, threads_for};

/// What the fit is made of.
pub(crate) struct Prepared<'a> {
    pub(crate) recordings: &'a [Recording<'a>],
    pub(crate) rests: &'a [UnitRest],
    /// Which rests take part.
    pub(crate) used: &'a [bool],
    pub(crate) moves: &'a [Move],
    /// Before and after each move.
    pub(crate) ends: &'a [[End; 2]],
    pub(crate) noise: &'a [NoiseDensity],
    pub(crate) gravity_mps2: f64,
    pub(crate) wander: Wander,
    /// Where an effect of the encoders is to be estimated.
    pub(crate) encoders: Option<Encoders>,
}

/// A rest at given parameters.
pub(crate) struct AtRest {
    pub(crate) force: Vector3<f64>,
    /// Derivative of the force by every parameter.
    force_jacobian: Vec<Vector3<f64>>,
    /// Derivative of the force by the accelerometer's mean.
    by_mean: Matrix3<f64>,
    /// What the effects add to the rate, and their columns.
    on_rate: Vector3<f64>,
    columns: Vec<Vector3<f64>>,
}

/// A residual, its derivatives by the parameters and by the means of the rests.
#[derive(Clone)]
pub(crate) struct Line {
    pub(crate) residual: f64,
    pub(crate) jacobian: Vec<f64>,
    pub(crate) by_means: Vec<(usize, Vector3<f64>)>,
    pub(crate) source: Source,
}

impl Line {
    /// Of the residual, for a small change of the parameters.
    pub(super) fn change(&self, change: &[f64]) -> f64 {
        self.jacobian.iter().zip(change).map(|(by, change)| by * change).sum()
    }
}

/// What a line is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Source {
    Norm(usize),
    Move(usize),
}

/// One move at given parameters.
pub(crate) struct AtMove {
    pub(crate) pass: Pass,
    pub(crate) before: EndDirection,
    pub(crate) after: EndDirection,
}

/// All residuals at given parameters, not whitened.
#[derive(Clone)]
pub(crate) struct Linear {
    pub(crate) model: Model,
    pub(crate) lines: Vec<Line>,
    /// Three for each rest that takes part: seen minus predicted mean rate, raw units, axis by axis.
    pub(crate) rates: Vec<(usize, [Line; 3])>,
    pub(crate) moves: Arc<Vec<AtMove>>,
    /// Direction of gravity at the rests that take part.
    pub(super) directions: Vec<(usize, EndDirection)>,
    rests: Arc<Vec<Option<AtRest>>>,
    /// By how much the parameters have changed since the moves were passed; empty where they have not. Residuals inside the moves follow
    /// their derivatives by it.
    pub(super) change: Vec<f64>,
    kinds: Kinds,
}

/// Rows of the whitened residuals beyond the lines and the rates.
pub(crate) struct Groups {
    pub(crate) inside: Range<usize>,
    pub(crate) stand_rests: Range<usize>,
    pub(crate) stand_moves: Range<usize>,
}

impl Linear {
    /// Index and direction of gravity of the rests that take part.
    pub(crate) fn directions(&self) -> impl Iterator<Item = (usize, &Vector3<f64>)> {
        self.directions.iter().map(|(k, direction)| (*k, &direction.up))
    }

    /// Whether the force inside the moves takes part.
    pub(crate) fn sees_inside(&self) -> bool {
        self.kinds.in_motion
    }

    /// The residuals after a small change of the parameters; all else stays.
    pub(super) fn moved(&self, change: &[f64], model: Model) -> Self {
        let inside = if self.kinds.in_motion { change } else { &[] };
        let mut moved = Self { model, change: inside.to_vec(), ..self.clone() };
        for line in moved.lines.iter_mut().chain(moved.rates.iter_mut().flat_map(|(_, lines)| lines)) {
            line.residual += line.change(change);
        }
        moved
    }

    pub(crate) fn groups(&self) -> Groups {
        let start = self.lines.len() + 3 * self.rates.len();
        let inside: usize = if self.kinds.in_motion {
            self.moves.iter().map(|m| inside::count(&m.pass, self.kinds.encoders)).sum()
        } else {
            0
        };
        let rests = if self.kinds.encoders { 2 * self.directions.len() } else { 0 };
        let count = |m: &AtMove| encoders::count(&m.pass);
        let moves: usize = if self.kinds.encoders { self.moves.iter().map(count).sum() } else { 0 };
        let (a, b, c) = (start + inside, start + inside + rests, start + inside + rests + moves);
        Groups { inside: start..a, stand_rests: a..b, stand_moves: b..c }
    }

    /// What the rows after the lines and the rates are about, stretch by stretch: the insides of the moves, rests and moves
    /// against the stand.
    pub(super) fn rows_beyond_rates(&self) -> Vec<(Source, Range<usize>)> {
        let mut row = self.lines.len() + 3 * self.rates.len();
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
            moves().for_each(|(k, m)| next(Source::Move(k), encoders::count(&m.pass)));
        }
        found
    }

    /// The group that each row of the whitened residuals belongs to: norms, moves, rates x, y and z, inside the moves,
    /// rests and moves against the stand.
    pub(crate) fn groups_of_rows(&self) -> Vec<usize> {
        let groups = self.groups();
        let lines = self.lines.iter().map(|line| usize::from(matches!(line.source, Source::Move(_))));
        let rates = (0..3 * self.rates.len()).map(|row| 2 + row % 3);
        let rest = [(INSIDE, groups.inside), (STAND_RESTS, groups.stand_rests), (STAND_MOVES, groups.stand_moves)];
        let rest = rest.into_iter().flat_map(|(group, range)| range.map(move |_| group));
        lines.chain(rates).chain(rest).collect()
    }
}

/// The group of the residuals inside the moves, and those of rests and moves against the stand.
pub(crate) const INSIDE: usize = 5;
pub(crate) const STAND_RESTS: usize = 6;
pub(crate) const STAND_MOVES: usize = 7;

/// With effects, or with blocks inside the move, a sample costs as much as so many in the kernel.
const COST: usize = 30;

impl Prepared<'_> {
    /// The first rest behind a move that takes no part: the heading is not known from there on.
    pub(crate) fn heading_lost(&self) -> Option<usize> {
        let first = self.used.iter().position(|used| *used)?;
        let is_reached = |k: usize| k == first || self.moves.iter().any(|m| m.to == k);
        (0..self.rests.len()).find(|&k| self.used[k] && !is_reached(k))
    }

    /// Residuals and derivatives at these parameters.
    pub(crate) fn linearise(&self, terms: &Terms<'_>, parameters: &[f64]) -> Result<Linear, Error> {
        let model = Model::of(parameters, terms)?;
        let with_attitude = terms.needs(Need::Attitude);
        let active = terms.active(&model.values);
        // Where nothing adds to the rate the kernel is fast enough to go ahead.
        let goes_ahead = active.all.is_empty();
        let mut rests: Vec<Option<AtRest>> = (0..self.rests.len()).map(|_| None).collect();
        let mut attitudes: Vec<Option<UnitQuaternion<f64>>> = vec![None; self.rests.len()];
        let mut moves: Vec<AtMove> = Vec::with_capacity(self.moves.len());
        let mut next_move = 0;
        for k in (0..self.rests.len()).filter(|&k| self.used[k]) {
            let mean = self.rests[k].rest.specific_force.mean;
            let mut at_rest = self.at_rest(k, &mean, attitudes[k], &model, terms);
            if with_attitude && attitudes[k].is_none() {
                attitudes[k] = Some(attitude::first(&at_rest.force.normalize()));
                at_rest = self.at_rest(k, &mean, attitudes[k], &model, terms);
            }
            // Each move leads to the attitude at the next rest.
            while let Some(m) = self.moves.get(next_move).filter(|m| with_attitude && m.from == k) {
                let (rotation, up) = if goes_ahead {
                    let [before, after] = self.directions(next_move, None, &model, &active);
                    (self.route(next_move, None, &before, terms).rotation(&model.gyroscope), after.up)
                } else {
                    let at_move = self.at_move(next_move, attitudes[k], &model, terms);
                    let led = (at_move.pass.rotation, at_move.after.up);
                    moves.push(at_move);
                    led
                };
                attitudes[m.to] = attitudes[k].map(|start| attitude::after(&start, &rotation, &up));
                next_move += 1;
            }
            rests[k] = Some(at_rest);
        }
        if moves.is_empty() {
            let samples: usize = self.moves.iter().map(|m| m.last - m.first).sum();
            let cost = if terms.count > 0 || terms.kinds.in_motion || terms.kinds.encoders { COST } else { 1 };
            let start = |index: usize| attitudes[self.moves[index].from].filter(|_| with_attitude);
            let at_move = |index: usize| self.at_move(index, start(index), &model, terms);
            moves = in_order(threads_for(cost * samples), self.moves.len(), at_move);
        }
        Ok(self.lines(model, terms, Arc::new(rests), Arc::new(moves)))
    }

    /// A move that begins with this attitude, if an effect needs it.
    fn at_move(&self, index: usize, attitude: Option<UnitQuaternion<f64>>, model: &Model, terms: &Terms<'_>) -> AtMove {
        let [before, after] = self.directions(index, attitude, model, terms);
        AtMove { pass: self.route(index, attitude, &before, terms).pass(model, terms), before, after }
    }

    /// Gravity before and after a move.
    fn directions(
        &self,
        index: usize,
        attitude: Option<UnitQuaternion<f64>>,
        model: &Model,
        terms: &Terms<'_>,
    ) -> [EndDirection; 2] {
        let Move { from, to, .. } = self.moves[index];
        [(from, true), (to, false)].map(|(rest, at_end)| {
            let end = &self.ends[index][usize::from(!at_end)];
            let direction = self.at_rest(rest, &end.raw, attitude, model, terms).direction();
            self.carried(direction, rest, at_end, model)
        })
    }

    fn route(
        &self,
        index: usize,
        attitude: Option<UnitQuaternion<f64>>,
        before: &EndDirection,
        terms: &Terms<'_>,
    ) -> Route<'_> {
        let span = &self.moves[index];
        Route {
            recording: &self.recordings[span.recording],
            span,
            rotation_world_from_start: attitude,
            gravity_at_start: before.up * self.gravity_mps2,
            with_blocks: terms.kinds.in_motion || terms.kinds.encoders,
        }
    }

    /// What the same passes say of rests and moves from rest to rest alone; `terms` are those of the linearisation without the
    /// residuals inside the moves.
    pub(crate) fn without_insides(&self, linear: &Linear, terms: &Terms<'_>) -> Linear {
        self.lines(linear.model.clone(), terms, Arc::clone(&linear.rests), Arc::clone(&linear.moves))
    }

    /// A direction at the last (`at_end`) or first sample of a rest, had its samples been carried there with the bias of the
    /// model.
    fn carried(&self, mut direction: EndDirection, rest: usize, at_end: bool, model: &Model) -> EndDirection {
        if let Some(Carried { mean_s, bias }) = &self.rests[rest].carried {
            let inverse = model.gyroscope.inverse() * if at_end { *mean_s } else { -mean_s };
            direction.up += (inverse * (model.gyroscope.bias() - bias)).cross(&direction.up);
            for axis in 0..3 {
                direction.jacobian[GYRO_BIAS.start + axis] += inverse.column(axis).cross(&direction.up);
            }
        }
        direction
    }

    /// The unit at a rest, `reading` being the mean of its accelerometer.
    fn at_rest(
        &self,
        k: usize,
        reading: &Vector3<f64>,
        attitude: Option<UnitQuaternion<f64>>,
        model: &Model,
        terms: &Terms<'_>,
    ) -> AtRest {
        let UnitRest { recording, rest, .. } = &self.rests[k];
        let seen = model.accelerometer.correct(*reading);
        // Without effects nothing depends on them.
        let moments =
            if terms.all.is_empty() { Vec::new() } else { moments(&self.recordings[*recording], rest.first..rest.end) };
        let around: Vec<Surroundings<f64>> =
            moments.into_iter().map(|moment| Surroundings { rotation_world_from_body: attitude, ..moment }).collect();
        let mut columns = vec![Vector3::zeros(); terms.count];
        let (on_rate, force) =
            terms.at_rest(&model.values, seen, &around, *recording, rest.first..rest.end, &mut columns);
        let mut force_jacobian = vec![Vector3::zeros(); terms.total()];
        let by_parameters = force_by_parameters(&model.accelerometer, &seen);
        for p in ACCEL {
            force_jacobian[p] = by_parameters.column(p).into_owned();
        }
        for (p, column) in columns.iter().enumerate() {
            if terms.sensors[p] == Sensor::Accelerometer {
                force_jacobian[BASE + p] = -column;
            }
        }
        AtRest { force, force_jacobian, by_mean: *model.accelerometer.inverse(), on_rate, columns }
    }

    fn lines(
        &self,
        model: Model,
        terms: &Terms<'_>,
        rests: Arc<Vec<Option<AtRest>>>,
        moves: Arc<Vec<AtMove>>,
    ) -> Linear {
        let n = terms.total();
        let mut directions = Vec::new();
        let (mut lines, mut rates) = (Vec::new(), Vec::new());
        let mut next_move = 0;
        for (k, at_rest) in rests.iter().enumerate() {
            let Some(at_rest) = at_rest else { continue };
            let up = at_rest.force.normalize();
            lines.push(Line {
                residual: at_rest.force.norm() - self.gravity_mps2,
                jacobian: at_rest.force_jacobian.iter().map(|column| up.dot(column)).collect(),
                by_means: vec![(k, at_rest.by_mean.tr_mul(&up))],
                source: Source::Norm(k),
            });
            while self.moves.get(next_move).is_some_and(|m| m.from == k) {
                if !terms.kinds.in_motion && !terms.kinds.encoders {
                    lines.extend(self.move_lines(next_move, &moves[next_move], &rests));
                }
                next_move += 1;
            }
            directions.push((k, at_rest.direction()));
            rates.push((k, self.rate_lines(k, at_rest, &model, n, terms)));
        }
        Linear { model, lines, rates, moves, directions, rests, change: Vec::new(), kinds: terms.kinds }
    }

    /// Components of the carried minus the measured direction, across the latter.
    fn move_lines(&self, index: usize, at_move: &AtMove, rests: &[Option<AtRest>]) -> [Line; 2] {
        let m = &self.moves[index];
        let AtMove { pass, after, .. } = at_move;
        let across = rows_across(&after.up);
        let (residual, columns) = move_direction(at_move);
        let by_mean = |rest: usize, end: &End| -> Option<Matrix3<f64>> {
            let at_rest = rests[rest].as_ref().filter(|_| end.steady)?;
            let up = at_rest.force.normalize();
            Some((Matrix3::identity() - up * up.transpose()) * at_rest.by_mean / at_rest.force.norm())
        };
        let [end_before, end_after] = &self.ends[index];
        let from = by_mean(m.from, end_before).map(|by| (m.from, across * pass.rotation.transpose() * by));
        let to = by_mean(m.to, end_after).map(|by| (m.to, -across * by));
        [0, 1].map(|c| Line {
            residual: residual[c],
            jacobian: columns.iter().map(|column| column[c]).collect(),
            by_means: from.iter().chain(&to).map(|(rest, by)| (*rest, by.row(c).transpose())).collect(),
            source: Source::Move(index),
        })
    }

    fn rate_lines(&self, k: usize, at_rest: &AtRest, model: &Model, n: usize, terms: &Terms<'_>) -> [Line; 3] {
        let sensitivity = model.gyroscope.sensitivity();
        let UnitRest { rest, carried, .. } = &self.rests[k];
        let mut residual = rest.angular_rate.mean - model.gyroscope.measure(at_rest.on_rate);
        let mut by_bias = -Matrix3::identity();
        if let Some(Carried { mean_s, bias }) = carried {
            // What the directions at both ends leave of the turn between them.
            let up = at_rest.force.normalize();
            let across = Matrix3::identity() - up * up.transpose();
            let turned =
                sensitivity * across * model.gyroscope.inverse() * (2.0 * mean_s / (rest.end_s - rest.start_s));
            residual += turned * (model.gyroscope.bias() - bias);
            by_bias += turned;
        }
        [0, 1, 2].map(|axis| {
            let mut jacobian = vec![0.0; n];
            for j in 0..3 {
                jacobian[GYRO_BIAS.start + j] = by_bias[(axis, j)];
                jacobian[GYRO_SENSITIVITY.start + 3 * axis + j] = -at_rest.on_rate[j];
            }
            for (p, column) in at_rest.columns.iter().enumerate() {
                if terms.sensors[p] == Sensor::Gyroscope {
                    jacobian[BASE + p] = -sensitivity.row(axis).transpose().dot(column);
                }
            }
            Line { residual: residual[axis], jacobian, by_means: Vec::new(), source: Source::Norm(k) }
        })
    }
}

/// Two components of the carried minus the measured direction, and their derivatives by every parameter.
pub(super) fn move_direction(at_move: &AtMove) -> (Vector2<f64>, Vec<Vector2<f64>>) {
    let AtMove { pass, before, after } = at_move;
    let carried = pass.rotation.tr_mul(&before.up);
    let across = rows_across(&after.up);
    let columns = (0..before.jacobian.len()).map(|p| {
        let by_turn = pass.rotation.tr_mul(&before.up.cross(&pass.turn[p]));
        across * (by_turn + pass.rotation.tr_mul(&before.jacobian[p]) - after.jacobian[p])
    });
    (across * (carried - after.up), columns.collect())
}

impl AtRest {
    /// Direction of gravity and its derivatives.
    fn direction(&self) -> EndDirection {
        let up = self.force.normalize();
        let across = (Matrix3::identity() - up * up.transpose()) / self.force.norm();
        EndDirection { up, jacobian: self.force_jacobian.iter().map(|column| across * column).collect() }
    }
}
