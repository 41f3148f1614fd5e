//! Detects rests in a stream of samples, with fixed memory.
//!
//! Samples are summed in short blocks, and a window consists of the last few blocks. The six channels are the three
//! components of the rate and of the force. A window is still if its rest statistic ([`rest_statistic`]) is below a
//! threshold:
//!
//! ```text
//! statistic = (1 / 6) sum_c (variance_c / noise_variance_c)  <  threshold
//! ```
//!
//! The index c denotes the channel. Consecutive windows are one block apart. A rest consists of all blocks of still
//! windows that overlap each other. The first block of a rest may contain the end of the previous move, and the last
//! block may contain the start of the next move, even if the statistic is below the threshold. These two blocks are
//! trimmed and do not contribute to the means.
//!
//! Samples may be raw or corrected, in any unit. The noise variances must be in the square of this unit. The detector
//! counts samples and does not know their times, so call [`RestDetector::finish`] at a gap in the data. Sample indices
//! wrap around at `usize::MAX`. On a 32-bit processor this happens after 49 days at 1 kHz.

mod block;

pub use block::{BlockSums, rest_statistic, statistic_of};

use core::{error::Error, fmt};
use nalgebra::{RealField, Vector3, Vector6};

/// Maximum number of blocks in a window. The memory of the detector is proportional to this number.
pub const MAX_WINDOW_BLOCKS: usize = 10;

/// Settings of a [`RestDetector`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RestDetectorConfig<F: RealField + Copy> {
    /// Number of samples in a block, at least 1. It is usually a tenth of the number of samples in a window.
    pub block_samples: usize,
    /// Number of blocks in a window, 3 to [`MAX_WINDOW_BLOCKS`]. Rests shorter than a window are not detected.
    pub window_blocks: usize,
    /// Variance of a single sample at rest, in squared units of the samples: rate x, y, z, then force x, y, z.
    pub noise_variance: Vector6<F>,
    /// Threshold of the rest statistic, dimensionless. A window is still if its statistic is below the threshold. With
    /// noise only, the statistic is 1 on average. Usual thresholds are 2 to 10.
    pub threshold: F,
}

/// An interval in which the unit was at rest, with one block trimmed at each end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rest<F: RealField + Copy> {
    /// Index of the first sample of the rest. The first sample pushed into the detector has index 0.
    pub first_sample: usize,
    /// Index of the last sample of the rest plus one.
    pub end_sample: usize,
    /// Mean rate, in the unit of the samples.
    pub mean_rate: Vector3<F>,
    /// Mean force, in the unit of the samples.
    pub mean_force: Vector3<F>,
}

/// Detects rests in a stream of samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RestDetector<F: RealField + Copy> {
    config: RestDetectorConfig<F>,
    /// Index of the first sample of block 0.
    start_sample: usize,
    /// Sums of the current, incomplete block.
    filling: BlockSums<F>,
    /// Number of complete blocks since `start_sample`.
    blocks: usize,
    /// Ring buffer with the sums of the blocks of the last window. Only the first `window_blocks` entries are used.
    ring: [BlockSums<F>; MAX_WINDOW_BLOCKS],
    /// Index of the oldest block in the ring buffer. The next complete block replaces it.
    oldest: usize,
    open: Option<OpenRest<F>>,
}

/// A rest that may still become longer. `sums` contains the sums over all blocks of the rest except the first and the
/// last.
#[derive(Clone, Copy, Debug, PartialEq)]
struct OpenRest<F: RealField + Copy> {
    first_block: usize,
    end_block: usize,
    sums: BlockSums<F>,
}

impl<F: RealField + Copy> RestDetector<F> {
    /// A detector without samples.
    ///
    /// # Errors
    /// [`RestConfigError`] states which value of the configuration cannot be used.
    pub fn try_new(config: RestDetectorConfig<F>) -> Result<Self, RestConfigError> {
        let positive = |x: &F| x.is_finite() && *x > F::zero();
        if config.block_samples == 0 {
            return Err(RestConfigError::BlockSamples);
        }
        if !(3..=MAX_WINDOW_BLOCKS).contains(&config.window_blocks) {
            return Err(RestConfigError::WindowBlocks { given: config.window_blocks });
        }
        if let Some(channel) = config.noise_variance.iter().position(|v| !positive(v)) {
            return Err(RestConfigError::NoiseVariance { channel });
        }
        if !positive(&config.threshold) {
            return Err(RestConfigError::Threshold);
        }
        Ok(Self {
            config,
            start_sample: 0,
            filling: BlockSums::new(),
            blocks: 0,
            ring: [BlockSums::new(); MAX_WINDOW_BLOCKS],
            oldest: 0,
            open: None,
        })
    }

    /// Adds one sample. When a rest is complete, the function returns it. A rest is complete about one window after its
    /// end.
    #[inline]
    pub fn push(&mut self, rate: Vector3<F>, force: Vector3<F>) -> Option<Rest<F>> {
        self.filling.push(rate, force);
        if self.filling.count() < self.config.block_samples {
            return None;
        }
        if let Some(place) = self.ring.get_mut(self.oldest) {
            *place = self.filling;
        }
        self.oldest = if self.oldest + 1 < self.config.window_blocks { self.oldest + 1 } else { 0 };
        self.filling = BlockSums::new();
        self.blocks = self.blocks.wrapping_add(1);
        self.judge_window()
    }

    /// Whether the last complete window was still, which means that its rest statistic was below the threshold.
    pub fn is_still(&self) -> bool {
        self.open.is_some_and(|rest| rest.end_block == self.blocks)
    }

    /// Ends the stream, or the part of the stream before a gap in the data. Returns the rest in progress, if there is
    /// one. After a gap, sample indices continue from the last index.
    pub fn finish(&mut self) -> Option<Rest<F>> {
        let last = self.close();
        let samples = self.blocks.wrapping_mul(self.config.block_samples).wrapping_add(self.filling.count());
        self.start_sample = self.start_sample.wrapping_add(samples);
        self.filling = BlockSums::new();
        self.blocks = 0;
        self.oldest = 0;
        last
    }

    /// The blocks of the last window, oldest first.
    fn window(&self) -> impl Iterator<Item = &BlockSums<F>> {
        let newer = self.ring.get(..self.oldest).unwrap_or_default();
        let older = self.ring.get(self.oldest..self.config.window_blocks).unwrap_or_default();
        older.iter().chain(newer)
    }

    fn judge_window(&mut self) -> Option<Rest<F>> {
        let length = self.config.window_blocks;
        let window_start = self.blocks.checked_sub(length)?;
        let mut window = BlockSums::new();
        for block in self.window() {
            window.merge(block);
        }

        // NaN is not below the threshold. A NaN in a sample therefore ends the rest and does not contribute to the
        // means.
        if rest_statistic(&window, &self.config.noise_variance) < self.config.threshold {
            self.extend_rest(window_start);
            None
        } else if self.open.is_some_and(|rest| window_start.wrapping_add(2) > rest.end_block) {
            // No later window can overlap the current rest, so the rest is complete.
            self.close()
        } else {
            None
        }
    }

    /// Adds the still window that starts at block `window_start` to the current rest, or starts a new rest with it.
    fn extend_rest(&mut self, window_start: usize) {
        let mut rest = self.open.unwrap_or(OpenRest {
            first_block: window_start,
            end_block: window_start.wrapping_add(2),
            sums: BlockSums::new(),
        });
        // The last block of a rest is trimmed and is therefore not in the sums. If the rest is extended, its previous
        // last block is no longer trimmed and must be added to the sums. The ring buffer still contains this block,
        // because the new window overlaps the rest.
        let mut block = window_start;
        for sums in self.window() {
            if block.wrapping_add(1) >= rest.end_block && block.wrapping_add(1) < self.blocks {
                rest.sums.merge(sums);
            }
            block = block.wrapping_add(1);
        }
        rest.end_block = self.blocks;
        self.open = Some(rest);
    }

    fn close(&mut self) -> Option<Rest<F>> {
        let rest = self.open.take()?;
        let sample_of = |block: usize| self.start_sample.wrapping_add(block.wrapping_mul(self.config.block_samples));
        let mean = rest.sums.mean();
        Some(Rest {
            first_sample: sample_of(rest.first_block.wrapping_add(1)),
            end_sample: sample_of(rest.end_block.wrapping_sub(1)),
            mean_rate: Vector3::new(mean.x, mean.y, mean.z),
            mean_force: Vector3::new(mean.w, mean.a, mean.b),
        })
    }
}

/// Reasons why a [`RestDetectorConfig`] cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum RestConfigError {
    /// The number of samples in a block is zero.
    BlockSamples,
    /// The number of blocks in a window is too small or too large.
    WindowBlocks {
        /// Number of blocks requested.
        given: usize,
    },
    /// A noise variance is zero, negative or not finite.
    NoiseVariance {
        /// Index of the channel in `noise_variance`.
        channel: usize,
    },
    /// The threshold is zero, negative or not finite.
    Threshold,
}

impl fmt::Display for RestConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::BlockSamples => f.write_str("block_samples is 0: a block needs at least one sample"),
            Self::WindowBlocks { given } => {
                write!(
                    f,
                    "window_blocks is {given}: give 3 to {MAX_WINDOW_BLOCKS}, and longer blocks for a longer window"
                )
            }
            Self::NoiseVariance { channel } => {
                write!(f, "noise_variance[{channel}] is not a positive number: give the channel's variance at rest")
            }
            Self::Threshold => f.write_str("threshold is not a positive number: give a number from 2 to 10"),
        }
    }
}

impl Error for RestConfigError {}

#[cfg(test)]
mod tests;
