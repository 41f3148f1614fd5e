//! Check of the sign of gravity. A sensor at rest must read +g on the axis that points up.
//!
//! Let u be gravity measured in the body frame, u' its time derivative, g the known magnitude of gravity, and w the
//! angular rate. Motion does not determine the sign of u, because |u| = g and u' = u x w also hold for -u. There are
//! two possible causes of a reading of -g instead of +g. First, the axes may have z down (FRD or NED). These axes are
//! right-handed, and both sensors need the same rotation. Second, the accelerometer may report gravity instead of
//! specific force. Its sign must then be reversed, but not the sign of the gyroscope. Only the motor angles of a stand,
//! or a rotation about the vertical, distinguish the two causes. If the cause is unknown, the finding describes the
//! correction for each cause. If there is a gyroscope, it also describes the rotation that distinguishes them.

use std::ops::Range;

use nalgebra::Vector3;

use super::{ACCEL, names};
use crate::finding::{Finding, Place};
use crate::recording::{RawUnit, Recording};
use crate::simulate::gimbal::rotation_world_from_body;

/// The stand is in its zero position if the magnitude of each motor angle is at most this limit, rad.
const STAND_ZERO_RAD: f64 = 0.02;
/// The unit reads -g on z if the z component of the measured up direction (a unit vector) is below minus this value.
/// The value is the cosine of 20 deg.
const NEARLY_UPRIGHT: f64 = 0.94;
/// There are two hypotheses for a reading of -g on z: the z axis points down, or the accelerometer has the reversed
/// sign of gravity. Each hypothesis predicts the up direction at each rest from the motor angles. A hypothesis is
/// accepted only if the mean cosine of the angle between predicted and measured direction is above this limit, the
/// cosine of 20 deg.
const FITS_STAND: f64 = 0.94;
/// One of the two hypotheses is chosen only if their mean cosines differ by more than this value. The directions that
/// they predict differ only in the sign of the x component. Rests with a horizontal x axis therefore do not distinguish
/// the hypotheses.
const TOLD_APART: f64 = 0.1;

/// Reports `gravity_sign` for a unit that reads -g on z although its z axis is expected to point up.
///
/// If the recording contains the motor angles of a stand, z must point up when all motor angles are zero, and the rests
/// at other motor angles show the cause. Axes with z down are a warning. A reversed sign of gravity and an unclear
/// cause are errors. Without motor angles, the first rest is checked, because most recordings start with the unit
/// upright. The finding is then a warning, because the unit may be upside down. Unsigned counts have no known zero and
/// are not checked.
pub(super) fn check(recording: &Recording, rests: &[Range<usize>]) -> Option<Finding> {
    let at_zero = |rest: &&Range<usize>| {
        recording
            .stand_rad
            .is_some_and(|stand| stand[(*rest).clone()].iter().flatten().all(|angle| angle.abs() < STAND_ZERO_RAD))
    };
    let rest = match recording.stand_rad {
        Some(_) => rests.iter().find(at_zero)?,
        None => rests.first()?,
    };
    let up = mean_direction(recording, rest)?;
    let rows = recording.specific_force;
    let has_sign = || recording.accel_unit == RawUnit::Si || rows.iter().flatten().any(|v| v < 0.0 && v.is_finite());
    if up.z >= -NEARLY_UPRIGHT || !has_sign() {
        return None;
    }
    let on_stand = recording.stand_rad.map(|stand| Axes::by_motors(recording, rests, stand));
    let evidence = if on_stand.is_some() { "with all motors at zero, body z up" } else { "in the first rest" };
    let (kind, way_out): (fn(_, &str) -> _, String) = match on_stand {
        Some(Axes::ZDown) => (
            Finding::warning,
            format!(
                "the motor angles show axes with z down, such as FRD or NED: {Z_DOWN}; without it, everything is \
                     calibrated in the axes of the columns"
            ),
        ),
        Some(Axes::Reversed) => (
            Finding::error,
            format!("the motor angles show that the accelerometer reads -g on the axis that points up: {REVERSED}"),
        ),
        Some(Axes::Unclear) => (Finding::error, format!("{}, or mount the unit with z up at the stand's zero", ask())),
        None if recording.angular_rate.is_absent() => (
            Finding::warning,
            format!(
                "if the unit lies upside down there, nothing is wrong; if its z axis points down (FRD, NED), {Z_DOWN_ALONE}; \
                 if it reads -g on the axis that points up, pass axes='accel=-x,-y,-z'"
            ),
        ),
        None => (Finding::warning, format!("if the unit lies upside down there, nothing is wrong; {}", ask())),
    };
    let place = Place::new(recording, rest.start, rest.end - 1);
    Some(Finding {
        columns: names(ACCEL),
        place: Some(place),
        count: rest.len(),
        value: up.z,
        unit: "g",
        message: format!("accel_z reads {:.2} g {evidence} ({place})", up.z),
        way_out,
        ..kind("gravity_sign", recording.name)
    })
}

const Z_DOWN: &str = "pass axes='frd', which rotates accelerometer and gyroscope to x forward, y left, z up";
const Z_DOWN_ALONE: &str = "pass axes='frd', which rotates the accelerometer to x forward, y left, z up";
const REVERSED: &str = "pass axes='accel=-x,-y,-z', which leaves the gyroscope as it is";

/// Returns the text of the recommended action if the data do not show whether the z axes point down or the
/// accelerometer has the reversed sign.
fn ask() -> String {
    format!(
        "if the axes are FRD or NED (z down), {Z_DOWN}. If neither the pose nor the axes are known, turn the unit in \
         this pose counter-clockwise as seen from above. If gyro_z reads a negative rate, the unit is upside down or \
         its z axis points down. If gyro_z reads a positive rate, the accelerometer reads -g on the axis that points \
         up: {REVERSED}"
    )
}

/// Cause of a reading of -g on z, as determined from the motor angles.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Axes {
    /// The axes of both sensors are x forward, y right, z down.
    ZDown,
    /// The accelerometer reads -g on the axis that points up.
    Reversed,
    /// Both causes agree with the measured directions at the rests, or neither does.
    Unclear,
}

impl Axes {
    /// Determines the cause by comparing the measured up directions at all rests with the directions that each cause
    /// predicts from the motor angles.
    fn by_motors(recording: &Recording, rests: &[Range<usize>], stand: &[[f64; 3]]) -> Self {
        let (mut z_down, mut reversed, mut count) = (0.0, 0.0, 0.0);
        for rest in rests {
            let Some(seen) = mean_direction(recording, rest) else { continue };
            let angle_rad = Vector3::from(stand[rest.start + rest.len() / 2]);
            let up = rotation_world_from_body(&angle_rad).inverse() * Vector3::z();
            if up.iter().all(|v| v.is_finite()) {
                z_down += seen.dot(&Vector3::new(up.x, -up.y, -up.z));
                reversed += seen.dot(&-up);
                count += 1.0;
            }
        }
        let [z_down, reversed] = [z_down / count, reversed / count];
        if z_down > FITS_STAND && z_down - reversed > TOLD_APART {
            Self::ZDown
        } else if reversed > FITS_STAND && reversed - z_down > TOLD_APART {
            Self::Reversed
        } else {
            Self::Unclear
        }
    }
}

/// Unit vector of the mean specific force over `samples`. Samples that are not finite are ignored; `None` if no sample
/// is left.
fn mean_direction(recording: &Recording, samples: &Range<usize>) -> Option<Vector3<f64>> {
    let rows = recording.specific_force.slice(samples.clone()).iter();
    let sum: Vector3<f64> = rows.map(Vector3::from).filter(|row| row.iter().all(|v| v.is_finite())).sum();
    sum.try_normalize(0.0)
}

#[cfg(test)]
mod tests {
    use super::super::example::Columns;
    use super::*;
    use crate::finding::Severity;

    /// Returns the finding for the synthetic recording [`Columns::tumbling`] with its accelerometer axes multiplied by
    /// `accel`. `stand` contains motor angles that agree with the true up direction.
    fn found(accel: [f64; 3], stand: Option<&[[f64; 3]]>) -> Option<Finding> {
        let mut columns = Columns::tumbling();
        columns.force.iter_mut().for_each(|row| *row = [0, 1, 2].map(|k| accel[k] * row[k]));
        check(&Recording { stand_rad: stand, ..columns.recording() }, &Columns::rests())
    }

    /// Computes the motor angles, rad, for which the true up direction equals the direction that the accelerometer
    /// measures in the synthetic recording [`Columns::tumbling`]. Motor 2 sets the tilt, and motor 3 the heading.
    fn motors() -> Vec<[f64; 3]> {
        let columns = Columns::tumbling();
        let up = |i: usize| Vector3::from(columns.force[i]).normalize();
        let angles = |up: Vector3<f64>| {
            let tilt = up.z.clamp(-1.0, 1.0).acos();
            // For the angles q2 and q3 of the motors 2 and 3, the up direction in the body frame is
            // R_z(q3)^T R_y(q2)^T e_z = (-sin q2 cos q3, sin q2 sin q3, cos q2).
            [0.0, -tilt, f64::atan2(-up.y, up.x)]
        };
        let mut stand: Vec<[f64; 3]> = (0..columns.force.len()).map(|i| angles(up(i))).collect();
        stand[..100].fill([0.0; 3]);
        stand
    }

    #[test]
    fn without_a_stand_it_is_asked() {
        assert_eq!(found([1.0; 3], None), None);
        for accel in [[-1.0; 3], [1.0, -1.0, -1.0]] {
            let finding = found(accel, None).unwrap();
            assert_eq!((finding.code, finding.severity), ("gravity_sign", Severity::Warning));
            for part in ["axes='frd'", "counter-clockwise", "upside down"] {
                assert!(finding.way_out.contains(part), "{}", finding.way_out);
            }
        }
    }

    #[test]
    fn motor_angles_tell_z_down_from_a_reversed_sign() {
        let stand = motors();
        assert_eq!(found([1.0; 3], Some(&stand)), None);
        let reversed = found([-1.0; 3], Some(&stand)).unwrap();
        assert_eq!(reversed.severity, Severity::Error);
        assert!(reversed.way_out.contains("axes='accel=-x,-y,-z'"), "{}", reversed.way_out);
        let z_down = found([1.0, -1.0, -1.0], Some(&stand)).unwrap();
        assert_eq!(z_down.severity, Severity::Warning);
        assert!(z_down.way_out.contains("axes='frd'") && !z_down.way_out.contains("accel="), "{}", z_down.way_out);
    }

    #[test]
    fn a_stand_without_a_rest_at_zero_or_with_other_angles_gives_no_decision() {
        let mut stand = vec![[0.0, 1.5, 0.0]; 4000];
        assert_eq!(found([-1.0; 3], Some(&stand)), None);
        stand[..100].fill([0.0; 3]);
        let finding = found([-1.0; 3], Some(&stand)).unwrap();
        assert_eq!(finding.severity, Severity::Error);
        assert!(finding.way_out.contains("counter-clockwise"), "{}", finding.way_out);
    }
}
