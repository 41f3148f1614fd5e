//! Motion of the unit as an exact function of time.
//!
//! ```text
//! R_wb(t),   w = vee(R_wb^T dR_wb/dt),   dw/dt,   x''(t)
//! ```
//!
//! R_wb is the attitude (world from body), w the angular rate in the body frame, and x the position in the world frame.
//! x'' is the second time derivative of x. The operator vee maps a skew-symmetric matrix to its vector: vee(M) is the
//! vector u for which `M v = u x v` for all vectors v. Attitude and derivatives have closed forms. The rate is
//! therefore the derivative of the attitude up to rounding errors, and the motion does not depend on the sampling rate.

use imucal_core::effects::{Effect, EffectSet};
use nalgebra::{UnitQuaternion, Vector3};

use super::moment::Moment;
use super::program::Program;
use super::stand::Stand;
use super::tumble::Tumble;
use crate::error::Error;

/// A motion of the unit.
#[derive(Clone, Debug, PartialEq)]
pub enum Motion {
    /// Motion on a stand that runs a program.
    Stand {
        /// Program of the motors.
        program: Program,
        /// Errors of the stand.
        stand: Stand,
    },
    /// Hand-held motion.
    Tumble(Tumble),
    /// No motion.
    Static {
        /// The constant attitude, `v_w = r_wb * v_b`.
        rotation_world_from_body: UnitQuaternion<f64>,
        /// Duration, s.
        duration_s: f64,
    },
}

impl Motion {
    /// Duration of the motion, s.
    pub fn duration_s(&self) -> f64 {
        match self {
            Self::Stand { program, .. } => program.duration_s(),
            Self::Tumble(tumble) => tumble.duration_s(),
            Self::Static { duration_s, .. } => *duration_s,
        }
    }

    /// Start and end of each rest, s. If there is tremor, the unit trembles about a constant pose during these
    /// intervals.
    pub fn rests(&self) -> Vec<(f64, f64)> {
        match self {
            Self::Stand { program, .. } => program.rests(),
            Self::Tumble(tumble) => tumble.rests(),
            Self::Static { duration_s, .. } => vec![(0.0, *duration_s)],
        }
    }

    /// Motion at a time, s. A time before the start gives the motion at the start, and a time after the end gives the
    /// motion at the end. Tremor and slip are exceptions, because both also act before the start and after the end.
    pub fn at(&self, time_s: f64) -> Moment {
        match self {
            Self::Stand { program, stand } => {
                let mut moment = stand.moment(&program.phase(time_s));
                if let Some(tremor) = &stand.tremor {
                    moment = tremor.shake(moment, time_s);
                }
                if let Some(slip) = &stand.slip {
                    moment = slip.turn(moment, time_s);
                }
                moment
            }
            Self::Tumble(tumble) => tumble.moment(time_s),
            Self::Static { rotation_world_from_body, .. } => Moment {
                rotation_world_from_body: *rotation_world_from_body,
                angular_rate: Vector3::zeros(),
                angular_acceleration: Vector3::zeros(),
                acceleration: Vector3::zeros(),
                stand: None,
            },
        }
    }

    /// Computes the mean angular acceleration, rad/s^2, over the interval that ends at `time_s` and has the length
    /// `delay_s`, the delay of the gyroscope. An interval that would start before the motion is shortened, so that it
    /// starts with the motion. The result is `None` if the length of the interval is zero.
    pub(crate) fn mean_angular_acceleration(&self, time_s: f64, delay_s: f64) -> Option<Vector3<f64>> {
        let start_s = delay_start_s(time_s, delay_s);
        let change = || self.at(time_s).angular_rate - self.at(start_s).angular_rate;
        (start_s != time_s).then(|| change() / (time_s - start_s))
    }

    /// Returns the latest time, s, up to which [`at`](Self::at) returns the same motion as at `time_s`. A caller can
    /// reuse the motion until then. `None` while the unit moves.
    pub fn still_until(&self, time_s: f64) -> Option<f64> {
        match self {
            Self::Stand { program, stand } => {
                if stand.tremor.is_some() {
                    return None;
                }
                let until_s = program.still_until(time_s)?;
                stand.slip.map_or(Some(until_s), |slip| slip.still_until(time_s, until_s))
            }
            Self::Tumble(tumble) => tumble.still_until(time_s),
            Self::Static { .. } => Some(f64::INFINITY),
        }
    }

    /// Returns an error if the motion cannot be simulated.
    pub(super) fn check(&self) -> Result<(), Error> {
        match self {
            Self::Stand { stand, .. } => stand.check(),
            Self::Tumble(_) => Ok(()),
            Self::Static { duration_s, .. } if *duration_s > 0.0 && duration_s.is_finite() => Ok(()),
            Self::Static { duration_s, .. } => {
                Err(Error::Input(format!("the unit rests for {duration_s} s: give a positive time")))
            }
        }
    }
}

/// Start, s, of the interval of length `delay_s` that ends at `time_s`. A start before the start of the motion is
/// replaced by 0, the start of the motion.
pub(super) fn delay_start_s(time_s: f64, delay_s: f64) -> f64 {
    (time_s - delay_s).max(0.0)
}

/// Delay of the gyroscope, s: the parameter of the effect `gyro_time_offset`, or 0 without this effect.
pub(crate) fn gyroscope_delay_s(effects: &EffectSet<f64>) -> f64 {
    let number = Effect::<f64>::GYRO_TIME_OFFSET.number;
    effects.iter().find(|own| own.effect().number == number).map_or(0.0, |own| own.values()[0])
}

#[cfg(test)]
mod tests {
    use imucal_core::integrate::Integrator;
    use imucal_core::so3;

    use super::*;
    use crate::simulate::gimbal::rotation_world_from_body;
    use crate::simulate::program::RandomMoves;
    use crate::simulate::tumble::HandMoves;

    fn on(stand: Stand) -> Motion {
        let moves = RandomMoves { moves: 4, ..RandomMoves::default() };
        Motion::Stand { program: Program::random(&moves, 2).unwrap(), stand }
    }

    fn by_hand(moves: HandMoves) -> Motion {
        Motion::Tumble(Tumble::random(&HandMoves { poses: 5, ..moves }, 3).unwrap())
    }

    /// A stand with all mechanical errors: mount rotation, base tilt, non-orthogonality, flexure and vibration.
    fn bad() -> Stand {
        Stand {
            mount_rotation_rad: Vector3::new(0.02, -0.03, 0.05),
            base_tilt_rad: [0.01, -0.02],
            non_orthogonality_rad: [0.015, -0.01],
            flexure_rad: 0.02,
            vibration_rad: 1e-3,
            vibration_m: 1e-4,
            vibration_hz: 30.0,
            ..Stand::perfect()
        }
    }

    /// Simulated motions: on a perfect stand, on stands with one kind of error each, on a stand with all errors, and
    /// hand-held.
    fn motions() -> Vec<Motion> {
        let perfect = Stand::perfect();
        vec![
            on(perfect.clone()),
            on(Stand { mount_rotation_rad: bad().mount_rotation_rad, ..perfect.clone() }),
            on(Stand { base_tilt_rad: bad().base_tilt_rad, ..perfect.clone() }),
            on(Stand { non_orthogonality_rad: bad().non_orthogonality_rad, ..perfect.clone() }),
            on(Stand { flexure_rad: bad().flexure_rad, ..perfect.clone() }),
            on(Stand { vibration_rad: bad().vibration_rad, vibration_hz: bad().vibration_hz, ..perfect }),
            on(bad()),
            by_hand(HandMoves::default()),
            by_hand(HandMoves { tremor_rad: 2e-3, ..HandMoves::default() }),
        ]
    }

    #[test]
    fn rate_and_acceleration_are_derivatives_whatever_is_wrong() {
        let h = 1e-6;
        for (number, motion) in motions().iter().enumerate() {
            for i in 1..4000 {
                // The number of steps, 4001, is prime, so no instant coincides with a corner of the acceleration (the
                // corners are at multiples of 1/6 s).
                let t = motion.duration_s() * f64::from(i) / 4001.0;
                let (before, now, after) = (motion.at(t - h), motion.at(t), motion.at(t + h));
                let turned = before.rotation_world_from_body.inverse() * after.rotation_world_from_body;
                let rate = so3::log(&turned) / (2.0 * h);
                let acceleration = (after.angular_rate - before.angular_rate) / (2.0 * h);
                let off = (rate - now.angular_rate).norm();
                assert!(off < 1e-8, "motion {number}: rate at {t} s is off by {off}");
                let off = (acceleration - now.angular_acceleration).norm();
                assert!(off < 1e-6, "motion {number}: acceleration at {t} s is off by {off}");
                assert!((now.rotation_world_from_body.norm() - 1.0).abs() < 2e-15);
            }
        }
    }

    /// Integrates the rate of a simulated motion at sampling rates from 50 to 8000 Hz, and returns the order of
    /// convergence of the attitude. The order is the least-squares slope of the logarithm of the largest error over the
    /// logarithm of the sampling interval.
    fn order(motion: &Motion) -> f64 {
        let rates_hz = [50.0, 100.0, 200.0, 400.0, 800.0, 1600.0, 4000.0, 8000.0];
        let points = rates_hz.map(|rate_hz: f64| {
            let start = motion.at(0.0).rotation_world_from_body;
            let (mut turned, mut worst_rad) = (Integrator::new(), 0.0_f64);
            for i in 0..=(motion.duration_s() * rate_hz) as usize {
                let now = motion.at(i as f64 / rate_hz);
                turned.push(1.0 / rate_hz, now.angular_rate);
                let attitude = start * turned.rotation();
                worst_rad = worst_rad.max(attitude.angle_to(&now.rotation_world_from_body));
            }
            (-rate_hz.ln(), worst_rad.ln())
        });
        let mean = |part: fn(&(f64, f64)) -> f64| points.iter().map(part).sum::<f64>() / points.len() as f64;
        let (x, y) = (mean(|point| point.0), mean(|point| point.1));
        let products: f64 = points.iter().map(|point| (point.0 - x) * (point.1 - y)).sum();
        products / points.iter().map(|point| (point.0 - x).powi(2)).sum::<f64>()
    }

    /// The integrator assumes a linear rate between samples, so its error is of second order in the sampling interval.
    /// Corners in the acceleration of the motors do not change this order, because each corner affects only one
    /// integration step, and the additional error of this step is of third order.
    #[test]
    fn integrating_the_rate_converges_to_the_attitude_with_the_integrators_order() {
        for (number, motion) in motions().iter().enumerate() {
            let order = order(motion);
            println!("motion {number}: order {order:.3}");
            // The order deviates slightly from 2, because samples at 50 Hz are too coarse for a vibration at 30 Hz.
            assert!((order - 2.0).abs() < 0.03, "motion {number}: order {order}");
        }
    }

    #[test]
    fn a_perfect_stand_is_the_ideal_gimbal() {
        let motion = on(Stand::perfect());
        let Motion::Stand { program, .. } = &motion else { unreachable!() };
        for i in 0..3300 {
            let t = f64::from(i) / 100.0;
            let (moment, motors) = (motion.at(t), program.motors(t));
            let ideal = rotation_world_from_body(&motors.angle_rad);
            assert!(moment.rotation_world_from_body.angle_to(&ideal) < 1e-15);
            assert_eq!(moment.acceleration, Vector3::zeros());
            let stand = moment.stand.unwrap();
            assert_eq!((stand.angle_rad, stand.rate_radps), (motors.angle_rad, motors.rate_radps));
        }
    }

    #[test]
    fn rests_are_still_and_what_is_said_to_stay_stays() {
        let mut motions = motions();
        motions.push(Motion::Static { rotation_world_from_body: so3::exp(&Vector3::x()), duration_s: 10.0 });
        for (number, motion) in motions.iter().enumerate() {
            let trembles = number == 8;
            for (start, end) in motion.rests() {
                for t in [start, (2.0 * start + end) / 3.0, end] {
                    let moment = motion.at(t);
                    let still = [moment.angular_rate, moment.angular_acceleration, moment.acceleration];
                    assert_eq!(still == [Vector3::zeros(); 3], !trembles, "motion {number}: {t} s");
                }
                let (inside, until) = ((start + end) / 2.0, motion.still_until((start + end) / 2.0));
                assert_eq!(until.is_none(), trembles, "motion {number}");
                if let Some(until) = until {
                    assert!(until >= end);
                    assert_eq!(motion.at(end), motion.at(inside), "motion {number}: {end} s");
                    assert_eq!(motion.at(until.min(1e6)), motion.at(inside), "motion {number}: {until} s");
                }
            }
            // Between the rests the unit moves, and `still_until` must be `None`.
            for pair in motion.rests().windows(2) {
                for share in [1e-6, 0.3, 0.999_999] {
                    let t = pair[0].1 + share * (pair[1].0 - pair[0].1);
                    assert_eq!(motion.still_until(t), None, "motion {number}: {t} s");
                    assert_ne!(motion.at(t).angular_rate, Vector3::zeros(), "motion {number}: {t} s");
                }
            }
        }
    }

    #[test]
    fn outside_its_time_a_motion_stands_at_its_ends() {
        // A tremor continues before the start and after the end, so motions with tremor are excluded.
        for motion in motions().iter().filter(|motion| motion.still_until(0.0).is_some()) {
            assert_eq!(motion.at(-1.0), motion.at(0.0));
            assert_eq!(motion.at(motion.duration_s() + 9.0), motion.at(motion.duration_s()));
        }
    }

    #[test]
    fn a_duration_that_cannot_be_is_refused() {
        for duration_s in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let motion = Motion::Static { rotation_world_from_body: UnitQuaternion::identity(), duration_s };
            assert!(motion.check().is_err(), "{duration_s} s");
        }
        assert!(motions().iter().all(|motion| motion.check().is_ok()));
    }
}
