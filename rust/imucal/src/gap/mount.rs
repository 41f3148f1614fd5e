//! Detects faults of the mount between a unit and its stand. The stand rotates the unit with three motors, whose angles
//! are measured by encoders. At each rest, two directions of gravity are compared: the direction measured by the
//! accelerometer, and the direction computed from the motor angles.
//!
//! ```text
//! r_k = up_k - R(q_k)^T e_z                                  up_k: measured direction up, R: stand model (21)
//! mount_slip     r_k = stand errors, plus s x up_k from rest `first` on   s: lasting rotation of unit on mount, rad
//! loose_mount    r_k scatters from rest to rest by more than on any rigid mount
//! ```
//!
//! k is the index of the rest, q_k are the motor angles at this rest, and e_z is the unit vector up in the world frame.
//! R(q) rotates vectors from the body frame to the world frame. Stand errors are described by the eight parameters of
//! the stand model (docs/model.md (21)) and by two harmonics of each encoder's error (one and two periods per
//! revolution).

use faer::Mat;
use imucal_core::sensor::Triad;
use imucal_core::so3;
use nalgebra::{Matrix3, Vector3};

use crate::evaluate::RestReport;
use crate::finding::{Finding, general};
use crate::joint::{StandModel, mount_rotation};
use crate::numerics::stats::median;
use crate::parameters::STAND_PARAMETERS;
use crate::recording::Recording;

/// A slip of the mount is detected only if there are at least this number of rests before it and this number after it.
const FEWEST_RESTS: usize = 4;
/// A step of the unit's attitude on the mount is reported as a slip if chi2(without step) / chi2(with step) >
/// SLIP_FACTOR. A steady drift of the attitude gives the ratio 4, because a step in its middle halves the residuals. A
/// drift is not a slip, so the threshold must exceed 4.
const SLIP_FACTOR: f64 = 10.0;
/// Maximum scatter of the measured gravity direction about the direction computed from the stand's angles, deg (1
/// sigma). The value is the largest scatter that occurs with a rigid mount on a low-cost stand. A larger scatter is
/// reported as looseness of the mount.
const PLAY_DEG: f64 = 0.25;
/// Step of the numerical derivatives (central differences) with respect to stand parameters and motor angles, rad.
const STEP_RAD: f64 = 1e-4;
/// Threshold of the rank decision: a singular value of the matrix of stand-error derivatives counts as zero if it is
/// below this share of the largest one.
const RANK: f64 = 1e-6;
/// Number of mount angles. They are the first parameters of the stand model.
const MOUNT: usize = 3;
/// Number of components of a direction vector.
const AXES: usize = 3;

/// A rest of a unit on a stand.
#[derive(Clone, Copy, Debug)]
pub struct StandRest {
    /// Index of the recording that contains the rest.
    pub recording: usize,
    /// Index of the first sample.
    pub first: usize,
    /// Index of the last sample plus one.
    pub end: usize,
    /// Time of the first sample, s.
    pub start_s: f64,
    /// Mean accelerometer reading, raw units.
    pub mean_specific_force: Vector3<f64>,
    /// Whether the fit of the calibration used the rest.
    pub is_used: bool,
}

impl From<&RestReport> for StandRest {
    fn from(rest: &RestReport) -> Self {
        Self {
            recording: rest.recording,
            first: rest.first,
            end: rest.end,
            start_s: rest.start_s,
            mean_specific_force: rest.mean_specific_force,
            is_used: rest.excluded.is_none(),
        }
    }
}

/// Detects a lasting rotation of the unit relative to its mount, in each recording. `accelerometer` (the sensor model)
/// and `rests` are results of a fit without effects to these recordings.
pub fn mount_slips(accelerometer: &Triad<f64>, rests: &[StandRest], recordings: &[Recording<'_>]) -> Vec<Finding> {
    let slip_of = |(index, recording): (usize, &Recording<'_>)| {
        let rests = with_angles(rests, index, recording).into_iter().filter(|rest| rest.is_used).collect();
        let residuals = Residuals::new(accelerometer, recording, rests)?;
        let Step { first, turn_rad, factor } = residuals.largest_step();
        (factor > SLIP_FACTOR).then(|| {
            let degrees = turn_rad.to_degrees();
            Finding {
                value: degrees,
                message: format!(
                    "from {:.1} s on the unit is rotated by {degrees:.2} deg on its mount: with this rotation in the model, \
                     residuals of the rests against the stand's angles are {} times smaller",
                    residuals.rests[first].start_s,
                    general(factor.sqrt(), 2)
                ),
                ..mount_fault("mount_slip", recording)
            }
        })
    };
    recordings.iter().enumerate().filter_map(slip_of).collect()
}

/// Detects a loose mount: the attitude of the unit relative to the mount changes with every move. `accelerometer` (the
/// sensor model) and `rests` are results of a fit without effects to these recordings.
pub fn loose_mounts(accelerometer: &Triad<f64>, rests: &[StandRest], recordings: &[Recording<'_>]) -> Vec<Finding> {
    let play_of = |(index, recording): (usize, &Recording<'_>)| {
        let residuals = Residuals::new(accelerometer, recording, with_angles(rests, index, recording))?;
        let degrees = residuals.scatter_rad().to_degrees();
        (degrees > PLAY_DEG).then(|| Finding {
            value: degrees,
            message: format!(
                "gravity scatters by {degrees:.2} deg (1 sigma) from rest to rest against the stand's angles, more than the \
                 {PLAY_DEG} deg of a rigid mount: the unit has play on its mount"
            ),
            ..mount_fault("loose_mount", recording)
        })
    };
    recordings.iter().enumerate().filter_map(play_of).collect()
}

/// Median over all samples of the angle between two directions of gravity, deg. The first direction is that of the raw
/// accelerometer sample. The second direction is computed from the motor angles, for a stand without errors and with
/// the mount angles that fit best. `None` if the recording has no motor angles.
pub fn stand_mismatch_deg(recording: &Recording<'_>) -> Option<f64> {
    let angles = recording.stand_rad?;
    let known = (0..recording.len()).filter(|&k| angles[k].iter().all(|angle| angle.is_finite()));
    let (angles, up): (Vec<Vector3<f64>>, Vec<Vector3<f64>>) = known
        .map(|k| {
            let force = Vector3::from(recording.specific_force.at(k));
            (Vector3::from(angles[k]), force / force.norm().max(f64::MIN_POSITIVE))
        })
        .unzip();
    if angles.is_empty() {
        return None;
    }
    let mount = best_mount(&angles, &up);
    let missed = |(angle, up): (&Vector3<f64>, &Vector3<f64>)| {
        up.dot(&(mount * up_by_stand(&[0.0; STAND_PARAMETERS], angle))).clamp(-1.0, 1.0).acos()
    };
    let mut missed: Vec<f64> = angles.iter().zip(&up).map(missed).collect();
    // Samples inside moves contain accelerations in addition to gravity. The median is robust against these samples.
    Some(median(&mut missed).to_degrees())
}

fn mount_fault(code: &'static str, recording: &Recording<'_>) -> Finding {
    Finding {
        columns: ["stand_1", "stand_2", "stand_3"].map(str::to_owned).into(),
        count: 1,
        unit: "deg",
        way_out: "fasten the unit and record again".into(),
        ..Finding::warning(code, recording.name)
    }
}

/// The rests of recording `index` at which all motor angles of the stand are known.
fn with_angles<'a>(rests: &'a [StandRest], index: usize, recording: &Recording<'_>) -> Vec<&'a StandRest> {
    let Some(angles) = recording.stand_rad else { return Vec::new() };
    let is_known =
        |rest: &&StandRest| angles[rest.first..rest.end].as_flattened().iter().all(|angle| angle.is_finite());
    rests.iter().filter(|rest| rest.recording == index).filter(is_known).collect()
}

/// Direction up in the body frame, computed from the stand parameters and the motor angles.
fn up_by_stand(parameters: &[f64; STAND_PARAMETERS], angle_rad: &Vector3<f64>) -> Vector3<f64> {
    StandModel::of(parameters).attitude(angle_rad).inverse() * Vector3::z()
}

/// Least-squares rotation that maps the up directions computed for an error-free stand to the measured up directions.
fn best_mount(angles: &[Vector3<f64>], up: &[Vector3<f64>]) -> Matrix3<f64> {
    so3::exp(&mount_rotation(angles, up)).inverse().to_rotation_matrix().into_inner()
}

/// Residuals of the gravity directions at the rests of one recording. Stand errors have been fitted and subtracted.
struct Residuals<'a> {
    rests: Vec<&'a StandRest>,
    /// Residuals of the direction up. Each rest has three consecutive components.
    values: Mat<f64>,
    /// Orthonormal basis of the space of all residuals that errors of the stand can cause.
    basis: Mat<f64>,
    /// Derivatives of the gravity directions with respect to the three mount angles.
    by_mount: Mat<f64>,
}

/// A lasting rotation of the unit relative to its mount, which occurs between two rests.
struct Step {
    /// Index of the first rest after the rotation.
    first: usize,
    /// Angle of the rotation, rad.
    turn_rad: f64,
    /// chi2(without step) / chi2(with step).
    factor: f64,
}

impl<'a> Residuals<'a> {
    /// Fits the stand errors to the directions at `rests`. `None` if there are fewer than four times [`FEWEST_RESTS`]
    /// rests, or if there are no motor angles.
    fn new(accelerometer: &Triad<f64>, recording: &Recording<'_>, rests: Vec<&'a StandRest>) -> Option<Self> {
        if rests.len() < 4 * FEWEST_RESTS {
            return None;
        }
        let readings = recording.stand_rad?;
        let angles: Vec<Vector3<f64>> = rests.iter().map(|rest| mean_of(&readings[rest.first..rest.end])).collect();
        let up: Vec<Vector3<f64>> =
            rests.iter().map(|rest| accelerometer.correct(rest.mean_specific_force).normalize()).collect();
        let none = [0.0; STAND_PARAMETERS];
        let by_stand: Vec<Vector3<f64>> = angles.iter().map(|angle| up_by_stand(&none, angle)).collect();
        let mount = best_mount(&angles, &up);
        let difference = |at: &dyn Fn(f64, &Vector3<f64>) -> Vector3<f64>, angle: &Vector3<f64>| {
            mount * (at(STEP_RAD, angle) - at(-STEP_RAD, angle)) / (2.0 * STEP_RAD)
        };
        // Derivatives of the direction up at rest `k`: first with respect to the stand parameters, then with respect to
        // the amplitudes of two harmonics of each encoder's error.
        let row = |k: usize| -> Vec<Vector3<f64>> {
            let angle = &angles[k];
            let by_parameter = |p: usize| {
                // The derivative with respect to the mount angles is analytic: a small rotation m of the mount changes
                // the direction `up` by the cross product up x m.
                if p < MOUNT {
                    return mount * by_stand[k].cross(&Vector3::ith(p, 1.0));
                }
                let at = |step: f64, angle: &Vector3<f64>| {
                    let mut changed = none;
                    changed[p] = step;
                    up_by_stand(&changed, angle)
                };
                difference(&at, angle)
            };
            let harmonics = (0..3).flat_map(|motor| {
                let at = |step: f64, angle: &Vector3<f64>| up_by_stand(&none, &(angle + Vector3::ith(motor, step)));
                let by_angle = difference(&at, angle);
                [1.0, 2.0].into_iter().flat_map(move |order| {
                    let (sine, cosine) = (order * angle[motor]).sin_cos();
                    [by_angle * sine, by_angle * cosine]
                })
            });
            (0..STAND_PARAMETERS).map(by_parameter).chain(harmonics).collect()
        };
        let columns: Vec<Vec<Vector3<f64>>> = (0..rests.len()).map(row).collect();
        let errors = Mat::from_fn(AXES * rests.len(), columns[0].len(), |i, j| columns[i / AXES][j][i % AXES]);
        let svd = errors.thin_svd().ok()?;
        let rank = (0..errors.ncols()).take_while(|&k| svd.S()[k] > RANK * svd.S()[0]).count();
        let basis = svd.U().subcols(0, rank).to_owned();
        let missed = |i: usize| (up[i / AXES] - mount * by_stand[i / AXES])[i % AXES];
        let values = Mat::from_fn(AXES * rests.len(), 1, |i, _| missed(i));
        let values = without(&basis, values);
        Some(Self { rests, values, basis, by_mount: errors.subcols(0, MOUNT).to_owned() })
    }

    /// The lasting rotation of the unit on its mount that decreases chi2 most if it is added to the model.
    fn largest_step(&self) -> Step {
        let mut best = Step { first: 0, turn_rad: 0.0, factor: 1.0 };
        let chi2 = self.values.squared_norm_l2();
        for first in FEWEST_RESTS..=self.rests.len() - FEWEST_RESTS {
            let after = |i: usize, j: usize| if i / AXES < first { 0.0 } else { self.by_mount[(i, j)] };
            let step = without(&self.basis, Mat::from_fn(self.values.nrows(), MOUNT, after));
            let Ok(svd) = step.thin_svd() else { continue };
            // The minimum-norm solution is used, because the rests may not determine all three components of the
            // rotation.
            let share =
                |k: usize| if svd.S()[k] > f64::EPSILON * self.values.nrows() as f64 * svd.S()[0] { 1.0 } else { 0.0 };
            let seen = svd.U().transpose() * &self.values;
            let scaled = Mat::from_fn(MOUNT, 1, |k, _| share(k) * seen[(k, 0)] / svd.S()[k].max(f64::MIN_POSITIVE));
            let turn = svd.V() * scaled;
            let factor = chi2 / (&self.values - &step * &turn).squared_norm_l2().max(1e-30);
            if factor > best.factor {
                best = Step { first, turn_rad: turn.norm_l2(), factor };
            }
        }
        best
    }

    /// Standard deviation, rad, of one component of the direction residuals. A residual has two components, which are
    /// perpendicular to gravity.
    fn scatter_rad(&self) -> f64 {
        // Each rest has two degrees of freedom, because a direction is a unit vector.
        let freedom = (2 * self.rests.len()).saturating_sub(self.basis.ncols()).max(1);
        (self.values.squared_norm_l2() / freedom as f64).sqrt()
    }
}

/// The part of each column of a matrix that is orthogonal to all columns of an orthonormal basis.
fn without(basis: &Mat<f64>, columns: Mat<f64>) -> Mat<f64> {
    let along = basis * (basis.transpose() * &columns);
    columns - along
}

fn mean_of(readings: &[[f64; 3]]) -> Vector3<f64> {
    readings.iter().map(|row| Vector3::from(*row)).sum::<Vector3<f64>>() / readings.len() as f64
}
