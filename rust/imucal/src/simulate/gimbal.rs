//! Kinematics of the stand, which has three nested axes. The unit is at the point where the axes intersect.
//!
//! ```text
//! R_wb = R_x(q1) R_y(q2) R_z(q3)                          motor 1 outermost (horizontal), motor 3 innermost
//! w    = R_z^T R_y^T e_x q1' + R_z^T e_y q2' + e_z q3'    body rate, in the body frame
//! ```
//!
//! R_wb is the attitude (world from body). R_x(q1) is the rotation about the x axis by the angle q1 of motor 1, q1' is
//! the rate of motor 1, and e_x is the unit vector along the x axis. R_y, R_z, e_y and e_z are defined likewise for
//! motors 2 and 3. If all motor angles are zero, the body frame equals the world frame, z up. Motors 2 and 3 can
//! produce any direction of gravity in the body frame, so the accelerometer program (`Program::grid`) does not use
//! motor 1.
//!
//! On a stand with non-orthogonal axes, the directions of the axes are as follows if all motor angles are zero:
//!
//! ```text
//! axis 1 = e_x,   axis 2 = R_z(n1) e_y,   axis 3 = R_z(n1) R_x(n2) e_z
//! ```
//!
//! n1 and n2 are the two values of `Stand::non_orthogonality_rad`. The angle between axes 1 and 2 is 90 deg + n1, and
//! the angle between axes 2 and 3 is 90 deg + n2.

use nalgebra::{UnitQuaternion, Vector3};

use super::attitude::Attitude;
use super::profile::MotorState;

/// Computes the attitude of the body on a stand without errors, `v_world = r_wb * v_body`, for the motor angles in rad.
pub fn rotation_world_from_body(angle_rad: &Vector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::x_axis(), angle_rad.x)
        * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), angle_rad.y)
        * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle_rad.z)
}

/// Computes the attitude of the innermost ring relative to the base, with its derivatives, from the state of the
/// motors.
pub(super) fn inner_ring(motors: &MotorState, non_orthogonality_rad: &[f64; 2]) -> Attitude {
    let [(sin_1, cos_1), (sin_2, cos_2)] = non_orthogonality_rad.map(f64::sin_cos);
    let axes = [Vector3::x(), Vector3::new(-sin_1, cos_1, 0.0), Vector3::new(sin_1 * sin_2, -cos_1 * sin_2, cos_2)];
    let [outer, middle, inner] = [0, 1, 2].map(|motor| Attitude::about(axes[motor], motors.course(motor)));
    outer.then(&middle).then(&inner)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;

    const SQUARE: [f64; 2] = [0.0; 2];

    /// Motors whose angles are smooth functions of time, with exact derivatives.
    fn motors(t: f64) -> MotorState {
        MotorState {
            angle_rad: Vector3::new((0.7 * t).sin(), 0.4 + 1.3 * t, 2.0 * (0.5 * t).cos() + t),
            rate_radps: Vector3::new(0.7 * (0.7 * t).cos(), 1.3, 1.0 - (0.5 * t).sin()),
            acceleration_radps2: Vector3::new(-0.49 * (0.7 * t).sin(), 0.0, -0.5 * (0.5 * t).cos()),
        }
    }

    /// Computes angular rate and acceleration of the body by the formulas of the module documentation, written in
    /// components.
    fn by_components(motors: &MotorState) -> (Vector3<f64>, Vector3<f64>) {
        let ((sin_2, cos_2), (sin_3, cos_3)) = (motors.angle_rad.y.sin_cos(), motors.angle_rad.z.sin_cos());
        let (rate, acceleration) = (&motors.rate_radps, &motors.acceleration_radps2);
        let to_body = |v: Vector3<f64>| Vector3::new(cos_3 * v.x + sin_3 * v.y, cos_3 * v.y - sin_3 * v.x, v.z);
        let carried = to_body(Vector3::new(cos_2 * rate.x, rate.y, sin_2 * rate.x));
        let ring_acceleration = Vector3::new(
            cos_2 * acceleration.x - sin_2 * rate.y * rate.x,
            acceleration.y,
            sin_2 * acceleration.x + cos_2 * rate.y * rate.x,
        );
        let (inner, inner_acceleration) = (Vector3::z() * rate.z, Vector3::z() * acceleration.z);
        (carried + inner, to_body(ring_acceleration) - inner.cross(&carried) + inner_acceleration)
    }

    #[test]
    fn a_square_gimbal_gives_the_formulas_by_components() {
        for i in 0..200 {
            let motors = motors(0.05 * f64::from(i));
            let ring = inner_ring(&motors, &SQUARE);
            let (rate, acceleration) = by_components(&motors);
            assert!(ring.rotation.angle_to(&rotation_world_from_body(&motors.angle_rad)) < 1e-15);
            assert!((ring.rate - rate).norm() < 1e-15 * 3.0);
            assert!((ring.acceleration - acceleration).norm() < 1e-15 * 6.0);
        }
    }

    #[test]
    fn at_zero_the_body_stands_upright() {
        let ring = inner_ring(&MotorState::still(Vector3::zeros()), &[0.01, -0.02]);
        assert_eq!(ring, Attitude::fixed(UnitQuaternion::identity()));
    }

    #[test]
    fn aligned_axes_add_their_rates() {
        // With the middle axis at +90 deg, the innermost axis (body z) is parallel to the outermost axis.
        let state = MotorState {
            angle_rad: Vector3::new(0.3, FRAC_PI_2, 0.0),
            rate_radps: Vector3::new(1.0, 0.0, 2.0),
            acceleration_radps2: Vector3::zeros(),
        };
        assert!((inner_ring(&state, &SQUARE).rate - Vector3::new(0.0, 0.0, 3.0)).norm() < 1e-15);
    }

    #[test]
    fn neighbouring_axes_meet_at_their_angle() {
        let tilts = [0.01, -0.02];
        let turned = |motor: usize, angle: f64| {
            let motors = MotorState::still(Vector3::ith(motor, angle));
            inner_ring(&motors, &tilts).rotation.axis().unwrap().into_inner()
        };
        let axes = [0, 1, 2].map(|motor| turned(motor, 1.0));
        for (pair, tilt) in axes.windows(2).zip(tilts) {
            assert!((pair[0].angle(&pair[1]) - FRAC_PI_2 - tilt).abs() < 1e-15);
        }
    }
}
