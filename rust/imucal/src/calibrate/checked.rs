//! What several calibrations of the same recordings share.

use std::sync::{Mutex, OnceLock};

use imucal_core::sensor::Triad;

use super::cross_validation::cross_validate;
use super::jointly::Selection;
use super::outcome::Outcome;
use super::unit_data::{UnitData, refuse_errors};
use super::{Kinds, Options, Prepared};
use crate::calibrate::two_stages::Gyroscope;
use crate::check::check_gains;
use crate::error::Error;
use crate::joint::{Near, Wander};
use crate::recording::Recording;
use crate::rests::moves::{Move, Unusable};
use crate::two_stage::accelerometer::AccelerometerFit;

/// Recordings of one unit that have passed the checks, the rests and moves in them, and the fits that all others start from.
///
/// Each use takes the same recordings once more, and the same options but for effects and folds.
pub struct Checked {
    data: UnitData<'static>,
    accelerometer: AccelerometerFit,
    moves: Vec<Move>,
    unusable: Vec<Unusable>,
    gyroscope: Gyroscope,
    /// Where the joint fit without effects has ended, and what it is made of.
    plain: OnceLock<([Triad<f64>; 2], Selection)>,
    /// Set once a search finds that a hand carried the unit, whatever effects may explain; fewer effects explain no more.
    pub(crate) carried: OnceLock<()>,
    /// Where the last search ended: a calibration with the effects that it found ends near to that.
    near: Mutex<Option<Near>>,
}

impl Checked {
    /// # Errors
    /// As [`calibrate`](super::calibrate()).
    pub fn try_new(recordings: &[Recording<'_>], options: &Options<'_>) -> Result<Self, Error> {
        let mut data = UnitData::try_new(recordings, options)?;
        let accelerometer = data.fit_accelerometer(options)?;
        let (moves, unusable) = data.moves(&accelerometer, options)?;
        let gyroscope = data.fit_gyroscope(&moves, &accelerometer, options)?;
        if options.is_joint() {
            let (seen, sound, triads) = (data.clone(), data.sound(), [&accelerometer.triad, &gyroscope.fit.triad]);
            data.free_of_tremor(triads[0], triads[1], &sound);
            // What the fit leaves out was taken for how the hand holds the unit: once more without it.
            if data.is_held() {
                let (_, selection) = data.fit_without_outliers(&accelerometer, &gyroscope, &unusable, options, None)?;
                if selection.used != sound {
                    data = seen;
                    data.free_of_tremor(triads[0], triads[1], &selection.used);
                }
            }
        }
        Ok(Self {
            data: data.of(&[]),
            accelerometer,
            moves,
            unusable,
            gyroscope,
            plain: OnceLock::new(),
            carried: OnceLock::new(),
            near: Mutex::new(None),
        })
    }

    /// As [`calibrate`](super::calibrate()).
    ///
    /// # Errors
    /// As [`calibrate`](super::calibrate()).
    pub fn calibrate(&self, recordings: &[Recording<'_>], options: &Options<'_>) -> Result<Outcome, Error> {
        let data = self.data(recordings);
        data.require_turns_in_place(options)?;
        let Self { accelerometer, gyroscope, unusable, .. } = self;
        let mut outcome = if options.is_joint() {
            let (joint, selection) =
                data.fit_without_outliers(accelerometer, gyroscope, unusable, options, self.near())?;
            let triads = self.triads();
            let misfits = data.misfits(&joint, &selection, triads, options)?;
            let unseen = |folds| data.held_out(&joint, &selection, (&self.moves, triads), options, folds);
            let held_out = options.folds.map(unseen).transpose()?;
            if !options.has_effects() {
                let triads = [joint.model.accelerometer, joint.model.gyroscope];
                self.plain.get_or_init(|| (triads, selection.clone()));
            }
            let started_from = [accelerometer.report, gyroscope.fit.report];
            let findings = &gyroscope.findings;
            let outcome = Outcome::joint(data, started_from, findings, &joint, &misfits, &selection, options)?;
            Outcome { held_out, ..outcome }
        } else {
            let unseen = |folds| cross_validate(&data, accelerometer, &self.moves, options, folds);
            let held_out = options.folds.map(unseen).transpose()?;
            Outcome { held_out, ..Outcome::new(data, accelerometer, gyroscope, unusable, options)? }
        };
        let gains = check_gains(&recordings[0], &outcome.calibration);
        refuse_errors(&gains)?;
        outcome.findings.extend(gains);
        Ok(outcome)
    }

    /// The joint fit without effects and what it is made of, for a search that may let any sensor drift.
    pub(crate) fn prepare<T>(
        &self,
        recordings: &[Recording<'_>],
        options: &Options<'_>,
        kinds: Kinds,
        work: impl FnOnce(&Prepared<'_>, &Triad<f64>, &Triad<f64>) -> Result<T, Error>,
    ) -> Result<T, Error> {
        let data = self.data(recordings);
        let ([accelerometer, gyroscope], selection) = match self.plain.get() {
            Some(plain) => plain.clone(),
            None => {
                let Self { accelerometer, gyroscope, unusable, .. } = self;
                let (joint, selection) =
                    data.fit_without_outliers(accelerometer, gyroscope, unusable, options, None)?;
                ([joint.model.accelerometer, joint.model.gyroscope], selection)
            }
        };
        let triads = [&accelerometer, &gyroscope];
        let selection = data.for_search(selection);
        data.prepared_for(&selection, triads, options, (kinds, true, Wander::of(options.wander)), |prepared| {
            work(prepared, triads[0], triads[1])
        })
    }

    /// Whether a hand carried the unit through the moves of some recording, as far as is known. One that holds it at rest did.
    pub(crate) fn is_carried(&self) -> bool {
        self.carried.get().is_some() || self.data.is_held()
    }

    /// Takes where a search has ended.
    pub(crate) fn ends_near(&self, near: Near) {
        if let Ok(mut own) = self.near.lock() {
            *own = Some(near);
        }
    }

    fn near(&self) -> Option<Near> {
        self.near.lock().ok().and_then(|near| near.clone())
    }

    fn data<'a>(&self, recordings: &'a [Recording<'a>]) -> UnitData<'a> {
        self.data.clone().of(recordings)
    }

    /// Those of the two-stage fit.
    fn triads(&self) -> [&Triad<f64>; 2] {
        [&self.accelerometer.triad, &self.gyroscope.fit.triad]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rests::moves::direction_error_rad;
    use crate::simulate::{Program, RandomMoves, Unit, simulate};

    /// Every third move and rest of the paper's run, predicted by the whole fit and by fits of their own.
    #[test]
    fn what_is_held_out_is_predicted_as_by_a_fit_without_it() {
        let program = Program::random(&RandomMoves::default(), 5).unwrap();
        let run = simulate(&program, &Unit::paper(), 100.0, 9.80665, 5).unwrap();
        let recordings = [run.recording("run")];
        let options = Options { folds: Some(3), ..Options::default() };
        let checked = Checked::try_new(&recordings, &options).unwrap();
        let found = checked.calibrate(&recordings, &options).unwrap().held_out.unwrap();
        let data = checked.data(&recordings);
        let Checked { accelerometer, gyroscope, unusable, moves, .. } = &checked;
        let (_, all) = data.fit_without_outliers(accelerometer, gyroscope, unusable, &options, None).unwrap();
        assert_eq!((all.moves.len(), found.direction_error_deg.len()), (moves.len(), moves.len()));
        for fold in 0..3 {
            let is_out = |k: &usize| k % 3 == fold;
            let (unseen, seen): (Vec<usize>, Vec<usize>) = (0..moves.len()).partition(is_out);
            let of = |places: &[usize]| Selection { moves: places.iter().map(|&k| moves[k]).collect(), ..all.clone() };
            let fit = data.fit_jointly(&of(&seen), checked.triads(), &options, None).unwrap();
            for (k, (ends, rotation)) in unseen.iter().zip(data.predict(&fit, &of(&unseen), &options).unwrap()) {
                let own = direction_error_rad(&ends, &rotation).to_degrees();
                let sigma = ends.sigma_rad.to_degrees();
                assert!((found.direction_error_deg[*k] - own).abs() < 0.1 * sigma, "move {k}: {own}");
            }
            // A rest whose means are a hundred times as uncertain says nothing.
            let mut without = data.clone();
            for rest in without.rests.iter_mut().skip(fold).step_by(3) {
                rest.rest.specific_force.variance_of_mean *= 1e4;
                rest.rate_covariance *= 1e4;
            }
            let fit = without.fit_jointly(&all, checked.triads(), &options, None).unwrap();
            for k in (0..data.rests.len()).filter(is_out) {
                let own = fit.model.accelerometer.correct(data.rests[k].rest.specific_force.mean).norm() - 9.80665;
                let sigma = crate::rests::rest::sigma_norm(&data.rests[k].rest, &fit.model.accelerometer);
                assert!((found.norm_error_mps2[k] - own).abs() < 0.1 * sigma, "rest {k}: {own}");
            }
        }
    }
}
