//! Motion of the unit at one instant: attitude, rates and acceleration, and the state of the stand's motors.

use imucal_core::effects::StandState;
use nalgebra::{UnitQuaternion, Vector3};

use super::attitude::Attitude;
use super::gimbal::inner_ring;
use super::profile::MotorState;

/// Motion of the unit at an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// Attitude: rotation from the body frame to the world frame, `v_w = r_wb * v_b`.
    pub rotation_world_from_body: UnitQuaternion<f64>,
    /// Angular rate of the body relative to the world, in the body frame, rad/s.
    pub angular_rate: Vector3<f64>,
    /// Derivative of the angular rate in the body frame, rad/s^2.
    pub angular_acceleration: Vector3<f64>,
    /// Acceleration of the unit relative to the world, in the world frame, m/s^2.
    pub acceleration: Vector3<f64>,
    /// State of the stand's motors; `None` without a stand.
    pub stand: Option<StandState<f64>>,
}

impl Moment {
    /// Computes the motion of a unit on a stand without errors, from the state of its motors.
    pub(crate) fn on_perfect_stand(motors: &MotorState) -> Self {
        let attitude = inner_ring(motors, &[0.0; 2]);
        Self {
            rotation_world_from_body: attitude.rotation,
            angular_rate: attitude.rate,
            angular_acceleration: attitude.acceleration,
            acceleration: Vector3::zeros(),
            stand: Some(StandState {
                angle_rad: motors.angle_rad,
                rate_radps: motors.rate_radps,
                direction: motors.rate_radps.map(|rate| if rate == 0.0 { 0.0 } else { rate.signum() }),
            }),
        }
    }

    /// Adds a rotation of the unit to this motion. `turn` is the attitude of the rotated unit relative to the body
    /// frame of this motion.
    pub(super) fn turned(self, turn: &Attitude) -> Self {
        let before = Attitude {
            rotation: self.rotation_world_from_body,
            rate: self.angular_rate,
            acceleration: self.angular_acceleration,
        };
        let after = before.then(turn);
        Self {
            rotation_world_from_body: after.rotation,
            angular_rate: after.rate,
            angular_acceleration: after.acceleration,
            ..self
        }
    }
}
