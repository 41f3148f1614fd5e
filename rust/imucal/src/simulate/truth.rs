//! Computes the true state of the unit and the resulting input of its triads at any instant.
//!
//! ```text
//! f    = R_wb^T (x'' + g e_z)                                                  specific force
//! seen = sensitivity * (true + sum_c Phi_c(state) theta_c + added) + bias      model.md (15), (22)
//! ```
//!
//! R_wb is the attitude (world from body), x the position in the world frame, g local gravity, and e_z the unit vector
//! up. `seen` is the input of a triad. theta_c are the parameters of effect c. Phi_c is the field of effect c: the
//! derivatives of the error that the effect adds, with respect to theta_c. `added` are the errors in `Setup::added`,
//! which the user gives for each sample. The state is evaluated at the true instant of a sample, even if the time
//! stamps are wrong.

use imucal_core::effects::{EffectSet, Need, State, Surroundings};
use imucal_core::temperature_memory::TemperatureHistory;
use nalgebra::Vector3;

use super::motion::{Motion, delay_start_s, gyroscope_delay_s};
use super::temperature::Temperature;
use super::unit::Unit;
use crate::recording::REFERENCE_TEMPERATURE_DEGC;

/// The inputs from which the true state is computed: motion, local gravity, temperature, and the effects of the unit.
pub(super) struct Truth<'a> {
    motion: &'a Motion,
    unit: &'a Unit,
    gravity_mps2: f64,
    temperature: &'a Temperature,
    /// Temperature of the run, degC, if it is constant; `None` if it varies.
    constant_degc: Option<f64>,
    rests: Vec<(f64, f64)>,
    /// Delay of the gyroscope (`gyro_time_offset`), s.
    delay_s: f64,
    /// Effects whose errors are constant while the unit is at rest.
    steady: EffectSet<f64>,
    /// Effects whose errors can change during a rest, because they depend on time or on a varying temperature.
    changing: EffectSet<f64>,
}

impl<'a> Truth<'a> {
    pub(super) fn new(motion: &'a Motion, unit: &'a Unit, gravity_mps2: f64, temperature: &'a Temperature) -> Self {
        let constant_degc = temperature.is_constant().then(|| temperature.at(0.0));
        let (mut steady, mut changing) = (EffectSet::none(), EffectSet::none());
        for member in unit.effects.iter() {
            let changes = member.effect().needs.iter().any(|need| match need {
                Need::Time => true,
                Need::Temperature | Need::TemperatureHistory => constant_degc.is_none(),
                Need::AngularAcceleration | Need::Attitude | Need::Stand => false,
            });
            let place = if changes { &mut changing } else { &mut steady };
            // The new set is a subset of an existing `EffectSet`, so it cannot be full, and the result can be ignored.
            let _ = place.push(*member);
        }
        let (rests, delay_s) = (motion.rests(), gyroscope_delay_s(&unit.effects));
        Self { motion, unit, gravity_mps2, temperature, constant_degc, rests, delay_s, steady, changing }
    }

    /// Whether any effect depends on the history of a varying temperature.
    pub(super) fn needs_history(&self) -> bool {
        self.changing.iter().any(|member| member.effect().has_need(Need::TemperatureHistory))
    }

    /// Temperature at a time, degC.
    #[inline]
    pub(super) fn temperature_degc(&self, time_s: f64) -> f64 {
        self.constant_degc.unwrap_or_else(|| self.temperature.at(time_s))
    }

    /// A cursor that computes the state at any instant. The cursor is fastest if the requested instants increase,
    /// because the motion is then not computed again during a rest.
    pub(super) fn cursor(&self) -> Cursor<'_> {
        Cursor {
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

/// The true state at one instant. [`Cursor::seek`] computes the state at another instant. While the unit is at rest,
/// `seek` does not compute the motion and the constant effects again.
pub(super) struct Cursor<'a> {
    truth: &'a Truth<'a>,
    from_s: f64,
    until_s: f64,
    /// The true state (rate, force and surroundings) at the present instant.
    pub(super) state: State<f64>,
    pub(super) temperature_degc: f64,
    /// Sum of the errors that the effects in `Truth::steady` add to the rate, rad/s, and to the force, m/s^2.
    steady: (Vector3<f64>, Vector3<f64>),
    /// Whether this instant is outside the rests of the motion. A tremor or a slip during a rest does not count as
    /// motion.
    pub(super) moving: bool,
}

impl Cursor<'_> {
    /// Computes the true state at the time `time_s`, s. `history` is the temperature history at this time; `None` if no
    /// effect depends on it.
    #[inline]
    pub(super) fn seek(&mut self, time_s: f64, history: Option<TemperatureHistory<f64>>) {
        let truth = self.truth;
        let surroundings = &mut self.state.surroundings;
        surroundings.time_s = Some(time_s);
        self.temperature_degc = truth.temperature_degc(time_s);
        surroundings.temperature_difference_k = Some(self.temperature_degc - REFERENCE_TEMPERATURE_DEGC);
        surroundings.temperature_history = history;
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
        surroundings.mean_angular_acceleration = truth.motion.mean_angular_acceleration(time_s, truth.delay_s);
        surroundings.rotation_world_from_body = Some(moment.rotation_world_from_body);
        surroundings.stand = moment.stand;
        self.steady = truth.steady.at(&self.state);
        self.moving = !truth.is_rest(time_s);
        let still_until = |time_s: f64| truth.motion.still_until(time_s).unwrap_or(time_s);
        // At the start of a rest, a gyroscope with a delay still measures the end of the move. Its output is constant
        // only after the delay.
        let start_s = delay_start_s(time_s, truth.delay_s);
        let until_s = still_until(time_s).min(still_until(start_s) + (time_s - start_s));
        (self.from_s, self.until_s) = (time_s, until_s);
    }

    /// Computes the inputs of the gyroscope and of the accelerometer, before noise. `added` is the additional rate and
    /// force given in the setup.
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
