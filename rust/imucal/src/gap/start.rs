//! Where a search starts: the model without effects, and whether a hand carried the unit.

use std::sync::Arc;

use imucal_core::effects::{Need, Sensor};
use imucal_core::sensor::Triad;

use super::design::design;
use super::evidence::{Column, Gram};
use super::path::Hunt;
use super::stage::{Beside, NO_EVIDENCE, Stage};
use crate::calibrate::EffectChoice;
use crate::error::Error;
use crate::joint::{BLOCK_S, Kinds, Prepared, Terms, is_unobservable_hand_held};

/// A hand takes longer than this to push and to stop, s: the force inside the moves is asked for in means over as long.
const STRETCH_S: f64 = 4.0 * BLOCK_S;
/// Force that then scatters by this many times its noise, whatever effects are in the model, is that of a hand.
const CARRIED: f64 = 10.0;
/// Effects that turning alone shows leave less of its variance, even a long lever arm on a noisy gyroscope.
const UNEXPLAINED: f64 = 0.003;

impl Hunt<'_> {
    /// The model without effects, and the candidates that are left: without those of the motion if a hand carried the unit.
    pub(super) fn start(
        &mut self,
        prepared: &Prepared<'_>,
        triads: [&Triad<f64>; 2],
        mut open: Vec<EffectChoice>,
    ) -> Result<(Stage, Vec<EffectChoice>), Error> {
        if self.is_carried || self.looks_carried(prepared, triads, &open)? {
            self.is_carried = true;
            self.kinds.in_motion = false;
            open.retain(|choice| {
                let blind = is_unobservable_hand_held(choice.effect.name);
                if blind {
                    self.left_out.push((
                        choice.effect.name.to_owned(),
                        "turns on a stand: a hand carries the unit along".into(),
                    ));
                }
                !blind
            });
        }
        if prepared.heading_lost().is_some() {
            let (lost, left): (Vec<_>, Vec<_>) =
                open.into_iter().partition(|c| c.effect.needs.contains(&Need::Attitude));
            let names = lost.iter().map(|choice| choice.effect.name.to_owned());
            self.left_out
                .extend(names.map(|name| (name, "every move: behind one that is left out the heading is lost".into())));
            open = left;
        }
        let stage = self.stage(prepared, triads, &open, &[], Beside::Candidates)?;
        *self.ground.borrow_mut() = Some(Arc::clone(&stage.design));
        Ok((stage, open))
    }

    /// Whether the force inside the moves of some recording is that of a hand, whatever effect is allowed to explain it.
    fn looks_carried(
        &mut self,
        prepared: &Prepared<'_>,
        triads: [&Triad<f64>; 2],
        open: &[EffectChoice],
    ) -> Result<bool, Error> {
        let inside = |gram: &Gram, group: usize, columns: &[Column]| {
            let Some(place) = gram.groups.iter().position(|own| *own == group) else { return Ok(0.0) };
            // Where the least is far there is no need to know more.
            let least = gram.least_scale(group, columns).filter(|least| *least > CARRIED * CARRIED);
            let scale = least.or_else(|| gram.evidence(columns).map(|evidence| evidence.scales[place]));
            scale.ok_or_else(|| Error::Fit(NO_EVIDENCE.into()))
        };
        // The insides of a hand would lead the fit astray.
        let kinds = self.kinds;
        self.kinds.in_motion = false;
        let plain = self.stage(prepared, triads, open, &[], Beside::Nothing);
        self.kinds = kinds;
        let model = plain?.model;
        let prepared = &Prepared { encoders: None, block_s: STRETCH_S, ..*prepared };
        let none = Terms::try_new(&[], &[], &self.samples, Kinds { in_motion: true, encoders: false })?;
        let linear = Arc::new(prepared.linearise(&none, &model.parameters())?);
        let seen = design(prepared, (&none, &[]), &none, &linear)?;
        // More columns only explain more.
        let (gram, groups) = seen.insides_apart(prepared);
        let scales = groups.map(|group| Ok((group, inside(&gram, group, &seen.model)?)));
        let mut loud: Vec<(usize, f64)> = scales.collect::<Result<_, Error>>()?;
        loud.retain(|(_, plain)| *plain > CARRIED * CARRIED);
        if loud.is_empty() {
            return Ok(false);
        }
        let asked = |choice: &&EffectChoice| choice.effect.sensor != Sensor::Encoder && choice.effect.shape.is_none();
        let asked: Vec<EffectChoice> = open.iter().filter(asked).copied().collect();
        self.with_candidates(prepared, &none, &model, &asked, |all, linear| {
            let seen = design(prepared, (&none, &[]), all, linear)?;
            let with = |is_asked: &dyn Fn(&str) -> bool| -> Vec<Column> {
                let asked = seen.candidates.iter().filter(|c| is_asked(&c.name));
                seen.model.iter().copied().chain(asked.flat_map(|c| c.columns(10.0))).collect()
            };
            let (all_columns, of_turning) = (with(&|_| true), with(&is_unobservable_hand_held));
            let (gram, _) = seen.insides_apart(prepared);
            let mut is_carried = false;
            for (group, plain) in &loud {
                // What turning explains so well is no hand's, however much is left.
                is_carried |= inside(&gram, *group, &all_columns)? > CARRIED * CARRIED
                    && inside(&gram, *group, &of_turning)? > UNEXPLAINED * plain;
            }
            Ok(is_carried)
        })
    }
}
