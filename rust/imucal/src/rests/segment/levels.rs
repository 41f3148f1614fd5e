//! Detects rests with different strengths of tremor in one recording, for example on a table and in a hand (model.md
//! (11)). Each strength is called a level. A level has its own noise variances and its own threshold.

use std::ops::Range;

use nalgebra::Vector6;

use super::WINDOW_BLOCKS;
use super::threshold::{Choice, choose_threshold, statistic_of, still, window_statistic};

/// A further level is accepted only if its rests are found with a wide range of thresholds. The weighted width of this
/// range, ln(upper end / lower end) x ln(n + 0.1), must be at least this number, where n is the number of rests that
/// the level adds. In simulated hand-held runs after a table rest, with 12 to 30 poses and a tremor of 0.1 to 0.8 deg,
/// the weighted width is 2.2 to 13. In simulated motion without further rests, it is below 2 in 47 of 48 recordings,
/// and 2.2 in the remaining recording.
const CLEAR: f64 = 2.0;

/// Detects the intervals at rest at all levels of tremor. Returns the chosen threshold of the last level, as a multiple
/// of the noise variances `floor`, and the intervals as ranges of blocks.
///
/// The statistic and the threshold of the first level refer to the noise of the sensors, which is estimated from the
/// quietest windows. The variance of hand-held rests may be a thousand times the noise variance, and thus nearer to the
/// variance of motion. For each further level, the noise variance and the threshold are therefore estimated again from
/// the windows outside the rests that were already found. If a hand-held run follows a rest on a table, the estimates
/// of the second level describe only the hand-held run.
pub(super) fn rests_of_all_levels(
    variances: &[Vec<f64>; 6],
    steps: &Vector6<f64>,
    statistic: &[f64],
    floor: &Vector6<f64>,
    coarse: &Vector6<f64>,
    min_blocks: usize,
) -> (Choice, Vec<Range<usize>>) {
    let mut choice = choose_threshold(statistic, min_blocks);
    let mut at_rest: Vec<Range<usize>> = still(statistic, choice.factor).collect();
    loop {
        let outside = outside(variances, at_rest.iter().filter(|blocks| blocks.len() >= min_blocks));
        if outside[0].len() < WINDOW_BLOCKS {
            return (choice, at_rest);
        }
        let step_of = |channel: usize| Some(coarse[channel]).filter(|step| *step > 0.0);
        let (_, level, _) = window_statistic(&outside, steps, step_of);
        let of_level = statistic_of(variances, &level);
        let next = choose_threshold(&of_level, min_blocks);
        let added = next.rests.saturating_sub(choice.rests) as f64;
        if (next.to / next.from).ln() * (added + 0.1).ln() < CLEAR {
            return (choice, at_rest);
        }
        // Rests that were already found are not replaced. With the threshold of this level, two rests that are
        // separated only by a slow rotation would become one interval.
        at_rest.retain(|blocks| blocks.len() >= min_blocks);
        let is_new = |new: &Range<usize>| at_rest.iter().all(|old| old.end <= new.start || new.end <= old.start);
        let new: Vec<Range<usize>> = still(&of_level, next.factor).filter(is_new).collect();
        at_rest.extend(new);
        at_rest.sort_by_key(|blocks| blocks.start);
        // A channel that is constant during the whole recording has an infinite noise variance. Its ratio is not a
        // number and is replaced by zero.
        let ratio = level.component_div(floor).map(|ratio| if ratio.is_finite() { ratio } else { 0.0 });
        choice = next.scaled(ratio.mean());
    }
}

/// The variances of the windows that have no block in common with the intervals `at_rest`.
fn outside<'a>(variances: &[Vec<f64>; 6], at_rest: impl Iterator<Item = &'a Range<usize>>) -> [Vec<f64>; 6] {
    let mut is_outside = vec![true; variances[0].len()];
    for blocks in at_rest {
        let windows = blocks.start.saturating_sub(WINDOW_BLOCKS - 1)..blocks.end.min(is_outside.len());
        is_outside[windows].fill(false);
    }
    variances.each_ref().map(|of_channel| {
        of_channel
            .iter()
            .zip(&is_outside)
            .filter(|(_, is_outside)| **is_outside)
            .map(|(variance, _)| *variance)
            .collect()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Simulates the variances of windows: `tables` rests of 20 s on a table, then 20 hand-held rests of 4 s, with
    /// moves of 4 s between all rests. In the hand, the variance of the gyroscope is 2000 to 2760 times its variance on
    /// the table, and the variance of the accelerometer is 20 times its variance on the table. In moves, these factors
    /// are about 6e4 and 600.
    fn table_then_hand(tables: usize) -> [Vec<f64>; 6] {
        // Each part of the recording has a number of windows, a variance for each of the two sensors, and a scatter:
        // the largest ln of (variance of a window) / (variance of the sensor).
        let moving = (80, [6e4, 600.0], 1.4);
        let on_a_table = (0..tables).flat_map(|_| [(400, [1.0, 1.0], 0.2), moving]);
        let held = (0..20).flat_map(|k| [(80, [2000.0 + 40.0 * f64::from(k), 20.0], 0.2), moving]);
        let parts: Vec<(usize, [f64; 2], f64)> = on_a_table.chain(held).collect();
        [0, 1, 2, 3, 4, 5].map(|channel: usize| {
            let window = |(count, sizes, scatter): &(usize, [f64; 2], f64)| {
                let (size, scatter) = (sizes[channel / 3], *scatter);
                (0..*count).map(move |k| size * (scatter * ((k * (channel + 2)) as f64 * 0.7).sin()).exp())
            };
            parts.iter().flat_map(window).collect()
        })
    }

    #[test]
    fn hand_held_rests_are_found_after_rests_on_a_table() {
        for tables in [0, 1, 3] {
            let variances = table_then_hand(tables);
            let steps = Vector6::repeat(1e-9);
            let (statistic, floor, _) = window_statistic(&variances, &steps, |_| None);
            let (choice, rests) = rests_of_all_levels(&variances, &steps, &statistic, &floor, &Vector6::zeros(), 20);
            assert_eq!(rests.iter().filter(|blocks| blocks.len() >= 20).count(), tables + 20, "{tables} {choice:?}");
            assert_eq!(choice.rests, tables + 20);
            if tables > 0 {
                let alone = choose_threshold(&statistic, 20);
                assert_eq!(alone.rests, tables, "{alone:?}");
                // The ratio (variance in the hand) / (variance on the table), averaged over the channels, is about
                // 1000.
                assert!((1000.0..6000.0).contains(&choice.factor), "{choice:?}");
            }
        }
    }

    /// With the threshold of the hand-held rests, a slow turn on the table is detected as a rest. The table rests
    /// before and after the turn must nevertheless remain two rests.
    #[test]
    fn rests_on_a_table_are_not_joined_by_the_threshold_of_a_hand() {
        let hand = table_then_hand(1);
        let variances: [Vec<f64>; 6] = std::array::from_fn(|channel| {
            let turn = if channel < 3 { 30.0 } else { 1.0 };
            [&hand[channel][..400], &[turn; 40], &hand[channel]].concat()
        });
        let steps = Vector6::repeat(1e-9);
        let (statistic, floor, coarse) = window_statistic(&variances, &steps, |_| None);
        let (_, rests) = rests_of_all_levels(&variances, &steps, &statistic, &floor, &coarse, 20);
        let long: Vec<_> = rests.iter().filter(|blocks| blocks.len() >= 20).collect();
        assert_eq!(long.len(), 22, "{long:?}");
        assert!(long[0].end <= 410 && long[1].start >= 440, "{long:?}");
    }

    #[test]
    fn windows_outside_share_no_block_with_a_rest() {
        let variances = [(); 6].map(|()| (0..40).map(f64::from).collect::<Vec<f64>>());
        let found = outside(&variances, [15..20, 45..49].iter());
        let expected: Vec<f64> = (0..6).chain(20..36).map(f64::from).collect();
        assert_eq!(found, [(); 6].map(|()| expected.clone()));
    }
}
