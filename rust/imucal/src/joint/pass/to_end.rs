//! A pass from rest to rest: only the end of the move is asked for.
//!
//! Rotation and sums of the base parameters are the kernel's. What an effect turns until the end is the integral of `R Phi`, and a motion
//! that begins and ends at rest lets a sum over even steps be as exact as if they were far finer.

use imucal_core::effects::Need;
use imucal_core::sensor::Triad;
use nalgebra::{Matrix3, Vector3};

use super::changes::Changes;
use super::corrected::Corrected;
use super::stretches::Stretches;
use super::turned::Turned;
use super::{EvaluatedTerms, Pass, Route};
use crate::joint::model::Model;
use crate::joint::terms::SideBySide;
use crate::parameters::{BASE, GYRO_BIAS, GYRO_SENSITIVITY};
use crate::preintegration::{Sums, preintegrate};
use crate::recording::Samples;

/// Length of a stretch, s.
const STRETCH_S: f64 = 0.04;
/// A move has at least so many.
const FEWEST: f64 = 24.0;

/// d_turn_d_p for the base parameters; room for those of effects.
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
    /// Rotation and turns at the end.
    pub(super) fn to_end(&self, model: &Model, asked: &EvaluatedTerms<'_>) -> Pass {
        // What effects do to the force turns nothing.
        let EvaluatedTerms { terms, active, on_rate: SideBySide { terms: own, values, places }, .. } = asked;
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
            Some(all) => self.carried_freed(model, all, &stretches, &weights),
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

    /// The rotation from the start of the move to its end, and the sums of the base parameters, of samples that are freed of effects.
    fn carried_freed(
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
        // The entries multiply the rates that are seen.
        for (k, weight) in weights.iter().enumerate() {
            let [on_rate, _] = self.mean_added(model, all, stretches.groups.samples(k));
            sums.add_beyond(weight, &on_rate);
        }
        (rotation, sums)
    }
}
