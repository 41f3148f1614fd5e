//! Computes the mean and variance of each block of samples, and the variance of windows of ten blocks (model.md (11)).

use imucal_core::rest::BlockSums;
use nalgebra::{Vector3, Vector6};
use pulp::{Simd, WithSimd};

use super::WINDOW_BLOCKS;
use crate::numerics::instructions::Instructions;
use crate::numerics::workers::{share_out, threads_for};
use crate::recording::{Recording, SIDE_BY_SIDE, each_step};

/// Sums over the samples of one block of length [`BLOCK_S`](super::BLOCK_S). The six channels are rate x, y, z, then
/// force x, y, z.
pub(super) type Block = BlockSums<f64>;

/// At high sampling rates, the samples of a block are averaged into at least this number of means. Each mean then
/// covers 3.5 to 5 ms. At low sampling rates, samples are not averaged.
const MEANS: usize = 10;

/// Number of samples that are processed together. Their data fit into the processor's cache.
const PART: usize = 256;
/// Number of samples that a thread processes as one job.
const JOB: usize = 1 << 16;

/// Number of consecutive blocks (together 0.25 s) that form one mean. The Allan variance in [`Colour`] is computed from
/// such means, because averaging removes the noise at high frequencies. This noise hardly affects the mean over a rest.
const GROUP_BLOCKS: usize = 5;

/// The blocks of a recording, and further statistics that are computed in the same pass over the samples.
pub(super) struct Blocks {
    /// Sums over the samples of each block.
    pub(super) samples: Vec<Block>,
    /// Variance of each channel in each window. Each window starts one block after the previous window. The values
    /// whose variance is computed are means over `averaged` samples. Single samples are not used, because their noise
    /// increases with the sampling rate and would mask slow motion.
    pub(super) variances: [Vec<f64>; 6],
    /// Number of consecutive samples that are averaged before the variances are computed; 1 below 400 Hz.
    pub(super) averaged: usize,
    /// Smallest nonzero difference of consecutive samples of each channel (its resolution), raw units.
    pub(super) steps: Vector6<f64>,
}

/// Computes [`Blocks`] in one pass over the samples, which is divided among threads.
pub(super) fn sum_blocks(recording: &Recording<'_>, block_samples: usize) -> Blocks {
    let averaged = (block_samples / MEANS).max(1);
    let count = recording.len() / block_samples;
    let mut samples = vec![Block::new(); count];
    let mut variances = [(); 6].map(|()| vec![0.0; (count + 1).saturating_sub(WINDOW_BLOCKS)]);
    let of_job = (JOB / block_samples).max(1);
    let mut steps = vec![[[f64::INFINITY; SIDE_BY_SIDE]; 2]; count.div_ceil(of_job)];
    let mut of_windows = variances.each_mut().map(|of_channel| of_channel.chunks_mut(of_job));
    let jobs = samples.chunks_mut(of_job).zip(&mut steps).enumerate().map(|(job, (samples, steps))| Summing {
        recording,
        block_samples,
        averaged,
        first: job * of_job,
        samples,
        variances: of_windows.each_mut().map(|of_channel| of_channel.next().unwrap_or_default()),
        steps,
    });
    let jobs = jobs.collect();
    share_out(threads_for(recording.len()), jobs, |job: Summing<'_>| Instructions::Best.run(job));
    if averaged == 1 {
        let to = variances.each_mut().map(Vec::as_mut_slice);
        Instructions::Best.run(Windows { blocks: &samples, to });
    }
    let of_channel =
        |channel: usize| steps.iter().flat_map(move |of| of[channel / 3].iter().skip(channel % 3).step_by(3));
    let smallest = |channel: usize| of_channel(channel).copied().fold(f64::INFINITY, f64::min);
    let steps = Vector6::from_fn(|channel, _| smallest(channel));
    Blocks { samples, variances, averaged, steps }
}

/// Computation of [`Blocks`] for one job, which is a sequence of consecutive blocks. It uses the widest vector
/// instructions of the processor.
struct Summing<'a> {
    recording: &'a Recording<'a>,
    block_samples: usize,
    averaged: usize,
    /// Index of the first block of the job.
    first: usize,
    /// Output: sums over the samples of each block of the job.
    samples: &'a mut [Block],
    /// Output: variances of the windows that begin in the blocks of the job. If samples are not averaged, nothing is
    /// written.
    variances: [&'a mut [f64]; 6],
    /// Output: smallest nonzero differences of consecutive rates and of consecutive forces, one value for each SIMD
    /// lane.
    steps: &'a mut [[f64; SIDE_BY_SIDE]; 2],
}

impl WithSimd for Summing<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { recording, block_samples, averaged, first, samples, variances, steps } = self;
        let of_part = (PART / block_samples).max(1);
        let mut means = Vec::new();
        for (part, samples) in samples.chunks_mut(of_part).enumerate() {
            let start = (first + part * of_part) * block_samples;
            let end = start + samples.len() * block_samples;
            let before = start.saturating_sub(1);
            let triads = [recording.angular_rate, recording.specific_force].map(|rows| rows.part(before..end));
            for (steps, rows) in steps.iter_mut().zip(&triads) {
                smallest_steps(rows, steps);
            }
            let [rates, forces] = triads.each_ref().map(|rows| &rows[start - before..]);
            let blocks = rates.chunks_exact(block_samples).zip(forces.chunks_exact(block_samples));
            for (block, (rates, forces)) in samples.iter_mut().zip(blocks) {
                rates.iter().zip(forces).for_each(|(w, f)| block.push(Vector3::from(*w), Vector3::from(*f)));
                if averaged > 1 {
                    means.push(sum_means(rates, forces, averaged));
                }
            }
        }
        if averaged > 1 && !variances[0].is_empty() {
            // The last windows of this job extend into the blocks of the next job, so the means of these blocks are
            // computed here, too.
            for block in means.len()..variances[0].len() + WINDOW_BLOCKS - 1 {
                let own = (first + block) * block_samples..(first + block + 1) * block_samples;
                let (rates, forces) = (recording.angular_rate.part(own.clone()), recording.specific_force.part(own));
                means.push(sum_means(&rates, &forces, averaged));
            }
            Windows { blocks: &means, to: variances }.with_simd(simd);
        }
    }
}

/// Computes the variance of each channel in each window, with the widest vector instructions of the processor.
///
/// The blocks are divided into groups of ten. A window is the last k blocks of one group and the first 10 - k blocks of
/// the next group. Each of these two partial sums is computed from the partial sum with one block less. Each window
/// therefore needs three additions of block sums instead of ten.
struct Windows<'a> {
    blocks: &'a [Block],
    /// Output: for each channel, the variance in each window.
    to: [&'a mut [f64]; 6],
}

impl WithSimd for Windows<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { blocks: mut ahead, mut to } = self;
        let (mut at, windows) = (0, to[0].len());
        while let Some((group, next)) = ahead.split_first_chunk::<WINDOW_BLOCKS>() {
            let mut suffixes = *group;
            for k in (0..WINDOW_BLOCKS - 1).rev() {
                let after = suffixes[k + 1];
                suffixes[k].merge(&after);
            }
            let mut prefix = Block::new();
            for (k, suffix) in suffixes.iter().enumerate().take(windows - at) {
                if k > 0 {
                    prefix.merge(&next[k - 1]);
                }
                let mut window = *suffix;
                window.merge(&prefix);
                let variance = window.variance();
                to.iter_mut().zip(&variance).for_each(|(of_channel, v)| of_channel[at] = *v);
                at += 1;
            }
            ahead = next;
        }
    }
}

/// Updates `steps` with the smallest nonzero differences of consecutive samples (rows of three axes).
#[inline(always)]
fn smallest_steps(rows: &[[f64; 3]], steps: &mut [f64; SIDE_BY_SIDE]) {
    each_step(rows, |k, before, after| {
        let step = (after - before).abs();
        let step = if step > 0.0 { step } else { f64::INFINITY };
        steps[k] = if step < steps[k] { step } else { steps[k] };
    });
}

/// Block sums in which each element is a mean over `averaged` consecutive samples, instead of a single sample.
#[inline(always)]
fn sum_means(rates: &[[f64; 3]], forces: &[[f64; 3]], averaged: usize) -> Block {
    let mean = |rows: &[[f64; 3]]| rows.iter().map(|&row| Vector3::from(row)).sum::<Vector3<f64>>() / averaged as f64;
    let mut block = Block::new();
    for (rates, forces) in rates.chunks_exact(averaged).zip(forces.chunks_exact(averaged)) {
        block.push(mean(rates), mean(forces));
    }
    block
}

/// Sums over all samples of several blocks.
pub(super) fn merge(blocks: &[Block]) -> Block {
    blocks.iter().fold(Block::new(), |mut sum, block| {
        sum.merge(block);
        sum
    })
}

/// Mean of all channels over several blocks, which must have equal numbers of samples.
pub(super) fn mean(blocks: &[Block]) -> Vector6<f64> {
    blocks.iter().map(Block::mean).sum::<Vector6<f64>>() / blocks.len() as f64
}

/// Noise is treated as low-pass filtered if the estimated factor c of [`Colour`] is at least this value. For white
/// noise, the estimated factor is almost always smaller.
const FILTERED: f64 = 1.7;

/// Sums from which the factor c of model.md (10) is estimated. c is the factor by which the correlation of the noise
/// increases the variance of a mean. The estimate is the Allan variance of consecutive 0.25 s means, divided by its
/// expected value for white noise with the variance of single samples.
#[derive(Clone, Copy)]
pub(super) struct Colour {
    /// Sum of (b - a)^2 / (2 v) over all pairs a, b of consecutive means. v is the variance of a mean if the noise is
    /// white.
    sum: Vector6<f64>,
    /// Number of pairs of consecutive means, for each channel. Pairs of a rest at which all samples of the channel are
    /// equal are not counted.
    pairs: Vector6<f64>,
    /// Number of samples over which each mean is taken.
    samples: f64,
}

impl Colour {
    pub(super) fn none() -> Self {
        Self { sum: Vector6::zeros(), pairs: Vector6::zeros(), samples: 1.0 }
    }

    /// The sums for one rest, which consists of `blocks`. `variance` is the variance of its single samples.
    pub(super) fn of(blocks: &[Block], variance: &Vector6<f64>) -> Self {
        let mut colour = Self::none();
        let mut before = None;
        for group in blocks.chunks_exact(GROUP_BLOCKS) {
            let samples = group.iter().map(Block::count).sum::<usize>() as f64;
            colour.samples = samples;
            let now = mean(group);
            if let Some(before) = before.replace(now) {
                let excess = |d: f64, v: f64| if v > 0.0 { 0.5 * d * d * samples / v } else { 0.0 };
                colour.sum += (now - before).zip_map(variance, excess);
                colour.pairs += variance.map(|v| f64::from(u8::from(v > 0.0)));
            }
        }
        colour
    }

    pub(super) fn add(&mut self, other: &Self) {
        self.sum += other.sum;
        self.pairs += other.pairs;
        self.samples = self.samples.max(other.samples);
    }

    /// Returns c (see [`Self::factor`]) of means over much more than 0.25 s. `factor` is c estimated from 0.25 s means.
    ///
    /// Low-pass filtered noise is correlated across the boundary of two consecutive means, so their difference, and
    /// with it `factor`, is too small: `factor = c (1 - 1.5 / (pi^2 tau B))` with `1 / B = 2 c dt`. tau is the
    /// averaging time of 0.25 s, dt is the sampling interval, and B is the noise bandwidth. The equation is solved for
    /// c (model.md (10)). If `factor` is below [`FILTERED`], the noise may be white, and `factor` is returned
    /// unchanged.
    fn without_edges(&self, factor: f64) -> f64 {
        let edges = 3.0 / (std::f64::consts::PI.powi(2) * self.samples);
        if factor < FILTERED {
            return factor;
        }
        (1.0 - (1.0 - 4.0 * edges * factor).max(0.0).sqrt()) / (2.0 * edges)
    }

    /// For each channel, the factor c by which the correlation of the noise increases the variance of a mean. With
    /// fewer than 20 pairs, the estimate would be too uncertain, and the factor is one (white noise).
    pub(super) fn factor(&self) -> Vector6<f64> {
        self.sum.zip_map(&self.pairs, |total, pairs| {
            if pairs >= 20.0 && total > 0.0 { self.without_edges(total / pairs) } else { 1.0 }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
        for count in [0_usize, 9, 10, 11, 19, 20, 21, 47] {
            let mut found = [(); 6].map(|()| vec![0.0; (count + 1).saturating_sub(WINDOW_BLOCKS)]);
            let to = found.each_mut().map(Vec::as_mut_slice);
            Instructions::Best.run(Windows { blocks: &blocks[..count], to });
            let expected: Vec<_> = blocks[..count].windows(WINDOW_BLOCKS).map(|w| merge(w).variance()).collect();
            assert!(found.iter().all(|of_channel| of_channel.len() == expected.len()));
            for (k, expected) in expected.iter().enumerate() {
                let found = Vector6::from_fn(|channel, _| found[channel][k]);
                assert!((found - expected).norm() < 1e-9 * (1.0 + expected.norm()), "{count}: {found} {expected}");
            }
        }
    }

    #[test]
    fn jobs_and_parts_meet_without_a_seam() {
        // The recording is divided into more than two jobs, and its last block is incomplete. The smallest difference
        // of consecutive samples is at the boundary of two jobs.
        let rough = |i: usize, axis: usize| (((i * i + 7 * axis) % 1009) as f64 - 504.0) * 10.0;
        let samples = 2 * JOB + 333;
        let mut rate: Vec<[f64; 3]> = (0..samples).map(|i| [0, 1, 2].map(|axis| rough(i, axis))).collect();
        let force: Vec<[f64; 3]> = (0..samples).map(|i| [3, 4, 5].map(|axis| rough(i, axis))).collect();
        let time_s: Vec<f64> = (0..samples).map(|i| i as f64 * 1e-3).collect();
        for block_samples in [1, 7, 50, 400] {
            let seam = (JOB / block_samples).max(1) * block_samples;
            let before = rate[seam];
            rate[seam] = rate[seam - 1].map(|value| value + 0.5);
            let recording = Recording::try_new("rough", &time_s, &force, &rate).unwrap();
            let found = sum_blocks(&recording, block_samples);
            let count = samples / block_samples;
            assert_eq!(found.samples.len(), count);
            let mut steps = Vector6::repeat(f64::INFINITY);
            for i in 1..count * block_samples {
                for (channel, rows) in [&rate, &force].into_iter().enumerate() {
                    for axis in 0..3 {
                        let step = (rows[i][axis] - rows[i - 1][axis]).abs();
                        let smallest = &mut steps[3 * channel + axis];
                        *smallest = if step > 0.0 { smallest.min(step) } else { *smallest };
                    }
                }
            }
            assert_eq!(found.steps, steps, "{block_samples}");
            for (k, block) in found.samples.iter().enumerate() {
                assert_eq!(block.count(), block_samples);
                let own = rate[k * block_samples..(k + 1) * block_samples].iter();
                let mean = own.map(|row| row[1]).sum::<f64>() / block_samples as f64;
                assert!((block.mean()[1] - mean).abs() < 1e-9, "block {k} of {block_samples}");
            }
            let averaged = found.averaged;
            let means: Vec<Block> = (0..count)
                .map(|k| k * block_samples..(k + 1) * block_samples)
                .map(|own| sum_means(&rate[own.clone()], &force[own], averaged))
                .collect();
            let windows = means.windows(WINDOW_BLOCKS).map(|window| merge(window).variance());
            for (k, variance) in windows.enumerate() {
                let found = Vector6::from_fn(|channel, _| found.variances[channel][k]);
                assert!((found - variance).norm() < 1e-9 * variance.norm(), "window {k} of {block_samples}");
            }
            rate[seam] = before;
        }
    }
}
