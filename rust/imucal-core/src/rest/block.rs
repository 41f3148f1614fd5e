//! Computes the mean and the variance of a block of samples from running sums, for rest detection on a device and on a
//! PC.

use nalgebra::{RealField, Vector3, Vector6, convert};

/// Count, mean and variance of consecutive samples, per channel: rate x, y, z, then force x, y, z.
///
/// The sums are formed over the differences between each sample and the first sample. The variance is therefore
/// accurate even if the samples have a large offset, for example gravity, or unsigned counts around 32768 in f32. The
/// sums of two intervals can be merged:
///
/// ```
/// use imucal_core::rest::BlockSums;
/// use nalgebra::Vector3;
///
/// // Unsigned 16-bit counts of the rate about x. All other channels are zero.
/// let mut first = BlockSums::new();
/// first.push(Vector3::new(32768.0_f32, 0.0, 0.0), Vector3::zeros());
/// first.push(Vector3::new(32770.0, 0.0, 0.0), Vector3::zeros());
/// let mut second = BlockSums::new();
/// second.push(Vector3::new(32772.0, 0.0, 0.0), Vector3::zeros());
/// first.merge(&second);
/// assert_eq!((first.count(), first.mean()[0], first.variance()[0]), (3, 32770.0, 4.0));
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BlockSums<F: RealField + Copy> {
    count: usize,
    origin: Vector6<F>,
    sum: Vector6<F>,
    squares: Vector6<F>,
}

impl<F: RealField + Copy> BlockSums<F> {
    /// Sums of zero samples.
    pub fn new() -> Self {
        let o = F::zero();
        let zeros = Vector6::new(o, o, o, o, o, o);
        Self { count: 0, origin: zeros, sum: zeros, squares: zeros }
    }

    /// Adds one sample. All samples must be in the same unit. Any unit is permitted.
    #[inline]
    pub fn push(&mut self, rate: Vector3<F>, force: Vector3<F>) {
        let sample = Vector6::new(rate.x, rate.y, rate.z, force.x, force.y, force.z);
        if self.count == 0 {
            self.origin = sample;
        }
        self.count = self.count.wrapping_add(1);
        let offset = both(&sample, &self.origin, |x, origin| x - origin);
        self.sum = both(&self.sum, &offset, |sum, x| sum + x);
        self.squares = both(&self.squares, &offset, |squares, x| squares + x * x);
    }

    /// Adds all samples of another interval.
    #[inline]
    pub fn merge(&mut self, other: &Self) {
        if self.count == 0 {
            *self = *other;
            return;
        }
        let count = number::<F>(other.count);
        let shift = both(&other.origin, &self.origin, |other, own| other - own);
        let shifted_sum = both(&other.sum, &shift, |_, shift| shift * count);
        let cross = both(&other.sum, &shifted_sum, |sum, shifted| sum + sum + shifted);
        let added = both(&other.squares, &both(&shift, &cross, |shift, cross| shift * cross), |squares, x| squares + x);
        self.squares = both(&self.squares, &added, |squares, x| squares + x);
        self.sum = both(&self.sum, &both(&other.sum, &shifted_sum, |sum, x| sum + x), |sum, x| sum + x);
        self.count = self.count.wrapping_add(other.count);
    }

    /// Number of samples.
    #[inline]
    pub fn count(&self) -> usize {
        self.count
    }

    /// Mean of each channel, in the unit of the samples; NaN without samples.
    #[inline]
    pub fn mean(&self) -> Vector6<F> {
        let count = number::<F>(self.count);
        both(&self.origin, &self.sum, |origin, sum| origin + sum / count)
    }

    /// Unbiased variance of each channel, in squared units of the samples; NaN with fewer than two samples.
    #[inline]
    pub fn variance(&self) -> Vector6<F> {
        let count = number::<F>(self.count);
        both(&self.squares, &self.sum, |squares, sum| {
            let about_mean = squares - sum * sum / count;
            // Rounding can make the sum of squares about the mean of a constant channel slightly negative. It is then
            // set to zero. The comparison leaves NaN unchanged, so that a NaN sample gives a NaN variance.
            (if about_mean < F::zero() { F::zero() } else { about_mean }) / (count - F::one())
        })
    }
}

impl<F: RealField + Copy> Default for BlockSums<F> {
    fn default() -> Self {
        Self::new()
    }
}

/// Rest statistic of a window: the mean of variance / noise variance over the six channels. It is near 1 at rest and
/// large in a move.
///
/// ```text
/// statistic = (1 / 6) sum_c (variance_c / noise_variance_c)
/// ```
///
/// `noise_variance` contains the variance of a single sample at rest for each channel, in squared units of the samples.
/// The result is NaN if a sample is NaN.
#[inline]
pub fn rest_statistic<F: RealField + Copy>(window: &BlockSums<F>, noise_variance: &Vector6<F>) -> F {
    statistic_of(&window.variance(), noise_variance)
}

/// Computes the [`rest_statistic`] of a window whose channels have the given `variance`.
#[inline]
pub fn statistic_of<F: RealField + Copy>(variance: &Vector6<F>, noise_variance: &Vector6<F>) -> F {
    let ratio = both(variance, noise_variance, |variance, noise| variance / noise);
    (ratio.x + ratio.y + ratio.z + ratio.w + ratio.a + ratio.b) / convert(6.0)
}

/// Applies `f` to the two vectors channel by channel. Like the functions of `vector.rs`, it cannot panic at any
/// optimisation level.
#[inline]
fn both<F: RealField + Copy>(a: &Vector6<F>, b: &Vector6<F>, f: impl Fn(F, F) -> F) -> Vector6<F> {
    Vector6::new(f(a.x, b.x), f(a.y, b.y), f(a.z, b.z), f(a.w, b.w), f(a.a, b.a), f(a.b, b.b))
}

#[inline]
fn number<F: RealField + Copy>(count: usize) -> F {
    convert(count as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn samples(offset: f64) -> [Vector3<f64>; 7] {
        [0.3, -1.0, 2.0, 0.0, 1.5, -0.7, 0.9].map(|x: f64| Vector3::new(offset + x, x * x, -x))
    }

    /// Sums samples whose rates are given. The force of each sample is 0.1 times its rate.
    fn sums_of(samples: &[Vector3<f64>]) -> BlockSums<f64> {
        let mut sums = BlockSums::new();
        samples.iter().for_each(|&s| sums.push(s, s * 0.1));
        sums
    }

    #[test]
    fn mean_and_variance_are_those_of_two_passes() {
        let data = samples(40.0);
        let mean = data.iter().sum::<Vector3<f64>>() / 7.0;
        let variance = data.iter().map(|s| (s - mean).component_mul(&(s - mean))).sum::<Vector3<f64>>() / 6.0;
        let sums = sums_of(&data);
        for i in 0..3 {
            assert!((sums.mean()[i] - mean[i]).abs() < 1e-14 * mean[i].abs().max(1.0));
            assert!((sums.variance()[i] - variance[i]).abs() < 1e-14 * variance[i]);
            assert!((sums.variance()[i + 3] - 0.01 * variance[i]).abs() < 1e-15 * variance[i]);
        }
    }

    #[test]
    fn merged_parts_are_the_whole() {
        let data = samples(3.0);
        let whole = sums_of(&data);
        for cut in 0..=data.len() {
            let mut merged = sums_of(&data[..cut]);
            merged.merge(&sums_of(&data[cut..]));
            assert_eq!(merged.count(), whole.count());
            assert!((merged.mean() - whole.mean()).norm() < 1e-15);
            assert!((merged.variance() - whole.variance()).norm() < 1e-14);
        }
    }

    #[test]
    fn a_large_offset_costs_no_digits_in_f32() {
        let (mut near, mut far) = (BlockSums::<f32>::new(), BlockSums::<f32>::new());
        for k in 0..10_000 {
            // Every value is a multiple of 1/4, so it is exact in f32 with and without the offset.
            let x = ((k * 7919) % 41) as f32 * 0.25;
            near.push(Vector3::repeat(x), Vector3::zeros());
            far.push(Vector3::repeat(x + 32768.0), Vector3::zeros());
        }
        assert_eq!(near.variance(), far.variance());
        assert!((near.variance()[0] / 8.75 - 1.0).abs() < 1e-3);
    }

    #[test]
    fn a_constant_channel_has_no_variance_and_a_nan_is_seen() {
        let mut sums = BlockSums::new();
        (0..100).for_each(|_| sums.push(Vector3::repeat(0.1), Vector3::repeat(9.8)));
        assert_eq!(sums.variance(), Vector6::zeros());
        assert_eq!(rest_statistic(&sums, &Vector6::repeat(1.0)), 0.0);
        sums.push(Vector3::repeat(f64::NAN), Vector3::zeros());
        assert!(rest_statistic(&sums, &Vector6::repeat(1.0)).is_nan());
    }

    #[test]
    fn the_statistic_is_the_mean_of_six_ratios() {
        let sums = sums_of(&samples(0.0));
        let floors = sums.variance().component_div(&Vector6::new(1.0, 2.0, 3.0, 4.0, 5.0, 9.0));
        assert!((rest_statistic(&sums, &floors) - 4.0).abs() < 1e-14);
    }
}
