//! Errors of a stand: geometry, stiffness, vibration and encoders.
//!
//! ```text
//! R_wb = R_tilt  R_gimbal(q)  R_flexure(q)  R_vibration(t)  R_mount
//! ```
//!
//! R_wb is the attitude of the unit (world from body) for the motor angles q at time t. The other rotations are:
//!
//! * R_tilt: the base is tilted by `base_tilt_rad` from level.
//! * R_gimbal: the motors rotate the innermost ring about axes that are not orthogonal (see [`gimbal`]).
//! * R_flexure: the innermost ring is an arm along axis 3 that bends under its own weight. The bending angle is
//!   `flexure_rad` if axis 3 is horizontal. In general, the rotation vector of the bending, in the frame of the ring,
//!   is `flexure_rad` times the cross product of the up vector and axis 3. The bending is quasi-static.
//! * R_vibration: while the motors turn, the unit vibrates about three axes and along three axes. The phases of the
//!   three axes differ by a third of a period. During each turn, the amplitude rises from zero and falls back to zero.
//!   The translation is in the world frame.
//! * R_mount: the unit is rotated by `mount_rotation_rad` relative to the innermost ring.
//!
//! Encoders read the motor angles, not the attitude, so these errors do not appear in their readings.
//!
//! All errors have closed forms, so rate and acceleration are exact derivatives.

use std::f64::consts::TAU;

use imucal_core::effects::{EffectSet, StandState, State, Surroundings};
use imucal_core::so3;
use nalgebra::{UnitQuaternion, Vector3};

use super::attitude::Attitude;
use super::gimbal;
use super::moment::Moment;
use super::profile::{Course, MotorState};
use super::program::Phase;
use super::slip::Slip;
use super::tremor::Tremor;
use crate::error::Error;

/// Errors of a stand; zero for a perfect stand.
#[derive(Clone, Debug, PartialEq)]
pub struct Stand {
    /// Rotation vector of the unit relative to the innermost ring, rad.
    pub mount_rotation_rad: Vector3<f64>,
    /// Tilt of the base about the world's x and y axes (a rotation vector), rad.
    pub base_tilt_rad: [f64; 2],
    /// Angle between axes 1 and 2 minus 90 deg, and angle between axes 2 and 3 minus 90 deg, rad.
    pub non_orthogonality_rad: [f64; 2],
    /// Bending angle of the innermost ring with axis 3 horizontal, rad.
    pub flexure_rad: f64,
    /// Amplitude of the angular vibration about each axis, rad.
    pub vibration_rad: f64,
    /// Amplitude of the translational vibration along each axis, m.
    pub vibration_m: f64,
    /// Frequency of the vibration, Hz.
    pub vibration_hz: f64,
    /// Standard deviation of the white noise of an encoder reading, rad.
    pub encoder_noise_rad: f64,
    /// Encoder counts per revolution; `None` for no rounding.
    pub encoder_counts: Option<u32>,
    /// Tremor of the stand, for example on a vibrating table. It acts at all times; `None` for a stand without tremor.
    pub tremor: Option<Tremor>,
    /// Slip of the unit on its mount; `None` for no slip.
    pub slip: Option<Slip>,
}

impl Stand {
    /// A stand without errors and noise.
    pub fn perfect() -> Self {
        Self {
            mount_rotation_rad: Vector3::zeros(),
            base_tilt_rad: [0.0; 2],
            non_orthogonality_rad: [0.0; 2],
            flexure_rad: 0.0,
            vibration_rad: 0.0,
            vibration_m: 0.0,
            vibration_hz: 0.0,
            encoder_noise_rad: 0.0,
            encoder_counts: None,
            tremor: None,
            slip: None,
        }
    }

    /// Computes the encoder readings, rad: the motor angles with the encoder effects in `effects`, with noise, and
    /// rounded to counts.
    ///
    /// `noise` contains one random number with a standard deviation of one for each encoder.
    pub fn read_encoders(
        &self,
        stand: &StandState<f64>,
        effects: &EffectSet<f64>,
        noise: Vector3<f64>,
    ) -> Vector3<f64> {
        let surroundings = Surroundings { stand: Some(*stand), ..Surroundings::unknown() };
        let state = State { angular_rate: Vector3::zeros(), specific_force: Vector3::zeros(), surroundings };
        let read_rad = stand.angle_rad + effects.on_encoders(&state) + noise * self.encoder_noise_rad;
        match self.encoder_counts {
            Some(counts) => {
                let count_rad = TAU / f64::from(counts);
                read_rad.map(|angle| (angle / count_rad).round_ties_even() * count_rad)
            }
            None => read_rad,
        }
    }

    /// Attitude of the unit at rest, `v_world = r_wb * v_body`, for the motor angles in rad.
    pub fn attitude(&self, angle_rad: &Vector3<f64>) -> UnitQuaternion<f64> {
        let motors = MotorState::still(*angle_rad);
        self.moment(&Phase { motors, direction: Vector3::zeros(), turn: None }).rotation_world_from_body
    }

    /// Computes the motion of the unit for a given state of the program.
    pub(super) fn moment(&self, phase: &Phase) -> Moment {
        let [tilt_x, tilt_y] = self.base_tilt_rad;
        let tilt = so3::exp(&Vector3::new(tilt_x, tilt_y, 0.0));
        // The attitude relative to the base is computed first. The tilt of the base relative to the world is applied
        // last.
        let mut attitude = gimbal::inner_ring(&phase.motors, &self.non_orthogonality_rad);
        if self.flexure_rad != 0.0 {
            attitude = attitude.then(&self.flexure(&attitude.seen(&tilt.inverse_transform_vector(&Vector3::z()))));
        }
        let mut acceleration = Vector3::zeros();
        if let Some((elapsed_s, duration_s)) = phase.turn
            && (self.vibration_rad != 0.0 || self.vibration_m != 0.0)
        {
            let vibration = self.vibration(elapsed_s, duration_s);
            attitude = attitude.then(&Attitude::small(&vibration.map(|course| course * self.vibration_rad)));
            acceleration = vibration.map(|course| course.acceleration * self.vibration_m).into();
        }
        let attitude = attitude.between(&tilt, &so3::exp(&self.mount_rotation_rad));
        Moment {
            rotation_world_from_body: attitude.rotation,
            angular_rate: attitude.rate,
            angular_acceleration: attitude.acceleration,
            acceleration,
            stand: Some(StandState {
                angle_rad: phase.motors.angle_rad,
                rate_radps: phase.motors.rate_radps,
                direction: phase.direction,
            }),
        }
    }

    /// Computes the bending of the innermost ring. `up` is the up vector in the frame of the ring, and `rate` and
    /// `acceleration` are the first and second time derivative of `up`.
    fn flexure(&self, [up, rate, acceleration]: &[Vector3<f64>; 3]) -> Attitude {
        // In the frame of the ring, axis 3 is taken as e_z. On a stand with non-orthogonal axes, the small angle
        // between e_z and axis 3 is neglected. up x e_z = (up_y, -up_x, 0), and the derivatives have the same form.
        let course = |axis: usize| Course { value: up[axis], rate: rate[axis], acceleration: acceleration[axis] };
        let level = Course { value: 0.0, rate: 0.0, acceleration: 0.0 };
        Attitude::small(&[course(1) * self.flexure_rad, course(0) * -self.flexure_rad, level])
    }

    /// Computes a vibration with an amplitude of one for each of three axes, with its derivatives. The same three
    /// functions of time describe the angular and the translational vibration.
    fn vibration(&self, elapsed_s: f64, duration_s: f64) -> [Course; 3] {
        let swell = Course::swell(elapsed_s / duration_s).in_time(duration_s);
        [0.0, 1.0, 2.0].map(|axis| swell * Course::sine(TAU * self.vibration_hz, TAU / 3.0 * axis, elapsed_s))
    }

    /// Returns an error if a value cannot be used.
    pub(super) fn check(&self) -> Result<(), Error> {
        let input = |message: String| Err(Error::Input(format!("stand: {message}")));
        let angles = self.mount_rotation_rad.iter().chain(&self.base_tilt_rad).chain(&self.non_orthogonality_rad);
        if !angles.chain([&self.flexure_rad]).all(|angle| angle.is_finite()) {
            return input("mount rotation, base tilt, non-orthogonality and flexure need finite angles".to_owned());
        }
        for (name, value) in [
            ("vibration_rad", self.vibration_rad),
            ("vibration_m", self.vibration_m),
            ("vibration_hz", self.vibration_hz),
            ("encoder_noise_rad", self.encoder_noise_rad),
        ] {
            if !(value.is_finite() && value >= 0.0) {
                return input(format!("{name} is {value}: give zero or a positive value"));
            }
        }
        if !self.tremor.is_none_or(|tremor| tremor.is_finite()) {
            return input("the tremor needs a standard deviation of zero or more".to_owned());
        }
        if !self.slip.is_none_or(|slip| slip.is_finite()) {
            return input("a slip needs a finite time and finite angles".to_owned());
        }
        if self.encoder_counts == Some(0) {
            return input("encoder_counts is 0: give the counts per revolution, or omit it".to_owned());
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use imucal_core::effects::{Effect, EffectValues};
    use nalgebra::UnitQuaternion;

    use super::*;
    use crate::simulate::profile::MotorState;
    use crate::simulate::program::{Program, Step};

    fn resting(stand: &Stand, angle_rad: Vector3<f64>) -> UnitQuaternion<f64> {
        let phase = Phase { motors: MotorState::still(angle_rad), direction: Vector3::zeros(), turn: None };
        stand.moment(&phase).rotation_world_from_body
    }

    #[test]
    fn tilt_turns_the_stand_in_the_world_and_mount_the_unit_on_it() {
        let angles = Vector3::new(0.3, -1.2, 2.0);
        let ideal = resting(&Stand::perfect(), angles);
        let tilt = resting(&Stand { base_tilt_rad: [0.02, -0.01], ..Stand::perfect() }, angles);
        assert!((so3::log(&(tilt * ideal.inverse())) - Vector3::new(0.02, -0.01, 0.0)).norm() < 1e-15);
        let mount_rotation_rad = Vector3::new(0.02, -0.01, 0.3);
        let mount = resting(&Stand { mount_rotation_rad, ..Stand::perfect() }, angles);
        assert!((so3::log(&(ideal.inverse() * mount)) - mount_rotation_rad).norm() < 1e-15);
    }

    #[test]
    fn the_innermost_ring_sags_where_its_axis_is_level() {
        let soft = Stand { flexure_rad: 0.01, ..Stand::perfect() };
        let tip = |stand: &Stand, angles| resting(stand, angles) * Vector3::z();
        for angles in [Vector3::new(FRAC_PI_2, 0.0, 1.0), Vector3::new(0.0, -FRAC_PI_2, -0.4)] {
            let (straight, bent) = (tip(&Stand::perfect(), angles), tip(&soft, angles));
            assert!((straight.angle(&bent) - 0.01).abs() < 1e-6);
            assert!((bent.z - straight.z + 0.01).abs() < 1e-6, "it goes down: {bent:?}");
        }
        // If axis 3 is vertical, upright or upside down, the weight has no lever arm, so the ring does not bend.
        for angle in [0.0, 2.0 * FRAC_PI_2] {
            let angles = Vector3::new(angle, 0.0, 0.7);
            assert!(resting(&soft, angles).angle_to(&resting(&Stand::perfect(), angles)) < 1e-15);
        }
    }

    #[test]
    fn vibration_shakes_while_the_motors_turn_and_takes_the_unit_nowhere() {
        let steps = vec![Step { turn_rad: [1.0, 0.0, 0.0], move_s: 2.0, hold_s: 1.0 }];
        let program = Program::try_new(steps).unwrap();
        let stand = Stand { vibration_m: 1e-3, vibration_rad: 2e-3, vibration_hz: 20.0, ..Stand::perfect() };
        let (count, step_s) = (40_000, 2.0 / 40_000.0);
        let (mut velocity, mut place) = (Vector3::zeros(), Vector3::zeros());
        let (mut furthest_m, mut widest_rad) = (0.0_f64, 0.0_f64);
        for i in 0..count {
            let phase = program.phase((f64::from(i) + 0.5) * step_s);
            let moment = stand.moment(&phase);
            velocity += moment.acceleration * step_s;
            place += velocity * step_s;
            furthest_m = furthest_m.max(place.amax());
            let straight = gimbal::rotation_world_from_body(&phase.motors.angle_rad);
            widest_rad = widest_rad.max(so3::log(&(straight.inverse() * moment.rotation_world_from_body)).amax());
        }
        assert!(velocity.norm() < 1e-6 && place.norm() < 1e-6, "{velocity:?}, {place:?}");
        assert!((furthest_m - 1e-3).abs() < 2e-5, "{furthest_m} m");
        assert!((widest_rad - 2e-3).abs() < 1e-6, "{widest_rad} rad");
        assert_eq!(stand.moment(&program.phase(2.5)).acceleration, Vector3::zeros());
    }

    fn effects(name: &str, values: &[f64]) -> EffectSet<f64> {
        let mut set = EffectSet::none();
        set.push(EffectValues::try_new(Effect::find(name).unwrap(), values, None).unwrap()).unwrap();
        set
    }

    #[test]
    fn encoders_read_angles_with_noise_and_in_counts() {
        let state = StandState::still(Vector3::new(1.0, -2.0, 7.5));
        let noise = Vector3::new(1.0, -1.0, 0.5);
        let none = EffectSet::none();
        assert_eq!(Stand::perfect().read_encoders(&state, &none, noise), state.angle_rad);
        let noisy = Stand { encoder_noise_rad: 1e-3, ..Stand::perfect() };
        assert_eq!(noisy.read_encoders(&state, &none, noise), state.angle_rad + noise * 1e-3);
        let coarse = Stand { encoder_counts: Some(4096), ..Stand::perfect() };
        let read = coarse.read_encoders(&state, &none, noise);
        for (read, angle) in read.iter().zip(&state.angle_rad) {
            let counts = read / TAU * 4096.0;
            assert!((counts - counts.round()).abs() < 1e-9);
            assert!((read - angle).abs() <= TAU / 4096.0 / 2.0);
        }
    }

    #[test]
    fn effects_of_encoders_are_read_and_others_are_not() {
        let stand = Stand::perfect();
        let state = StandState { direction: Vector3::new(1.0, -1.0, 0.0), ..StandState::still(Vector3::zeros()) };
        let read = |set: &EffectSet<f64>| stand.read_encoders(&state, set, Vector3::zeros());
        assert_eq!(read(&effects("encoder_backlash", &[1e-3; 3])), Vector3::new(1e-3, -1e-3, 0.0));
        assert_eq!(read(&effects("gyro_g_sensitivity", &[1.0; 9])), Vector3::zeros());
    }

    #[test]
    fn an_encoder_that_is_early_reads_the_angle_of_a_later_time() {
        let program = Program::random(&Default::default(), 4).unwrap();
        let tau_s = 1e-4;
        let early = effects("encoder_time_offset", &[tau_s]);
        for i in 0..1000 {
            let time_s = 0.3 * f64::from(i);
            let phase = program.phase(time_s);
            let state = StandState {
                angle_rad: phase.motors.angle_rad,
                rate_radps: phase.motors.rate_radps,
                direction: phase.direction,
            };
            let read = Stand::perfect().read_encoders(&state, &early, Vector3::zeros());
            // The effect adds the rate times tau_s to the angle at `time_s`. The reading therefore differs from the
            // angle at `time_s + tau_s` by about half the acceleration times tau_s squared. The acceleration of a motor
            // is at most 8.4 rad/s^2.
            assert!((read - program.motors(time_s + tau_s).angle_rad).amax() < 8.4 * tau_s * tau_s, "{time_s} s");
        }
    }

    #[test]
    fn stands_that_cannot_be_are_refused() {
        let bad = [
            Stand { base_tilt_rad: [0.0, f64::NAN], ..Stand::perfect() },
            Stand { flexure_rad: f64::INFINITY, ..Stand::perfect() },
            Stand { vibration_hz: -1.0, ..Stand::perfect() },
            Stand { encoder_noise_rad: f64::NAN, ..Stand::perfect() },
            Stand { encoder_counts: Some(0), ..Stand::perfect() },
        ];
        for stand in bad {
            let message = stand.check().unwrap_err().to_string();
            assert!(message.starts_with("stand: "), "{message}");
        }
        assert!(Stand::perfect().check().is_ok());
    }
}
