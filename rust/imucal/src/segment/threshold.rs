//! Noise floor, window statistic, and the choice of the threshold.

use std::ops::Range;

use nalgebra::Vector6;
use pulp::{Arch, Simd, WithSimd};

use super::WINDOW_BLOCKS;
use super::edges::trim;
use crate::stats::quantile_of;

/// The statistic of every window (one per block it may start at) and the noise floor (variances).
///
/// `variances` are those of each channel in the windows, `steps` the smallest steps of the channels.
pub(super) fn window_statistic(variances: &[Vec<f64>; 6], steps: &Vector6<f64>) -> (Vec<f64>, Vector6<f64>) {
    // A coarse converter may read one number throughout a rest: its floor is that of the rounding. A channel that
    // never changes has no step at all and no say.
    let rounding = steps.map(|step| if step.is_finite() { step * step / 12.0 } else { f64::INFINITY });
    let mut floor = Vector6::from_fn(|channel, _| {
        let of_channel = &variances[channel];
        let write = |k: usize, to: &mut [f64]| to.copy_from_slice(&of_channel[k..k + to.len()]);
        quantile_of(of_channel.len(), write, 0.05).max(rounding[channel])
    });
    let mut statistic = vec![0.0; variances[0].len()];
    let mut before: Vec<bool> = Vec::new();
    // The floor of each channel is that of the windows that are quiet in all channels together.
    for _ in 0..4 {
        Arch::new().dispatch(Ratios { variances, floor: &floor, statistic: &mut statistic });
        let write = |k: usize, to: &mut [f64]| to.copy_from_slice(&statistic[k..k + to.len()]);
        let limit = 2.0 * quantile_of(statistic.len(), write, 0.05);
        let quiet: Vec<bool> = statistic.iter().map(|s| *s <= limit).collect();
        // The same windows have the same floor.
        if quiet == before {
            break;
        }
        floor = Vector6::from_fn(|channel, _| {
            let in_quiet = |k: usize, to: &mut [f64]| {
                let windows = variances[channel][k..].iter().zip(&quiet[k..]);
                let in_quiet = windows.map(|(variance, quiet)| if *quiet { *variance } else { f64::NAN });
                to.iter_mut().zip(in_quiet).for_each(|(to, variance)| *to = variance);
            };
            quantile_of(statistic.len(), in_quiet, 0.5).max(rounding[channel])
        });
        before = quiet;
    }
    (statistic, floor)
}

/// The mean over the six channels of variance over noise floor, as [`imucal_core::rest::statistic_of`], of every window.
struct Ratios<'a> {
    variances: &'a [Vec<f64>; 6],
    floor: &'a Vector6<f64>,
    statistic: &'a mut [f64],
}

impl WithSimd for Ratios<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let weights = self.floor.map(|floor| 1.0 / (6.0 * floor));
        let [a, b, c, d, e, f] = self.variances;
        let channels = a.iter().zip(b).zip(c).zip(d).zip(e).zip(f);
        for (statistic, (((((a, b), c), d), e), f)) in self.statistic.iter_mut().zip(channels) {
            let (rate, force) = ([a, b, c], [d, e, f]);
            *statistic = (0..3).map(|k| rate[k] * weights[k] + force[k] * weights[3 + k]).sum();
        }
    }
}

/// The threshold in the widest range (on a logarithmic scale) that always finds the same number of rests, and that range.
///
/// Widths are weighed by the number of rests (none weighs less than nothing): one rest on a table before a unit is held by
/// hand, a thousand times less quiet, must not be all that is found.
pub(super) fn choose_threshold(statistic: &[f64], min_blocks: usize) -> (f64, f64, f64) {
    const LOWEST: f64 = 1.5;
    const STEP: f64 = 1.08;
    let loudest = statistic.iter().copied().fold(1.0, f64::max);
    // A tenth of the fastest motion, or half way to it on a logarithmic scale: above that, motion is taken for rest.
    let highest = (loudest / 100.0).max(loudest.sqrt()).max(2.0 * LOWEST);
    let levels = Levels::of(statistic, LOWEST, highest);
    let mut best = (0.0, LOWEST, LOWEST);
    let mut plateau: Option<(usize, f64)> = None;
    let mut threshold = LOWEST;
    while threshold <= highest {
        let rests = levels.still(threshold).filter(|range| trim(range, statistic.len()).len() >= min_blocks).count();
        let start = match plateau {
            Some((count, start)) if count == rests => start,
            _ => threshold,
        };
        plateau = Some((rests, start));
        let score = (threshold * STEP / start).ln() * (rests as f64 + 0.1).ln();
        if score > best.0 {
            best = (score, start, threshold);
        }
        threshold *= STEP;
    }
    let (_, from, to) = best;
    // Nearer the noise than the motion: the ends of a rest then hold as little motion as possible.
    (from * (to / from).powf(0.25), from, to)
}

/// The statistic as far as thresholds within a range see it.
pub(super) struct Levels {
    /// Windows in a row that are of one level: below all thresholds, above all, or of one value.
    runs: Vec<(f64, Range<usize>)>,
}

impl Levels {
    /// For thresholds from `lowest` to `highest`.
    pub(super) fn of(statistic: &[f64], lowest: f64, highest: f64) -> Self {
        let mut runs: Vec<(f64, Range<usize>)> = Vec::new();
        for (window, &value) in statistic.iter().enumerate() {
            let level = match value {
                _ if value < lowest => f64::NEG_INFINITY,
                _ if value >= highest => f64::INFINITY,
                _ => value,
            };
            match runs.last_mut() {
                Some((before, windows)) if *before == level => windows.end = window + 1,
                _ => runs.push((level, window..window + 1)),
            }
        }
        Self { runs }
    }

    /// Stretches of blocks that lie in some window below the threshold.
    pub(super) fn still(&self, threshold: f64) -> impl Iterator<Item = Range<usize>> + '_ {
        let mut still =
            self.runs.iter().filter(move |(level, _)| *level < threshold).map(|(_, windows)| windows).peekable();
        let end_of = |windows: &Range<usize>| windows.end - 1 + WINDOW_BLOCKS;
        std::iter::from_fn(move || {
            let first = still.next()?;
            let mut end = end_of(first);
            // Windows that overlap are one stretch.
            while let Some(next) = still.next_if(|next| next.start < end) {
                end = end_of(next);
            }
            Some(first.start..end)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stretches_are_the_blocks_of_still_windows_at_any_threshold() {
        let statistic: Vec<f64> =
            (0..400).map(|i| ((f64::from(i) * 0.37).sin() * 3.0).exp() + f64::from(i % 3)).collect();
        let levels = Levels::of(&statistic, 1.5, 12.0);
        for threshold in [1.5, 2.0, 3.7, 9.0, 12.0] {
            let mut covered = vec![false; statistic.len() + WINDOW_BLOCKS - 1];
            for (window, _) in statistic.iter().enumerate().filter(|(_, s)| **s < threshold) {
                covered[window..window + WINDOW_BLOCKS].fill(true);
            }
            let mut found = vec![false; covered.len()];
            levels.still(threshold).for_each(|range| found[range].fill(true));
            assert_eq!(found, covered, "{threshold}");
        }
    }
}
