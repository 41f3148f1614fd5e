//! Tests whether the output of the gyroscope is only delayed, or also smoothed by a filter.
//!
//! ```text
//! delay               w(t - tau)             = w - tau w' + tau^2 / 2 w'' - ...
//! filter              mean of w(t - s)       = w - tau w' + (tau^2 / 2 + k) w'' - ...
//! ```
//!
//! w is the angular rate, w' and w'' are its derivatives. The output of a filter is the mean of the earlier rates
//! `w(t-s)`, weighted by the impulse response of the filter. tau is the mean of s under these weights, and k is half of
//! the variance of s. k is zero for a delay, and tau^2 / 2 for a low-pass filter of first order with the time constant
//! tau. k is also zero for a Butterworth filter of second or higher order: up to the term with w'', this filter only
//! delays its input.
//!
//! The test adds the gyroscope error `k w''` to a model with the effect `gyro_time_offset`. The effect
//! `gyro_time_offset` alone describes a pure delay exactly, so a k that differs from zero shows smoothing.

use imucal_core::effects::{Effect, Sensor};
use nalgebra::Vector3;

use super::acceptance::{Accepted, Refusal, unless_it_fails};
use super::fits::{Fit, Fits};
use crate::calibrate::{ModelOptions, Outcome, UserField};
use crate::correct::angular_acceleration;
use crate::error::Error;
use crate::recording::Recording;

/// Name of the effect that is added to the fit to describe smoothing. It is the gyroscope error `k w''`, where `w''` is
/// the second derivative of the angular rate.
const SMOOTHING: &str = "gyro_smoothing";
/// Threshold of |k| in standard deviations of k. The output of the gyroscope counts as smoothed if |k| exceeds both
/// this threshold and the threshold [`LEAST_SHARE`].
const SIGNIFICANT: f64 = 5.0;
/// Threshold of |k| in multiples of tau^2 / 2, the value of k for a low-pass filter of first order.
const LEAST_SHARE: f64 = 0.3;

impl Fits<'_> {
    /// Rejects the effect `gyro_time_offset` if a filter also smooths the output of the gyroscope. The effect may
    /// already be rejected because it makes the prediction of unseen data worse. In this case, the smoothing is
    /// reported as the reason instead. The test is omitted if user-defined effects were accepted.
    pub(super) fn without_smoothing(&mut self, mut accepted: Accepted) -> Result<Accepted, Error> {
        let name = Effect::<f64>::GYRO_TIME_OFFSET.name;
        let is_worse = |refusal: &Refusal| matches!(refusal, Refusal::PredictsWorse { name: own, .. } if own == name);
        let others: Vec<String> = accepted.path.iter().filter(|own| *own != name).cloned().collect();
        let was_accepted = others.len() < accepted.path.len();
        let are_of_catalogue = others.iter().all(|own| Effect::<f64>::find(own).is_some());
        if !are_of_catalogue || !(was_accepted || accepted.refused.iter().any(is_worse)) {
            return Ok(accepted);
        }
        let with = if was_accepted { accepted.path.clone() } else { [others.as_slice(), &[name.to_owned()]].concat() };
        let Ok(fit) = unless_it_fails(self.with(&with))? else { return Ok(accepted) };
        let Some(refusal) = self.smoothing(&fit)? else { return Ok(accepted) };
        if was_accepted && let Ok(fit) = unless_it_fails(self.with(&others))? {
            accepted.fit = fit;
        }
        accepted.path = others;
        accepted.refused.retain(|own| !is_worse(own));
        accepted.refused.push(refusal);
        Ok(accepted)
    }

    /// The reason to reject `gyro_time_offset` if the output of the gyroscope is smoothed; `None` if the output may be
    /// only delayed. `fit` contains the effect `gyro_time_offset`.
    fn smoothing(&self, fit: &Fit) -> Result<Option<Refusal>, Error> {
        let gyroscope = &fit.outcome.calibration.gyroscope;
        let second_derivative = |recording: &Recording<'_>| -> Vec<f64> {
            let corrected = |raw| <[f64; 3]>::from(gyroscope.correct(Vector3::from(raw)));
            let rate: Vec<[f64; 3]> = recording.angular_rate.iter().map(corrected).collect();
            let first = angular_acceleration(recording.time_s, &rate);
            angular_acceleration(recording.time_s, &first).into_iter().flatten().collect()
        };
        let columns: Vec<Vec<f64>> = self.checked.recordings().iter().map(second_derivative).collect();
        if columns.iter().any(Vec::is_empty) {
            return Ok(None);
        }
        let find = |outcome: &Outcome, name: &str| {
            outcome.effects.iter().find(|own| own.name == name).map(|own| (own.values[0], own.statistic.sqrt()))
        };
        let Some((tau_s, _)) = find(&fit.outcome, Effect::<f64>::GYRO_TIME_OFFSET.name) else {
            return Ok(None);
        };
        let of_low_pass_s2 = tau_s * tau_s / 2.0;
        let field = UserField {
            name: SMOOTHING,
            sensor: Sensor::Gyroscope,
            typical: vec![of_low_pass_s2],
            columns: columns.iter().map(Vec::as_slice).collect(),
        };
        let model = ModelOptions { user_fields: vec![field], folds: None, ..self.model(&fit.effects)? };
        let outcome = match self.checked.calibrate(&model, None) {
            Err(Error::Fit(_) | Error::NotEnoughMotion(_)) => return Ok(None),
            outcome => outcome?,
        };
        let Some(((tau_s, _), (k_s2, times_sigma))) =
            find(&outcome, Effect::<f64>::GYRO_TIME_OFFSET.name).zip(find(&outcome, SMOOTHING))
        else {
            return Ok(None);
        };
        let is_smoothed = times_sigma > SIGNIFICANT && k_s2.abs() > LEAST_SHARE * of_low_pass_s2;
        Ok(is_smoothed.then(|| Refusal::NotOnlyDelayed {
            name: Effect::<f64>::GYRO_TIME_OFFSET.name.to_owned(),
            tau_s,
            k_s2,
            k_sigma_s2: k_s2.abs() / times_sigma,
        }))
    }
}
