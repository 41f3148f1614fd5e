//! Integrates the angular rate to a rotation (`docs/model.md` (6)).
//!
//! The angular rate is assumed to be linear in time between two samples. The rotation over the step is then
//!
//! ```text
//! R(t + dt) = R(t) exp(phi),   phi = (dt / 2) (w0 + w1) + (dt^2 / 12) (w0 x w1) + O(dt^5)
//! ```
//!
//! R is the rotation from the body frame to the world frame, and w0 and w1 are the rates at the two samples, in the
//! body frame. The formula for phi is the Magnus series. For a rate in the world frame, the cross product would have
//! the opposite sign. If the true rate is smooth but not linear between the samples, phi has an error of O(dt^3) per
//! step.

use crate::{
    so3,
    vector::{add, cross, scaled},
};
use nalgebra::{RealField, UnitQuaternion, Vector3, convert};

/// Rotation vector, rad, over a step of `dt_s` seconds in which the rate changes linearly from `w0` to `w1`, rad/s in
/// the body frame.
#[inline]
pub fn increment<F: RealField + Copy>(w0: &Vector3<F>, w1: &Vector3<F>, dt_s: F) -> Vector3<F> {
    let mean = scaled(&add(w0, w1), dt_s * convert(0.5));
    add(&mean, &scaled(&cross(w0, w1), dt_s * dt_s * convert(1.0 / 12.0)))
}

/// Rule by which an [`Integrator`] computes the rotation between two consecutive samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Order {
    /// Uses the mean of the rates at the two samples. This rule needs the least computing time. It is exact if the rate
    /// is linear in time and the axis of rotation is fixed. It neglects coning, so an error due to coning accumulates
    /// with time.
    Midpoint,
    /// Uses the mean of the rates at the two samples and the coning correction of [`increment`].
    #[default]
    Magnus4,
}

/// Integrates the angular rate over a move, sample by sample.
///
/// In `f32`, rounding limits the resolution of one step to 6e-8 rad. At 0.01 rad/s and 8 kHz, a step is only 1.25e-6
/// rad, so the rounding error of a step is up to a few per cent. These errors do not average out completely, and the
/// rotation can be wrong by one per cent. For slow motion at a high sampling rate, use `f64`, or push means over
/// several samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Integrator<F: RealField + Copy> {
    order: Order,
    rotation: UnitQuaternion<F>,
    last_rate: Option<Vector3<F>>,
}

impl<F: RealField + Copy> Integrator<F> {
    /// An integrator that uses the rule [`Order::Magnus4`], with the identity as its rotation and no samples yet.
    pub fn new() -> Self {
        Self::of_order(Order::default())
    }

    /// An integrator that uses the rule `order`, with the identity as its rotation and no samples yet.
    pub fn of_order(order: Order) -> Self {
        Self { order, rotation: UnitQuaternion::identity(), last_rate: None }
    }

    /// Adds one sample: `rate` in the body frame, rad/s, taken `dt_s` seconds after the previous sample.
    ///
    /// The first sample only defines the start of the move, and its `dt_s` is ignored.
    #[inline]
    pub fn push(&mut self, dt_s: F, rate: Vector3<F>) {
        if let Some(last_rate) = self.last_rate {
            let turn = match self.order {
                Order::Midpoint => scaled(&add(&last_rate, &rate), dt_s * convert(0.5)),
                Order::Magnus4 => increment(&last_rate, &rate, dt_s),
            };
            self.rotation = so3::product(&self.rotation, &so3::exp(&turn));
        }
        self.last_rate = Some(rate);
    }

    /// Rotation from the current body frame to the body frame at the start: `v_start = rotation * v_now`.
    #[inline]
    pub fn rotation(&self) -> UnitQuaternion<F> {
        self.rotation
    }

    /// Starts a new move: the rotation becomes the identity, and the last sample is discarded.
    pub fn reset(&mut self) {
        *self = Self::of_order(self.order);
    }
}

impl<F: RealField + Copy> Default for Integrator<F> {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Coning motion: the z axis of the body moves along a cone, `R(t) = Rz(a t) Rx(tilt) Rz(-a t)`. Rz and Rx are
    /// rotations about the z and the x axis, and a is `turn_radps`.
    struct Coning {
        tilt: f64,
        turn_radps: f64,
    }

    impl Coning {
        fn rotation(&self, t: f64) -> UnitQuaternion<f64> {
            let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.turn_radps * t);
            turn * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), self.tilt) * turn.inverse()
        }

        /// Angular rate in the body frame at the time t: `a (R^T z - z)`, where a is `turn_radps`, R the rotation at t,
        /// and z the unit vector along the z axis.
        fn rate(&self, t: f64) -> Vector3<f64> {
            (self.rotation(t).inverse() * Vector3::z() - Vector3::z()) * self.turn_radps
        }

        fn error_after(&self, seconds: f64, steps: usize, order: Order) -> f64 {
            let dt = seconds / steps as f64;
            let mut integrator = Integrator::of_order(order);
            for k in 0..=steps {
                integrator.push(dt, self.rate(k as f64 * dt));
            }
            (self.rotation(0.0).inverse() * self.rotation(seconds)).angle_to(&integrator.rotation())
        }
    }

    #[test]
    fn coning_comes_out_with_the_error_of_straight_lines() {
        let motion = Coning { tilt: 0.2, turn_radps: 5.0 };
        let errors = |order| [200, 400, 800].map(|steps| motion.error_after(1.0, steps, order));
        let (fourth, midpoint) = (errors(Order::Magnus4), errors(Order::Midpoint));
        assert!(fourth[2] < 1e-5, "{fourth:?}");
        for pair in fourth.windows(2).chain(midpoint.windows(2)) {
            assert!((pair[0] / pair[1] - 4.0).abs() < 0.1, "not of second order: {fourth:?} {midpoint:?}");
        }
        // Both rules assume that the rate is linear between samples, and have an error because the rate is not exactly
        // linear. The midpoint rule also has the coning error, so its total error must be larger.
        for (fourth, midpoint) in fourth.iter().zip(&midpoint) {
            assert!(midpoint > fourth, "{fourth} {midpoint}");
        }
    }

    #[test]
    fn a_linear_rate_is_integrated_to_fourth_order() {
        let rate = |t: f64| Vector3::new(1.0, -0.5, 0.3) + Vector3::new(-0.8, 1.5, 2.0) * t;
        // The independent reference consists of a million steps. The rate is constant in each step and equals the true
        // rate at the middle of the step.
        let fine = 1_000_000;
        let truth = (0..fine).fold(UnitQuaternion::identity(), |r, k| {
            r * UnitQuaternion::from_scaled_axis(rate((k as f64 + 0.5) / fine as f64) / fine as f64)
        });
        let errors = [4, 8, 16].map(|steps| {
            let mut integrator = Integrator::new();
            for k in 0..=steps {
                integrator.push(1.0 / steps as f64, rate(k as f64 / steps as f64));
            }
            truth.angle_to(&integrator.rotation())
        });
        for pair in errors.windows(2) {
            assert!((pair[0] / pair[1] - 16.0).abs() < 2.0, "not of fourth order: {errors:?}");
        }
    }

    #[test]
    fn uneven_steps_and_the_first_one_are_taken_as_said() {
        let mut integrator = Integrator::new();
        for dt in [9.0, 0.01, 0.02, 0.005] {
            integrator.push(dt, Vector3::new(0.0, 2.0, 0.0));
        }
        assert!((so3::log(&integrator.rotation()) - Vector3::new(0.0, 0.07, 0.0)).norm() < 1e-16);
    }

    #[test]
    fn a_reset_starts_a_new_move_of_the_same_order() {
        let mut integrator = Integrator::of_order(Order::Midpoint);
        integrator.push(0.1, Vector3::new(1.0, 0.0, 0.0));
        integrator.push(0.1, Vector3::new(1.0, 0.0, 0.0));
        integrator.reset();
        assert_eq!(integrator, Integrator::of_order(Order::Midpoint));
    }

    #[test]
    fn millions_of_steps_keep_the_length_one() {
        let mut integrator = Integrator::new();
        for k in 0..2_000_000 {
            let phase = k as f32 * 0.01;
            integrator.push(0.001, Vector3::new(phase.sin(), 3.0, -1.0));
        }
        assert!((integrator.rotation().norm() - 1.0).abs() < 3e-7);
    }
}
