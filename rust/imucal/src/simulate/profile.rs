//! How a motor turns from rest to rest: a seven-segment profile whose jerk is piecewise constant.
//!
//! ```text
//! angle(t) = angle_0 + turn s(t / T),    s(0) = 0,  s(1) = 1,  s' and s'' zero at both ends
//! ```
//!
//! A quarter of the duration `T` goes into speeding up, half into turning at constant rate, a quarter into slowing
//! down; each ramp is jerk up, constant acceleration, jerk down, in thirds. So all is bounded and follows from the
//! turn and its duration: peak rate 4/3 turn/T, peak acceleration 8 turn/T^2, jerk 96 turn/T^3.
//! The motors share `T`: they start and stop together.

use nalgebra::Vector3;

/// Peak rate of a turn, in units of turn / duration.
pub const PEAK_RATE: f64 = 4.0 / 3.0;
/// Peak acceleration of a turn, in units of turn / duration^2.
pub const PEAK_ACCELERATION: f64 = 8.0;
/// Size of the jerk wherever it is not zero, in units of turn / duration^3.
pub const JERK: f64 = 96.0;

/// Angles of the three motors and their first two derivatives; outer motor first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotorState {
    /// Angles, rad; more than a full turn is kept as such.
    pub angle_rad: Vector3<f64>,
    /// Rates, rad/s.
    pub rate_radps: Vector3<f64>,
    /// Accelerations, rad/s^2.
    pub acceleration_radps2: Vector3<f64>,
}

impl MotorState {
    /// Standing still.
    pub fn still(angle_rad: Vector3<f64>) -> Self {
        Self { angle_rad, rate_radps: Vector3::zeros(), acceleration_radps2: Vector3::zeros() }
    }

    /// `time_s` after the start of a turn by `turn_rad` that takes `duration_s`; still before and after it.
    pub fn turning(start_rad: Vector3<f64>, turn_rad: Vector3<f64>, duration_s: f64, time_s: f64) -> Self {
        if time_s <= 0.0 {
            return Self::still(start_rad);
        }
        if time_s >= duration_s {
            return Self::still(start_rad + turn_rad);
        }
        let shape = Shape::at(time_s / duration_s);
        Self {
            angle_rad: start_rad + turn_rad * shape.position,
            rate_radps: turn_rad * (shape.rate / duration_s),
            acceleration_radps2: turn_rad * (shape.acceleration / (duration_s * duration_s)),
        }
    }
}

/// The profile itself: a turn by one in a time of one.
struct Shape {
    position: f64,
    rate: f64,
    acceleration: f64,
}

/// Where each segment of the first half starts, what holds there, and the jerk until the next.
struct Segment {
    start: f64,
    position: f64,
    rate: f64,
    acceleration: f64,
    jerk: f64,
}

#[rustfmt::skip]
const SEGMENTS: [Segment; 4] = [
    Segment { start: 0.0,        position: 0.0,         rate: 0.0,       acceleration: 0.0,               jerk: JERK },
    Segment { start: 1.0 / 12.0, position: 1.0 / 108.0, rate: 1.0 / 3.0, acceleration: PEAK_ACCELERATION, jerk: 0.0 },
    Segment { start: 1.0 / 6.0,  position: 7.0 / 108.0, rate: 1.0,       acceleration: PEAK_ACCELERATION, jerk: -JERK },
    Segment { start: 0.25,       position: 1.0 / 6.0,   rate: PEAK_RATE, acceleration: 0.0,               jerk: 0.0 },
];

impl Shape {
    /// At the given share of the duration, between 0 and 1.
    fn at(share: f64) -> Self {
        // The second half is the first one backwards, so both ends are met exactly.
        if share > 0.5 {
            let mirrored = Self::first_half(1.0 - share);
            return Self {
                position: 1.0 - mirrored.position,
                rate: mirrored.rate,
                acceleration: -mirrored.acceleration,
            };
        }
        Self::first_half(share)
    }

    fn first_half(share: f64) -> Self {
        let later = SEGMENTS[1..].iter().filter(|segment| share >= segment.start).count();
        let segment = &SEGMENTS[later];
        let t = share - segment.start;
        Self {
            position: segment.position + t * (segment.rate + t * (segment.acceleration / 2.0 + t * segment.jerk / 6.0)),
            rate: segment.rate + t * (segment.acceleration + t * segment.jerk / 2.0),
            acceleration: segment.acceleration + t * segment.jerk,
        }
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
        // The limits from inside, too: no jump where the turn ends.
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
            // Where the jerk steps, the central difference is off by jerk h / 4.
            let corner = JERK * turn().norm() / DURATION_S.powi(3) * h / 2.0;
            assert!((acceleration - now.acceleration_radps2).norm() < 1e-8 + corner, "acceleration at {t} s");
        }
    }

    #[test]
    fn peaks_are_as_stated_and_jerk_is_bounded() {
        let steps = 100_000;
        let (mut rate, mut acceleration, mut jerk) = (0.0_f64, 0.0_f64, 0.0_f64);
        let mut previous = Shape::at(0.0);
        for i in 1..=steps {
            let now = Shape::at(f64::from(i) / f64::from(steps));
            rate = rate.max(now.rate);
            acceleration = acceleration.max(now.acceleration.abs());
            jerk = jerk.max((now.acceleration - previous.acceleration).abs() * f64::from(steps));
            assert!(now.position >= previous.position, "a turn never goes back");
            previous = now;
        }
        assert!((rate - PEAK_RATE).abs() < 1e-12);
        assert!((acceleration - PEAK_ACCELERATION).abs() < 1e-12);
        assert!((jerk - JERK).abs() < 1e-6);
    }
}
