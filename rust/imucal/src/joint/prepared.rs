//! What a joint fit is made of, and the passes over it at given parameters.

use std::sync::{Arc, OnceLock};

use imucal_core::effects::{Need, Sensor, Surroundings};
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use super::attitude;
use super::encoders::Encoders;
use super::inside::EndDirection;
use super::linear::{AtMove, AtRest, Linear};
use super::model::{ACCEL, BASE, GYRO_BIAS, Model, force_by_parameters, moments};
use super::pass::Route;
use super::scatter::Modes;
use super::terms::{Term, Terms};
use super::wander::Wander;
use crate::derivative::Width;
use crate::error::Error;
use crate::moves::{Carried, End, Move, UnitRest};
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
    /// How smooth each is, for all passes the same.
    pub(crate) widths: &'a [Width],
    /// How the rates at the rests scatter where biases wander, once it is asked for: only their finest noise depends on the model.
    pub(crate) flicker: &'a OnceLock<Option<[Modes; 3]>>,
    pub(crate) noise: &'a [NoiseDensity],
    pub(crate) gravity_mps2: f64,
    pub(crate) wander: Wander,
    /// Where an effect of the encoders is to be estimated.
    pub(crate) encoders: Option<Encoders>,
    /// Length of the stretches inside a move over which the force is a mean, s.
    pub(crate) block_s: f64,
}

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
        // Where nothing adds to the rate the kernel is fast enough to go ahead.
        let goes_ahead = terms.active(&model.values).all.is_empty();
        let through_rests = self.through_rests(terms);
        let at_rest = |k: usize, attitude| {
            let mean = self.rests[k].rest.specific_force.mean;
            self.at_rest(k, &mean, attitude, &model, (terms, &through_rests[k]))
        };
        // A direction of gravity is that of a force.
        let on_force = terms.of(Sensor::Accelerometer);
        let directions = |index, attitude| self.directions(index, attitude, &model, (&on_force, &through_rests));
        let at_move = |index, attitude| {
            let [before, after] = directions(index, attitude);
            AtMove { pass: self.route(index, attitude, &before, terms).pass(&model, terms), before, after }
        };
        let mut rests: Vec<Option<AtRest>> = (0..self.rests.len()).map(|_| None).collect();
        let mut attitudes: Vec<Option<UnitQuaternion<f64>>> = vec![None; self.rests.len()];
        let mut moves: Vec<AtMove> = Vec::with_capacity(self.moves.len());
        let mut next_move = 0;
        for k in (0..self.rests.len()).filter(|&k| self.used[k]) {
            let mut here = at_rest(k, attitudes[k]);
            if with_attitude && attitudes[k].is_none() {
                attitudes[k] = Some(attitude::first(&here.force.normalize()));
                here = at_rest(k, attitudes[k]);
            }
            // Each move leads to the attitude at the next rest.
            while let Some(m) = self.moves.get(next_move).filter(|m| with_attitude && m.from == k) {
                let (rotation, up) = if goes_ahead {
                    let [before, after] = directions(next_move, None);
                    (self.route(next_move, None, &before, terms).rotation(&model.gyroscope), after.up)
                } else {
                    let at_move = at_move(next_move, attitudes[k]);
                    let led = (at_move.pass.rotation, at_move.after.up);
                    moves.push(at_move);
                    led
                };
                attitudes[m.to] = attitudes[k].map(|start| attitude::after(&start, &rotation, &up));
                next_move += 1;
            }
            rests[k] = Some(here);
        }
        if moves.is_empty() {
            let samples: usize = self.moves.iter().map(|m| m.last - m.first).sum();
            let cost = if terms.count > 0 || terms.kinds.look_inside() { COST } else { 1 };
            let at_move = |index: usize| at_move(index, attitudes[self.moves[index].from]);
            moves = in_order(threads_for(cost * samples), self.moves.len(), at_move);
        }
        Ok(self.lines(model, terms, &rests, Arc::new(moves)))
    }

    /// What the terms depend on through each rest that takes part: of time and temperature where these count.
    fn through_rests(&self, terms: &Terms<'_>) -> Vec<Vec<Surroundings<f64>>> {
        let changes = terms.all.iter().any(Term::changes_at_rest);
        let through = |(k, UnitRest { recording, rest, .. }): (usize, &UnitRest)| match changes {
            true if self.used[k] => moments(&self.recordings[*recording], rest.first..rest.end),
            _ => vec![Surroundings::unknown()],
        };
        self.rests.iter().enumerate().map(through).collect()
    }

    /// Gravity before and after a move.
    fn directions(
        &self,
        index: usize,
        attitude: Option<UnitQuaternion<f64>>,
        model: &Model,
        (terms, through_rests): (&Terms<'_>, &[Vec<Surroundings<f64>>]),
    ) -> [EndDirection; 2] {
        let Move { from, to, .. } = self.moves[index];
        [(from, true), (to, false)].map(|(rest, at_end)| {
            let end = &self.ends[index][usize::from(!at_end)];
            let at_rest = self.at_rest(rest, &end.raw, attitude, model, (terms, &through_rests[rest]));
            self.carried(at_rest.direction(), rest, at_end, model)
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
            width: &self.widths[index],
            block_s: self.block_s,
            has_blocks: terms.kinds.look_inside(),
        }
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
        (terms, through): (&Terms<'_>, &[Surroundings<f64>]),
    ) -> AtRest {
        let UnitRest { recording, rest, .. } = &self.rests[k];
        let seen = model.accelerometer.correct(*reading);
        let around: Vec<Surroundings<f64>> =
            through.iter().map(|moment| Surroundings { rotation_world_from_body: attitude, ..*moment }).collect();
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
}

impl AtRest {
    /// Direction of gravity and its derivatives.
    pub(super) fn direction(&self) -> EndDirection {
        let up = self.force.normalize();
        let across = (Matrix3::identity() - up * up.transpose()) / self.force.norm();
        EndDirection { up, jacobian: self.force_jacobian.iter().map(|column| across * column).collect() }
    }
}
