//! How still a rest is: on something firm or in a hand.

use std::ops::Range;

use nalgebra::{Vector3, Vector6};

use super::WINDOW_BLOCKS;
use super::blocks::{Block, Colour, mean, merge};
use crate::numerics::stats::median;
use crate::rests::rest::UNSTEADY;

/// A rest and what its blocks say of it.
#[derive(Clone)]
pub(super) struct Stretch {
    pub(super) blocks: Range<usize>,
    /// Sums of all its samples.
    pub(super) whole: Block,
    /// Those of the first and the last third, if there are so many blocks.
    thirds: Option<[Block; 2]>,
    /// Median statistic of its windows.
    scatter: f64,
    colour: Colour,
}

impl Stretch {
    pub(super) fn of(range: &Range<usize>, blocks: &[Block], statistic: &[f64]) -> Self {
        let own = &blocks[range.clone()];
        let third = own.len() / 3;
        let parts = [&own[..third], &own[third..own.len() - third], &own[own.len() - third..]].map(merge);
        let whole = merge(&parts);
        Self {
            blocks: range.clone(),
            thirds: (third > 0).then_some([parts[0], parts[2]]),
            scatter: unsteadiness(range, statistic),
            colour: Colour::of(own, &whole.variance()),
            whole,
        }
    }

    /// Whether it is without tremor.
    pub(super) fn is_steady(&self) -> bool {
        self.scatter < UNSTEADY
    }

    /// Change of gravity from the first to the last third of a rest over what noise explains at most (chi2 / 15, so that
    /// noise alone exceeds 2 once in 10^6 rests).
    fn drift(&self, colour: &Vector6<f64>) -> f64 {
        let Some([first, last]) = &self.thirds else { return 0.0 };
        let change = last.mean() - first.mean();
        let variance = (first.variance() + last.variance()).component_mul(colour) / first.count() as f64;
        (3..6).filter(|&c| variance[c] > 0.0).map(|c| change[c] * change[c] / variance[c]).sum::<f64>() / 15.0
    }
}

/// Colour of the noise that the rests of a recording have in common. A table and a hand have noise of different kinds.
pub(super) struct Steadiness {
    /// That of rests without tremor, and of all others.
    pub(super) steady_colour: Vector6<f64>,
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

    /// Colour of the noise in a rest.
    pub(super) fn colour(&self, rest: &Stretch) -> &Vector6<f64> {
        if rest.is_steady() { &self.steady_colour } else { &self.held_colour }
    }

    /// See [`Rest::unsteadiness`](super::Rest::unsteadiness).
    pub(super) fn unsteadiness(&self, rest: &Stretch) -> f64 {
        rest.scatter.max(rest.drift(self.colour(rest)))
    }

    /// Variance of one sample of white noise with the same density at low frequency as in the steady rests; `None` without any.
    pub(super) fn noise_variance(&self, rests: &[Stretch]) -> Option<Vector6<f64>> {
        let variances: Vec<Vector6<f64>> =
            rests.iter().filter(|rest| rest.is_steady()).map(|rest| rest.whole.variance()).collect();
        let typical =
            |channel: usize| median(&mut variances.iter().map(|variance| variance[channel]).collect::<Vec<f64>>());
        (!variances.is_empty()).then(|| Vector6::from_fn(|channel, _| typical(channel) * self.steady_colour[channel]))
    }
}

/// Median statistic of the windows inside a rest.
pub(super) fn unsteadiness(blocks: &Range<usize>, statistic: &[f64]) -> f64 {
    // Where the record ends with a stretch of one window, what is left of it when its ends are cut starts behind the last.
    let first = blocks.start.min(statistic.len().saturating_sub(1));
    let end = (blocks.end + 1).saturating_sub(WINDOW_BLOCKS).max(first + 1).min(statistic.len());
    median(&mut statistic[first..end].to_vec())
}

/// Whether gravity goes astray by more than 5 % of `size` (3 deg) within a rest: an even tumble has no quieter windows
/// to be told from, but no rest either.
pub(super) fn wanders(blocks: &[Block], size: f64) -> bool {
    let force = |blocks: &[Block]| -> Vector3<f64> { mean(blocks).fixed_rows::<3>(3).into() };
    let whole = force(blocks);
    blocks.chunks_exact(WINDOW_BLOCKS).any(|window| (force(window) - whole).norm() > 0.05 * size)
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
