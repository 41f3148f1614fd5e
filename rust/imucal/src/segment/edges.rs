//! Where a rest begins and ends, and how still it is.

use std::ops::Range;

use nalgebra::{Vector3, Vector6};

use super::WINDOW_BLOCKS;
use super::blocks::{Block, merge};
use crate::stats::median;

/// Without the guard block at each end that the motion may have touched; a recording's own ends need none.
pub(super) fn trim(blocks: &Range<usize>, windows: usize) -> Range<usize> {
    let start = if blocks.start == 0 { 0 } else { blocks.start + 1 };
    let end = if blocks.end == windows + WINDOW_BLOCKS - 1 { blocks.end } else { blocks.end - 1 };
    start..end.max(start)
}

/// Without the ends that are louder than the rest itself: a hand comes to rest slowly, and its tremor says how calm
/// this rest is.
pub(super) fn calm(mut blocks: Range<usize>, statistic: &[f64]) -> Range<usize> {
    if blocks.len() <= WINDOW_BLOCKS {
        return blocks;
    }
    let loud = 3.0 * unsteadiness(&blocks, statistic).max(1.0);
    while blocks.len() > WINDOW_BLOCKS && statistic[blocks.start] > loud {
        blocks.start += 1;
    }
    while blocks.len() > WINDOW_BLOCKS && statistic[blocks.end - WINDOW_BLOCKS] > loud {
        blocks.end -= 1;
    }
    blocks
}

/// Without the ends in which the gyroscope already turns too slowly for its scatter to show it.
///
/// Up to half a second at each end is compared with the inner part: a turn that the noise of the inner part explains
/// less than once in 10^5 ends belongs to the move.
pub(super) fn settle(mut range: Range<usize>, blocks: &[Block]) -> Range<usize> {
    const EDGE: usize = WINDOW_BLOCKS;
    const LIMIT: f64 = 25.9; // chi2 with 3 degrees of freedom, 1e-5
    if range.len() < 3 * EDGE {
        return range;
    }
    let rates: Vec<Vector3<f64>> = blocks[range.clone()].iter().map(|b| b.mean().fixed_rows::<3>(0).into()).collect();
    let inner = &rates[EDGE..rates.len() - EDGE];
    let count = inner.len() as f64;
    let mean = inner.iter().sum::<Vector3<f64>>() / count;
    let square = |v: Vector3<f64>| v.component_mul(&v);
    // A noise-free simulation: rounding is no turn.
    let variance =
        (inner.iter().map(|rate| square(rate - mean)).sum::<Vector3<f64>>() / (count - 1.0)).map(|v| v.max(1e-18));
    let turning = |edge: &mut dyn Iterator<Item = &Vector3<f64>>| {
        let mut sum = Vector3::zeros();
        let mut worst = (LIMIT, 0);
        for (k, rate) in edge.take(EDGE).enumerate() {
            sum += rate - mean;
            let n = (k + 1) as f64;
            let chi2 = square(sum).component_div(&(variance * (n * (1.0 + n / count)))).sum();
            if chi2 > worst.0 {
                worst = (chi2, k + 1);
            }
        }
        // One guard block more, as everywhere.
        if worst.1 > 0 { worst.1 + 1 } else { 0 }
    };
    let (at_start, at_end) = (turning(&mut rates.iter()), turning(&mut rates.iter().rev()));
    range.start += at_start;
    range.end -= at_end;
    range
}

/// Change of gravity from the first to the last third of a rest over what noise explains at most (chi2 / 15, so that
/// noise alone exceeds 2 once in 10^6 rests).
pub(super) fn drift(blocks: &[Block], colour: &Vector6<f64>) -> f64 {
    let third = blocks.len() / 3;
    if third == 0 {
        return 0.0;
    }
    let (first, last) = (merge(&blocks[..third]), merge(&blocks[blocks.len() - third..]));
    let change = last.mean() - first.mean();
    let variance = (first.variance() + last.variance()).component_mul(colour) / first.count() as f64;
    (3..6).filter(|&c| variance[c] > 0.0).map(|c| change[c] * change[c] / variance[c]).sum::<f64>() / 15.0
}

/// Median statistic of the windows inside a rest.
pub(super) fn unsteadiness(blocks: &Range<usize>, statistic: &[f64]) -> f64 {
    let windows = blocks.start..(blocks.end + 1).saturating_sub(WINDOW_BLOCKS).max(blocks.start + 1);
    median(&mut statistic[windows].to_vec())
}

/// Whether gravity goes astray by more than 5 % of `size` (3 deg) within a rest: an even tumble has no quieter windows
/// to be told from, but no rest either.
pub(super) fn wanders(blocks: &[Block], size: f64) -> bool {
    let force = |blocks: &[Block]| -> Vector3<f64> { merge(blocks).mean().fixed_rows::<3>(3).into() };
    let whole = force(blocks);
    blocks.chunks_exact(WINDOW_BLOCKS).any(|window| (force(window) - whole).norm() > 0.05 * size)
}
