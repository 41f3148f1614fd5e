//! Compares generic hypotheses with the selected effects (docs/model.md (24)). A generic hypothesis is a variation of a
//! bias or scale that no effect of the catalogue describes.

use imucal_core::effects::Sensor;
use imucal_core::sensor::Triad;

use super::Scattering;
use super::forward_search::ForwardSearch;
use super::generic::Block;
use super::moments::Setting;
use super::pattern::{BestGeneric, Pattern, best_generics};
use super::score::contradiction_of_stand;
use super::stage::{Beside, Member, Stage};
use crate::calibrate::EffectChoice;
use crate::error::Error;
use crate::joint::{Kinds, Prepared, Terms};

impl ForwardSearch<'_> {
    /// Evaluates generic hypotheses (unknown variations of a bias or scale) in a model without effects and in a model
    /// with the selected effects. The evaluation uses the residuals at the rests and the residuals of the gravity
    /// directions after the moves. If the search uses accelerometer samples inside moves, the evaluation is repeated
    /// with these samples. The second result reports a significant difference between the effects estimated with and
    /// without the stand's angles. It is `None` if there is no significant difference.
    pub(super) fn patterns(
        &mut self,
        prepared: &Prepared<'_>,
        triads: [&Triad<f64>; 2],
        open: &[EffectChoice],
        stage: &Stage,
    ) -> Result<(Vec<Pattern>, Option<Scattering>), Error> {
        let kinds = self.kinds;
        let (mut patterns, mut contradiction) = (Vec::new(), None);
        for in_motion in [false, true].into_iter().filter(|in_motion| kinds.in_motion || !in_motion) {
            self.kinds = Kinds { in_motion, encoders: false };
            // Accelerometer samples inside moves determine the gyroscope scale more accurately than the gravity
            // directions after the moves alone. If the search uses such samples, hypotheses about the gyroscope scale
            // are therefore tested only in the evaluation with these samples.
            let is_selected = |block: Block| in_motion || !kinds.in_motion || block != Block::GyroscopeScale;
            let found = self.pattern(prepared, triads, open, &stage.members, is_selected);
            self.kinds = kinds;
            let (pattern, with) = found?;
            patterns.push(pattern);
            if let (Some(with), true) = (with, kinds.encoders) {
                contradiction = contradiction_of_stand(&with, stage);
            }
        }
        Ok((patterns, contradiction))
    }

    /// Evaluates generic hypotheses on the kinds of residuals in `self.kinds`. The second result is the model with the
    /// selected effects. Effects that these residuals do not determine are left out of this model.
    fn pattern(
        &self,
        prepared: &Prepared<'_>,
        triads: [&Triad<f64>; 2],
        open: &[EffectChoice],
        members: &[Member],
        is_selected: impl Fn(Block) -> bool,
    ) -> Result<(Pattern, Option<Stage>), Error> {
        let is_inertial = |c: &&EffectChoice| c.effect.sensor != Sensor::Encoder;
        let inertial: Vec<EffectChoice> = open.iter().filter(is_inertial).copied().collect();
        let seen: Vec<EffectChoice> =
            inertial.iter().filter(|c| self.kinds.in_motion || !Kinds::needed_by(&[**c]).in_motion).copied().collect();
        let without = self.stage(prepared, triads, &[], &[], Beside::Nothing)?;
        // The residuals of gravity directions after moves may contain little information about effects that act inside
        // moves. If the fit with these effects fails, it is repeated without them.
        let with = [inertial, seen].into_iter().find_map(|choices| {
            let own = |m: &&Member| {
                choices.iter().any(|c| c.effect.name == m.name) || self.user_fields.iter().any(|f| f.name == m.name)
            };
            let members: Vec<Member> = members.iter().filter(own).cloned().collect();
            if members.is_empty() {
                return None;
            }
            let stage = self.stage(prepared, triads, &choices, &members, Beside::Nothing).ok()?;
            Some((choices, stage))
        });
        let (choices, with) = with.unzip();
        let (path, path_chi2) = with.as_ref().map_or((0.0, 0.0), |with| {
            (with.evidence.log - without.evidence.log, without.evidence.chi2 - with.evidence.chi2)
        });
        let none = Terms::try_new(&[], &[], &self.samples, self.kinds)?;
        let setting = Setting::new(prepared, &none, &without.model)?;
        let (alone, on_top) = match &with {
            Some(with) if setting.has_axes(with.design.axes()) => {
                let [alone, on_top] = best_generics(&setting, [&without, with], &is_selected);
                (alone, on_top)
            }
            with => {
                let [alone] = best_generics(&setting, [&without], &is_selected);
                let beside = |with: &Stage| -> Result<Option<BestGeneric>, Error> {
                    let (own, fields) = self.of_members(choices.as_deref().unwrap_or_default(), &with.members);
                    let terms = Terms::try_new(&own, &fields, &self.samples, self.kinds)?;
                    let setting = Setting::new(prepared, &terms, &with.model)?;
                    let [on_top] = best_generics(&setting, [with], &is_selected);
                    Ok(on_top)
                };
                (alone, with.as_ref().map(beside).transpose()?.flatten())
            }
        };
        Ok((Pattern { alone, path, path_chi2, on_top }, with))
    }
}
