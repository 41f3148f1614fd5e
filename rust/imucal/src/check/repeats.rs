//! Check for repeated rows, which occur if the sensor repeats its last sample or if a row is written twice.

use super::Tally;
use super::part::{PART, Part};
use crate::finding::Finding;
use crate::recording::Recording;

/// A sequence of at most this number of equal rows is counted as repeated rows. A longer sequence is a rest without
/// noise.
const LONGEST_REPEAT: usize = 8;
/// A finding is reported only for at least this number of repeated rows.
const FEWEST: usize = 5;

/// Reports rows in which all sensor values equal those of the previous row, although the time stamp differs.
///
/// At rest, rows of coarsely quantised data repeat without any fault. Two rules exclude such natural repeats. First, a
/// repeated row is counted only if the row before it and the row after it each repeat at most one value. Second, there
/// must be more than twice as many repeated rows as rows with five repeated values. Let q be the probability that a
/// channel repeats its value at rest without a fault. All six values repeat with probability q^6, and exactly five of
/// them with probability 6 q^5 (1 - q). Natural repeats therefore satisfy the second rule only if q is above 0.92. A
/// rest without noise is a long sequence of equal rows and is excluded by [`LONGEST_REPEAT`]. If the recording has only
/// one sensor, rows have three values instead of six.
pub(super) fn check(recording: &Recording, repeats: &Repeats) -> Option<Finding> {
    let count = repeats.reported()?;
    let share = 100.0 * repeats.share();
    let has_both = !recording.specific_force.is_absent() && !recording.angular_rate.is_absent();
    let values = if has_both { "six" } else { "three" };
    Some(Finding {
        place: repeats.doubled.place(recording),
        count,
        value: share,
        unit: "%",
        message: format!(
            "{} repeat all {values} values of the row before, the first {}{}",
            repeats.counted(),
            repeats.doubled.first_place(recording),
            repeats.not_examined(recording)
        ),
        way_out: "record at the rate at which the sensor gives new samples, or drop the repeated rows".into(),
        ..Finding::warning("samples_duplicated", recording.name)
    })
}

/// Share of the rows of a recording that repeat all values of the previous row; zero if such rows can occur by
/// coincidence.
pub(crate) fn repeated_share(recording: &Recording<'_>) -> f64 {
    let mut repeats = Repeats::default();
    for start in (0..recording.len()).step_by(PART) {
        repeats.feed(&Part::new(recording, start..(start + PART).min(recording.len())));
    }
    repeats.reported().map_or(0.0, |_| repeats.share())
}

/// Counts of the rows that repeat all values of the previous row, and of the rows that repeat all but one. Such rows
/// are counted only if the row before them and the row after them repeat at most one value.
#[derive(Default)]
pub(super) struct Repeats {
    /// Counter of the rows that repeat all values of the previous row.
    doubled: Tally,
    /// Number of changing rows that follow another changing row, either directly or after a sequence of repeated rows.
    /// A changing row repeats at most one value of the previous row. Repeated rows are counted in `doubled` only
    /// between two changing rows.
    changing: usize,
    /// Number of rows that repeat all but one value of the previous row.
    near: usize,
    /// Whether the row before the current sequence of repeated rows repeats at most one value. Only repeats after
    /// such a row are counted.
    changes_before: bool,
    /// Number of completely repeated rows in the current sequence. A row with two or more new values ends the
    /// sequence.
    equal_rows: usize,
    /// Number of rows with exactly one new value in the current sequence. A row with two or more new values ends the
    /// sequence.
    near_rows: usize,
}

impl Repeats {
    /// Number of rows that repeat all values of the previous row; `None` if so many such rows can occur by coincidence.
    pub(super) fn reported(&self) -> Option<usize> {
        let count = self.doubled.samples;
        (count >= FEWEST && count > 2 * self.near).then_some(count)
    }

    /// Share of the repeated rows among the examined rows. The examined rows are the repeated rows in `doubled` and the
    /// rows in `changing`. Other rows are not examined, because values of coarsely quantised data repeat at rest
    /// without any fault.
    pub(super) fn share(&self) -> f64 {
        self.doubled.samples as f64 / self.examined().max(1) as f64
    }

    fn examined(&self) -> usize {
        self.doubled.samples + self.changing
    }

    /// The number and the share of the repeated rows, as the beginning of a sentence.
    pub(super) fn counted(&self) -> String {
        format!("{} of {} rows ({:.2} %)", self.doubled.samples, self.examined(), 100.0 * self.share())
    }

    /// The end of the sentence that begins with [`Self::counted`]: the number of rows that were not examined.
    pub(super) fn not_examined(&self, recording: &Recording) -> String {
        // The first row has no previous row. The second row is not examined either, because it is unknown whether the
        // first row repeats any values.
        match recording.len().saturating_sub(2 + self.examined()) {
            0 => String::new(),
            others => format!(
                "; the other {others} rows are not counted, because values repeat near them also without a fault, as \
                 coarse values do at rest"
            ),
        }
    }

    pub(super) fn feed(&mut self, part: &Part<'_>) {
        let time_s = part.recording.time_s;
        for (i, equal) in part.equal() {
            if equal == part.all_equal && time_s[i] != time_s[i - 1] {
                self.equal_rows += 1;
            } else if (equal ^ part.all_equal).is_power_of_two() {
                self.near_rows += 1;
            } else {
                let changes = equal & equal.wrapping_sub(1) == 0;
                self.changing += usize::from(self.changes_before && changes);
                if self.equal_rows + self.near_rows > 0 {
                    self.end_of_stretch(i, self.changes_before && changes);
                }
                self.changes_before = changes;
            }
        }
    }

    /// Counts the rows of a finished sequence of repeated rows, if changing rows precede and follow it. Row `i` is the
    /// first row after the sequence.
    fn end_of_stretch(&mut self, i: usize, changes_on_both_sides: bool) {
        if changes_on_both_sides && self.near_rows == 0 && self.equal_rows <= LONGEST_REPEAT {
            (i - self.equal_rows..i).for_each(|row| self.doubled.add(row));
        } else if changes_on_both_sides {
            self.near += self.near_rows;
        }
        (self.equal_rows, self.near_rows) = (0, 0);
    }
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
    fn fine_and_coarse_data_repeat_by_chance_alone() {
        for (force_step, rate_step) in [(1e-4, 1e-5), (0.01, 0.001), (0.04, 0.006), (0.06, 0.009), (0.2, 0.03)] {
            let columns = Columns::tumbling().quantised(force_step, rate_step);
            assert!(found(&columns).is_none(), "{force_step}");
        }
    }

    #[test]
    fn a_rest_without_noise_is_no_repeat() {
        let mut columns = Columns::tumbling();
        for rest in Columns::rests() {
            for i in rest.clone() {
                columns.force[i] = columns.force[rest.start];
                columns.rate[i] = columns.rate[rest.start];
            }
        }
        assert!(found(&columns).is_none());
    }

    #[test]
    fn rows_written_again_are_counted() {
        let mut columns = Columns::tumbling();
        for i in (100..3900).step_by(100) {
            columns.force[i] = columns.force[i - 1];
            columns.rate[i] = columns.rate[i - 1];
        }
        let finding = found(&columns).unwrap();
        assert_eq!((finding.code, finding.count), ("samples_duplicated", 38));
        assert_eq!(finding.place.unwrap().first_sample, 100);
    }

    /// At rest, coarse values repeat also without a fault, so the rows at rest are not counted. The stated share must
    /// nevertheless equal the share of repeated rows in the whole recording.
    #[test]
    fn the_share_of_held_samples_is_right_with_coarse_values_at_rest() {
        for held in [2, 3, 4] {
            let mut columns = Columns::tumbling().quantised(0.06, 0.009);
            for i in 0..4000 {
                columns.force[i] = columns.force[i - i % held];
                columns.rate[i] = columns.rate[i - i % held];
            }
            let finding = found(&columns).unwrap();
            let share = 100.0 * (1.0 - 1.0 / held as f64);
            assert!((finding.value - share).abs() < 2.0, "{held}: {finding}");
            assert!(finding.message.contains("rows are not counted"), "{finding}");
        }
    }

    #[test]
    fn a_sample_held_three_times_is_counted() {
        let mut columns = Columns::tumbling();
        for i in 0..4000 {
            columns.force[i] = columns.force[i - i % 3];
            columns.rate[i] = columns.rate[i - i % 3];
        }
        let finding = found(&columns).unwrap();
        assert!(finding.count > 2600, "{}", finding.count);
    }
}
