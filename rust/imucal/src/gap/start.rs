//! The start of a search: the model without effects, and whether a hand moved the unit.

use std::sync::Arc;

use imucal_core::effects::{Need, Sensor};
use imucal_core::sensor::Triad;

use super::design::design;
use super::evidence::{Column, Gram};
use super::forward_search::ForwardSearch;
use super::stage::{Beside, NO_EVIDENCE, Stage};
use crate::calibrate::EffectChoice;
use crate::error::Error;
use crate::joint::{BLOCK_S, Kinds, Prepared, Terms, is_unobservable_hand_held};

/// Duration of the means of the specific force inside moves by which hand motion is detected, s: a hand accelerates and
/// stops more slowly.
const STRETCH_S: f64 = 4.0 * BLOCK_S;
/// Ratio to noise of the scatter of these means, whatever effects are in the model, from which on a hand moved the
/// unit.
const HAND: f64 = 10.0;
/// Effects that show in rotation alone explain all but this share of the variance of these means if no hand moved the
/// unit; a long lever arm on a noisy gyroscope leaves the most.
const UNEXPLAINED: f64 = 0.003;

impl ForwardSearch<'_> {
    /// The model without effects, and the remaining candidates. If a hand moved the unit, candidates that need the
    /// specific force inside the moves are excluded.
    pub(super) fn start(
        &mut self,
        prepared: &Prepared<'_>,
        triads: [&Triad<f64>; 2],
        mut open: Vec<EffectChoice>,
    ) -> Result<(Stage, Vec<EffectChoice>), Error> {
        if self.is_hand_moved || self.seems_hand_moved(prepared, triads, &open)? {
            self.is_hand_moved = true;
            self.kinds.in_motion = false;
            open.retain(|choice| {
                let blind = is_unobservable_hand_held(choice.effect.name);
                if blind {
                    self.left_out.push((
                        choice.effect.name.to_owned(),
                        "rotation on a stand: a hand also translates the unit".into(),
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
                names.map(|name| (name, "every move: the heading is lost after a move that is left out".into())),
            );
            open = left;
        }
        let stage = self.stage(prepared, triads, &open, &[], Beside::Candidates)?;
        *self.ground.borrow_mut() = Some(Arc::clone(&stage.design));
        Ok((stage, open))
    }

    /// Whether the specific force inside the moves of a recording is that of a hand, whatever effect may explain it.
    fn seems_hand_moved(
        &mut self,
        prepared: &Prepared<'_>,
        triads: [&Triad<f64>; 2],
        open: &[EffectChoice],
    ) -> Result<bool, Error> {
        let inside = |gram: &Gram, group: usize, columns: &[Column]| {
            let Some(place) = gram.groups.iter().position(|own| *own == group) else { return Ok(0.0) };
            // A lower bound above the threshold decides.
            let least = gram.least_scale(group, columns).filter(|least| *least > HAND * HAND);
            let scale = least.or_else(|| gram.evidence(columns).map(|evidence| evidence.scales[place]));
            scale.ok_or_else(|| Error::Fit(NO_EVIDENCE.into()))
        };
        // Specific force by a hand would bias the fit.
        let kinds = self.kinds;
        self.kinds.in_motion = false;
        let plain = self.stage(prepared, triads, open, &[], Beside::Nothing);
        self.kinds = kinds;
        let model = plain?.model;
        let prepared = &Prepared { encoders: None, block_s: STRETCH_S, ..*prepared };
        let none = Terms::try_new(&[], &[], &self.samples, Kinds { in_motion: true, encoders: false })?;
        let linear = Arc::new(prepared.linearise(&none, &model.parameters())?);
        let seen = design(prepared, (&none, &[]), &none, &linear)?;
        // More columns can only lower the scatter.
        let (gram, groups) = seen.insides_apart(prepared);
        let scales = groups.map(|group| Ok((group, inside(&gram, group, &seen.model)?)));
        let mut scattered: Vec<(usize, f64)> = scales.collect::<Result<_, Error>>()?;
        scattered.retain(|(_, plain)| *plain > HAND * HAND);
        if scattered.is_empty() {
            return Ok(false);
        }
        let may_explain =
            |choice: &&EffectChoice| choice.effect.sensor != Sensor::Encoder && choice.effect.shape.is_none();
        let explaining: Vec<EffectChoice> = open.iter().filter(may_explain).copied().collect();
        self.with_candidates(prepared, &none, &model, &explaining, |all, linear| {
            let seen = design(prepared, (&none, &[]), all, linear)?;
            let with = |is_included: &dyn Fn(&str) -> bool| -> Vec<Column> {
                let included = seen.candidates.iter().filter(|c| is_included(&c.name));
                seen.model.iter().copied().chain(included.flat_map(|c| c.columns(10.0))).collect()
            };
            let (all_columns, of_rotation) = (with(&|_| true), with(&is_unobservable_hand_held));
            let (gram, _) = seen.insides_apart(prepared);
            let mut is_hand_moved = false;
            for (group, plain) in &scattered {
                // Scatter that rotation explains so well is not that of a hand, whatever remains.
                is_hand_moved |= inside(&gram, *group, &all_columns)? > HAND * HAND
                    && inside(&gram, *group, &of_rotation)? > UNEXPLAINED * plain;
            }
            Ok(is_hand_moved)
        })
    }
}
