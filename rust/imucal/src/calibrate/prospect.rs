//! Predicts, before any fit, which parameters the recordings determine, and how accurately (model.md (12)).
//!
//! The residuals of the joint fit are linearised at nominal values of the sensor parameters. Their derivatives form the
//! design matrix, which shows which parameters are not determined. If its rows are divided by the noise measured at the
//! rests, the matrix also gives the standard deviation of each parameter, provided that the model describes the unit.

use std::sync::OnceLock;

use faer::Mat;
use imucal_core::sensor::Triad;
use nalgebra::{Matrix3, Vector3};

use super::design::{Design, FAR_OFF, OBSERVED, sizes};
use super::unit_data::{MIN_MOVES, UnitData, too_few_moves};
use super::{Frame, Options};
use crate::error::Error;
use crate::joint::{BLOCK_S, Joint, Kinds, Model, Prepared, SharedHistories, Terms, Wander};
use crate::numerics::derivative::Width;
use crate::numerics::lsq;
use crate::parameters::{BASE, parameter_names};
use crate::preintegration::kinematics::{rate_from_gravity, scale_from_gravity};
use crate::preintegration::{integrate_rotation_linear, total_rotation_rad};
use crate::recording::Recording;
use crate::rests::moves::{Move, Unusable, between};
use crate::rests::unit_rest::UnitRest;
use crate::two_stage::ellipsoid;
use crate::two_stage::observability::{
    EDGES_AND_CORNERS, FARTHEST, OR_ROLL, missing_poses, missing_turns, too_few_poses,
};

/// The unit counts as rotated between two rests if the gravity directions at these rests differ by more than this
/// angle, rad (20 deg).
const TURNED_RAD: f64 = 0.35;
/// Two gravity directions count as equal if the angle between them is below this limit, rad.
const ALIKE_RAD: f64 = 0.05;
/// The gyroscope responds to motion if (rms rate in a move) / (noise at rest) is above this value on any axis.
const REACTS: f64 = 3.0;

/// Prediction of which parameters the recordings determine, and of the standard deviations that a calibration would
/// have.
#[derive(Clone, Debug)]
pub struct Prospect {
    /// Names of the 21 parameters in the symmetric body frame.
    pub names: [String; 21],
    /// Predicted standard deviation of each parameter, raw units, provided that the model describes the unit; `None` if
    /// the parameter is not determined.
    pub predicted_sigma: [Option<f64>; 21],
    /// Names of the accelerometer parameters that the rests determine only together with the moves. An example is the
    /// misalignment if the unit is in a box that rests only on its six faces. The rotations between the rests then
    /// replace the missing directions of gravity.
    pub through_moves: Vec<String>,
    /// Message about the undetermined parameters, with the poses and rotations to add; `None` if all parameters are
    /// determined.
    pub missing: Option<String>,
}

/// Predicts, without a fit, which parameters the recordings of one unit determine and how accurately.
///
/// # Errors
/// [`Error::Data`] for recordings with faults, [`Error::NotEnoughMotion`] if there is no rest.
pub fn prospect(recordings: &[Recording<'_>], options: &Options<'_>) -> Result<Prospect, Error> {
    let mut data = UnitData::try_new(recordings, options)?;
    let scene = data.scene(options)?;
    if let (Some(accelerometer), Some(gyroscope)) = (&scene.accelerometer, &scene.gyroscope) {
        let sound = data.sound();
        data.free_of_tremor(accelerometer, gyroscope, &sound);
    }
    Ok(data.prospect(scene, options)?.0)
}

/// The rests and moves of the recordings, and the nominal sensor models before any fit.
struct Scene {
    /// For each rest, whether it has no known fault.
    used: Vec<bool>,
    /// Moves between the rests without known faults.
    moves: Vec<Move>,
    /// Intervals between the rests without known faults that cannot be used as moves.
    unusable: Vec<Unusable>,
    /// Nominal accelerometer: the sensor model before any fit; `None` if its scale is unknown.
    accelerometer: Option<Triad<f64>>,
    /// Nominal gyroscope: the sensor model before any fit; `None` if its scale is unknown.
    gyroscope: Option<Triad<f64>>,
    /// Measured vertical (up) at the rests without known faults, unit vectors in the body frame.
    up: Vec<Vector3<f64>>,
    /// Message if the accelerometer does not respond to motion.
    silent_accelerometer: Option<String>,
    /// Message if the gyroscope does not respond to motion.
    silent_gyroscope: Option<String>,
}

impl UnitData<'_> {
    /// Predicts which parameters the rests and moves together determine, and how accurately. The second result is a
    /// sensor model: determined parameters have their least-squares values, and all others their nominal values. All
    /// error messages about missing motion are based on this prediction.
    pub(super) fn joint_information(&self, options: &Options<'_>) -> Result<(Prospect, Model), Error> {
        self.prospect(self.scene(options)?, options)
    }

    /// Predicts which parameters these recordings determine, from the rests, moves and nominal sensor models in
    /// `scene`.
    fn prospect(&self, scene: Scene, options: &Options<'_>) -> Result<(Prospect, Model), Error> {
        let accelerometer = scene.accelerometer.unwrap_or_else(Triad::identity);
        let gyroscope = scene.gyroscope.unwrap_or_else(Triad::identity);
        let measures_gravity = scene.accelerometer.is_some() && scene.silent_accelerometer.is_none();
        let measures_rotation = measures_gravity && scene.gyroscope.is_some() && scene.silent_gyroscope.is_none();
        let moves: &[Move] = if measures_rotation { &scene.moves } else { &[] };

        let directions = self.directions(&accelerometer, &gyroscope);
        let ends: Vec<_> = moves.iter().map(|m| directions.readings(m, false)).collect();
        let held = self.held(options)?;
        let widths: Vec<Width> = moves.iter().map(|_| Width::default()).collect();
        let prepared = Prepared {
            recordings: self.recordings,
            rests: &self.rests,
            used: &scene.used,
            moves,
            ends: &ends,
            widths: &widths,
            flicker: &OnceLock::new(),
            histories: &SharedHistories::default(),
            noise: self.noise(),
            gravity_mps2: options.gravity_mps2,
            wander: Wander::of(options.wander),
            held: &held,
            encoders: None,
            max_iterations: options.max_iterations,
            block_s: BLOCK_S,
        };
        let samples: Vec<usize> = self.recordings.iter().map(Recording::len).collect();
        let terms = Terms::try_new(&[], &[], &samples, Kinds { in_motion: false, encoders: false })?;
        let model = Model { accelerometer, gyroscope, values: Vec::new(), stand: Vec::new() };
        let sizes = sizes(&model, options.gravity_mps2);

        let (design, near) = if measures_gravity {
            Design::near(&prepared, &terms, &model, &sizes)?
        } else {
            (Design::default(), model.parameters())
        };
        let of_held: Vec<usize> =
            held.iter().filter_map(|held| OBSERVED.iter().position(|p| *p == held.parameter())).collect();
        let (open, open_to_moves) = (design.open()?.without(&of_held), design.open_to_moves()?.columns);

        let mut predicted_sigma = [None; BASE];
        let problem = Joint::new(&prepared, &terms, &model.parameters())?;
        let (_, whitened) = problem.whitened(&model.parameters())?;
        // Each parameter in [`OBSERVED`] gets a prior whose standard deviation is a tenth of the typical size of the
        // parameter. The covariance is then finite even if some parameters are not determined.
        let held = Mat::from_fn(whitened.nrows() + 18, BASE, |i, p| match i.checked_sub(whitened.nrows()) {
            None => whitened[(i, p)],
            Some(k) if OBSERVED[k] == p => 1.0 / (FARTHEST * sizes[p]),
            Some(_) => 0.0,
        });
        let covariance = lsq::covariance(&held);
        for (p, sigma) in predicted_sigma.iter_mut().enumerate() {
            let is_open = open.columns.iter().any(|&k| OBSERVED[k] == p);
            *sigma = (!is_open).then(|| covariance[(p, p)].sqrt());
        }

        let turned = || -> Vector3<f64> {
            let of_move = |m: &Move| total_rotation_rad(&self.recordings[m.recording], m.first, m.last, &gyroscope);
            moves.iter().map(of_move).sum()
        };
        let names = parameter_names(Frame::Symmetric);
        let only_moves = |k: &usize| !open.columns.contains(k) && !of_held.contains(k);
        let through_moves = design
            .open_to_rests()?
            .columns
            .into_iter()
            .filter(only_moves)
            .map(|k| names[OBSERVED[k]].clone())
            .collect();
        let missing = (!open.columns.is_empty()).then(|| {
            let poses = scene.missing_poses();
            let turns = scene.missing_turns(measures_gravity, || missing_turns(&open_to_moves, &turned()));
            let words = open.explain(scene.up.len(), scene.moves.len(), &poses, &turns);
            [words, self.short_rests(options)].into_iter().flatten().collect::<Vec<_>>().join("; ")
        });
        Ok((Prospect { names, predicted_sigma, through_moves, missing }, Model::of(&near, &terms)?))
    }

    /// Collects the rests and moves of these recordings, and the nominal sensor models before any fit.
    fn scene(&self, options: &Options<'_>) -> Result<Scene, Error> {
        let used: Vec<bool> = self.excluded.iter().map(Option::is_none).collect();
        let (moves, unusable) = between(self.recordings, &self.rests, &used, &self.saturated);
        let accelerometer = self.nominal_accelerometer(&used, options)?;
        let seen_by = |triad: &Triad<f64>| -> Vec<Vector3<f64>> {
            self.rests.iter().map(|rest| triad.correct(rest.rest.specific_force.mean).normalize()).collect()
        };
        let mut scene = Scene {
            moves,
            unusable,
            gyroscope: None,
            up: Vec::new(),
            silent_accelerometer: None,
            silent_gyroscope: None,
            accelerometer,
            used,
        };
        let all_up = seen_by(&accelerometer.unwrap_or_else(Triad::identity));
        scene.silent_gyroscope = self.silent_gyroscope(&scene.moves, &all_up);
        if let Some(accelerometer) = accelerometer {
            scene.gyroscope = self.nominal_gyroscope(&scene.moves, &accelerometer, options);
        }
        if let Some(gyroscope) = &scene.gyroscope {
            scene.silent_accelerometer = self.silent_accelerometer(&scene.moves, &all_up, gyroscope);
        }
        scene.up = all_up.into_iter().zip(&scene.used).filter(|(_, used)| **used).map(|(up, _)| up).collect();
        Ok(scene)
    }

    /// Returns the nominal accelerometer (the sensor model before any fit). For readings in SI units, it is the
    /// identity. For readings in counts, it has the nominal scale. If this scale is not given or contradicts the
    /// readings, the nominal accelerometer has the scale and bias of the smallest sphere through the mean forces at the
    /// rests. `None` if the rests do not determine the scale.
    fn nominal_accelerometer(&self, used: &[bool], options: &Options<'_>) -> Result<Option<Triad<f64>>, Error> {
        if self.raw_is_si(|recording| recording.accel_unit) {
            return Ok(Some(Triad::identity()));
        }
        let means: Vec<Vector3<f64>> = self
            .rests
            .iter()
            .zip(used)
            .filter(|(_, used)| **used)
            .map(|(rest, _)| rest.rest.specific_force.mean)
            .collect();
        if let Some(scale) = options.accel_nominal {
            let fits = means.iter().all(|mean| (mean.norm() / scale / options.gravity_mps2 - 1.0).abs() < FAR_OFF);
            if fits {
                let nominal = Matrix3::from_diagonal_element(scale);
                return Ok(Triad::try_new(nominal, Vector3::zeros()).ok());
            }
        }
        let start = ellipsoid::smallest_sphere(&means, options.gravity_mps2)?;
        let noise = self.rests.iter().map(|rest| rest.rest.specific_force.whole_variance().max()).fold(0.0, f64::max);
        let exceeds_noise = |triad: &Triad<f64>| noise.sqrt() * triad.inverse().norm() < FAR_OFF;
        Ok(start.and_then(|start| Triad::try_new(start.sensitivity, start.bias).ok()).filter(exceeds_noise))
    }

    /// Returns the nominal gyroscope (the sensor model before any fit). Its bias is the mean rate at the rests. For
    /// readings in SI units, its sensitivity is the identity. For readings in counts, it has the nominal scale. If this
    /// scale is not given, the sensitivity is computed from the moves: the rotation that the gyroscope measures must
    /// agree with the rotation of gravity. `None` if the moves do not determine the scale.
    fn nominal_gyroscope(
        &self,
        moves: &[Move],
        accelerometer: &Triad<f64>,
        options: &Options<'_>,
    ) -> Option<Triad<f64>> {
        let bias = self.bias.bias;
        let si = self.raw_is_si(|recording| recording.gyro_unit);
        let sensitivity = options
            .gyro_nominal
            .or(si.then_some(1.0))
            .map(Matrix3::from_diagonal_element)
            .or_else(|| rate_from_gravity(self.recordings, moves, accelerometer, bias)?.rate_from_raw.try_inverse())
            .or_else(|| {
                let scale = scale_from_gravity(self.recordings, moves, accelerometer, bias)?;
                Some(Matrix3::from_diagonal_element(1.0 / scale))
            })?;
        Triad::try_new(sensitivity, bias).ok()
    }

    /// Whether the gyroscope reads only noise while the gravity directions at the rests differ.
    pub(super) fn has_silent_gyroscope(&self, moves: &[Move], accelerometer: &Triad<f64>) -> bool {
        let up = |rest: &UnitRest| accelerometer.correct(rest.rest.specific_force.mean).normalize();
        self.silent_gyroscope(moves, &self.rests.iter().map(up).collect::<Vec<_>>()).is_some()
    }

    /// Returns a message about a gyroscope that reads only noise while gravity rotates in the body frame; `None` if the
    /// gyroscope responds.
    fn silent_gyroscope(&self, moves: &[Move], up: &[Vector3<f64>]) -> Option<String> {
        let turned = |m: &&Move| up[m.from].angle(&up[m.to]) > TURNED_RAD;
        let turns: Vec<&Move> = moves.iter().filter(turned).collect();
        let reacts = |m: &&&Move| {
            let recording = &self.recordings[m.recording];
            let rates = recording.angular_rate.slice(m.first..m.last + 1);
            let noise = self.segments[m.recording].noise_density.angular_rate / m.interval_s.sqrt();
            let squares: Vector3<f64> =
                rates.iter().map(|rate| (Vector3::from(rate) - self.bias.bias).map(|v| v * v)).sum();
            (0..3).any(|axis| (squares[axis] / rates.len() as f64).sqrt() > REACTS * noise[axis])
        };
        let silent = turns.len() >= 3 && 5 * turns.iter().filter(reacts).count() < turns.len();
        silent.then(|| {
            format!(
                "the gyroscope reads no more than noise although gravity rotates in {} of them: check its power, its \
                 columns and its range; if hand tremor is as large as the rotation, rest the unit on a support",
                turns.len()
            )
        })
    }

    /// Returns a message about an accelerometer with constant readings at all rests while the gyroscope measures
    /// rotations that change the gravity direction; `None` if the accelerometer responds.
    fn silent_accelerometer(&self, moves: &[Move], up: &[Vector3<f64>], gyroscope: &Triad<f64>) -> Option<String> {
        let alike = up.iter().all(|other| up[0].angle(other) < ALIKE_RAD);
        let rotates = |m: &&Move| {
            let turn = integrate_rotation_linear(&self.recordings[m.recording], m.first, m.last, gyroscope);
            turn.tr_mul(&up[m.from]).angle(&up[m.to]) > TURNED_RAD
        };
        let turns = if alike { moves.iter().filter(rotates).count() } else { 0 };
        (turns >= 3 && 2 * turns > moves.len()).then(|| {
            format!(
                "the accelerometer readings are the same at all of them although the gyroscope measures a change of \
                 attitude in {turns} moves: check its power, its columns and its range"
            )
        })
    }
}

impl Scene {
    fn missing_poses(&self) -> String {
        match &self.silent_accelerometer {
            Some(words) => words.clone(),
            None if self.accelerometer.is_none() => too_few_poses(),
            None => {
                let poses = missing_poses(&self.up);
                // Rotations can replace missing poses only if a gyroscope measures them.
                let rotates = self.gyroscope.is_some() && self.silent_gyroscope.is_none();
                if rotates && poses.ends_with(EDGES_AND_CORNERS) { poses + OR_ROLL } else { poses }
            }
        }
    }

    fn missing_turns(&self, measures_gravity: bool, turns: impl FnOnce() -> String) -> String {
        if let Some(words) = &self.silent_gyroscope {
            return words.clone();
        }
        if self.moves.len() < MIN_MOVES {
            return too_few_moves(self.moves.len(), &self.unusable);
        }
        if !measures_gravity {
            return "gravity, from which they are determined, is not measured".into();
        }
        turns()
    }
}
