//! Rest detection while samples come in, with fixed memory.
//!
//! Samples are gathered in short blocks; a window is the last few blocks. A window is still when
//!
//! ```text
//! statistic = 1/6 sum_c variance_c / noise_variance_c  <  threshold
//! ```
//!
//! over the six channels ([`rest_statistic`]). Windows move on by one block, and a rest is all blocks that still windows
//! cover, as far as these overlap. The first and the last block of a rest may hold the end of one move or the start of
//! the next without betraying it: these two are trimmed, and never enter the means.
//!
//! Detection works on raw or on corrected samples, in any unit that the noise variances share. It counts samples and
//! knows no time: after a gap call [`RestDetector::finish`].

mod block;

pub use block::{BlockSums, rest_statistic, statistic_of};

use core::{error::Error, fmt};
use nalgebra::{RealField, Vector3, Vector6};

/// Most blocks that a window can have; it fixes the detector's memory.
pub const MAX_WINDOW_BLOCKS: usize = 10;

/// What [`RestDetector`] takes for a rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RestDetectorConfig<F: RealField + Copy> {
    /// Samples in a block, at least 1. A tenth of a window is usual.
    pub block_samples: usize,
    /// Blocks in a window, 3 to [`MAX_WINDOW_BLOCKS`]. A rest must be this long to be seen.
    pub window_blocks: usize,
    /// Variance of one sample at rest: rate x, y, z, then force x, y, z, in the samples' units squared.
    pub noise_variance: Vector6<F>,
    /// A window is still below this many times the noise floor; 2 to 10 is usual.
    pub threshold: F,
}

/// A stretch in which the unit lay still, one block trimmed at either end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rest<F: RealField + Copy> {
    /// Number of the first sample; the first sample ever pushed is 0.
    pub first_sample: usize,
    /// Number of the sample after the last one.
    pub end_sample: usize,
    /// Mean rate, in the unit of the samples.
    pub mean_rate: Vector3<F>,
    /// Mean force, in the unit of the samples.
    pub mean_force: Vector3<F>,
}

/// Finds rests in a stream of samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RestDetector<F: RealField + Copy> {
    config: RestDetectorConfig<F>,
    /// Number of the first sample of block 0.
    start_sample: usize,
    /// The block that is being filled.
    filling: BlockSums<F>,
    /// How many blocks are full.
    blocks: usize,
    /// The last full blocks: block k stands at k modulo the window's length.
    ring: [BlockSums<F>; MAX_WINDOW_BLOCKS],
    open: Option<OpenRest<F>>,
}

/// A rest that may still grow. `sums` holds its blocks but the first and the last.
#[derive(Clone, Copy, Debug, PartialEq)]
struct OpenRest<F: RealField + Copy> {
    first_block: usize,
    end_block: usize,
    sums: BlockSums<F>,
}

impl<F: RealField + Copy> RestDetector<F> {
    /// A detector that has seen no sample.
    ///
    /// # Errors
    /// [`RestConfigError`] names the value that cannot be used.
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
            open: None,
        })
    }

    /// Takes one sample, and gives the rest that is over, about one window after its end.
    #[inline]
    pub fn push(&mut self, rate: Vector3<F>, force: Vector3<F>) -> Option<Rest<F>> {
        self.filling.push(rate, force);
        if self.filling.count() < self.config.block_samples {
            return None;
        }
        self.ring[self.blocks % self.config.window_blocks] = self.filling;
        self.filling = BlockSums::new();
        self.blocks += 1;
        self.judge_window()
    }

    /// Whether the last full window was still.
    pub fn is_still(&self) -> bool {
        self.open.is_some_and(|rest| rest.end_block == self.blocks)
    }

    /// Ends the stream, or a part of it before a gap, and gives the rest that was going on. Sample numbers run on.
    pub fn finish(&mut self) -> Option<Rest<F>> {
        let last = self.close();
        self.start_sample += self.blocks * self.config.block_samples + self.filling.count();
        self.filling = BlockSums::new();
        self.blocks = 0;
        last
    }

    fn judge_window(&mut self) -> Option<Rest<F>> {
        let length = self.config.window_blocks;
        let window_start = self.blocks.checked_sub(length)?;
        let mut window = BlockSums::new();
        (window_start..self.blocks).for_each(|block| window.merge(&self.ring[block % length]));

        // A NaN is not below the threshold, so it ends a rest and enters no mean.
        if rest_statistic(&window, &self.config.noise_variance) < self.config.threshold {
            self.extend_rest(window_start);
            None
        } else if self.open.is_some_and(|rest| window_start + 2 > rest.end_block) {
            // The next window will not overlap this rest any more.
            self.close()
        } else {
            None
        }
    }

    /// Lets the rest, or a new one, reach to the end of the still window that starts at block `window_start`.
    fn extend_rest(&mut self, window_start: usize) {
        let rest = self.open.get_or_insert(OpenRest {
            first_block: window_start,
            end_block: window_start + 2,
            sums: BlockSums::new(),
        });
        // The last block of the rest so far was held back as its end; as the window overlaps it, the ring still has it.
        for block in rest.end_block - 1..self.blocks - 1 {
            rest.sums.merge(&self.ring[block % self.config.window_blocks]);
        }
        rest.end_block = self.blocks;
    }

    fn close(&mut self) -> Option<Rest<F>> {
        let rest = self.open.take()?;
        let sample_of = |block: usize| self.start_sample + block * self.config.block_samples;
        let mean = rest.sums.mean();
        Some(Rest {
            first_sample: sample_of(rest.first_block + 1),
            end_sample: sample_of(rest.end_block - 1),
            mean_rate: mean.fixed_rows::<3>(0).into(),
            mean_force: mean.fixed_rows::<3>(3).into(),
        })
    }
}

/// Why a [`RestDetectorConfig`] cannot be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum RestConfigError {
    /// A block has no samples.
    BlockSamples,
    /// A window has too few or too many blocks.
    WindowBlocks {
        /// How many were asked for.
        given: usize,
    },
    /// A noise variance is zero, negative or not finite.
    NoiseVariance {
        /// Its index in `noise_variance`.
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
            Self::Threshold => f.write_str("threshold is not a positive number: give 2 to 10 times the noise floor"),
        }
    }
}

impl Error for RestConfigError {}

#[cfg(test)]
mod tests;
