//! Residuals relative to a stand, which rotates the unit with three motors (model.md (21)). They compare gravity
//! directions and attitudes of the unit with those computed from the encoder angles of the motors.
//!
//! ```text
//! rests        perpendicular to u_k:  R_wb(q_k)^T e_z - u_k
//! in the move  log(C_0^T C(t) R(t)^T),   C = R_wb(q)
//! q = e - sum Phi(q, dq/dt, direction) theta,   e the encoder readings, rad
//! ```
//!
//! q are the motor angles, Phi are the fields of the encoder effects, and theta are their parameters. `direction` is
//! the sign of the last motion of each motor. R_wb(q) is the attitude of the stand (world from body), C(t) is its value
//! at time t, and C_0 is its value at the start of the move. u_k is the measured direction up at rest k in the body
//! frame, and e_z is the direction up in the world frame. R(t) is the rotation from the body frame at time t to the
//! body frame at the start of the move, integrated from the gyroscope rates. The geometry of the stand is not known
//! exactly, so eight parameters of the stand are also estimated: the mount rotation (3 parameters), the base tilt (2),
//! the non-orthogonality of the axes (2), and the zero error of the second motor (1). A zero error of the first motor
//! is part of the tilt of the base, and a zero error of the third motor is part of the rotation of the mount. The
//! parameters of the stand are the last entries of the parameter vector.

mod directions;
pub(super) mod moves;

use std::ops::Range;

use imucal_core::effects::{Sensor, StandState, State, Surroundings};
use imucal_core::so3;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::histories::Sample;
use super::move_ends::EndDirection;
use super::terms::Terms;
use crate::error::Error;
use crate::numerics::derivative::Derivative;
use crate::numerics::stats::median;
use crate::parameters::{BASE, STAND_PARAMETERS};
use crate::recording::Recording;
use crate::rests::moves::{Move, rows_across};
use crate::rests::unit_rest::UnitRest;
use crate::simulate::stand::Stand;
use directions::directions;

/// Step of the central differences with respect to stand parameters and motor angles, rad. The relative error of a
/// difference quotient is about the square of the step, 1e-8.
const STEP_RAD: f64 = 1e-4;
/// A change of an encoder reading by up to this angle, rad, is attributed to rounding of the stored numbers. The count
/// (resolution) of any real encoder is a far larger angle.
const LEAST_COUNT_RAD: f64 = 1e-11;
/// Number of fixed-point iterations that correct the encoder readings. The effects on the encoders depend on the true
/// motor angles and rates, which are known only after the correction, so the correction is repeated.
const PASSES: usize = 3;

/// Model of the stand: its attitude as a function of the motor angles, for given stand parameters.
pub(crate) struct StandModel {
    stand: Stand,
    /// Angle of each motor, rad, when its encoder reads zero.
    zero_rad: Vector3<f64>,
    parameters: [f64; STAND_PARAMETERS],
}

impl StandModel {
    pub(crate) fn of(parameters: &[f64]) -> Self {
        // Without encoders, `parameters` is empty. The model then describes a stand without errors, and no residual
        // uses it.
        let mut p = [0.0; STAND_PARAMETERS];
        p.iter_mut().zip(parameters).for_each(|(own, given)| *own = *given);
        let stand = Stand {
            mount_rotation_rad: Vector3::new(p[0], p[1], p[2]),
            base_tilt_rad: [p[3], p[4]],
            non_orthogonality_rad: [p[5], p[6]],
            ..Stand::perfect()
        };
        Self { stand, zero_rad: Vector3::new(0.0, p[7], 0.0), parameters: p }
    }

    /// Attitude of the body (world from body) for the motor angles, rad.
    pub(crate) fn attitude(&self, angle_rad: &Vector3<f64>) -> UnitQuaternion<f64> {
        self.stand.attitude(&(angle_rad + self.zero_rad))
    }

    /// Derivative of the attitude with respect to the motor angles. Column k is the rotation vector in the world frame
    /// per radian of motor k.
    fn by_angle(&self, angle_rad: &Vector3<f64>) -> Matrix3<f64> {
        Matrix3::from_columns(&[0, 1, 2].map(|motor| {
            let step = Vector3::ith(motor, STEP_RAD);
            let turn = self.attitude(&(angle_rad + step)) * self.attitude(&(angle_rad - step)).inverse();
            so3::log(&turn) / (2.0 * STEP_RAD)
        }))
    }

    /// Derivative of the attitude with respect to the stand parameter `p`, as a rotation vector in the world frame.
    fn by_parameter(&self, p: usize, angle_rad: &Vector3<f64>) -> Vector3<f64> {
        let moved = |step: f64| {
            let mut changed = self.parameters;
            changed[p] += step;
            Self::of(&changed).attitude(angle_rad)
        };
        so3::log(&(moved(STEP_RAD) * moved(-STEP_RAD).inverse())) / (2.0 * STEP_RAD)
    }
}

/// Computes the start value of the mount rotation: the least-squares rotation that maps the measured up directions `up`
/// (body frame) to the up directions computed from the encoder angles (frame of the innermost ring of the stand).
pub(crate) fn mount_rotation(angles: &[Vector3<f64>], up: &[Vector3<f64>]) -> Vector3<f64> {
    let square = StandModel::of(&[0.0; STAND_PARAMETERS]);
    let sum: Matrix3<f64> =
        angles.iter().zip(up).map(|(q, u)| square.attitude(q).inverse() * Vector3::z() * u.transpose()).sum();
    // Rotation closest to the sum of outer products, computed iteratively. This avoids a singular value decomposition,
    // which might not converge.
    so3::log(&UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_eps(
        &sum,
        1e-14,
        1000,
        Rotation3::identity(),
    )))
}

/// Motor angles for a range of samples: the encoder readings, corrected for the effects on the encoders.
pub(crate) struct Angles {
    pub(super) angle_rad: Vec<Vector3<f64>>,
    /// Derivatives Phi of the encoder readings with respect to the parameters of the effects: `terms.count` vectors for
    /// each sample, with one component per motor. An effect is the sum of Phi times its parameters.
    columns: Vec<Vector3<f64>>,
}

/// Estimates the count (resolution) of the encoders, rad, as the smallest nonzero change between consecutive readings.
/// For readings that are not quantised, it is nearly zero.
fn count_rad(stand_rad: &[[f64; 3]]) -> f64 {
    let changes = stand_rad.windows(2).flat_map(|w| [0, 1, 2].map(|motor| (w[1][motor] - w[0][motor]).abs()));
    let least = changes.filter(|change| *change > LEAST_COUNT_RAD).fold(f64::INFINITY, f64::min);
    if least.is_finite() { least } else { 0.0 }
}

impl Angles {
    /// Corrects the encoder readings for the effects with the parameters `values`. `time_s`, `readings` and
    /// `directions` (signs of the last motion of each motor) have one entry per sample. `sample` identifies the first
    /// of these samples by its recording and its index.
    fn of(
        values: &[f64],
        terms: &Terms<'_>,
        time_s: &[f64],
        readings: &[[f64; 3]],
        directions: &[Vector3<f64>],
        sample: Sample,
    ) -> Self {
        let seen: Vec<Vector3<f64>> = readings.iter().map(|r| Vector3::from(*r)).collect();
        let mut all = Self { angle_rad: seen.clone(), columns: vec![Vector3::zeros(); seen.len() * terms.count] };
        let mut room = terms.room();
        let derivative = Derivative::narrow(time_s);
        for _ in 0..PASSES {
            let rates = if seen.len() > 1 { derivative.of(&all.angle_rad) } else { vec![Vector3::zeros(); seen.len()] };
            for k in 0..seen.len() {
                let stand = StandState { angle_rad: all.angle_rad[k], rate_radps: rates[k], direction: directions[k] };
                let state = State {
                    angular_rate: Vector3::zeros(),
                    specific_force: Vector3::zeros(),
                    surroundings: Surroundings { stand: Some(stand), ..Surroundings::unknown() },
                };
                terms.columns_at(values, &state, Sample { index: sample.index + k, ..sample }, &mut room);
                all.angle_rad[k] = seen[k] - terms.sum_of(Sensor::Encoder, values, &room);
                all.columns[k * terms.count..(k + 1) * terms.count].copy_from_slice(&room[..terms.count]);
            }
        }
        all
    }

    /// Computes the derivative of the attitude of the stand with respect to every parameter, averaged over `samples`.
    /// It is one rotation vector in the world frame for each parameter. The stand is linearised at the middle sample.
    /// The derivatives of the readings with respect to the parameters of the effects are averaged over all samples,
    /// because they may jump when a motor reverses.
    pub(super) fn attitude_jacobian(
        &self,
        samples: Range<usize>,
        terms: &Terms<'_>,
        stand: &StandModel,
    ) -> Vec<Vector3<f64>> {
        let mut jacobian = vec![Vector3::zeros(); terms.total()];
        let middle = &self.angle_rad[(samples.start + samples.end) / 2];
        let by_angle = stand.by_angle(middle) / samples.len() as f64;
        for k in samples {
            for p in (0..terms.count).filter(|p| terms.sensors[*p] == Sensor::Encoder) {
                jacobian[BASE + p] -= by_angle * self.columns[k * terms.count + p];
            }
        }
        for p in 0..STAND_PARAMETERS {
            jacobian[BASE + terms.count + p] = stand.by_parameter(p, middle);
        }
        jacobian
    }
}

/// Computes two residuals of a rest, rad: the gravity direction computed from the encoder angles minus the measured
/// direction, along two axes perpendicular to the measured direction. For each residual, the result contains its
/// derivatives with respect to all parameters, followed by the residual.
pub(crate) fn rest_rows(
    angles: &Angles,
    terms: &Terms<'_>,
    stand: &StandModel,
    measured: &EndDirection,
) -> [Vec<f64>; 2] {
    let body_from_world = stand.attitude(&angles.angle_rad[0]).inverse();
    let across = rows_across(&measured.up);
    let residual = across * (body_from_world * Vector3::z() - measured.up);
    // R is the attitude of the body (world from body), and e_z is the unit vector up in the world frame. An attitude
    // error `turn` replaces R by exp(turn) R. It changes the gravity direction R^T e_z by R^T (e_z x turn).
    let columns: Vec<_> = angles
        .attitude_jacobian(0..1, terms, stand)
        .iter()
        .zip(&measured.jacobian)
        .map(|(turn, by)| across * (body_from_world * Vector3::z().cross(turn) - by))
        .collect();
    [0, 1].map(|c| columns.iter().map(|column| column[c]).chain([residual[c]]).collect())
}

/// Quantities computed from the encoder readings of all recordings.
pub(crate) struct Encoders {
    /// Sign of the last motion of each motor, for every sample of every recording.
    directions: Vec<Vec<Vector3<f64>>>,
    /// Mean reading at each rest, rad.
    means: Vec<Vector3<f64>>,
    /// Variance of one reading in motion, rad^2.
    reading_variance: f64,
    /// Variance of the mean reading at a rest, rad^2.
    mean_variance: f64,
}

impl Encoders {
    /// # Errors
    /// [`Error::Input`] if a recording has no encoder angles.
    pub(crate) fn try_new(recordings: &[Recording<'_>], rests: &[UnitRest]) -> Result<Self, Error> {
        let all = recordings.iter().map(readings).collect::<Result<Vec<_>, Error>>()?;
        let directions = recordings.iter().enumerate().map(|(index, recording)| {
            let ranges: Vec<_> =
                rests.iter().filter(|r| r.recording == index).map(|r| r.rest.first..r.rest.end).collect();
            directions(recording.time_s, all[index], &ranges)
        });
        let at_rest = |r: &UnitRest| {
            let readings = &all[r.recording][r.rest.first..r.rest.end];
            let count = readings.len() as f64;
            // Differences from the first reading are averaged, because sums of large angles (many turns) would lose
            // digits by rounding.
            let first = Vector3::from(readings[0]);
            let mean = readings.iter().map(|e| Vector3::from(*e) - first).sum::<Vector3<f64>>() / count + first;
            let square = |e: &[f64; 3]| (Vector3::from(*e) - mean).norm_squared() / 3.0;
            let variance = readings.iter().map(square).sum::<f64>() / count;
            (mean, variance, variance / count)
        };
        let at_rests: Vec<(Vector3<f64>, f64, f64)> = rests.iter().map(at_rest).collect();
        // In motion, quantisation acts as noise with the variance `resolution^2 / 12`. At a rest, all readings have the
        // same quantisation error, so averaging does not reduce this variance.
        let rounding = all.iter().map(|readings| count_rad(readings)).fold(0.0, f64::max).powi(2) / 12.0;
        let typical =
            |of: fn(&(Vector3<f64>, f64, f64)) -> f64| median(&mut at_rests.iter().map(of).collect::<Vec<_>>());
        Ok(Self {
            directions: directions.collect(),
            reading_variance: typical(|rest| rest.1) + rounding,
            mean_variance: typical(|rest| rest.2) + rounding,
            means: at_rests.into_iter().map(|rest| rest.0).collect(),
        })
    }

    /// Mean reading at a rest, rad.
    pub(crate) fn mean(&self, rest: usize) -> &Vector3<f64> {
        &self.means[rest]
    }

    /// Variance of one reading in motion, rad^2.
    pub(crate) fn reading_variance(&self) -> f64 {
        self.reading_variance
    }

    /// Variance of the mean reading at a rest, rad^2.
    pub(crate) fn mean_variance(&self) -> f64 {
        self.mean_variance
    }

    /// Computes the motor angles at rest `k`: the mean encoder reading, corrected for the effects with the parameters
    /// `values`.
    pub(crate) fn at_rest(&self, k: usize, rest: &UnitRest, values: &[f64], terms: &Terms<'_>) -> Angles {
        let sample = Sample { recording: rest.recording, index: rest.rest.end - 1, count: 1 };
        let direction = self.directions[rest.recording][sample.index];
        Angles::of(values, terms, &[0.0], &[(*self.mean(k)).into()], &[direction], sample)
    }

    /// Computes the motor angles of all samples of the move `m`, corrected for the effects with the parameters
    /// `values`.
    pub(crate) fn in_move(&self, recording: &Recording<'_>, m: &Move, values: &[f64], terms: &Terms<'_>) -> Angles {
        let range = m.first..m.last + 1;
        let sample = Sample { recording: m.recording, index: m.first, count: 1 };
        let readings = &recording.stand_rad.unwrap_or_default()[range.clone()];
        let directions = &self.directions[m.recording][range.clone()];
        Angles::of(values, terms, &recording.time_s[range], readings, directions, sample)
    }
}

fn readings<'a>(recording: &Recording<'a>) -> Result<&'a [[f64; 3]], Error> {
    recording.stand_rad.filter(|_| recording.has_stand()).ok_or_else(|| {
        Error::Input(format!(
            "{} has no stand_1, stand_2 and stand_3 columns with values in every row: effects of the encoders need them",
            recording.name
        ))
    })
}
