//! Computes the unsteadiness of a rest, a ratio of variances that distinguishes rests on a rigid support from hand-held
//! rests (model.md (11)).

use std::ops::Range;

use nalgebra::{Vector3, Vector6};

use super::WINDOW_BLOCKS;
use super::blocks::{Block, Colour, mean, merge};
use crate::numerics::stats::median;
use crate::rests::rest::UNSTEADY;

/// An interval at rest, with the statistics of its blocks.
#[derive(Clone)]
pub(super) struct Stretch {
    /// Index range of the blocks of the interval.
    pub(super) blocks: Range<usize>,
    /// Sums over all samples of the interval, from which their number, mean and variance are computed.
    pub(super) whole: Block,
    /// Sums over the samples of the first and of the last third of the interval; `None` for fewer than three blocks.
    thirds: Option<[Block; 2]>,
    /// Median of the statistic (variance / noise variance) over all half-second windows of the interval.
    scatter: f64,
    /// Sums from which the factor c of model.md (10) is computed: the factor by which the correlation of the noise
    /// increases the variance of a mean.
    colour: Colour,
    /// Upper bound of the variance of the rounding error of a mean: step^2 / 12, squared raw units. It is zero for
    /// channels whose noise is not below the quantisation step.
    rounding: Vector6<f64>,
}

impl Stretch {
    pub(super) fn of(range: &Range<usize>, blocks: &[Block], statistic: &[f64], coarse: &Vector6<f64>) -> Self {
        let own = &blocks[range.clone()];
        let third = own.len() / 3;
        let parts = [&own[..third], &own[third..own.len() - third], &own[own.len() - third..]].map(merge);
        let whole = merge(&parts);
        Self {
            blocks: range.clone(),
            thirds: (third > 0).then_some([parts[0], parts[2]]),
            scatter: unsteadiness(range, statistic),
            colour: Colour::of(own, &whole.variance()),
            rounding: coarse.map(|step| step * step / 12.0),
            whole,
        }
    }

    /// Whether the samples of the interval scatter so little that they contain no tremor of a hand.
    pub(super) fn is_steady(&self) -> bool {
        self.scatter < UNSTEADY
    }

    /// Drift statistic of a rest: chi2 / 15. chi2 is the squared change of the mean force from the first to the last
    /// third of the rest, divided by the variance that noise and rounding give this change, and summed over the axes.
    /// With the divisor 15, the limit of 2 for the unsteadiness corresponds to chi2 = 30. If a rest contains only
    /// noise, chi2 exceeds 30 with a probability of 1e-6.
    fn drift(&self, colour: &Vector6<f64>) -> f64 {
        let Some([first, last]) = &self.thirds else { return 0.0 };
        let change = last.mean() - first.mean();
        let noise = (first.variance() + last.variance()).component_mul(colour) / first.count() as f64;
        let variance = noise + self.rounding * 2.0;
        (3..6).filter(|&c| variance[c] > 0.0).map(|c| change[c] * change[c] / variance[c]).sum::<f64>() / 15.0
    }
}

/// Maximum deviation of the mean force of a window (half a second) from the mean force of the rest, divided by gravity.
/// 0.05 corresponds to a tilt of 3 deg.
const MAX_TILT: f64 = 0.05;

/// The factors c of a recording, by which the correlation of the noise increases the variance of a mean (model.md
/// (10)). Steady and hand-held rests have separate factors, because their spectra differ.
pub(super) struct Steadiness {
    /// Factor c of each channel, for rests without tremor.
    pub(super) steady_colour: Vector6<f64>,
    /// Factor c of each channel, for hand-held rests.
    held_colour: Vector6<f64>,
}

impl Steadiness {
    pub(super) fn of<'a>(rests: impl Iterator<Item = &'a Stretch>) -> Self {
        let (mut steady, mut held) = (Colour::none(), Colour::none());
        for rest in rests {
            if rest.is_steady() { &mut steady } else { &mut held }.add(&rest.colour);
        }
        Self { steady_colour: steady.factor(), held_colour: held.factor() }
    }

    /// Returns the factors c of the six channels for a rest: the factors for steady rests if the rest is steady,
    /// otherwise the factors for hand-held rests.
    pub(super) fn colour(&self, rest: &Stretch) -> &Vector6<f64> {
        if rest.is_steady() { &self.steady_colour } else { &self.held_colour }
    }

    /// Unsteadiness of a rest, a ratio of variances that is defined at
    /// [`Rest::unsteadiness`](super::Rest::unsteadiness).
    pub(super) fn unsteadiness(&self, rest: &Stretch) -> f64 {
        rest.scatter.max(rest.drift(self.colour(rest)))
    }

    /// Unsteadiness of a rest that is divided into `epochs`, each with its own mean. It is the median of the
    /// unsteadiness of the epochs. The unsteadiness of the whole rest is not used, because drifting biases change the
    /// mean force during a long rest. If `epochs` is empty, the result is [`unsteadiness`](Self::unsteadiness).
    pub(super) fn unsteadiness_of(&self, rest: &Stretch, epochs: &[Stretch]) -> f64 {
        if epochs.is_empty() {
            return self.unsteadiness(rest);
        }
        median(&mut epochs.iter().map(|epoch| self.unsteadiness(epoch)).collect::<Vec<f64>>())
    }

    /// Noise variance of each channel, computed from the steady rests: the variance of a sample of white noise that has
    /// the same density as the measured noise at low frequencies. `None` if there are no steady rests.
    pub(super) fn noise_variance<'a>(&self, rests: impl Iterator<Item = &'a Stretch>) -> Option<Vector6<f64>> {
        let variances: Vec<Vector6<f64>> =
            rests.filter(|rest| rest.is_steady()).map(|rest| rest.whole.variance()).collect();
        let typical =
            |channel: usize| median(&mut variances.iter().map(|variance| variance[channel]).collect::<Vec<f64>>());
        (!variances.is_empty()).then(|| Vector6::from_fn(|channel, _| typical(channel) * self.steady_colour[channel]))
    }
}

/// Median of the window statistic (variance / noise variance) over all windows that are completely inside a rest.
pub(super) fn unsteadiness(blocks: &Range<usize>, statistic: &[f64]) -> f64 {
    // `trim` may have shortened the interval at both ends. A short interval at the end of the recording may then start
    // later than the last window. In this case, the last window is used.
    let first = blocks.start.min(statistic.len().saturating_sub(1));
    let end = (blocks.end + 1).saturating_sub(WINDOW_BLOCKS).max(first + 1).min(statistic.len());
    median(&mut statistic[first..end].to_vec())
}

/// Whether the mean force of any window deviates from the mean force of the interval by more than 5 % of gravity (3
/// deg). `size` is the magnitude of gravity. This check prevents a uniform tumble from being detected as a rest. The
/// window statistic of a uniform tumble is low if the recording contains no quieter windows.
///
/// In a rest of more than `long` blocks, accelerometer drift may exceed this limit. Each part of `long` blocks is
/// therefore compared with its own mean. Over the whole rest, a deviation of three times this limit (15 % of gravity)
/// is permitted.
pub(super) fn gravity_wanders(blocks: &[Block], size: f64, long: usize) -> bool {
    let force = |blocks: &[Block]| -> Vector3<f64> { mean(blocks).fixed_rows::<3>(3).into() };
    let exceeds = |blocks: &[Block], share: f64| {
        let whole = force(blocks);
        blocks.chunks_exact(WINDOW_BLOCKS).any(|window| (force(window) - whole).norm() > share * size)
    };
    if blocks.len() <= long {
        return exceeds(blocks, MAX_TILT);
    }
    exceeds(blocks, 3.0 * MAX_TILT) || blocks.chunks(long).any(|part| exceeds(part, MAX_TILT))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rest_that_ends_with_the_record_may_be_shorter_than_a_window() {
        let statistic = [1.0, 2.0, 3.0];
        assert_eq!(unsteadiness(&(1..13), &statistic), 2.5);
        assert_eq!(unsteadiness(&(3..12), &statistic), 3.0);
    }
}
