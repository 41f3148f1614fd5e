//! Check for rows in which all sensor values are zero, which some loggers write in place of a lost sample.

use super::part::Part;
use super::values::Extremes;
use super::{ACCEL, GYRO, Tally, names};
use crate::finding::{Finding, counted};
use crate::recording::Recording;

/// The rows in which all values of the recorded sensors are exactly zero.
#[derive(Default)]
pub(super) struct Zeros {
    rows: Tally,
}

impl Zeros {
    #[inline(always)]
    pub(super) fn feed(&mut self, part: &Part<'_>) {
        let [no_force, no_rate] =
            [part.recording.specific_force, part.recording.angular_rate].map(|rows| rows.is_absent());
        // Without an accelerometer, zeros are no evidence of a lost sample, because a gyroscope may read zero at rest.
        if no_force {
            return;
        }
        let [force, rate] = part.triads();
        for ((i, force), rate) in part.samples.clone().zip(force).zip(rate) {
            if *force == [0.0; 3] && (no_rate || *rate == [0.0; 3]) {
                self.rows.add(i);
            }
        }
    }
}

/// Reports rows of zeros. An accelerometer at rest measures gravity, so such a row is not a measurement. In the middle
/// of a move, it also falsifies the integral of the angular rate.
///
/// An accelerometer that is constantly zero beside a working gyroscope is reported as stuck instead.
pub(super) fn check(recording: &Recording, zeros: &Zeros, extremes: &Extremes) -> Option<Finding> {
    let [is_force_dead, is_rate_dead] = extremes.ends.map(|ends| ends == [[0.0; 2]; 3]);
    let Tally { samples, .. } = zeros.rows;
    if samples == 0 || (is_force_dead && !is_rate_dead) {
        return None;
    }
    let is_alone = recording.angular_rate.is_absent();
    Some(Finding {
        columns: names(if is_alone { ACCEL.to_vec() } else { [ACCEL, GYRO].concat() }),
        place: zeros.rows.place(recording),
        count: samples,
        value: 100.0 * samples as f64 / recording.len() as f64,
        unit: "%",
        message: format!(
            "all {} values are exactly zero in {}, the first {}: these rows are not measurements, because an \
             accelerometer measures gravity",
            if is_alone { "three" } else { "six" },
            counted(samples, "row"),
            zeros.rows.first_place(recording)
        ),
        way_out:
            "leave these rows out of the file (gaps are detected and handled); do not fill in zeros for lost samples"
                .into(),
        ..Finding::error("samples_zero", recording.name)
    })
}

#[cfg(test)]
mod tests {
    use super::super::example::Columns;
    use super::*;
    use crate::check::survey::Survey;
    use crate::recording::Samples;

    fn found(recording: &Recording) -> Option<Finding> {
        let survey = Survey::of(recording);
        check(recording, &survey.zeros, &survey.extremes)
    }

    #[test]
    fn rows_of_zeros_are_named_and_zeros_of_one_sensor_are_not() {
        let mut columns = Columns::tumbling().quantised(0.06, 0.009);
        assert!(found(&columns.recording()).is_none());
        for i in [777, 778, 2277] {
            columns.rate[i] = [0.0, -0.0, 0.0];
        }
        assert!(found(&columns.recording()).is_none());
        for i in [777, 778, 2277] {
            columns.force[i] = [0.0; 3];
        }
        let finding = found(&columns.recording()).unwrap();
        assert_eq!((finding.code, finding.count), ("samples_zero", 3));
        let place = finding.place.unwrap();
        assert_eq!((place.first_sample, place.last_sample), (777, 778));
        let findings = crate::check::check_columns(&columns.recording());
        assert_eq!(findings.len(), 1, "{findings:?}");

        let accelerometer = Recording { angular_rate: Samples::Absent(4000), ..columns.recording() };
        assert_eq!(found(&accelerometer).unwrap().columns, ACCEL);
        let gyroscope = Recording { specific_force: Samples::Absent(4000), ..columns.recording() };
        assert!(found(&gyroscope).is_none());
    }

    #[test]
    fn a_dead_accelerometer_is_not_a_lost_sample() {
        let mut columns = Columns::tumbling().quantised(0.06, 0.03);
        columns.force.iter_mut().for_each(|row| *row = [0.0; 3]);
        assert!(columns.rate.contains(&[0.0; 3]));
        assert!(found(&columns.recording()).is_none());
        columns.rate.iter_mut().for_each(|row| *row = [0.0; 3]);
        assert_eq!(found(&columns.recording()).unwrap().count, 4000);
    }
}
