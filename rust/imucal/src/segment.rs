//! Rests and moves: when does the unit stand still? (model.md (11))
//!
//! The statistic of a half-second window is the mean over the six channels of (variance / noise floor). No initial rest
//! and no threshold is asked for: the noise floor is that of the quietest windows, and the threshold is taken from
//! the widest range of thresholds that all find the same number of rests. A sum of squared misfits would not do as
//! a criterion, for fewer rests always have the smaller sum.

use std::ops::Range;

use imucal_core::rest::{BlockSums, rest_statistic};
use nalgebra::{Vector3, Vector6};

use crate::error::Error;
use crate::recording::Recording;
use crate::stats::{median, quantile};

type Block = BlockSums<f64>;

/// Length of a block, s; a window has [`WINDOW_BLOCKS`] of them.
const BLOCK_S: f64 = 0.05;
const WINDOW_BLOCKS: usize = 10;
/// Blocks that are averaged before neighbours are compared, to see noise at low frequency (0.25 s).
const GROUP_BLOCKS: usize = 5;

/// Mean of a triad over a rest, in raw units.
#[derive(Clone, Copy, Debug)]
pub struct RestMean {
    /// The mean.
    pub mean: Vector3<f64>,
    /// Variance of that mean, from this rest's own scatter and the correlation of the noise.
    pub variance_of_mean: Vector3<f64>,
}

/// A stretch in which the unit stands still.
#[derive(Clone, Copy, Debug)]
pub struct Rest {
    /// Index of the first sample.
    pub first: usize,
    /// Index after the last sample.
    pub end: usize,
    /// Time of the first sample, s.
    pub start_s: f64,
    /// Time of the last sample, s.
    pub end_s: f64,
    /// Scatter in half a second over the noise floor, or drift of gravity over what noise explains, whichever is more
    /// (ratios of variances): near 1 on a table, more in a hand.
    pub unsteadiness: f64,
    /// Accelerometer.
    pub specific_force: RestMean,
    /// Gyroscope.
    pub angular_rate: RestMean,
}

/// The threshold that was chosen, and why.
#[derive(Clone, Debug)]
pub struct Threshold {
    /// A window is still below this multiple of the noise floor (a ratio of variances).
    pub factor: f64,
    /// The same number of rests is found from this threshold ...
    pub stable_from: f64,
    /// ... to this one: the widest such range.
    pub stable_to: f64,
    /// Noise floor of one sample: standard deviation in raw units, gyroscope x, y, z, accelerometer x, y, z.
    pub noise_floor: Vector6<f64>,
    /// Length of a window, s.
    pub window_s: f64,
}

/// White-noise densities from the rests, in raw units per sqrt(Hz).
#[derive(Clone, Copy, Debug)]
pub struct NoiseDensity {
    /// Accelerometer x, y, z.
    pub specific_force: Vector3<f64>,
    /// Gyroscope x, y, z.
    pub angular_rate: Vector3<f64>,
}

/// What rest detection says about a recording.
#[derive(Clone, Debug)]
pub struct Segments {
    /// Rests in order of time.
    pub rests: Vec<Rest>,
    /// Still stretches that are shorter than a rest must be, as sample ranges.
    pub too_short: Vec<Range<usize>>,
    /// The threshold and why it was chosen.
    pub threshold: Threshold,
    /// Noise within the rests.
    pub noise_density: NoiseDensity,
}

impl Segments {
    /// Finds the rests that last `min_rest_s` or more.
    ///
    /// # Errors
    /// [`Error::NotEnoughMotion`] if there is no rest.
    pub fn find(recording: &Recording<'_>, min_rest_s: f64) -> Result<Self, Error> {
        let dt_s = sample_interval_s(recording.time_s);
        let block_samples = ((BLOCK_S / dt_s).round() as usize).max(1);
        let (blocks, steps) = sum_blocks(recording, block_samples);
        let min_blocks = ((min_rest_s / (block_samples as f64 * dt_s)).round() as usize).max(2);
        if blocks.len() < WINDOW_BLOCKS.max(min_blocks) {
            return Err(no_rest(recording, min_rest_s));
        }
        let (statistic, floor) = window_statistic(&blocks, &steps);
        let threshold = choose_threshold(&statistic, min_blocks);
        let (long, short): (Vec<_>, Vec<_>) = still_stretches(&statistic, threshold.0)
            .map(|range| settle(calm(trim(&range, statistic.len()), &statistic), &blocks))
            .filter(|blocks| !blocks.is_empty())
            .partition(|blocks| blocks.len() >= min_blocks);
        if long.is_empty() {
            return Err(no_rest(recording, min_rest_s));
        }
        let colour = colour_factor(&blocks, &long);
        let rests: Vec<Rest> = long
            .iter()
            .map(|range| Rest {
                unsteadiness: unsteadiness(range, &statistic).max(drift(&blocks[range.clone()], &colour)),
                ..rest(recording, &blocks[range.clone()], range.start, &colour)
            })
            .collect();
        let variances: Vec<Vector6<f64>> = long.iter().map(|r| merge(&blocks[r.clone()]).variance()).collect();
        let density = |channel: usize| {
            let typical = median(&mut variances.iter().map(|v| v[channel]).collect::<Vec<f64>>());
            (typical * colour[channel] * dt_s).sqrt()
        };
        let samples = |r: Range<usize>| r.start * block_samples..r.end * block_samples;
        Ok(Self {
            noise_density: NoiseDensity {
                angular_rate: Vector3::from_fn(|i, _| density(i)),
                specific_force: Vector3::from_fn(|i, _| density(3 + i)),
            },
            too_short: short.into_iter().map(samples).collect(),
            threshold: Threshold {
                factor: threshold.0,
                stable_from: threshold.1,
                stable_to: threshold.2,
                noise_floor: floor.map(f64::sqrt),
                window_s: (WINDOW_BLOCKS * block_samples) as f64 * dt_s,
            },
            rests,
        })
    }
}

impl Threshold {
    /// One sentence for people.
    pub fn explain(&self, rests: usize) -> String {
        format!(
            "a {:.2} s window is still below {:.1} times the noise floor; every threshold from {:.1} to {:.1} finds the \
             same {rests} rests, the widest such range",
            self.window_s, self.factor, self.stable_from, self.stable_to
        )
    }
}

/// Median time between samples, s; NaN for fewer than two.
pub fn sample_interval_s(time_s: &[f64]) -> f64 {
    let mut steps: Vec<f64> = time_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
    median(&mut steps)
}

fn no_rest(recording: &Recording<'_>, min_rest_s: f64) -> Error {
    Error::NotEnoughMotion(format!(
        "{}: no rest of {min_rest_s} s or more in {} samples: hold the unit still in each pose for 2 s or longer, \
         or pass a shorter min_rest_s",
        recording.name,
        recording.len()
    ))
}

/// One pass over the samples: block sums, and the smallest step of each channel (its resolution).
fn sum_blocks(recording: &Recording<'_>, block_samples: usize) -> (Vec<Block>, Vector6<f64>) {
    let mut steps = Vector6::repeat(f64::INFINITY);
    let mut last = Vector6::repeat(f64::NAN);
    let blocks = recording
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
            block
        })
        .collect();
    (blocks, steps)
}

fn merge(blocks: &[Block]) -> Block {
    blocks.iter().fold(Block::new(), |mut sum, block| {
        sum.merge(block);
        sum
    })
}

/// The statistic of every window (one per block it may start at) and the noise floor (variances).
fn window_statistic(blocks: &[Block], steps: &Vector6<f64>) -> (Vec<f64>, Vector6<f64>) {
    let windows: Vec<Block> = blocks.windows(WINDOW_BLOCKS).map(merge).collect();
    let variances: Vec<Vector6<f64>> = windows.iter().map(Block::variance).collect();
    // A coarse converter may read one number throughout a rest: its floor is that of the rounding. A channel that
    // never changes has no step at all and no say.
    let rounding = steps.map(|step| {
        if step.is_finite() {
            step * step / 12.0
        } else {
            f64::INFINITY
        }
    });
    let typical = |mut values: Vec<f64>, q: f64, channel: usize| quantile(&mut values, q).max(rounding[channel]);
    let mut floor =
        Vector6::from_fn(|channel, _| typical(variances.iter().map(|v| v[channel]).collect(), 0.05, channel));
    let mut statistic = Vec::new();
    // The floor of each channel is that of the windows that are quiet in all channels together.
    for _ in 0..4 {
        statistic = windows.iter().map(|window| rest_statistic(window, &floor)).collect();
        let quiet = 2.0 * quantile(&mut statistic.clone(), 0.05);
        floor = Vector6::from_fn(|channel, _| {
            let in_quiet = variances
                .iter()
                .zip(&statistic)
                .filter(|(_, s)| **s <= quiet)
                .map(|(v, _)| v[channel]);
            typical(in_quiet.collect(), 0.5, channel)
        });
    }
    (statistic, floor)
}

/// The threshold in the widest range (on a logarithmic scale) that always finds the same number of rests, and that range.
fn choose_threshold(statistic: &[f64], min_blocks: usize) -> (f64, f64, f64) {
    const LOWEST: f64 = 1.5;
    const STEP: f64 = 1.08;
    let loudest = statistic.iter().copied().fold(1.0, f64::max);
    // Half way, on a logarithmic scale, between the noise and the loudest motion: above that, motion is taken for rest.
    let highest = loudest.sqrt().max(2.0 * LOWEST);
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
        let width = (threshold * STEP / start).ln();
        if rests > 0 && width > best.0 {
            best = (width, start, threshold);
        }
        threshold *= STEP;
    }
    let (_, from, to) = best;
    // Nearer the noise than the motion: the ends of a rest then hold as little motion as possible.
    (from * (to / from).powf(0.25), from, to)
}

/// Stretches of blocks that lie in some window below the threshold.
fn still_stretches(statistic: &[f64], threshold: f64) -> impl Iterator<Item = Range<usize>> + '_ {
    let mut window = 0;
    std::iter::from_fn(move || {
        while window < statistic.len() && !(statistic[window] < threshold) {
            window += 1;
        }
        if window == statistic.len() {
            return None;
        }
        let start = window;
        let mut end = window + WINDOW_BLOCKS;
        while window < statistic.len() && window < end {
            if statistic[window] < threshold {
                end = window + WINDOW_BLOCKS;
            }
            window += 1;
        }
        Some(start..end)
    })
}

/// Without the guard block at each end that the motion may have touched; a recording's own ends need none.
fn trim(blocks: &Range<usize>, windows: usize) -> Range<usize> {
    let start = if blocks.start == 0 { 0 } else { blocks.start + 1 };
    let end = if blocks.end == windows + WINDOW_BLOCKS - 1 {
        blocks.end
    } else {
        blocks.end - 1
    };
    start..end.max(start)
}

/// Without the ends that are louder than the rest itself: a hand comes to rest slowly, and its tremor says how calm
/// this rest is.
fn calm(mut blocks: Range<usize>, statistic: &[f64]) -> Range<usize> {
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
fn settle(mut range: Range<usize>, blocks: &[Block]) -> Range<usize> {
    const EDGE: usize = WINDOW_BLOCKS;
    const LIMIT: f64 = 25.9; // chi2 with 3 degrees of freedom, 1e-5
    if range.len() < 3 * EDGE {
        return range;
    }
    let rates: Vec<Vector3<f64>> = blocks[range.clone()]
        .iter()
        .map(|b| b.mean().fixed_rows::<3>(0).into())
        .collect();
    let inner = &rates[EDGE..rates.len() - EDGE];
    let count = inner.len() as f64;
    let mean = inner.iter().sum::<Vector3<f64>>() / count;
    let square = |v: Vector3<f64>| v.component_mul(&v);
    let variance = inner.iter().map(|rate| square(rate - mean)).sum::<Vector3<f64>>() / (count - 1.0);
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
fn drift(blocks: &[Block], colour: &Vector6<f64>) -> f64 {
    let third = blocks.len() / 3;
    if third == 0 {
        return 0.0;
    }
    let (first, last) = (merge(&blocks[..third]), merge(&blocks[blocks.len() - third..]));
    let change = last.mean() - first.mean();
    let variance = (first.variance() + last.variance()).component_mul(colour) / first.count() as f64;
    (3..6)
        .filter(|&c| variance[c] > 0.0)
        .map(|c| change[c] * change[c] / variance[c])
        .sum::<f64>()
        / 15.0
}

/// Median statistic of the windows inside a rest.
fn unsteadiness(blocks: &Range<usize>, statistic: &[f64]) -> f64 {
    let windows = blocks.start..(blocks.end + 1).saturating_sub(WINDOW_BLOCKS).max(blocks.start + 1);
    median(&mut statistic[windows].to_vec())
}

/// By how much the variance of a mean exceeds that of white noise: half the mean squared difference of neighbouring
/// 0.25 s means (an Allan variance) over what the scatter of single samples predicts.
fn colour_factor(blocks: &[Block], rests: &[Range<usize>]) -> Vector6<f64> {
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
    sum.map(|total| {
        if count >= 20.0 && total > 0.0 {
            total / count
        } else {
            1.0
        }
    })
}

fn rest(recording: &Recording<'_>, blocks: &[Block], first_block: usize, colour: &Vector6<f64>) -> Rest {
    let sum = merge(blocks);
    let block_samples = blocks.first().map_or(0, Block::count);
    let first = first_block * block_samples;
    let end = first + sum.count();
    let mean = sum.mean();
    let variance_of_mean = sum.variance().component_mul(colour) / sum.count() as f64;
    let triad = |offset: usize| RestMean {
        mean: mean.fixed_rows::<3>(offset).into_owned(),
        variance_of_mean: variance_of_mean.fixed_rows::<3>(offset).into_owned(),
    };
    Rest {
        first,
        end,
        start_s: recording.time_s[first],
        end_s: recording.time_s[end - 1],
        unsteadiness: 1.0,
        angular_rate: triad(0),
        specific_force: triad(3),
    }
}
