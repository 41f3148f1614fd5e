//! Tests generic hypotheses (docs/model.md (24)). A generic hypothesis is a variation of a bias or scale, for example
//! with temperature, that no effect of the catalogue describes. Each hypothesis is added to two models. In the model
//! without effects, it is an alternative to the selected effects. In the model with the selected effects, it describes
//! a variation that is present in addition to these effects.

use imucal_core::STANDARD_GRAVITY_MPS2;
use nalgebra::Vector3;

use super::GenericFinding;
use super::evidence::{Column, Evidence};
use super::generic::{Block, Hypothesis};
use super::kernel::Kernel;
use super::known::{Known, Others};
use super::moments::Setting;
use super::stage::Stage;
use super::weighing::Weighing;
use crate::numerics::workers::{in_order, processors};

/// Trial values of the standard deviation of a hypothesis's prior, in multiples of the typical deviation of its sensor
/// parameter ([`Block::typical`]).
const WIDTHS: [f64; 5] = [0.1, 0.3, 1.0, 3.0, 10.0];
/// A generic hypothesis (unknown variation of a bias or scale) replaces the selected effects only if the log evidence
/// of the model with the hypothesis exceeds that of the model with the effects by more than this number of nats. 3 nats
/// are odds of 20 to 1.
const LEAD: f64 = 3.0;
/// A generic hypothesis replaces the selected effects only if its log Bayes factor, relative to the model without
/// effects, is above this number of nats. 8 nats are odds of 3000 to 1.
const LEAST: f64 = 8.0;
/// The evidence of a hypothesis is computed exactly only if an approximate computation shows an increase of the log
/// evidence by more than this number of nats. The approximation uses the noise scales (chi2 per degree of freedom of
/// each kind of residual) of the model without the hypothesis.
const LEAST_GAIN: f64 = 2.0;
/// A generic hypothesis is reported in addition to the selected effects only if its log Bayes factor is above this
/// number of nats.
const NOT_ALL: f64 = 12.0;
/// A generic hypothesis is reported in addition to the selected effects only if ln B > REMAINDER x ln B_effects. B and
/// B_effects are the Bayes factors of the hypothesis and of the effects. A hypothesis with a smaller ln B may only
/// describe linearisation errors of large effects.
const REMAINDER: f64 = 0.02;
/// A generic hypothesis is reported in addition to the selected effects only if d > REMAINDER_OF_CHI2 x d_effects. d
/// and d_effects are the decreases of chi2 by the hypothesis and by the selected effects. A hypothesis is reported
/// instead of the effects only if d - d_effects > REMAINDER_OF_CHI2 x d_effects. A hypothesis with a smaller decrease
/// may only describe linearisation errors of large effects. The limit [`REMAINDER`] alone is not sufficient. Log Bayes
/// factors grow only with the logarithm of an effect's size, because the noise scales are estimated. ln B of small
/// linearisation errors may therefore exceed REMAINDER x ln B of a large effect.
const REMAINDER_OF_CHI2: f64 = 0.002;

/// The generic hypothesis (unknown variation of a bias or scale) with the largest evidence, and its fit.
pub(super) struct BestGeneric {
    pub(super) block: Block,
    pub(super) kernel: Kernel,
    pub(super) log_bayes_factor: f64,
    /// Standard deviation of the prior of the coefficients, in multiples of the typical deviation of the sensor
    /// parameter.
    pub(super) width: f64,
    /// Decrease of chi2 if the hypothesis is added to the model.
    chi2: f64,
    /// Noise scale (chi2 per degree of freedom) of each group of residuals if the hypothesis is added to the model. The
    /// order of the groups is that of the evidence of the model.
    pub(super) scales: Vec<f64>,
    /// For each rest: its index, and the deviation of the parameter on each axis, SI units. For a hypothesis about
    /// moves, one entry for each move: the index of the rest before the move, and the deviation inside the move.
    wrong: Vec<(usize, Vector3<f64>)>,
}

/// A model and its evidence. Generic hypotheses are added to this model one at a time and compared.
struct Judge<'a> {
    known: Known<'a>,
    model: &'a [Column],
    before: &'a Evidence,
}

impl<'a> Judge<'a> {
    fn new(stage: &'a Stage) -> Self {
        Self { known: stage.design.known(), model: &stage.design.model, before: &stage.evidence }
    }

    /// Adds a hypothesis of `width` columns to the model. Returns the largest evidence over the trial prior widths, and
    /// the prior width with this evidence. `None` if the log evidence increases by at most [`LEAST_GAIN`].
    fn evaluate(&self, hypothesis: &Hypothesis, others: &Others<'_>, width: usize) -> Option<(Evidence, f64)> {
        let Self { known, model, before } = self;
        let (gram, typical) = (known.with(others), hypothesis.typical());
        let own = (model.len()..model.len() + width).map(|place| (place, typical));
        let weighing = Weighing::new(&gram, model, own.collect());
        let swept = weighing.sweep(&before.scales)?;
        // The evidence is first computed with the noise scales s_g^2 (chi2 per degree of freedom) of the model without
        // the hypothesis. If the hypothesis hardly increases this evidence, it is not significant at the smaller noise
        // scales of the model with the hypothesis either.
        let (mut best, _) = weighing.left(&swept).best_width(&WIDTHS).filter(|(_, gain)| *gain > LEAST_GAIN)?;
        let (mut evidence, swept) = weighing.evidence(best, swept)?;
        // A hypothesis that explains a large part of the residuals reduces the noise scales. With smaller noise scales,
        // another prior width may give a larger evidence.
        if let Some((again, _)) = weighing.left(&swept).best_width(&WIDTHS).filter(|(width, _)| *width != best)
            && let Some((other, _)) = weighing.evidence(again, swept).filter(|(other, _)| other.log > evidence.log)
        {
            (evidence, best) = (other, again);
        }
        Some((evidence, best))
    }
}

/// For the model of each stage: the generic hypothesis (unknown variation of a bias or scale) with the largest
/// evidence. Only hypotheses about sensor parameters for which `is_selected` is true are tested.
pub(super) fn best_generics<const N: usize>(
    setting: &Setting<'_>,
    stages: [&Stage; N],
    is_selected: impl Fn(Block) -> bool,
) -> [Option<BestGeneric>; N] {
    let judges = stages.map(Judge::new);
    let hypotheses = setting.hypotheses(|block, _| is_selected(block));
    let found = in_order(processors(), hypotheses.len(), |place| {
        let hypothesis = &hypotheses[place];
        let columns = setting.columns(hypothesis);
        // The residual groups of the rows are the same in all models, so the Gram matrix of the hypothesis is computed
        // only once.
        let others = judges.first().map(|judge| judge.known.others(&columns));
        judges.each_ref().map(|judge| judge.evaluate(hypothesis, others.as_ref()?, columns.ncols()))
    });
    std::array::from_fn(|judge| {
        let mut best: Option<(&Hypothesis, &(Evidence, f64))> = None;
        for (hypothesis, found) in hypotheses.iter().zip(&found) {
            if let Some(found) = found[judge].as_ref().filter(|own| best.is_none_or(|(_, best)| own.0.log > best.0.log))
            {
                best = Some((hypothesis, found));
            }
        }
        let Judge { model, before, .. } = &judges[judge];
        best.map(|(hypothesis, (with, width))| BestGeneric {
            block: hypothesis.block,
            kernel: hypothesis.kernel,
            log_bayes_factor: with.log - before.log,
            width: *width,
            chi2: before.chi2 - with.chi2,
            scales: with.scales.clone(),
            wrong: setting.wrong(hypothesis, &with.theta[model.len()..]),
        })
    })
}

/// The best generic hypotheses (unknown variations of a bias or scale) and the selected effects, evaluated on the same
/// residuals.
pub(super) struct Pattern {
    /// The best generic hypothesis in a model without effects.
    pub(super) alone: Option<BestGeneric>,
    /// Log Bayes factor of the selected effects relative to the model without effects, nats.
    pub(super) path: f64,
    /// Decrease of chi2 if the selected effects are added to the model without effects.
    pub(super) path_chi2: f64,
    /// The best generic hypothesis in a model with the selected effects. Its Bayes factor is relative to the model with
    /// these effects and without the hypothesis.
    pub(super) on_top: Option<BestGeneric>,
}

impl Pattern {
    /// The best hypothesis in a model without effects, if it explains the residuals better than the selected effects.
    pub(super) fn instead(&self) -> Option<&BestGeneric> {
        let is_better = |g: &&BestGeneric| {
            g.log_bayes_factor > LEAST.max(self.path + LEAD) && self.is_no_remainder(g.chi2 - self.path_chi2)
        };
        self.alone.as_ref().filter(is_better)
    }

    /// The best hypothesis in a model with the selected effects, if it is significant and explains more than the
    /// linearisation errors of the effects.
    pub(super) fn besides(&self) -> Option<&BestGeneric> {
        let is_large =
            |g: &&BestGeneric| g.log_bayes_factor > NOT_ALL.max(REMAINDER * self.path) && self.is_no_remainder(g.chi2);
        self.on_top.as_ref().filter(is_large)
    }

    /// Whether a decrease of chi2 is too large to be caused by linearisation errors of the selected effects.
    fn is_no_remainder(&self, chi2: f64) -> bool {
        self.path_chi2 <= 0.0 || chi2 > REMAINDER_OF_CHI2 * self.path_chi2
    }
}

impl BestGeneric {
    pub(super) fn finding(&self) -> GenericFinding {
        let Self { block, kernel, log_bayes_factor, ref wrong, .. } = *self;
        // If noise is the only error, a Bayes factor of B or more has a probability of at most 1/B.
        let p_value = (-log_bayes_factor).exp().min(1.0);
        // At rest the specific force is g times the unit vector up. A bias that depends on the direction of gravity is
        // therefore indistinguishable from a scale that depends on the specific force. The bias is reported as such a
        // scale. A scale deviation s changes the reading of a force g by s g, so rms(scale) = rms(bias) / g.
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
        GenericFinding { block, kernel, log_bayes_factor, p_value, axis, rests, rms: rms(axis) / unit }
    }
}
