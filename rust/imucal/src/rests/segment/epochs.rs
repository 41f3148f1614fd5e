//! Divides a long rest into epochs, each with its own mean (model.md (41)).
//!
//! One mean describes a rest of a few seconds. During a rest of several minutes, the biases drift and the unit warms
//! up. A mean over the whole rest is therefore not more accurate than a mean over a part. The change within the rest
//! contains information about temperature effects and drifts. A long rest is therefore divided into epochs of equal
//! length. Each epoch has its own mean, time and temperature, and all epochs have the same pose.

use std::ops::Range;

use nalgebra::Vector6;

use crate::recording::Recording;

/// Minimum duration of a rest that is divided into epochs, s. The rests of a calibration run last 1 to 60 s, including
/// the initial rest of 50 s that some methods require. They are shorter than this limit, and one mean describes each of
/// them.
pub(crate) const LONG_REST_S: f64 = 120.0;
/// Maximum duration of an epoch, s. The Allan deviation of MEMS sensors no longer decreases after 10 to 100 s, because
/// bias instability then exceeds white noise. A longer mean is therefore not more accurate.
const EPOCH_S: f64 = 60.0;
/// Maximum change of the temperature within an epoch, K. A fit averages the temperature effects over the temperatures
/// within an epoch. For linear and quadratic effects, this average is exact for any change of temperature. Other
/// effects must be nearly linear over the change. The bias of a MEMS sensor is a nearly linear function of temperature
/// over 2 K.
const EPOCH_K: f64 = 2.0;
/// Minimum duration of an epoch, s. It applies even if the temperature changes fast. Typical rests in calibration runs
/// take 10 s, and a mean over 10 s determines the gravity direction with little noise.
const MIN_EPOCH_S: f64 = 10.0;
/// Maximum number of epochs of one rest. It limits the time of a fit, which grows with the third power of this number.
const MAX_EPOCHS: usize = 120;

/// Divides a rest into epochs, which are ranges of blocks. The result is empty if one mean describes the rest.
/// `block_s` is the duration of a block. `temperature_degc` returns the mean temperature over several blocks, if it is
/// known.
pub(super) fn cut(
    blocks: &Range<usize>,
    block_s: f64,
    temperature_degc: impl Fn(Range<usize>) -> Option<f64>,
) -> Vec<Range<usize>> {
    let duration_s = blocks.len() as f64 * block_s;
    if duration_s <= LONG_REST_S || blocks.len() < 2 {
        return Vec::new();
    }
    let most = ((duration_s / MIN_EPOCH_S) as usize).min(MAX_EPOCHS).min(blocks.len());
    // The temperature may rise and fall again, so the absolute changes between consecutive parts of the rest are
    // summed. Each change is a difference of mean temperatures, because averaging reduces the noise of the thermometer.
    let temperatures: Vec<f64> = parts(blocks, most).into_iter().filter_map(temperature_degc).collect();
    let change_k: f64 = temperatures.windows(2).map(|pair| (pair[1] - pair[0]).abs()).sum();
    let count = (duration_s / EPOCH_S).max(change_k / EPOCH_K).ceil() as usize;
    parts(blocks, count.min(most))
}

/// Divides a range into `count` consecutive parts of nearly equal length.
fn parts(range: &Range<usize>, count: usize) -> Vec<Range<usize>> {
    let bound = |k: usize| range.start + range.len() * k / count;
    (0..count).map(|k| bound(k)..bound(k + 1)).collect()
}

/// Joins consecutive intervals at rest that are separated only by noise, if the result is a long rest. In a rest of
/// several minutes, the variance of noise in a half-second window may exceed the threshold, so that the rest is
/// detected as several intervals. Intervals are ranges of blocks of `samples` samples. `floor` is the standard
/// deviation of the noise of each channel.
pub(super) fn joined(
    recording: &Recording<'_>,
    still: Vec<Range<usize>>,
    samples: usize,
    block_s: f64,
    floor: &Vector6<f64>,
) -> Vec<Range<usize>> {
    let follows = |a: &Range<usize>, b: &Range<usize>| {
        is_noise(recording, a.start * samples..a.end * samples, b.start * samples, floor)
    };
    let of_group = |group: &[Range<usize>]| match group {
        [first, .., last] if (last.end - first.start) as f64 * block_s > LONG_REST_S => {
            Vec::from_iter([Range { start: first.start, end: last.end }])
        }
        _ => group.to_vec(),
    };
    still.chunk_by(follows).flat_map(of_group).collect()
}

/// Whether only noise separates a rest from the following rest, which starts at sample `next`. This is the case if no
/// sample between the two rests deviates from the mean at the end of the first rest by more than six standard
/// deviations. Filtered noise can split a long rest, because the variance of filtered noise over half a second varies
/// strongly.
pub(crate) fn is_noise(recording: &Recording<'_>, rest: Range<usize>, next: usize, floor: &Vector6<f64>) -> bool {
    const NEAR: usize = 200;
    const LIMIT: f64 = 6.0;
    let near = rest.end.saturating_sub(NEAR).max(rest.start)..rest.end;
    [(recording.angular_rate, 0), (recording.specific_force, 3)].iter().all(|(rows, first)| {
        rows.is_absent()
            || (0..3).all(|axis| {
                let values = || rows.slice(near.clone()).axis(axis);
                let mean = values().sum::<f64>() / near.len() as f64;
                let variance = values().map(|value| (value - mean).powi(2)).sum::<f64>() / near.len() as f64;
                let limit = LIMIT * variance.sqrt().max(floor[first + axis]);
                rows.slice(rest.end..next).axis(axis).all(|value| (value - mean).abs() <= limit)
            })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const BLOCK_S: f64 = 0.05;

    #[test]
    fn blocks_longer_than_an_epoch_are_not_divided() {
        assert!(cut(&(3..4), 500.0, |_| None).is_empty());
        assert_eq!(cut(&(3..5), 500.0, |_| None), [3..4, 4..5]);
    }

    fn lengths(duration_s: f64, degc_at: impl Fn(f64) -> Option<f64>) -> Vec<usize> {
        let blocks = 7..7 + (duration_s / BLOCK_S).round() as usize;
        let found = cut(&blocks, BLOCK_S, |range| degc_at((range.start + range.end) as f64 / 2.0 * BLOCK_S));
        assert!(found.windows(2).all(|pair| pair[0].end == pair[1].start), "{found:?}");
        if let (Some(first), Some(last)) = (found.first(), found.last()) {
            assert_eq!((first.start, last.end), (blocks.start, blocks.end));
        }
        found.iter().map(ExactSizeIterator::len).collect()
    }

    #[test]
    fn a_rest_of_up_to_two_minutes_is_one_mean() {
        assert!(lengths(120.0, |_| None).is_empty());
        assert_eq!(lengths(120.1, |_| None).len(), 3);
    }

    #[test]
    fn epochs_are_shorter_where_the_temperature_changes_more() {
        assert_eq!(lengths(1800.0, |_| None).len(), 30);
        assert_eq!(lengths(1800.0, |_| Some(25.0)).len(), 30);
        // The temperature rises by 30 K and falls again, and then falls by 30 K and rises again.
        let cycle = |t_s: f64| Some(25.0 + 30.0 * (t_s / 900.0 * std::f64::consts::PI).sin());
        let found = lengths(1800.0, cycle);
        assert_eq!(found.len(), 60);
        assert_eq!(lengths(100_000.0, cycle).len(), MAX_EPOCHS);
    }
}
