//! Noise floor, window statistic, and the choice of the threshold.

use std::ops::Range;

use imucal_core::rest::rest_statistic;
use nalgebra::Vector6;

use super::WINDOW_BLOCKS;
use super::blocks::{Block, merge};
use super::edges::trim;
use crate::stats::quantile;

/// The statistic of every window (one per block it may start at) and the noise floor (variances).
pub(super) fn window_statistic(blocks: &[Block], steps: &Vector6<f64>) -> (Vec<f64>, Vector6<f64>) {
    let windows: Vec<Block> = blocks.windows(WINDOW_BLOCKS).map(merge).collect();
    let variances: Vec<Vector6<f64>> = windows.iter().map(Block::variance).collect();
    // A coarse converter may read one number throughout a rest: its floor is that of the rounding. A channel that
    // never changes has no step at all and no say.
    let rounding = steps.map(|step| if step.is_finite() { step * step / 12.0 } else { f64::INFINITY });
    let typical = |mut values: Vec<f64>, q: f64, channel: usize| quantile(&mut values, q).max(rounding[channel]);
    let mut floor =
        Vector6::from_fn(|channel, _| typical(variances.iter().map(|v| v[channel]).collect(), 0.05, channel));
    let mut statistic = Vec::new();
    // The floor of each channel is that of the windows that are quiet in all channels together.
    for _ in 0..4 {
        statistic = windows.iter().map(|window| rest_statistic(window, &floor)).collect();
        let quiet = 2.0 * quantile(&mut statistic.clone(), 0.05);
        floor = Vector6::from_fn(|channel, _| {
            let in_quiet = variances.iter().zip(&statistic).filter(|(_, s)| **s <= quiet).map(|(v, _)| v[channel]);
            typical(in_quiet.collect(), 0.5, channel)
        });
    }
    (statistic, floor)
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
    let mut best = (0.0, LOWEST, LOWEST);
    let mut plateau: Option<(usize, f64)> = None;
    let mut threshold = LOWEST;
    while threshold <= highest {
        let rests = still_stretches(statistic, threshold)
            .filter(|range| trim(range, statistic.len()).len() >= min_blocks)
            .count();
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

/// Stretches of blocks that lie in some window below the threshold.
pub(super) fn still_stretches(statistic: &[f64], threshold: f64) -> impl Iterator<Item = Range<usize>> + '_ {
    let still = move |window: usize| statistic[window] < threshold;
    let mut window = 0;
    std::iter::from_fn(move || {
        while window < statistic.len() && !still(window) {
            window += 1;
        }
        if window == statistic.len() {
            return None;
        }
        let start = window;
        let mut end = window + WINDOW_BLOCKS;
        while window < statistic.len() && window < end {
            if still(window) {
                end = window + WINDOW_BLOCKS;
            }
            window += 1;
        }
        Some(start..end)
    })
}
