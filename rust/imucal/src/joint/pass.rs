//! One pass over the samples of a move: the rotation, how every parameter turns it, and the force inside the move.
//!
//! A change of the parameters turns the attitude at time t on the side of the move's start, `R(t) <- exp(turn(t)) R(t)`:
//!
//! ```text
//! w = v - sum Phi theta,   v = T^-1 (m - b),   phi = h s(w) + h^2/12 (w_0 x w_1)
//! s(w) = (-w_(-1) + 13 w_0 + 13 w_1 - w_2) / 24: the mean of the cubic through four samples, for even steps
//! d_turn_d_p = sum_k A_k (h s(d) + h^2/12 ([w0]x d1 - [w1]x d0)),   A_k = R_k J_l(phi_k),   d = d_w_d_p
//! d = -T^-1 e_i v_j for T_ij,   -T^-1 e_i for b_i,   -Phi_p for a parameter of an effect           model.md (17)
//! ```
//!
//! with w for v in the second part of T_ij's, small as it is. Where only the end of the move is asked for, the sums are trapezoids:
//! the kernel's over the samples, those of effects over groups of samples, each at its mean state.
//!
//! The error of a smooth motion falls with the fourth power of the sample interval; straight lines between the samples
//! leave one of the second, for the rate's curvature does not cancel where the attitude changes.
//!
//! The slope of the effects with the rate itself is left out of d: it is below a per cent, and the residual is exact. The force
//! depends on the accelerometer's parameters as gravity, carried along, lets expect: at the sample itself the derivative would
//! hold the same noise as the residual, and beside a field that holds none it would explain that noise.

use std::ops::Range;

use imucal_core::effects::Sensor;
use imucal_core::sensor::Triad;
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use super::corrected::Correction;
use super::model::{ACCEL, BASE, GYRO_BIAS, GYRO_SENSITIVITY, Model, turned_by_parameters};
use super::planes::{Planes, Sum};
use super::terms::Terms;
#[cfg(test)]
use crate::carry::STEPS_TAKEN;
use crate::carry::{Sums, carry_smoothly};
use crate::derivative::Width;
use crate::moves::Move;
use crate::recording::Recording;

/// Length of a block inside a move, s.
pub(crate) const BLOCK_S: f64 = 0.04;

/// What a pass gives.
pub(crate) struct Pass {
    /// `v_start = rotation * v_end`.
    pub(crate) rotation: Matrix3<f64>,
    /// d_turn_d_p at the end for every parameter; zero for the accelerometer's.
    pub(crate) turn: Vec<Vector3<f64>>,
    /// Empty unless asked for.
    pub(crate) blocks: Vec<Block>,
    /// The rotation at every sample of the move; empty unless asked for.
    pub(crate) attitudes: Vec<Matrix3<f64>>,
}

/// A short stretch inside a move.
pub(crate) struct Block {
    /// From the start of the move to the centre, s.
    pub(crate) time_s: f64,
    pub(crate) duration_s: f64,
    /// Its samples, counted from the first of the move.
    pub(crate) samples: Range<usize>,
    /// Mean of d_turn_d_p; without encoders that of the base parameters alone.
    pub(crate) turn: Vec<Vector3<f64>>,
    /// Mean of the corrected force, turned to the body frame at the start of the move, m/s^2.
    pub(crate) force: Vector3<f64>,
    /// Its derivative by every parameter.
    pub(crate) jacobian: Vec<Vector3<f64>>,
}

/// d_turn_d_p for every parameter: the base ones from sums, divided by `count`, and those of effects on the rate.
fn turn(base: &Sums, count: f64, effects: Option<(&Sum, &Planes)>, model: &Model, total: usize) -> Vec<Vector3<f64>> {
    let (inverse, sensitivity) = (model.gyroscope.inverse(), base.sensitivity());
    let mut turn = vec![Vector3::zeros(); total];
    for i in 0..3 {
        let column = inverse.column(i) / -count;
        turn[GYRO_BIAS.start + i] = base.bias * column;
        for j in 0..3 {
            turn[GYRO_SENSITIVITY.start + 3 * i + j] = sensitivity[j] * column;
        }
    }
    if let Some((sum, on_rate)) = effects {
        for (k, p) in on_rate.parameters().iter().enumerate() {
            turn[BASE + p] = -sum.column(k);
        }
    }
    turn
}

/// Where a pass goes, and what it is to give.
pub(crate) struct Route<'a> {
    pub(crate) recording: &'a Recording<'a>,
    pub(crate) span: &'a Move,
    /// Attitude at the start, where an effect needs it.
    pub(crate) rotation_world_from_start: Option<UnitQuaternion<f64>>,
    /// Gravity at the start, m/s^2.
    pub(crate) gravity_at_start: Vector3<f64>,
    /// How smooth the motion is.
    pub(crate) width: &'a Width,
    /// Length of a block inside the move, s.
    pub(crate) block_s: f64,
    /// Whether blocks are wanted, or only the end of the move.
    pub(crate) has_blocks: bool,
}

/// A pass on its way.
struct Walk {
    rotation: Matrix3<f64>,
    /// Running sums of d_turn_d_p.
    base: Sums,
    effects: Sum,
    /// What each group's columns add to the sum at the end of a stretch, and to their mean over it.
    weights: Vec<[Matrix3<f64>; 2]>,
    blocks: Vec<Block>,
    attitudes: Vec<Matrix3<f64>>,
}

/// Groups that are taken together where no blocks are wanted.
const TOGETHER: usize = 16;

/// A block in the making: sums over its samples.
struct Gathered {
    force: Vector3<f64>,
    /// Of the rotation, and of the rotation times each component of the expected force.
    rotation: Matrix3<f64>,
    by_force: [Matrix3<f64>; 3],
    /// Of the running sums after each step.
    base: Sums,
}

impl Gathered {
    fn nothing() -> Self {
        let zero = Matrix3::zeros();
        Self { force: Vector3::zeros(), rotation: zero, by_force: [zero; 3], base: Sums::zero() }
    }
}

impl Route<'_> {
    pub(crate) fn pass(&self, model: &Model, terms: &Terms<'_>) -> Pass {
        let span = self.span;
        let (first, last) = (span.first, span.last);
        if !self.has_blocks {
            return self.to_end(model, terms);
        }
        #[cfg(test)]
        STEPS_TAKEN.set(STEPS_TAKEN.get() + last - first);
        let mut correction = self.correct(model, terms);
        let mut walk = Walk {
            rotation: Matrix3::identity(),
            base: Sums::zero(),
            effects: Sum::zero(&correction.on_rate),
            weights: Vec::new(),
            blocks: Vec::new(),
            attitudes: vec![Matrix3::identity()],
        };
        let of_block = self.of_block();
        let mut start = first;
        while start < last {
            let end = (start + of_block).min(last);
            // Steps that do not fill a block belong to none.
            self.walk(start..end, &mut correction, model, terms, end - start == of_block, &mut walk);
            start = end;
        }
        let turn = turn(&walk.base, 1.0, Some((&walk.effects, &correction.on_rate)), model, terms.total());
        Pass { rotation: walk.rotation, turn, blocks: walk.blocks, attitudes: walk.attitudes }
    }

    /// Samples of a block.
    pub(super) fn of_block(&self) -> usize {
        let Move { first, last, duration_s, .. } = self.span;
        ((self.block_s * (last - first) as f64 / duration_s).round() as usize).max(1)
    }

    /// From rest to rest: rotation and sums of the base parameters are the kernel's, the effects' are trapezoids over groups.
    fn to_end(&self, model: &Model, terms: &Terms<'_>) -> Pass {
        let pass = |rotation, turn| Pass { rotation, turn, blocks: Vec::new(), attitudes: Vec::new() };
        // What effects do to the force turns nothing.
        if terms.all.iter().all(|term| term.sensor != Sensor::Gyroscope) {
            let (rotation, base) = self.carried(&model.gyroscope);
            return pass(rotation, turn(&base, 1.0, None, model, terms.total()));
        }
        let mut correction = self.correct(model, terms);
        let (rotation, base) = correction.carried();
        let mut effects = Sum::zero(&correction.on_rate);
        let weights: Vec<[Matrix3<f64>; 1]> = correction.weights().into_iter().map(|weight| [weight]).collect();
        for first in (0..weights.len()).step_by(TOGETHER) {
            let end = (first + TOGETHER).min(weights.len());
            correction.until(end);
            let [more] = correction.on_rate.weighted(first, &weights[first..end]);
            effects.add(&more);
            correction.on_rate.forget_before(end);
        }
        pass(rotation, turn(&base, 1.0, Some((&effects, &correction.on_rate)), model, terms.total()))
    }

    /// Takes these steps, and makes a block of them if they are one.
    fn walk(
        &self,
        steps: Range<usize>,
        correction: &mut Correction<'_>,
        model: &Model,
        terms: &Terms<'_>,
        is_block: bool,
        walk: &mut Walk,
    ) {
        let (time, count) = (self.recording.time_s, steps.len());
        let k_first = self.step(steps.start).before;
        // From one sample before the first step to one after the last, where there are any.
        let reached = k_first.saturating_sub(1)..(k_first + count + 2).min(correction.all.rate.len());
        let groups = correction.groups;
        correction.until(groups.of(reached.end - 1) + 1);
        let (first_group, first_after) = (groups.of(reached.start), groups.of(k_first + 1));
        correction.on_rate.forget_before(first_group);
        correction.on_force.forget_before(first_group);
        let (corrected, on_rate, on_force) = (&correction.all, &correction.on_rate, &correction.on_force);
        walk.weights.clear();
        walk.weights.resize(groups.of(reached.end - 1) + 1 - first_group, [Matrix3::zeros(); 2]);
        let mut turned = vec![[Matrix3::zeros()]; groups.of(k_first + count) + 1 - first_after];
        let mut gathered = Gathered::nothing();
        for (j, i) in steps.clone().enumerate() {
            let h = time[i + 1] - time[i];
            let step = self.step(i);
            let (k0, k1) = (step.before, step.before + 1);
            let (w0, w1) = (corrected.rate[k0], corrected.rate[k1]);
            let turn = step.mean(|k| corrected.rate[k]) * h;
            let seen = step.mean(|k| corrected.seen_rate[k]) * h;
            let a = walk.base.step(&mut walk.rotation, h, [&w0, &w1], &turn, &seen);
            if !on_rate.parameters().is_empty() {
                // A mean over the block has this share of what the step adds.
                let share = (count - j) as f64 / count as f64;
                step.weigh(&a, h, [&w0, &w1], |k, weight| {
                    let [end, mean] = &mut walk.weights[groups.of(k) - first_group];
                    *end += weight;
                    if is_block {
                        *mean += weight * share;
                    }
                });
            }
            walk.attitudes.push(walk.rotation);
            if is_block {
                gathered.force += walk.rotation * corrected.force[k1];
                let effects = corrected.seen_force[k1] - corrected.force[k1];
                let expected = walk.rotation.tr_mul(&self.gravity_at_start) + effects;
                gathered.rotation += walk.rotation;
                (0..3).for_each(|j| gathered.by_force[j] += walk.rotation * expected[j]);
                gathered.base.add(&walk.base);
                turned[groups.of(k1) - first_after][0] += walk.rotation;
            }
        }
        if !is_block {
            let weights: Vec<[Matrix3<f64>; 1]> = walk.weights.iter().map(|[end, _]| [*end]).collect();
            let [end] = on_rate.weighted(first_group, &weights);
            walk.effects.add(&end);
            return;
        }
        let [end, mean] = on_rate.weighted(first_group, &walk.weights);
        let mut mean_turn = walk.effects.clone();
        mean_turn.add(&mean);
        walk.effects.add(&end);
        let [force_columns] = on_force.weighted(first_after, &turned);

        let n = count as f64;
        let force = gathered.force / n;
        let turn = turn(&gathered.base, n, Some((&mean_turn, on_rate)), model, terms.total());
        // Turning the start of the move by phi moves the force by phi x force.
        let mut jacobian: Vec<Vector3<f64>> = turn.iter().map(|turn| turn.cross(&force)).collect();
        let by_parameters = turned_by_parameters(&model.accelerometer, &gathered.rotation, &gathered.by_force);
        for p in ACCEL {
            jacobian[p] = by_parameters.column(p) / n;
        }
        for (k, p) in on_force.parameters().iter().enumerate() {
            jacobian[BASE + p] = force_columns.column(k) / -n;
        }
        // What effects turn is asked for by the stand alone.
        let turn = if terms.kinds.encoders { turn } else { turn[..BASE].to_vec() };
        let first = self.span.first;
        walk.blocks.push(Block {
            time_s: f64::midpoint(time[steps.start], time[steps.end]) - time[first],
            duration_s: time[steps.end] - time[steps.start],
            samples: steps.start + 1 - first..steps.end + 1 - first,
            turn,
            force,
            jacobian,
        });
    }

    /// The rotation without effects.
    pub(crate) fn rotation(&self, gyroscope: &Triad<f64>) -> Matrix3<f64> {
        self.carried(gyroscope).0
    }

    /// Rotation and sums without effects, as the kernel takes them.
    pub(super) fn carried(&self, gyroscope: &Triad<f64>) -> (Matrix3<f64>, Sums) {
        let Recording { time_s, angular_rate, .. } = *self.recording;
        carry_smoothly(time_s, angular_rate, self.span.first, self.span.last, gyroscope)
    }
}
