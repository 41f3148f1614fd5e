//! Checks of recordings before and during a calibration. Each fault has a stable reason code, a location, a value and a
//! recommended action.
//!
//! The checks run in stages. Each stage runs as soon as its inputs are available. [`check_columns`] uses a single
//! recording, [`check_shared`] uses all recordings, and [`check_rests`] uses the detected rests. [`check_kinematics`]
//! uses a first linear fit of the gyroscope, and [`check_gains`] uses the finished calibration. Several faults of one
//! kind give one finding, which states their number and the location of the first fault. Samples that are not finite
//! (NaN or infinity) are reported once, and all other checks ignore them.

mod axes;
mod bursts;
mod clock;
mod continuity;
#[cfg(test)]
mod example;
mod gains;
mod gaps;
mod gravity_sign;
mod identical;
mod independence;
mod kinematics;
mod noise_search;
mod noise_tape;
mod part;
mod plateau;
mod plausible;
mod rails;
mod repeats;
mod runs;
mod shared;
mod spikes;
mod stamps;
mod stuck;
mod survey;
mod temperature;
mod units;
mod unsigned;
mod values;
mod zeros;

use survey::Survey;

pub use gains::{check_accelerometer_gains, check_gains};
pub use independence::{AtRest, at_rest, check_control, check_independent};
pub(crate) use kinematics::check_calibrated;
pub use kinematics::check_kinematics;
pub use plausible::{RestNoise, check_noise};
pub use rails::saturated_samples;
pub(crate) use repeats::repeated_share;
pub use shared::check_shared;
pub(crate) use stamps::from_sensor as stamps_from_sensor;
pub use temperature::{TEMPERATURE_DEGC, check_temperature};
pub use units::check_rests;
pub use unsigned::check_counts;

use crate::finding::{Finding, Place};
use crate::recording::{RawUnit, Recording};

/// Runs all checks that do not need detected rests, before a calculation that needs both sensors. An empty result means
/// that no fault was found.
///
/// The findings are those of [`check_one_or_both`]. If the recording has only one sensor, `sensor_missing` is added.
pub fn check_columns(recording: &Recording) -> Vec<Finding> {
    sensor_missing(recording).into_iter().chain(check_one_or_both(recording)).collect()
}

/// Returns the finding `sensor_missing` for a recording of only one sensor; `None` if the recording has both sensors.
pub fn sensor_missing(recording: &Recording) -> Option<Finding> {
    let (absent, present, columns) = match (recording.specific_force.is_absent(), recording.angular_rate.is_absent()) {
        (false, false) => return None,
        (false, true) => ("gyroscope", "accelerometer", GYRO),
        (true, _) => ("accelerometer", "gyroscope", ACCEL),
    };
    Some(Finding {
        columns: names(columns),
        count: recording.len(),
        unit: "samples",
        message: format!(
            "there is no {absent}: this calculation needs both sensors, but the recording has only the {present}"
        ),
        way_out: format!("add the columns of the {absent}; docs/one-sensor.md lists what one sensor alone allows"),
        ..Finding::error("sensor_missing", recording.name)
    })
}

/// Runs all checks that do not need detected rests, for recordings with one sensor or both. An empty result means that
/// no fault was found.
///
/// Codes: `lengths_differ`, `empty`, `too_short`, `non_finite`, `value_impossible`, `time_not_increasing`,
/// `samples_zero`, `samples_duplicated`, `samples_missing`, `samples_spiked`, `clock_irregular`, `clock_rate`,
/// `stuck_axis`, `columns_identical`, `counts_unsigned`, `accel_saturation`, `gyro_saturation`, `accel_units`,
/// `gyro_units`, `temperature_implausible`, `temperature_jump`.
pub fn check_one_or_both(recording: &Recording) -> Vec<Finding> {
    if let Err(error) = recording.check_lengths() {
        return vec![Finding {
            count: recording.len(),
            value: recording.len() as f64,
            unit: "samples",
            message: error.to_string(),
            way_out: "give columns of one length".into(),
            ..Finding::error("lengths_differ", recording.name)
        }];
    }
    if recording.is_empty() {
        return vec![Finding {
            unit: "samples",
            message: "there is no sample".into(),
            way_out: "record rests in many poses with moves between them; check that the file was written to its end"
                .into(),
            ..Finding::error("empty", recording.name)
        }];
    }
    let mut survey = Survey::of(recording);
    let mut findings = values::check_finite(recording, &survey.not_finite);
    findings.extend(clock::check(recording, &survey.steps));
    let mut not_measured = values::check_possible(recording, &survey.extremes);
    not_measured.extend(zeros::check(recording, &survey.zeros, &survey.extremes));
    if !not_measured.is_empty() {
        // Values that no sensor has measured distort the statistics of all later checks, so these checks are skipped.
        findings.extend(not_measured);
        return findings;
    }
    findings.extend(stuck::check(recording, &survey.runs));
    findings.extend(identical::check(recording, &survey.identical, &survey.extremes));
    findings.extend(spikes::check(recording, &mut survey.spikes));
    let discontinuous = continuity::check(recording, &survey.repeats);
    let counts_repeats = discontinuous.as_ref().is_some_and(|finding| finding.code == "samples_duplicated");
    findings.extend(repeats::check(recording, &survey.repeats).filter(|_| !counts_repeats));
    findings.extend(discontinuous);
    let unsigned = unsigned::check(recording, &survey);
    let is_unsigned = |column: &String| unsigned.iter().any(|wrong| wrong.columns.contains(column));
    // A channel whose counts wrap around at zero reaches both ends of the number range without being saturated, so its
    // saturation is not reported.
    findings
        .extend(rails::check(recording, &survey).into_iter().filter(|rails| !rails.columns.iter().any(is_unsigned)));
    findings.extend(unsigned);
    findings.extend(units::check(recording, (&survey.lengths, &survey.extremes)));
    findings.extend(temperature::check(recording));
    findings
}

pub(crate) const ACCEL: [&str; 3] = ["accel_x", "accel_y", "accel_z"];
pub(crate) const GYRO: [&str; 3] = ["gyro_x", "gyro_y", "gyro_z"];
/// Names of the six sensor columns, accelerometer first.
pub(crate) const CHANNELS: [&str; 6] = ["accel_x", "accel_y", "accel_z", "gyro_x", "gyro_y", "gyro_z"];

impl Place {
    fn new(recording: &Recording, first_sample: usize, last_sample: usize) -> Self {
        Self {
            first_sample,
            last_sample,
            start_s: recording.time_s[first_sample],
            end_s: recording.time_s[last_sample],
        }
    }
}

/// Counts the samples in which a check finds a fault, and the runs (intervals of consecutive faulty samples). Also
/// stores the first and last sample of the first run. Samples must be added in ascending order.
#[derive(Clone, Copy, Default)]
struct Tally {
    samples: usize,
    runs: usize,
    first: Option<(usize, usize)>,
    last: Option<usize>,
}

impl Tally {
    fn add(&mut self, sample: usize) {
        self.samples += 1;
        if self.last.is_none_or(|last| last + 1 != sample) {
            self.runs += 1;
        }
        self.last = Some(sample);
        self.first = match self.first {
            None => Some((sample, sample)),
            Some((start, end)) if self.runs == 1 && end + 1 == sample => Some((start, sample)),
            first => first,
        };
    }

    fn place(&self, recording: &Recording) -> Option<Place> {
        self.first.map(|(start, end)| Place::new(recording, start, end))
    }

    /// Returns a text that states the time of the first run of faulty samples: "at 3.20 s" or "from 3.20 s to 3.40 s".
    fn first_place(&self, recording: &Recording) -> String {
        self.place(recording).map_or_else(String::new, |place| place.to_string())
    }
}

/// The unit of the raw data of a sensor, as messages name it: "lsb" for counts, and the text `si` for data in SI units.
pub(crate) fn unit_name(unit: RawUnit, si: &'static str) -> &'static str {
    match unit {
        RawUnit::Si => si,
        RawUnit::Lsb => "lsb",
    }
}

fn names<S: ToString>(columns: impl IntoIterator<Item = S>) -> Vec<String> {
    columns.into_iter().map(|name| name.to_string()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_sample_is_empty_and_columns_must_be_of_one_length() {
        let empty = Recording::try_new("e.csv", &[], &[], &[]).unwrap();
        let findings = check_columns(&empty);
        assert_eq!(findings[0].code, "empty");
        assert!(check_rests(&empty, &[], 9.80665).is_empty());
        assert!(saturated_samples(&empty).is_empty());

        let torn = Recording { time_s: &[0.0, 0.01], ..empty };
        assert_eq!(check_columns(&torn)[0].code, "lengths_differ");
        assert!(saturated_samples(&torn).is_empty());
    }

    #[test]
    fn one_and_two_samples_are_too_short_and_nothing_worse() {
        for n in [1, 2] {
            let time = [0.0, 0.01];
            let force = [[0.1, 0.2, 9.8], [0.1, 0.3, 9.7]];
            let rate = [[0.01, 0.02, 0.03], [0.02, 0.01, 0.02]];
            let recording = Recording::try_new("s", &time[..n], &force[..n], &rate[..n]).unwrap();
            let findings = check_columns(&recording);
            assert_eq!(findings.len(), 1, "{findings:?}");
            assert_eq!(findings[0].code, "too_short");
        }
    }

    #[test]
    fn tally_keeps_the_first_stretch() {
        let mut tally = Tally::default();
        for sample in [4, 5, 6, 9, 10, 7] {
            tally.add(sample);
        }
        assert_eq!((tally.samples, tally.runs, tally.first), (6, 3, Some((4, 6))));
    }
}
