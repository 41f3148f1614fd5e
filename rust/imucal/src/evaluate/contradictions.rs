//! Checks whether units, axes and time stamps of control recordings agree with a calibration.
//! [`calibrate`](mod@crate::calibrate) refuses a recording that fails one of these checks. The evaluation reports a
//! failed check as a warning, in addition to its verdict.

use std::ops::Range;

use imucal_core::calibration::Calibration;
use nalgebra::Vector3;

use super::{Evaluation, MoveReport};
use crate::check::{check_calibrated, check_rests};
use crate::finding::{Finding, Severity};
use crate::numerics::stats::{median, sample_interval_s};
use crate::preintegration::kinematics::rate_from_gravity;
use crate::recording::Recording;
use crate::rests::moves::Move;

/// Returns warnings about units, axes and time stamps that make `evaluation` poor or meaningless.
///
/// `judged` are the measured `recordings`, or the recordings that are already corrected for effects. `triads` converts
/// the samples of `judged` to angular rate and specific force.
pub(super) fn contradictions(
    recordings: &[Recording<'_>],
    (judged, triads): (&[Recording<'_>], &Calibration<f64>),
    evaluation: &Evaluation,
    gravity_mps2: f64,
) -> Vec<Finding> {
    let of_recording = |index: usize| {
        let own = evaluation.rests.iter().filter(|rest| rest.recording == index);
        let ranges: Vec<Range<usize>> = own.map(|rest| rest.first..rest.end).collect();
        let mut found = check_rests(&recordings[index], &ranges, gravity_mps2);
        found.retain(|finding| finding.severity == Severity::Error);
        if found.is_empty() {
            found = of_motion(index, judged, triads, evaluation);
        }
        found
    };
    let warning = |finding| Finding { severity: Severity::Warning, ..finding };
    (0..recordings.len()).flat_map(of_recording).map(warning).collect()
}

/// Compares the calibrated rates of one recording with the rotation of gravity during its moves.
fn of_motion(
    index: usize,
    judged: &[Recording<'_>],
    Calibration { accelerometer, gyroscope, .. }: &Calibration<f64>,
    evaluation: &Evaluation,
) -> Vec<Finding> {
    let recording = &judged[index];
    let usable = |m: &&MoveReport| m.recording == index && m.excluded.is_none();
    let moves: Vec<Move> = evaluation.moves.iter().filter(usable).map(|m| as_move(m, recording)).collect();
    let own: Vec<_> = evaluation.rests.iter().filter(|rest| rest.recording == index).collect();
    // The gyroscope bias is estimated from the rests of this recording. The bias of the calibration is not used,
    // because it does not apply to rates in wrong units.
    let bias = Vector3::from_fn(|axis, _| {
        median(&mut own.iter().map(|rest| rest.mean_angular_rate[axis]).collect::<Vec<f64>>())
    });
    let Some(found) = rate_from_gravity(judged, &moves, accelerometer, bias) else { return Vec::new() };
    check_calibrated(recording, &(found.rate_from_raw * gyroscope.sensitivity()), found.explained)
}

fn as_move(m: &MoveReport, recording: &Recording<'_>) -> Move {
    Move {
        recording: m.recording,
        from: m.from_rest,
        to: m.to_rest,
        first: m.first,
        last: m.last,
        duration_s: m.duration_s,
        interval_s: sample_interval_s(&recording.time_s[m.first..=m.last]),
    }
}

#[cfg(test)]
mod tests {
    use imucal_core::sensor::Triad;

    use super::super::evaluate;
    use super::*;
    use crate::simulate::{Program, RandomMoves, Sensor, Unit, simulate};

    fn found(change: impl Fn([f64; 3]) -> [f64; 3], late: usize) -> Vec<Finding> {
        let program = Program::random(&RandomMoves { moves: 15, ..RandomMoves::default() }, 5).unwrap();
        let unit = Unit::paper();
        let run = simulate(&program, &unit, 100.0, 9.80665, 5).unwrap();
        let recording = run.recording("control.csv");
        let count = recording.len() - late;
        let rate: Vec<[f64; 3]> = recording.angular_rate.iter().take(count).map(change).collect();
        let control = Recording {
            time_s: &recording.time_s[late..],
            specific_force: recording.specific_force.slice(late..recording.len()),
            angular_rate: (&rate).into(),
            temperature_degc: None,
            stand_rad: None,
            ..recording
        };
        let triad = |sensor: &Sensor| Triad::try_new(sensor.sensitivity, sensor.bias).unwrap();
        let truth = Calibration::new(triad(&unit.accelerometer), triad(&unit.gyroscope));
        let evaluation = evaluate(&truth, None, &[control], 9.80665, 1.0).unwrap();
        evaluation.findings.into_iter().filter(|finding| finding.columns.iter().any(|c| c.contains("gyro"))).collect()
    }

    #[test]
    fn wrong_units_axes_and_time_stamps_are_named_and_right_ones_are_not() {
        assert_eq!(found(|w| w, 0), []);
        for (change, late, code) in [
            ((|[x, y, z]| [-x, y, z]) as fn([f64; 3]) -> [f64; 3], 0, "left_handed_axes"),
            (|[x, y, z]| [y, x, z], 0, "left_handed_axes"),
            (|w| w.map(|v| 0.55 * v), 0, "gyro_units"),
            (|[x, y, z]| [x, y, z + 1.7], 0, "gyro_units"),
            (|w| w, 90, "sensors_not_together"),
        ] {
            let findings = found(change, late);
            assert_eq!(findings.iter().map(|finding| finding.code).collect::<Vec<_>>(), [code], "{findings:?}");
            assert_eq!((findings[0].severity, &findings[0].recording[..]), (Severity::Warning, "control.csv"));
        }
    }
}
