//! Check for columns with the same values, such as an axis that was written twice.

use super::part::Part;
use super::values::Extremes;
use super::{CHANNELS, names};
use crate::finding::Finding;
use crate::recording::Recording;

/// The pairs of channels whose values are equal in all samples processed so far.
///
/// Samples in which a channel of the pair is not finite are ignored. `compared` is the number of the other samples.
pub(super) struct Identical {
    pairs: Vec<Pair>,
}

#[derive(Clone, Copy)]
struct Pair {
    channels: [usize; 2],
    compared: usize,
}

impl Default for Identical {
    fn default() -> Self {
        let pair = |one, other| Pair { channels: [one, other], compared: 0 };
        Self { pairs: (0..6).flat_map(|one| (one + 1..6).map(move |other| pair(one, other))).collect() }
    }
}

impl Identical {
    pub(super) fn feed(&mut self, part: &Part<'_>) {
        let is_recorded = |channel: usize| part.all_equal >> channel & 1 == 1;
        self.pairs.retain(|pair| pair.channels.into_iter().all(is_recorded));
        // In most recordings, any two channels differ in the first samples, so no pair is left for the later samples.
        if self.pairs.is_empty() {
            return;
        }
        let [force, rate] = part.triads();
        for ([fx, fy, fz], [wx, wy, wz]) in force.iter().zip(rate) {
            let row = [fx, fy, fz, wx, wy, wz];
            self.pairs.retain_mut(|pair| {
                let [one, other] = pair.channels.map(|channel| row[channel]);
                let is_compared = (one - other).is_finite();
                pair.compared += usize::from(is_compared);
                !is_compared || one == other
            });
        }
    }
}

/// Reports pairs of columns that are equal in all samples, except columns with a constant value. The noise of two axes
/// is never the same, so equal columns contain the data of one axis twice. Pairs that are not finite together in more
/// than half of the samples are not reported.
pub(super) fn check(recording: &Recording, identical: &Identical, extremes: &Extremes) -> Option<Finding> {
    let ends: Vec<[f64; 2]> = extremes.ends.into_iter().flatten().collect();
    let changes = |channel: usize| ends[channel][0] < ends[channel][1];
    let is_equal = |pair: &&Pair| 2 * pair.compared > recording.len() && pair.channels.into_iter().all(changes);
    let pairs: Vec<[usize; 2]> = identical.pairs.iter().filter(is_equal).map(|pair| pair.channels).collect();
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
    fn sensors_in_separate_rows_are_not_equal() {
        let mut columns = Columns::tumbling();
        let rows = columns.force.iter_mut().zip(&mut columns.rate).enumerate();
        rows.for_each(|(i, (force, rate))| *(if i % 2 == 0 { force } else { rate }) = [f64::NAN; 3]);
        assert!(found(&columns).is_none());
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
