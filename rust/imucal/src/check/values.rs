//! Single columns: numbers that are none, and temperature that jumps.

use super::{ACCEL, GYRO, Tally, names};
use crate::finding::Finding;
use crate::recording::Recording;
use crate::stats::quantile;

/// Temperature step between neighbours, K.
const TEMPERATURE_STEP_K: f64 = 5.0;

/// NaN and infinity, by column; the stand's columns are not fitted, so there it is only a warning.
pub(super) fn check_finite(recording: &Recording) -> Vec<Finding> {
    let (mut bad, mut columns) = (Tally::default(), [false; 7]);
    let (mut bad_stand, mut stand_columns) = (Tally::default(), [false; 3]);
    for i in 0..recording.len() {
        let [fx, fy, fz] = recording.specific_force[i];
        let [wx, wy, wz] = recording.angular_rate[i];
        if mark([recording.time_s[i], fx, fy, fz, wx, wy, wz], &mut columns) {
            bad.add(i);
        }
        if recording.stand_rad.is_some_and(|stand| mark(stand[i], &mut stand_columns)) {
            bad_stand.add(i);
        }
    }
    let sensors = [&["time_s"], &ACCEL[..], &GYRO[..]].concat();
    let stand = ["stand_1", "stand_2", "stand_3"];
    let mut findings = Vec::new();
    for (tally, names, marked, kind) in [
        (bad, &sensors[..], &columns[..], Finding::error as fn(_, &_) -> _),
        (bad_stand, &stand[..], &stand_columns[..], Finding::warning),
    ] {
        if tally.samples > 0 {
            findings.push(not_finite(recording, tally, names, marked, kind("non_finite", recording.name)));
        }
    }
    findings
}

/// Notes the columns whose value is not finite; true if there is one.
fn mark<const N: usize>(row: [f64; N], columns: &mut [bool; N]) -> bool {
    let mut any = false;
    for (value, column) in row.iter().zip(columns) {
        if !value.is_finite() {
            *column = true;
            any = true;
        }
    }
    any
}

fn not_finite(recording: &Recording, tally: Tally, all: &[&str], marked: &[bool], kind: Finding) -> Finding {
    let columns = names(all.iter().zip(marked).filter(|(_, bad)| **bad).map(|(name, _)| name));
    let share = 100.0 * tally.samples as f64 / recording.len() as f64;
    let first = tally.first.map_or(0, |(first, _)| first);
    Finding {
        place: tally.place(recording),
        count: tally.samples,
        value: share,
        unit: "%",
        message: format!(
            "{} hold NaN or infinity in {} samples ({share:.2} %), the first in sample {first}",
            columns.join(", "),
            tally.samples
        ),
        way_out: "drop those rows (a gap is seen and handled) or repair the reader; do not fill them with zeros".into(),
        columns,
        ..kind
    }
}

/// Largest less smallest finite value; 0 without any.
pub(super) fn range(rows: &[[f64; 3]], axis: usize) -> f64 {
    let [low, high] = extremes(rows, axis);
    (high - low).max(0.0)
}

/// Smallest and largest finite value; [inf, -inf] without any.
pub(super) fn extremes(rows: &[[f64; 3]], axis: usize) -> [f64; 2] {
    let values = rows.iter().map(|row| row[axis]).filter(|v| v.is_finite());
    // Without NaN there is no need for the slower minimum that takes care of it.
    values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], v| {
        [if v < low { v } else { low }, if v > high { v } else { high }]
    })
}

/// The converter's step: the size of the smallest differences between neighbours that are not zero, 5 % of them being
/// smaller. Differences of rounding size are left out, and odd ones, as at a limit between two steps, do not count.
/// Infinite for a constant.
pub(super) fn converter_step(rows: &[[f64; 3]], axis: usize) -> f64 {
    let rounding = 1e-9 * range(rows, axis);
    let differences = rows.windows(2).map(|pair| (pair[1][axis] - pair[0][axis]).abs());
    let mut steps: Vec<f64> = differences.filter(|step| *step > rounding && step.is_finite()).collect();
    if steps.is_empty() {
        return f64::INFINITY;
    }
    quantile(&mut steps, 0.05)
}

/// Steps of more than 5 K between neighbours, and values that are not finite.
pub(super) fn check_temperature(recording: &Recording) -> Option<Finding> {
    let temperature = recording.temperature_degc?;
    let (mut jumps, mut largest, mut not_finite) = (Tally::default(), 0.0f64, 0);
    for i in 0..temperature.len() {
        let step = if i == 0 { 0.0 } else { (temperature[i] - temperature[i - 1]).abs() };
        if !temperature[i].is_finite() {
            not_finite += 1;
            jumps.add(i);
        } else if step.is_finite() && step > TEMPERATURE_STEP_K {
            largest = largest.max(step);
            jumps.add(i);
        }
    }
    (jumps.samples > 0).then(|| Finding {
        columns: names(["temp_degc"]),
        place: jumps.place(recording),
        count: jumps.samples,
        value: largest,
        unit: "K",
        message: format!(
            "the temperature jumps by more than {TEMPERATURE_STEP_K:.0} K {} times (at most {largest:.1} K) and is not a number in {not_finite} samples, first {}",
            jumps.samples - not_finite,
            jumps.first_place(recording)
        ),
        way_out: "a sensor cannot warm up so fast: repair or drop the temperature column".into(),
        ..Finding::warning("temperature_jump", recording.name)
    })
}

#[cfg(test)]
mod tests {
    use super::super::example::Columns;
    use super::*;
    use crate::finding::Severity;

    #[test]
    fn a_clean_recording_has_nothing() {
        for columns in [Columns::tumbling(), Columns::tumbling().quantised(0.05, 0.01)] {
            let recording = columns.recording();
            assert!(check_finite(&recording).is_empty());
            assert!(check_temperature(&recording).is_none());
        }
    }

    #[test]
    fn nan_names_its_columns_and_its_place() {
        let mut columns = Columns::tumbling();
        columns.force[70][1] = f64::NAN;
        columns.force[71][1] = f64::INFINITY;
        columns.rate[90][2] = f64::NAN;
        let findings = check_finite(&columns.recording());
        assert_eq!(findings.len(), 1);
        assert_eq!(findings[0].columns, ["accel_y", "gyro_z"]);
        assert_eq!(findings[0].count, 3);
        let place = findings[0].place.unwrap();
        assert_eq!((place.first_sample, place.last_sample), (70, 71));
    }

    #[test]
    fn nan_in_the_stand_is_a_warning() {
        let columns = Columns::tumbling();
        let mut stand = vec![[0.0; 3]; columns.time_s.len()];
        stand[5][0] = f64::NAN;
        let recording = Recording { stand_rad: Some(&stand), ..columns.recording() };
        let findings = check_finite(&recording);
        assert_eq!(findings[0].severity, Severity::Warning);
        assert_eq!(findings[0].columns, ["stand_1"]);
    }

    #[test]
    fn temperature_may_drift_but_not_jump() {
        let columns = Columns::tumbling();
        let mut temperature: Vec<f64> = (0..4000).map(|i| 20.0 + 0.005 * i as f64).collect();
        let check = |temperature: &[f64]| {
            check_temperature(&Recording { temperature_degc: Some(temperature), ..columns.recording() })
        };
        assert!(check(&temperature).is_none());
        temperature[2000] = -40.0;
        temperature[3000] = f64::NAN;
        let finding = check(&temperature).unwrap();
        assert_eq!((finding.count, finding.severity), (3, Severity::Warning));
        assert!(finding.value > 60.0);
    }
}
