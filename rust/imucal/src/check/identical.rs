//! Check for columns with the same values, such as an axis that was written twice.

use super::part::Part;
use super::values::Extremes;
use super::{CHANNELS, names};
use crate::finding::Finding;
use crate::recording::Recording;

/// The pairs of channels whose values are equal in all samples processed so far. Samples that are not finite are
/// ignored.
pub(super) struct Identical {
    pairs: Vec<[usize; 2]>,
}

impl Default for Identical {
    fn default() -> Self {
        Self { pairs: (0..6).flat_map(|one| (one + 1..6).map(move |other| [one, other])).collect() }
    }
}

impl Identical {
    pub(super) fn feed(&mut self, part: &Part<'_>) {
        let is_recorded = |channel: usize| part.all_equal >> channel & 1 == 1;
        self.pairs.retain(|&[one, other]| is_recorded(one) && is_recorded(other));
        // In most recordings, any two channels differ in the first samples, so no pair is left for the later samples.
        if self.pairs.is_empty() {
            return;
        }
        let [force, rate] = part.triads();
        for ([fx, fy, fz], [wx, wy, wz]) in force.iter().zip(rate) {
            let row = [fx, fy, fz, wx, wy, wz];
            self.pairs.retain(|&[one, other]| row[one] == row[other] || !(row[one] - row[other]).is_finite());
        }
    }
}

/// Reports pairs of columns that are equal in all samples, except columns with a constant value. The noise of two axes
/// is never the same, so equal columns contain the data of one axis twice.
pub(super) fn check(recording: &Recording, identical: &Identical, extremes: &Extremes) -> Option<Finding> {
    let ends: Vec<[f64; 2]> = extremes.ends.into_iter().flatten().collect();
    let changes = |channel: usize| ends[channel][0] < ends[channel][1];
    let pairs: Vec<[usize; 2]> =
        identical.pairs.iter().copied().filter(|&[one, other]| changes(one) && changes(other)).collect();
    if pairs.is_empty() {
        return None;
    }
    let is_affected = |channel: &usize| pairs.iter().any(|pair| pair.contains(channel));
    let parts: Vec<String> =
        pairs.iter().map(|&[one, other]| format!("{} equals {}", CHANNELS[other], CHANNELS[one])).collect();
    Some(Finding {
        columns: names((0..6).filter(is_affected).map(|channel| CHANNELS[channel])),
        count: recording.len(),
        value: pairs.len() as f64,
        unit: "pairs",
        message: format!("{} in all {} samples", parts.join(", "), recording.len()),
        way_out: "a column was written or named twice: correct the program that writes the file, or the names of the \
                  columns; other motion does not help"
            .into(),
        ..Finding::error("columns_identical", recording.name)
    })
}

#[cfg(test)]
mod tests {
    use super::super::example::Columns;
    use super::*;
    use crate::check::survey::Survey;

    fn found(columns: &Columns) -> Option<Finding> {
        let survey = Survey::of(&columns.recording());
        check(&columns.recording(), &survey.identical, &survey.extremes)
    }

    #[test]
    fn a_column_that_was_written_twice_is_named() {
        for (force_step, rate_step) in [(1e-4, 1e-5), (0.06, 0.009)] {
            let mut columns = Columns::tumbling().quantised(force_step, rate_step);
            assert!(found(&columns).is_none());
            columns.rate.iter_mut().for_each(|row| row[1] = row[0]);
            columns.rate[50] = [f64::NAN, 0.0, 0.0];
            let finding = found(&columns).unwrap();
            assert_eq!((finding.code, &finding.columns[..]), ("columns_identical", &names(["gyro_x", "gyro_y"])[..]));
            columns.rate[3999][1] += rate_step;
            assert!(found(&columns).is_none());
        }
    }

    #[test]
    fn columns_of_two_sensors_may_be_equal_and_constant_ones_are_not_reported() {
        let mut columns = Columns::tumbling();
        columns.rate.iter_mut().zip(&columns.force).for_each(|(rate, force)| *rate = [force[2], 0.0, 0.0]);
        assert_eq!(found(&columns).unwrap().columns, ["accel_z", "gyro_x"]);
        columns.rate.iter_mut().for_each(|row| row[0] = 0.0);
        assert!(found(&columns).is_none());
    }
}
