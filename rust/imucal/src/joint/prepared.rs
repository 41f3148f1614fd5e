//! Inputs of a joint fit, and the integration of each of its moves.

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

/// Inputs of a joint fit.
pub(crate) struct Prepared<'a> {
    pub(crate) recordings: &'a [Recording<'a>],
    pub(crate) rests: &'a [UnitRest],
    /// Whether each rest is used.
    pub(crate) used: &'a [bool],
    pub(crate) moves: &'a [Move],
    /// Directions of gravity before and after each move.
    pub(crate) ends: &'a [[End; 2]],
    /// Smoothing width of the rate's derivative in each move, the same for all passes.
    pub(crate) widths: &'a [Width],
    /// Eigenvectors for the scatter of the rates with bias instability, calculated when first needed. Only the noise
    /// depends on the model.
    pub(crate) flicker: &'a OnceLock<Option<[Modes; 3]>>,
    pub(crate) noise: &'a [NoiseDensity],
    pub(crate) gravity_mps2: f64,
    pub(crate) wander: Wander,
    /// Encoder angles; `None` if no effect on encoders is estimated.
    pub(crate) encoders: Option<Encoders>,
    /// Length of the blocks inside a move over which the force is averaged, s.
    pub(crate) block_s: f64,
}

impl Prepared<'_> {
    /// Index of the first rest that follows an unused move; the heading is unknown from there on.
    pub(crate) fn heading_lost(&self) -> Option<usize> {
        let first = self.used.iter().position(|used| *used)?;
        let is_reached = |k: usize| k == first || self.moves.iter().any(|m| m.to == k);
        (0..self.rests.len()).find(|&k| self.used[k] && !is_reached(k))
    }

    /// Indices of the used rests of a recording, and start and end of each, s.
    pub(super) fn rests_of(&self, recording: usize) -> (Vec<usize>, Vec<[f64; 2]>) {
        let own = |k: &usize| self.used[*k] && self.rests[*k].recording == recording;
        let rest = |k: usize| (k, [self.rests[k].rest.start_s, self.rests[k].rest.end_s]);
        (0..self.rests.len()).filter(own).map(rest).unzip()
    }

    /// Duration of the longest recording, s.
    pub(crate) fn longest_s(&self) -> f64 {
        self.recordings.iter().map(Recording::span_s).map(|[first, last]| last - first).fold(0.0, f64::max)
    }

    /// Inputs for the integration of a move, with the attitude at its start if an effect depends on it.
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
