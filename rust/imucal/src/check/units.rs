//! Checks of the units of measurement. At rest, the norm |f| of the specific force must equal local gravity g, and a
//! gyroscope must read only its bias.

use std::ops::Range;

use imucal_core::STANDARD_GRAVITY_MPS2;

use super::part::Part;
use super::values::Extremes;
use super::{ACCEL, GYRO, gravity_sign, names};
use crate::finding::{Finding, Place};
use crate::numerics::stats::quantile;
use crate::recording::{RawUnit, Recording, Samples};

/// Plausible ratio of |f| to g at rest. The limits allow for the bias and the scale error of a sensor.
const AT_REST: [f64; 2] = [0.75, 1.25];
/// Plausible ratio of the median of |f| to g over a whole recording, moves included.
const WITH_MOVES: [f64; 2] = [0.5, 2.0];
/// Largest plausible angular rate, rad/s. It is twice the widest usual range of MEMS gyroscopes, 4000 deg/s. Only
/// special gyroscopes have a wider range (ADXRS649, 20000 deg/s).
const FASTEST_RADPS: f64 = 140.0;
/// Largest plausible bias of a MEMS gyroscope, rad/s (57 deg/s).
const LARGEST_BIAS_RADPS: f64 = 1.0;
/// Within a rest, the mean rate is regarded as a bias if (standard deviation of the rate) / (norm of the mean rate) is
/// below this limit. If the device is moved to and fro, the ratio is above the limit.
const STEADY: f64 = 0.3;
/// A sensor may measure gravity if the lower and the upper quartile of the norm of its readings are within these
/// multiples of the median norm. The norm of angular rates varies far more, because recordings contain rests and moves.
const STEADY_NORM: [f64; 2] = [0.85, 1.15];
/// Usual units of accelerometer columns: the name, the size in m/s^2, and the recommendation if a file in this unit was
/// read in another unit. Columns without a known unit were read as m/s^2.
const ACCEL_UNITS: [(&str, f64, &str); 4] = [
    ("mps2", 1.0, "m/s^2: name the columns accel_x_mps2, accel_y_mps2, accel_z_mps2"),
    ("g", STANDARD_GRAVITY_MPS2, "g: name the columns accel_x_g, accel_y_g, accel_z_g"),
    ("mg", STANDARD_GRAVITY_MPS2 / 1000.0, "mg: name the columns accel_x_mg, accel_y_mg, accel_z_mg"),
    ("cmps2", 0.01, "cm/s^2: name the columns accel_x_cmps2, accel_y_cmps2, accel_z_cmps2"),
];
/// Rare units of accelerometer columns, which are never recommended: the name and the size in m/s^2.
const RARE_ACCEL_UNITS: [(&str, f64); 3] = [("mmps2", 1e-3), ("ftps2", 0.3048), ("ug", STANDARD_GRAVITY_MPS2 / 1e6)];
/// Usual units of gyroscope columns, largest first: the name, the size in rad/s, and the name in messages.
const GYRO_UNITS: [(&str, f64, &str); 3] =
    [("radps", 1.0, "rad/s"), ("dps", DEGREE, "deg/s"), ("mdps", DEGREE / 1000.0, "mdeg/s")];
/// Rare units of gyroscope columns, which are never recommended: the name, the size in rad/s, and the name in messages.
const RARE_GYRO_UNITS: [(&str, f64, &str); 5] = [
    ("mradps", 1e-3, "mrad/s"),
    ("dpmin", DEGREE / 60.0, "deg/min"),
    ("dph", DEGREE / 3600.0, "deg/h"),
    ("rpm", 6.0 * DEGREE, "rpm"),
    ("gonps", 0.9 * DEGREE, "gon/s"),
];
/// One degree, rad.
const DEGREE: f64 = std::f64::consts::PI / 180.0;
/// If the median norm |f| of the specific force, in the unit of the columns, is above this limit, the numbers are raw
/// counts. In usual units, the largest number for 1 g is 1000 (mg).
const COUNTS: f64 = 1500.0;
/// If the median norm |f| of the specific force, m/s^2, is below this limit, gravity was removed from the readings.
const WITHOUT_GRAVITY_MPS2: f64 = 0.5;

/// Reports `accel_units` and `gyro_units` for units that are wrong by so large a factor that the readings show it
/// before the rests are known.
pub(super) fn check(recording: &Recording, (lengths, extremes): (&Lengths, &Extremes)) -> Vec<Finding> {
    let mut findings = Vec::new();
    let whole = 0..recording.len();
    let everything = std::slice::from_ref(&whole);
    if recording.accel_unit == RawUnit::Si
        && !lengths.have_median_within()
        && let Some(norm) = median_norm(recording.specific_force, everything)
        && !within(norm / STANDARD_GRAVITY_MPS2, WITH_MOVES)
    {
        findings.push(wrong_accel_unit(recording, everything, norm, STANDARD_GRAVITY_MPS2));
    }
    if extremes.ends[1].iter().flatten().any(|rate| rate.abs() > FASTEST_RADPS) {
        findings.extend(too_fast(recording));
    }
    findings
}

/// Numbers of finite samples (rows of three axes): all of them, those whose norm is below a lower limit, and those
/// whose norm is above an upper limit.
#[derive(Default)]
pub(super) struct Lengths {
    rows: usize,
    below: usize,
    above: usize,
}

impl Lengths {
    /// Counts the accelerometer samples of the block `part` if the accelerometer is in SI units. The limits of the norm
    /// are [`WITH_MOVES`] times standard gravity.
    #[inline(always)]
    pub(super) fn feed(&mut self, part: &Part<'_>) {
        if part.recording.accel_unit == RawUnit::Si {
            self.add(part.triads()[0], WITH_MOVES.map(|share| share * STANDARD_GRAVITY_MPS2));
        }
    }

    fn add(&mut self, rows: &[[f64; 3]], limits: [f64; 2]) {
        let [least, most] = limits.map(|limit| limit * limit);
        for [x, y, z] in rows {
            let square = x * x + y * y + z * z;
            self.rows += usize::from(square.is_finite());
            self.below += usize::from(square < least);
            self.above += usize::from(square > most && square.is_finite());
        }
    }

    /// Whether the median norm is between the two limits. This follows from the three numbers, without sorting the
    /// norms: fewer than half of the samples are below the lower limit, and fewer than half are above the upper limit.
    fn have_median_within(&self) -> bool {
        2 * self.below < self.rows && 2 * self.above < self.rows
    }
}

/// Runs the checks that need rests: the units (from the force and the rate at rest), and the sign of gravity.
///
/// `rests` are ranges of sample indices; ranges outside the recording are ignored. Codes: `accel_units`, `gyro_units`,
/// `gravity_sign`. Findings of [`super::check_columns`] are not repeated.
pub fn check_rests(recording: &Recording, rests: &[Range<usize>], gravity_mps2: f64) -> Vec<Finding> {
    if recording.check_lengths().is_err() {
        return Vec::new();
    }
    let rests: Vec<Range<usize>> =
        rests.iter().filter(|rest| !rest.is_empty() && rest.end <= recording.len()).cloned().collect();
    let mut findings = Vec::new();
    let whole = 0..recording.len();
    let everything = std::slice::from_ref(&whole);
    let with_moves = WITH_MOVES.map(|share| share * STANDARD_GRAVITY_MPS2);
    let seen_without_rests = || median_norm_beyond(recording.specific_force, everything, with_moves).is_some();
    if recording.accel_unit == RawUnit::Si
        && let Some(norm) =
            median_norm_beyond(recording.specific_force, &rests, AT_REST.map(|share| share * gravity_mps2))
        && !seen_without_rests()
    {
        findings.push(wrong_accel_unit(recording, &rests, norm, gravity_mps2));
    }
    findings.extend(biased(recording, &rests).filter(|_| too_fast(recording).is_none()));
    findings.extend(gravity_sign::check(recording, &rests));
    findings
}

fn within(value: f64, [low, high]: [f64; 2]) -> bool {
    (low..=high).contains(&value)
}

fn length([x, y, z]: [f64; 3]) -> f64 {
    (x * x + y * y + z * z).sqrt()
}

/// Computes the median norm of the samples (rows of three axes) in the index ranges. Samples that are not finite are
/// ignored; `None` if no sample is left.
fn median_norm(rows: Samples<'_>, ranges: &[Range<usize>]) -> Option<f64> {
    let rows = ranges.iter().flat_map(|range| rows.slice(range.clone()).iter());
    let mut norms: Vec<f64> = rows.map(length).filter(|norm| norm.is_finite()).collect();
    (!norms.is_empty()).then(|| quantile(&mut norms, 0.5))
}

/// The [`median_norm`] if it is outside the limits, otherwise `None`. The norms are sorted only if the median is
/// outside the limits, which is rare.
fn median_norm_beyond(rows: Samples<'_>, ranges: &[Range<usize>], limits: [f64; 2]) -> Option<f64> {
    let mut lengths = Lengths::default();
    ranges.iter().for_each(|range| lengths.add(&rows.part(range.clone()), limits));
    if lengths.have_median_within() {
        return None;
    }
    median_norm(rows, ranges).filter(|norm| !within(*norm, limits))
}

fn wrong_accel_unit(recording: &Recording, ranges: &[Range<usize>], norm: f64, gravity_mps2: f64) -> Finding {
    let given = given_accel_unit(recording);
    let in_file = norm / given.1;
    // First, the usual units are searched for one in which the numbers of the file have the magnitude of gravity. If
    // the columns contain the specific force, this unit is the correct one.
    let fitting: Vec<&str> = ACCEL_UNITS
        .iter()
        .filter(|unit| unit.0 != given.0 && within(in_file * unit.1 / gravity_mps2, AT_REST))
        .map(|unit| unit.2)
        .collect();
    let swapped = fitting.is_empty() && gyroscope_has_gravity(recording, gravity_mps2);
    let way_out = if swapped {
        "the gyro columns contain gravity: accel and gyro columns look swapped".into()
    } else if !fitting.is_empty() {
        format!("looks like {}", fitting.join("; or like "))
    } else if norm < WITHOUT_GRAVITY_MPS2 {
        "looks like linear acceleration (gravity removed): record the raw specific force, because gravity is the only \
         reference"
            .into()
    } else if in_file > COUNTS {
        "looks like raw counts: name the columns accel_x_lsb, accel_y_lsb, accel_z_lsb".into()
    } else {
        "give the columns in the unit of their names: accel_x_mps2, _g, _mg or _lsb".into()
    };
    let first = ranges.first().cloned().unwrap_or(0..1);
    let read_as = match given.0 {
        "mps2" => String::new(),
        name => format!(" (the columns were read as {name})"),
    };
    Finding {
        columns: if swapped { names(ACCEL.iter().chain(&GYRO)) } else { names(ACCEL) },
        place: Some(Place::new(recording, first.start, first.end - 1)),
        count: ranges.iter().map(Range::len).sum(),
        value: norm,
        unit: "m/s^2",
        message: format!(
            "the median |f| is {norm:.4} m/s^2{read_as}, but gravity is {gravity_mps2:.3} m/s^2 (ratio {:.4})",
            norm / gravity_mps2
        ),
        way_out,
        ..Finding::error("accel_units", recording.name)
    }
}

/// Whether the numbers in the gyroscope columns may be a specific force: their median norm is that of gravity, in m/s^2
/// or in g, and at least half of the norms are close to this median.
fn gyroscope_has_gravity(recording: &Recording, gravity_mps2: f64) -> bool {
    if recording.gyro_unit != RawUnit::Si {
        return false;
    }
    let factor = given_gyro_unit(recording).1;
    let mut norms: Vec<f64> =
        recording.angular_rate.iter().map(|row| length(row) / factor).filter(|norm| norm.is_finite()).collect();
    if norms.is_empty() {
        return false;
    }
    let [low, median, high] = [0.25, 0.5, 0.75].map(|q| quantile(&mut norms, q));
    let has_size = within(median / gravity_mps2, AT_REST) || within(median, AT_REST);
    has_size && low > STEADY_NORM[0] * median && high < STEADY_NORM[1] * median
}

/// The unit of the accelerometer columns: its name, and its size in m/s^2.
pub(super) fn given_accel_unit(recording: &Recording) -> (&'static str, f64) {
    let name = recording.column_units[0].unwrap_or("mps2");
    let mut units = ACCEL_UNITS.iter().map(|unit| (unit.0, unit.1)).chain(RARE_ACCEL_UNITS);
    units.find(|unit| unit.0 == name).unwrap_or(("mps2", 1.0))
}

/// The unit of the gyroscope columns: its name, its size in rad/s, and its name in messages.
pub(super) fn given_gyro_unit(recording: &Recording) -> &'static (&'static str, f64, &'static str) {
    let [_, given] = recording.column_units;
    let mut units = GYRO_UNITS.iter().chain(&RARE_GYRO_UNITS);
    units.find(|unit| unit.0 == given.unwrap_or("radps")).unwrap_or(&GYRO_UNITS[0])
}

/// Returns a text that recommends smaller units, for rates that are far too large in the unit of the columns.
fn smaller_gyro_units(recording: &Recording) -> String {
    let given = given_gyro_unit(recording);
    let (words, names): (Vec<&str>, Vec<String>) = GYRO_UNITS
        .iter()
        .filter(|unit| unit.1 < given.1)
        .map(|unit| (unit.2, format!("gyro_x_{}", unit.0)))
        .chain([("raw counts", "gyro_x_lsb".to_owned())])
        .unzip();
    let read_as = match given.0 {
        "radps" => String::new(),
        _ => format!("the columns were read as {}: if they are not, the column ", given.2),
    };
    format!(
        "{read_as}looks like {}: without converting them, name the columns {}",
        words.join(" or "),
        names.join(" or ")
    )
}

fn too_fast(recording: &Recording) -> Option<Finding> {
    if recording.gyro_unit != RawUnit::Si || recording.is_empty() {
        return None;
    }
    let over = |row: [f64; 3]| row.iter().any(|v| v.abs() > FASTEST_RADPS);
    let first = recording.angular_rate.iter().position(over)?;
    // The 99.9 % quantile is used, so that up to one sample in a thousand may be a spike.
    let mut fastest: Vec<f64> = recording
        .angular_rate
        .iter()
        .map(|row| row.iter().fold(0.0, |most: f64, rate| most.max(rate.abs())))
        .filter(|rate| rate.is_finite())
        .collect();
    let rate = quantile(&mut fastest, 0.999);
    let is_fast = |axis: &usize| {
        let mut rates: Vec<f64> =
            recording.angular_rate.iter().map(|row| row[*axis].abs()).filter(|rate| rate.is_finite()).collect();
        quantile(&mut rates, 0.999) > FASTEST_RADPS
    };
    let axes = || (0..3).filter(is_fast).map(|axis| GYRO[axis]).collect::<Vec<_>>();
    (rate > FASTEST_RADPS).then(|| Finding {
        columns: names(GYRO),
        place: Some(Place::new(recording, first, first)),
        count: recording.angular_rate.iter().filter(|row| over(*row)).count(),
        value: rate,
        unit: "rad/s",
        message: format!(
            "rates reach {rate:.0} rad/s ({:.0} deg/s), above the {FASTEST_RADPS:.0} rad/s of usual MEMS gyroscopes, first at {:.2} s",
            rate.to_degrees(),
            recording.time_s[first]
        ),
        way_out: smaller_gyro_units(recording) + &if_only(&axes()),
        ..Finding::error("gyro_units", recording.name)
    })
}

/// Recommendation for the case that only the gyroscope axes `axes` are in another unit; empty for no axis or all three.
pub(super) fn if_only(axes: &[&str]) -> String {
    match axes.len() {
        1 | 2 => format!("; if only {} has another unit, convert it to the unit of the others", axes.join(" and ")),
        _ => String::new(),
    }
}

/// Reports `gyro_units` for a gyroscope whose bias is too large for any MEMS gyroscope. A bias is steady within a rest.
/// If a large rate varies within a rest, the device was moved, and the rate does not show a wrong unit of measurement.
fn biased(recording: &Recording, rests: &[Range<usize>]) -> Option<Finding> {
    if recording.gyro_unit != RawUnit::Si {
        return None;
    }
    median_norm_beyond(recording.angular_rate, rests, [0.0, LARGEST_BIAS_RADPS])?;
    let mut biases: Vec<f64> = rests.iter().filter_map(|rest| steady_norm(recording.angular_rate, rest)).collect();
    if 2 * biases.len() < rests.len().max(1) {
        return None;
    }
    let rate = quantile(&mut biases, 0.5);
    let first = rests.first().filter(|_| rate > LARGEST_BIAS_RADPS)?;
    Some(Finding {
        columns: names(GYRO),
        place: Some(Place::new(recording, first.start, first.end - 1)),
        count: rests.iter().map(Range::len).sum(),
        value: rate,
        unit: "rad/s",
        message: format!(
            "the gyroscope reads {rate:.2} rad/s ({:.0} deg/s) at rest, more than any bias of a MEMS gyroscope",
            rate.to_degrees()
        ),
        way_out: format!(
            "{}; if the unit was turning steadily at that time ({}), it was not at rest: hold it still in each pose",
            smaller_gyro_units(recording),
            Place::new(recording, first.start, first.end - 1)
        ),
        ..Finding::error("gyro_units", recording.name)
    })
}

/// Computes the norm of the mean angular rate of a rest, in the unit of `rows`; `None` if the rate varies within the
/// rest (see [`STEADY`]).
fn steady_norm(rows: Samples<'_>, rest: &Range<usize>) -> Option<f64> {
    let (mut count, mut sum, mut squares) = (0.0, [0.0; 3], 0.0);
    for row in rows.slice(rest.clone()).iter().filter(|row| row.iter().all(|v| v.is_finite())) {
        count += 1.0;
        sum = [0, 1, 2].map(|k| sum[k] + row[k]);
        squares += row.iter().map(|v| v * v).sum::<f64>();
    }
    let norm = length(sum.map(|v| v / count));
    let variance = (squares / count - norm * norm).max(0.0);
    (norm.is_finite() && variance.sqrt() < STEADY * norm).then_some(norm)
}

#[cfg(test)]
mod tests {
    use super::super::example::Columns;
    use super::*;
    use crate::check::survey::Survey;

    fn scaled(force: f64, rate: f64) -> Columns {
        let mut columns = Columns::tumbling();
        columns.force.iter_mut().for_each(|row| *row = row.map(|v| v * force));
        columns.rate.iter_mut().for_each(|row| *row = row.map(|v| v * rate));
        columns
    }

    fn both(recording: &Recording) -> Vec<Finding> {
        let survey = Survey::of(recording);
        let mut findings = check(recording, (&survey.lengths, &survey.extremes));
        findings.extend(check_rests(recording, &Columns::rests(), STANDARD_GRAVITY_MPS2));
        findings
    }

    #[test]
    fn si_with_the_errors_of_a_cheap_sensor_is_clean() {
        for scale in [0.85, 1.0, 1.15] {
            let columns = scaled(scale, scale);
            assert!(both(&columns.recording()).is_empty(), "{scale}");
        }
    }

    #[test]
    fn wrong_accelerometer_units_are_named_once() {
        let cases = [
            (1.0 / 9.80665, "accel_x_g"),
            (100.0, "cm/s^2"),
            (1000.0 / 9.80665, "mg"),
            (0.001, "gravity removed"),
            (400.0, "accel_x_lsb"),
            (1.4, "unit of their names"),
        ];
        for (scale, hint) in cases {
            let columns = scaled(scale, 1.0);
            let findings = both(&columns.recording());
            assert_eq!(findings.len(), 1, "{scale}: {findings:?}");
            assert_eq!(findings[0].code, "accel_units");
            assert!(findings[0].way_out.contains(hint), "{}", findings[0]);
        }
    }

    #[test]
    fn swapped_triads_are_named() {
        let mut columns = Columns::tumbling();
        std::mem::swap(&mut columns.force, &mut columns.rate);
        let findings = both(&columns.recording());
        assert!(findings[0].way_out.contains("swapped"), "{findings:?}");
    }

    #[test]
    fn rates_that_no_gyroscope_measures_are_not_si() {
        let findings = both(&scaled(1.0, 57.3).recording());
        assert_eq!((findings.len(), findings[0].code), (1, "gyro_units"));
        let mut biased = Columns::tumbling();
        biased.rate.iter_mut().for_each(|row| row[2] += 1.5);
        let findings = both(&biased.recording());
        assert_eq!((findings.len(), findings[0].code), (1, "gyro_units"));
        let mut spike = Columns::tumbling();
        spike.rate[100][1] = 1e4;
        assert!(both(&spike.recording()).is_empty());
    }

    #[test]
    fn counts_have_no_unit_to_check() {
        let columns = scaled(2000.0, 4000.0);
        let recording = Recording { accel_unit: RawUnit::Lsb, gyro_unit: RawUnit::Lsb, ..columns.recording() };
        assert!(both(&recording).is_empty());
    }

    #[test]
    fn the_unit_that_was_given_is_not_recommended() {
        let with_units = |columns: &Columns, units: [Option<&'static str>; 2]| {
            let recording = Recording { column_units: units, ..columns.recording() };
            let survey = Survey::of(&recording);
            let mut findings = check(&recording, (&survey.lengths, &survey.extremes));
            findings.extend(check_rests(&recording, &Columns::rests(), STANDARD_GRAVITY_MPS2));
            findings
        };
        // The numbers are in m/s^2 but read as g, then in mg but read as g, and finally counts that are read as deg/s.
        for (force, hint) in [(9.80665, "m/s^2:"), (1000.0, "mg:")] {
            let findings = with_units(&scaled(force, 1.0), [Some("g"), None]);
            assert_eq!(findings[0].code, "accel_units");
            assert!(findings[0].way_out.contains(hint) && !findings[0].way_out.contains("accel_x_g"), "{findings:?}");
        }
        let findings = with_units(&scaled(1.0, 131.0), [None, Some("dps")]);
        assert_eq!(findings[0].code, "gyro_units");
        assert!(findings[0].way_out.contains("read as deg/s") && !findings[0].way_out.contains("gyro_x_dps"));
    }

    #[test]
    fn a_unit_in_g_with_fast_rates_is_not_swapped() {
        // The rates have the median norm of gravity in m/s^2, but the specific force has the norm 1, which is gravity
        // in g.
        let mut columns = scaled(1.0 / 9.80665, 1.0);
        columns.rate.iter_mut().for_each(|row| *row = [9.8 + row[0], row[1], row[2]]);
        let findings = both(&columns.recording());
        assert!(findings[0].way_out.contains("looks like g:"), "{findings:?}");
    }

    #[test]
    fn a_false_rest_in_motion_is_no_evidence_of_a_unit() {
        let mut columns = Columns::tumbling();
        columns.rate.iter_mut().enumerate().for_each(|(i, row)| row[2] = 2.0 * (0.3 * i as f64).sin());
        assert!(both(&columns.recording()).is_empty());
    }

    #[test]
    fn rests_outside_the_recording_are_passed_over() {
        let columns = Columns::tumbling();
        assert!(check_rests(&columns.recording(), &[5000..6000, 7..7], 9.80665).is_empty());
    }
}
