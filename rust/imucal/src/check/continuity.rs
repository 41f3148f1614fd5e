//! Check for lost samples and additional rows in a recording whose time stamps were computed from the sample number.
//! The rotation of the unit reveals these faults.
//!
//! ```text
//! d_i = w_i - w_(i-1)      m = (d_(i-1) + d_(i+1)) / 2      k = d_i . m / |m|^2
//! ```
//!
//! In a smooth motion, the change `d_i` of the rate `w` over a time step equals the mean `m` of the adjacent changes,
//! so `k` is 1. If a sample between two rows was lost, the time between these rows is twice as long, and `k` is 2.
//! Noise, rough motion, coarse rounding, and motion that is too fast for the sampling rate scatter `k` to both sides of
//! 1, so there are as many values near 0 as near 2. If time stamps were recorded with the samples, a lost sample causes
//! a gap. If time stamps were computed from the sample number, there is no gap. The estimated sensitivity of the
//! gyroscope then has a relative error equal to the share of lost samples.

use nalgebra::Vector3;

use super::Tally;
use super::repeats::Repeats;
use crate::finding::Finding;
use crate::numerics::stats::quantile_of;
use crate::recording::{Recording, Samples};

/// Time stamps are regarded as computed from the sample number if |time stamp x rate - sample number| is at most this
/// value. The limit permits stamps that are rounded to multiples of a ninth of the time step. The rounding error of a
/// stamp is then at most 1/18 time step, and the error of the difference of two stamps is at most 1/9 = 0.11 time step.
const EVEN: f64 = 0.12;
/// A lost sample is recognised by the ratio `k` = (change `d_i` of the rate over one step) / (mean `m` of the two
/// adjacent changes), which is then about 2. The ratio is used only if |m| / (noise standard deviation of `d_i - m`) is
/// above this value, because the ratio is too noisy if the rate changes more slowly. At this limit, the noise of `k`
/// has a standard deviation of 1/8.
const CLEAR: f64 = 8.0;
/// The ratio `k` is used only if the motion is smooth, which means |d_(i+1) - d_(i-1)| < SMOOTH x |m|.
const SMOOTH: f64 = 0.5;
/// The ratio `k` is used only if (component of `d_i` perpendicular to `m`) / |m| is below this value.
const ACROSS: f64 = 0.35;
/// A ratio `k` (rate change / mean of the adjacent changes) in this range shows one lost sample. The limits are 2 minus
/// and plus two standard deviations of `k`. One standard deviation is 1/8 at the limit [`CLEAR`].
const LOST: [f64; 2] = [1.75, 2.25];
/// Range of `k` between the peaks of its histogram at 1 (no loss) and 2 (one lost sample). Rough motion gives about as
/// many values of `k` in this range as near 2, so the numbers of values in both ranges are compared.
const BETWEEN: [f64; 2] = [1.35, 1.65];
/// Range of `k` that is as far from 1 as the range [`LOST`], on the other side. Coarsely rounded rates give ratios of
/// small integers, and motion that is too fast for the sampling rate gives any ratio, on both sides of 1. A lost sample
/// gives no ratio in this range.
const OPPOSITE: [f64; 2] = [2.0 - LOST[1], 2.0 - LOST[0]];
/// Number of samples that are read and examined together. This number of samples fits into the processor's cache.
const BLOCK: usize = 4096;
/// A finding is reported only for at least this number of lost samples.
const FEWEST: usize = 5;
/// Lost samples are reported only if the number of values of `k` in the range [`LOST`] is at least this multiple of the
/// number of values in the ranges [`BETWEEN`] and [`OPPOSITE`] together.
const PEAK: usize = 3;
/// Repeated rows are additional rows if the mean of `k` over them is below this limit. `k` is (rate change across the
/// repeated row) / (mean of the adjacent changes). It is 1 if a row was written in addition to the samples, and 2 if
/// the sensor repeated a sample.
const ADDITIONAL: f64 = 1.5;

/// Reports lost samples and additional rows in a recording whose time stamps were computed from the sample number.
pub(super) fn check(recording: &Recording<'_>, repeats: &Repeats) -> Option<Finding> {
    if recording.angular_rate.is_absent() || !is_even(recording.time_s) {
        return None;
    }
    let noise = noise_of_changes(recording.angular_rate)?;
    additional(recording, repeats, noise).or_else(|| lost(recording, noise))
}

/// Whether all time stamps equal first time stamp + sample number / mean rate, within [`EVEN`] time steps.
fn is_even(time_s: &[f64]) -> bool {
    let ([first_s, .., last_s], count) = (time_s, time_s.len()) else { return false };
    let step_s = (last_s - first_s) / (count - 1) as f64;
    let is_near = |(i, stamp_s): (usize, &f64)| (stamp_s - first_s - i as f64 * step_s).abs() <= EVEN * step_s;
    step_s > 0.0 && time_s.iter().enumerate().all(is_near)
}

fn lost(recording: &Recording<'_>, noise: f64) -> Option<Finding> {
    let rate = recording.angular_rate;
    let (mut lost, mut elsewhere) = (Tally::default(), 0);
    for start in (0..rate.len() - 3).step_by(BLOCK) {
        let block = rate.part(start..(start + BLOCK + 3).min(rate.len()));
        for (i, rows) in (start + 2..).zip(fours(&block)) {
            match change_over_neighbours(rows, noise) {
                Some(k) if (LOST[0]..LOST[1]).contains(&k) => lost.add(i),
                Some(k) if [BETWEEN, OPPOSITE].iter().any(|[low, high]| (*low..*high).contains(&k)) => elsewhere += 1,
                _ => {}
            }
        }
    }
    if lost.samples < FEWEST || lost.samples < PEAK * elsewhere {
        return None;
    }
    Some(Finding {
        place: lost.place(recording),
        count: lost.samples,
        value: lost.samples as f64,
        unit: "samples",
        message: format!(
            "the rate jumps by two time steps at {} samples, the first {}, but the time stamps are even: samples were \
             lost before the stamps were made from the sample number",
            lost.samples,
            lost.first_place(recording)
        ),
        way_out:
            "record again without losing samples, or record the time stamp of each sample with it: the sensitivity of \
             the gyroscope would be wrong by the share of lost samples"
                .into(),
        ..Finding::error("samples_missing", recording.name)
    })
}

/// Reports rows that repeat the previous row and were written in addition to the samples. Across an additional row,
/// from the row before it to the row after it, the rate changes as in one sampling interval instead of two.
fn additional(recording: &Recording<'_>, repeats: &Repeats, noise: f64) -> Option<Finding> {
    let count = repeats.reported()?;
    let rate = recording.angular_rate;
    let is_repeat = |i: usize| rate.at(i) == rate.at(i - 1);
    // The repeated row is row i - 1. The rows before and after it are i - 2 and i.
    let across = (3..rate.len() - 1).filter(|&i| is_repeat(i - 1) && !is_repeat(i) && !is_repeat(i - 2));
    let (sum, number) = across
        .filter_map(|i| change_over_neighbours([i - 3, i - 2, i, i + 1].map(|row| rate.at(row).into()), noise))
        .fold((0.0, 0usize), |(sum, number), k| (sum + k, number + 1));
    let mean = sum / number as f64;
    if number < FEWEST || mean > ADDITIONAL {
        return None;
    }
    Some(Finding {
        count,
        value: 100.0 * repeats.share(),
        unit: "%",
        message: format!(
            "{} repeat all six values of the row before, and across them the rate changes by {mean:.2} time steps: they \
             are additional rows, but the time stamps were made from the sample number and count them{}",
            repeats.counted(),
            repeats.not_examined(recording)
        ),
        way_out: "drop the repeated rows, then give the rate of the sensor with --rate-hz if the rows were written twice, or \
             keep the time stamps of the other rows if a slower sensor was polled"
            .into(),
        ..Finding::error("samples_duplicated", recording.name)
    })
}

/// Returns every group of four consecutive samples of the angular rate, in ascending order.
fn fours(rows: &[[f64; 3]]) -> impl Iterator<Item = [Vector3<f64>; 4]> + '_ {
    rows.windows(4).map(|rows| std::array::from_fn(|k| rows[k].into()))
}

/// Returns the ratio `k` (module documentation) for four consecutive rates: the change between the two middle rates,
/// relative to the mean `m` of the two adjacent changes. `None` if the motion is too slow or too rough, or if a value
/// is not finite.
#[inline]
fn change_over_neighbours([a, b, c, d]: [Vector3<f64>; 4], noise: f64) -> Option<f64> {
    let (before, change, after) = (b - a, c - b, d - c);
    let mean = (before + after) / 2.0;
    let length2 = mean.norm_squared();
    // This test is first, because most rows are at rest and fail it.
    let is_clear = length2 > (CLEAR * noise).powi(2) && (after - before).norm_squared() < SMOOTH.powi(2) * length2;
    // Changes as small as rounding errors, which occur in simulations without noise, are not used.
    if !is_clear || length2 < (CLEAR * f64::EPSILON).powi(2) * b.norm_squared() {
        return None;
    }
    let k = change.dot(&mean) / length2;
    ((change - mean * k).norm_squared() < ACROSS.powi(2) * length2).then_some(k)
}

/// Estimates the standard deviation of the noise of `d_i - m` (a change of the rate minus the mean of the adjacent
/// changes) for one axis, raw units. The three axes are assumed to have equal noise. The estimate is computed from the
/// median of |d_i - m|, because most changes are smooth, and the few others hardly affect the median.
fn noise_of_changes(rate: Samples<'_>) -> Option<f64> {
    /// Median length of a vector with three independent standard normal components.
    const MEDIAN_LENGTH: f64 = 1.538_172;
    let count = rate.len().checked_sub(3).filter(|count| *count > 0)?;
    let sizes = |first: usize, to: &mut [f64]| {
        let rows = rate.part(first..first + to.len() + 3);
        for (size, [a, b, c, d]) in to.iter_mut().zip(fours(&rows)) {
            *size = ((c - b) - (b - a + d - c) / 2.0).norm();
        }
    };
    let noise = quantile_of(count, sizes, 0.5) / MEDIAN_LENGTH;
    noise.is_finite().then_some(noise)
}

#[cfg(test)]
mod tests {
    use super::super::example::Columns;
    use super::*;
    use crate::check::survey::Survey;

    fn found(columns: &Columns) -> Option<Finding> {
        check(&columns.recording(), &Survey::of(&columns.recording()).repeats)
    }

    #[test]
    fn rounding_errors_at_rest_are_no_lost_samples() {
        let mut columns = Columns::tumbling();
        for (i, rate) in columns.rate.iter_mut().enumerate() {
            // After every hundredth sample, the rate rises by 1, 2 and 1 units in the last place in three consecutive
            // steps.
            let units = [0, 1, 3, 4].get(i % 100).copied().unwrap_or(4) + 4 * (i / 100);
            *rate = [0.04 + units as f64 * f64::EPSILON / 32.0, 0.0, 0.0];
        }
        assert!(found(&columns).is_none());
    }

    /// The samples of the synthetic recording [`Columns::tumbling`] with the indices `kept`. If `made_anew` is true,
    /// new time stamps are computed from the sample number. Otherwise, the samples keep their time stamps.
    fn rows(kept: impl Iterator<Item = usize>, made_anew: bool) -> Columns {
        let all = Columns::tumbling();
        let mut columns = Columns { time_s: Vec::new(), force: Vec::new(), rate: Vec::new() };
        for i in kept {
            columns.time_s.push(if made_anew { columns.time_s.len() as f64 * 0.01 } else { all.time_s[i] });
            columns.force.push(all.force[i]);
            columns.rate.push(all.rate[i]);
        }
        columns
    }

    #[test]
    fn a_recording_without_fault_is_continuous() {
        assert!(found(&Columns::tumbling()).is_none());
        assert!(found(&Columns::tumbling().quantised(0.04, 0.006)).is_none());
    }

    #[test]
    fn two_coarse_axes_are_no_loss() {
        // With these quantisation steps, three consecutive changes of the rate in a move are often 1, 2 and 1 steps, or
        // 1, 0 and 1 steps.
        for step in [0.053, 0.057, 0.06, 0.063, 0.066] {
            let mut columns = Columns::tumbling();
            for [x, y, _] in &mut columns.rate {
                (*x, *y) = ((*x / step).round() * step, (*y / step).round() * step);
            }
            assert!(found(&columns).is_none(), "{step} rad/s");
        }
    }

    #[test]
    fn lost_samples_show_in_even_stamps_only() {
        let kept = || (0..4000).filter(|i| i % 40 != 7);
        let finding = found(&rows(kept(), true)).unwrap();
        assert_eq!((finding.code, finding.severity), ("samples_missing", crate::finding::Severity::Error));
        assert!((20..=100).contains(&finding.count), "{finding:?}");
        assert!(found(&rows(kept(), false)).is_none());
    }

    #[test]
    fn additional_rows_are_no_held_samples() {
        let twice = (0..4000).flat_map(|i| std::iter::repeat_n(i, if i % 20 == 7 { 2 } else { 1 }));
        assert_eq!(found(&rows(twice, true)).unwrap().code, "samples_duplicated");
        let held = (0..4000).map(|i| if i % 20 == 7 { i - 1 } else { i });
        assert!(found(&rows(held, true)).is_none());
        assert!(found(&rows((0..4000).map(|i| i - i % 2), true)).is_none());
    }

    #[test]
    fn few_rows_are_no_evidence() {
        assert!(found(&rows(0..2, true)).is_none());
        assert!(found(&rows(0..3, true)).is_none());
    }
}
