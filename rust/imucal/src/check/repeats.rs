//! Rows held or written again.

use super::Tally;
use super::part::{ALL_EQUAL, Part};
use crate::finding::Finding;
use crate::recording::Recording;

/// A longer stretch of equal rows is a rest without noise, not a sample held or written again.
const LONGEST_REPEAT: usize = 8;
/// Fewer repeats are not worth a word.
const FEWEST: usize = 5;

/// Rows that repeat the one before in all six values though time goes on: held or written again.
///
/// Coarse data at rest repeat by themselves. There rows in which just five of six values repeat are the more common
/// ones: with a repeat rate q per channel, 6 q^5 (1 - q) against q^6. So repeats are counted only between rows that
/// change (at most one value repeats), and only if they far outnumber such near repeats. A rest without noise is one
/// long stretch of equal rows and is left out by its length.
pub(super) fn check(recording: &Recording, repeats: &Repeats) -> Option<Finding> {
    let Repeats { doubled, near, .. } = repeats;
    if doubled.samples < FEWEST || doubled.samples <= 2 * near {
        return None;
    }
    let share = 100.0 * doubled.samples as f64 / recording.len() as f64;
    Some(Finding {
        place: doubled.place(recording),
        count: doubled.samples,
        value: share,
        unit: "%",
        message: format!(
            "{} rows ({share:.2} %) repeat all six values of the row before, the first {}",
            doubled.samples,
            doubled.first_place(recording)
        ),
        way_out: "record at the rate at which the sensor gives new samples, or drop the repeated rows".into(),
        ..Finding::warning("samples_duplicated", recording.name)
    })
}

/// Repeats between rows that change.
#[derive(Default)]
pub(super) struct Repeats {
    /// Rows in which all six values repeat.
    doubled: Tally,
    /// How many have five that do.
    near: usize,
    /// Since the last row with fewer: whether that one changes, and how many of both there have been.
    changes_before: bool,
    equal_rows: usize,
    near_rows: usize,
}

impl Repeats {
    pub(super) fn feed(&mut self, part: &Part<'_>) {
        let time_s = part.recording.time_s;
        for (i, equal) in part.equal() {
            if equal == ALL_EQUAL && time_s[i] != time_s[i - 1] {
                self.equal_rows += 1;
            } else if (equal ^ ALL_EQUAL).is_power_of_two() {
                self.near_rows += 1;
            } else {
                let changes = equal & equal.wrapping_sub(1) == 0;
                if self.equal_rows + self.near_rows > 0 {
                    self.end_of_stretch(i, self.changes_before && changes);
                }
                self.changes_before = changes;
            }
        }
    }

    /// Row `i` is the first after a stretch of rows that repeat.
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
