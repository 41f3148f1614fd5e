//! Estimates the noise variance, computes the statistic (variance / noise variance) of each half-second window, and
//! chooses the threshold of the rest detection (model.md (11)).

use std::ops::Range;

use nalgebra::Vector6;
use pulp::{Simd, WithSimd};

use super::WINDOW_BLOCKS;
use super::edges::trim;
use crate::numerics::instructions::Instructions;
use crate::numerics::stats::quantile_of;
use crate::rounding::LEAST_SCATTER;

/// Returns the statistic of each window (variance / noise variance, averaged over the six channels), the noise variance
/// of each channel (squared raw units), and the quantisation step of each channel. The step is zero if the noise of the
/// channel is not below its step.
///
/// `variances` contains, for each channel, the variance in each window. At high sampling rates, consecutive samples are
/// first averaged in groups of equal size, and the variance is that of the averages. `steps` contains the smallest
/// difference between consecutive samples of each channel, divided by the square root of the group size, because
/// averaging reduces the rounding errors by this factor. The function `step_of` returns the quantisation step of a
/// channel.
pub(super) fn window_statistic(
    variances: &[Vec<f64>; 6],
    steps: &Vector6<f64>,
    step_of: impl Fn(usize) -> Option<f64>,
) -> (Vec<f64>, Vector6<f64>, Vector6<f64>) {
    // The floor is the estimated noise variance of a channel. With a coarse converter, a channel may be constant during
    // a rest, so its floor is at least step^2 / 12, the variance of rounding errors. A channel that is constant during
    // the whole recording has no finite step. Its floor is infinite, so it does not contribute to the statistic.
    let mut rounding = steps.map(|step| if step.is_finite() { step * step / 12.0 } else { f64::INFINITY });
    let mut coarse = Vector6::zeros();
    let mut floor = Vector6::from_fn(|channel, _| {
        let of_channel = &variances[channel];
        let write = |k: usize, to: &mut [f64]| to.copy_from_slice(&of_channel[k..k + to.len()]);
        let quietest = quantile_of(of_channel.len(), write, 0.05);
        let may_be_coarse = steps[channel].is_finite() && quietest < (LEAST_SCATTER * steps[channel]).powi(2);
        if let Some(step) = may_be_coarse.then(|| step_of(channel)).flatten() {
            // If the mean is midway between two multiples of the step, half of the samples are rounded to each of
            // them. The rounded samples then have the variance step^2 / 4, even with very small noise.
            rounding[channel] = steps[channel] * steps[channel] / 4.0;
            coarse[channel] = step;
        }
        quietest.max(rounding[channel])
    });
    let mut statistic = vec![0.0; variances[0].len()];
    let (mut before, mut in_quiet) = (Vec::new(), Vec::new());
    // The floor of each channel is estimated from the windows that are quiet in all channels at the same time. Four
    // iterations are sufficient for convergence.
    for _ in 0..4 {
        Instructions::Best.run(Ratios { variances, floor: &floor, statistic: &mut statistic });
        let write = |k: usize, to: &mut [f64]| to.copy_from_slice(&statistic[k..k + to.len()]);
        let limit = 2.0 * quantile_of(statistic.len(), write, 0.05);
        let quiet = runs_up_to(&statistic, limit);
        // If the set of quiet windows has not changed, the floor has converged.
        if quiet == before {
            break;
        }
        floor = Vector6::from_fn(|channel, _| {
            in_quiet.clear();
            quiet.iter().for_each(|run| in_quiet.extend_from_slice(&variances[channel][run.clone()]));
            let write = |k: usize, to: &mut [f64]| to.copy_from_slice(&in_quiet[k..k + to.len()]);
            quantile_of(in_quiet.len(), write, 0.5).max(rounding[channel])
        });
        before = quiet;
    }
    (statistic, floor, coarse)
}

/// Computes the statistic of each window: variance / noise variance, averaged over the channels. `floor` contains the
/// noise variance of each channel.
pub(super) fn statistic_of(variances: &[Vec<f64>; 6], floor: &Vector6<f64>) -> Vec<f64> {
    let mut statistic = vec![0.0; variances[0].len()];
    Instructions::Best.run(Ratios { variances, floor, statistic: &mut statistic });
    statistic
}

/// The windows whose statistic (variance / noise variance) is at most `limit`, as index ranges of consecutive windows.
fn runs_up_to(statistic: &[f64], limit: f64) -> Vec<Range<usize>> {
    let mut runs: Vec<Range<usize>> = Vec::new();
    for (window, _) in statistic.iter().enumerate().filter(|(_, s)| **s <= limit) {
        match runs.last_mut() {
            Some(run) if run.end == window => run.end += 1,
            _ => runs.push(window..window + 1),
        }
    }
    runs
}

/// Computation of the statistic of every window: variance / noise variance, averaged over the six channels, as in
/// [`imucal_core::rest::statistic_of`].
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

/// The chosen threshold, and the range of thresholds from which it was chosen, in units of the noise variance.
#[derive(Debug)]
pub(super) struct Choice {
    /// The threshold.
    pub(super) factor: f64,
    /// Lower end of the range.
    pub(super) from: f64,
    /// Upper end of the range.
    pub(super) to: f64,
    /// Number of rests that every threshold in the range gives.
    pub(super) rests: usize,
}

impl Choice {
    /// Converts the thresholds, which are multiples of one variance, to multiples of another variance. `ratio` is
    /// (present variance) / (new variance).
    pub(super) fn scaled(self, ratio: f64) -> Self {
        Self { factor: self.factor * ratio, from: self.from * ratio, to: self.to * ratio, rests: self.rests }
    }
}

/// Chooses the threshold. The thresholds are divided into ranges, and all thresholds in a range give the same number n
/// of rests. The range with the largest weighted width ln(upper end / lower end) x ln(n + 0.1) is selected. The chosen
/// threshold is near the lower end of this range.
pub(super) fn choose_threshold(statistic: &[f64], min_blocks: usize) -> Choice {
    // Lowest threshold that is tried, a ratio of variances. Most windows at rest have a statistic near 1, which is
    // below this threshold.
    const LOWEST: f64 = 1.5;
    // Ratio of consecutive thresholds that are tried.
    const STEP: f64 = 1.08;
    // Upper limit of the statistic. Without this limit, samples whose square overflows would make the highest threshold
    // infinite.
    const HIGHEST: f64 = 1e300;
    let maximum = statistic.iter().copied().fold(1.0, f64::max).min(HIGHEST);
    // Highest threshold that is tried, a ratio of variances. Higher thresholds would classify motion as rest. It is
    // max(v / 100, sqrt(v), 2 x LOWEST), where v is (variance of the fastest motion) / (variance of the noise).
    let highest = (maximum / 100.0).max(maximum.sqrt()).max(2.0 * LOWEST);
    let mut pending: Vec<(f64, usize)> = statistic.iter().copied().zip(0..).collect();
    pending.retain(|(level, _)| (LOWEST..highest).contains(level));
    pending.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let mut pending = pending.into_iter().peekable();
    let is_rest = |blocks: &Range<usize>| trim(blocks, statistic.len()).len() >= min_blocks;
    let (mut stretches, mut rests) = (Stretches::none(statistic.len()), 0);
    for blocks in still(statistic, LOWEST) {
        rests += usize::from(is_rest(&blocks));
        stretches.add(blocks.start..blocks.end + 1 - WINDOW_BLOCKS);
    }
    let mut best = (0.0, LOWEST, LOWEST, rests);
    let mut plateau: Option<(usize, f64)> = None;
    let mut threshold = LOWEST;
    while threshold <= highest {
        while let Some((_, window)) = pending.next_if(|(level, _)| *level < threshold) {
            if let Some((joined, parts)) = stretches.add(window..window + 1) {
                rests =
                    rests + usize::from(is_rest(&joined)) - parts.iter().flatten().filter(|part| is_rest(part)).count();
            }
        }
        let start = match plateau {
            Some((count, start)) if count == rests => start,
            _ => threshold,
        };
        plateau = Some((rests, start));
        let score = (threshold * STEP / start).ln() * (rests as f64 + 0.1).ln();
        if score > best.0 {
            best = (score, start, threshold, rests);
        }
        threshold *= STEP;
    }
    let (_, from, to, rests) = best;
    // The returned threshold is near the lower end of the range, so that the ends of the rests contain little motion.
    Choice { factor: from * (to / from).powf(0.25), from, to, rests }
}

/// Intervals at rest, as ranges of block indices in chronological order. Every block of an interval is in at least one
/// window whose statistic is below the threshold.
pub(super) fn still(statistic: &[f64], threshold: f64) -> impl Iterator<Item = Range<usize>> + '_ {
    let below = move |(window, value): (usize, &f64)| (*value < threshold).then_some(window);
    let mut windows = statistic.iter().enumerate().filter_map(below).peekable();
    std::iter::from_fn(move || {
        let first = windows.next()?;
        let mut end = first + WINDOW_BLOCKS;
        // Overlapping windows form one interval.
        while let Some(next) = windows.next_if(|next| *next < end) {
            end = next + WINDOW_BLOCKS;
        }
        Some(first..end)
    })
}

/// The intervals at rest that [`still`] returns, in a form that can be updated. When the threshold increases, the
/// windows whose statistic is now below it are added.
struct Stretches {
    /// For the first window of an interval: the index of the last window of the interval. For the last window: the
    /// index of the first window. For windows between them, the value is not used. A window outside all intervals has
    /// [`Self::OUTSIDE`].
    other_end: Vec<usize>,
}

/// The block range of an interval, and the block ranges of up to two earlier intervals that this interval replaces.
type Joined = (Range<usize>, [Option<Range<usize>>; 2]);

impl Stretches {
    /// Value of `other_end` for a window that belongs to no interval.
    const OUTSIDE: usize = usize::MAX;
    /// Maximum distance between the starts of two windows that overlap, in blocks.
    const REACH: usize = WINDOW_BLOCKS - 1;

    /// An empty set of intervals for a recording with `windows` windows.
    fn none(windows: usize) -> Self {
        Self { other_end: vec![Self::OUTSIDE; windows] }
    }

    /// Adds consecutive windows to the intervals, and returns the interval that now contains them. Returns `None` if an
    /// interval already contains them.
    fn add(&mut self, windows: Range<usize>) -> Option<Joined> {
        let Range { start, end } = windows;
        let is_in = |window: &usize| self.other_end[*window] != Self::OUTSIDE;
        if is_in(&start) {
            return None;
        }
        let before = (start.saturating_sub(Self::REACH)..start).rev().find(is_in);
        let after = (end..(end + Self::REACH).min(self.other_end.len())).find(is_in);
        let before = before.map(|last| (self.other_end[last], last));
        let after = after.map(|first| (first, self.other_end[first]));
        let blocks = |(first, last): (usize, usize)| first..last + WINDOW_BLOCKS;
        let whole = (before.map_or(start, |(first, _)| first), after.map_or(end - 1, |(_, last)| last));
        self.other_end[before.map_or(start, |(_, last)| last)..after.map_or(end, |(first, _)| first)].fill(whole.0);
        (self.other_end[whole.0], self.other_end[whole.1]) = (whole.1, whole.0);
        Some((blocks(whole), [before.map(blocks), after.map(blocks)]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stretches_are_the_blocks_of_still_windows_at_any_threshold() {
        let statistic: Vec<f64> =
            (0..400).map(|i| ((f64::from(i) * 0.37).sin() * 3.0).exp() + f64::from(i % 3)).collect();
        let mut order: Vec<usize> = (0..statistic.len()).collect();
        order.sort_unstable_by(|a, b| statistic[*a].total_cmp(&statistic[*b]));
        let (mut order, mut rising) = (order.into_iter().peekable(), Stretches::none(statistic.len()));
        let mut kept: Vec<Range<usize>> = Vec::new();
        for threshold in [1.5, 2.0, 3.7, 9.0, 12.0] {
            let mut covered = vec![false; statistic.len() + WINDOW_BLOCKS - 1];
            for (window, _) in statistic.iter().enumerate().filter(|(_, s)| **s < threshold) {
                covered[window..window + WINDOW_BLOCKS].fill(true);
            }
            let mut found = vec![false; covered.len()];
            still(&statistic, threshold).for_each(|range| found[range].fill(true));
            assert_eq!(found, covered, "{threshold}");
            while let Some(window) = order.next_if(|window| statistic[*window] < threshold) {
                if let Some((joined, parts)) = rising.add(window..window + 1) {
                    let before = kept.len();
                    kept.retain(|range| !parts.contains(&Some(range.clone())));
                    assert_eq!(before - kept.len(), parts.iter().flatten().count());
                    kept.push(joined);
                }
            }
            kept.sort_unstable_by_key(|range| range.start);
            assert_eq!(kept, still(&statistic, threshold).collect::<Vec<_>>(), "{threshold}");
        }
    }
}
