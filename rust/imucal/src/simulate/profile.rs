//! Motion of a motor from rest to rest, with a seven-segment profile of piecewise constant jerk.
//!
//! ```text
//! angle(t) = angle_0 + turn s(t / T),    s(0) = 0,  s(1) = 1,  s' and s'' zero at both ends
//! ```
//!
//! During the first quarter of the duration `T`, a motor accelerates. It turns at a constant rate during half of `T`,
//! and decelerates during the last quarter. The first and the last quarter each have three parts of equal length. The
//! acceleration changes with constant jerk in the first part, is constant in the second, and returns to zero with the
//! opposite jerk in the third. The first three derivatives are therefore bounded. For an angle `turn`, the peak rate is
//! (4/3) turn / T, the peak acceleration is 8 turn / T^2, and the magnitude of the jerk is 96 turn / T^3. All motors
//! have the same `T`, so they start and stop together.
//!
//! The jerk has steps, so the acceleration has corners. The attitude error of an integrator of second order, such as
//! the integrator of `imucal_core`, nevertheless remains of second order in the step length. The reason is that a
//! corner affects only the integration step that contains the corner, and the additional error of this step is of third
//! order.

use std::iter::Sum;
use std::ops::Mul;

use nalgebra::Vector3;

/// Ratio of the peak rate of a turn to its mean rate, (angle of the turn) / duration.
pub const PEAK_RATE: f64 = 4.0 / 3.0;
/// Ratio of the peak acceleration of a turn to (angle of the turn) / duration^2.
pub const PEAK_ACCELERATION: f64 = 8.0;
/// Ratio of the magnitude of the nonzero jerk of a turn to (angle of the turn) / duration^3.
pub const JERK: f64 = 96.0;

/// Angles, rates and accelerations of the three motors, outermost motor first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotorState {
    /// Motor angles, rad. The angles are not wrapped to one revolution.
    pub angle_rad: Vector3<f64>,
    /// Motor rates, rad/s.
    pub rate_radps: Vector3<f64>,
    /// Motor accelerations, rad/s^2.
    pub acceleration_radps2: Vector3<f64>,
}

impl MotorState {
    /// State of motors that are at rest at these angles, rad.
    pub fn still(angle_rad: Vector3<f64>) -> Self {
        Self { angle_rad, rate_radps: Vector3::zeros(), acceleration_radps2: Vector3::zeros() }
    }

    /// State `time_s` seconds after the start of a turn. The motors turn by `turn_rad` within `duration_s`, and are at
    /// rest before and after the turn.
    pub fn turning(start_rad: Vector3<f64>, turn_rad: Vector3<f64>, duration_s: f64, time_s: f64) -> Self {
        if time_s <= 0.0 {
            return Self::still(start_rad);
        }
        if time_s >= duration_s {
            return Self::still(start_rad + turn_rad);
        }
        let profile = Course::jerk_limited(time_s / duration_s).in_time(duration_s);
        Self {
            angle_rad: start_rad + turn_rad * profile.value,
            rate_radps: turn_rad * profile.rate,
            acceleration_radps2: turn_rad * profile.acceleration,
        }
    }

    /// Angle, rate and acceleration of the motor with the index `motor`, 0 for the outermost motor.
    #[inline]
    pub(super) fn course(&self, motor: usize) -> Course {
        Course {
            value: self.angle_rad[motor],
            rate: self.rate_radps[motor],
            acceleration: self.acceleration_radps2[motor],
        }
    }
}

/// Value of a function of time at an instant, with its first and second time derivative.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Course {
    pub(super) value: f64,
    pub(super) rate: f64,
    pub(super) acceleration: f64,
}

/// A segment of the first half of the profile: its start as a share of the duration of the turn, the value of the
/// profile and its first two derivatives at this start, and the constant jerk. All derivatives are with respect to the
/// share.
struct Segment {
    start: f64,
    value: f64,
    rate: f64,
    acceleration: f64,
    jerk: f64,
}

#[rustfmt::skip]
const SEGMENTS: [Segment; 4] = [
    Segment { start: 0.0,        value: 0.0,         rate: 0.0,       acceleration: 0.0,               jerk: JERK },
    Segment { start: 1.0 / 12.0, value: 1.0 / 108.0, rate: 1.0 / 3.0, acceleration: PEAK_ACCELERATION, jerk: 0.0 },
    Segment { start: 1.0 / 6.0,  value: 7.0 / 108.0, rate: 1.0,       acceleration: PEAK_ACCELERATION, jerk: -JERK },
    Segment { start: 0.25,       value: 1.0 / 6.0,   rate: PEAK_RATE, acceleration: 0.0,               jerk: 0.0 },
];

impl Course {
    /// The seven-segment profile. It increases from 0 to 1 while `share`, the elapsed share of the duration,
    /// increases from 0 to 1.
    #[inline]
    pub(super) fn jerk_limited(share: f64) -> Self {
        // The second half is the mirrored first half. At both ends, the value (0 or 1) and the zero rate and
        // acceleration are therefore free of rounding errors.
        if share > 0.5 {
            let mirrored = Self::first_half(1.0 - share);
            return Self { value: 1.0 - mirrored.value, rate: mirrored.rate, acceleration: -mirrored.acceleration };
        }
        Self::first_half(share)
    }

    /// Smooth profile from 0 to 1: `35 u^4 - 84 u^5 + 70 u^6 - 20 u^7` with u = `share`. Its first three derivatives
    /// are zero at both ends, and all derivatives are continuous between the ends.
    #[inline]
    pub(super) fn smooth_step(share: f64) -> Self {
        // The second half is the mirrored first half, because the polynomial loses digits by cancellation near u = 1.
        let u = share.min(1.0 - share);
        let value = u.powi(4) * (35.0 + u * (-84.0 + u * (70.0 - 20.0 * u)));
        let left = share * (1.0 - share);
        Self {
            value: if share > 0.5 { 1.0 - value } else { value },
            rate: 140.0 * left * left * left,
            acceleration: 420.0 * left * left * (1.0 - 2.0 * share),
        }
    }

    /// Smooth profile that increases from 0 to 1 and returns to 0 while `share` increases from 0 to 1. Its value is the
    /// smooth step, evaluated at `4 u (1 - u)` with u = `share`.
    #[inline]
    pub(super) fn swell(share: f64) -> Self {
        let inner = Self { value: 4.0 * share * (1.0 - share), rate: 4.0 - 8.0 * share, acceleration: -8.0 };
        let outer = Self::smooth_step(inner.value);
        Self {
            value: outer.value,
            rate: outer.rate * inner.rate,
            acceleration: outer.acceleration * inner.rate * inner.rate + outer.rate * inner.acceleration,
        }
    }

    /// The function `sin(frequency * time + phase)`, with the frequency in rad/s.
    #[inline]
    pub(super) fn sine(frequency_radps: f64, phase_rad: f64, time_s: f64) -> Self {
        let (sine, cosine) = (frequency_radps * time_s + phase_rad).sin_cos();
        Self { value: sine, rate: frequency_radps * cosine, acceleration: -frequency_radps * frequency_radps * sine }
    }

    /// Converts derivatives with respect to the elapsed share of a motion into derivatives with respect to time.
    #[inline]
    pub(super) fn in_time(self, duration_s: f64) -> Self {
        Self {
            value: self.value,
            rate: self.rate / duration_s,
            acceleration: self.acceleration / (duration_s * duration_s),
        }
    }

    fn first_half(share: f64) -> Self {
        let later = SEGMENTS[1..].iter().filter(|segment| share >= segment.start).count();
        let segment = &SEGMENTS[later];
        let t = share - segment.start;
        Self {
            value: segment.value + t * (segment.rate + t * (segment.acceleration / 2.0 + t * segment.jerk / 6.0)),
            rate: segment.rate + t * (segment.acceleration + t * segment.jerk / 2.0),
            acceleration: segment.acceleration + t * segment.jerk,
        }
    }
}

impl Mul for Course {
    type Output = Self;

    #[inline]
    fn mul(self, other: Self) -> Self {
        Self {
            value: self.value * other.value,
            rate: self.rate * other.value + self.value * other.rate,
            acceleration: self.acceleration * other.value
                + 2.0 * self.rate * other.rate
                + self.value * other.acceleration,
        }
    }
}

impl Mul<f64> for Course {
    type Output = Self;

    #[inline]
    fn mul(self, factor: f64) -> Self {
        Self { value: self.value * factor, rate: self.rate * factor, acceleration: self.acceleration * factor }
    }
}

impl Sum for Course {
    #[inline]
    fn sum<I: Iterator<Item = Self>>(courses: I) -> Self {
        courses.fold(Self { value: 0.0, rate: 0.0, acceleration: 0.0 }, |sum, course| Self {
            value: sum.value + course.value,
            rate: sum.rate + course.rate,
            acceleration: sum.acceleration + course.acceleration,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DURATION_S: f64 = 2.0;

    fn turn() -> Vector3<f64> {
        Vector3::new(1.0, -2.5, 0.3)
    }

    fn state(time_s: f64) -> MotorState {
        MotorState::turning(Vector3::new(0.1, 0.2, 0.3), turn(), DURATION_S, time_s)
    }

    #[test]
    fn ends_are_exact() {
        let start = Vector3::new(0.1, 0.2, 0.3);
        assert_eq!(state(0.0), MotorState::still(start));
        assert_eq!(state(-1.0), MotorState::still(start));
        assert_eq!(state(DURATION_S), MotorState::still(start + turn()));
        assert_eq!(state(3.0), MotorState::still(start + turn()));
        // Just before the end of the turn, angle, rate and acceleration must be close to their values after the turn.
        let last = state(DURATION_S * (1.0 - 1e-9));
        assert!((last.angle_rad - start - turn()).norm() < 1e-15);
        assert!(last.rate_radps.norm() < 1e-15);
        assert!(last.acceleration_radps2.norm() < 1e-6);
    }

    #[test]
    fn rate_and_acceleration_are_derivatives() {
        let h = 1e-5;
        for i in 1..400 {
            let t = DURATION_S * f64::from(i) / 400.0;
            let (before, now, after) = (state(t - h), state(t), state(t + h));
            let rate = (after.angle_rad - before.angle_rad) / (2.0 * h);
            let acceleration = (after.rate_radps - before.rate_radps) / (2.0 * h);
            assert!((rate - now.rate_radps).norm() < 1e-8, "rate at {t} s");
            // At a step of the jerk, the central difference has an error of h / 4 times the size of the step. The test
            // tolerates twice this error.
            let corner = JERK * turn().norm() / DURATION_S.powi(3) * h / 2.0;
            assert!((acceleration - now.acceleration_radps2).norm() < 1e-8 + corner, "acceleration at {t} s");
        }
    }

    #[test]
    fn peaks_are_as_stated_and_jerk_is_bounded() {
        let steps = 100_000;
        let (mut rate, mut acceleration, mut jerk) = (0.0_f64, 0.0_f64, 0.0_f64);
        let mut previous = Course::jerk_limited(0.0);
        for i in 1..=steps {
            let now = Course::jerk_limited(f64::from(i) / f64::from(steps));
            rate = rate.max(now.rate);
            acceleration = acceleration.max(now.acceleration.abs());
            jerk = jerk.max((now.acceleration - previous.acceleration).abs() * f64::from(steps));
            assert!(now.value >= previous.value, "a turn never goes back");
            previous = now;
        }
        assert!((rate - PEAK_RATE).abs() < 1e-12);
        assert!((acceleration - PEAK_ACCELERATION).abs() < 1e-12);
        assert!((jerk - JERK).abs() < 1e-6);
    }

    /// Tests that the rate and the acceleration of `course` agree with central differences.
    fn is_differentiated(course: impl Fn(f64) -> Course, tolerance: f64) {
        let h = 1e-5;
        for i in 1..200 {
            let t = f64::from(i) / 200.0;
            let (before, now, after) = (course(t - h), course(t), course(t + h));
            assert!(((after.value - before.value) / (2.0 * h) - now.rate).abs() < tolerance, "rate at {t}");
            let acceleration = (after.rate - before.rate) / (2.0 * h);
            assert!((acceleration - now.acceleration).abs() < tolerance * 100.0, "acceleration at {t}");
        }
    }

    #[test]
    fn smooth_courses_and_their_products_are_differentiated() {
        is_differentiated(Course::smooth_step, 1e-7);
        is_differentiated(Course::swell, 1e-7);
        is_differentiated(|t| Course::sine(3.0, 0.5, t), 1e-7);
        is_differentiated(|t| Course::swell(t) * Course::sine(9.0, 0.5, t) * 0.3, 1e-7);
        is_differentiated(|t| Course::smooth_step(t / 3.0).in_time(3.0), 1e-7);
    }

    #[test]
    fn smooth_courses_start_and_end_at_rest() {
        let zero = Course { value: 0.0, rate: 0.0, acceleration: 0.0 };
        for course in [Course::smooth_step(0.0), Course::swell(0.0), Course::swell(1.0)] {
            assert_eq!(course * 1.0, zero);
        }
        assert_eq!(Course::smooth_step(1.0) * 1.0, Course { value: 1.0, ..zero });
        assert_eq!(Course::swell(0.5).value, 1.0);
        // The third derivative of the smooth step is also zero at the start. Near the start, the acceleration is
        // therefore proportional to the square of the time, and doubling the time must multiply it by four.
        let ratio = Course::smooth_step(2e-3).acceleration / Course::smooth_step(1e-3).acceleration;
        assert!((ratio - 4.0).abs() < 0.1, "{ratio}");
    }
}
