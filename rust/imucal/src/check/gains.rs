//! The calibration itself: one axis in another unit than its column's name says.
//!
//! A fit takes any scale: with accel_x in g and the other axes in m/s^2 it finds a perfect T, a tenth on x. In SI units
//! the gain of an axis, the length of its row of T, is near 1 for every sensor on the market. Counts are not judged.

use imucal_core::calibration::Calibration;
use imucal_core::sensor::Triad;

use super::{ACCEL, GYRO, names};
use crate::finding::Finding;
use crate::recording::{RawUnit, Recording};

/// Gain of an axis in SI units; datasheets promise 0.9 to 1.1 or better.
const GAIN: [f64; 2] = [0.75, 1.25];

/// `accel_units` and `gyro_units` for axes whose gain no sensor has; `recording` is the first one of the unit.
pub fn check_gains(recording: &Recording, calibration: &Calibration<f64>) -> Vec<Finding> {
    let accelerometer = (recording.accel_unit, &calibration.accelerometer, ACCEL, "accel_units");
    let gyroscope = (recording.gyro_unit, &calibration.gyroscope, GYRO, "gyro_units");
    [accelerometer, gyroscope]
        .into_iter()
        .filter(|(unit, ..)| *unit == RawUnit::Si)
        .filter_map(|(_, triad, columns, code)| odd_gains(recording, triad, columns, code))
        .collect()
}

fn odd_gains(recording: &Recording, triad: &Triad<f64>, columns: [&str; 3], code: &'static str) -> Option<Finding> {
    let gains = [0, 1, 2].map(|axis| triad.sensitivity().row(axis).norm());
    let odd: Vec<usize> = (0..3).filter(|&axis| !(GAIN[0]..=GAIN[1]).contains(&gains[axis])).collect();
    let farthest = odd.iter().copied().max_by(|&a, &b| gains[a].ln().abs().total_cmp(&gains[b].ln().abs()))?;
    let parts: Vec<String> =
        odd.iter().map(|&axis| format!("{} has the gain {:.4}", columns[axis], gains[axis])).collect();
    Some(Finding {
        columns: names(odd.iter().map(|&axis| columns[axis])),
        count: recording.len(),
        value: gains[farthest],
        unit: "ratio",
        message: format!("{}, where {} to {} can be", parts.join(", "), GAIN[0], GAIN[1]),
        way_out: "give every column in the unit that its name says, or as raw counts; check the time column and the sample rate for a gyroscope"
            .into(),
        ..Finding::error(code, recording.name)
    })
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix3, Rotation3, Vector3};

    use super::super::example::Columns;
    use super::*;

    fn triad(gains: [f64; 3]) -> Triad<f64> {
        let turn = Rotation3::from_euler_angles(0.4, -1.0, 2.0);
        Triad::try_new(Matrix3::from_diagonal(&Vector3::from(gains)) * turn.matrix(), Vector3::zeros()).unwrap()
    }

    #[test]
    fn the_axis_is_named_however_the_frame_is_turned() {
        let columns = Columns::tumbling();
        let good = [1.1, 0.9, 1.0];
        for axis in 0..3 {
            for factor in [0.102, 0.5, 1.5, 57.3] {
                let mut bad = good;
                bad[axis] *= factor;
                let accelerometer = Calibration::new(triad(bad), triad(good));
                let findings = check_gains(&columns.recording(), &accelerometer);
                assert_eq!((findings.len(), findings[0].code), (1, "accel_units"));
                assert_eq!(findings[0].columns, [ACCEL[axis]]);
                let gyroscope = Calibration::new(triad(good), triad(bad));
                let findings = check_gains(&columns.recording(), &gyroscope);
                assert_eq!((findings[0].code, findings[0].columns[0].as_str()), ("gyro_units", GYRO[axis]));
            }
        }
        let calibration = Calibration::new(triad(good), triad(good));
        assert!(check_gains(&columns.recording(), &calibration).is_empty());
    }

    #[test]
    fn counts_may_have_any_gain() {
        let columns = Columns::tumbling();
        let lsb = Recording { accel_unit: RawUnit::Lsb, gyro_unit: RawUnit::Lsb, ..columns.recording() };
        let calibration = Calibration::new(triad([400.0; 3]), triad([4000.0, 939.0, 939.0]));
        assert!(check_gains(&lsb, &calibration).is_empty());
    }
}
