//! What the unit undergoes, and what its triads see of it, at any instant.
//!
//! ```text
//! f    = R_wb^T (x'' + g e_z)                                                  specific force
//! seen = sensitivity * (true + sum_c Phi_c(state) theta_c + added) + bias      model.md (15), (21)
//! ```
//!
//! The state is the true one at the true instant: also where a clock says otherwise.

use imucal_core::effects::{EffectSet, Need, State, Surroundings};
use nalgebra::Vector3;

use super::motion::Motion;
use super::temperature::Temperature;
use super::unit::Unit;
use crate::recording::REFERENCE_TEMPERATURE_DEGC;

/// A motion, a place and a unit.
pub(super) struct Truth<'a> {
    motion: &'a Motion,
    unit: &'a Unit,
    gravity_mps2: f64,
    temperature: &'a Temperature,
    /// The temperature, if it never changes, degC.
    constant_degc: Option<f64>,
    rests: Vec<(f64, f64)>,
    /// Effects that do not change while the unit is still.
    steady: EffectSet<f64>,
    /// The others: time and temperature go on.
    changing: EffectSet<f64>,
}

impl<'a> Truth<'a> {
    pub(super) fn new(motion: &'a Motion, unit: &'a Unit, gravity_mps2: f64, temperature: &'a Temperature) -> Self {
        let constant_degc = temperature.is_constant().then(|| temperature.at(0.0));
        let (mut steady, mut changing) = (EffectSet::none(), EffectSet::none());
        for member in unit.effects.iter() {
            let changes = member.effect().needs.iter().any(|need| match need {
                Need::Time => true,
                Need::Temperature => constant_degc.is_none(),
                Need::AngularAcceleration | Need::Attitude | Need::Stand => false,
            });
            let place = if changes { &mut changing } else { &mut steady };
            // A part of a set has room where the set had.
            let _ = place.push(*member);
        }
        Self { motion, unit, gravity_mps2, temperature, constant_degc, rests: motion.rests(), steady, changing }
    }

    /// From instant to instant; quickest in the order of time.
    pub(super) fn walk(&self) -> Walk<'_> {
        Walk {
            truth: self,
            from_s: f64::INFINITY,
            until_s: f64::NEG_INFINITY,
            state: State {
                angular_rate: Vector3::zeros(),
                specific_force: Vector3::zeros(),
                surroundings: Surroundings::unknown(),
            },
            temperature_degc: REFERENCE_TEMPERATURE_DEGC,
            steady: (Vector3::zeros(), Vector3::zeros()),
            moving: false,
        }
    }

    fn is_rest(&self, time_s: f64) -> bool {
        let started = self.rests.partition_point(|(start_s, _)| *start_s <= time_s);
        started.checked_sub(1).is_some_and(|rest| time_s <= self.rests[rest].1)
    }
}

/// The state at an instant, kept for as long as nothing moves.
pub(super) struct Walk<'a> {
    truth: &'a Truth<'a>,
    from_s: f64,
    until_s: f64,
    /// The true state.
    pub(super) state: State<f64>,
    pub(super) temperature_degc: f64,
    /// On rate and force.
    steady: (Vector3<f64>, Vector3<f64>),
    /// Whether this is no rest.
    pub(super) moving: bool,
}

impl Walk<'_> {
    #[inline]
    pub(super) fn go_to(&mut self, time_s: f64) {
        let truth = self.truth;
        let surroundings = &mut self.state.surroundings;
        surroundings.time_s = Some(time_s);
        self.temperature_degc = truth.constant_degc.unwrap_or_else(|| truth.temperature.at(time_s));
        surroundings.temperature_difference_k = Some(self.temperature_degc - REFERENCE_TEMPERATURE_DEGC);
        if !(self.from_s..=self.until_s).contains(&time_s) {
            self.move_to(time_s);
        }
    }

    fn move_to(&mut self, time_s: f64) {
        let truth = self.truth;
        let moment = truth.motion.at(time_s);
        let up = Vector3::new(0.0, 0.0, truth.gravity_mps2);
        self.state.angular_rate = moment.angular_rate;
        self.state.specific_force =
            moment.rotation_world_from_body.inverse_transform_vector(&(moment.acceleration + up));
        let surroundings = &mut self.state.surroundings;
        surroundings.angular_acceleration = Some(moment.angular_acceleration);
        surroundings.rotation_world_from_body = Some(moment.rotation_world_from_body);
        surroundings.stand = moment.stand;
        self.steady = truth.steady.at(&self.state);
        self.moving = !truth.is_rest(time_s);
        (self.from_s, self.until_s) = (time_s, truth.motion.still_until(time_s).unwrap_or(time_s));
    }

    /// What gyroscope and accelerometer see, each with what the user adds to the true value.
    #[inline]
    pub(super) fn seen(&self, added: (Vector3<f64>, Vector3<f64>)) -> (Vector3<f64>, Vector3<f64>) {
        let (mut on_rate, mut on_force) = self.steady;
        if !self.truth.changing.is_empty() {
            let changing = self.truth.changing.at(&self.state);
            on_rate += changing.0;
            on_force += changing.1;
        }
        let Unit { accelerometer, gyroscope, .. } = self.truth.unit;
        (
            gyroscope.sensitivity * (self.state.angular_rate + (on_rate + added.0)) + gyroscope.bias,
            accelerometer.sensitivity * (self.state.specific_force + (on_force + added.1)) + accelerometer.bias,
        )
    }
}
