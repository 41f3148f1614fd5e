//! Check for samples that occur in two recordings. Such samples would be used twice, which would reduce the standard
//! deviations without adding information.

use std::collections::HashMap;

use crate::finding::{Finding, Place};
use crate::recording::Recording;

/// Two recordings count as overlapping if at least this number of consecutive rows are identical. The noise of
/// independent recordings never coincides over so many rows.
const SHARED_ROWS: usize = 100;

/// Map from the bits of a row (six sensor values) to three indices: the index of its recording, the index of the row
/// after removal of consecutive duplicates, and the index of the row in the recording.
type Seen = HashMap<[u64; 6], (usize, usize, usize)>;

/// Reports `recordings_overlap` for every recording that contains an interval of an earlier recording in the list. Time
/// stamps are ignored.
pub fn check_shared(recordings: &[Recording]) -> Vec<Finding> {
    // A single recording needs no comparison, so the large hash table is not built.
    if recordings.len() < 2 {
        return Vec::new();
    }
    let mut seen = Seen::new();
    let mut findings = Vec::new();
    for (k, recording) in recordings.iter().enumerate() {
        findings.extend(shared_with_earlier(recording, recordings, &seen));
        for (n, i) in changes(recording).enumerate() {
            seen.insert(row_bits(recording, i), (k, n, i));
        }
    }
    findings
}

/// Reports the first [`SHARED_ROWS`] consecutive rows that are also consecutive in an earlier recording of the list.
fn shared_with_earlier(recording: &Recording, recordings: &[Recording], seen: &Seen) -> Option<Finding> {
    let (mut count, mut start, mut before) = (0, [0, 0], None);
    for i in changes(recording) {
        let twin = seen.get(&row_bits(recording, i)).copied();
        let follows = matches!((before, twin), (Some((k, j, _)), Some((l, m, _))) if k == l && j + 1 == m);
        before = twin;
        let Some((k, _, at)) = twin else { continue };
        if !follows {
            (count, start) = (0, [i, at]);
        }
        count += 1;
        if count == SHARED_ROWS {
            let place = Place::new(recording, start[0], i);
            return Some(Finding {
                place: Some(place),
                count: SHARED_ROWS,
                value: SHARED_ROWS as f64,
                unit: "samples",
                message: format!(
                    "{SHARED_ROWS} consecutive samples {place} are identical to those of {} from sample {}",
                    recordings[k].name, start[1]
                ),
                way_out: "give every recording once: repeated data add no information, and the stated accuracy would be wrong"
                    .into(),
                ..Finding::error("recordings_overlap", recording.name)
            });
        }
    }
    None
}

/// Number of rows (samples) of a recording. It is 0 if the columns have different lengths, because another finding
/// reports this fault.
fn rows(recording: &Recording) -> usize {
    if recording.check_lengths().is_ok() { recording.len() } else { 0 }
}

/// Returns the indices of the rows that differ from the previous row. If a row was repeated or written twice, only its
/// first copy is returned.
fn changes<'a>(recording: &'a Recording<'_>) -> impl Iterator<Item = usize> + 'a {
    (0..rows(recording)).filter(|&i| i == 0 || row_bits(recording, i) != row_bits(recording, i - 1))
}

fn row_bits(recording: &Recording, i: usize) -> [u64; 6] {
    let ([fx, fy, fz], [wx, wy, wz]) = (recording.specific_force.at(i), recording.angular_rate.at(i));
    [fx, fy, fz, wx, wy, wz].map(f64::to_bits)
}

#[cfg(test)]
mod tests {
    use super::super::example::Columns;
    use super::*;

    #[test]
    fn a_recording_given_twice_or_in_part_is_found_at_its_place() {
        let columns = Columns::tumbling();
        let whole = columns.recording();
        let later: Vec<f64> = columns.time_s.iter().map(|t| t + 1000.0).collect();
        let again = Recording { name: "again", time_s: &later, ..whole };
        let cut = |range: std::ops::Range<usize>| {
            Recording::try_new(
                "cut",
                &columns.time_s[range.clone()],
                &columns.force[range.clone()],
                &columns.rate[range],
            )
            .unwrap()
        };
        for (other, sample) in [(again, 0), (cut(700..1500), 700)] {
            let findings = check_shared(&[whole, other]);
            assert_eq!((findings.len(), findings[0].code), (1, "recordings_overlap"));
            assert!(findings[0].message.ends_with(&format!("example from sample {sample}")), "{}", findings[0]);
        }
        assert!(check_shared(&[cut(0..1500), cut(1500..4000)]).is_empty());
        assert!(check_shared(&[whole]).is_empty());
    }

    #[test]
    fn a_copy_whose_rows_were_held_is_a_copy() {
        let columns = Columns::tumbling();
        let whole = columns.recording();
        fn held<T: Copy>(rows: &[T]) -> Vec<T> {
            rows.iter().flat_map(|row| [*row; 2]).collect()
        }
        let time_s: Vec<f64> = (0..2 * whole.len()).map(|k| k as f64 * 0.005).collect();
        let (force, rate) = (held(&columns.force), held(&columns.rate));
        let doubled = Recording::try_new("doubled", &time_s, &force, &rate).unwrap();
        for (first, second) in [(whole, doubled), (doubled, doubled), (doubled, whole)] {
            let findings = check_shared(&[first, second]);
            assert_eq!((findings.len(), findings[0].code), (1, "recordings_overlap"));
            assert!(findings[0].message.ends_with("from sample 0"), "{}", findings[0]);
        }
    }

    #[test]
    fn rests_without_noise_are_no_copies() {
        let still = vec![[0.0, 0.0, 9.80665]; 1000];
        let (time, zero) = ((0..1000).map(f64::from).collect::<Vec<_>>(), vec![[0.0; 3]; 1000]);
        let recording = Recording::try_new("still", &time, &still, &zero).unwrap();
        assert!(check_shared(&[recording, recording]).is_empty());
    }
}
