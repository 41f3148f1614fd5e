//! Integrates the samples of one move. The results are the rotation over the move, its derivatives with respect to the
//! parameters, and the force inside the move.
//!
//! R(t) rotates vectors from the body frame at time t to the body frame at the start of the move. A small change of the
//! parameters changes R(t) to exp(turn(t)) R(t). Here turn(t) is the attitude error in the body frame at the start of
//! the move.
//!
//! ```text
//! w = v - sum Phi theta,   v = T^-1 (m - b),   R <- R exp(h s(w) + h^2/12 (w_0 x w_1))
//! s(w) = (-w_(-1) + 13 w_0 + 13 w_1 - w_2) / 24: the mean of the cubic through four samples, for equal steps
//! d_turn_d_p = integral of R d dt,   d = d_w_d_p
//! d = -T^-1 e_i v_j for T_ij,   -T^-1 e_i for b_i,   -Phi_p for a parameter of an effect           model.md (17)
//! ```
//!
//! m is the measured rate, T the sensitivity, and b the bias of the gyroscope. Phi is the field of an effect and theta
//! its parameters. v is the rate corrected for T and b only. w is the rate corrected for T, b and the effects. w_0 and
//! w_1 are the values of w at the start and at the end of a step of length h. w_(-1) and w_2 are the values of w at the
//! samples before and after the step. e_i is the unit vector along axis i, v_j is component j of v, and p is any
//! parameter. R is computed at every sample. The derivative d is evaluated at the midpoints of segments, which consist
//! of several samples. If only the rotation over the whole move is needed, preintegration gives the integral of R d dt
//! for the base parameters (model.md (6)).
//!
//! For smooth motion, the integration error decreases with the fourth power of the sampling interval. Linear
//! interpolation between samples would neglect the curvature of the rate, and its error would decrease only with the
//! second power. These errors of linear interpolation would cancel over a move only if the axis of the rotation were
//! fixed, because then only the integral of the rate matters.
//!
//! The derivative d neglects that the effects depend on the rate, which depends on the parameters. For most effects,
//! the neglected terms are less than 1 % of d (exceptions: model.md (17)). The residuals themselves are computed
//! without this approximation. The derivative of the force with respect to the accelerometer parameters is evaluated at
//! the propagated gravity instead of the sampled force. If it were evaluated at the sampled force, its columns of the
//! Jacobian would contain the noise of the residuals. A linear combination of these columns and of noise-free columns
//! could then fit this noise (docs/decisions/0022).

mod attitude_jacobian;
mod corrected;
pub(super) mod planes;
pub(super) mod segments;
mod stretches;

use std::ops::Range;

use imucal_core::effects::{Need, Sensor};
use imucal_core::sensor::Triad;
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use super::model::Model;
use super::terms::{SideBySide, Terms};
use crate::numerics::derivative::Width;
#[cfg(test)]
use crate::preintegration::STEPS_TAKEN;
use crate::preintegration::{Sums, attitudes, integrate_rotation, preintegrate};
use crate::recording::Recording;
use crate::rests::moves::Move;
use attitude_jacobian::Turns;
use corrected::Corrected;
use planes::Changes;

/// Duration of a block inside a move over which the force is averaged, s (model.md (20)).
pub(crate) const BLOCK_S: f64 = 0.04;

/// Result of the integration over one move.
pub(crate) struct Pass {
    /// Rotation of the body frame from the end of the move to its start: `v_start = rotation * v_end`.
    pub(crate) rotation: Matrix3<f64>,
    /// Derivative of the attitude at the end of the move with respect to every parameter, rad per unit of the
    /// parameter. It is a rotation vector in the body frame at the start of the move. It is zero for the parameters of
    /// the accelerometer.
    pub(crate) turn: Vec<Vector3<f64>>,
    /// Blocks (short intervals with a mean force) inside the move; empty unless requested.
    pub(crate) blocks: Vec<Block>,
    /// Derivatives of the mean attitude and of the mean force of each block with respect to the parameters.
    pub(super) changes: Changes,
    /// Rotation from every sample to the start of the move; empty unless residuals relative to the encoders are
    /// computed.
    pub(super) attitudes: Vec<Matrix3<f64>>,
}

/// Effects of a model, prepared for the integration over moves.
pub(crate) struct EvaluatedTerms<'a> {
    terms: &'a Terms<'a>,
    /// Effects with at least one nonzero parameter.
    active: Terms<'a>,
    on_rate: SideBySide<'a>,
    on_force: SideBySide<'a>,
}

impl<'a> EvaluatedTerms<'a> {
    pub(crate) fn new(model: &Model, terms: &'a Terms<'a>) -> Self {
        let [on_rate, on_force] =
            [Sensor::Gyroscope, Sensor::Accelerometer].map(|sensor| terms.side_by_side(sensor, &model.values));
        Self { terms, active: terms.active(&model.values), on_rate, on_force }
    }

    /// Whether all parameters of the effects are zero.
    pub(crate) fn adds_nothing(&self) -> bool {
        self.active.all.is_empty()
    }
}

/// A short interval inside a move. The force is averaged over it.
pub(crate) struct Block {
    /// Time from the start of the move to the centre of the block, s.
    pub(crate) time_s: f64,
    pub(crate) duration_s: f64,
    /// Samples of the block, counted from the first sample of the move.
    pub(crate) samples: Range<usize>,
    /// Mean corrected force, rotated to the body frame at the start of the move, m/s^2.
    pub(crate) force: Vector3<f64>,
}

/// One move to integrate, with the requested outputs.
pub(crate) struct Route<'a> {
    pub(crate) recording: &'a Recording<'a>,
    pub(crate) span: &'a Move,
    /// Attitude at the start of the move; needed by effects that depend on the attitude.
    pub(crate) rotation_world_from_start: Option<UnitQuaternion<f64>>,
    /// Gravity in the body frame at the start of the move, m/s^2.
    pub(crate) gravity_at_start: Vector3<f64>,
    /// Window width of the numerical derivative of the rate. It depends on the smoothness of the motion (model.md
    /// (16)).
    pub(crate) width: &'a Width,
    /// Duration of a block inside the move, s.
    pub(crate) block_s: f64,
    /// Whether the blocks inside the move are requested, each with its mean attitude and mean force. Otherwise, only
    /// the rotation over the whole move is requested.
    pub(crate) has_blocks: bool,
    /// Result of preintegration of the rates that are not corrected for effects: the rotation over the move, and the
    /// integrals from which its Jacobian is computed. `None` if it is not yet known. It is not used if blocks are
    /// requested.
    pub(crate) preintegrated: Option<(Matrix3<f64>, Sums)>,
}

impl Route<'_> {
    pub(crate) fn pass(&self, model: &Model, evaluated: &EvaluatedTerms<'_>) -> Pass {
        if !self.has_blocks {
            return self.over_whole_move(model, evaluated);
        }
        let EvaluatedTerms { terms, active, .. } = evaluated;
        let Move { first, last, .. } = *self.span;
        #[cfg(test)]
        STEPS_TAKEN.set(STEPS_TAKEN.get() + last - first);
        let all = self.freed(model, active, terms.needs(Need::AngularAcceleration));
        let [stretch, stretches] = self.stretches_of_block();
        let of_block = stretch * stretches;
        let mut turns = Turns::new(self, model, evaluated, &all, [stretch, stretches]);
        let rotations = self.rotations_of_samples(&all);
        let mut blocks = Vec::new();
        let mut start = first;
        while start < last {
            let end = (start + of_block).min(last);
            let force = self.mean_force(start..end, &all, &rotations);
            // The last integration steps of the move belong to no block if they do not fill a complete block.
            if end - start == of_block {
                blocks.push(self.block(start..end, force));
                turns.next_block();
            }
            start = end;
        }
        let (turn, changes) = turns.at_end(terms.total());
        let matrix = |rotation: &UnitQuaternion<f64>| *rotation.to_rotation_matrix().matrix();
        let attitudes = if terms.kinds.encoders { rotations.iter().map(matrix).collect() } else { Vec::new() };
        let rotation = matrix(&rotations[rotations.len() - 1]);
        Pass { rotation, turn, blocks, changes, attitudes }
    }

    /// Returns the number of samples in a segment, and the number of segments in a block. A block consists of two
    /// segments, or of one segment if the block has a single sample.
    pub(super) fn stretches_of_block(&self) -> [usize; 2] {
        let [stretch, block] = [self.block_s / 2.0, self.block_s].map(|length_s| self.samples_in(length_s));
        [stretch, if block > stretch { 2 } else { 1 }]
    }

    /// Number of sample intervals in a time of `length_s`, at least one.
    pub(super) fn samples_in(&self, length_s: f64) -> usize {
        let Move { first, last, duration_s, .. } = self.span;
        ((length_s * (last - first) as f64 / duration_s).round() as usize).max(1)
    }

    /// Integrates the corrected rates to the rotation from every sample to the start of the move. The first rotation is
    /// the identity.
    fn rotations_of_samples(&self, all: &Corrected) -> Vec<UnitQuaternion<f64>> {
        let (Move { first, last, .. }, time_s) = (self.span, self.recording.time_s);
        let turned = |i: usize| self.step(i).turn(|k| all.rate[k], time_s[i + 1] - time_s[i]);
        let turns: Vec<Vector3<f64>> = (*first..*last).map(turned).collect();
        attitudes(UnitQuaternion::identity(), &turns)
    }

    /// Computes the mean force over the samples at the ends of the integration steps `steps`. The force is first
    /// rotated to the body frame at the start of the move.
    fn mean_force(&self, steps: Range<usize>, all: &Corrected, rotations: &[UnitQuaternion<f64>]) -> Vector3<f64> {
        let (first, reach, count) = (self.span.first, self.reach().start, steps.len() as f64);
        let turned = |i: usize| rotations[i - first].to_rotation_matrix() * all.force[i - reach];
        (steps.start + 1..=steps.end).map(turned).sum::<Vector3<f64>>() / count
    }

    /// Block that consists of these integration steps and has the mean force `force`.
    fn block(&self, steps: Range<usize>, force: Vector3<f64>) -> Block {
        let (time, first) = (self.recording.time_s, self.span.first);
        Block {
            time_s: f64::midpoint(time[steps.start], time[steps.end]) - time[first],
            duration_s: time[steps.end] - time[steps.start],
            samples: steps.start + 1 - first..steps.end + 1 - first,
            force,
        }
    }

    /// Rotation over the move, from rates that are not corrected for effects.
    pub(super) fn rotation(&self, gyroscope: &Triad<f64>) -> Matrix3<f64> {
        integrate_rotation(self.recording, self.span.first, self.span.last, gyroscope)
    }

    /// Rotation over the move, from rates that are not corrected for effects, and the integrals from which its Jacobian
    /// is computed.
    pub(super) fn preintegrated_base(&self, gyroscope: &Triad<f64>) -> (Matrix3<f64>, Sums) {
        let Recording { time_s, angular_rate, .. } = *self.recording;
        preintegrate(time_s, angular_rate, self.span.first, self.span.last, gyroscope)
    }
}
