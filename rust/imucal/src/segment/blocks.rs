//! Block sums of a recording and what their scatter says about its noise.

use imucal_core::rest::BlockSums;
use nalgebra::{Vector3, Vector6};
use pulp::{Arch, Simd, WithSimd};

use crate::recording::Recording;

/// Sums over [`BLOCK_S`](super::BLOCK_S) of samples, six channels: rate x, y, z, then force x, y, z.
pub(super) type Block = BlockSums<f64>;

/// A block has this many means at least, if it has as many samples (0.005 s each).
const MEANS: usize = 10;

/// Samples that are looked at while they are near, in whole blocks.
const PART: usize = 256;
/// Rows of a triad side by side: full registers.
const ROWS: usize = 8;

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
    Arch::new().dispatch(Summing { recording, block_samples })
}

/// The passes, made with the widest vectors that the processor has.
struct Summing<'a> {
    recording: &'a Recording<'a>,
    block_samples: usize,
}

impl WithSimd for Summing<'_> {
    type Output = Blocks;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Blocks {
        let Self { recording, block_samples } = self;
        let averaged = (block_samples / MEANS).max(1);
        let count = recording.len() / block_samples;
        let mut samples = Vec::with_capacity(count);
        let mut means = Vec::with_capacity(if averaged > 1 { count } else { 0 });
        let mut steps = [[f64::INFINITY; 3 * ROWS]; 2];
        let part = (PART / block_samples).max(1) * block_samples;
        for start in (0..count * block_samples).step_by(part) {
            let end = (start + part).min(count * block_samples);
            let before = start.saturating_sub(1);
            let triads = [recording.angular_rate, recording.specific_force].map(|rows| rows.part(before..end));
            for (steps, rows) in steps.iter_mut().zip(&triads) {
                smallest_steps(rows, steps);
            }
            let [rates, forces] = triads.each_ref().map(|rows| &rows[start - before..]);
            for (rates, forces) in rates.chunks_exact(block_samples).zip(forces.chunks_exact(block_samples)) {
                let mut block = Block::new();
                rates.iter().zip(forces).for_each(|(w, f)| block.push(Vector3::from(*w), Vector3::from(*f)));
                samples.push(block);
                if averaged > 1 {
                    means.push(sum_means(rates, forces, averaged));
                }
            }
        }
        let smallest = |k: usize| steps[k / 3].iter().skip(k % 3).step_by(3).copied().fold(f64::INFINITY, f64::min);
        Blocks { samples, means, averaged, steps: Vector6::from_fn(|channel, _| smallest(channel)) }
    }
}

/// Lessens `steps`, those of some rows side by side, to the smallest steps from one row to the next.
#[inline(always)]
fn smallest_steps(rows: &[[f64; 3]], steps: &mut [f64; 3 * ROWS]) {
    let lessen = |smallest: &mut f64, before: &f64, after: &f64| {
        let step = (after - before).abs();
        let step = if step > 0.0 { step } else { f64::INFINITY };
        *smallest = if step < *smallest { step } else { *smallest };
    };
    let after = rows[1..].as_flattened();
    let (fulls_before, before) = rows.as_flattened()[..after.len()].as_chunks::<{ 3 * ROWS }>();
    let (fulls_after, after) = after.as_chunks::<{ 3 * ROWS }>();
    for (before, after) in fulls_before.iter().zip(fulls_after) {
        (0..3 * ROWS).for_each(|k| lessen(&mut steps[k], &before[k], &after[k]));
    }
    for (smallest, (before, after)) in steps.iter_mut().zip(before.iter().zip(after)) {
        lessen(smallest, before, after);
    }
}

/// Sums of the means of `averaged` samples each.
#[inline(always)]
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

/// Mean of blocks of one length.
pub(super) fn mean(blocks: &[Block]) -> Vector6<f64> {
    blocks.iter().map(Block::mean).sum::<Vector6<f64>>() / blocks.len() as f64
}

/// What says by how much the variance of a mean exceeds that of white noise: half the squared differences of neighbouring 0.25 s
/// means (an Allan variance) over what the scatter of single samples predicts.
#[derive(Clone, Copy)]
pub(super) struct Colour {
    sum: Vector6<f64>,
    pairs: f64,
}

impl Colour {
    pub(super) fn none() -> Self {
        Self { sum: Vector6::zeros(), pairs: 0.0 }
    }

    /// Of a rest in which single samples have this variance.
    pub(super) fn of(blocks: &[Block], variance: &Vector6<f64>) -> Self {
        let mut colour = Self::none();
        let mut before = None;
        for group in blocks.chunks_exact(GROUP_BLOCKS) {
            let samples = group.iter().map(Block::count).sum::<usize>() as f64;
            let now = mean(group);
            if let Some(before) = before.replace(now) {
                let excess = |d: f64, v: f64| if v > 0.0 { 0.5 * d * d * samples / v } else { 0.0 };
                colour.sum += (now - before).zip_map(variance, excess);
                colour.pairs += 1.0;
            }
        }
        colour
    }

    pub(super) fn add(&mut self, other: &Self) {
        self.sum += other.sum;
        self.pairs += other.pairs;
    }

    /// The factor; with fewer than 20 pairs the estimate says nothing, and white noise is assumed.
    pub(super) fn factor(&self) -> Vector6<f64> {
        self.sum.map(|total| if self.pairs >= 20.0 && total > 0.0 { total / self.pairs } else { 1.0 })
    }
}
