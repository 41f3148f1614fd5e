//! What several calibrations of the same recordings share.

use std::sync::OnceLock;

use imucal_core::sensor::Triad;

use super::cross_validation::cross_validate;
use super::jointly::{self, Selection};
use super::outcome::Outcome;
use super::unit_data::{Gyroscope, UnitData, refuse_errors};
use super::{Kinds, Options, Prepared};
use crate::accelerometer::AccelerometerFit;
use crate::check::check_gains;
use crate::error::Error;
use crate::moves::{Move, Unusable};
use crate::recording::Recording;

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
            data.free_of_tremor(&accelerometer.triad, &gyroscope.fit.triad);
        }
        Ok(Self { data: data.of(&[]), accelerometer, moves, unusable, gyroscope, plain: OnceLock::new() })
    }

    /// As [`calibrate`](super::calibrate()).
    ///
    /// # Errors
    /// As [`calibrate`](super::calibrate()).
    pub fn calibrate(&self, recordings: &[Recording<'_>], options: &Options<'_>) -> Result<Outcome, Error> {
        let data = self.data(recordings);
        let Self { accelerometer, gyroscope, unusable, .. } = self;
        let outcome = if options.is_joint() {
            let (joint, selection) = data.fit_without_outliers(accelerometer, gyroscope, unusable, options)?;
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
        refuse_errors(&check_gains(&recordings[0], &outcome.calibration))?;
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
                let (joint, selection) = data.fit_without_outliers(accelerometer, gyroscope, unusable, options)?;
                ([joint.model.accelerometer, joint.model.gyroscope], selection)
            }
        };
        let triads = [&accelerometer, &gyroscope];
        let selection = data.for_search(selection);
        data.prepared_for(&selection, triads, options, (kinds, true, jointly::known(options)), |prepared| {
            work(prepared, triads[0], triads[1])
        })
    }

    fn data<'a>(&self, recordings: &'a [Recording<'a>]) -> UnitData<'a> {
        self.data.clone().of(recordings)
    }

    /// Those of the two-stage fit.
    fn triads(&self) -> [&Triad<f64>; 2] {
        [&self.accelerometer.triad, &self.gyroscope.fit.triad]
    }
}
