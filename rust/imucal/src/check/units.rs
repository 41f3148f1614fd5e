//! Checks of units and signs against gravity: at rest |f| = g, and the axis that points up reads +g.

use std::ops::Range;

use imucal_core::STANDARD_GRAVITY_MPS2;

use super::part::Part;
use super::values::Extremes;
use super::{ACCEL, GYRO, names};
use crate::finding::{Finding, Place};
use crate::numerics::stats::quantile;
use crate::recording::{RawUnit, Recording, Samples};

/// Plausible ratio of |f| to g at rest, with the bias and the scale error of a sensor.
const AT_REST: [f64; 2] = [0.75, 1.25];
/// Plausible ratio of the median of |f| to g over a whole recording, moves included.
const WITH_MOVES: [f64; 2] = [0.5, 2.0];
/// Largest plausible angular rate, rad/s: twice the widest range on the market.
const FASTEST_RADPS: f64 = 140.0;
/// Largest plausible bias of a MEMS gyroscope, rad/s (57 deg/s).
const LARGEST_BIAS_RADPS: f64 = 1.0;
/// Maximum magnitude of the motor angles at the stand's zero position, rad.
const STAND_ZERO_RAD: f64 = 0.02;
/// Minimum component of the unit up-vector along an axis that points nearly up: the cosine of 20 deg.
const NEARLY_UPRIGHT: f64 = 0.94;

/// Findings of wrong units whose errors are so large that they are detected without rests.
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

/// Number of finite rows, and the numbers of rows with a norm below a lower limit and above an upper limit.
#[derive(Default)]
pub(super) struct Lengths {
    rows: usize,
    below: usize,
    above: usize,
}

impl Lengths {
    /// Adds the rows of an accelerometer in SI units, with the limits [`WITH_MOVES`] times standard gravity.
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

    /// Whether the median norm lies between the two limits, decided from the counts without calculating the median.
    fn have_median_within(&self) -> bool {
        2 * self.below < self.rows && 2 * self.above < self.rows
    }
}

/// Checks that need rests: units, from |f| and from the angular rate at rest, and the sign of gravity.
///
/// `rests` are ranges of sample indices; ranges outside the recording are ignored. Codes: `accel_units`, `gyro_units`,
/// `gravity_sign`. Findings of [`super::check_columns`] are not repeated.
///
/// The sign of gravity is not observable from motion, because |u| = g and u' = u x w remain true for -u. It needs
/// external evidence. With stand columns, body z points up when all motors are at zero; a reading of -g on z is then an
/// error. Without stand columns, most recordings start upright. A reading of -g on z, within 20 deg, in the first rest
/// is then a warning, because the unit may be upside down. Unsigned counts have no known zero and are not checked.
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
    findings.extend(turns_at_rest(recording, &rests).filter(|_| too_fast(recording).is_none()));
    findings.extend(gravity_sign(recording, &rests));
    findings
}

fn within(value: f64, [low, high]: [f64; 2]) -> bool {
    (low..=high).contains(&value)
}

fn length([x, y, z]: [f64; 3]) -> f64 {
    (x * x + y * y + z * z).sqrt()
}

/// Median norm of the finite rows in the ranges.
fn median_norm(rows: Samples<'_>, ranges: &[Range<usize>]) -> Option<f64> {
    let rows = ranges.iter().flat_map(|range| rows.slice(range.clone()).iter());
    let mut norms: Vec<f64> = rows.map(length).filter(|norm| norm.is_finite()).collect();
    (!norms.is_empty()).then(|| quantile(&mut norms, 0.5))
}

/// The [`median_norm`] if it is outside the limits. For most recordings it is inside, which is decided without sorting.
fn median_norm_beyond(rows: Samples<'_>, ranges: &[Range<usize>], limits: [f64; 2]) -> Option<f64> {
    let mut lengths = Lengths::default();
    ranges.iter().for_each(|range| lengths.add(&rows.part(range.clone()), limits));
    if lengths.have_median_within() {
        return None;
    }
    median_norm(rows, ranges).filter(|norm| !within(*norm, limits))
}

fn wrong_accel_unit(recording: &Recording, ranges: &[Range<usize>], norm: f64, gravity_mps2: f64) -> Finding {
    let rate = median_norm(recording.angular_rate, ranges);
    let swapped = recording.gyro_unit == RawUnit::Si
        && norm < 0.5 * gravity_mps2
        && rate.is_some_and(|rate| within(rate / gravity_mps2, AT_REST));
    let way_out = if swapped {
        "the gyro columns contain gravity: accel and gyro columns look swapped".into()
    } else if within(norm, AT_REST) {
        "looks like g: name the columns accel_x_g, accel_y_g, accel_z_g".into()
    } else if within(norm / 1000.0, AT_REST) {
        "looks like mg (name the columns accel_x_mg, ...) or cm/s^2 (divide by 100)".into()
    } else if norm < 0.5 {
        "looks like linear acceleration, gravity removed: record the raw specific force, gravity is the only reference"
            .into()
    } else if norm > 1500.0 {
        "looks like raw counts: name the columns accel_x_lsb, accel_y_lsb, accel_z_lsb".into()
    } else {
        "give the columns in the unit of their names: accel_x_mps2, _g, _mg or _lsb".into()
    };
    let first = ranges.first().cloned().unwrap_or(0..1);
    Finding {
        columns: if swapped { names(ACCEL.iter().chain(&GYRO)) } else { names(ACCEL) },
        place: Some(Place::new(recording, first.start, first.end - 1)),
        count: ranges.iter().map(Range::len).sum(),
        value: norm,
        unit: "m/s^2",
        message: format!(
            "the median |f| is {norm:.4} m/s^2, but gravity is {gravity_mps2:.3} m/s^2 (ratio {:.4})",
            norm / gravity_mps2
        ),
        way_out,
        ..Finding::error("accel_units", recording.name)
    }
}

const GYRO_WAY_OUT: &str =
    "looks like deg/s or raw counts: without converting them, name the columns gyro_x_dps, gyro_x_mdps or gyro_x_lsb";

fn too_fast(recording: &Recording) -> Option<Finding> {
    if recording.gyro_unit != RawUnit::Si || recording.is_empty() {
        return None;
    }
    let over = |row: [f64; 3]| row.iter().any(|v| v.abs() > FASTEST_RADPS);
    let first = recording.angular_rate.iter().position(over)?;
    // The 99.9 % quantile: one sample in a thousand may be a spike.
    let mut fastest: Vec<f64> = recording
        .angular_rate
        .iter()
        .map(|row| row.iter().fold(0.0, |most: f64, rate| most.max(rate.abs())))
        .filter(|rate| rate.is_finite())
        .collect();
    let rate = quantile(&mut fastest, 0.999);
    (rate > FASTEST_RADPS).then(|| Finding {
        columns: names(GYRO),
        place: Some(Place::new(recording, first, first)),
        count: recording.angular_rate.iter().filter(|row| over(*row)).count(),
        value: rate,
        unit: "rad/s",
        message: format!(
            "rates reach {rate:.0} rad/s ({:.0} deg/s), above the {FASTEST_RADPS:.0} rad/s of any MEMS gyroscope, first at {:.2} s",
            rate.to_degrees(),
            recording.time_s[first]
        ),
        way_out: GYRO_WAY_OUT.into(),
        ..Finding::error("gyro_units", recording.name)
    })
}

fn turns_at_rest(recording: &Recording, rests: &[Range<usize>]) -> Option<Finding> {
    if recording.gyro_unit != RawUnit::Si {
        return None;
    }
    let rate = median_norm_beyond(recording.angular_rate, rests, [0.0, LARGEST_BIAS_RADPS])?;
    let first = rests.first()?;
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
        way_out: GYRO_WAY_OUT.into(),
        ..Finding::error("gyro_units", recording.name)
    })
}

fn gravity_sign(recording: &Recording, rests: &[Range<usize>]) -> Option<Finding> {
    let rows = recording.specific_force;
    let at_zero = |rest: &&Range<usize>| {
        recording
            .stand_rad
            .is_some_and(|stand| stand[(*rest).clone()].iter().flatten().all(|angle| angle.abs() < STAND_ZERO_RAD))
    };
    let (rest, kind, evidence, way_out) = match (recording.stand_rad, rests.iter().find(at_zero)) {
        (Some(_), None) => return None,
        (Some(_), Some(rest)) => (
            rest,
            Finding::error as fn(_, &str) -> _,
            "with all motors at zero, body z up",
            "negate the accelerometer (a still sensor reads +g on the axis that points up), or mount the unit with z up at the stand's zero",
        ),
        (None, _) => (
            rests.first()?,
            Finding::warning as fn(_, &str) -> _,
            "in the first rest",
            "if z points up there, negate the accelerometer: a still sensor reads +g on the axis that points up; if the unit is upside down, nothing is wrong",
        ),
    };
    let mut mean = [0.0; 3];
    for row in rows.slice(rest.clone()).iter().filter(|row| row.iter().all(|v| v.is_finite())) {
        mean = [0, 1, 2].map(|k| mean[k] + row[k]);
    }
    let up = mean[2] / (mean[0].powi(2) + mean[1].powi(2) + mean[2].powi(2)).sqrt();
    let place = Place::new(recording, rest.start, rest.end - 1);
    let has_sign = || recording.accel_unit == RawUnit::Si || rows.iter().flatten().any(|v| v < 0.0 && v.is_finite());
    (up < -NEARLY_UPRIGHT && has_sign()).then(|| Finding {
        columns: names(ACCEL),
        place: Some(place),
        count: rest.len(),
        value: up,
        unit: "g",
        message: format!("accel_z reads {up:.2} g {evidence} ({place})"),
        way_out: way_out.into(),
        ..kind("gravity_sign", recording.name)
    })
}

#[cfg(test)]
mod tests {
    use super::super::example::Columns;
    use super::*;
    use crate::check::survey::Survey;
    use crate::finding::Severity;

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
    fn gravity_with_the_wrong_sign_needs_evidence() {
        let negated = scaled(-1.0, 1.0);
        let findings = both(&negated.recording());
        assert_eq!((findings[0].code, findings[0].severity), ("gravity_sign", Severity::Warning));
        // With stand columns, only the rest at the stand's zero position counts.
        let mut stand = vec![[0.0, 1.5, 0.0]; 4000];
        let judge = |stand: &[[f64; 3]]| both(&Recording { stand_rad: Some(stand), ..negated.recording() });
        assert!(judge(&stand).is_empty());
        stand[..100].fill([0.0; 3]);
        let findings = judge(&stand);
        assert_eq!((findings[0].code, findings[0].severity), ("gravity_sign", Severity::Error));
    }

    #[test]
    fn rests_outside_the_recording_are_passed_over() {
        let columns = Columns::tumbling();
        assert!(check_rests(&columns.recording(), &[5000..6000, 7..7], 9.80665).is_empty());
    }
}
