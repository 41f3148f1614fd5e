//! Check of the estimated gains, which detects an axis whose unit of measurement differs from the unit in its column
//! name.
//!
//! The fit accepts any scale. For example, if accel_x is in g and the other axes are in m/s^2, the residuals are small
//! and the gain of x is 0.1. The gain of an axis is the norm of its row of the sensitivity matrix (raw unit per SI
//! unit). In SI units, it is near 1 for every sensor on the market. In counts, the gain can have any value, but the
//! axes of one chip have nearly equal gains.

use imucal_core::calibration::Calibration;
use imucal_core::sensor::Triad;

use super::{ACCEL, GYRO, names};
use crate::finding::Finding;
use crate::recording::{RawUnit, Recording};

/// Limits of a plausible gain of an axis in SI units (ideal: 1); datasheets specify 0.9 to 1.1 or better.
const GAIN: [f64; 2] = [0.75, 1.25];

/// For axes in counts: maximum plausible ratio of the largest to the smallest gain of the three axes of a sensor. It is
/// the ratio of the limits of [`GAIN`].
const MOST_APART: f64 = GAIN[1] / GAIN[0];

/// A gain that all axes of a gyroscope have in common is reported if |gain - 1| is above this value. A wrong clock rate
/// causes such a gain. The error of a quartz clock is far smaller than this limit. The error of a sensor's internal
/// oscillator, or of a guessed sampling rate, can be larger.
const COMMON_GAIN: f64 = 0.01;

/// The axes have a common gain if |gain of the axis - mean gain| <= COMMON_SHARE x |mean gain - 1| for each axis. The
/// scale errors of the axes of a sensor are independent, and rarely agree so well by coincidence.
const COMMON_SHARE: f64 = 1.0 / 3.0;

/// Reports up to four kinds of findings. `accel_units` and `gyro_units` (errors): an axis in SI units has an
/// implausible gain. `gains_differ` (a warning): axes in counts have different gains. `gyro_common_gain` (a warning):
/// all gyroscope axes in SI units have the same gain, and it differs from 1. `recording` is the first recording of the
/// calibrated device.
pub fn check_gains(recording: &Recording, calibration: &Calibration<f64>) -> Vec<Finding> {
    let mut findings: Vec<Finding> = check_accelerometer_gains(recording, &calibration.accelerometer)
        .into_iter()
        .chain(gains_of_sensor(recording, recording.gyro_unit, &calibration.gyroscope, (GYRO, "gyro_units")))
        .collect();
    if recording.gyro_unit == RawUnit::Si && findings.is_empty() {
        findings.extend(common_gain(recording, gains_of(&calibration.gyroscope)));
    }
    findings
}

/// Performs the checks of [`check_gains`] for an accelerometer without a gyroscope.
pub fn check_accelerometer_gains(recording: &Recording, accelerometer: &Triad<f64>) -> Option<Finding> {
    gains_of_sensor(recording, recording.accel_unit, accelerometer, (ACCEL, "accel_units"))
}

fn gains_of_sensor(
    recording: &Recording,
    unit: RawUnit,
    triad: &Triad<f64>,
    (columns, code): ([&str; 3], &'static str),
) -> Option<Finding> {
    match unit {
        RawUnit::Si => odd_gains(recording, gains_of(triad), columns, code),
        RawUnit::Lsb => different_gains(recording, gains_of(triad), columns),
    }
}

fn gains_of(triad: &Triad<f64>) -> [f64; 3] {
    [0, 1, 2].map(|axis| triad.sensitivity().row(axis).norm())
}

fn common_gain(recording: &Recording, gains: [f64; 3]) -> Option<Finding> {
    let mean = gains.iter().sum::<f64>() / 3.0;
    let apart = gains.iter().map(|gain| (gain - mean).abs()).fold(0.0, f64::max);
    if (mean - 1.0).abs() <= COMMON_GAIN || apart > COMMON_SHARE * (mean - 1.0).abs() {
        return None;
    }
    let percent = 100.0 * (mean - 1.0).abs();
    let (sense, stamps) = if mean > 1.0 { ("above", "long") } else { ("below", "short") };
    Some(Finding {
        columns: names(GYRO),
        count: recording.len(),
        value: mean,
        unit: "ratio",
        message: format!(
            "the gains of all three gyroscope axes ({}) are {percent:.1} % {sense} 1: a common factor points to the \
             clock or to the unit, not to the sensor",
            gains.map(|gain| format!("{gain:.4}")).join(", ")
        ),
        way_out: format!(
            "compare the duration of the recording with another clock, because time stamps that are {percent:.1} % too \
             {stamps} give this gain; check the sensitivity by which counts were converted; if both are right, the \
             gain is that of the sensor"
        ),
        ..Finding::warning("gyro_common_gain", recording.name)
    })
}

fn odd_gains(recording: &Recording, gains: [f64; 3], columns: [&str; 3], code: &'static str) -> Option<Finding> {
    let odd: Vec<usize> = (0..3).filter(|&axis| !(GAIN[0]..=GAIN[1]).contains(&gains[axis])).collect();
    let farthest = odd.iter().copied().max_by(|&a, &b| gains[a].ln().abs().total_cmp(&gains[b].ln().abs()))?;
    let parts: Vec<String> =
        odd.iter().map(|&axis| format!("{} has the gain {:.4}", columns[axis], gains[axis])).collect();
    Some(Finding {
        columns: names(odd.iter().map(|&axis| columns[axis])),
        count: recording.len(),
        value: gains[farthest],
        unit: "ratio",
        message: format!("{}; gains from {} to {} are plausible", parts.join(", "), GAIN[0], GAIN[1]),
        way_out: "give every column in the unit of its name, or as raw counts; for a gyroscope check the time column and the sample rate"
            .into(),
        ..Finding::error(code, recording.name)
    })
}

fn different_gains(recording: &Recording, gains: [f64; 3], columns: [&str; 3]) -> Option<Finding> {
    let mut sorted = gains;
    sorted.sort_by(f64::total_cmp);
    let [least, middle, most] = sorted;
    if most <= MOST_APART * least {
        return None;
    }
    // `odd` is the gain that differs most from the other two gains.
    let odd = if most * least > middle * middle { most } else { least };
    let axis = gains.iter().position(|gain| *gain == odd)?;
    Some(Finding {
        columns: vec![columns[axis].to_owned()],
        count: recording.len(),
        value: odd / middle,
        unit: "ratio",
        message: format!("{} has {:.4} times the counts per unit of another axis", columns[axis], odd / middle),
        way_out: "nothing to do if the axes are sensors of different types; else this column was scaled separately: check how it was recorded"
            .into(),
        ..Finding::warning("gains_differ", recording.name)
    })
}

#[cfg(test)]
mod tests {
    use imucal_core::sensor::Triad;
    use nalgebra::{Matrix3, Rotation3, Vector3};

    use super::super::example::Columns;
    use super::*;
    use crate::finding::Severity;

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
    fn counts_may_have_any_gain_and_axes_that_differ_are_a_warning() {
        let columns = Columns::tumbling();
        let lsb = Recording { accel_unit: RawUnit::Lsb, gyro_unit: RawUnit::Lsb, ..columns.recording() };
        let of = |gains| check_gains(&lsb, &Calibration::new(triad([400.0; 3]), triad(gains)));
        assert!(of([4000.0, 3000.0, 3500.0]).is_empty());
        for (gains, column, ratio) in
            [([4000.0, 939.0, 939.0], "gyro_x", 4000.0 / 939.0), ([940.0, 470.0, 939.0], "gyro_y", 470.0 / 939.0)]
        {
            let findings = of(gains);
            assert_eq!((findings.len(), findings[0].code), (1, "gains_differ"));
            assert_eq!((findings[0].severity, findings[0].columns[0].as_str()), (Severity::Warning, column));
            assert!((findings[0].value - ratio).abs() < 1e-9);
        }
    }

    #[test]
    fn a_gain_that_all_gyroscope_axes_share_is_a_warning() {
        let columns = Columns::tumbling();
        let of =
            |recording: &Recording<'_>, gains| check_gains(recording, &Calibration::new(triad([1.0; 3]), triad(gains)));
        for gains in [[1.02, 1.021, 1.018], [0.96, 0.97, 0.965]] {
            let findings = of(&columns.recording(), gains);
            assert_eq!((findings.len(), findings[0].code), (1, "gyro_common_gain"));
            assert_eq!(findings[0].severity, Severity::Warning);
            let lsb = Recording { gyro_unit: RawUnit::Lsb, ..columns.recording() };
            assert!(of(&lsb, gains).is_empty());
        }
        for gains in [[1.009, 1.009, 1.009], [1.03, 1.0, 1.015], [0.97, 1.03, 1.02]] {
            assert!(of(&columns.recording(), gains).is_empty());
        }
    }
}
