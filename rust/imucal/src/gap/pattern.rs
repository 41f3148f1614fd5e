//! Generic hypotheses beside and instead of a path (model.md (24)).

use super::design::Design;
use super::evidence::Column;
use super::stage::Stage;
use super::{Block, GenericFinding, Kernel};
use crate::joint::Prepared;

/// Prior widths in units of the typical bias.
const WIDTHS: [f64; 5] = [0.1, 0.3, 1.0, 3.0, 10.0];
/// A generic hypothesis has to explain this much more than the path, and this much at all.
const LEAD: f64 = 3.0;
const LEAST: f64 = 8.0;

/// The generic hypothesis with the largest evidence.
pub(super) struct BestGeneric {
    index: usize,
    block: Block,
    kernel: Kernel,
    pub(super) log_bayes_factor: f64,
    /// Bias of each epoch, SI units.
    biases: Vec<[f64; 3]>,
}

/// The generic hypothesis with the largest evidence beside a model.
pub(super) fn best_generic(stage: &Stage) -> Option<BestGeneric> {
    let Design { gram, model, generics, .. } = &stage.design;
    let mut best: Option<BestGeneric> = None;
    for (index, generic) in generics.iter().enumerate() {
        for width in WIDTHS {
            let precision = 1.0 / (width * generic.typical).powi(2);
            let own = generic.columns.clone().map(|place| Column { place, precision, value: 0.0 });
            let columns: Vec<Column> = model.iter().copied().chain(own).collect();
            let Some(evidence) = gram.evidence(&columns) else { continue };
            let log_bayes_factor = evidence.log - stage.evidence.log;
            if best.as_ref().is_some_and(|best| best.log_bayes_factor >= log_bayes_factor) {
                continue;
            }
            let weights = &evidence.theta[model.len()..];
            let bias = |epoch: usize, axis: usize| -> f64 {
                (0..generic.factor.ncols()).map(|c| generic.factor[(epoch, c)] * weights[3 * c + axis]).sum()
            };
            let biases = (0..generic.factor.nrows()).map(|e| [0, 1, 2].map(|axis| bias(e, axis))).collect();
            best = Some(BestGeneric { index, block: generic.block, kernel: generic.kernel, log_bayes_factor, biases });
        }
    }
    let found = best?;
    let generic = &generics[found.index];
    let raw = generic.typical / generic.block.typical_si();
    Some(BestGeneric { biases: found.biases.iter().map(|b| b.map(|v| v / raw)).collect(), ..found })
}

/// Logarithms of Bayes factors on the residuals that generic hypotheses act on.
pub(super) struct Pattern {
    /// The best one against no effect.
    pub(super) alone: Option<BestGeneric>,
    /// The path against no effect.
    pub(super) path: f64,
    /// The best one on top of the path, against the path.
    pub(super) on_top: f64,
}

impl Pattern {
    /// The generic hypothesis, if it explains more than the path, or if with it the path explains nothing more.
    pub(super) fn winner(self) -> Option<BestGeneric> {
        let (path, on_top) = (self.path, self.on_top);
        self.alone.filter(|g| {
            let more = g.log_bayes_factor > path + LEAD;
            let superfluous = on_top > LEAST && path + on_top < g.log_bayes_factor + LEAD;
            g.log_bayes_factor > LEAST && (more || superfluous)
        })
    }
}

impl BestGeneric {
    pub(super) fn finding(self, prepared: &Prepared<'_>) -> GenericFinding {
        let used: Vec<usize> = (0..prepared.rests.len()).filter(|&k| prepared.used[k]).collect();
        let rms = |axis: usize| {
            (self.biases.iter().map(|b| b[axis] * b[axis]).sum::<f64>() / self.biases.len().max(1) as f64).sqrt()
        };
        let axis = (0..3).max_by(|&a, &b| rms(a).total_cmp(&rms(b))).unwrap_or(0);
        let mut order: Vec<usize> = (0..self.biases.len()).collect();
        order.sort_by(|&a, &b| self.biases[b][axis].abs().total_cmp(&self.biases[a][axis].abs()));
        GenericFinding {
            block: self.block,
            kernel: self.kernel,
            log_bayes_factor: self.log_bayes_factor,
            axis,
            rests: order.into_iter().take(3).map(|e| used[e]).collect(),
            rms: rms(axis),
        }
    }
}
