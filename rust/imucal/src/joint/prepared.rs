//! What a joint fit is made of, and the way through each of its moves.

use std::sync::OnceLock;

use nalgebra::UnitQuaternion;

use super::encoders::Encoders;
use super::move_ends::EndDirection;
use super::pass::Route;
use super::scatter::Modes;
use super::wander::Wander;
use crate::numerics::derivative::Width;
use crate::recording::Recording;
use crate::rests::moves::{End, Move};
use crate::rests::noise_density::NoiseDensity;
use crate::rests::unit_rest::UnitRest;

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

impl Prepared<'_> {
    /// The first rest behind a move that takes no part: the heading is not known from there on.
    pub(crate) fn heading_lost(&self) -> Option<usize> {
        let first = self.used.iter().position(|used| *used)?;
        let is_reached = |k: usize| k == first || self.moves.iter().any(|m| m.to == k);
        (0..self.rests.len()).find(|&k| self.used[k] && !is_reached(k))
    }

    /// The rests of a recording that take part, and from when to when each lasts, s.
    pub(super) fn rests_of(&self, recording: usize) -> (Vec<usize>, Vec<[f64; 2]>) {
        let own = |k: &usize| self.used[*k] && self.rests[*k].recording == recording;
        let rest = |k: usize| (k, [self.rests[k].rest.start_s, self.rests[k].rest.end_s]);
        (0..self.rests.len()).filter(own).map(rest).unzip()
    }

    /// How long the longest recording is, s.
    pub(crate) fn longest_s(&self) -> f64 {
        self.recordings.iter().map(Recording::span_s).map(|[first, last]| last - first).fold(0.0, f64::max)
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
            preintegrated: None,
        }
    }
}
