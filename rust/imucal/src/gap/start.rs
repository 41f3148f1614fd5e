//! Starts a search: fits the model without effects, and tests whether the unit was moved by hand.

use std::sync::Arc;

use imucal_core::effects::{Effect, Need, Sensor};
use imucal_core::sensor::Triad;

use super::design::design;
use super::evidence::{Column, Gram};
use super::forward_search::ForwardSearch;
use super::stage::{Beside, Member, NO_EVIDENCE, Stage};
use crate::calibrate::EffectChoice;
use crate::error::Error;
use crate::joint::{BLOCK_S, Kinds, Model, Prepared, Terms, is_unobservable_hand_held};

/// Averaging time, s, of the specific force inside moves in the test for hand motion. Accelerations by a hand last
/// longer than this time, so the average still contains them.
const STRETCH_S: f64 = 4.0 * BLOCK_S;
/// Threshold of the scatter of the averaged specific force inside moves, in multiples of the noise of this average.
/// Hand motion is detected only if the scatter is above this threshold and effects do not explain the scatter.
const HAND: f64 = 10.0;
/// Threshold of the unexplained share of the variance of the averaged specific force inside moves. Hand motion is
/// detected only if effects that depend on the angular acceleration, for example the lever arm of the accelerometer,
/// leave more than this share unexplained. Without hand motion, the unexplained share is smaller even with a long lever
/// arm and a noisy gyroscope.
const UNEXPLAINED: f64 = 0.003;
/// Threshold of the share of the variance of the averaged specific force inside moves that effects of the angular
/// acceleration, such as a delay of the gyroscope, leave unexplained. Above this threshold, a delay is ruled out as the
/// cause of the scatter. If a delay of at most a third of the duration of a move were the cause, a smaller share would
/// remain unexplained.
const BEYOND_A_DELAY: f64 = 0.5;
/// Standard deviation of the prior of the gyroscope's delay in the test for hand motion, in multiples of the typical
/// delay.
const LONG_DELAY: f64 = 100.0;

impl ForwardSearch<'_> {
    /// Fits the model without effects. Returns this model and the candidate effects that can be tested. If hand motion
    /// is detected, candidates that need the specific force inside moves are excluded.
    pub(super) fn start(
        &mut self,
        prepared: &Prepared<'_>,
        triads: [&Triad<f64>; 2],
        mut open: Vec<EffectChoice>,
    ) -> Result<(Stage, Vec<EffectChoice>), Error> {
        let is_hand_moved = match self.is_hand_moved {
            Some(known) => known,
            None => self.seems_hand_moved(prepared, triads, &open)?,
        };
        self.is_hand_moved = Some(is_hand_moved);
        if is_hand_moved {
            self.kinds.in_motion = false;
            open.retain(|choice| {
                let blind = is_unobservable_hand_held(choice.effect.name);
                if blind {
                    self.left_out.push((
                        choice.effect.name.to_owned(),
                        "moves on a stand (a hand also translates the unit) and an accelerometer whose noise exceeds a \
                         step of its converter"
                            .into(),
                    ));
                }
                !blind
            });
        }
        if prepared.heading_lost().is_some() {
            let (lost, left): (Vec<_>, Vec<_>) =
                open.into_iter().partition(|c| c.effect.needs.contains(&Need::Attitude));
            let names = lost.iter().map(|choice| choice.effect.name.to_owned());
            self.left_out.extend(
                names.map(|name| (name, "all moves: the heading is lost after a move that the fit leaves out".into())),
            );
            open = left;
        }
        let stage = self.stage(prepared, triads, &open, &[], Beside::Candidates)?;
        *self.ground.borrow_mut() = Some(Arc::clone(&stage.design));
        Ok((stage, open))
    }

    /// Whether the specific force inside the moves of any recording contains accelerations by a hand. This is assumed
    /// if all candidate effects together do not explain the scatter of the force, and effects of the angular
    /// acceleration leave more than the share [`UNEXPLAINED`] of its variance unexplained.
    fn seems_hand_moved(
        &mut self,
        prepared: &Prepared<'_>,
        triads: [&Triad<f64>; 2],
        open: &[EffectChoice],
    ) -> Result<bool, Error> {
        let inside = |gram: &Gram, group: usize, columns: &[Column]| {
            let Some(place) = gram.groups.iter().position(|own| *own == group) else { return Ok(0.0) };
            // A lower bound of the noise scale (chi2 per degree of freedom) is computed first, because this takes less
            // time. If the bound exceeds the threshold, the noise scale itself is not needed.
            let least = gram.least_scale(group, columns).filter(|least| *least > HAND * HAND);
            let scale = least.or_else(|| gram.evidence(columns).map(|evidence| evidence.scales[place]));
            scale.ok_or_else(|| Error::Fit(NO_EVIDENCE.into()))
        };
        // Accelerometer samples inside moves are not fitted, because hand motion would bias the fit.
        let kinds = self.kinds;
        self.kinds.in_motion = false;
        let plain = self.stage(prepared, triads, open, &[], Beside::Nothing);
        self.kinds = kinds;
        let model = plain?.model;
        let coarse = &Prepared { encoders: None, block_s: STRETCH_S, ..*prepared };
        let none = Terms::try_new(&[], &[], &self.samples, Kinds { in_motion: true, encoders: false })?;
        let linear = Arc::new(coarse.linearise(&none, &model.parameters())?);
        let seen = design(coarse, (&none, &[]), &none, &linear)?;
        // Effects in the model can only reduce the scatter, so a recording needs no further test if its scatter without
        // effects is below the threshold.
        let (gram, groups) = seen.insides_apart(coarse);
        let scales = groups.map(|group| Ok((group, inside(&gram, group, &seen.model)?)));
        let mut scattered: Vec<(usize, f64)> = scales.collect::<Result<_, Error>>()?;
        scattered.retain(|(_, plain)| *plain > HAND * HAND);
        if scattered.is_empty() {
            return Ok(false);
        }
        let may_explain =
            |choice: &&EffectChoice| choice.effect.sensor != Sensor::Encoder && choice.effect.shape.is_none();
        let explaining: Vec<EffectChoice> = open.iter().filter(may_explain).copied().collect();
        // Considers the recordings in which all effects together do not explain the scatter of the force inside moves.
        // For each of them, computes the share of the variance that effects of the angular acceleration leave
        // unexplained: noise scale with these effects / noise scale without effects (or lower bounds of these scales).
        // Returns the largest share, or zero if effects explain the scatter in all recordings. `own` are the effects in
        // the model, with the precisions of their priors.
        let unexplained = |search: &Self, own: (&Terms<'_>, &[f64]), model: &Model| {
            search.with_candidates(coarse, own.0, model, &explaining, |all, linear| {
                let seen = design(coarse, own, all, linear)?;
                let with = |is_included: &dyn Fn(&str) -> bool| -> Vec<Column> {
                    let included = seen.full_forms().filter(|c| is_included(&c.name));
                    seen.model.iter().copied().chain(included.flat_map(|c| c.columns(10.0))).collect()
                };
                let (all_columns, of_rotation) = (with(&|_| true), with(&is_unobservable_hand_held));
                let (gram, _) = seen.insides_apart(coarse);
                let mut by_hand: f64 = 0.0;
                for (group, plain) in &scattered {
                    // Effects that depend on the angular acceleration cannot describe accelerations by a hand. If these
                    // effects explain almost the whole scatter, the unit was not moved by hand.
                    if inside(&gram, *group, &all_columns)? > HAND * HAND {
                        by_hand = by_hand.max(inside(&gram, *group, &of_rotation)? / plain);
                    }
                }
                Ok(by_hand)
            })
        };
        let share = unexplained(self, (&none, &[]), &model)?;
        if share <= UNEXPLAINED || share > BEYOND_A_DELAY {
            return Ok(share > UNEXPLAINED);
        }
        // The Jacobian columns describe the errors of effects to first order in the parameters. A long delay of the
        // gyroscope also causes errors of higher order. The delay is therefore fitted, and the test is repeated with
        // the linearisation at the fitted delay.
        let Some(delay) =
            explaining.iter().find(|choice| choice.effect.number == Effect::<f64>::GYRO_TIME_OFFSET.number)
        else {
            return Ok(true);
        };
        self.kinds = Kinds { in_motion: true, encoders: false };
        let members = [Member { width: LONG_DELAY, ..Member::plain(delay.effect) }];
        let delayed = self.stage(prepared, triads, open, &members, Beside::Nothing);
        self.kinds = kinds;
        let Ok(delayed) = delayed else { return Ok(true) };
        let own = Terms::try_new(&[EffectChoice::plain(delay.effect)], &[], &self.samples, none.kinds)?;
        Ok(unexplained(self, (&own, &[0.0]), &delayed.model)? > UNEXPLAINED)
    }
}
