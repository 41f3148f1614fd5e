//! Rows held or written again.

use super::Tally;
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
pub(super) fn check(recording: &Recording) -> Option<Finding> {
    let (mut doubled, mut near) = (Tally::default(), 0usize);
    let (mut before, mut equal_rows, mut near_rows) = (6, 0, 0);
    for i in 1..recording.len() {
        let repeats = values_repeated(recording, i);
        let same_time = recording.time_s[i] == recording.time_s[i - 1];
        match repeats {
            6 if !same_time => equal_rows += 1,
            5 => near_rows += 1,
            _ => {
                let changes_on_both_sides = before <= 1 && repeats <= 1;
                if changes_on_both_sides && near_rows == 0 && (1..=LONGEST_REPEAT).contains(&equal_rows) {
                    (i - equal_rows..i).for_each(|row| doubled.add(row));
                } else if changes_on_both_sides && near_rows > 0 {
                    near += near_rows;
                }
                (before, equal_rows, near_rows) = (repeats, 0, 0);
            }
        }
    }
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

/// How many of the six values of row `i` are those of the row before.
fn values_repeated(recording: &Recording, i: usize) -> usize {
    let same = |rows: &[[f64; 3]]| (0..3).filter(|&k| rows[i][k] == rows[i - 1][k]).count();
    same(recording.specific_force) + same(recording.angular_rate)
}

#[cfg(test)]
mod tests {
    use super::super::example::Columns;
    use super::*;

    #[test]
    fn fine_and_coarse_data_repeat_by_chance_alone() {
        for (force_step, rate_step) in [(1e-4, 1e-5), (0.01, 0.001), (0.04, 0.006), (0.06, 0.009), (0.2, 0.03)] {
            let columns = Columns::tumbling().quantised(force_step, rate_step);
            assert!(check(&columns.recording()).is_none(), "{force_step}");
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
        assert!(check(&columns.recording()).is_none());
    }

    #[test]
    fn rows_written_again_are_counted() {
        let mut columns = Columns::tumbling();
        for i in (100..3900).step_by(100) {
            columns.force[i] = columns.force[i - 1];
            columns.rate[i] = columns.rate[i - 1];
        }
        let finding = check(&columns.recording()).unwrap();
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
        let finding = check(&columns.recording()).unwrap();
        assert!(finding.count > 2600, "{}", finding.count);
    }
}
