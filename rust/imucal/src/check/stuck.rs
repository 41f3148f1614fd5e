//! Check for axes with a constant value.

use super::runs::Runs;
use super::values::{converter_step, extremes, range};
use super::{ACCEL, GYRO, names, unit_name};
use crate::finding::{Finding, Place};
use crate::parameters::of_axes;
use crate::recording::{Recording, Samples};

/// An axis counts as stuck if it has one constant value over at least this share of the recording.
const STUCK_SHARE: f64 = 0.5;
/// An axis moves if its values span at least this number of steps of the converter.
const MOVING_STEPS: f64 = 8.0;

/// Reports axes that are constant for most of the recording while other axes of the same triad move.
///
/// Two cases are not reported: a rest without noise, in which all axes are constant, and a coarse converter, with which
/// the other axes change only by a few steps. The finding is an error if the axis is certainly stuck: the other axes
/// are noisy while the axis is constant, or a whole triad is constant while the other triad moves. The finding is a
/// warning if the other axes also have no noise, as with a coarse converter or in a simulation without noise. The axis
/// may then be constant because the motion did not affect it.
pub(super) fn check(recording: &Recording, runs: &Runs) -> Vec<Finding> {
    let mut stuck = Vec::new();
    for (first_channel, rows, other, names, unit) in [
        (0, recording.specific_force, recording.angular_rate, ACCEL, unit_name(recording.accel_unit, "m/s^2")),
        (3, recording.angular_rate, recording.specific_force, GYRO, unit_name(recording.gyro_unit, "rad/s")),
    ] {
        for axis in 0..3 {
            let (first, last) = runs.longest(first_channel + axis);
            let held = last + 1 - first;
            if (held as f64) < STUCK_SHARE * recording.len() as f64 || held < 3 {
                continue;
            }
            let meanwhile = rows.slice(first..last + 1);
            let siblings = [(axis + 1) % 3, (axis + 2) % 3];
            let triad_is_dead = siblings.iter().all(|&k| range(meanwhile, k) == 0.0)
                && (0..3).any(|k| moves_widely(other.slice(first..last + 1), k));
            // If the axis also has no noise outside the constant interval, its noise is below a step of the converter.
            // The axis may then be constant because the motion does not affect it, so it is not certain that the axis
            // is stuck.
            let [before, after] = [rows.slice(0..first), rows.slice(last + 1..rows.len())];
            let steps = !(before.is_empty() && after.is_empty()) && [before, after].iter().all(|r| !is_noisy(*r, axis));
            let siblings_are_noisy = !steps && siblings.iter().any(|&k| moves(meanwhile, k) && is_noisy(meanwhile, k));
            if triad_is_dead || siblings.iter().any(|&k| moves(meanwhile, k)) {
                stuck.push(Stuck {
                    column: names[axis],
                    // Adding zero turns a negative zero into a positive one.
                    value: rows.at(first)[axis] + 0.0,
                    unit,
                    held,
                    place: Place::new(recording, first, last),
                    is_certain: triad_is_dead || siblings_are_noisy,
                });
            }
        }
    }
    let (certain, possible): (Vec<_>, Vec<_>) = stuck.into_iter().partition(|axis| axis.is_certain);
    let certain =
        stuck_axes(recording, &certain, Finding::error("stuck_axis", recording.name), &undetermined(&certain));
    let possible = stuck_axes(
        recording,
        &possible,
        Finding::warning("stuck_axis", recording.name),
        "nothing to do if the motion never moves this axis; else check the wiring and the sensor's axis enable bits",
    );
    certain.into_iter().chain(possible).collect()
}

/// Returns a text that names the calibration parameters that the data do not determine without the stuck `axes`, and
/// the recommended action.
fn undetermined(axes: &[Stuck]) -> String {
    let is_stuck = |name: &str| axes.iter().any(|axis| axis.column == name);
    let stuck = |names: [&str; 3]| names.map(is_stuck);
    let open = |gyroscope: bool| of_axes(gyroscope, stuck(if gyroscope { GYRO } else { ACCEL }));
    let (accelerometer, mut gyroscope) = (open(false), open(true));
    let mut parts = Vec::new();
    const WAY_OUT: &str = "check the wiring, the reader's column order and the sensor's axis enable bits";
    if !accelerometer.is_empty() {
        parts.push(format!("the data do not determine the accelerometer's {}: {WAY_OUT}", accelerometer.join(", ")));
    }
    let mut needed = WAY_OUT;
    if stuck(ACCEL) == [true; 3] {
        gyroscope = of_axes(true, [true; 3]);
        needed = "gravity, from which they are determined, is not measured";
    }
    if !gyroscope.is_empty() {
        parts.push(format!("the data do not determine the gyroscope's {}: {needed}", gyroscope.join(", ")));
    }
    parts.join("; ")
}

/// An axis that is constant over most of the recording.
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
                "{} is constant at {} {} for {} samples ({:.0} % of the recording, {})",
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

fn moves(rows: Samples<'_>, axis: usize) -> bool {
    range(rows, axis) >= MOVING_STEPS * converter_step(rows, axis)
}

/// Whether the axis is noisy: more than half of its samples differ from the previous sample.
fn is_noisy(rows: Samples<'_>, axis: usize) -> bool {
    let mut changes = 0;
    rows.neighbours(axis, |before, after| changes += usize::from(after != before));
    2 * changes > rows.len()
}

/// Whether the values of the axis change so much that noise cannot be the cause: by at least [`MOVING_STEPS`] steps of
/// the converter, and by more than 0.3 times the largest magnitude of the values.
fn moves_widely(rows: Samples<'_>, axis: usize) -> bool {
    let [low, high] = extremes(rows, axis);
    moves(rows, axis) && high - low > 0.3 * low.abs().max(high.abs())
}

#[cfg(test)]
mod tests {
    use super::super::example::Columns;
    use super::*;
    use crate::check::survey::Survey;
    use crate::finding::Severity;

    fn found(columns: &Columns) -> Vec<Finding> {
        check(&columns.recording(), &Survey::of(&columns.recording()).runs)
    }

    #[test]
    fn fine_and_coarse_data_are_not_stuck() {
        for columns in [Columns::tumbling(), Columns::tumbling().quantised(0.05, 0.01)] {
            assert!(found(&columns).is_empty());
        }
    }

    #[test]
    fn an_axis_that_stops_is_stuck() {
        let mut columns = Columns::tumbling();
        columns.rate[1000..].iter_mut().for_each(|row| row[1] = 0.25);
        let findings = found(&columns);
        assert_eq!(findings[0].columns, ["gyro_y"]);
        assert_eq!((findings[0].count, findings[0].severity), (3000, Severity::Error));

        let mut dead = Columns::tumbling();
        dead.rate.iter_mut().for_each(|row| *row = [0.0; 3]);
        assert_eq!(found(&dead)[0].columns, GYRO);
    }

    #[test]
    fn a_rest_without_noise_and_a_coarse_one_are_not_stuck() {
        let mut still = Columns::tumbling();
        for i in 1000..4000 {
            still.force[i] = still.force[1000];
            still.rate[i] = still.rate[1000];
        }
        assert!(found(&still).is_empty());
        // The step of the converter is three times the noise. At rest, the values therefore change only by single
        // steps.
        let mut coarse = Columns::tumbling().quantised(0.06, 0.009);
        for i in 0..3000 {
            coarse.force[i] = coarse.force[i % 90];
            coarse.rate[i] = coarse.rate[i % 90];
            coarse.rate[i][0] = 0.0;
        }
        assert!(found(&coarse).is_empty());
    }

    #[test]
    fn an_axis_that_nothing_turns_is_a_warning_without_noise() {
        let mut columns = Columns::tumbling();
        for (i, row) in columns.rate.iter_mut().enumerate() {
            let moving = f64::from(u8::from(i % 200 >= 150));
            *row = [0.0, moving * (i as f64).sin(), moving * (i as f64).cos()];
        }
        let findings = found(&columns);
        assert_eq!(findings.len(), 1);
        assert_eq!(
            (findings[0].columns.as_slice(), findings[0].severity),
            (&["gyro_x".to_string()][..], Severity::Warning)
        );
    }
}
