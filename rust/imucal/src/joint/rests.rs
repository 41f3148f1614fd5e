//! Computes three quantities at given parameters: the mean force at each rest, the gravity direction at both ends of
//! each move, and the rate that the effects add at each rest.
//!
//! Effects on the force may depend on the true rate, which is zero at rest. The force therefore does not depend on the
//! effects on the rate. The force is computed first, by fixed-point iteration with the effects on the force. The
//! effects on the rate are then evaluated once. No catalogue effect on the force depends on the attitude, so the force
//! can be computed before the attitude. A test verifies this property of the catalogue.

use std::sync::Arc;

use imucal_core::effects::{Sensor, Surroundings};
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use super::model::{Model, Part, force_by_parameters, parts};
use super::prepared::Prepared;
use super::settle::Still;
use super::terms::{Term, Terms};
use crate::joint::move_ends::EndDirection;
use crate::parameters::{ACCEL, BASE, GYRO_BIAS};
use crate::recording::Recording;
use crate::rests::moves::{End, Move};
use crate::rests::unit_rest::{PropagatedMean, UnitRest};

/// Specific force at a rest.
pub(super) struct Force {
    pub(super) value: Vector3<f64>,
    /// Derivative of the force with respect to every parameter.
    pub(super) jacobian: Vec<Vector3<f64>>,
    /// Direction of the force, which is the gravity direction.
    pub(super) direction: Arc<EndDirection>,
}

/// Mean rate that the effects add at a rest, rad/s, and its derivatives with respect to the parameters of the effects.
pub(super) struct Rate {
    pub(super) added: Vector3<f64>,
    pub(super) columns: Vec<Vector3<f64>>,
}

/// For given parameters: the mean force at every rest, and the mean rate that the effects add at every rest.
pub(super) struct Rests<'a> {
    prepared: &'a Prepared<'a>,
    model: &'a Model,
    on_force: Terms<'a>,
    on_rate: Terms<'a>,
    /// For each rest: the temperature and time on which effects depend, and the derivatives of the force with respect
    /// to the parameters of the effects. The derivatives of effects that depend on the force itself are not included.
    stills: Vec<(Still, Vec<Vector3<f64>>)>,
    /// Mean force at each rest.
    pub(super) forces: Vec<Force>,
    /// For each recording: the rate that the effects add, averaged over the rests of the recording. Empty if no rest is
    /// hand-held, or if no effect changes the rate.
    mean_rates: Vec<Rate>,
}

/// Error of a preliminary gyroscope bias. The samples of a hand-held rest were rotated into the body frames at its ends
/// with the preliminary bias. `value` is the bias of the model minus the preliminary bias, rad/s. `columns` contains
/// the derivatives of `value` with respect to the parameters of the effects. The derivative with respect to the bias
/// parameter is the inverse of the gyroscope sensitivity and is not stored.
pub(super) struct BiasError {
    pub(super) value: Vector3<f64>,
    pub(super) columns: Vec<Vector3<f64>>,
}

impl<'a> Rests<'a> {
    pub(super) fn new(prepared: &'a Prepared<'a>, model: &'a Model, terms: &Terms<'a>) -> Self {
        let [on_force, on_rate] = [Sensor::Accelerometer, Sensor::Gyroscope].map(|sensor| terms.of(sensor));
        let changes = |recording: &Recording<'_>| {
            terms.all.iter().any(|term| term.changes_at_rest(recording.temperature_degc.is_some()))
        };
        let still = |(k, UnitRest { recording, rest, .. }): (usize, &UnitRest)| {
            let (samples, whole) = (rest.first..rest.end, &prepared.recordings[*recording]);
            let parts = match prepared.used[k] && changes(whole) {
                true => parts(whole, samples.clone()),
                false => vec![Part { samples: samples.clone(), surroundings: Surroundings::unknown() }],
            };
            let still = Still { recording: *recording, samples, parts };
            let mut columns = vec![Vector3::zeros(); terms.count];
            let is_known = |term: &Term<'_>| !term.reads(Sensor::Accelerometer);
            on_force.mean_columns(&model.values, (&Vector3::zeros(), None), &still, is_known, &mut columns);
            (still, columns)
        };
        let stills = prepared.rests.iter().enumerate().map(still).collect();
        let mut rests = Self { prepared, model, on_force, on_rate, stills, forces: Vec::new(), mean_rates: Vec::new() };
        let of_mean = |(k, rest): (usize, &UnitRest)| rests.force(k, &rest.rest.specific_force.mean);
        rests.forces = prepared.rests.iter().enumerate().map(of_mean).collect();
        if rests.on_rate.count > 0 && prepared.rests.iter().any(|rest| rest.propagated.is_some()) {
            rests.mean_rates = (0..prepared.recordings.len()).map(|recording| rests.mean_rate(recording)).collect();
        }
        rests
    }

    /// Computes the rate that the effects add, averaged over the used rests of a recording.
    fn mean_rate(&self, recording: usize) -> Rate {
        let (own, _) = self.prepared.rests_of(recording);
        let mut mean = Rate { added: Vector3::zeros(), columns: vec![Vector3::zeros(); self.on_rate.count] };
        for k in &own {
            let Rate { added, columns } = self.rate(*k, None);
            mean.added += added / own.len() as f64;
            mean.columns.iter_mut().zip(columns).for_each(|(sum, column)| *sum += column / own.len() as f64);
        }
        mean
    }

    /// Computes the bias of the model minus a preliminary gyroscope bias. The samples of a hand-held rest were rotated
    /// (propagated) into the body frames at its ends with the preliminary bias. `None` for a rest without tremor. The
    /// preliminary bias is `m + (1 - shrunk) (m_k - m)`. m_k is the mean rate of rest k, m is the mean rate over all
    /// rests of the recording, and `shrunk` is the shrinkage of the bias, from 0 to 1 (model.md (27)).
    ///
    /// The bias of the model contains the rate that the effects add: e_k at rest k, and e on average over the rests.
    /// The preliminary bias contains e, but lacks two parts of e_k - e. The shrinkage removes the part
    /// `shrunk (e_k - e)`. The second part is already missing in m_k, because m_k was computed with the bias m, and
    /// this part of the rate was mistaken for a rotation of the hand.
    pub(super) fn bias_error(&self, k: usize) -> Option<BiasError> {
        let UnitRest { recording, rest, propagated, .. } = &self.prepared.rests[k];
        let PropagatedMean { mean_s, bias, shrunk } = propagated.as_ref()?;
        let gyroscope = &self.model.gyroscope;
        let common = gyroscope.inverse() * (gyroscope.bias() - bias);
        let Some(mean) = self.mean_rates.get(*recording) else {
            return Some(BiasError { value: common, columns: vec![Vector3::zeros(); self.on_rate.count] });
        };
        let up = self.forces[k].direction.up;
        let across = Matrix3::identity() - up * up.transpose();
        let own_share = Matrix3::from_diagonal(&shrunk.map(|shrunk| 1.0 - shrunk));
        let taken_for_rotation = across * (2.0 * mean_s / (rest.end_s - rest.start_s));
        let missing = Matrix3::identity() - own_share * (Matrix3::identity() - taken_for_rotation);
        let missing = gyroscope.inverse() * missing * gyroscope.sensitivity();
        let own = self.rate(k, None);
        let error = |own: &Vector3<f64>, mean: &Vector3<f64>| mean + missing * (own - mean);
        Some(BiasError {
            value: common + error(&own.added, &mean.added),
            columns: own.columns.iter().zip(&mean.columns).map(|(own, mean)| error(own, mean)).collect(),
        })
    }

    /// Computes the specific force at rest `k` from the accelerometer reading `reading` in raw units.
    fn force(&self, k: usize, reading: &Vector3<f64>) -> Force {
        let Self { model, on_force, stills, .. } = self;
        let (still, known) = &stills[k];
        let mut columns = known.clone();
        let seen = model.accelerometer.correct(*reading);
        let value = on_force.force_at_rest(&model.values, seen, still, &mut columns);
        let mut jacobian = vec![Vector3::zeros(); on_force.total()];
        let by_parameters = force_by_parameters(&model.accelerometer, &seen);
        ACCEL.for_each(|p| jacobian[p] = by_parameters.column(p).into_owned());
        on_force.parameters_of(Sensor::Accelerometer).for_each(|p| jacobian[BASE + p] = -columns[p]);
        let up = value.normalize();
        let across = (Matrix3::identity() - up * up.transpose()) / value.norm();
        let direction = EndDirection { up, jacobian: jacobian.iter().map(|column| across * column).collect() };
        Force { value, jacobian, direction: Arc::new(direction) }
    }

    /// Returns the gravity directions before and after the move `index`.
    pub(super) fn ends(&self, index: usize) -> [Arc<EndDirection>; 2] {
        let Move { from, to, .. } = self.prepared.moves[index];
        let [before, after] = &self.prepared.ends[index];
        [self.end(from, before, true), self.end(to, after, false)]
    }

    /// Computes the gravity direction at the last sample of a rest if `at_end` is true, otherwise at its first sample.
    /// At a hand-held rest, the direction was propagated with a preliminary gyroscope bias. The direction is corrected
    /// here for the difference between the preliminary bias and the bias of the model (model.md (27)).
    fn end(&self, rest: usize, end: &End, at_end: bool) -> Arc<EndDirection> {
        let of_mean = end.steady.then(|| Arc::clone(&self.forces[rest].direction));
        let mut direction = of_mean.unwrap_or_else(|| self.force(rest, &end.raw).direction);
        if let Some((PropagatedMean { mean_s, .. }, error)) =
            self.prepared.rests[rest].propagated.as_ref().zip(self.bias_error(rest))
        {
            let EndDirection { up, jacobian } = Arc::make_mut(&mut direction);
            let mean_s = if at_end { *mean_s } else { -mean_s };
            *up += (error.value * mean_s).cross(up);
            for axis in 0..3 {
                jacobian[GYRO_BIAS.start + axis] += (self.model.gyroscope.inverse().column(axis) * mean_s).cross(up);
            }
            for p in self.on_rate.parameters_of(Sensor::Gyroscope) {
                jacobian[BASE + p] += (error.columns[p] * mean_s).cross(up);
            }
        }
        direction
    }

    /// Computes the mean rate that the effects add at a rest.
    pub(super) fn rate(&self, k: usize, attitude: Option<UnitQuaternion<f64>>) -> Rate {
        let Self { model, on_rate, stills, forces, .. } = self;
        let mut columns = vec![Vector3::zeros(); on_rate.count];
        on_rate.mean_columns(&model.values, (&forces[k].value, attitude), &stills[k].0, |_| true, &mut columns);
        Rate { added: on_rate.sum_of(Sensor::Gyroscope, &model.values, &columns), columns }
    }
}
