//! Single columns: numbers that are none, axes that do not move, temperature that jumps.

use super::{ACCEL, Finding, GYRO, Place, Tally, names, quantile, unit_name};
use crate::recording::Recording;

/// Share of the recording over which an axis must stand still to be called stuck.
const STUCK_SHARE: f64 = 0.5;
/// Steps of the converter over which another axis must move meanwhile.
const MOVING_STEPS: f64 = 8.0;
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
        if recording
            .stand_rad
            .is_some_and(|stand| mark(stand[i], &mut stand_columns))
        {
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
            findings.push(not_finite(
                recording,
                tally,
                names,
                marked,
                kind("non_finite", recording),
            ));
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

/// An axis that holds one value for most of the recording while its neighbours move.
///
/// A rest without noise holds all axes, and a coarse converter moves them by single steps: neither is stuck. An axis is certainly
/// stuck if its neighbours are noisy meanwhile, or if a whole triad is dead. Where the neighbours are as quiet (a coarse
/// converter, a simulation without noise), it may as well be that nothing turned about it: a warning.
pub(super) fn check_stuck(recording: &Recording) -> Vec<Finding> {
    let mut stuck = Vec::new();
    for (rows, other, names, unit) in [
        (
            recording.specific_force,
            recording.angular_rate,
            ACCEL,
            unit_name(recording.accel_unit, "m/s^2"),
        ),
        (
            recording.angular_rate,
            recording.specific_force,
            GYRO,
            unit_name(recording.gyro_unit, "rad/s"),
        ),
    ] {
        for axis in 0..3 {
            let (first, last) = longest_run(rows, axis);
            let held = last + 1 - first;
            if (held as f64) < STUCK_SHARE * recording.len() as f64 || held < 3 {
                continue;
            }
            let meanwhile = &rows[first..=last];
            let siblings = [(axis + 1) % 3, (axis + 2) % 3];
            let triad_is_dead = siblings.iter().all(|&k| range(meanwhile, k) == 0.0)
                && (0..3).any(|k| moves_widely(&other[first..=last], k));
            let siblings_are_noisy = siblings.iter().any(|&k| moves(meanwhile, k) && is_noisy(meanwhile, k));
            if triad_is_dead || siblings.iter().any(|&k| moves(meanwhile, k)) {
                stuck.push(Stuck {
                    column: names[axis],
                    value: rows[first][axis],
                    unit,
                    held,
                    place: Place::new(recording, first, last),
                    is_certain: triad_is_dead || siblings_are_noisy,
                });
            }
        }
    }
    let (certain, possible): (Vec<_>, Vec<_>) = stuck.into_iter().partition(|axis| axis.is_certain);
    let certain = stuck_axes(
        recording,
        &certain,
        Finding::error("stuck_axis", recording),
        "check the wiring, the reader's column order and the sensor's axis enable bits; the axis cannot be calibrated",
    );
    let possible = stuck_axes(
        recording,
        &possible,
        Finding::warning("stuck_axis", recording),
        "nothing to do if the motion never moves this axis; else check the wiring and the sensor's axis enable bits",
    );
    certain.into_iter().chain(possible).collect()
}

/// One axis that holds one value.
struct Stuck {
    column: &'static str,
    value: f64,
    unit: &'static str,
    held: usize,
    place: Place,
    is_certain: bool,
}

fn stuck_axes(recording: &Recording, axes: &[Stuck], kind: Finding, way_out: &str) -> Option<Finding> {
    let longest = axes.iter().max_by_key(|axis| axis.held)?;
    let parts: Vec<String> = axes
        .iter()
        .map(|axis| {
            format!(
                "{} stands at {} {} for {} samples ({:.0} % of the recording, {})",
                axis.column,
                axis.value,
                axis.unit,
                axis.held,
                100.0 * axis.held as f64 / recording.len() as f64,
                axis.place
            )
        })
        .collect();
    Some(Finding {
        columns: names(axes.iter().map(|axis| axis.column)),
        place: Some(longest.place),
        count: longest.held,
        value: longest.value,
        unit: longest.unit,
        message: format!("{} while other axes move", parts.join("; ")),
        way_out: way_out.into(),
        ..kind
    })
}

/// First and last sample of the longest run of one value.
fn longest_run(rows: &[[f64; 3]], axis: usize) -> (usize, usize) {
    let (mut best, mut start) = ((0, 0), 0);
    for i in 0..rows.len() {
        if rows[i][axis] != rows[start][axis] {
            start = i;
        }
        if i - start > best.1 - best.0 {
            best = (start, i);
        }
    }
    best
}

/// Largest less smallest finite value; 0 without any.
pub(super) fn range(rows: &[[f64; 3]], axis: usize) -> f64 {
    let [low, high] = extremes(rows, axis);
    (high - low).max(0.0)
}

/// Smallest and largest finite value; [inf, -inf] without any.
pub(super) fn extremes(rows: &[[f64; 3]], axis: usize) -> [f64; 2] {
    let values = rows.iter().map(|row| row[axis]).filter(|v| v.is_finite());
    values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], v| {
        [low.min(v), high.max(v)]
    })
}

/// The converter's step: the size of the smallest differences between neighbours that are not zero, 5 % of them being
/// smaller. Differences of rounding size are left out, and odd ones, as at a limit between two steps, do not count.
/// Infinite for a constant.
pub(super) fn converter_step(rows: &[[f64; 3]], axis: usize) -> f64 {
    let rounding = 1e-9 * range(rows, axis);
    let differences = rows.windows(2).map(|pair| (pair[1][axis] - pair[0][axis]).abs());
    let mut steps: Vec<f64> = differences
        .filter(|step| *step > rounding && step.is_finite())
        .collect();
    if steps.is_empty() {
        return f64::INFINITY;
    }
    quantile(&mut steps, 0.05)
}

fn moves(rows: &[[f64; 3]], axis: usize) -> bool {
    range(rows, axis) >= MOVING_STEPS * converter_step(rows, axis)
}

/// Most samples differ from the one before.
fn is_noisy(rows: &[[f64; 3]], axis: usize) -> bool {
    let changes = rows.windows(2).filter(|pair| pair[1][axis] != pair[0][axis]).count();
    2 * changes > rows.len()
}

/// Beyond noise: the range is like the values themselves.
fn moves_widely(rows: &[[f64; 3]], axis: usize) -> bool {
    let [low, high] = extremes(rows, axis);
    moves(rows, axis) && high - low > 0.3 * low.abs().max(high.abs())
}

/// Steps of more than 5 K between neighbours, and values that are not finite.
pub(super) fn check_temperature(recording: &Recording) -> Option<Finding> {
    let temperature = recording.temperature_degc?;
    let (mut jumps, mut largest, mut not_finite) = (Tally::default(), 0.0f64, 0);
    for i in 0..temperature.len() {
        let step = if i == 0 {
            0.0
        } else {
            (temperature[i] - temperature[i - 1]).abs()
        };
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
        ..Finding::warning("temperature_jump", recording)
    })
}

#[cfg(test)]
mod tests {
    use super::super::{Severity, example::Columns};
    use super::*;

    #[test]
    fn a_clean_recording_has_nothing() {
        for columns in [Columns::tumbling(), Columns::tumbling().quantised(0.05, 0.01)] {
            let recording = columns.recording();
            assert!(check_finite(&recording).is_empty());
            assert!(check_stuck(&recording).is_empty());
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
        let recording = Recording {
            stand_rad: Some(&stand),
            ..columns.recording()
        };
        let findings = check_finite(&recording);
        assert_eq!(findings[0].severity, Severity::Warning);
        assert_eq!(findings[0].columns, ["stand_1"]);
    }

    #[test]
    fn an_axis_that_stops_is_stuck() {
        let mut columns = Columns::tumbling();
        columns.rate[1000..].iter_mut().for_each(|row| row[1] = 0.25);
        let findings = check_stuck(&columns.recording());
        assert_eq!(findings[0].columns, ["gyro_y"]);
        assert_eq!((findings[0].count, findings[0].severity), (3000, Severity::Error));

        let mut dead = Columns::tumbling();
        dead.rate.iter_mut().for_each(|row| *row = [0.0; 3]);
        assert_eq!(check_stuck(&dead.recording())[0].columns, GYRO);
    }

    #[test]
    fn a_rest_without_noise_and_a_coarse_one_are_not_stuck() {
        let mut still = Columns::tumbling();
        for i in 1000..4000 {
            still.force[i] = still.force[1000];
            still.rate[i] = still.rate[1000];
        }
        assert!(check_stuck(&still.recording()).is_empty());
        // A converter's step of three times the noise: single steps are all that is left at rest.
        let mut coarse = Columns::tumbling().quantised(0.06, 0.009);
        for i in 0..3000 {
            coarse.force[i] = coarse.force[i % 90];
            coarse.rate[i] = coarse.rate[i % 90];
            coarse.rate[i][0] = 0.0;
        }
        assert!(check_stuck(&coarse.recording()).is_empty());
    }

    #[test]
    fn an_axis_that_nothing_turns_is_a_warning_without_noise() {
        let mut columns = Columns::tumbling();
        for (i, row) in columns.rate.iter_mut().enumerate() {
            let moving = f64::from(u8::from(i % 200 >= 150));
            *row = [0.0, moving * (i as f64).sin(), moving * (i as f64).cos()];
        }
        let findings = check_stuck(&columns.recording());
        assert_eq!(findings.len(), 1);
        assert_eq!(
            (findings[0].columns.as_slice(), findings[0].severity),
            (&["gyro_x".to_string()][..], Severity::Warning)
        );
    }

    #[test]
    fn temperature_may_drift_but_not_jump() {
        let columns = Columns::tumbling();
        let mut temperature: Vec<f64> = (0..4000).map(|i| 20.0 + 0.005 * i as f64).collect();
        let check = |temperature: &[f64]| {
            check_temperature(&Recording {
                temperature_degc: Some(temperature),
                ..columns.recording()
            })
        };
        assert!(check(&temperature).is_none());
        temperature[2000] = -40.0;
        temperature[3000] = f64::NAN;
        let finding = check(&temperature).unwrap();
        assert_eq!((finding.count, finding.severity), (3, Severity::Warning));
        assert!(finding.value > 60.0);
    }
}
