//! Computes the variables of the temperature history: the lag of a first-order low-pass of the temperature, the rate of
//! change of the temperature, and the direction in which the temperature last changed (`docs/model.md` (43)).
//!
//! ```text
//! lag         T_tau - T,          tau dT_tau/dt = T - T_tau
//! rate        (T_1 - T_2) / tau_r,   T_1, T_2: T after one and after two low-passes of tau_r = 0.5 s
//! direction   s <- clamp(s + change of (2 T_1 - T_2) / 1 K, -1, 1)
//! ```
//!
//! T is the temperature, T_tau is T after a low-pass with the time constant tau of an effect, and s is the direction.
//! At the first reading of the thermometer, T_tau = T_1 = T_2 = T and s = 0. T is assumed to be linear in time between
//! two readings of the thermometer, and the outputs of the low-passes are exact for this input.
//!
//! ```
//! use imucal_core::effects::{Effect, EffectSet, EffectValues, Surroundings};
//! use imucal_core::temperature_memory::TemperatureMemory;
//!
//! // The gyroscope follows the thermometer with a time constant of 60 s.
//! let lag = EffectValues::<f64>::try_new(Effect::GYRO_BIAS_TEMPERATURE_LAG, &[1e-4, 0.0, 0.0], Some(60.0))?;
//! let mut effects = EffectSet::none();
//! effects.push(lag)?;
//! let mut memory = TemperatureMemory::new(&effects);
//! // The thermometer is read once per second, and its temperature rises by 0.1 K per second for 10 minutes.
//! let mut history = memory.update(0.0, 0.0);
//! for k in 1..=600 {
//!     history = memory.update(1.0, 0.1 * f64::from(k));
//! }
//! assert!((history.gyroscope_lag_k + 0.1 * 60.0).abs() < 1e-3);
//! assert!((history.rate_kps - 0.1).abs() < 1e-9 && history.direction == 1.0);
//! let surroundings = Surroundings {
//!     temperature_difference_k: Some(60.0),
//!     temperature_history: Some(history),
//!     ..Surroundings::unknown()
//! };
//! # let _ = surroundings;
//! # Ok::<(), imucal_core::effects::EffectError>(())
//! ```

use crate::effects::{EffectSet, Need, Sensor};
use nalgebra::{RealField, convert};

/// Time constant of the low-passes of the temperature from which the rate of change and the direction are computed, s.
/// The low-passes suppress the noise of the thermometer. The rate is delayed by twice this time, that is by 1 s, in
/// which the temperature of a unit hardly changes.
pub const SMOOTHING_S: f64 = 0.5;
/// Half of the temperature change that reverses the direction from -1 to 1 or back, in kelvin. The noise of a
/// thermometer after the low-pass is smaller than this temperature change, so it does not reverse the direction.
pub const REVERSAL_K: f64 = 1.0;

/// Variables of the temperature history at an instant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TemperatureHistory<F: RealField + Copy> {
    /// Derivative of the temperature, K/s.
    pub rate_kps: F,
    /// Direction of the last temperature change: 1 for heating, -1 for cooling. The value is between -1 and 1 while the
    /// temperature reverses.
    pub direction: F,
    /// Lag of the temperature after the low-pass of the gyroscope's lag effect: output minus input, K; 0 if no lag
    /// effect acts on the gyroscope.
    pub gyroscope_lag_k: F,
    /// Lag of the temperature after the low-pass of the accelerometer's lag effect: output minus input, K; 0 if no lag
    /// effect acts on the accelerometer.
    pub accelerometer_lag_k: F,
}

impl<F: RealField + Copy> TemperatureHistory<F> {
    /// The history of a temperature that has been constant for a long time.
    pub fn constant() -> Self {
        let zero = F::zero();
        Self { rate_kps: zero, direction: zero, gyroscope_lag_k: zero, accelerometer_lag_k: zero }
    }

    /// Linear interpolation from this history (`share` 0) to `other` (`share` 1).
    pub fn between(&self, other: &Self, share: F) -> Self {
        let between = |own: F, other: F| other + (own - other) * (F::one() - share);
        Self {
            rate_kps: between(self.rate_kps, other.rate_kps),
            direction: between(self.direction, other.direction),
            gyroscope_lag_k: between(self.gyroscope_lag_k, other.gyroscope_lag_k),
            accelerometer_lag_k: between(self.accelerometer_lag_k, other.accelerometer_lag_k),
        }
    }
}

/// State of the low-passes from which the temperature history is computed. Each new temperature updates the state,
/// which has a fixed size of some tens of bytes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TemperatureMemory<F: RealField + Copy> {
    gyroscope: LowPass<F>,
    accelerometer: LowPass<F>,
    first: LowPass<F>,
    /// Output of the second smoothing low-pass minus the output of the first (`T_2 - T_1`), K.
    second_lag_k: F,
    direction: F,
    /// The last temperature, K; `None` before the first temperature.
    last_k: Option<F>,
    /// Time since the last temperature, s.
    since_s: F,
}

/// A first-order low-pass of the temperature. `tau_s` is its time constant; `None` if no effect uses the low-pass.
#[derive(Clone, Copy, Debug, PartialEq)]
struct LowPass<F: RealField + Copy> {
    tau_s: Option<F>,
    /// Output of the low-pass minus its input (the temperature), K.
    lag_k: F,
}

impl<F: RealField + Copy> LowPass<F> {
    fn new(tau_s: Option<F>) -> Self {
        Self { tau_s, lag_k: F::zero() }
    }

    /// Advances by a time step in which the temperature changes linearly by `change_k`.
    #[inline]
    fn advance(&mut self, time_step_s: F, change_k: F) {
        if let Some(tau_s) = self.tau_s {
            let step = time_step_s / tau_s;
            let settled = -((-step).exp_m1());
            // The limit of (1 - exp(-x)) / x at 0 is 1.
            let share = if step > F::zero() { settled / step } else { F::one() };
            self.lag_k = self.lag_k - settled * self.lag_k - change_k * share;
        }
    }
}

impl<F: RealField + Copy> TemperatureMemory<F> {
    /// The initial state for a set of effects. If the set contains two lag effects of one sensor, the time constant of
    /// the last of these effects is used.
    pub fn new(effects: &EffectSet<F>) -> Self {
        let (mut gyroscope, mut accelerometer) = (None, None);
        for values in effects.iter() {
            if !values.effect().has_need(Need::TemperatureHistory) {
                continue;
            }
            match (values.effect().sensor, values.shape()) {
                (Sensor::Gyroscope, Some(tau_s)) => gyroscope = Some(tau_s),
                (Sensor::Accelerometer, Some(tau_s)) => accelerometer = Some(tau_s),
                _ => {}
            }
        }
        Self::with_time_constants(gyroscope, accelerometer)
    }

    /// The initial state for lag effects with these time constants, s; `None` for a sensor without a lag effect.
    pub fn with_time_constants(gyroscope_s: Option<F>, accelerometer_s: Option<F>) -> Self {
        Self {
            gyroscope: LowPass::new(gyroscope_s),
            accelerometer: LowPass::new(accelerometer_s),
            first: LowPass::new(Some(convert(SMOOTHING_S))),
            second_lag_k: F::zero(),
            direction: F::zero(),
            last_k: None,
            since_s: F::zero(),
        }
    }

    /// Adds the next temperature and returns the history at this temperature. `temperature_k` is relative to any fixed
    /// reference temperature, K. `time_step_s` is the time since the previous call, at least 0. A temperature that is
    /// not finite is ignored. The next finite temperature is then connected to the last finite temperature by a
    /// straight line.
    pub fn update(&mut self, time_step_s: F, temperature_k: F) -> TemperatureHistory<F> {
        self.since_s += time_step_s;
        if temperature_k.is_finite() && self.since_s.is_finite() {
            let last_k = self.last_k.replace(temperature_k).unwrap_or(temperature_k);
            self.advance(temperature_k - last_k);
            self.since_s = F::zero();
        }
        self.history()
    }

    fn advance(&mut self, change_k: F) {
        let (step_s, smoothing_s): (F, F) = (self.since_s, convert(SMOOTHING_S));
        self.gyroscope.advance(step_s, change_k);
        self.accelerometer.advance(step_s, change_k);
        let (before_k, second_before_k) = (self.first.lag_k, self.second_lag_k);
        self.first.advance(step_s, change_k);
        // The output of the first low-pass is the input of the second. If the temperature is linear in time, this
        // output is a straight line plus a decaying exponential. `steady_k` is the output minus the temperature after
        // the exponential has decayed.
        let step = step_s / smoothing_s;
        if step > F::zero() {
            let settled = -((-step).exp_m1());
            let steady_k = -change_k / step;
            self.second_lag_k = self.second_lag_k - settled * self.second_lag_k
                + steady_k * settled
                + (before_k - steady_k) * step * (F::one() - settled);
        }
        // T_1 and T_2 are the outputs of the first and of the second low-pass. `smooth_change_k` is the change of
        // 2 T_1 - T_2. While the temperature changes at a constant rate, 2 T_1 - T_2 has no delay.
        let smooth_change_k = change_k + (self.first.lag_k - before_k) - (self.second_lag_k - second_before_k);
        let reversal_k: F = convert(REVERSAL_K);
        let turned = self.direction + smooth_change_k / reversal_k;
        self.direction = if turned > F::one() {
            F::one()
        } else if turned < -F::one() {
            -F::one()
        } else {
            turned
        };
    }

    /// The history at the last temperature.
    pub fn history(&self) -> TemperatureHistory<F> {
        let smoothing_s: F = convert(SMOOTHING_S);
        TemperatureHistory {
            rate_kps: -self.second_lag_k / smoothing_s,
            direction: self.direction,
            gyroscope_lag_k: self.gyroscope.lag_k,
            accelerometer_lag_k: self.accelerometer.lag_k,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lag, rate and direction after the temperatures `degc` at the times `time_s`, computed by small Euler steps. The
    /// temperature is linear in time between two of the given temperatures.
    fn by_euler(time_s: &[f64], degc: &[f64], tau_s: f64) -> [f64; 3] {
        let (mut lagged, mut once, mut twice, mut s) = (degc[0], degc[0], degc[0], 0.0_f64);
        for (t, d) in time_s.windows(2).zip(degc.windows(2)) {
            let n = 20_000;
            let h = (t[1] - t[0]) / f64::from(n);
            for k in 0..n {
                let now = d[0] + (d[1] - d[0]) * (f64::from(k) + 0.5) / f64::from(n);
                let before = once;
                lagged += h * (now - lagged) / tau_s;
                twice += h * (once - twice) / SMOOTHING_S;
                once += h * (now - once) / SMOOTHING_S;
                s = (s + (once - before) / REVERSAL_K).clamp(-1.0, 1.0);
            }
        }
        [lagged - degc[degc.len() - 1], (once - twice) / SMOOTHING_S, s]
    }

    const TIME_S: [f64; 7] = [0.0, 2.0, 3.0, 10.0, 11.0, 40.0, 43.0];
    const DEGC: [f64; 7] = [20.0, 20.5, 22.0, 25.0, 24.6, 24.0, 24.4];

    #[test]
    fn the_steps_are_exact_for_straight_lines() {
        let mut memory = TemperatureMemory::with_time_constants(Some(30.0), None);
        let mut last_s = 0.0;
        for k in 0..TIME_S.len() {
            let history = memory.update(TIME_S[k] - last_s, DEGC[k]);
            last_s = TIME_S[k];
            if k > 0 {
                let [lag, rate, _] = by_euler(&TIME_S[..=k], &DEGC[..=k], 30.0);
                assert!((history.gyroscope_lag_k - lag).abs() < 2e-3 * lag.abs(), "{k}: {history:?} {lag}");
                assert!((history.rate_kps - rate).abs() < 2e-3 * rate.abs() + 2e-5, "{k}: {history:?} {rate}");
                assert_eq!(history.accelerometer_lag_k, 0.0);
            }
        }
    }

    #[test]
    fn the_direction_follows_the_temperature_with_a_play_of_two_kelvin() {
        let mut memory = TemperatureMemory::with_time_constants(None, None);
        let mut seen: std::vec::Vec<f64> = std::vec::Vec::new();
        for degc in [20.0, 22.0, 30.0, 29.5, 29.0, 28.0, 27.0, 20.0, 20.5] {
            memory.update(20.0, degc);
            // The temperature then stays constant for 100 s, so that the low-passes settle.
            seen.push(memory.update(100.0, degc).direction);
        }
        let expected = [0.0_f64, 1.0, 1.0, 0.5, 0.0, -1.0, -1.0, -1.0, -0.5];
        for (seen, expected) in seen.iter().zip(expected) {
            assert!((seen - expected).abs() < 1e-6, "{seen} {expected}");
        }
    }

    #[test]
    fn a_missing_temperature_is_bridged_by_a_line() {
        let mut whole = TemperatureMemory::with_time_constants(Some(30.0), Some(7.0));
        let mut holed = whole;
        let mut both = (whole.history(), holed.history());
        for k in 0..41 {
            let degc = 20.0 + 0.25 * f64::from(k);
            both.0 = whole.update(0.5, degc);
            both.1 = holed.update(0.5, if k % 5 == 4 { f64::NAN } else { degc });
        }
        let (whole, holed) = both;
        assert!((whole.gyroscope_lag_k - holed.gyroscope_lag_k).abs() < 1e-12, "{whole:?} {holed:?}");
        assert!((whole.accelerometer_lag_k - holed.accelerometer_lag_k).abs() < 1e-12, "{whole:?} {holed:?}");
        assert!((whole.rate_kps - holed.rate_kps).abs() < 1e-12 && whole.direction == holed.direction);
    }

    #[test]
    fn single_precision_keeps_a_long_lag_at_a_high_rate() {
        let mut narrow = TemperatureMemory::<f32>::with_time_constants(Some(300.0), None);
        let mut wide = TemperatureMemory::<f64>::with_time_constants(Some(300.0), None);
        let mut both = (TemperatureHistory::constant(), TemperatureHistory::constant());
        for k in 0..60_000 {
            let degc = 20.0 + 0.05 * f64::from(k) / 100.0;
            both = (narrow.update(0.01, degc as f32), wide.update(0.01, degc));
        }
        let (narrow, wide) = both;
        assert!((f64::from(narrow.gyroscope_lag_k) - wide.gyroscope_lag_k).abs() < 2e-3 * 15.0, "{narrow:?} {wide:?}");
        assert!((f64::from(narrow.rate_kps) - 0.05).abs() < 2e-3, "{narrow:?}");
    }
}
