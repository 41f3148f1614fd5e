//! The stand: an ideal gimbal of three nested axes with the unit at their common point.
//!
//! ```text
//! R_wb = R_x(q1) R_y(q2) R_z(q3)                          motor 1 outside (horizontal), motor 3 inside
//! w    = R_z^T R_y^T e_x q1' + R_z^T e_y q2' + e_z q3'    body rate, in the body frame
//! f    = g R_wb^T e_z                                     specific force: the unit is turned, never carried along
//! ```
//!
//! With all motors at zero the body frame is the world frame, z up. Motors 3 and 2 alone point the body's axes in every
//! direction relative to gravity, which is why the accelerometer program needs no motor 1.

use nalgebra::{UnitQuaternion, Vector3};

use super::profile::MotorState;

/// What the unit undergoes, in the body frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyMotion {
    /// Direction of the world's z axis (up); times g it is the specific force.
    pub up: Vector3<f64>,
    /// Angular rate, rad/s.
    pub angular_rate: Vector3<f64>,
    /// Angular acceleration, rad/s^2.
    pub angular_acceleration: Vector3<f64>,
}

/// Attitude of the body, `v_world = r_wb * v_body`.
pub fn rotation_world_from_body(angle_rad: &Vector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::x_axis(), angle_rad.x)
        * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), angle_rad.y)
        * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle_rad.z)
}

/// What the unit undergoes while the motors move as given.
pub fn body_motion(motors: &MotorState) -> BodyMotion {
    let (sin_1, cos_1) = motors.angle_rad.x.sin_cos();
    let (sin_2, cos_2) = motors.angle_rad.y.sin_cos();
    let (sin_3, cos_3) = motors.angle_rad.z.sin_cos();
    let rate = &motors.rate_radps;
    let acceleration = &motors.acceleration_radps2;
    // From the frame of the middle gimbal ring into the body: R_z(q3)^T.
    let to_body = |v: Vector3<f64>| Vector3::new(cos_3 * v.x + sin_3 * v.y, cos_3 * v.y - sin_3 * v.x, v.z);

    // Rate of the middle ring, in its own frame, and its derivative.
    let ring_rate = Vector3::new(cos_2 * rate.x, rate.y, sin_2 * rate.x);
    let ring_acceleration = Vector3::new(
        cos_2 * acceleration.x - sin_2 * rate.y * rate.x,
        acceleration.y,
        sin_2 * acceleration.x + cos_2 * rate.y * rate.x,
    );
    let carried = to_body(ring_rate);
    let inner = Vector3::new(0.0, 0.0, rate.z);
    BodyMotion {
        up: to_body(Vector3::new(-sin_2 * cos_1, sin_1, cos_2 * cos_1)),
        angular_rate: carried + inner,
        // d/dt R_z^T v = R_z^T v' - q3' e_z x R_z^T v
        angular_acceleration: to_body(ring_acceleration) - inner.cross(&carried)
            + Vector3::new(0.0, 0.0, acceleration.z),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Motors that move as smooth functions of time, with their exact derivatives.
    fn motors(t: f64) -> MotorState {
        MotorState {
            angle_rad: Vector3::new((0.7 * t).sin(), 0.4 + 1.3 * t, 2.0 * (0.5 * t).cos() + t),
            rate_radps: Vector3::new(0.7 * (0.7 * t).cos(), 1.3, 1.0 - (0.5 * t).sin()),
            acceleration_radps2: Vector3::new(-0.49 * (0.7 * t).sin(), 0.0, -0.5 * (0.5 * t).cos()),
        }
    }

    #[test]
    fn rate_and_acceleration_are_derivatives_of_the_attitude() {
        let h = 1e-4;
        for i in 0..200 {
            let t = 0.05 * f64::from(i);
            let attitude = |t: f64| rotation_world_from_body(&motors(t).angle_rad);
            let rate = (attitude(t - h).inverse() * attitude(t + h)).scaled_axis() / (2.0 * h);
            let acceleration =
                (body_motion(&motors(t + h)).angular_rate - body_motion(&motors(t - h)).angular_rate) / (2.0 * h);
            let motion = body_motion(&motors(t));
            assert!((rate - motion.angular_rate).norm() < 1e-7, "rate at {t} s");
            assert!((acceleration - motion.angular_acceleration).norm() < 1e-7, "acceleration at {t} s");
        }
    }

    #[test]
    fn up_is_the_world_z_axis_seen_from_the_body() {
        for i in 0..50 {
            let motors = motors(0.2 * f64::from(i));
            let seen = rotation_world_from_body(&motors.angle_rad).inverse() * Vector3::z();
            assert!((seen - body_motion(&motors).up).norm() < 1e-14);
        }
    }

    #[test]
    fn at_zero_the_body_stands_upright() {
        let motion = body_motion(&MotorState::still(Vector3::zeros()));
        assert_eq!(motion.up, Vector3::z());
        assert_eq!(motion.angular_rate, Vector3::zeros());
    }

    #[test]
    fn aligned_axes_add_their_rates() {
        // Middle axis at +90 deg: the inner axis (body z) lies along the outer one.
        let state = MotorState {
            angle_rad: Vector3::new(0.3, std::f64::consts::FRAC_PI_2, 0.0),
            rate_radps: Vector3::new(1.0, 0.0, 2.0),
            acceleration_radps2: Vector3::zeros(),
        };
        assert!((body_motion(&state).angular_rate - Vector3::new(0.0, 0.0, 3.0)).norm() < 1e-15);
    }
}
