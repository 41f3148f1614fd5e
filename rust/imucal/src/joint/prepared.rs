//! What a joint fit is made of, and the passes over it at given parameters.

use std::sync::OnceLock;

use imucal_core::effects::Need;
use nalgebra::UnitQuaternion;

use super::attitude;
use super::encoders::Encoders;
use super::inside::EndDirection;
use super::linear::{AtMove, Linear};
use super::model::Model;
use super::pass::Route;
use super::rests::Rests;
use super::scatter::Modes;
use super::terms::Terms;
use super::wander::Wander;
use crate::derivative::Width;
use crate::error::Error;
use crate::moves::{End, Move, UnitRest};
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
        let rests = Rests::new(self, &model, terms);
        let ends: Vec<_> = (0..self.moves.len()).map(|index| rests.ends(index)).collect();
        let has_blocks = terms.kinds.look_inside();
        let at_move = |index: usize, attitude, carried| {
            let [before, after] = ends[index].clone();
            let route = Route { carried, ..self.route(index, attitude, &before, has_blocks) };
            AtMove { pass: route.pass(&model, terms), before, after }
        };
        // Where nothing adds to the rate the kernel is fast enough to go ahead.
        let goes_ahead = terms.active(&model.values).all.is_empty();
        let mut attitudes: Vec<Option<UnitQuaternion<f64>>> = vec![None; self.rests.len()];
        let mut moves: Vec<AtMove> = Vec::with_capacity(self.moves.len());
        let mut carried = vec![None; self.moves.len()];
        let mut next_move = 0;
        for k in (0..self.rests.len()).filter(|&k| self.used[k] && terms.needs(Need::Attitude)) {
            let start = *attitudes[k].get_or_insert_with(|| attitude::first(&rests.forces[k].direction.up));
            // Each move leads to the attitude at the next rest.
            while let Some(m) = self.moves.get(next_move).filter(|m| m.from == k) {
                let [before, after] = &ends[next_move];
                let rotation = if goes_ahead {
                    let found = self.route(next_move, None, before, has_blocks).carry(&model.gyroscope);
                    carried[next_move] = Some(found);
                    found.0
                } else {
                    moves.push(at_move(next_move, Some(start), None));
                    moves[next_move].pass.rotation
                };
                attitudes[m.to] = Some(attitude::after(&start, &rotation, &after.up));
                next_move += 1;
            }
        }
        if moves.is_empty() {
            let samples: usize = self.moves.iter().map(|m| m.last - m.first).sum();
            let cost = if terms.count > 0 || terms.kinds.look_inside() { COST } else { 1 };
            let at_move = |index: usize| at_move(index, attitudes[self.moves[index].from], carried[index]);
            moves = in_order(threads_for(cost * samples), self.moves.len(), at_move);
        }
        Ok(self.lines(&model, terms, &rests, &attitudes, moves))
    }

    /// That of a move, with the attitude at its start where an effect needs it.
    pub(super) fn route(
        &self,
        index: usize,
        attitude: Option<UnitQuaternion<f64>>,
        before: &EndDirection,
        has_blocks: bool,
    ) -> Route<'_> {
        let span = &self.moves[index];
        Route {
            recording: &self.recordings[span.recording],
            span,
            rotation_world_from_start: attitude,
            gravity_at_start: before.up * self.gravity_mps2,
            width: &self.widths[index],
            block_s: self.block_s,
            has_blocks,
            carried: None,
        }
    }
}
