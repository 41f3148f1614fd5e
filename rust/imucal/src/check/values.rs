//! Checks single columns for values that are not finite and for values that no sensor can measure. Also computes the
//! resolution of the converter.

use super::part::{Part, all_finite};
use super::{ACCEL, GYRO, Tally, names, unit_name};
use crate::finding::Finding;
use crate::numerics::stats::quantile;
use crate::recording::{RawUnit, Recording, Samples};

/// Largest specific force that a sensor can measure, m/s^2. It is ten thousand times gravity, and twenty times the
/// widest range of MEMS accelerometers that resolve gravity (ADXL1004, 500 g).
const LARGEST_FORCE_MPS2: f64 = 1e5;
/// Largest angular rate that a sensor can measure, rad/s. It is thirty times the widest range of MEMS gyroscopes
/// (ADXRS649, 20000 deg/s).
const LARGEST_RATE_RADPS: f64 = 1e4;
/// Largest magnitude of a raw count. The widest output of converters is a signed integer of 32 bits.
const LARGEST_COUNT: f64 = 2_147_483_648.0;
/// If more than this share of a sensor's samples has values that no sensor can measure, the finding names a wrong unit
/// of measurement as the cause.
const WRONG_UNIT_SHARE: f64 = 0.01;
/// If more than this share of the rows has only accelerometer values, and more than this share has only gyroscope
/// values, each sensor has its own time stamps.
const OWN_ROWS: f64 = 0.1;

/// Samples with NaN or infinity, and the columns in which these values occur.
#[derive(Default)]
pub(super) struct NotFinite {
    bad: Tally,
    columns: [bool; 7],
    /// Number of samples that have only gyroscope values, and number of samples that have only accelerometer values.
    alone: [usize; 2],
    bad_stand: Tally,
    stand_columns: [bool; 3],
}

impl NotFinite {
    #[inline(always)]
    pub(super) fn feed(&mut self, part: &Part<'_>) {
        let recording = part.recording;
        if !part.is_finite {
            for i in part.samples.clone() {
                // Columns of an absent sensor do not count as missing values.
                let [[fx, fy, fz], [wx, wy, wz]] = [recording.specific_force, recording.angular_rate]
                    .map(|rows| if rows.is_absent() { [0.0; 3] } else { rows.at(i) });
                if mark([recording.time_s[i], fx, fy, fz, wx, wy, wz], &mut self.columns) {
                    self.bad.add(i);
                    let [no_force, no_rate] =
                        [[fx, fy, fz], [wx, wy, wz]].map(|row| row.iter().all(|v| !v.is_finite()));
                    let [force, rate] = [[fx, fy, fz], [wx, wy, wz]].map(|row| row.iter().all(|v| v.is_finite()));
                    self.alone[0] += usize::from(no_force && rate);
                    self.alone[1] += usize::from(no_rate && force);
                }
            }
        }
        if let Some(stand) = recording.stand_rad
            && !all_finite(stand[part.samples.clone()].as_flattened())
        {
            for i in part.samples.clone() {
                if mark(stand[i], &mut self.stand_columns) {
                    self.bad_stand.add(i);
                }
            }
        }
    }

    /// Whether the rows are an outer join of two tables, one per sensor, with different time stamps. Many rows then
    /// have values of only one sensor.
    fn is_outer_join(&self, samples: usize) -> bool {
        self.alone.iter().all(|&alone| alone as f64 > OWN_ROWS * samples as f64)
    }

    /// Number of samples with a value that is not finite, and the first and last index of the first interval of such
    /// samples.
    #[cfg(test)]
    pub(super) fn samples(&self) -> (usize, Option<(usize, usize)>) {
        (self.bad.samples, self.bad.first)
    }
}

/// Reports NaN and infinity, and names their columns. In the columns with the motor angles of a stand, the finding is
/// only a warning, because only the effects of the angle encoders need these columns.
pub(super) fn check_finite(recording: &Recording, not_finite: &NotFinite) -> Vec<Finding> {
    let NotFinite { bad, columns, bad_stand, stand_columns, alone, .. } = not_finite;
    let sensors = [&["time_s"], &ACCEL[..], &GYRO[..]].concat();
    let stand = ["stand_1", "stand_2", "stand_3"];
    let mut findings = Vec::new();
    for (tally, names, marked, kind) in [
        (bad, &sensors[..], &columns[..], Finding::error as fn(_, &_) -> _),
        (bad_stand, &stand[..], &stand_columns[..], Finding::warning),
    ] {
        if tally.samples > 0 {
            findings.push(missing_numbers(recording, *tally, names, marked, kind("non_finite", recording.name)));
        }
    }
    if let Some(joined) = findings.first_mut().filter(|_| not_finite.is_outer_join(recording.len())) {
        let [rate, force] = alone;
        joined.message = format!(
            "accelerometer and gyroscope are in separate rows: {force} samples have NaN for the gyroscope only, {rate} for \
             the accelerometer only"
        );
        joined.way_out =
            "the two sensors have different time stamps: first interpolate the columns of one sensor to the time \
                          stamps of the other, and keep only those rows"
                .into();
    }
    findings
}

/// Reports finite values that no sensor can measure, for example damaged numbers, and the place of the first one. Such
/// values distort the statistics of all other checks.
pub(super) fn check_possible(recording: &Recording, extremes: &Extremes) -> Vec<Finding> {
    let triads = [
        (recording.specific_force, ACCEL, recording.accel_unit, LARGEST_FORCE_MPS2, "m/s^2"),
        (recording.angular_rate, GYRO, recording.gyro_unit, LARGEST_RATE_RADPS, "rad/s"),
    ];
    let mut findings = Vec::new();
    for ((rows, columns, unit, largest, si), ends) in triads.into_iter().zip(&extremes.ends) {
        let largest = if unit == RawUnit::Lsb { LARGEST_COUNT } else { largest };
        // The extremes of a channel without finite values are [inf, -inf]. They are not reported here.
        let is_beyond = |value: f64| value.is_finite() && value.abs() > largest;
        if !ends.iter().flatten().any(|end| is_beyond(*end)) {
            continue;
        }
        let (mut bad, mut marked, mut first) = (Tally::default(), [false; 3], None);
        for (i, row) in rows.iter().enumerate() {
            for axis in (0..3).filter(|axis| is_beyond(row[*axis])) {
                if marked == [false; 3] {
                    first = Some((axis, row[axis]));
                }
                marked[axis] = true;
                if bad.last != Some(i) {
                    bad.add(i);
                }
            }
        }
        let Some((axis, value)) = first else { continue };
        let sample = bad.first.map_or(0, |(first, _)| first);
        let unit = unit_name(unit, si);
        let is_unit = bad.samples as f64 > WRONG_UNIT_SHARE * recording.len() as f64;
        let way_out = if is_unit {
            format!("give the unit of {} as it is, and check its columns", if si == "rad/s" { "gyro" } else { "accel" })
        } else {
            "leave out these rows (gaps are detected and handled), and check the file for damage".to_owned()
        };
        findings.push(Finding {
            columns: names(columns.iter().zip(marked).filter(|(_, bad)| *bad).map(|(name, _)| name)),
            place: bad.place(recording),
            count: bad.samples,
            value,
            unit,
            message: format!(
                "{} {} above {largest:.0e} {unit}, which no sensor measures; the first is {value:.3e} in {}, sample {sample}, {}",
                bad.samples,
                if bad.samples == 1 { "sample is" } else { "samples are" },
                columns[axis],
                bad.first_place(recording)
            ),
            way_out,
            ..Finding::error("value_impossible", recording.name)
        });
    }
    findings
}

/// Sets `columns[k]` to true if `row[k]` is not finite. Returns whether any value in `row` is not finite.
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

fn missing_numbers(recording: &Recording, tally: Tally, all: &[&str], marked: &[bool], kind: Finding) -> Finding {
    let columns = names(all.iter().zip(marked).filter(|(_, bad)| **bad).map(|(name, _)| name));
    let share = 100.0 * tally.samples as f64 / recording.len() as f64;
    let first = tally.first.map_or(0, |(first, _)| first);
    Finding {
        place: tally.place(recording),
        count: tally.samples,
        value: share,
        unit: "%",
        message: format!(
            "{} have NaN or infinity in {} samples ({share:.2} %), the first in sample {first}",
            columns.join(", "),
            tally.samples
        ),
        way_out: "drop these rows (gaps are detected and handled) or repair the reader; do not fill them with zeros"
            .into(),
        columns,
        ..kind
    }
}

/// Difference of the largest and the smallest finite value of one axis; 0 if no value is finite.
pub(super) fn range(rows: Samples<'_>, axis: usize) -> f64 {
    let [low, high] = extremes(rows, axis);
    (high - low).max(0.0)
}

/// Smallest and largest finite value of one axis; [inf, -inf] if no value is finite.
pub(super) fn extremes(rows: Samples<'_>, axis: usize) -> [f64; 2] {
    let values = rows.axis(axis).filter(|v| v.is_finite());
    // A plain comparison is faster than `f64::min`, which also handles NaN. Here NaN has been filtered out.
    values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], v| {
        [if v < low { v } else { low }, if v > high { v } else { high }]
    })
}

/// Smallest and largest finite value of each axis of both triads, accelerometer first; [inf, -inf] if no value is
/// finite.
pub(super) struct Extremes {
    pub(super) ends: [[[f64; 2]; 3]; 2],
}

impl Default for Extremes {
    fn default() -> Self {
        Self { ends: [[[f64::INFINITY, f64::NEG_INFINITY]; 3]; 2] }
    }
}

impl Extremes {
    #[inline(always)]
    pub(super) fn feed(&mut self, part: &Part<'_>) {
        for (ends, rows) in self.ends.iter_mut().zip(part.triads()) {
            // With four rows per step, the compiler can vectorise the loop. Plain comparisons are valid only if no
            // value is NaN.
            let (fours, others) = if part.is_finite { rows.as_chunks::<4>() } else { (&[][..], rows) };
            let (mut low, mut high) = ([[f64::INFINITY; 3]; 4], [[f64::NEG_INFINITY; 3]; 4]);
            for four in fours {
                for (k, row) in four.iter().enumerate() {
                    for (axis, &v) in row.iter().enumerate() {
                        low[k][axis] = if v < low[k][axis] { v } else { low[k][axis] };
                        high[k][axis] = if v > high[k][axis] { v } else { high[k][axis] };
                    }
                }
            }
            let found = low.iter().zip(&high).map(|(low, high)| [*low, *high]);
            for rows in found.chain(others.iter().map(|row| [*row; 2])) {
                for axis in 0..3 {
                    let [low, high] = [rows[0][axis], rows[1][axis]];
                    if low.is_finite() && high.is_finite() {
                        ends[axis] = [ends[axis][0].min(low), ends[axis][1].max(high)];
                    }
                }
            }
        }
    }
}

/// Resolution of the converter, in the unit of the samples; infinite for a constant channel. It is the 5 % quantile of
/// the nonzero differences between consecutive samples. The quantile ignores rare smaller differences, for example if a
/// signal is clipped at a value between two steps. Differences as small as floating-point rounding errors are excluded.
pub(super) fn converter_step(rows: Samples<'_>, axis: usize) -> f64 {
    let rounding = 1e-9 * range(rows, axis);
    let mut steps = Vec::new();
    rows.neighbours(axis, |before, after| {
        let step = (after - before).abs();
        if step > rounding && step.is_finite() {
            steps.push(step);
        }
    });
    if steps.is_empty() {
        return f64::INFINITY;
    }
    quantile(&mut steps, 0.05)
}

#[cfg(test)]
mod tests {
    use super::super::example::Columns;
    use super::*;
    use crate::check::survey::Survey;
    use crate::finding::Severity;

    fn not_finite(recording: &Recording) -> Vec<Finding> {
        check_finite(recording, &Survey::of(recording).not_finite)
    }

    #[test]
    fn a_clean_recording_has_nothing() {
        for columns in [Columns::tumbling(), Columns::tumbling().quantised(0.05, 0.01)] {
            let recording = columns.recording();
            assert!(not_finite(&recording).is_empty());
        }
    }

    #[test]
    fn nan_names_its_columns_and_its_place() {
        let mut columns = Columns::tumbling();
        columns.force[70][1] = f64::NAN;
        columns.force[71][1] = f64::INFINITY;
        columns.rate[90][2] = f64::NAN;
        let findings = not_finite(&columns.recording());
        assert_eq!(findings.len(), 1);
        assert_eq!(findings[0].columns, ["accel_y", "gyro_z"]);
        assert_eq!(findings[0].count, 3);
        let place = findings[0].place.unwrap();
        assert_eq!((place.first_sample, place.last_sample), (70, 71));
    }

    #[test]
    fn rows_of_one_sensor_each_are_told_from_missing_samples() {
        let mut columns = Columns::tumbling();
        columns.force.iter_mut().step_by(2).for_each(|row| *row = [f64::NAN; 3]);
        // The sensors have different rates, so only every second row has values of both.
        assert!(not_finite(&columns.recording())[0].way_out.contains("drop these rows"));
        columns.rate.iter_mut().skip(1).step_by(2).for_each(|row| *row = [f64::NAN; 3]);
        let findings = not_finite(&columns.recording());
        assert_eq!((findings.len(), findings[0].code, findings[0].count), (1, "non_finite", 4000));
        assert!(findings[0].message.contains("2000 samples have NaN for the gyroscope only, 2000"));
        assert!(findings[0].way_out.contains("interpolate"));
    }

    #[test]
    fn an_impossible_value_is_named_and_hides_its_consequences() {
        for value in [1.7e153, -3.4e38, 2e5, f64::MAX] {
            let mut columns = Columns::tumbling();
            columns.force[1234][2] = value;
            let findings = crate::check::check_columns(&columns.recording());
            assert_eq!(findings.len(), 1, "{findings:?}");
            let found = &findings[0];
            assert_eq!((found.code, found.severity, found.count), ("value_impossible", Severity::Error, 1));
            assert_eq!((&found.columns[..], found.value, found.unit), (&["accel_z".to_owned()][..], value, "m/s^2"));
            assert_eq!(found.place.unwrap().first_sample, 1234);
            assert!(found.message.contains("sample 1234") && found.way_out.contains("leave out"), "{found}");
        }
        let mut columns = Columns::tumbling();
        columns.rate.iter_mut().for_each(|row| row[0] = 1e7);
        columns.rate[7] = [1.0, -1e300, 1e300];
        let findings = crate::check::check_columns(&columns.recording());
        assert_eq!((findings[0].columns.len(), findings[0].count), (3, 4000));
        assert!(findings[0].way_out.contains("unit of gyro"));
    }

    #[test]
    fn counts_of_any_converter_are_possible() {
        let columns = Columns::tumbling();
        let force: Vec<[f64; 3]> = columns.force.iter().map(|row| row.map(|v| (v * 2e8).clamp(-2e9, 2e9))).collect();
        let recording = Recording { specific_force: (&force).into(), accel_unit: RawUnit::Lsb, ..columns.recording() };
        assert!(check_possible(&recording, &Survey::of(&recording).extremes).is_empty());
    }

    #[test]
    fn nan_in_the_stand_is_a_warning() {
        let columns = Columns::tumbling();
        let mut stand = vec![[0.0; 3]; columns.time_s.len()];
        stand[5][0] = f64::NAN;
        let recording = Recording { stand_rad: Some(&stand), ..columns.recording() };
        let findings = not_finite(&recording);
        assert_eq!(findings[0].severity, Severity::Warning);
        assert_eq!(findings[0].columns, ["stand_1"]);
    }
}
