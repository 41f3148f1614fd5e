//! Check for packet time stamps. All samples of a packet have nearly equal stamps if they are stamped when the packet
//! arrives or is read.

use super::{names, stamps};
use crate::finding::{Finding, Place};
use crate::numerics::stats::median;
use crate::recording::Recording;

/// Minimum number of samples in a packet. Two samples with equal time stamps do not count as a packet, because the same
/// row may have been written twice.
const LEAST_SAMPLES: f64 = 3.0;
/// A finding is reported only for at least this number of packets.
const FEWEST_PACKETS: usize = 10;
/// Maximum median time step between packets, s. Longer time steps are pauses of a logger that sleeps, not intervals
/// between packets.
const LONGEST_S: f64 = 2.0;
/// Time stamps count as those of packets only if the sum of the time steps between packets exceeds this share of the
/// recording's duration.
const SHARE_OF_TIME: f64 = 0.5;
/// Time stamps count as those of packets only if at least this share of the packets has nearly the median number of
/// samples. If samples are lost at random, the groups between long time steps have varying sizes, so this limit
/// excludes random loss.
const ALIKE: f64 = 0.9;
/// A packet has nearly the median number of samples if its number differs from the median by at most this share of the
/// median. A difference of one sample is always permitted.
const WITHIN: f64 = 0.25;

/// Reports packet time stamps, with the finding `clock_irregular`; `None` if the stamps are not those of packets. The
/// time stamps must not decrease.
pub(super) fn check(recording: &Recording) -> Option<Finding> {
    let time_s = recording.time_s;
    let (first_s, last_s) = (*time_s.first()?, *time_s.last()?);
    let mean_s = (last_s - first_s) / (time_s.len() - 1) as f64;
    // A packet starts after a time step longer than 1.5 times the mean time step. A time step of NaN starts no packet.
    let starts: Vec<usize> = (1..time_s.len()).filter(|&i| time_s[i] - time_s[i - 1] > 1.5 * mean_s).collect();
    let (&first, &last) = (starts.first()?, starts.last()?);
    if starts.len() <= FEWEST_PACKETS {
        return None;
    }
    let mut sizes: Vec<f64> = starts.windows(2).map(|pair| (pair[1] - pair[0]) as f64).collect();
    let typical = median(&mut sizes);
    sizes.retain(|size| (size - typical).abs() <= (WITHIN * typical).max(1.0));
    // The reported size is the mean instead of the median, because rounded time stamps may give packets of alternating
    // sizes, for example 9 and 11 samples.
    let size = sizes.iter().sum::<f64>() / sizes.len() as f64;
    let mut between: Vec<f64> = starts.iter().map(|&i| time_s[i] - time_s[i - 1]).collect();
    let share = between.iter().sum::<f64>() / (last_s - first_s);
    let between_s = median(&mut between);
    let is_bursts = size >= LEAST_SAMPLES
        && between_s < LONGEST_S
        && share > SHARE_OF_TIME
        && sizes.len() as f64 >= ALIKE * (starts.len() - 1) as f64;
    if !is_bursts {
        return None;
    }
    let mut within: Vec<f64> = starts
        .windows(2)
        .filter(|pair| pair[1] - pair[0] > 1)
        .map(|pair| (time_s[pair[1] - 1] - time_s[pair[0]]) / (pair[1] - pair[0] - 1) as f64)
        .collect();
    Some(Finding {
        columns: names(["time_s"]),
        place: Some(Place::new(recording, first, last)),
        count: time_s.len(),
        value: size,
        unit: "samples",
        message: format!(
            "the time stamps come in bursts of {size:.0} samples: {:.3} ms from one sample to the next within a burst, {:.3} ms \
             from a burst to the next",
            1e3 * median(&mut within),
            1e3 * between_s
        ),
        way_out: format!("the stamps are those of packets, not of samples: {}", stamps::even(recording)),
        ..Finding::error("clock_irregular", recording.name)
    })
}

#[cfg(test)]
mod tests {
    use super::super::check_columns;
    use super::super::example::Columns;
    use super::*;

    /// Returns the findings for the synthetic recording [`Columns::tumbling`], with the time stamp `stamp_s(i)` for
    /// sample i.
    fn found(stamp_s: impl Fn(usize) -> f64) -> Vec<Finding> {
        let mut columns = Columns::tumbling();
        columns.time_s = (0..columns.time_s.len()).map(stamp_s).collect();
        check_columns(&columns.recording())
    }

    #[test]
    fn samples_stamped_by_packets_are_told_from_lost_ones() {
        // Time steps within a packet, s: the time to read one sample, a shorter time, a longer time, and zero.
        for within_s in [1e-4, 1e-5, 2e-3, 0.0] {
            let findings = found(|i| (i / 16) as f64 * 0.16 + (i % 16) as f64 * within_s);
            assert_eq!(findings.len(), 1, "{findings:?}");
            let bursts = &findings[0];
            assert_eq!((bursts.code, bursts.value), ("clock_irregular", 16.0));
            assert!(bursts.message.contains(&format!("{:.3} ms from one", 1e3 * within_s)), "{}", bursts.message);
            assert!(
                bursts.way_out.contains("rate_hz=100") || bursts.way_out.contains("rate_hz=99.99"),
                "{}",
                bursts.way_out
            );
        }
        // If a timer that is not synchronised with the sensor reads the sensor's buffer, the number of samples in a
        // packet varies by one.
        let short = found(|i| ((i + i / 160) / 16) as f64 * 0.16 + ((i + i / 160) % 16) as f64 * 1e-4);
        assert_eq!(short.iter().map(|f| f.code).collect::<Vec<_>>(), ["clock_irregular"]);
    }

    #[test]
    fn rounded_time_stamps_do_not_change_the_size_of_a_packet() {
        // Packets of 9 samples and packets of 11 samples alternate. Pauses of 2.5 s do not change the typical size.
        let findings = found(|i| (i / 20) as f64 * 0.2 + if i % 20 < 9 { 0.0 } else { 0.1 } + (i / 1990) as f64 * 2.5);
        assert_eq!(findings[0].code, "clock_irregular", "{findings:?}");
        assert!(findings[0].message.contains("bursts of 10 samples"), "{}", findings[0].message);
    }

    #[test]
    fn lost_samples_and_a_logger_that_sleeps_are_no_packets() {
        // After every 500 samples (5 s), there is a gap of 6 s. Each gap is longer than the recorded interval between
        // two gaps.
        let lost = found(|i| i as f64 * 0.01 + (i / 500) as f64 * 6.0);
        assert_eq!(lost.iter().map(|f| f.code).collect::<Vec<_>>(), ["samples_missing"]);
        let chance = |i: usize| (i as f64 * 12.9898).sin().abs() * 43758.5453 % 1.0;
        let mut now_s = 0.0;
        let stamps: Vec<f64> = (0..4000)
            .map(|i| {
                now_s += if chance(i) < 0.05 { 0.5 } else { 0.01 };
                now_s
            })
            .collect();
        let lost = found(|i| stamps[i]);
        assert_eq!(lost.iter().map(|f| f.code).collect::<Vec<_>>(), ["samples_missing"]);
    }
}
