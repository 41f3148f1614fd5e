//! How still a rest is: on something firm or in a hand.

use std::ops::Range;

use nalgebra::{Vector3, Vector6};

use super::blocks::{Block, colour_factor, merge};
use super::{UNSTEADY, WINDOW_BLOCKS};
use crate::stats::median;

/// What the rests of a recording have in common. A table and a hand have noise of different kinds.
pub(super) struct Steadiness<'a> {
    blocks: &'a [Block],
    statistic: &'a [f64],
    /// Rests without tremor.
    pub(super) steady: Vec<Range<usize>>,
    /// Colour of the noise in them, and in all others.
    pub(super) steady_colour: Vector6<f64>,
    held_colour: Vector6<f64>,
}

impl<'a> Steadiness<'a> {
    pub(super) fn of(blocks: &'a [Block], statistic: &'a [f64], rests: &[Range<usize>]) -> Self {
        let (steady, held): (Vec<_>, Vec<_>) =
            rests.iter().cloned().partition(|range| unsteadiness(range, statistic) < UNSTEADY);
        let (steady_colour, held_colour) = (colour_factor(blocks, &steady), colour_factor(blocks, &held));
        Self { blocks, statistic, steady, steady_colour, held_colour }
    }

    /// Colour of the noise in a rest.
    pub(super) fn colour(&self, range: &Range<usize>) -> &Vector6<f64> {
        if unsteadiness(range, self.statistic) < UNSTEADY { &self.steady_colour } else { &self.held_colour }
    }

    /// See [`Rest::unsteadiness`](super::Rest::unsteadiness).
    pub(super) fn unsteadiness(&self, range: &Range<usize>) -> f64 {
        unsteadiness(range, self.statistic).max(drift(&self.blocks[range.clone()], self.colour(range)))
    }
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
    (3..6).filter(|&c| variance[c] > 0.0).map(|c| change[c] * change[c] / variance[c]).sum::<f64>() / 15.0
}

/// Median statistic of the windows inside a rest.
pub(super) fn unsteadiness(blocks: &Range<usize>, statistic: &[f64]) -> f64 {
    let windows = blocks.start..(blocks.end + 1).saturating_sub(WINDOW_BLOCKS).max(blocks.start + 1);
    median(&mut statistic[windows].to_vec())
}

/// Whether gravity goes astray by more than 5 % of `size` (3 deg) within a rest: an even tumble has no quieter windows
/// to be told from, but no rest either.
pub(super) fn wanders(blocks: &[Block], size: f64) -> bool {
    let force = |blocks: &[Block]| -> Vector3<f64> { merge(blocks).mean().fixed_rows::<3>(3).into() };
    let whole = force(blocks);
    blocks.chunks_exact(WINDOW_BLOCKS).any(|window| (force(window) - whole).norm() > 0.05 * size)
}
