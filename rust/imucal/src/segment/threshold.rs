//! Noise floor, window statistic, and the choice of the threshold.

use std::ops::Range;

use imucal_core::rest::statistic_of;
use nalgebra::Vector6;

use super::WINDOW_BLOCKS;
use super::blocks::Block;
use super::edges::trim;
use crate::stats::quantile_of;

/// The statistic of every window (one per block it may start at) and the noise floor (variances).
pub(super) fn window_statistic(blocks: &[Block], steps: &Vector6<f64>) -> (Vec<f64>, Vector6<f64>) {
    let variances = window_variances(blocks);
    // A coarse converter may read one number throughout a rest: its floor is that of the rounding. A channel that
    // never changes has no step at all and no say.
    let rounding = steps.map(|step| if step.is_finite() { step * step / 12.0 } else { f64::INFINITY });
    let mut floor = Vector6::from_fn(|channel, _| {
        quantile_of(variances.len(), |k| variances[k][channel], 0.05).max(rounding[channel])
    });
    let mut statistic = vec![0.0; variances.len()];
    // The floor of each channel is that of the windows that are quiet in all channels together.
    for _ in 0..4 {
        for (statistic, variance) in statistic.iter_mut().zip(&variances) {
            *statistic = statistic_of(variance, &floor);
        }
        let quiet = 2.0 * quantile_of(statistic.len(), |k| statistic[k], 0.05);
        let in_quiet: Vec<&Vector6<f64>> =
            variances.iter().zip(&statistic).filter(|(_, s)| **s <= quiet).map(|(v, _)| v).collect();
        let before = floor;
        floor = Vector6::from_fn(|channel, _| {
            quantile_of(in_quiet.len(), |k| in_quiet[k][channel], 0.5).max(rounding[channel])
        });
        if floor == before {
            break;
        }
    }
    (statistic, floor)
}

/// The variance in every window.
///
/// The windows that begin in one stretch of their length are what is left of it and what has come of the next: three
/// merges for a window instead of ten.
fn window_variances(blocks: &[Block]) -> Vec<Vector6<f64>> {
    let mut variances = Vec::with_capacity((blocks.len() + 1).saturating_sub(WINDOW_BLOCKS));
    let mut ahead = blocks;
    while let Some((stretch, next)) = ahead.split_first_chunk::<WINDOW_BLOCKS>() {
        let mut left = *stretch;
        for k in (0..WINDOW_BLOCKS - 1).rev() {
            let after = left[k + 1];
            left[k].merge(&after);
        }
        variances.push(left[0].variance());
        let mut come = Block::new();
        for (left, block) in left[1..].iter().zip(next) {
            come.merge(block);
            let mut window = *left;
            window.merge(&come);
            variances.push(window.variance());
        }
        ahead = next;
    }
    variances
}

/// The threshold in the widest range (on a logarithmic scale) that always finds the same number of rests, and that range.
///
/// Widths are weighed by the number of rests (none weighs less than nothing): one rest on a table before a unit is held by
/// hand, a thousand times less quiet, must not be all that is found.
pub(super) fn choose_threshold(statistic: &[f64], min_blocks: usize) -> (f64, f64, f64) {
    const LOWEST: f64 = 1.5;
    const STEP: f64 = 1.08;
    let loudest = statistic.iter().copied().fold(1.0, f64::max);
    // A tenth of the fastest motion, or half way to it on a logarithmic scale: above that, motion is taken for rest.
    let highest = (loudest / 100.0).max(loudest.sqrt()).max(2.0 * LOWEST);
    let levels = Levels::of(statistic, LOWEST, highest);
    let mut best = (0.0, LOWEST, LOWEST);
    let mut plateau: Option<(usize, f64)> = None;
    let mut threshold = LOWEST;
    while threshold <= highest {
        let rests = levels.still(threshold).filter(|range| trim(range, statistic.len()).len() >= min_blocks).count();
        let start = match plateau {
            Some((count, start)) if count == rests => start,
            _ => threshold,
        };
        plateau = Some((rests, start));
        let score = (threshold * STEP / start).ln() * (rests as f64 + 0.1).ln();
        if score > best.0 {
            best = (score, start, threshold);
        }
        threshold *= STEP;
    }
    let (_, from, to) = best;
    // Nearer the noise than the motion: the ends of a rest then hold as little motion as possible.
    (from * (to / from).powf(0.25), from, to)
}

/// The statistic as far as thresholds within a range see it.
pub(super) struct Levels {
    /// Windows in a row that are of one level: below all thresholds, above all, or of one value.
    runs: Vec<(f64, Range<usize>)>,
}

impl Levels {
    /// For thresholds from `lowest` to `highest`.
    pub(super) fn of(statistic: &[f64], lowest: f64, highest: f64) -> Self {
        let mut runs: Vec<(f64, Range<usize>)> = Vec::new();
        for (window, &value) in statistic.iter().enumerate() {
            let level = match value {
                _ if value < lowest => f64::NEG_INFINITY,
                _ if value >= highest => f64::INFINITY,
                _ => value,
            };
            match runs.last_mut() {
                Some((before, windows)) if *before == level => windows.end = window + 1,
                _ => runs.push((level, window..window + 1)),
            }
        }
        Self { runs }
    }

    /// Stretches of blocks that lie in some window below the threshold.
    pub(super) fn still(&self, threshold: f64) -> impl Iterator<Item = Range<usize>> + '_ {
        let mut still =
            self.runs.iter().filter(move |(level, _)| *level < threshold).map(|(_, windows)| windows).peekable();
        let end_of = |windows: &Range<usize>| windows.end - 1 + WINDOW_BLOCKS;
        std::iter::from_fn(move || {
            let first = still.next()?;
            let mut end = end_of(first);
            // Windows that overlap are one stretch.
            while let Some(next) = still.next_if(|next| next.start < end) {
                end = end_of(next);
            }
            Some(first.start..end)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::blocks::merge;
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn every_window_is_the_merged_sum_of_its_blocks() {
        let blocks: Vec<Block> = (0..47)
            .map(|k| {
                let mut block = Block::new();
                for i in 0..5 {
                    let x = (f64::from(k * 5 + i) * 1.7).sin();
                    block.push(Vector3::new(x, 1e4 + x * x, f64::from(k)), Vector3::new(-x, 0.0, 9.8));
                }
                block
            })
            .collect();
        for count in [0, 9, 10, 11, 19, 20, 21, 47] {
            let found = window_variances(&blocks[..count]);
            let expected: Vec<_> = blocks[..count].windows(WINDOW_BLOCKS).map(|w| merge(w).variance()).collect();
            assert_eq!(found.len(), expected.len());
            for (found, expected) in found.iter().zip(&expected) {
                assert!((found - expected).norm() < 1e-9 * (1.0 + expected.norm()), "{count}: {found} {expected}");
            }
        }
    }

    #[test]
    fn stretches_are_the_blocks_of_still_windows_at_any_threshold() {
        let statistic: Vec<f64> =
            (0..400).map(|i| ((f64::from(i) * 0.37).sin() * 3.0).exp() + f64::from(i % 3)).collect();
        let levels = Levels::of(&statistic, 1.5, 12.0);
        for threshold in [1.5, 2.0, 3.7, 9.0, 12.0] {
            let mut covered = vec![false; statistic.len() + WINDOW_BLOCKS - 1];
            for (window, _) in statistic.iter().enumerate().filter(|(_, s)| **s < threshold) {
                covered[window..window + WINDOW_BLOCKS].fill(true);
            }
            let mut found = vec![false; covered.len()];
            levels.still(threshold).for_each(|range| found[range].fill(true));
            assert_eq!(found, covered, "{threshold}");
        }
    }
}
