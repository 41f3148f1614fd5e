//! Recordings that have passed the checks, and the first fits to them. Calibrations with different models start from
//! these fits.

use std::sync::OnceLock;

use imucal_core::calibration::Calibration;
use imucal_core::sensor::Triad;

use super::cross_validation::cross_validate;
use super::jointly::Selection;
use super::outcome::Outcome;
use super::several_units::several_units;
use super::unit_data::{UnitData, refuse_errors};
use super::{Kinds, ModelOptions, Options, Prepared};
use crate::calibrate::two_stages::Gyroscope;
use crate::check::check_gains;
use crate::error::Error;
use crate::finding::{Finding, Severity};
use crate::frame::Frame;
use crate::joint::{Wander, WarmStart};
use crate::recording::Recording;
use crate::rests::moves::{Move, Unusable, between};
use crate::rests::segment::Segments;
use crate::rounding::Rounding;
use crate::two_stage::accelerometer::AccelerometerFit;
use crate::verdict::Verdict;

/// Recordings of one unit that have passed the checks, with their rests, their moves, and the two-stage fit. Joint
/// fits start from the two-stage fit, or from a warm start if one is given.
///
/// If the recordings cannot be fitted together, each recording is fitted separately. These fits show whether the
/// recordings belong to several units.
///
/// A result depends only on the recordings, the options and the arguments of the call. Earlier calls have no influence.
pub struct Checked<'a> {
    recordings: Vec<Recording<'a>>,
    /// All options except the model options (effects and folds).
    options: Options<'static>,
    /// Rests, noise and findings of the recordings. The list `recordings` in this field is empty, because the field
    /// `recordings` of `Checked` contains them.
    data: UnitData<'static>,
    accelerometer: AccelerometerFit,
    moves: Vec<Move>,
    unusable: Vec<Unusable>,
    gyroscope: Gyroscope,
    /// The joint fit without effects; computed when first needed.
    plain: OnceLock<Plain>,
    /// Findings about recordings that cannot be fitted together; computed when first needed.
    units: OnceLock<Vec<Finding>>,
}

/// Result of the joint fit without effects and without a warm start: the triads of the accelerometer and of the
/// gyroscope, and the rests and moves that the fit uses.
type Plain = ([Triad<f64>; 2], Selection);

impl<'a> Checked<'a> {
    /// Tests whether a fit failed with `error` because the recordings are of several units. If so, returns an error
    /// that states this cause.
    pub(super) fn refuse_several_units(
        recordings: &[Recording<'_>],
        options: &Options<'_>,
        error: &Error,
    ) -> Result<(), Error> {
        refuse_errors(&several_units(recordings, Err(error), |recording| fit_alone(recording, options))?)
    }

    /// Checks and fits the recordings like [`Checked::try_new`], but error messages do not offer a model with fewer
    /// parameters. After a failed fit, the function does not test whether the recordings are of several units.
    pub(super) fn of_determined(recordings: &[Recording<'a>], options: &Options<'_>) -> Result<Self, Error> {
        let mut data = UnitData::try_new(recordings, options)?;
        let mut accelerometer = data.fit_accelerometer(options)?;
        let (mut moves, mut unusable) = data.moves(&accelerometer, options)?;
        let mut gyroscope = data.fit_gyroscope(&moves, &accelerometer, options)?;
        if options.is_joint() {
            let (seen, sound, triads) = (data.clone(), data.sound(), [&accelerometer.triad, &gyroscope.fit.triad]);
            data.free_of_tremor(triads[0], triads[1], &sound);
            // The estimate of the hand tremor must not use rests that the fit excludes, so it is repeated without these
            // rests.
            if data.is_held() {
                let (_, selection) = data.fit_without_outliers(&accelerometer, &gyroscope, &unusable, options, None)?;
                if selection.used != sound {
                    data = seen;
                    data.free_of_tremor(triads[0], triads[1], &selection.used);
                }
            }
            // Long rests are divided into epochs, each with its own mean. Only the joint fit uses the epochs. The
            // two-stage fit above uses one mean for each rest.
            if data.cut_into_epochs() {
                data.use_epochs(&mut accelerometer);
                (moves, unusable) = between(recordings, &data.rests, &accelerometer.used, &data.saturated);
                gyroscope.use_moves(&moves, &data.rests);
                moves.retain(|m| !m.is_within_rest(&data.rests));
            }
        }
        Ok(Self {
            recordings: recordings.to_vec(),
            options: options.without_model(),
            data: data.of(&[]),
            accelerometer,
            moves,
            unusable,
            gyroscope,
            plain: OnceLock::new(),
            units: OnceLock::new(),
        })
    }

    /// The checked recordings.
    pub fn recordings(&self) -> &[Recording<'a>] {
        &self.recordings
    }

    /// All options except the model options (effects and folds).
    pub fn options(&self) -> &Options<'static> {
        &self.options
    }

    /// Calibrates like [`calibrate`](super::calibrate()), with the given model. A warm start (parameters from which the
    /// joint fit starts) reduces the number of iterations, but does not change the result.
    ///
    /// # Errors
    /// The errors are those of [`calibrate`](super::calibrate()).
    pub fn calibrate(&self, model: &ModelOptions<'_>, warm_start: Option<&WarmStart>) -> Result<Outcome, Error> {
        let mut outcome = self.calibrate_one_unit(model, warm_start);
        let is_plain = model.effects.is_empty() && model.user_fields.is_empty();
        if self.recordings.len() > 1 && (is_plain || self.units.get().is_none()) {
            let of_effects = outcome.as_ref().is_ok_and(|outcome| outcome.verdict() == Verdict::Good);
            let units = match (is_plain, of_effects) {
                (true, _) => self.units(outcome.as_ref())?,
                (false, true) => Vec::new(),
                (false, false) => self.units(self.calibrate_one_unit(&ModelOptions::default(), None).as_ref())?,
            };
            refuse_errors(&units)?;
            if let Ok(outcome) = &mut outcome {
                outcome.findings.extend(units);
            }
        }
        outcome
    }

    /// Returns the findings about recordings that cannot be fitted together. `plain` is the result of the joint fit
    /// without effects.
    fn units(&self, plain: Result<&Outcome, &Error>) -> Result<Vec<Finding>, Error> {
        if let Some(known) = self.units.get() {
            return Ok(known.clone());
        }
        let found = several_units(&self.recordings, plain, |recording| fit_alone(recording, &self.options))?;
        Ok(self.units.get_or_init(|| found).clone())
    }

    /// Calibrates like [`calibrate`](Self::calibrate), but does not test whether the recordings are of several units.
    fn calibrate_one_unit(&self, model: &ModelOptions<'_>, warm_start: Option<&WarmStart>) -> Result<Outcome, Error> {
        let options = &self.options.with_model(model);
        options.check_model()?;
        let data = self.data();
        data.require_turns_in_place(options)?;
        let Self { accelerometer, gyroscope, unusable, .. } = self;
        let mut outcome = if options.is_joint() {
            let (joint, selection) = data
                .fit_without_outliers(accelerometer, gyroscope, unusable, options, warm_start.cloned())
                .map_err(|error| self.of_contradiction(error))?;
            let triads = self.triads();
            let misfits = data.misfits(&joint, &selection, triads, options)?;
            let unseen = |folds| data.held_out(&joint, &selection, (&self.moves, triads), options, folds);
            let held_out = options.folds.map(unseen).transpose()?;
            if !options.has_effects() && warm_start.is_none() {
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
        let gains = check_gains(&self.recordings[0], &outcome.calibration);
        self.require_fit(&gains)?;
        refuse_errors(&gains)?;
        outcome.findings.extend(gains);
        outcome.findings.extend(outcome.overestimated_noise(&self.recordings));
        Ok(outcome)
    }

    /// Returns an error if the joint fit of several recordings has failed. It has failed if it gives implausible gains
    /// (scales of the axes) although the two-stage fit from which it started has plausible gains. If the gains of both
    /// fits are implausible, the probable cause is a wrong unit of a data column, which the caller reports.
    fn require_fit(&self, gains: &[Finding]) -> Result<(), Error> {
        let is_error = |finding: &Finding| finding.severity == Severity::Error;
        let Some(wrong) = gains.iter().find(|finding| is_error(finding)) else { return Ok(()) };
        let [accelerometer, gyroscope] = self.triads().map(|triad| *triad);
        let started_from = check_gains(&self.recordings[0], &Calibration::new(accelerometer, gyroscope));
        if self.recordings.len() < 2 || started_from.iter().any(is_error) {
            return Ok(());
        }
        Err(self.of_contradiction(Error::Fit(format!("the joint fit has gains that no sensor has: {}", wrong.message))))
    }

    /// Adds a possible cause to an error of the joint fit of several recordings: one recording may differ from all
    /// other recordings.
    fn of_contradiction(&self, error: Error) -> Error {
        match error {
            Error::Fit(words) if self.recordings.len() > 1 => Error::Fit(format!(
                "the recordings contradict each other by far more than noise ({words}): calibrate each recording alone \
                 to find the recording that differs. If it is of another unit, leave it out. If the unit changed, for \
                 example with temperature, add the effect, such as gyro_bias_temperature"
            )),
            other => other,
        }
    }

    /// Prepares the input of a joint fit for a search for effects, and calls `work` with this input and the triads of
    /// both sensors. The triads, rests and moves are those of the joint fit without effects. If this fit excluded too
    /// many outliers, all rests and moves are used. The input allows both sensors to drift within a rest. It contains
    /// the temperatures `temperatures_degc` instead of the temperatures of the recordings.
    pub(crate) fn prepare<T>(
        &self,
        temperatures_degc: &[Option<Vec<f64>>],
        kinds: Kinds,
        work: impl FnOnce(&Prepared<'_>, &Triad<f64>, &Triad<f64>) -> Result<T, Error>,
    ) -> Result<T, Error> {
        let with = |(recording, column): (&Recording<'a>, _)| with_temperature(recording, column);
        let recordings: Vec<Recording<'_>> = self.recordings.iter().zip(temperatures_degc).map(with).collect();
        let data = self.data.clone().of(&recordings);
        let ([accelerometer, gyroscope], selection) = match self.plain.get() {
            Some(plain) => plain.clone(),
            None => {
                let plain = self.plain(&data)?;
                self.plain.get_or_init(|| plain).clone()
            }
        };
        let triads = [&accelerometer, &gyroscope];
        let selection = data.for_search(selection);
        let options = &self.options;
        data.prepared_for(&selection, triads, options, (kinds, true, Wander::of(options.wander)), |prepared| {
            work(prepared, triads[0], triads[1])
        })
    }

    /// Performs the joint fit without effects and without a warm start.
    fn plain(&self, data: &UnitData<'_>) -> Result<Plain, Error> {
        let Self { accelerometer, gyroscope, unusable, options, .. } = self;
        let (joint, selection) = data.fit_without_outliers(accelerometer, gyroscope, unusable, options, None)?;
        Ok(([joint.model.accelerometer, joint.model.gyroscope], selection))
    }

    /// Whether the unit is hand-held in any recording. The hand accelerates the unit during moves, so the specific
    /// force during moves differs from gravity.
    pub(crate) fn is_held(&self) -> bool {
        self.data.is_held()
    }

    /// Whether the noise of the accelerometer is far below one count of its converter. Rounding errors during the moves
    /// are then not white noise, because the force can change so slowly that several samples have the same count.
    pub(crate) fn has_coarse_accelerometer(&self) -> bool {
        let is_coarse = |segments: &Segments| segments.rounding[3..].iter().any(Rounding::is_not_white_in_moves);
        self.data.segments.iter().any(is_coarse)
    }

    fn data(&self) -> UnitData<'_> {
        self.data.clone().of(&self.recordings)
    }

    /// The triads of the two-stage fit.
    fn triads(&self) -> [&Triad<f64>; 2] {
        [&self.accelerometer.triad, &self.gyroscope.fit.triad]
    }
}

/// Performs the fit without effects to a single recording, in the symmetric frame.
fn fit_alone(recording: &Recording<'_>, options: &Options<'_>) -> Result<Outcome, Error> {
    let options = Options { frame: Frame::Symmetric, joint: true, ..options.without_model() };
    Checked::of_determined(std::slice::from_ref(recording), &options)?
        .calibrate_one_unit(&ModelOptions::default(), None)
}

/// The recording, with its temperatures replaced by `column`.
fn with_temperature<'b>(recording: &Recording<'b>, column: &'b Option<Vec<f64>>) -> Recording<'b> {
    Recording { temperature_degc: column.as_deref(), ..*recording }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rests::moves::direction_error_rad;
    use crate::simulate::{Program, RandomMoves, Unit, simulate};

    /// Cross-validates a simulated run in three folds. Each fold leaves out every third move and every third rest. The
    /// prediction errors of the omitted moves and rests are computed by a formula that needs only the fit to all data.
    /// They must agree with the errors of actual fits without these moves and rests.
    #[test]
    fn what_is_held_out_is_predicted_as_by_a_fit_without_it() {
        let program = Program::random(&RandomMoves::default(), 5).unwrap();
        let run = simulate(&program, &Unit::paper(), 100.0, 9.80665, 5).unwrap();
        let recordings = [run.recording("run")];
        let options = Options { folds: Some(3), ..Options::default() };
        let checked = Checked::try_new(&recordings, &options).unwrap();
        let found = checked.calibrate(&options.model(), None).unwrap().held_out.unwrap();
        let data = checked.data();
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
            // A rest whose standard deviations are multiplied by a hundred has practically no influence on the fit, as
            // if it were omitted.
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
