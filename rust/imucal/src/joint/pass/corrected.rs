//! Corrects the samples of a move for sensitivity, bias and effects.

use std::ops::Range;

use imucal_core::effects::Need;
use imucal_core::integrate::increment;
use imucal_core::sensor::Triad;
use imucal_core::so3;
use nalgebra::Vector3;

use super::Route;
use crate::joint::histories::Sample;
use crate::joint::model::{Model, surroundings};
use crate::joint::settle::Settling;
use crate::joint::terms::Terms;
use crate::preintegration::{Interpolation, turn};
use crate::recording::Samples;

/// Corrected rate and force for the samples of a move and for one additional sample on either side.
pub(super) struct Corrected {
    pub(super) rate: Vec<Vector3<f64>>,
    pub(super) force: Vec<Vector3<f64>>,
    /// Angular acceleration; empty if no effect needs it.
    pub(super) slopes: Vec<Vector3<f64>>,
    /// Whether any effect has nonzero parameters.
    has_effects: bool,
}

/// Integration step between two samples, with the weights of the samples in the mean rate over the step.
#[derive(Clone, Copy)]
pub(super) struct Step {
    /// Index of the sample at the start of the step.
    pub(super) before: usize,
    is_linear: bool,
    /// Weights of four samples in the mean rate over the step. The samples are the sample before the step, the two
    /// samples at its ends, and the sample after it.
    shares: [f64; 4],
}

impl Step {
    /// Step from sample `i` to sample `i + 1`.
    #[inline]
    pub(super) fn after(time_s: &[f64], i: usize) -> Self {
        let (interpolation, shares) = Interpolation::of(time_s, i);
        Self { before: i, is_linear: interpolation == Interpolation::Linear, shares }
    }

    /// Mean over the integration step of the quantity whose value at sample k is `value(k)`.
    #[inline(always)]
    pub(super) fn mean(&self, value: impl Fn(usize) -> Vector3<f64>) -> Vector3<f64> {
        let (k, [before, start, end, after]) = (self.before, self.shares);
        let inner = value(k) * start + value(k + 1) * end;
        if self.is_linear { inner } else { inner + value(k - 1) * before + value(k + 2) * after }
    }

    /// Rotation vector of the integration step, rad, for the rate `rate(k)` at sample k and the duration `step_s`.
    #[inline(always)]
    pub(super) fn turn(&self, rate: impl Fn(usize) -> Vector3<f64>, step_s: f64) -> Vector3<f64> {
        turn(&self.mean(&rate), [&rate(self.before), &rate(self.before + 1)], step_s)
    }
}

/// Number of fixed-point iterations for the angular acceleration. Iterations are needed because the angular
/// acceleration is the derivative of the corrected rate, and the correction depends on the angular acceleration. Each
/// iteration multiplies the error by the ratio of the gyroscope delay to the time scale of the motion (about 1/50). For
/// long delays, more iterations would amplify noise.
///
/// A gyroscope with a delay measures the rate of an earlier time. The correction of the delay needs the mean of the
/// angular acceleration over the delay. This mean is approximated by the mean of two derivatives: that of the corrected
/// rate and that of the measured rate. The remaining error of the corrected rate is proportional to the third power of
/// the delay.
const SLOPE_PASSES: usize = 3;

impl Route<'_> {
    /// Index range of the samples of the recording that are corrected: the samples of the move, and one additional
    /// sample on either side if it exists.
    pub(super) fn reach(&self) -> Range<usize> {
        self.span.first.saturating_sub(1)..(self.span.last + 2).min(self.recording.len())
    }

    /// Integration step from sample `i` of the recording to the next sample. The sample indices in the step are counted
    /// from the first corrected sample ([`Self::reach`]).
    pub(super) fn step(&self, i: usize) -> Step {
        Step { before: i - self.reach().start, ..Step::after(self.recording.time_s, i) }
    }

    /// Corrects the samples in the range `reach`. Effects whose parameters are all 0 are skipped. The angular
    /// acceleration is also computed if `wants_slopes` is true or an effect needs it.
    pub(super) fn freed(&self, model: &Model, active: &Terms<'_>, wants_slopes: bool) -> Corrected {
        let reach = self.reach();
        let corrected = |triad: &Triad<f64>, rows: Samples<'_>| -> Vec<Vector3<f64>> {
            rows.part(reach.clone()).iter().map(|row| triad.correct(Vector3::from(*row))).collect()
        };
        let rate = corrected(&model.gyroscope, self.recording.angular_rate);
        let force = corrected(&model.accelerometer, self.recording.specific_force);
        let passes = if active.needs(Need::AngularAcceleration) { SLOPE_PASSES } else { 1 };
        let raw = || self.recording.angular_rate.part(reach.clone()).iter().map(|row| Vector3::from(*row)).collect();
        let derivative =
            (wants_slopes || passes > 1).then(|| self.width.derivative(&self.recording.time_s[reach.clone()], raw));
        let mut all = Corrected { rate, force, slopes: Vec::new(), has_effects: !active.all.is_empty() };
        let seen = (passes > 1).then(|| (all.rate.clone(), all.force.clone()));
        let mut slopes_of_seen = Vec::new();
        for pass in 0..passes {
            all.slopes = derivative.as_ref().map_or_else(Vec::new, |d| d.of(&all.rate));
            if pass == 0 {
                slopes_of_seen.clone_from(&all.slopes);
            }
            if let Some((rate, force)) = seen.as_ref().filter(|_| pass > 0) {
                all.rate.copy_from_slice(rate);
                all.force.copy_from_slice(force);
            }
            if all.has_effects {
                self.free(&mut all, &slopes_of_seen, model, active);
            }
        }
        all
    }

    /// One iteration: corrects the samples for the effects. The effects are evaluated with the angular acceleration of
    /// the previous iteration. `slopes_of_seen` are the time derivatives of the rate that is not corrected for the
    /// effects.
    fn free(&self, all: &mut Corrected, slopes_of_seen: &[Vector3<f64>], model: &Model, active: &Terms<'_>) {
        let mut attitude = self.rotation_world_from_start;
        let mut settling = Settling::new(active, &model.values);
        // Contribution of the effects to the rate at the previous sample.
        let mut added_rate = Vector3::zeros();
        for (k, index) in self.reach().enumerate() {
            let (seen_rate, seen_force) = (all.rate[k], all.force[k]);
            let mut around = surroundings(self.recording, index);
            around.angular_acceleration = all.slopes.get(k).copied();
            around.mean_angular_acceleration = all
                .slopes
                .get(k)
                .zip(slopes_of_seen.get(k))
                .map(|(true_slope, seen_slope)| (true_slope + seen_slope) / 2.0);
            if let (Some(attitude), true) = (&mut attitude, index > self.span.first) {
                let h = self.recording.time_s[index] - self.recording.time_s[index - 1];
                // The rate of this sample is not corrected yet. Its correction is approximated by the correction of the
                // previous sample.
                *attitude *= so3::exp(&increment(&all.rate[k - 1], &(seen_rate - added_rate), h));
            }
            around.rotation_world_from_body = attitude;
            let sample = Sample { recording: self.span.recording, index, count: 1 };
            let state = settling.settle(seen_rate, seen_force, &around, sample);
            (all.rate[k], all.force[k]) = (state.angular_rate, state.specific_force);
            added_rate = seen_rate - all.rate[k];
        }
    }

    /// Computes the mean contribution of the effects to the rate and to the force over `samples`. The indices in
    /// `samples` are counted from the first corrected sample ([`Self::reach`]).
    pub(super) fn mean_added(&self, model: &Model, freed: &Corrected, samples: Range<usize>) -> [Vector3<f64>; 2] {
        if !freed.has_effects {
            return [Vector3::zeros(); 2];
        }
        let (first, count) = (self.reach().start, samples.len() as f64);
        let added = |triad: &Triad<f64>, rows: Samples<'_>, freed: &[Vector3<f64>]| {
            let raw: Vector3<f64> =
                rows.part(first + samples.start..first + samples.end).iter().map(|row| Vector3::from(*row)).sum();
            triad.correct(raw / count) - freed[samples.clone()].iter().sum::<Vector3<f64>>() / count
        };
        [
            added(&model.gyroscope, self.recording.angular_rate, &freed.rate),
            added(&model.accelerometer, self.recording.specific_force, &freed.force),
        ]
    }
}
