//! Detects steps and drifts of the mean reading of a unit at rest. The likelihood distinguishes steps and drifts from
//! random noise (section (36) of `docs/model.md`).
//!
//! ```text
//! z_j = sum over components of a_c s_cj + noise,     noise ~ N(0, mu_j(theta)),     j = 1 to W - 1
//! ```
//!
//! The record is divided into W blocks, and z is the cosine transform of the means over these blocks. The elements z_j
//! are uncorrelated for white noise and for a random walk. a_c is the amplitude of component c, s_cj is element j of
//! the cosine transform of its shape, and mu_j is the expected power for the noise parameters theta. A component is an
//! abrupt step, a ramp between two times, or an exponential approach to a final value (warm-up). A step has the power
//! spectrum of a random walk. However, the time of a step determines the signs of its z_j, whereas the z_j of a random
//! walk have random signs. Components are added one after the other. Each time, the component with the largest
//! difference (gain - penalty) is added. The gain is the increase of 2 ln L, where L is the likelihood. The penalty
//! accounts for the number of shapes that are tried. After each addition, all amplitudes and the noise parameters are
//! estimated again. The search ends if the largest difference (gain - penalty) is below 16, because noise then explains
//! the remaining changes of the mean. It also ends if 12 components have been added.

mod search;

use std::f64::consts::PI;

use search::Search;

use super::cosines::expected_powers;
use super::power_law::{KINDS, PerKind};

/// Maximum number of blocks into which a record is divided. More blocks would make the time of a step more accurate,
/// but the computing time grows with the square of the number of blocks.
const MAX_BLOCKS: usize = 1024;
/// Minimum number of blocks. With fewer blocks, steps cannot be distinguished from noise, so no search takes place.
const MIN_BLOCKS: usize = 64;
/// The search tries warm-ups with these time constants, in units of the duration of the record. The last time constant
/// is so long that the mean changes at a constant rate.
const TIME_CONSTANTS: [f64; 9] = [0.02, 0.04, 0.08, 0.15, 0.3, 0.6, 1.2, 2.5, LINEAR];
/// Ratio of the time constant to the duration of the record, for a warm-up whose rate of change is practically
/// constant.
const LINEAR: f64 = 1e3;
/// If a change of the mean takes at most this time, it is treated as a step, s. After a bump, a unit settles within
/// this time. Warm-up always takes longer.
pub(super) const ABRUPT_S: f64 = 10.0;
/// If a change of the mean takes at most this number of blocks, it is also treated as a step, even if it takes longer
/// than `ABRUPT_S`. The reason is that the block means do not resolve such a short change.
const ABRUPT_BLOCKS: usize = 2;

/// Shape of a component (a step or a drift of the mean).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Shape {
    /// A step of the mean at the time `first` + `fraction`, in blocks. `fraction` is between 0 and 1.
    Step { first: usize, fraction: f64 },
    /// A change of the mean at a constant rate, which starts at block `first` and takes `blocks` blocks.
    Ramp { first: usize, blocks: usize },
    /// Exponential approach of the mean to a final value, with the time constant in blocks.
    WarmUp { time_constant: f64 },
}

/// A step or a drift of one axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Component {
    pub(super) shape: Shape,
    /// Change of the mean, in the unit of the samples.
    pub(super) size: f64,
    /// Standard deviation of the error of `size`.
    pub(super) sigma: f64,
    /// Increase of 2 ln L when this component is added to the model, where L is the likelihood.
    pub(super) gain: f64,
}

/// Division of a record of given length into blocks of equal length, with the expected powers of the cosine transform
/// of the block means. All axes use the same blocks.
pub(super) struct Blocks {
    /// Number of samples in a block.
    pub(super) samples: usize,
    /// Number of blocks.
    count: usize,
    /// Expected power of element j of the cosine transform of the block means, for j = 1, 2, ...
    expected: Vec<PerKind>,
    /// `sin(pi k / (2 W))` for k from 0 to 4 W, where W is the number of blocks.
    sines: Vec<f64>,
    /// The warm-ups that the search tries, each with its cosine transform.
    warm_ups: Vec<(Shape, Vec<f64>)>,
}

/// Noise model of an axis in the search: the kinds of noise, the variance of the rounding error of a sample, and the
/// number of octaves omitted at the highest frequencies.
#[derive(Clone, Copy, Debug)]
pub(super) struct NoiseModel {
    pub(super) kinds: [bool; KINDS],
    pub(super) rounding: f64,
    pub(super) filtered: u32,
}

impl Blocks {
    /// Divides a record of `samples` samples into blocks; `None` if the record has fewer than [`MIN_BLOCKS`] samples.
    pub(super) fn try_new(samples: usize) -> Option<Self> {
        let length = samples.div_ceil(MAX_BLOCKS).max(1);
        let count = samples / length;
        if count < MIN_BLOCKS {
            return None;
        }
        let sines = (0..=4 * count).map(|k| (PI * k as f64 / (2.0 * count as f64)).sin()).collect();
        let mut blocks = Self {
            samples: length,
            count,
            expected: expected_powers(length as f64, count),
            sines,
            warm_ups: Vec::new(),
        };
        let warm_up = |share: &f64| {
            let time_constant = share * count as f64;
            // The shape increases from 0 to 1, so the amplitude of the component is the change of the mean over the
            // record.
            let end = 1.0 - (-(count as f64) / time_constant).exp();
            let values = (0..count).map(|t| (1.0 - (-(t as f64 + 0.5) / time_constant).exp()) / end);
            (Shape::WarmUp { time_constant }, blocks.cosines(&values.collect::<Vec<_>>()))
        };
        let warm_ups = TIME_CONSTANTS.iter().map(warm_up).collect();
        blocks.warm_ups = warm_ups;
        Some(blocks)
    }

    /// Detects steps and drifts in the record `values`. Returns them in the order in which the search adds them.
    /// `values` must have as many samples as the record for which the blocks were created. `rate_hz` converts durations
    /// to seconds, for the comparison with `ABRUPT_S`.
    pub(super) fn components(
        &self,
        values: impl Iterator<Item = f64>,
        noise: &NoiseModel,
        rate_hz: f64,
    ) -> Vec<Component> {
        let z = self.cosines(&self.means(values));
        let search = Search { blocks: self, z: &z, noise, shapes: self.shapes(rate_hz) };
        search.run()
    }

    fn means(&self, values: impl Iterator<Item = f64>) -> Vec<f64> {
        let mut values = values;
        let mean = |_| {
            let sum: f64 = values.by_ref().take(self.samples).sum();
            sum / self.samples as f64
        };
        (0..self.count).map(mean).collect()
    }

    /// Cosine transform z of a window y of W values:
    /// `z_j = sqrt(2 / W) sum over t = 0 to W - 1 of y_t cos(pi j (t + 1/2) / W)` for j = 1 to W - 1.
    fn cosines(&self, window: &[f64]) -> Vec<f64> {
        let width = self.count;
        let origin = window.first().copied().unwrap_or(0.0);
        let scale = (2.0 / width as f64).sqrt();
        (1..width)
            .map(|j| {
                // The table contains sines in steps of pi / (2 W), with W = `width`. Because cos(a) = sin(a + pi / 2),
                // the cosine of an angle is W steps further in the table than its sine.
                let mut at = (j + width) % (4 * width);
                let mut sum = 0.0;
                for value in window {
                    sum += (value - origin) * self.sines[at];
                    at = (at + 2 * j) % (4 * width);
                }
                scale * sum
            })
            .collect()
    }

    /// Element j of the cosine transform of a change from 0 to 1. The change starts at block `first` and takes `blocks`
    /// blocks.
    fn change(&self, j: usize, first: usize, blocks: usize) -> f64 {
        let width = self.count;
        let scale = (2.0 / width as f64).sqrt();
        let half_sine = self.sines[j];
        if blocks <= 1 {
            return -scale * self.sines[(2 * j * first) % (4 * width)] / (2.0 * half_sine);
        }
        // The change is a sum of equal steps at `first`, `first + 1`, ... The transform of each step contains a sine,
        // and the sum of these sines is a difference of two cosines (closed form).
        let cosine = |half_steps: usize| self.sines[(j * half_steps + width) % (4 * width)];
        let difference = cosine(2 * first - 1) - cosine(2 * (first + blocks) - 1);
        -scale * difference / (4.0 * half_sine * half_sine * blocks as f64)
    }

    /// Cosine transform of a shape of size 1: its elements for j = 1 to W - 1, where W is the number of blocks.
    fn column(&self, shape: Shape) -> Vec<f64> {
        match shape {
            Shape::Step { first, fraction } => {
                let at =
                    |j: usize| (1.0 - fraction) * self.change(j, first, 1) + fraction * self.change(j, first + 1, 1);
                (1..self.count).map(at).collect()
            }
            Shape::Ramp { first, blocks } => (1..self.count).map(|j| self.change(j, first, blocks)).collect(),
            Shape::WarmUp { .. } => {
                self.warm_ups.iter().find(|(other, _)| *other == shape).map_or_else(Vec::new, |(_, z)| z.clone())
            }
        }
    }

    /// All shapes that the search tries: a step at every block, ramps, and warm-ups. Each length of a ramp is twice the
    /// next shorter length. The start times of two consecutive ramps of the same length differ by a quarter of this
    /// length.
    fn shapes(&self, rate_hz: f64) -> Vec<Shape> {
        let mut shapes: Vec<Shape> = (1..self.count).map(|first| Shape::Step { first, fraction: 0.0 }).collect();
        let mut blocks = self.abrupt_blocks(rate_hz) * 2;
        while blocks < self.count {
            let last = self.count - blocks;
            shapes.extend((1..=last).step_by((blocks / 4).max(1)).map(|first| Shape::Ramp { first, blocks }));
            blocks *= 2;
        }
        shapes.extend(self.warm_ups.iter().map(|(shape, _)| *shape));
        shapes
    }

    /// Maximum duration of a change that is treated as a step, in blocks.
    fn abrupt_blocks(&self, rate_hz: f64) -> usize {
        ((ABRUPT_S * rate_hz / self.samples as f64) as usize).max(ABRUPT_BLOCKS)
    }
}

impl Shape {
    /// Whether the shape is a step. All other shapes are drifts.
    fn is_step(self) -> bool {
        matches!(self, Self::Step { .. })
    }

    /// Whether a warm-up with this time constant, in blocks, has a practically constant rate over `blocks` blocks.
    pub(super) fn is_linear(time_constant: f64, blocks: usize) -> bool {
        time_constant > 0.5 * LINEAR * blocks as f64
    }
}
