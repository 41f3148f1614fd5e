//! Generic hypotheses beside and instead of a path (model.md (24)).

use imucal_core::STANDARD_GRAVITY_MPS2;
use imucal_core::effects::Sensor;
use imucal_core::sensor::Triad;
use nalgebra::Vector3;

use super::evidence::{Column, Evidence};
use super::generic::Hypothesis;
use super::known::{Known, Others};
use super::moments::Setting;
use super::path::Hunt;
use super::score::contradiction_of_stand;
use super::stage::{Beside, Member, Stage};
use super::weighing::Weighing;
use super::{Block, GenericFinding, Kernel, Scattering};
use crate::calibrate::EffectChoice;
use crate::error::Error;
use crate::joint::{Kinds, Prepared, Terms};
use crate::numerics::workers::{in_order, processors};

/// Prior widths in units of the typical bias.
const WIDTHS: [f64; 5] = [0.1, 0.3, 1.0, 3.0, 10.0];
/// A generic hypothesis has to explain this much more than the path, and this much at all.
const LEAD: f64 = 3.0;
const LEAST: f64 = 8.0;
/// With less than this at the scales of the model it comes nowhere near.
const WORTH_ASKING: f64 = 2.0;
/// With so much that it explains on top of the path, the path is not all.
const NOT_ALL: f64 = 12.0;
/// Shares of a path's nats, and of the chi2 that it explains, that large effects may leave, being more than a line. Nats grow with the
/// logarithm of a size: alone they would tell a remainder of a few per cent from one of as much of a larger effect.
const REMAINDER: f64 = 0.02;
const REMAINDER_OF_CHI2: f64 = 0.002;

/// The generic hypothesis with the largest evidence.
pub(super) struct BestGeneric {
    pub(super) block: Block,
    pub(super) kernel: Kernel,
    pub(super) log_bayes_factor: f64,
    /// By how much it lowers chi2.
    chi2: f64,
    /// Rests, or rests before moves, and what is wrong there on each axis, SI units.
    wrong: Vec<(usize, Vector3<f64>)>,
}

/// A model that hypotheses come beside.
struct Judge<'a> {
    known: Known<'a>,
    model: &'a [Column],
    before: &'a Evidence,
}

impl<'a> Judge<'a> {
    fn new(stage: &'a Stage) -> Self {
        Self { known: stage.design.known(), model: &stage.design.model, before: &stage.evidence }
    }

    /// The evidence of the model with a hypothesis, which has so many columns; `None` where that comes to nothing.
    fn ask(&self, hypothesis: &Hypothesis, others: &Others<'_>, width: usize) -> Option<Evidence> {
        let Self { known, model, before } = self;
        let (gram, typical) = (known.with(others), hypothesis.typical());
        let own = (model.len()..model.len() + width).map(|place| (place, typical));
        let weighing = Weighing::new(&gram, model, own.collect());
        let swept = weighing.sweep(&before.scales)?;
        // What gains next to nothing at the scales of the model gains no more by narrowing them.
        let (first, _) = weighing.left(&swept).best_width(&WIDTHS).filter(|(_, gain)| *gain > WORTH_ASKING)?;
        let (mut evidence, swept) = weighing.evidence(first, swept)?;
        // What explains much narrows the scales, and is the larger for it.
        if let Some((again, _)) = weighing.left(&swept).best_width(&WIDTHS).filter(|(width, _)| *width != first)
            && let Some((other, _)) = weighing.evidence(again, swept).filter(|(other, _)| other.log > evidence.log)
        {
            evidence = other;
        }
        Some(evidence)
    }
}

/// The generic hypotheses with the largest evidence beside each of the models, of the blocks that are asked about.
fn best_generics<const N: usize>(
    setting: &Setting<'_>,
    stages: [&Stage; N],
    asked: impl Fn(Block) -> bool,
) -> [Option<BestGeneric>; N] {
    let judges = stages.map(Judge::new);
    let hypotheses = setting.hypotheses(asked);
    let heard = in_order(processors(), hypotheses.len(), |place| {
        let hypothesis = &hypotheses[place];
        let columns = setting.columns(hypothesis);
        // Rows are in the same groups beside all of these.
        let others = judges.first().map(|judge| judge.known.others(&columns));
        judges.each_ref().map(|judge| judge.ask(hypothesis, others.as_ref()?, columns.ncols()))
    });
    std::array::from_fn(|judge| {
        let mut best: Option<(&Hypothesis, &Evidence)> = None;
        for (hypothesis, heard) in hypotheses.iter().zip(&heard) {
            if let Some(heard) = heard[judge].as_ref().filter(|own| best.is_none_or(|(_, best)| own.log > best.log)) {
                best = Some((hypothesis, heard));
            }
        }
        let Judge { model, before, .. } = &judges[judge];
        best.map(|(hypothesis, with)| BestGeneric {
            block: hypothesis.block,
            kernel: hypothesis.kernel,
            log_bayes_factor: with.log - before.log,
            chi2: before.chi2 - with.chi2,
            wrong: setting.wrong(hypothesis, &with.theta[model.len()..]),
        })
    })
}

/// Logarithms of Bayes factors on the same residuals.
pub(super) struct Pattern {
    /// The best one against no effect.
    pub(super) alone: Option<BestGeneric>,
    /// The path against no effect.
    pub(super) path: f64,
    /// By how much the path lowers chi2.
    path_chi2: f64,
    /// The best one on top of the path, against the path.
    pub(super) on_top: Option<BestGeneric>,
}

impl Pattern {
    /// The generic hypothesis, if it explains more than the path; that on top of the path, if it explains much that the path does
    /// not.
    pub(super) fn winner(self) -> Option<BestGeneric> {
        let Self { alone, path, path_chi2, on_top } = self;
        let is_no_remainder = |chi2: f64| path_chi2 <= 0.0 || chi2 > REMAINDER_OF_CHI2 * path_chi2;
        let instead =
            |g: &BestGeneric| g.log_bayes_factor > LEAST.max(path + LEAD) && is_no_remainder(g.chi2 - path_chi2);
        let besides = |g: &BestGeneric| g.log_bayes_factor > NOT_ALL.max(REMAINDER * path) && is_no_remainder(g.chi2);
        alone.filter(instead).or(on_top.filter(besides))
    }
}

impl BestGeneric {
    pub(super) fn finding(self) -> GenericFinding {
        let Self { block, kernel, log_bayes_factor, wrong, .. } = self;
        // At rest the force is the direction of gravity: a bias that follows one is a scale that follows the other.
        let (block, kernel, unit) = match (block, kernel) {
            (Block::AccelerometerBias, Kernel::GravityDirection) => {
                (Block::AccelerometerScale, Kernel::Force, STANDARD_GRAVITY_MPS2)
            }
            same => (same.0, same.1, 1.0),
        };
        let rms = |axis: usize| {
            (wrong.iter().map(|(_, v)| v[axis] * v[axis]).sum::<f64>() / wrong.len().max(1) as f64).sqrt()
        };
        let axis = (0..3).max_by(|&a, &b| rms(a).total_cmp(&rms(b))).unwrap_or(0);
        let mut order: Vec<&(usize, Vector3<f64>)> = wrong.iter().collect();
        order.sort_by(|a, b| b.1[axis].abs().total_cmp(&a.1[axis].abs()));
        let rests = order.into_iter().take(3).map(|(place, _)| *place).collect();
        GenericFinding { block, kernel, log_bayes_factor, axis, rests, rms: rms(axis) / unit }
    }
}

impl Hunt<'_> {
    /// Generic hypotheses alone and on top of the path: on rests and moves from rest to rest, and inside the moves where these
    /// take part. With a stand, whether these residuals contradict it: the name, the factor and the chance of it.
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
            // Inside the moves a scale shows better, and so do the effects that resemble it.
            let asked = |block: Block| in_motion || !kinds.in_motion || block != Block::GyroscopeScale;
            let found = self.pattern(prepared, triads, open, &stage.members, asked);
            self.kinds = kinds;
            let (pattern, with) = found?;
            patterns.push(pattern);
            if let (Some(with), true) = (with, kinds.encoders) {
                contradiction = contradiction_of_stand(&with, stage);
            }
        }
        Ok((patterns, contradiction))
    }

    /// The same on the residuals of `self.kinds`; what these do not determine says nothing here.
    fn pattern(
        &self,
        prepared: &Prepared<'_>,
        triads: [&Triad<f64>; 2],
        open: &[EffectChoice],
        members: &[Member],
        asked: impl Fn(Block) -> bool,
    ) -> Result<(Pattern, Option<Stage>), Error> {
        let is_inertial = |c: &&EffectChoice| c.effect.sensor != Sensor::Encoder;
        let inertial: Vec<EffectChoice> = open.iter().filter(is_inertial).copied().collect();
        let seen: Vec<EffectChoice> =
            inertial.iter().filter(|c| self.kinds.in_motion || !Kinds::needed_by(&[**c]).in_motion).copied().collect();
        let without = self.stage(prepared, triads, &[], &[], Beside::Nothing)?;
        // What the motion shows, rests and moves may show a little, or not at all.
        let with = [inertial, seen].into_iter().find_map(|choices| {
            let own = |m: &&Member| {
                choices.iter().any(|c| c.effect.name == m.name) || self.user_fields.iter().any(|f| f.name == m.name)
            };
            let members: Vec<Member> = members.iter().filter(own).cloned().collect();
            if members.is_empty() {
                return None;
            }
            self.stage(prepared, triads, &choices, &members, Beside::Nothing).ok()
        });
        let (path, path_chi2) = with.as_ref().map_or((0.0, 0.0), |with| {
            (with.evidence.log - without.evidence.log, without.evidence.chi2 - with.evidence.chi2)
        });
        let none = Terms::try_new(&[], &[], &self.samples, self.kinds)?;
        let setting = Setting::new(prepared, &none, &without.model)?;
        let (alone, on_top) = match &with {
            Some(with) if setting.has_axes(with.design.axes()) => {
                let [alone, on_top] = best_generics(&setting, [&without, with], &asked);
                (alone, on_top)
            }
            with => {
                let [alone] = best_generics(&setting, [&without], &asked);
                let beside = |with: &Stage| -> Result<Option<BestGeneric>, Error> {
                    let setting = Setting::new(prepared, &none, &with.model)?;
                    let [on_top] = best_generics(&setting, [with], &asked);
                    Ok(on_top)
                };
                (alone, with.as_ref().map(beside).transpose()?.flatten())
            }
        };
        Ok((Pattern { alone, path, path_chi2, on_top }, with))
    }
}
