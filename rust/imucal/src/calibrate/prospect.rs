//! What recordings can determine, and how well, before any fit (model.md (12)).
//!
//! The residuals of the joint estimate are linearised at nominal sensors: the design says which parameters stay open, and with
//! the noise of the rests what the standard deviation of each will be if the model describes the unit.

use std::sync::OnceLock;

use faer::Mat;
use imucal_core::sensor::Triad;
use nalgebra::{Matrix3, Vector3};

use super::unit_data::{FEWEST_MOVES, UnitData, too_few_moves};
use super::{Frame, Options};
use crate::error::Error;
use crate::joint::{BLOCK_S, Joint, Kinds, Line, Model, Prepared, Source, Terms, Wander};
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
    FARTHEST, LARGEST_SHIFT, MOVE_ERROR_RAD, Open, REST_ERROR_MPS2, missing_poses, missing_turns, too_few_poses,
};

/// Between rests whose directions of gravity differ by more than this, a unit has turned for certain, rad.
const TURNED_RAD: f64 = 0.35;
/// Directions of gravity that differ by less are alike, rad.
const ALIKE_RAD: f64 = 0.05;
/// Motion scatters by more than this many times the noise at rest.
const REACTS: f64 = 3.0;

/// Steps towards the truth; the second is as exact as noise.
const STEPS: usize = 3;
/// A step as large as this share of a parameter's size leads nowhere.
const FAR_OFF: f64 = 0.3;

/// What recordings can determine.
#[derive(Clone, Debug)]
pub struct Prospect {
    /// Names of the 21 parameters, symmetric frame.
    pub names: [String; 21],
    /// Standard deviation that each will have if the model describes the unit, raw units; `None` where it is not determined.
    pub predicted_sigma: [Option<f64>; 21],
    /// What is not determined, and which poses and turns would change that; `None` if all is determined.
    pub missing: Option<String>,
}

/// What recordings of one unit can determine, before any fit.
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
    data.prospect(scene, options)
}

/// Rests and moves as far as they are known before a fit.
struct Scene {
    used: Vec<bool>,
    moves: Vec<Move>,
    unusable: Vec<Unusable>,
    accelerometer: Option<Triad<f64>>,
    gyroscope: Option<Triad<f64>>,
    /// Directions of gravity at the rests that are used.
    up: Vec<Vector3<f64>>,
    /// The words for a sensor that does not react to motion.
    silent_accelerometer: Option<String>,
    silent_gyroscope: Option<String>,
}

impl UnitData<'_> {
    /// What recordings that no calibration comes of can determine.
    pub(super) fn prospect_without_result(&self, options: &Options<'_>) -> Result<Prospect, Error> {
        self.prospect(self.scene(options)?, options)
    }

    /// What these recordings can determine.
    fn prospect(&self, scene: Scene, options: &Options<'_>) -> Result<Prospect, Error> {
        let accelerometer = scene.accelerometer.unwrap_or_else(Triad::identity);
        let gyroscope = scene.gyroscope.unwrap_or_else(Triad::identity);
        let sees_gravity = scene.accelerometer.is_some() && scene.silent_accelerometer.is_none();
        let sees_turns = sees_gravity && scene.gyroscope.is_some() && scene.silent_gyroscope.is_none();
        let moves: &[Move] = if sees_turns { &scene.moves } else { &[] };

        let directions = self.directions(&accelerometer, &gyroscope);
        let ends: Vec<_> = moves.iter().map(|m| directions.readings(m, false)).collect();
        let widths: Vec<Width> = moves.iter().map(|_| Width::default()).collect();
        let prepared = Prepared {
            recordings: self.recordings,
            rests: &self.rests,
            used: &scene.used,
            moves,
            ends: &ends,
            widths: &widths,
            flicker: &OnceLock::new(),
            noise: self.noise(),
            gravity_mps2: options.gravity_mps2,
            wander: Wander::of(options.wander),
            encoders: None,
            block_s: BLOCK_S,
        };
        let samples: Vec<usize> = self.recordings.iter().map(Recording::len).collect();
        let terms = Terms::try_new(&[], &[], &samples, Kinds { in_motion: false, encoders: false })?;
        let model = Model { accelerometer, gyroscope, values: Vec::new(), stand: Vec::new() };
        let sizes = sizes(&model, options.gravity_mps2);

        let design = if sees_gravity { Design::near(&prepared, &terms, &model, &sizes)? } else { Design::default() };
        let (rows, lines) = (&design.rows, &design.lines);
        let open = design.open()?;
        let turns: Vec<&[f64; 18]> =
            rows.iter().zip(lines).filter(|(_, l)| matches!(l.source, Source::Move(_))).map(|(row, _)| row).collect();
        let open_to_turns = Open::of(&Mat::from_fn(turns.len(), 9, |i, j| turns[i][9 + j]))?.columns;

        let mut predicted_sigma = [None; BASE];
        let problem = Joint::new(&prepared, &terms, &model.parameters())?;
        let (_, whitened) = problem.whitened(&model.parameters())?;
        // What is open is held to a tenth of its size, so that the rest has a covariance.
        let held = Mat::from_fn(whitened.nrows() + 18, BASE, |i, p| match i.checked_sub(whitened.nrows()) {
            None => whitened[(i, p)],
            Some(k) if TOGETHER[k] == p => 1.0 / (FARTHEST * sizes[p]),
            Some(_) => 0.0,
        });
        let covariance = lsq::covariance(&held);
        for (p, sigma) in predicted_sigma.iter_mut().enumerate() {
            let is_open = open.columns.iter().any(|&k| TOGETHER[k] == p);
            *sigma = (!is_open).then(|| covariance[(p, p)].sqrt());
        }

        let turned = || -> Vector3<f64> {
            let of_move = |m: &Move| total_rotation_rad(&self.recordings[m.recording], m.first, m.last, &gyroscope);
            moves.iter().map(of_move).sum()
        };
        let missing = (!open.columns.is_empty()).then(|| {
            let poses = scene.missing_poses();
            let turns = scene.missing_turns(sees_gravity, || missing_turns(&open_to_turns, &turned()));
            let words = open.explain(scene.up.len(), scene.moves.len(), &poses, &turns);
            [words, self.short_rests(options)].into_iter().flatten().collect::<Vec<_>>().join("; ")
        });
        Ok(Prospect { names: parameter_names(Frame::Symmetric), predicted_sigma, missing })
    }

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

    /// The accelerometer before any fit: in SI units a perfect one, in counts one that the rests suggest.
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
        let noise = self.rests.iter().map(|rest| rest.rest.specific_force.variance_of_mean.max()).fold(0.0, f64::max);
        let exceeds_noise = |triad: &Triad<f64>| noise.sqrt() * triad.inverse().norm() < FAR_OFF;
        Ok(start.and_then(|start| Triad::try_new(start.sensitivity, start.bias).ok()).filter(exceeds_noise))
    }

    /// The gyroscope before any fit, likewise; `None` if nothing suggests a scale.
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
            .or_else(|| rate_from_gravity(self.recordings, moves, accelerometer, bias)?.try_inverse())
            .or_else(|| {
                let scale = scale_from_gravity(self.recordings, moves, accelerometer, bias)?;
                Some(Matrix3::from_diagonal_element(1.0 / scale))
            })?;
        Triad::try_new(sensitivity, bias).ok()
    }

    /// Whether the gyroscope shows no more than noise while this accelerometer sees the unit turn.
    pub(super) fn has_silent_gyroscope(&self, moves: &[Move], accelerometer: &Triad<f64>) -> bool {
        let up = |rest: &UnitRest| accelerometer.correct(rest.rest.specific_force.mean).normalize();
        self.silent_gyroscope(moves, &self.rests.iter().map(up).collect::<Vec<_>>()).is_some()
    }

    /// The words for a gyroscope that shows no more than noise while gravity turns in the body.
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
                "the gyroscope shows no more than noise while the accelerometer sees the unit turn in {} of them: check its \
                 power, its columns and its range; where a hand trembles as much as it turns, rest it on something",
                turns.len()
            )
        })
    }

    /// The words for an accelerometer that reads the same at all rests while the gyroscope sees the unit turn against it.
    fn silent_accelerometer(&self, moves: &[Move], up: &[Vector3<f64>], gyroscope: &Triad<f64>) -> Option<String> {
        let alike = up.iter().all(|other| up[0].angle(other) < ALIKE_RAD);
        let carried = |m: &&Move| {
            let turn = integrate_rotation_linear(&self.recordings[m.recording], m.first, m.last, gyroscope);
            turn.tr_mul(&up[m.from]).angle(&up[m.to]) > TURNED_RAD
        };
        let turns = if alike { moves.iter().filter(carried).count() } else { 0 };
        (turns >= 3 && 2 * turns > moves.len()).then(|| {
            format!(
                "the accelerometer reads the same at all of them while the gyroscope sees the unit turn over in {turns} \
                 moves: check its power, its columns and its range"
            )
        })
    }
}

impl Scene {
    fn missing_poses(&self) -> String {
        match &self.silent_accelerometer {
            Some(words) => words.clone(),
            None if self.accelerometer.is_none() => too_few_poses(),
            None => missing_poses(&self.up),
        }
    }

    fn missing_turns(&self, sees_gravity: bool, turns: impl FnOnce() -> String) -> String {
        if let Some(words) = &self.silent_gyroscope {
            return words.clone();
        }
        if self.moves.len() < FEWEST_MOVES {
            return too_few_moves(self.moves.len(), &self.unusable);
        }
        if !sees_gravity {
            return "gravity, which they are seen by, is not measured".into();
        }
        turns()
    }
}

/// Rows of the design: over errors of real units, for a hundredth of the size of each parameter.
#[derive(Default)]
struct Design {
    rows: Vec<[f64; 18]>,
    residuals: Vec<f64>,
    lines: Vec<Line>,
}

impl Design {
    fn at(prepared: &Prepared<'_>, terms: &Terms<'_>, parameters: &[f64], sizes: &[f64]) -> Result<Self, Error> {
        let lines = prepared.linearise(terms, parameters)?.lines;
        let error = |line: &Line| if matches!(line.source, Source::Norm(_)) { REST_ERROR_MPS2 } else { MOVE_ERROR_RAD };
        let row = |line: &Line| TOGETHER.map(|p| line.jacobian[p] * sizes[p] * LARGEST_SHIFT / error(line));
        Ok(Self {
            rows: lines.iter().map(row).collect(),
            residuals: lines.iter().map(|line| line.residual / error(line)).collect(),
            lines,
        })
    }

    /// Near the truth as far as it is determined: what is determined is solved for, what is not stays nominal. Sensors that are some
    /// per cent off would turn the open directions by as much.
    fn near(prepared: &Prepared<'_>, terms: &Terms<'_>, model: &Model, sizes: &[f64]) -> Result<Self, Error> {
        let mut parameters = model.parameters();
        let mut design = Self::at(prepared, terms, &parameters, sizes)?;
        for _ in 0..STEPS {
            let step = design.step()?;
            // A unit that far from nominal is wired wrongly or has faults: the nominal design then says more.
            if !step.iter().all(|change| (change * LARGEST_SHIFT).abs() < FAR_OFF) {
                break;
            }
            for (change, p) in step.iter().zip(TOGETHER) {
                parameters[p] += change * LARGEST_SHIFT * sizes[p];
            }
            design = Self::at(prepared, terms, &parameters, sizes)?;
        }
        Ok(design)
    }

    fn matrix(&self) -> Mat<f64> {
        Mat::from_fn(self.rows.len(), 18, |i, j| self.rows[i][j])
    }

    fn open(&self) -> Result<Open, Error> {
        Open::of(&self.matrix())
    }

    /// Least squares in the directions that are determined, in hundredths.
    fn step(&self) -> Result<[f64; 18], Error> {
        let (values, vectors) = lsq::singular(&self.matrix())?;
        let mut step = [0.0; 18];
        for k in (0..18).filter(|&k| values[k] >= 1.0) {
            let seen: f64 = self
                .rows
                .iter()
                .zip(&self.residuals)
                .map(|(row, residual)| residual * (0..18).map(|j| row[j] * vectors[(j, k)]).sum::<f64>())
                .sum();
            for (j, change) in step.iter_mut().enumerate() {
                *change -= vectors[(j, k)] * seen / values[k].powi(2);
            }
        }
        Ok(step)
    }
}

/// The parameters that rests and moves determine together: all but the gyroscope's bias.
const TOGETHER: [usize; 18] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 13, 14, 15, 16, 17, 18, 19, 20];

/// Size of each parameter: for a sensitivity the mean scale, for a bias what gravity reads or a rate of 1 rad/s.
fn sizes(model: &Model, gravity_mps2: f64) -> [f64; BASE] {
    let scale = |triad: &Triad<f64>| triad.sensitivity().norm() / 3f64.sqrt();
    let (accelerometer, gyroscope) = (scale(&model.accelerometer), scale(&model.gyroscope));
    std::array::from_fn(|p| match p {
        0..3 => accelerometer * gravity_mps2,
        3..9 => accelerometer,
        _ => gyroscope,
    })
}
