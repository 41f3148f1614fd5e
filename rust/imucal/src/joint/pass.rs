//! One pass over the samples of a move: the rotation, how every parameter turns it, and the force inside the move.
//!
//! A change of the parameters turns the attitude at time t on the side of the move's start, `R(t) <- exp(turn(t)) R(t)`:
//!
//! ```text
//! w = v - sum Phi theta,   v = T^-1 (m - b),   phi = h s(w) + h^2/12 (w_0 x w_1)
//! s(w) = (-w_(-1) + 13 w_0 + 13 w_1 - w_2) / 24: the mean of the cubic through four samples
//! d_turn_d_p = sum_k A_k (h s(d) + h^2/12 ([w0]x d1 - [w1]x d0)),   A_k = R_k J_l(phi_k),   d = d_w_d_p
//! d = -T^-1 e_i v_j for T_ij,   -T^-1 e_i for b_i,   -Phi_p for a parameter of an effect           model.md (17)
//! ```
//!
//! with w for v in the second part of T_ij's, small as it is.
//!
//! The error of a smooth motion falls with the fourth power of the sample interval; straight lines between the samples
//! leave one of the second, for the rate's curvature does not cancel where the attitude changes.
//!
//! The slope of the effects with the rate itself is left out of d: it is below a per cent, and the residual is exact.

use std::ops::Range;

use imucal_core::effects::{Need, Sensor};
use imucal_core::integrate::increment;
use imucal_core::sensor::Triad;
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use super::model::{ACCEL, BASE, GYRO_BIAS, GYRO_SENSITIVITY, Model, force_by_parameters, surroundings};
use super::terms::{Sample, Terms};
#[cfg(test)]
use crate::carry::STEPS_TAKEN;
use crate::carry::{Pace, Path, Sums};
use crate::correct::{SLOPE_STEP_S, slopes};
use crate::moves::Move;
use crate::recording::Recording;

/// Length of a block inside a move, s.
const BLOCK_S: f64 = 0.04;

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
    /// Mean of d_turn_d_p.
    pub(crate) turn: Vec<Vector3<f64>>,
    /// Mean of the corrected force, turned to the body frame at the start of the move, m/s^2.
    pub(crate) force: Vector3<f64>,
    /// Its derivative by every parameter.
    pub(crate) jacobian: Vec<Vector3<f64>>,
}

/// Running sums of d_turn_d_p.
#[derive(Clone)]
struct TurnSums {
    base: Sums,
    effects: Vec<Vector3<f64>>,
}

impl TurnSums {
    fn zero(count: usize) -> Self {
        Self { base: Sums::zero(), effects: vec![Vector3::zeros(); count] }
    }

    fn add(&mut self, other: &Self) {
        self.base.add(&other.base);
        for (sum, term) in self.effects.iter_mut().zip(&other.effects) {
            *sum += term;
        }
    }

    /// d_turn_d_p for every parameter, divided by `count`.
    fn turn(&self, model: &Model, terms: &Terms<'_>, count: f64) -> Vec<Vector3<f64>> {
        let (inverse, sensitivity) = (model.gyroscope.inverse(), self.base.sensitivity());
        let mut turn = vec![Vector3::zeros(); terms.total()];
        for i in 0..3 {
            let column = inverse.column(i) / -count;
            turn[GYRO_BIAS.start + i] = self.base.bias * column;
            for j in 0..3 {
                turn[GYRO_SENSITIVITY.start + 3 * i + j] = sensitivity[j] * column;
            }
        }
        for (p, sum) in self.effects.iter().enumerate() {
            turn[BASE + p] = sum / -count;
        }
        turn
    }
}

/// Where a pass goes, and what it is to give.
pub(crate) struct Route<'a> {
    pub(crate) recording: &'a Recording<'a>,
    pub(crate) span: &'a Move,
    /// Attitude at the start, where an effect needs it.
    pub(crate) rotation_world_from_start: Option<UnitQuaternion<f64>>,
    pub(crate) with_blocks: bool,
}

/// A block in the making.
struct Gathered {
    first: usize,
    samples: usize,
    force: Vector3<f64>,
    by_parameters: nalgebra::SMatrix<f64, 3, 9>,
    effects: Vec<Vector3<f64>>,
    sums: TurnSums,
    start_s: f64,
}

impl Gathered {
    fn new(count: usize, first: usize, start_s: f64) -> Self {
        Self {
            first,
            samples: 0,
            force: Vector3::zeros(),
            by_parameters: nalgebra::SMatrix::zeros(),
            effects: vec![Vector3::zeros(); count],
            sums: TurnSums::zero(count),
            start_s,
        }
    }

    fn finish(&self, model: &Model, terms: &Terms<'_>, end_s: f64, move_start_s: f64) -> Block {
        let count = self.samples as f64;
        let force = self.force / count;
        // Turning the start of the move by phi moves the force by phi x force.
        let turn = self.sums.turn(model, terms, count);
        let mut jacobian: Vec<Vector3<f64>> = turn.iter().map(|turn| turn.cross(&force)).collect();
        for p in ACCEL {
            jacobian[p] = self.by_parameters.column(p) / count;
        }
        for (p, column) in self.effects.iter().enumerate() {
            if terms.sensors[p] == Sensor::Accelerometer {
                jacobian[BASE + p] = column / -count;
            }
        }
        Block {
            time_s: (self.start_s + end_s) / 2.0 - move_start_s,
            duration_s: end_s - self.start_s,
            samples: self.first..self.first + self.samples,
            turn,
            force,
            jacobian,
        }
    }
}

/// The samples of a move after correction, with one more on either side.
struct Corrected {
    rate: Vec<Vector3<f64>>,
    /// Empty where neither blocks nor effects need it.
    force: Vec<Vector3<f64>>,
    seen_rate: Vec<Vector3<f64>>,
    seen_force: Vec<Vector3<f64>>,
    /// One after the other, as many for each sample as there are parameters of effects.
    columns: Vec<Vector3<f64>>,
}

/// The place of a step among the samples that are corrected.
#[derive(Clone, Copy)]
struct Step {
    /// The sample before it.
    before: usize,
    /// Whether samples further off are there and as far from each other: else the rate goes straight.
    smooth: bool,
}

impl Step {
    /// Mean over the step, `value(k)` being that of sample k.
    #[inline(always)]
    fn mean(self, value: impl Fn(usize) -> Vector3<f64>) -> Vector3<f64> {
        let k = self.before;
        let inner = value(k) + value(k + 1);
        if self.smooth { (inner * 13.0 - (value(k - 1) + value(k + 2))) / 24.0 } else { inner / 2.0 }
    }
}

/// Where steps differ by more than this share, straight lines are safer.
const UNEVEN: f64 = 0.01;
/// The angular acceleration is that of the corrected rate, which is only known afterwards. A pass shrinks the error by the
/// delay of the gyroscope over the time in which the rate changes, a fiftieth, and adds noise where the delay is long.
const SLOPE_PASSES: usize = 3;

impl Route<'_> {
    pub(crate) fn pass(&self, model: &Model, terms: &Terms<'_>) -> Pass {
        let (recording, span) = (self.recording, self.span);
        let (first, last) = (span.first, span.last);
        if terms.count == 0
            && !self.with_blocks
            && let Some((rotation, base)) = self.carried(&model.gyroscope)
        {
            let sums = TurnSums { base, effects: Vec::new() };
            return Pass { rotation, turn: sums.turn(model, terms, 1.0), blocks: Vec::new(), attitudes: Vec::new() };
        }
        #[cfg(test)]
        STEPS_TAKEN.set(STEPS_TAKEN.get() + last - first);
        let corrected = self.correct(model, terms);
        let mut rotation = Matrix3::identity();
        let mut sums = TurnSums::zero(terms.count);
        let mut blocks = Vec::new();
        let block_samples = ((BLOCK_S * (last - first) as f64 / span.duration_s).round() as usize).max(1);
        let start_s = recording.time_s[first];
        let mut gathered = Gathered::new(terms.count, 1, start_s);
        let mut attitudes = if self.with_blocks { vec![rotation] } else { Vec::new() };
        for i in first..last {
            let h = recording.time_s[i + 1] - recording.time_s[i];
            let step = self.step(i);
            let (k0, k1) = (step.before, step.before + 1);
            let (w0, w1) = (corrected.rate[k0], corrected.rate[k1]);
            let turn = step.mean(|k| corrected.rate[k]) * h;
            let seen = step.mean(|k| corrected.seen_rate[k]) * h;
            let a = sums.base.step(&mut rotation, h, [&w0, &w1], &turn, &seen);
            let coning = h * h / 12.0;
            for (p, sum) in sums.effects.iter_mut().enumerate() {
                if terms.sensors[p] == Sensor::Gyroscope {
                    let column = |k: usize| corrected.columns[k * terms.count + p];
                    *sum += a * (step.mean(column) * h + (w0.cross(&column(k1)) - w1.cross(&column(k0))) * coning);
                }
            }
            if self.with_blocks {
                attitudes.push(rotation);
                let seen = force_by_parameters(&model.accelerometer, &corrected.seen_force[k1]);
                gathered.samples += 1;
                gathered.force += rotation * corrected.force[k1];
                gathered.by_parameters += rotation * seen;
                let columns = &corrected.columns[k1 * terms.count..(k1 + 1) * terms.count];
                for (sum, column) in gathered.effects.iter_mut().zip(columns) {
                    *sum += rotation * column;
                }
                gathered.sums.add(&sums);
                if gathered.samples == block_samples {
                    blocks.push(gathered.finish(model, terms, recording.time_s[i + 1], start_s));
                    gathered = Gathered::new(terms.count, i + 2 - first, recording.time_s[i + 1]);
                }
            }
        }
        Pass { rotation, turn: sums.turn(model, terms, 1.0), blocks, attitudes }
    }

    /// Rotation and sums without effects, as the kernel takes them; `None` where steps differ.
    fn carried(&self, gyroscope: &Triad<f64>) -> Option<(Matrix3<f64>, Sums)> {
        let (time, rates) = (self.recording.time_s, self.recording.angular_rate);
        let (first, last) = (self.span.first, self.span.last);
        // The first and the last step of a recording have no sample beyond them.
        let (start, end) = (first.max(1), last.min(time.len() - 2));
        if end < start || !(start..end).all(|i| self.step(i).smooth) {
            return None;
        }
        let straight = |from: usize, to: usize| Path::of(self.recording, from, to).sums(gyroscope);
        let (mut rotation, mut sums) = straight(first, start);
        let pace = Pace::of(&time[start - 1..=end + 1]);
        let middle = Path::cubic(&rates[start - 1..=end + 1], pace).sums(gyroscope);
        for (turn, added) in [middle, straight(end, last)] {
            sums.add_after(&rotation, &added);
            rotation *= turn;
        }
        Some((rotation, sums))
    }

    /// The samples that are corrected: those of the move, and one on either side where there is one.
    fn reach(&self) -> Range<usize> {
        self.span.first.saturating_sub(1)..(self.span.last + 2).min(self.recording.len())
    }

    /// The step after sample `i`.
    fn step(&self, i: usize) -> Step {
        let reach = self.reach();
        let time = &self.recording.time_s;
        let before = i - reach.start;
        if i == 0 || i + 2 >= reach.end {
            return Step { before, smooth: false };
        }
        let h = time[i + 1] - time[i];
        let even = |step: f64| (step - h).abs() <= UNEVEN * h;
        Step { before, smooth: even(time[i] - time[i - 1]) && even(time[i + 2] - time[i + 1]) }
    }

    /// The samples of the reach, freed of the effects.
    fn correct(&self, model: &Model, terms: &Terms<'_>) -> Corrected {
        let reach = self.reach();
        let corrected = |triad: &Triad<f64>, rows: &[[f64; 3]]| -> Vec<Vector3<f64>> {
            rows.iter().map(|row| triad.correct(Vector3::from(*row))).collect()
        };
        let seen_rate = corrected(&model.gyroscope, &self.recording.angular_rate[reach.clone()]);
        let is_force_needed = self.with_blocks || terms.count > 0;
        let forces = if is_force_needed { &self.recording.specific_force[reach.clone()] } else { &[] };
        let seen_force = corrected(&model.accelerometer, forces);
        let mut all = Corrected {
            rate: seen_rate.clone(),
            force: seen_force.clone(),
            seen_rate,
            seen_force,
            columns: vec![Vector3::zeros(); reach.len() * terms.count],
        };
        if terms.count == 0 {
            return all;
        }
        let passes = if terms.needs(Need::AngularAcceleration) { SLOPE_PASSES } else { 1 };
        for _ in 0..passes {
            let slopes = if passes > 1 {
                slopes(&self.recording.time_s[reach.clone()], &all.rate, SLOPE_STEP_S)
            } else {
                vec![]
            };
            self.correct_once(&mut all, &slopes, model, terms);
        }
        all
    }

    fn correct_once(&self, all: &mut Corrected, slopes: &[Vector3<f64>], model: &Model, terms: &Terms<'_>) {
        let mut attitude = self.rotation_world_from_start;
        for (k, index) in self.reach().enumerate() {
            let mut around = surroundings(self.recording, index);
            around.angular_acceleration = slopes.get(k).copied();
            if let (Some(attitude), true) = (&mut attitude, index > self.span.first) {
                let h = self.recording.time_s[index] - self.recording.time_s[index - 1];
                // Without its own rate yet, the sample takes the seen one less what the effects were just before.
                let rate = all.seen_rate[k] - (all.seen_rate[k - 1] - all.rate[k - 1]);
                *attitude *= UnitQuaternion::from_scaled_axis(increment(&all.rate[k - 1], &rate, h));
            }
            around.rotation_world_from_body = attitude;
            let sample = Sample { recording: self.span.recording, index };
            let columns = &mut all.columns[k * terms.count..(k + 1) * terms.count];
            let (seen_rate, seen_force) = (all.seen_rate[k], all.seen_force[k]);
            (all.rate[k], all.force[k]) = terms.remove(&model.values, seen_rate, seen_force, &around, sample, columns);
        }
    }
}
