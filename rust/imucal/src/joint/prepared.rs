//! Input of a joint fit: recordings, rests, moves and their noise. It is the same for all models.

use std::sync::OnceLock;

use nalgebra::UnitQuaternion;

use super::encoders::Encoders;
use super::histories::SharedHistories;
use super::move_ends::EndDirection;
use super::pass::Route;
use super::scatter::Modes;
use super::wander::Wander;
use crate::held::HeldParameter;
use crate::numerics::derivative::Width;
use crate::recording::Recording;
use crate::rests::moves::{End, Move};
use crate::rests::noise_density::NoiseDensity;
use crate::rests::unit_rest::UnitRest;

/// Input of a joint fit. It does not depend on the model.
pub(crate) struct Prepared<'a> {
    pub(crate) recordings: &'a [Recording<'a>],
    pub(crate) rests: &'a [UnitRest],
    /// For each rest, whether the fit uses it.
    pub(crate) used: &'a [bool],
    pub(crate) moves: &'a [Move],
    /// Measured gravity direction at the start and the end of each move, with its variance.
    pub(crate) ends: &'a [[End; 2]],
    /// Window width of the numerical derivative of the rate, for each move. It stays constant during a fit.
    pub(crate) widths: &'a [Width],
    /// For each axis: eigenvectors and eigenvalues of `N^-1/2 C N^-1/2`. N is the noise covariance of the mean rates,
    /// and C is the covariance of the mean rates for a bias instability of 1. The eigenvectors and eigenvalues are
    /// computed only once: C does not depend on the model, and N depends on it only through a small lower limit of the
    /// variances.
    pub(crate) flicker: &'a OnceLock<Option<[Modes; 3]>>,
    /// Temperature histories of the recordings: lags, rate of change, and direction of the last change.
    pub(crate) histories: &'a SharedHistories,
    pub(crate) noise: &'a [NoiseDensity],
    pub(crate) gravity_mps2: f64,
    pub(crate) wander: Wander,
    /// Parameters with a prior.
    pub(crate) held: &'a [HeldParameter],
    /// Encoder readings; present if an effect of the encoders is estimated.
    pub(crate) encoders: Option<Encoders>,
    /// Maximum number of iterations of a joint fit.
    pub(crate) max_iterations: u64,
    /// Duration of a block, s. Blocks are the short intervals inside a move over which the force is averaged.
    pub(crate) block_s: f64,
}

impl Prepared<'_> {
    /// The first used rest whose heading is unknown, because no move leads to it. The first of all used rests is not
    /// reported, because its heading is the reference.
    pub(crate) fn heading_lost(&self) -> Option<usize> {
        let first = self.used.iter().position(|used| *used)?;
        let is_reached = |k: usize| k == first || self.moves.iter().any(|m| m.to == k);
        (0..self.rests.len()).find(|&k| self.used[k] && !is_reached(k))
    }

    /// The rests of one recording that the fit uses, with the start and end time of each rest, s.
    pub(super) fn rests_of(&self, recording: usize) -> (Vec<usize>, Vec<[f64; 2]>) {
        let own = |k: &usize| self.used[*k] && self.rests[*k].recording == recording;
        let rest = |k: usize| (k, [self.rests[k].rest.start_s, self.rests[k].rest.end_s]);
        (0..self.rests.len()).filter(own).map(rest).unzip()
    }

    /// Duration of the longest recording, s.
    pub(crate) fn longest_s(&self) -> f64 {
        self.recordings.iter().map(Recording::span_s).map(|[first, last]| last - first).fold(0.0, f64::max)
    }

    /// Returns the input of the integration over move `index`. `attitude` is the attitude at the start of the move; it
    /// is needed only by effects that depend on the attitude.
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
