//! Finds long time steps and their cause: lost samples, or samples whose time stamps are late.
//!
//! After a lost sample, the time stamps continue at the usual rate. A late time stamp, for example because the computer
//! was busy, is followed by shorter steps until the stamps are on time again. If stamps are only late, the number of
//! samples agrees with the duration, and no sample is missing.

use super::{Tally, names, stamps};
use crate::finding::{Finding, Place, counted};
use crate::recording::Recording;

/// The time steps after a late time stamp are short, until the stamps are on time again. A time step is short if it is
/// below this multiple of the usual time step.
const CATCHES_UP: f64 = 0.95;

/// The long time steps of a recording, in two groups: gaps in which samples were lost, and late time stamps.
#[derive(Default)]
pub(super) struct Gaps {
    /// Counter of the gaps in which samples were lost. It counts the first sample after each gap.
    after_lost: Tally,
    /// Number of samples that were lost in all gaps together.
    lost: f64,
    longest_s: f64,
    /// Counter of the samples whose time stamps are late.
    late: Tally,
    /// Largest delay of a late time stamp, s.
    latest_s: f64,
}

/// Decides for each time step that is longer than `longest_usual_s` whether samples were lost or a time stamp is late.
/// `median_s` is the median time step, s.
pub(super) fn find(recording: &Recording, median_s: f64, longest_usual_s: f64) -> Gaps {
    let steps_s = || recording.time_s.windows(2).map(|pair| pair[1] - pair[0]);
    // The usual step is the mean of the steps near the median. With a coarse clock, the median is a multiple of the
    // clock's resolution, so the mean is more accurate.
    let usual = |step_s: &f64| *step_s >= 0.5 * median_s && *step_s <= longest_usual_s;
    let (count, sum_s) = steps_s().filter(usual).fold((0.0, 0.0), |(n, sum), step_s| (n + 1.0, sum + step_s));
    let usual_s = sum_s / count;
    let mut gaps = Gaps::default();
    for (i, step_s) in steps_s().enumerate().filter(|(_, step_s)| *step_s > longest_usual_s && step_s.is_finite()) {
        let following = recording.time_s[i + 1..].windows(2).map(|pair| pair[1] - pair[0]);
        let caught_up_s: f64 =
            following.take_while(|next_s| *next_s < CATCHES_UP * usual_s).map(|next_s| usual_s - next_s).sum();
        let lost = ((step_s - usual_s - caught_up_s) / usual_s).round().max(0.0);
        if lost > 0.0 {
            gaps.after_lost.add(i + 1);
            gaps.lost += lost;
            gaps.longest_s = gaps.longest_s.max(step_s);
        } else {
            gaps.late.add(i + 1);
            gaps.latest_s = gaps.latest_s.max(step_s - usual_s);
        }
    }
    gaps
}

impl Gaps {
    /// Returns the finding `samples_missing` if samples were lost in gaps, otherwise `None`.
    pub(super) fn missing(&self, recording: &Recording) -> Option<Finding> {
        let (first, _) = self.after_lost.first?;
        let share = 100.0 * self.lost / (self.lost + recording.len() as f64);
        let place = Place::new(recording, first - 1, first);
        Some(Finding {
            columns: names(["time_s"]),
            place: Some(place),
            count: self.lost as usize,
            value: share,
            unit: "%",
            message: format!(
                "about {} ({share:.2} %) {} missing in {}, the first {place}, the longest {:.3} s",
                counted(self.lost as usize, "sample"),
                if self.lost == 1.0 { "is" } else { "are" },
                counted(self.after_lost.samples, "gap"),
                self.longest_s
            ),
            way_out:
                "if only a few samples are missing, nothing needs to be done; otherwise look for lost packets or a \
                 full buffer, and record again"
                    .into(),
            ..Finding::warning("samples_missing", recording.name)
        })
    }

    /// Returns the finding `clock_irregular` if any time stamp is late, otherwise `None`. A long time step before which
    /// samples were lost does not count as a late time stamp.
    pub(super) fn late(&self, recording: &Recording) -> Option<Finding> {
        let (first, _) = self.late.first?;
        let place = Place::new(recording, first - 1, first);
        Some(Finding {
            columns: names(["time_s"]),
            place: Some(place),
            count: self.late.samples,
            value: 1e3 * self.latest_s,
            unit: "ms",
            message: format!(
                "{} {} stamped late, by up to {:.3} ms, the first {place}; none is missing, because the following time \
                 steps are shorter",
                counted(self.late.samples, "sample"),
                if self.late.samples == 1 { "is" } else { "are" },
                1e3 * self.latest_s
            ),
            way_out: format!(
                "if only a few samples are late, nothing needs to be done; otherwise {}",
                stamps::from_sensor(recording)
            ),
            ..Finding::warning("clock_irregular", recording.name)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::check_columns;
    use super::super::example::Columns;

    fn found(time_s: Vec<f64>) -> Vec<(&'static str, usize)> {
        let mut columns = Columns::tumbling();
        columns.force.truncate(time_s.len());
        columns.rate.truncate(time_s.len());
        columns.time_s = time_s;
        check_columns(&columns.recording()).iter().map(|finding| (finding.code, finding.count)).collect()
    }

    #[test]
    fn lost_samples_are_counted() {
        let kept = |i: &usize| !(500..530).contains(i) && *i != 900;
        let found = found((0..2000).filter(kept).map(|i| i as f64 * 0.01).collect());
        assert_eq!(found, [("samples_missing", 31)]);
    }

    #[test]
    fn a_lost_sample_of_a_coarse_clock_is_counted() {
        let found = found((0..4000).filter(|i| i % 401 != 7).map(|i| (2.5 * i as f64).floor() * 1e-3).collect());
        assert_eq!(found, [("samples_missing", 10)]);
    }

    #[test]
    fn late_samples_are_not_missing() {
        // Every 90th sample is 12 ms late, and the sample after it is 4 ms late. The samples 2000 to 2049 arrive almost
        // at the same time.
        let late_s = |i: usize| match i % 90 {
            _ if (2000..2050).contains(&i) => (2050 - i) as f64 * 0.0099,
            40 => 0.012,
            41 => 0.004,
            _ => 0.0,
        };
        let found = found((0..4000).map(|i| i as f64 * 0.01 + late_s(i)).collect());
        assert_eq!(found.iter().map(|(code, _)| *code).collect::<Vec<_>>(), ["clock_irregular"]);
    }
}
