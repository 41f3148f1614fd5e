//! Checks of the gyroscope's unit, handedness and order of axes. They use the rotation of the gravity direction in the
//! body frame during moves.
//!
//! In every move the direction u of gravity rotates in the body frame: u' = u x w, with the angular rate w. A linear
//! fit of this equation yields P in w = P (raw - bias). Let G and A be the signed permutations by which the reported
//! gyroscope and accelerometer axes differ from the true axes. Then P = det(A) A G^-1. The sign of det P is the sign of
//! det G, which is the handedness of the gyroscope. If only the accelerometer is left-handed, P = -A, which is a
//! rotation. One reversed accelerometer axis therefore has the same P as a half turn of the gyroscope about this axis.
//! Two exchanged accelerometer axes have the same P as a half turn of the gyroscope about a diagonal, which exchanges
//! these axes and reverses all three. If the columns of both sensors are mirrored in the same way, P = -I, as for a
//! gyroscope of reversed sign.

use nalgebra::Matrix3;

use super::axes::{SignedPermutation, recommendation};
use super::{ACCEL, GYRO, names};
use crate::finding::Finding;
use crate::recording::{RawUnit, Recording};

/// Limits of the scale |det P|^(1/3) of the matrix P in true rate = P (raw - bias), for a gyroscope in the correct unit
/// (ideal: 1). The scale errors of sensors are far smaller.
const RIGHT_UNIT: [f64; 2] = [0.5, 2.0];
/// Narrower limits of the scale |det P|^(1/3), for a gyroscope whose calibration has been applied.
const CALIBRATED: [f64; 2] = [0.7, 1.4];
/// The measured rates are too large by the factor 1 / (scale of P). If a wrong unit of measurement causes this factor,
/// it is the conversion factor between two units, for example 57.3 for deg/s read as rad/s. The finding names a unit if
/// the relative difference between the factor and the conversion factor is below this value.
const KNOWN: f64 = 0.25;
/// The true P is nearly a rotation times a scale, so its singular values are nearly equal. If (smallest singular value
/// of P) / (largest singular value of P) is below this value, the motion did not determine P, and no finding is
/// reported.
const WELL_DETERMINED: f64 = 0.1;
/// If the rates explain less than this share of the changes of the gravity direction, P is not used to check units and
/// axes. The share is usually 0.998 on a stand and 0.8 in hand-held moves. It is 0.5 if the rates are 0.6 s late and a
/// move takes one second.
const LEAST_EXPLAINED: f64 = 0.6;
/// If the rates explain less than this share of the changes of the gravity direction, the gyroscope may belong to
/// another device or recording, and the calibration is refused. A gyroscope that is 0.8 s late in moves of one second
/// is not refused, because its share is 0.12.
const UNRELATED: f64 = 0.1;
/// A finding names a signed permutation only if the correlation of P with it is at least this value (1: P equals the
/// permutation; 0.97: P is rotated from it by 18 deg).
const CLEAR: f64 = 0.85;

/// Checks `rate_from_raw`, which is P in true_rate = P (raw - bias), fitted linearly to the kinematics of gravity in
/// all moves. `explained` is the share of the changes of the gravity direction that the rates explain with this P.
///
/// Codes: `sensors_not_together`, `gyro_units` (SI columns only), `left_handed_axes`, `axes_turned`. If P is not
/// finite, or is nearly singular because of too little motion, there is no finding. For counts, only the handedness and
/// the order of the axes are checked.
///
/// # Example
/// If the raw x axis is reversed, P is near diag(-1, 1, 1) and det P < 0: the finding `left_handed_axes` names
/// `gyro_x`.
pub fn check_kinematics(recording: &Recording, rate_from_raw: &Matrix3<f64>, explained: f64) -> Vec<Finding> {
    check_rates(recording, (rate_from_raw, explained), RIGHT_UNIT)
}

/// Like [`check_kinematics`], for a recording whose rates a calibration has corrected: `p` is P in true_rate = P
/// (corrected rate - bias).
pub(crate) fn check_calibrated(recording: &Recording, p: &Matrix3<f64>, explained: f64) -> Vec<Finding> {
    check_rates(recording, (p, explained), CALIBRATED)
}

fn check_rates(recording: &Recording, (p, explained): (&Matrix3<f64>, f64), right_unit: [f64; 2]) -> Vec<Finding> {
    if explained < LEAST_EXPLAINED {
        return vec![not_together(recording, explained)];
    }
    if !p.iter().all(|v| v.is_finite()) || !is_well_determined(p) {
        return Vec::new();
    }
    let scale = p.determinant().abs().cbrt();
    let mut findings = Vec::new();
    if recording.gyro_unit == RawUnit::Si {
        findings.extend(unit(recording, scale, right_unit));
    }
    let (axes, correlation) = SignedPermutation::closest(&(p / scale));
    if correlation < CLEAR {
        findings.extend((p.determinant() < 0.0).then(|| unlike_any(recording, correlation)));
    } else if !axes.is_identity() {
        findings.push(wrong_axes(recording, &axes, correlation));
    }
    findings
}

/// Reports that the sensors did not move together, because the rates do not explain the changes of the direction of
/// gravity. The finding is only a warning if the rates explain part of these changes, because two harmless causes also
/// change the measured direction. First, the unit may have been accelerated during the moves. The calibration computes
/// the directions of gravity only from rests, so this acceleration has no effect. Second, the gyroscope may be late. It
/// then still measures the whole rotation between two rests that are longer than its delay.
fn not_together(recording: &Recording, explained: f64) -> Finding {
    let share = format!(
        "the rates explain only {:.0} % of the changes of the direction of gravity inside moves",
        100.0 * explained.max(0.0)
    );
    let (kind, cause, way_out) = if explained < UNRELATED {
        (
            Finding::error as fn(_, &_) -> _,
            "as if the two sensors had not moved together",
            "check that both sensors are of the same unit and recording, and that their time stamps have the same zero",
        )
    } else {
        (
            Finding::warning as fn(_, &_) -> _,
            "because the unit was accelerated during the moves, as when it is carried, or because the two sensors did not \
             move together",
            "if the unit was carried and the verdict is good, nothing has to be done; otherwise check that both sensors \
             are of the same unit and recording, and that their time stamps have the same zero",
        )
    };
    Finding {
        columns: names(GYRO),
        count: recording.len(),
        value: explained,
        unit: "ratio",
        message: format!("{share}, {cause}"),
        way_out: way_out.into(),
        ..kind("sensors_not_together", recording.name)
    }
}

fn is_well_determined(p: &Matrix3<f64>) -> bool {
    let squares = (p.transpose() * p).symmetric_eigenvalues();
    squares.min() > WELL_DETERMINED.powi(2) * squares.max()
}

/// Recommendation if the scale of P is not a known conversion factor between units. Only the product of rate and time
/// is observable, so the recommendation names the units of both.
const OTHERWISE: &str = "give the columns in the unit of their names, or as raw counts: gyro_x_lsb; or the time or the \
                         sample rate is wrong by this factor: correct it";

fn unit(recording: &Recording, scale: f64, [least, most]: [f64; 2]) -> Option<Finding> {
    if (least..=most).contains(&scale) {
        return None;
    }
    let known = [
        (57.29578, "looks like deg/s: name the columns gyro_x_dps, gyro_y_dps, gyro_z_dps"),
        (57295.78, "looks like mdeg/s: name the columns gyro_x_mdps, gyro_y_mdps, gyro_z_mdps"),
        (1000.0, "looks like mrad/s: divide by 1000"),
        (1.0 / 57.29578, "looks like rad/s converted from deg/s a second time: multiply by 57.29578"),
        (1e-3, "looks 1000 times too small: multiply by 1000"),
    ];
    let too_large = 1.0 / scale;
    let way_out =
        known.iter().find(|(factor, _)| (too_large / factor - 1.0).abs() < KNOWN).map_or(OTHERWISE, |(_, hint)| hint);
    Some(Finding {
        columns: names(GYRO),
        count: recording.len(),
        value: too_large,
        unit: "ratio",
        message: format!(
            "the rates are {too_large:.4} times those with which the direction of gravity changes in the body"
        ),
        way_out: way_out.into(),
        ..Finding::error("gyro_units", recording.name)
    })
}

/// Returns the finding `left_handed_axes` or `axes_turned` for a gyroscope whose axes differ from the axes of the
/// accelerometer by the signed permutation `axes`.
fn wrong_axes(recording: &Recording, axes: &SignedPermutation, correlation: f64) -> Finding {
    let of = |triad: [&str; 3], which: &[usize]| names(which.iter().map(|&k| triad[k]));
    let error = || Finding::error("left_handed_axes", recording.name);
    let (found, columns, what) = if axes.determinant() < 0.0 {
        let columns = axes.reversed_axis().map_or(names(GYRO), |axis| of(GYRO, &[axis]));
        (error(), columns, "the gyroscope's or the accelerometer's axes are left-handed")
    } else if let Some(axis) = axes.half_turn() {
        (error(), of(ACCEL, &[axis]), "one accelerometer axis is reversed, or two gyroscope axes are")
    } else if let Some(pair) = axes.exchanged_and_reversed() {
        (error(), of(ACCEL, &pair), "two accelerometer axes are exchanged, or the gyroscope is rotated by 180 deg")
    } else {
        let turned = Finding::warning("axes_turned", recording.name);
        (turned, names(GYRO), "the gyroscope's axes are rotated relative to the accelerometer's")
    };
    Finding {
        columns,
        count: recording.len(),
        value: correlation,
        unit: "correlation",
        message: format!("{what}: {} (correlation {correlation:.2})", axes.mapping()),
        way_out: recommendation(axes),
        ..found
    }
}

/// Returns the finding `left_handed_axes` for a P with det P < 0 that is not close to any signed permutation of the
/// axes.
fn unlike_any(recording: &Recording, correlation: f64) -> Finding {
    Finding {
        columns: names(GYRO),
        count: recording.len(),
        value: correlation,
        unit: "correlation",
        message: format!(
            "the rates do not follow the rotation of gravity by any order and any signs of the axes (largest correlation \
             {correlation:.2})"
        ),
        way_out:
            "check that both sensors were recorded by the same unit at the same time, and that all six columns are \
                  what their names say"
                .into(),
        ..Finding::error("left_handed_axes", recording.name)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{SMatrix, Vector3};

    use super::super::example::Columns;
    use super::*;
    use crate::finding::Severity;

    /// The matrix `p`, changed by typical scale and misalignment errors of a sensor.
    fn near(p: Matrix3<f64>) -> Matrix3<f64> {
        p * Matrix3::new(0.98, 0.05, -0.06, -0.04, 1.03, 0.02, 0.03, -0.05, 1.0)
    }

    const EXPLAINED: f64 = 0.8;

    fn judge(p: Matrix3<f64>) -> Vec<Finding> {
        check_kinematics(&Columns::tumbling().recording(), &p, EXPLAINED)
    }

    fn diagonal(x: f64, y: f64, z: f64) -> Matrix3<f64> {
        Matrix3::new(x, 0.0, 0.0, 0.0, y, 0.0, 0.0, 0.0, z)
    }

    #[test]
    fn a_sensor_with_ordinary_errors_and_no_motion_are_clean() {
        assert!(judge(near(Matrix3::identity())).is_empty());
        assert!(judge(near(diagonal(0.8, 1.3, 0.9))).is_empty());
        assert!(judge(Matrix3::zeros()).is_empty());
        assert!(judge(diagonal(1.0, 1.0, -0.01)).is_empty());
        assert!(judge(diagonal(1.0, f64::NAN, 1.0)).is_empty());
    }

    /// If the gyroscope is late, the fitted P is too small, which looks like a wrong unit of measurement.
    #[test]
    fn rates_that_do_not_follow_gravity_say_nothing_about_their_unit() {
        for (explained, severity) in [(0.3, Severity::Warning), (0.05, Severity::Error)] {
            let p = near(Matrix3::identity() / 6.6);
            let findings = check_kinematics(&Columns::tumbling().recording(), &p, explained);
            assert_eq!((findings.len(), findings[0].code), (1, "sensors_not_together"));
            assert_eq!(findings[0].severity, severity);
            assert_eq!(findings[0].way_out.contains("was carried"), severity == Severity::Warning);
        }
    }

    #[test]
    fn units_are_named_by_their_factor() {
        for (factor, hint) in [
            (57.29578, "gyro_x_dps"),
            (57295.78, "gyro_x_mdps"),
            (1000.0, "mrad/s"),
            (1.0 / 57.29578, "second time"),
            (16.4, "gyro_x_lsb"),
        ] {
            let findings = judge(near(Matrix3::identity() / factor));
            assert_eq!((findings.len(), findings[0].code), (1, "gyro_units"));
            assert!(findings[0].way_out.contains(hint), "{}", findings[0]);
        }
    }

    #[test]
    fn a_calibrated_gyroscope_has_tighter_limits() {
        let recording = Columns::tumbling();
        let of = |p| check_calibrated(&recording.recording(), &p, EXPLAINED);
        assert!(of(near(Matrix3::identity())).is_empty());
        let half = near(Matrix3::identity() * 1.9);
        assert!(judge(half).is_empty());
        assert_eq!(of(half)[0].code, "gyro_units");
    }

    #[test]
    fn counts_have_no_unit_but_a_handedness() {
        let columns = Columns::tumbling();
        let lsb = Recording { gyro_unit: RawUnit::Lsb, ..columns.recording() };
        assert!(check_kinematics(&lsb, &near(Matrix3::identity() / 4770.0), EXPLAINED).is_empty());
        let findings = check_kinematics(&lsb, &near(diagonal(1.0, -1.0, 1.0) / 4770.0), EXPLAINED);
        assert_eq!(findings[0].code, "left_handed_axes");
    }

    #[test]
    fn one_gyro_axis_reversed_is_named() {
        for axis in 0..3 {
            let mut p = Matrix3::identity();
            p[(axis, axis)] = -1.0;
            let findings = judge(near(p));
            assert_eq!(findings.len(), 1);
            assert_eq!((findings[0].code, findings[0].severity), ("left_handed_axes", Severity::Error));
            assert_eq!(findings[0].columns, [GYRO[axis]]);
        }
        assert!(judge(near(-Matrix3::identity()))[0].way_out.contains("axes='gyro=-x,-y,-z'"));
    }

    /// Simulates directions and rates, and fits P in u' = u x P w, which is linear in the nine entries of P. u is the
    /// gravity direction that the accelerometer reports, and w the rate that the gyroscope reports. `accel` and `gyro`
    /// are the matrices that convert true to reported values.
    fn fitted(accel: &Matrix3<f64>, gyro: &Matrix3<f64>) -> Matrix3<f64> {
        let (mut normal, mut right) = (SMatrix::<f64, 9, 9>::zeros(), SMatrix::<f64, 9, 1>::zeros());
        for i in 0..50 {
            let t = f64::from(i);
            let up = Vector3::new(t.sin(), (1.7 * t).cos(), (0.6 * t).sin()).normalize();
            let rate = Vector3::new((2.3 * t).sin(), (0.9 * t).cos(), (1.1 * t).sin());
            let (change, up, rate) = (accel * up.cross(&rate), accel * up, gyro * rate);
            // The nine unknowns are the entries of P in column-major order. Entry (r, c) multiplies component c of the
            // reported rate. The product is a rate about axis r.
            let rows = SMatrix::<f64, 3, 9>::from_fn(|k, n| (up.cross(&Vector3::ith(n % 3, 1.0)) * rate[n / 3])[k]);
            normal += rows.transpose() * rows;
            right += rows.transpose() * change;
        }
        let entries = normal.lu().solve(&right).unwrap();
        Matrix3::from_column_slice(entries.as_slice())
    }

    #[test]
    fn the_reversed_axis_is_named_from_the_motion_itself() {
        for axis in 0..3 {
            let mut reversed = Matrix3::identity();
            reversed[(axis, axis)] = -1.0;
            for (p, column) in [
                (fitted(&reversed, &Matrix3::identity()), ACCEL[axis]),
                (fitted(&Matrix3::identity(), &reversed), GYRO[axis]),
            ] {
                let findings = judge(near(p));
                assert_eq!((findings.len(), findings[0].code), (1, "left_handed_axes"));
                assert_eq!(findings[0].columns, [column]);
            }
        }
        assert!(judge(near(fitted(&Matrix3::identity(), &Matrix3::identity()))).is_empty());
    }

    #[test]
    fn exchanged_accelerometer_columns_are_named_and_a_mounting_is_not() {
        let [x, y, z] = [0, 1, 2].map(|k| Vector3::ith(k, 1.0));
        for (exchanged, columns) in [([y, x, z], [0, 1]), ([z, y, x], [0, 2]), ([x, z, y], [1, 2])] {
            let accel = Matrix3::from_columns(&exchanged);
            let findings = judge(near(fitted(&accel, &Matrix3::identity())));
            assert_eq!((findings[0].code, findings[0].severity), ("left_handed_axes", Severity::Error));
            assert_eq!(findings[0].columns, columns.map(|k| ACCEL[k]));
        }
        // The rotation from east-north-up to north-east-down is also a half turn about a diagonal. It is a common
        // mounting, so the finding is only a warning.
        let ned = Matrix3::from_columns(&[y, x, -z]);
        assert_eq!(judge(near(ned))[0].severity, Severity::Warning);
    }

    #[test]
    fn a_quarter_turn_is_a_warning_with_its_mapping() {
        // true x = -raw y, true y = raw x.
        let p = Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
        let findings = judge(near(p));
        assert_eq!((findings[0].code, findings[0].severity), ("axes_turned", Severity::Warning));
        assert!(findings[0].message.contains("gyro y follows accelerometer -x"));
        assert!(findings[0].message.contains("gyro x follows accelerometer y"));
    }

    #[test]
    fn swapped_gyro_columns_are_left_handed() {
        let swapped = Matrix3::new(0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
        let findings = judge(near(swapped));
        assert_eq!(findings[0].code, "left_handed_axes");
        assert!(findings[0].message.contains("gyro y follows accelerometer x"));
    }
}
