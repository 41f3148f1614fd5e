//! Block sums of a recording and what their scatter says about its noise.

use std::ops::Range;

use imucal_core::rest::BlockSums;
use nalgebra::{Vector3, Vector6};

use crate::recording::Recording;
use crate::stats::median;

/// Sums over [`BLOCK_S`](super::BLOCK_S) of samples, six channels: rate x, y, z, then force x, y, z.
pub(super) type Block = BlockSums<f64>;

/// A block has this many means at least, if it has as many samples (0.005 s each).
const MEANS: usize = 10;

/// Blocks that are averaged before neighbours are compared, to see noise at low frequency (0.25 s).
const GROUP_BLOCKS: usize = 5;

/// The blocks of a recording, and what else one pass over the samples tells.
pub(super) struct Blocks {
    /// Sums of the samples.
    pub(super) samples: Vec<Block>,
    /// Sums of means over `averaged` samples each. The noise of single samples grows with the rate until slow motion
    /// drowns in it; that of these means does not. Empty where they are the samples themselves.
    means: Vec<Block>,
    pub(super) averaged: usize,
    /// Smallest step of each channel (its resolution).
    pub(super) steps: Vector6<f64>,
}

impl Blocks {
    /// Sums of the means.
    pub(super) fn means(&self) -> &[Block] {
        if self.averaged == 1 { &self.samples } else { &self.means }
    }
}

/// One pass over the samples, and at high rates a second one for the means.
pub(super) fn sum_blocks(recording: &Recording<'_>, block_samples: usize) -> Blocks {
    let averaged = (block_samples / MEANS).max(1);
    let mut steps = Vector6::repeat(f64::INFINITY);
    let mut last = Vector6::repeat(f64::NAN);
    let mut means = Vec::new();
    let samples = recording
        .angular_rate
        .chunks_exact(block_samples)
        .zip(recording.specific_force.chunks_exact(block_samples))
        .map(|(rates, forces)| {
            let mut block = Block::new();
            for (w, f) in rates.iter().zip(forces) {
                let sample = Vector6::new(w[0], w[1], w[2], f[0], f[1], f[2]);
                for channel in 0..6 {
                    let step = (sample[channel] - last[channel]).abs();
                    if step > 0.0 && step < steps[channel] {
                        steps[channel] = step;
                    }
                }
                last = sample;
                block.push(Vector3::from(*w), Vector3::from(*f));
            }
            if averaged > 1 {
                means.push(sum_means(rates, forces, averaged));
            }
            block
        })
        .collect();
    Blocks { samples, means, averaged, steps }
}

/// Sums of the means of `averaged` samples each.
fn sum_means(rates: &[[f64; 3]], forces: &[[f64; 3]], averaged: usize) -> Block {
    let mean = |rows: &[[f64; 3]]| rows.iter().map(|&row| Vector3::from(row)).sum::<Vector3<f64>>() / averaged as f64;
    let mut block = Block::new();
    for (rates, forces) in rates.chunks_exact(averaged).zip(forces.chunks_exact(averaged)) {
        block.push(mean(rates), mean(forces));
    }
    block
}

pub(super) fn merge(blocks: &[Block]) -> Block {
    blocks.iter().fold(Block::new(), |mut sum, block| {
        sum.merge(block);
        sum
    })
}

/// By how much the variance of a mean exceeds that of white noise: half the mean squared difference of neighbouring
/// 0.25 s means (an Allan variance) over what the scatter of single samples predicts.
pub(super) fn colour_factor(blocks: &[Block], rests: &[Range<usize>]) -> Vector6<f64> {
    let mut sum = Vector6::zeros();
    let mut count = 0.0;
    for range in rests {
        let variance = merge(&blocks[range.clone()]).variance();
        let groups: Vec<Block> = blocks[range.clone()].chunks_exact(GROUP_BLOCKS).map(merge).collect();
        for pair in groups.windows(2) {
            count += 1.0;
            let difference = pair[1].mean() - pair[0].mean();
            let samples = pair[0].count() as f64;
            sum += difference.zip_map(&variance, |d, v| if v > 0.0 { 0.5 * d * d * samples / v } else { 0.0 });
        }
    }
    // With fewer than 20 pairs the estimate says nothing: white noise is assumed.
    sum.map(|total| if count >= 20.0 && total > 0.0 { total / count } else { 1.0 })
}

/// Variance of one sample of white noise with the same density at low frequency; `None` without rests.
pub(super) fn noise_variance(blocks: &[Block], rests: &[Range<usize>], colour: &Vector6<f64>) -> Option<Vector6<f64>> {
    let variances: Vec<Vector6<f64>> = rests.iter().map(|range| merge(&blocks[range.clone()]).variance()).collect();
    let typical =
        |channel: usize| median(&mut variances.iter().map(|variance| variance[channel]).collect::<Vec<f64>>());
    (!rests.is_empty()).then(|| Vector6::from_fn(|channel, _| typical(channel) * colour[channel]))
}
