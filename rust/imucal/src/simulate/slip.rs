//! Slip of the unit on its mount: a single change of the attitude of the unit relative to the stand. The encoders of
//! the stand do not measure the slip.
//!
//! ```text
//! R_wb(t) = (R_wb without the slip) * exp(turn * s((t - time) / 50 ms))
//! ```
//!
//! R_wb is the attitude (world from body), `turn` the rotation vector of the slip, and `time` its start. s is the
//! smooth step from 0 to 1. The gyroscope measures the slip as an ordinary rotation.

use nalgebra::Vector3;

use super::attitude::Attitude;
use super::moment::Moment;
use super::profile::Course;

/// Duration of a slip, s.
const DURATION_S: f64 = 0.05;

/// Time and size of a slip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Slip {
    /// Start of the slip, s.
    pub time_s: f64,
    /// Rotation vector of the slip in the body frame, rad.
    pub turn_rad: Vector3<f64>,
}

impl Slip {
    /// Adds the slip to a motion without slip.
    pub(super) fn turn(&self, moment: Moment, time_s: f64) -> Moment {
        let share = (time_s - self.time_s) / DURATION_S;
        if share <= 0.0 {
            return moment;
        }
        let done = Course { value: 1.0, rate: 0.0, acceleration: 0.0 };
        let course = if share < 1.0 { Course::smooth_step(share).in_time(DURATION_S) } else { done };
        moment.turned(&Attitude::along(&self.turn_rad, course))
    }

    /// Returns the time, s, until which a unit that is at rest at `time_s` stays at rest; `None` during the slip.
    /// `until_s` is the same time for the motion without the slip.
    pub(super) fn still_until(&self, time_s: f64, until_s: f64) -> Option<f64> {
        if time_s <= self.time_s {
            return Some(until_s.min(self.time_s));
        }
        (time_s >= self.time_s + DURATION_S).then_some(until_s)
    }

    pub(super) fn is_finite(&self) -> bool {
        self.time_s.is_finite() && self.turn_rad.iter().all(|angle| angle.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use imucal_core::so3;
    use nalgebra::Vector3;

    use super::*;
    use crate::simulate::{Motion, Program, RandomMoves, Stand};

    fn motion(time_s: f64) -> Motion {
        let slip = Slip { time_s, turn_rad: Vector3::new(0.02, -0.01, 0.03) };
        let moves = RandomMoves { moves: 3, ..RandomMoves::default() };
        let stand = Stand { slip: Some(slip), ..Stand::perfect() };
        Motion::Stand { program: Program::random(&moves, 2).unwrap(), stand }
    }

    #[test]
    fn rate_and_acceleration_are_the_derivatives_through_the_slip() {
        // The first slip is during a rest and the second during a turn. Rests take 5 s and turns 2 s.
        for slip_s in [2.0, 6.0] {
            let motion = motion(slip_s);
            let h = 1e-5;
            for i in -10..70 {
                let t = slip_s + 1e-3 * f64::from(i);
                let (before, now, after) = (motion.at(t - h), motion.at(t), motion.at(t + h));
                let turned = before.rotation_world_from_body.inverse() * after.rotation_world_from_body;
                assert!((so3::log(&turned) / (2.0 * h) - now.angular_rate).norm() < 1e-5, "{t} s");
                let change = (after.angular_rate - before.angular_rate) / (2.0 * h);
                assert!((change - now.angular_acceleration).norm() < 1e-2, "{t} s");
            }
        }
    }

    #[test]
    fn a_slip_stays_and_the_encoders_do_not_see_it() {
        let (slipped, plain) = (motion(6.0), motion(1e9));
        for (time_s, angle_rad) in [(4.0, 0.0), (6.0, 0.0), (6.05, 0.0014_f64.sqrt()), (20.0, 0.0014_f64.sqrt())] {
            let (a, b) = (slipped.at(time_s), plain.at(time_s));
            let angle = a.rotation_world_from_body.angle_to(&b.rotation_world_from_body);
            assert!((angle - angle_rad).abs() < 1e-12, "{time_s} s");
            assert_eq!(a.stand, b.stand);
        }
    }

    #[test]
    fn a_rest_ends_where_the_slip_begins() {
        let motion = motion(2.0);
        assert_eq!(motion.still_until(1.0), Some(2.0));
        assert_eq!(motion.still_until(2.0), Some(2.0));
        assert_eq!(motion.still_until(2.01), None);
        assert_eq!(motion.still_until(2.06), Some(5.0));
        assert_eq!(motion.at(2.06), motion.at(5.0));
    }
}
