//! Integrates the rates of a move in segments (short intervals), and computes the derivatives of the rotation over the
//! whole move with respect to base parameters and effects. Also divides a move into the segments at which generic error
//! fields are evaluated. A generic error field is a variation of a bias or scale that no effect of the catalogue
//! describes.

use imucal_core::effects::Need;
use imucal_core::sensor::Triad;
use nalgebra::{Matrix3, Vector3};

use super::{Pass, Route};
use crate::joint::model::Model;
use crate::joint::pass::attitude_jacobian::Turned;
use crate::joint::pass::stretches::Stretches;
use crate::joint::pass::{Changes, Corrected, EvaluatedTerms};
use crate::joint::terms::SideBySide;
use crate::parameters::{BASE, GYRO_BIAS, GYRO_SENSITIVITY};
use crate::preintegration::{Sums, preintegrate};
use crate::recording::Samples;

/// Segment of a move. A generic error field (unknown variation of a bias or scale) has one value in each segment.
pub(crate) struct Stretch {
    /// Time of the midpoint since the first sample of the recording, s.
    pub(crate) time_s: f64,
    /// Index of the sample at the midpoint.
    pub(crate) sample: usize,
    /// Rotation from the body frame at the midpoint to the start of the move: `v_start = attitude v_here`.
    pub(crate) attitude: Matrix3<f64>,
    pub(crate) rate: Vector3<f64>,
    /// Derivative of the attitude at the midpoint with respect to a constant rate that is subtracted from the measured
    /// rate of all samples since the start of the move, rad per rad/s. Column k is for a rate about body axis k.
    pub(crate) turn: Matrix3<f64>,
}

/// Segments of a move. `end` is defined like [`Stretch::turn`], but for the end of the move.
pub(crate) struct MoveSegments {
    pub(crate) stretches: Vec<Stretch>,
    pub(crate) end: Matrix3<f64>,
}

impl Route<'_> {
    /// Divides the move into segments, and computes the attitude at the midpoint of each segment from rates that are
    /// not corrected for effects. Only every `every`-th segment is kept. `pass` is the result of the integration over
    /// this move.
    pub(crate) fn segments(&self, model: &Model, pass: &Pass, every: usize) -> MoveSegments {
        let (recording, span) = (self.recording, self.span);
        let size = self.stretches_of_block().iter().product();
        let all = self.stretches(model, None, size, false);
        let first = all.groups.of(span.first + 1 - self.reach().start);
        let count = (span.last - span.first) / size;
        let mut turned = Matrix3::zeros();
        let mut stretches = Vec::with_capacity(count.div_ceil(every));
        for (k, weight) in all.weights().iter().enumerate().take(first + count) {
            let until = turned - weight / 2.0;
            turned -= weight;
            if k.checked_sub(first).is_some_and(|block| block % every == (every / 2).min(count - 1)) {
                let sample = span.first + (k - first) * size + size / 2 + 1;
                stretches.push(Stretch {
                    time_s: recording.time_s[sample] - recording.time_s[0],
                    sample,
                    attitude: all.rotations[k],
                    rate: all.states[k].angular_rate,
                    turn: until,
                });
            }
        }
        let end = Matrix3::from_columns(&[0, 1, 2].map(|axis| pass.turn[GYRO_BIAS.start + axis]));
        MoveSegments { stretches, end: end * model.gyroscope.sensitivity() }
    }
}

/// Maximum duration of a segment, s. The derivatives with respect to the parameters of effects are evaluated once per
/// segment.
const STRETCH_S: f64 = 0.04;
/// Minimum number of segments per move. It shortens the segments of moves that last less than 0.96 s.
const FEWEST: f64 = 24.0;

/// Computes the derivative of the attitude at the end of the move with respect to the base parameters, rad per unit of
/// the parameter. The entries of the parameters of effects are set to zero.
fn turn(base: &Sums, model: &Model, total: usize) -> Vec<Vector3<f64>> {
    let (inverse, sensitivity) = (model.gyroscope.inverse(), &base.sensitivity);
    let mut turn = vec![Vector3::zeros(); total];
    for i in 0..3 {
        let column = -inverse.column(i);
        turn[GYRO_BIAS.start + i] = base.bias * column;
        for j in 0..3 {
            turn[GYRO_SENSITIVITY.start + 3 * i + j] = sensitivity[j] * column;
        }
    }
    turn
}

impl Route<'_> {
    /// Computes the rotation over the whole move and its derivatives with respect to all parameters. The mean forces of
    /// blocks inside the move are not computed.
    pub(super) fn over_whole_move(&self, model: &Model, evaluated: &EvaluatedTerms<'_>) -> Pass {
        // Effects on the force do not change the attitude.
        let EvaluatedTerms { terms, active, on_rate: SideBySide { terms: own, values, places }, .. } = evaluated;
        let total = terms.total();
        let pass = |rotation, turn| Pass {
            rotation,
            turn,
            blocks: Vec::new(),
            changes: Changes::none(),
            attitudes: Vec::new(),
        };
        if own.all.is_empty() {
            let (rotation, base) = self.preintegrated.unwrap_or_else(|| self.preintegrated_base(&model.gyroscope));
            return pass(rotation, turn(&base, model, total));
        }
        let freed = (!active.all.is_empty()).then(|| self.freed(model, active, false));
        let size = self.samples_in(STRETCH_S.min(self.span.duration_s / FEWEST));
        let stretches = self.stretches(model, freed.as_ref(), size, own.needs(Need::AngularAcceleration));
        let weights = stretches.weights();
        let (rotation, base) = match &freed {
            None => self.preintegrated.unwrap_or_else(|| self.preintegrated_base(&model.gyroscope)),
            Some(all) => self.preintegrate_corrected(model, all, &stretches, &weights),
        };
        let mut on_rate = Turned::new(places.clone());
        let mut columns = own.room();
        for (k, weight) in weights.iter().enumerate() {
            self.columns(own, values, &stretches, k, &mut columns);
            on_rate.add(&columns, weight);
        }
        let mut turn = turn(&base, model, total);
        on_rate.write_negative_sum(&mut turn[BASE..]);
        pass(rotation, turn)
    }

    /// Computes the rotation over the move and the integrals for the Jacobian of the base parameters, from samples that
    /// are already corrected for the effects.
    fn preintegrate_corrected(
        &self,
        model: &Model,
        all: &Corrected,
        stretches: &Stretches,
        weights: &[Matrix3<f64>],
    ) -> (Matrix3<f64>, Sums) {
        let (reach, span) = (self.reach(), self.span);
        let rates: Vec<[f64; 3]> = all.rate.iter().map(|rate| (*rate).into()).collect();
        let (first, last) = (span.first - reach.start, span.last - reach.start);
        let time_s = &self.recording.time_s[reach];
        let (rotation, mut sums) = preintegrate(time_s, Samples::from(&rates), first, last, &Triad::identity());
        // The derivative with respect to the sensitivity is proportional to the rate before the correction for the
        // effects. The sums contain the corrected rate, so the change of the rate by the effects is added to them.
        for (k, weight) in weights.iter().enumerate() {
            let [on_rate, _] = self.mean_added(model, all, stretches.groups.samples(k));
            sums.add_beyond(weight, &on_rate);
        }
        (rotation, sums)
    }
}
