//! Residuals against the encoders of a stand (model.md (21)).
//!
//! ```text
//! rests        across u_k:  R_wb(q_k)^T e_z - u_k
//! in the move  log(C_0^T C(t) R(t)^T),   C = R_wb(q)
//! q = e - sum Phi(q, dq/dt, direction) theta,   e what the encoders read
//! ```
//!
//! The stand is not accurate: how the unit is mounted on it (3), its base's tilt (2) and the angles between its axes (2) are
//! estimated along, after all other parameters. Inside a move the residual is a random walk of the gyroscope's noise seen
//! through the encoders' noise; gravity at the end of the move is one more look at its two parts across gravity.

use std::ops::Range;

use imucal_core::effects::{Sensor, StandState, State, Surroundings};
use imucal_core::so3;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

use super::inside::{EndDirection, Filter};
use super::model::BASE;
use super::pass::Pass;
use super::terms::{Sample, Terms};
use crate::correct::slopes;
use crate::error::Error;
use crate::moves::{Ends, Move, UnitRest};
use crate::recording::Recording;
use crate::simulate::stand::Stand;

/// Mount rotation, base tilt and the angles between the axes.
pub(crate) const STAND_PARAMETERS: usize = 7;
/// Angle by which a derivative by a stand parameter or a motor angle is taken, rad; its square is the error.
const STEP_RAD: f64 = 1e-4;
/// A time offset's field is that of the true rate of the motors: passes of the correction.
const PASSES: usize = 3;

/// The stand at given parameters.
pub(crate) struct StandModel {
    stand: Stand,
    parameters: [f64; STAND_PARAMETERS],
}

impl StandModel {
    pub(crate) fn of(parameters: &[f64]) -> Self {
        // Without encoders there are none, and nobody asks.
        let mut p = [0.0; STAND_PARAMETERS];
        p.iter_mut().zip(parameters).for_each(|(own, given)| *own = *given);
        let stand = Stand {
            mount_rotation_rad: Vector3::new(p[0], p[1], p[2]),
            base_tilt_rad: [p[3], p[4]],
            non_orthogonality_rad: [p[5], p[6]],
            ..Stand::perfect()
        };
        Self { stand, parameters: p }
    }

    /// Attitude of the body for motor angles.
    fn attitude(&self, angle_rad: &Vector3<f64>) -> UnitQuaternion<f64> {
        self.stand.attitude(angle_rad)
    }

    /// Rotation vectors in the world by each motor angle, column by column.
    fn by_angle(&self, angle_rad: &Vector3<f64>) -> Matrix3<f64> {
        Matrix3::from_columns(&[0, 1, 2].map(|motor| {
            let step = Vector3::ith(motor, STEP_RAD);
            let turn = self.attitude(&(angle_rad + step)) * self.attitude(&(angle_rad - step)).inverse();
            so3::log(&turn) / (2.0 * STEP_RAD)
        }))
    }

    /// Rotation vector in the world by a stand parameter.
    fn by_parameter(&self, p: usize, angle_rad: &Vector3<f64>) -> Vector3<f64> {
        let moved = |step: f64| {
            let mut changed = self.parameters;
            changed[p] += step;
            Self::of(&changed).attitude(angle_rad)
        };
        so3::log(&(moved(STEP_RAD) * moved(-STEP_RAD).inverse())) / (2.0 * STEP_RAD)
    }
}

/// The start value of the mount: what turns the stand's up directions into the measured ones, least squares.
pub(crate) fn mount_rotation(angles: &[Vector3<f64>], up: &[Vector3<f64>]) -> Vector3<f64> {
    let square = StandModel::of(&[0.0; STAND_PARAMETERS]);
    let sum: Matrix3<f64> =
        angles.iter().zip(up).map(|(q, u)| square.attitude(q).inverse() * Vector3::z() * u.transpose()).sum();
    // The rotation nearest to the sum, found by iteration: no decomposition that might not converge.
    so3::log(&UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_eps(
        &sum,
        1e-14,
        1000,
        Rotation3::identity(),
    )))
}

/// Encoder angles of one stretch of samples, freed of the effects.
pub(crate) struct Angles {
    angle_rad: Vec<Vector3<f64>>,
    /// Columns of the effects, as many for each sample as there are parameters.
    columns: Vec<Vector3<f64>>,
}

/// Which way each motor went last, for every sample. `still_rad` is the largest step that is no motion.
///
/// A motor turns at a sample if it does so before and after it; the step after it says which way, for the step before the
/// first sample of a turn may be the backlash itself.
fn directions(stand_rad: &[[f64; 3]], still_rad: f64) -> Vec<Vector3<f64>> {
    let step = |i: usize, motor: usize| {
        let ends = stand_rad.get(i).zip(stand_rad.get(i + 1));
        ends.map_or(0.0, |(from, to)| to[motor] - from[motor])
    };
    let mut last = Vector3::zeros();
    (0..stand_rad.len())
        .map(|i| {
            for motor in 0..3 {
                let (before, after) = (if i > 0 { step(i - 1, motor) } else { 0.0 }, step(i, motor));
                if before.abs() > still_rad && after.abs() > still_rad {
                    last[motor] = after.signum();
                }
            }
            last
        })
        .collect()
}

/// The largest step between samples at rest: what is no motion.
fn still_rad(stand_rad: &[[f64; 3]], rests: &[std::ops::Range<usize>]) -> f64 {
    let steps = rests.iter().flat_map(|rest| {
        stand_rad[rest.clone()].windows(2).map(|w| (Vector3::from(w[1]) - Vector3::from(w[0])).amax())
    });
    1e-10 + 1.5 * steps.fold(0.0, f64::max)
}

impl Angles {
    /// `readings` and `directions` are those of the same samples; `time_s` too.
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
        for _ in 0..PASSES {
            let rates =
                if seen.len() > 1 { slopes(time_s, &all.angle_rad, 0.0) } else { vec![Vector3::zeros(); seen.len()] };
            for k in 0..seen.len() {
                let columns = &mut all.columns[k * terms.count..(k + 1) * terms.count];
                let stand = StandState { angle_rad: all.angle_rad[k], rate_radps: rates[k], direction: directions[k] };
                let state = State {
                    angular_rate: Vector3::zeros(),
                    specific_force: Vector3::zeros(),
                    surroundings: Surroundings { stand: Some(stand), ..Surroundings::unknown() },
                };
                terms.columns_at(values, &state, Sample { index: sample.index + k, ..sample }, columns);
                all.angle_rad[k] = seen[k] - terms.sum_of(Sensor::Encoder, values, columns);
            }
        }
        all
    }

    /// Mean derivative of the attitude of `samples` by every parameter: rotation vectors in the world. The stand is taken as it
    /// is in the middle; the columns, which may jump where a motor turns back, are those of all samples.
    fn attitude_jacobian(&self, samples: Range<usize>, terms: &Terms<'_>, stand: &StandModel) -> Vec<Vector3<f64>> {
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

/// Two residuals of a rest: the stand's direction of gravity less the measured one. Derivatives first, residual last.
pub(crate) fn rest_rows(
    angles: &Angles,
    terms: &Terms<'_>,
    stand: &StandModel,
    measured: &EndDirection,
) -> [Vec<f64>; 2] {
    let body_from_world = stand.attitude(&angles.angle_rad[0]).inverse();
    let across = Ends { before: measured.up, after: measured.up, sigma_rad: 1.0 }.across();
    let residual = across * (body_from_world * Vector3::z() - measured.up);
    // R <- exp(turn) R, so R^T e_z changes by R^T (e_z x turn).
    let columns: Vec<_> = angles
        .attitude_jacobian(0..1, terms, stand)
        .iter()
        .zip(&measured.jacobian)
        .map(|(turn, by)| across * (body_from_world * Vector3::z().cross(turn) - by))
        .collect();
    [0, 1].map(|c| columns.iter().map(|column| column[c]).chain([residual[c]]).collect())
}

/// What the encoders of all recordings say.
pub(crate) struct Encoders {
    /// Which way each motor went last, for every sample of every recording.
    directions: Vec<Vec<Vector3<f64>>>,
    /// Mean reading at each rest, and the variance of one reading there.
    rests: Vec<(Vector3<f64>, f64)>,
}

impl Encoders {
    /// # Errors
    /// [`Error::Input`] if a recording has no encoder angles.
    pub(crate) fn try_new(recordings: &[Recording<'_>], rests: &[UnitRest]) -> Result<Self, Error> {
        let directions = recordings.iter().enumerate().map(|(index, recording)| {
            let readings = readings(recording)?;
            let ranges: Vec<_> =
                rests.iter().filter(|r| r.recording == index).map(|r| r.rest.first..r.rest.end).collect();
            Ok(directions(readings, still_rad(readings, &ranges)))
        });
        let mean = |r: &UnitRest| {
            let readings = &readings(&recordings[r.recording])?[r.rest.first..r.rest.end];
            let count = readings.len() as f64;
            // Differences keep the digits of many turns.
            let first = Vector3::from(readings[0]);
            let mean = readings.iter().map(|e| Vector3::from(*e) - first).sum::<Vector3<f64>>() / count + first;
            let square = |e: &[f64; 3]| (Vector3::from(*e) - mean).norm_squared() / 3.0;
            Ok((mean, readings.iter().map(square).sum::<f64>() / count))
        };
        Ok(Self {
            directions: directions.collect::<Result<_, Error>>()?,
            rests: rests.iter().map(mean).collect::<Result<_, Error>>()?,
        })
    }

    /// Mean reading at a rest.
    pub(crate) fn mean(&self, rest: usize) -> &Vector3<f64> {
        &self.rests[rest].0
    }

    /// Variance of one reading, rad^2: the largest of all rests, as rounding hides where an angle is just between two counts.
    pub(crate) fn variance(&self) -> f64 {
        self.rests.iter().map(|(_, variance)| *variance).fold(0.0, f64::max)
    }

    /// The motor angles at a rest.
    pub(crate) fn at_rest(&self, k: usize, rest: &UnitRest, values: &[f64], terms: &Terms<'_>) -> Angles {
        let sample = Sample { recording: rest.recording, index: rest.rest.end - 1 };
        let direction = self.directions[rest.recording][sample.index];
        Angles::of(values, terms, &[0.0], &[(*self.mean(k)).into()], &[direction], sample)
    }

    /// The motor angles in a move.
    pub(crate) fn in_move(&self, recording: &Recording<'_>, m: &Move, values: &[f64], terms: &Terms<'_>) -> Angles {
        let range = m.first..m.last + 1;
        let sample = Sample { recording: m.recording, index: m.first };
        let readings = &recording.stand_rad.unwrap_or_default()[range.clone()];
        let directions = &self.directions[m.recording][range.clone()];
        Angles::of(values, terms, &recording.time_s[range], readings, directions, sample)
    }
}

fn readings<'a>(recording: &Recording<'a>) -> Result<&'a [[f64; 3]], Error> {
    recording.stand_rad.ok_or_else(|| {
        Error::Input(format!(
            "{} has no stand_1, stand_2 and stand_3 columns: effects of the encoders need their angles",
            recording.name
        ))
    })
}

/// Variances of one move.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EncoderNoise {
    /// Of one block of encoder readings, rad^2.
    pub(crate) reading: f64,
    /// Growth of the gyroscope's attitude error, rad^2/s.
    pub(crate) walk: f64,
    /// Of the direction of gravity at the end, rad^2; `None` if that residual stands elsewhere.
    pub(crate) end: Option<f64>,
}

/// One move as the encoders see it.
pub(crate) struct EncoderMove<'a> {
    pub(crate) span: &'a Move,
    /// Angles of the samples `first..=last`, and of the rest before.
    pub(crate) angles: &'a Angles,
    pub(crate) rest: &'a Angles,
    pub(crate) stand: &'a StandModel,
}

/// How many residuals a move gives.
pub(crate) fn count(pass: &Pass, with_end: bool) -> usize {
    3 * pass.blocks.len() + if with_end { 2 } else { 0 }
}

impl EncoderMove<'_> {
    /// Hands every white residual to `push`: its derivative by every parameter, and the residual itself as the last number.
    pub(crate) fn innovations(
        &self,
        pass: &Pass,
        terms: &Terms<'_>,
        [start, end]: [&EndDirection; 2],
        noise: &EncoderNoise,
        mut push: impl FnMut(&[f64]),
    ) {
        let n = terms.total();
        let first = self.stand.attitude(&self.rest.angle_rad[0]).inverse();
        let rest_jacobian = self.rest.attitude_jacobian(0..1, terms, self.stand);
        // Mean residual of each block and its derivatives, in the body frame at the start.
        let blocks: Vec<(f64, Vector3<f64>, Vec<Vector3<f64>>)> = pass
            .blocks
            .iter()
            .map(|block| {
                let residual = |i: usize| {
                    let here = first * self.stand.attitude(&self.angles.angle_rad[i]);
                    let gyroscope = Rotation3::from_matrix_unchecked(pass.attitudes[i]);
                    so3::log(&(here * UnitQuaternion::from_rotation_matrix(&gyroscope).inverse()))
                };
                let samples = block.samples.clone();
                let mean = samples.clone().map(residual).sum::<Vector3<f64>>() / samples.len() as f64;
                let jacobian = self
                    .angles
                    .attitude_jacobian(samples, terms, self.stand)
                    .iter()
                    .zip(&rest_jacobian)
                    .zip(&block.turn)
                    .map(|((here, rest), turn)| first * (here - rest) - turn)
                    .collect();
                (block.time_s, mean, jacobian)
            })
            .collect();
        let smallest = start.up.iamin();
        let side = Vector3::ith(smallest, 1.0).cross(&start.up).normalize();
        let other = start.up.cross(&side);
        // A turn x moves the carried gravity by x cross u: along `side` by x . other, along `other` by -x . side.
        for (d, across) in [(start.up, None), (side, Some((other, -1.0))), (other, Some((side, 1.0)))] {
            let mut filter = Filter::new(n, 0.0);
            let mut last_s = 0.0;
            for (time_s, mean, jacobian) in &blocks {
                let mut z: Vec<f64> = jacobian.iter().map(|column| d.dot(column)).chain([d.dot(mean)]).collect();
                filter.walk(noise.walk * (time_s - last_s));
                last_s = *time_s;
                filter.innovate(&mut z, noise.reading);
                push(&z);
            }
            if let (Some((along, sign)), Some(variance)) = (across, noise.end) {
                let carried = pass.rotation * end.up;
                let by = |p: usize| {
                    let change = pass.turn[p].cross(&carried) + pass.rotation * end.jacobian[p] - start.jacobian[p];
                    // The filter's state is minus the gyroscope's turn.
                    -sign * along.dot(&change)
                };
                let mut z: Vec<f64> = (0..n).map(by).chain([-sign * along.dot(&(carried - start.up))]).collect();
                filter.walk(noise.walk * (self.span.duration_s - last_s));
                filter.innovate(&mut z, variance);
                push(&z);
            }
        }
    }
}
