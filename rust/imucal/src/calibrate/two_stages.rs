//! The two-stage fit of a unit's recordings. The accelerometer is fitted to the rests, and then the gyroscope to the
//! moves.

use std::ops::Range;

use faer::Mat;
use imucal_core::sensor::Triad;
use nalgebra::{Matrix3, Vector3};

use crate::calibrate::Options;
use crate::calibrate::prospect::Prospect;
use crate::calibrate::unit_data::{CONTRADICTS_MOVES, MIN_MOVES, UnitData, refuse_errors, too_few_moves};
use crate::check;
use crate::error::Error;
use crate::evaluate::{MoveReport, move_report, unusable_report};
use crate::finding::Finding;
use crate::held::StageRows;
use crate::parameters::{ACCEL, GYRO_SENSITIVITY};
use crate::preintegration::kinematics::rate_from_gravity;
use crate::rests::moves::{Ends, Move, Unusable, between};
use crate::rests::rest::Rest;
use crate::rests::unit_rest::{UnitRest, ranges_of_rests};
use crate::two_stage::accelerometer::AccelerometerFit;
use crate::two_stage::ellipsoid::Start;
use crate::two_stage::gyroscope::{GyroscopeFit, PreintegratedMoves};
use crate::two_stage::{accelerometer, gyroscope, uncertainty};

/// The result of the gyroscope fit, with the moves to which it was fitted.
#[derive(Clone)]
pub(super) struct Gyroscope {
    /// The moves between consecutive rests. Rests that the accelerometer fit excluded are skipped.
    pub(super) moves: Vec<Move>,
    /// The result of the fit.
    pub(super) fit: GyroscopeFit,
    /// For each move: the directions of gravity at its two ends, and the standard deviation of the move's residual.
    pub(super) ends: Vec<Ends>,
    /// For each move: the standard deviation, rad, of the part of its residual that is not due to noise of the mean
    /// forces at the adjacent rests. This part is independent between moves. The part due to the mean forces is
    /// correlated between consecutive moves, because these moves have a rest in common.
    pub(super) random_walk_rad: Vec<f64>,
    /// Warnings about the unit of measurement and the axes of the gyroscope.
    pub(super) findings: Vec<Finding>,
}

impl UnitData<'_> {
    /// Fits the accelerometer to the rests without known faults. If poses are missing, the error message also names the
    /// moves that the gyroscope needs.
    pub(super) fn fit_accelerometer(&self, options: &Options<'_>) -> Result<AccelerometerFit, Error> {
        self.fit_rests(options).map_err(|error| self.with_all_that_is_missing(error, options))
    }

    /// Fits the accelerometer to the rests without known faults.
    pub(super) fn fit_rests(&self, options: &Options<'_>) -> Result<AccelerometerFit, Error> {
        let clean: Vec<usize> = (0..self.rests.len()).filter(|&k| self.excluded[k].is_none()).collect();
        let rests: Vec<&Rest> = clean.iter().map(|&k| &self.rests[k].rest).collect();
        let nominal = options
            .accel_nominal
            .map(|scale| Start { sensitivity: Matrix3::from_diagonal_element(scale), bias: Vector3::zeros() });
        let si = self.raw_is_si(|recording| recording.accel_unit);
        let held = self.held(options)?;
        let rows = StageRows::new(&held, ACCEL);
        let alone = accelerometer::fit(&rests, options.gravity_mps2, nominal, si, &rows);
        let has_gyroscope = self.recordings.iter().all(|recording| !recording.angular_rate.is_absent());
        let mut fit = match alone {
            Err(Error::NotEnoughMotion(words)) if has_gyroscope => {
                self.fit_accelerometer_with_moves(&rests, words, options)?
            }
            alone => alone?,
        };
        // The fit returns `used` and `gain` (negative derivatives of the parameters with respect to the errors of the
        // rests) for the rests in `clean`. Here, both are extended to all detected rests. For an excluded rest, `used`
        // is false, and the column of `gain` is zero.
        let mut used = vec![false; self.rests.len()];
        let mut gain = Mat::zeros(9, self.rests.len());
        for (column, &k) in clean.iter().enumerate() {
            used[k] = fit.used[column];
            for i in 0..9 {
                gain[(i, k)] = fit.gain[(i, column)];
            }
        }
        (fit.used, fit.gain) = (used, gain);
        Ok(fit)
    }

    /// Fits the accelerometer if the gravity directions at the rests do not determine all its parameters. An example is
    /// a box that rests only on its six faces. The rotations between the rests replace the missing directions, so rests
    /// and moves together must determine all parameters. The start values are the result of a joint fit that is
    /// linearised at sensors without misalignment (model.md (5)). A parameter that the rests do not determine keeps its
    /// start value.
    ///
    /// # Errors
    /// [`Error::NotEnoughMotion`] if the rests and moves together do not determine all parameters, or if no joint fit
    /// was requested. `of_rests` is the message about the parameters that the rests do not determine.
    fn fit_accelerometer_with_moves(
        &self,
        rests: &[&Rest],
        of_rests: String,
        options: &Options<'_>,
    ) -> Result<AccelerometerFit, Error> {
        match self.joint_information(options) {
            Ok((Prospect { missing: None, .. }, _)) if !options.is_joint() => {
                Err(Error::NotEnoughMotion(format!("{of_rests}; the joint fit determines them from the moves")))
            }
            Ok((Prospect { missing: None, .. }, model)) => {
                accelerometer::fit_near(rests, options.gravity_mps2, &model.accelerometer)
            }
            Ok((Prospect { missing: Some(words), .. }, _)) => Err(Error::NotEnoughMotion(words)),
            Err(_) => Err(Error::NotEnoughMotion(of_rests)),
        }
    }

    /// If the accelerometer fit or the gyroscope fit fails for lack of motion, its error message names only the motion
    /// that this fit needs. This function replaces this message by the message for rests and moves together, which
    /// names all motion that the calibration needs.
    fn with_all_that_is_missing(&self, error: Error, options: &Options<'_>) -> Error {
        let Error::NotEnoughMotion(_) = &error else { return error };
        match self.joint_information(options) {
            Ok((Prospect { missing: Some(words), .. }, _)) => Error::NotEnoughMotion(words),
            _ => error,
        }
    }

    /// Finds the moves between consecutive rests, and the intervals that cannot be used as moves.
    ///
    /// # Errors
    /// [`Error::NotEnoughMotion`] if there are too few moves, or if the gyroscope does not respond to them.
    pub(super) fn moves(
        &self,
        accelerometer: &AccelerometerFit,
        options: &Options<'_>,
    ) -> Result<(Vec<Move>, Vec<Unusable>), Error> {
        let (moves, unusable) = between(self.recordings, &self.rests, &accelerometer.used, &self.saturated);
        let held = self.held(options)?;
        let is_held = StageRows::new(&held, GYRO_SENSITIVITY).count() == GYRO_SENSITIVITY.len();
        if !is_held && moves.len() < MIN_MOVES || self.has_silent_gyroscope(&moves, &accelerometer.triad) {
            let words = format!(
                "{} moves do not determine the gyroscope: {}",
                moves.len(),
                too_few_moves(moves.len(), &unusable)
            );
            return Err(self.with_all_that_is_missing(Error::NotEnoughMotion(words), options));
        }
        Ok((moves, unusable))
    }

    /// Replaces the flags `used` of the accelerometer fit, one for each rest, by one flag for each epoch. An epoch is a
    /// part of a long rest with its own mean. All epochs of a long rest without known faults are used, even if the fit
    /// excluded this rest as an outlier. The accelerometer fit uses one mean for each rest. One mean does not describe
    /// a long rest, so a large residual of this mean does not show that the rest is faulty.
    pub(super) fn use_epochs(&self, accelerometer: &mut AccelerometerFit) {
        let used = &accelerometer.used;
        let of = |own: Range<usize>| {
            let is_used =
                if own.len() > 1 { self.excluded[own.start].is_none() } else { used[self.rests[own.start].whole] };
            std::iter::repeat_n(is_used, own.len())
        };
        accelerometer.used = ranges_of_rests(&self.rests).into_iter().flat_map(of).collect();
    }

    /// Returns two results for each move. The first contains the gravity directions at its ends and the standard
    /// deviation of its residual. The second is the standard deviation, rad, of the part of this residual that is not
    /// due to noise of the mean forces at the adjacent rests.
    pub(super) fn ends(
        &self,
        moves: &[Move],
        accelerometer: &AccelerometerFit,
        gyroscope: &Triad<f64>,
    ) -> (Vec<Ends>, Vec<f64>) {
        self.directions(&accelerometer.triad, gyroscope).ends_of(moves)
    }

    /// Fits the gyroscope to the moves. The fit has up to two start values of the sensitivity. One is the result of a
    /// linear fit of the rates to the rotation of gravity (model.md (10)). The other is the nominal sensitivity, if it
    /// is known.
    pub(super) fn fit_gyroscope(
        &self,
        moves: &[Move],
        accelerometer: &AccelerometerFit,
        options: &Options<'_>,
    ) -> Result<Gyroscope, Error> {
        let bias = &self.bias;
        let kinematic = rate_from_gravity(self.recordings, moves, &accelerometer.triad, bias.bias);
        let mut findings = Vec::new();
        if let Some(kinematic) = &kinematic {
            findings = check::check_kinematics(&self.recordings[0], &kinematic.rate_from_raw, kinematic.explained);
            refuse_errors(&findings)?;
        }
        let si = self.raw_is_si(|recording| recording.gyro_unit);
        let nominal = options.gyro_nominal.or(si.then_some(1.0)).map(Matrix3::from_diagonal_element);
        let starts: Vec<Matrix3<f64>> = kinematic
            .and_then(|found| found.rate_from_raw.try_inverse())
            .into_iter()
            .chain(nominal)
            .filter(well_conditioned)
            .collect();
        if starts.is_empty() {
            let words = format!(
                "{} moves do not determine the gyroscope's scale in raw counts: add moves of 90 deg or more about \
                 each axis, or pass its nominal sensitivity",
                moves.len()
            );
            return Err(self.with_all_that_is_missing(Error::NotEnoughMotion(words), options));
        }
        // The weights of the moves depend on the scale of the gyroscope. The fit is therefore performed twice: first
        // with the weights for the start value, and then with the weights for the first result.
        let (ends, _) = self.ends(moves, accelerometer, &gyroscope::triad_with(&starts[0], bias.bias)?);
        let held = self.held(options)?;
        let held = StageRows::new(&held, GYRO_SENSITIVITY);
        let preintegrated = PreintegratedMoves::new(self.recordings, moves, bias.bias, &held);
        let first = preintegrated.first_estimate(&ends, &starts)?;
        let (ends, random_walk_rad) = self.ends(moves, accelerometer, &first);
        let is_start = !accelerometer.is_determined;
        let mut fit = preintegrated.fit(&ends, &first, is_start);
        if matches!(fit, Err(Error::NotEnoughMotion(_))) && options.is_joint() && !is_start {
            // If the rests hardly determine the accelerometer, its errors may make a few moves look like outliers. If
            // the remaining moves do not determine the gyroscope, the fit is repeated with all moves. The joint fit
            // tests all moves for outliers later.
            fit = preintegrated.fit(&ends, &first, true);
        }
        let fit = fit.map_err(|error| self.with_all_that_is_missing(error, options))?;
        Ok(Gyroscope { moves: moves.to_vec(), fit, ends, random_walk_rad, findings })
    }

    /// Returns the covariance of the 21 parameters of both sensors (model.md (9)). They refer to the symmetric frame,
    /// in which the accelerometer sensitivity is a symmetric matrix.
    pub(super) fn covariance(&self, accelerometer: &AccelerometerFit, gyroscope: &Gyroscope) -> Mat<f64> {
        let rests: Vec<&Rest> = self.rests.iter().map(|rest| &rest.rest).collect();
        let Gyroscope { moves, fit, ends, random_walk_rad, .. } = gyroscope;
        uncertainty::covariance(&rests, moves, ends, accelerometer, &self.bias, fit, random_walk_rad)
    }
}

impl Gyroscope {
    /// Replaces the moves between rests by `moves`, which also contain the intervals between consecutive epochs (parts)
    /// of a long rest. A move that the fit excluded stays excluded.
    pub(super) fn use_moves(&mut self, moves: &[Move], rests: &[UnitRest]) {
        let of_fit = self.moves.iter().zip(&self.fit.used);
        let contradicts: Vec<Move> = of_fit.filter(|(_, used)| !**used).map(|(m, _)| *m).collect();
        self.fit.used = moves.iter().map(|m| !contradicts.contains(&m.between_rests(rests))).collect();
        self.moves = moves.to_vec();
    }

    /// Reports of all intervals between consecutive rests in chronological order, including those that the fit does not
    /// use.
    pub(super) fn move_reports(&self, unusable: &[Unusable]) -> Vec<MoveReport> {
        let report = |k: usize| {
            let excluded = (!self.fit.used[k]).then_some(CONTRADICTS_MOVES);
            move_report(&self.moves[k], &self.ends[k], &self.fit.preintegrated[k].rotation, excluded)
        };
        let spoilt = unusable.iter().map(|u| unusable_report(&u.span, u.reason));
        let mut reports: Vec<MoveReport> = (0..self.moves.len()).map(report).chain(spoilt).collect();
        reports.sort_by_key(|report| (report.recording, report.first));
        reports
    }

    /// Returns the residuals of the moves that the fit uses, in standard deviations of their noise.
    pub(super) fn used_residuals(&self) -> Vec<f64> {
        let of = |k: usize| {
            let z = self.ends[k].residual(&self.fit.preintegrated[k].rotation) / self.ends[k].sigma_rad;
            [z.x, z.y]
        };
        (0..self.moves.len()).filter(|&k| self.fit.used[k]).flat_map(of).collect()
    }
}

/// Whether a sensitivity matrix is so far from singular that it can be a start value of the fit.
fn well_conditioned(sensitivity: &Matrix3<f64>) -> bool {
    let size = sensitivity.norm() / 3f64.sqrt();
    size.is_finite() && sensitivity.determinant().abs() > 0.05 * size.powi(3)
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use super::*;
    use crate::calibrate::{calibrate, prospect};
    use crate::simulate::{Program, Simulation, Step, Unit, simulate};

    /// Simulates a box that is rolled over its faces by turns of 90 deg. First, it makes four turns about each of two
    /// axes while this axis is horizontal. A ninth turn makes the third axis horizontal, and four turns about the third
    /// axis follow. Only the first `turns` of these 13 turns are simulated.
    fn over_faces(turns: usize) -> Simulation {
        let turn = |motor: usize| std::array::from_fn(|k| if k == motor { FRAC_PI_2 } else { 0.0 });
        let motors = [0, 0, 0, 0, 1, 1, 1, 1, 1, 2, 2, 2, 2].into_iter().take(turns);
        let moves = motors.map(|motor| Step { turn_rad: turn(motor), move_s: 1.5, hold_s: 3.0 });
        let program = Program::try_new(std::iter::once(Step::hold(3.0)).chain(moves).collect()).unwrap();
        simulate(&program, &Unit::paper(), 100.0, 9.80665, 1).unwrap()
    }

    #[test]
    fn moves_determine_the_misalignment_that_rests_on_faces_leave_open() {
        let run = over_faces(13);
        let (recordings, options) = ([run.recording("faces")], Options::default());
        let found = prospect(&recordings, &options).unwrap();
        assert_eq!(found.missing, None);
        assert_eq!(found.through_moves, ["accel_sensitivity_xy", "accel_sensitivity_xz", "accel_sensitivity_yz"]);
        let outcome = calibrate(&recordings, &options).unwrap();
        assert!(outcome.rests.iter().all(|rest| rest.excluded.is_none()));
        for p in 0..21 {
            let ratio = outcome.covariance[p][p].sqrt() / found.predicted_sigma[p].unwrap();
            assert!((0.5..2.0).contains(&ratio), "{}: {ratio}", outcome.names[p]);
        }
        assert_eq!(outcome.accelerometer_fit.degrees_of_freedom, 14 - 6);
    }

    #[test]
    fn turns_about_two_axes_are_refused_with_the_parameters() {
        let run = over_faces(8);
        let recordings = [run.recording("faces")];
        let Err(Error::NotEnoughMotion(words)) = calibrate(&recordings, &Options::default()) else { panic!("result") };
        assert!(words.contains("do not determine the gyroscope's"), "{words}");
        assert!(prospect(&recordings, &Options::default()).unwrap().through_moves.len() < 3);
    }
}
