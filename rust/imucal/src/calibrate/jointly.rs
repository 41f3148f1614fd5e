//! The joint fit of all parameters of both sensors to a unit's recordings, with exclusion of outliers (model.md (18),
//! (25)).

use std::ops::Range;
use std::sync::OnceLock;

use imucal_core::sensor::Triad;
use nalgebra::Matrix3;

use super::unit_data::{CONTRADICTS_MOVES, MIN_MOVES, NOT_STILL, UnitData};
use super::{CrossValidation, Options};
use crate::calibrate::two_stages::Gyroscope;
use crate::error::Error;
use crate::joint::{
    self, BLOCK_S, Encoders, Item, Joint, JointFit, Kinds, Misfits, Prepared, SharedHistories, Terms, UnitWander,
    Wander, WarmStart,
};
use crate::numerics::derivative::Width;
use crate::numerics::stats::rms;
use crate::recording::Recording;
use crate::rests::moves::{Ends, Move, Unusable, between, direction_error_rad};
use crate::rests::unit_rest::ranges_of_rests;
use crate::two_stage::accelerometer::AccelerometerFit;

/// Maximum share of rests or moves that a search for effects excludes as outliers. If a larger share contradicts the
/// other rests or moves, the model is probably wrong, and the search uses all rests and moves.
const OUTLIERS: f64 = 0.1;
/// Maximum bias instability, deg/h, that is regarded as noise of the gyroscope. The bias instability is estimated from
/// the scatter of the mean rates at the rests. Consumer sensors have 5 to 60 deg/h. A larger estimate shows that the
/// bias depends on a quantity such as the temperature, and this dependence is not noise.
const MAX_INSTABILITY_DEGPH: f64 = 100.0;
/// Maximum number of joint fits in the search for outliers. Each fit excludes the outliers of the previous fit. The
/// fits end earlier if the set of outliers no longer changes.
const MAX_ROUNDS: usize = 4;

/// The rests and moves that a fit uses.
#[derive(Clone)]
pub(super) struct Selection {
    /// Whether each rest is used.
    pub(super) used: Vec<bool>,
    /// The moves that are used.
    pub(super) moves: Vec<Move>,
    /// Intervals between consecutive rests that are not used as moves, with the reason for each.
    pub(super) left_out: Vec<Unusable>,
}

impl Selection {
    /// The rests and moves that the two-stage fit uses.
    pub(super) fn of_two_stages(
        accelerometer: &AccelerometerFit,
        gyroscope: &Gyroscope,
        unusable: &[Unusable],
    ) -> Self {
        let mut selection =
            Self { used: accelerometer.used.clone(), moves: gyroscope.moves.clone(), left_out: unusable.to_vec() };
        let contradicts: Vec<Move> =
            gyroscope.moves.iter().zip(&gyroscope.fit.used).filter(|(_, used)| !**used).map(|(m, _)| *m).collect();
        selection.leave_out(&contradicts);
        selection
    }

    /// Excludes moves that contradict the other moves.
    fn leave_out(&mut self, contradicts: &[Move]) {
        self.moves.retain(|m| !contradicts.contains(m));
        self.left_out.extend(contradicts.iter().map(|m| Unusable { span: *m, reason: CONTRADICTS_MOVES }));
    }
}

impl UnitData<'_> {
    /// Returns the joint fit of both triads and the requested effects, and the rests and moves that this fit uses.
    ///
    /// The fit starts from the parameters in `warm_start` if they are given, and otherwise from the result of the
    /// two-stage fit. After each fit, all rests and moves are tested for outliers, including those excluded before. A
    /// rest or move that agrees with an improved fit is therefore used again.
    pub(super) fn fit_without_outliers(
        &self,
        accelerometer: &AccelerometerFit,
        gyroscope: &Gyroscope,
        unusable: &[Unusable],
        options: &Options<'_>,
        mut warm_start: Option<WarmStart>,
    ) -> Result<(JointFit, Selection), Error> {
        let model = [&accelerometer.triad, &gyroscope.fit.triad];
        let all = self.everything();
        let mut selection = Selection::of_two_stages(accelerometer, gyroscope, unusable);
        for _ in 1..MAX_ROUNDS {
            let fit = self.fit_jointly(&selection, model, options, warm_start.as_ref())?;
            let is_of_all = selection.used == all.used && selection.moves == all.moves;
            // `fit` was made without the rests and moves that have counted as outliers so far. These rests and moves
            // therefore do not influence the test that is applied to them here.
            let contradicts = self.prepared(&all, model, options, Wander::of(options.wander), |prepared| {
                let known = is_of_all.then_some(&fit.linear);
                joint::outliers(prepared, &self.terms(options)?, &fit.model, known)
            })?;
            let next = self.without(&all, &contradicts);
            let same = next.used == selection.used && next.moves == selection.moves;
            if same || next.moves.len() < MIN_MOVES {
                return Ok((fit, selection));
            }
            selection = next;
            warm_start = Some(WarmStart::of(&self.terms(options)?, &fit.model));
        }
        Ok((self.fit_jointly(&selection, model, options, warm_start.as_ref())?, selection))
    }

    /// All rests and moves without known faults.
    fn everything(&self) -> Selection {
        self.all_where(Option::is_none)
    }

    /// Returns the rests for which `is_kept` is true, and the moves between them. The argument of `is_kept` is the
    /// reason why a rest is excluded, or `None` for a rest without known faults.
    fn all_where(&self, is_kept: impl Fn(&Option<&'static str>) -> bool) -> Selection {
        let used: Vec<bool> = self.excluded.iter().map(is_kept).collect();
        let (moves, left_out) = between(self.recordings, &self.rests, &used, &self.saturated);
        Selection { used, moves, left_out }
    }

    /// Returns the rests and moves that a search for effects uses: those in `selection`, which contains no outliers. If
    /// the share of outliers exceeds [`OUTLIERS`], the model is probably wrong, and all rests and moves are used.
    pub(super) fn for_search(&self, selection: Selection) -> Selection {
        let rests = |selection: &Selection| selection.used.iter().filter(|used| **used).count() as f64;
        let (still, seemingly) =
            (self.everything(), self.all_where(|reason| reason.is_none_or(|reason| reason == NOT_STILL)));
        // A rest is excluded as a slow rotation if its mean rate differs from that of the other rests. If this affects
        // many rests, the probable cause is a gyroscope bias that changes, so the search also uses these rests.
        let all = if rests(&still) < (1.0 - OUTLIERS) * rests(&seemingly) { seemingly } else { still };
        let (kept, most) = (rests(&selection), rests(&all));
        let few = kept < (1.0 - OUTLIERS) * most
            || (selection.moves.len() as f64) < (1.0 - OUTLIERS) * all.moves.len() as f64;
        if few { all } else { selection }
    }

    /// Returns the selection `all` without the outliers `contradicts`. If a rest is excluded, the two moves before and
    /// after it are replaced by a single move.
    pub(super) fn without(&self, all: &Selection, contradicts: &[Item]) -> Selection {
        let mut used = all.used.clone();
        let mut bad = Vec::new();
        for item in contradicts {
            match *item {
                Item::Rest(k) => used[k] = false,
                Item::Move(k) => bad.push(all.moves[k]),
            }
        }
        let (moves, left_out) = between(self.recordings, &self.rests, &used, &self.saturated);
        // If an excluded rest is between two moves, one longer move across this rest replaces them. If one of the two
        // moves was excluded as an outlier, the longer move is also excluded.
        let within = |m: &Move, bad: &Move| m.recording == bad.recording && m.first <= bad.first && bad.last <= m.last;
        let contradicts: Vec<Move> = moves.iter().filter(|m| bad.iter().any(|bad| within(m, bad))).copied().collect();
        let mut selection = Selection { used, moves, left_out };
        selection.leave_out(&contradicts);
        selection
    }

    /// Performs the joint fit to the rests and moves in `selection`.
    pub(super) fn fit_jointly(
        &self,
        selection: &Selection,
        model: [&Triad<f64>; 2],
        options: &Options<'_>,
        warm_start: Option<&WarmStart>,
    ) -> Result<JointFit, Error> {
        let wander = options.wander.map_or(Wander::Seen, Wander::Known);
        self.prepared(selection, model, options, wander, |prepared| {
            joint::fit(prepared, &self.terms(options)?, model, warm_start)
        })
    }

    /// Computes the goodness of fit of the joint fit `fit` relative to noise (model.md (26)). `model` contains the two
    /// triads from which the fit started.
    pub(super) fn misfits(
        &self,
        fit: &JointFit,
        selection: &Selection,
        model: [&Triad<f64>; 2],
        options: &Options<'_>,
    ) -> Result<Misfits, Error> {
        let plausible = |unit: &UnitWander| {
            unit.gyroscope.bias_instability.iter().all(|radps| radps.to_degrees() * 3600.0 <= MAX_INSTABILITY_DEGPH)
        };
        let wander = options.wander.or(fit.wander.filter(plausible)).map_or(Wander::Constant, Wander::Known);
        self.prepared(selection, model, options, wander, |prepared| {
            Misfits::of(prepared, &self.terms(options)?, &fit.linear)
        })
    }

    /// Computes, for each move in `unseen` (moves that the fit did not use), the gravity directions at its ends and its
    /// rotation, with the parameters of the fit.
    pub(super) fn predict(
        &self,
        fit: &JointFit,
        unseen: &Selection,
        options: &Options<'_>,
    ) -> Result<Vec<(Ends, Matrix3<f64>)>, Error> {
        let model = [&fit.model.accelerometer, &fit.model.gyroscope];
        self.prepared(unseen, model, options, Wander::of(options.wander), |prepared| {
            joint::predict(prepared, &self.terms(options)?, &fit.model)
        })
    }

    /// Performs the cross-validation of the joint fit `fit`: computes the prediction error of each rest and each move
    /// with a fit without this rest or move. `moves` contains all usable moves, and `model` contains the two triads
    /// from which the fit started. Moves that the fit excluded as outliers are predicted with the fit itself.
    pub(super) fn held_out(
        &self,
        fit: &JointFit,
        selection: &Selection,
        (moves, model): (&[Move], [&Triad<f64>; 2]),
        options: &Options<'_>,
        folds: usize,
    ) -> Result<CrossValidation, Error> {
        let wander = fit.wander.map_or(Wander::Constant, Wander::Known);
        let found = self.prepared(selection, model, options, wander, |prepared| {
            let terms = self.terms(options)?;
            Ok(Joint::of_fit(prepared, &terms, fit)?.held_out(&fit.linear, folds))
        })?;
        let never: Vec<Move> = moves.iter().filter(|m| !selection.moves.contains(m)).copied().collect();
        // A move that the fit excluded may start or end at a rest that the fit does not use. Its prediction needs both
        // rests, so they are marked as used here.
        let mut used = selection.used.clone();
        never.iter().for_each(|m| [m.from, m.to].into_iter().for_each(|k| used[k] = true));
        let unseen = Selection { used, moves: never.clone(), left_out: Vec::new() };
        let predicted = self.predict(fit, &unseen, options)?;
        let direction_error_deg = moves.iter().map(|m| {
            let known = selection.moves.iter().position(|own| own == m);
            let angle_rad = match known.map(|k| found.direction_rad[k]) {
                Some(Some(angle_rad)) => angle_rad,
                Some(None) => {
                    return Err(Error::NotEnoughMotion(format!(
                        "without every {folds}-th move the others do not determine all parameters: record more \
                         moves, or use more folds"
                    )));
                }
                None => never.iter().position(|own| own == m).map_or(f64::NAN, |k| {
                    let (ends, rotation) = &predicted[k];
                    direction_error_rad(ends, rotation)
                }),
            };
            Ok(angle_rad.to_degrees())
        });
        let direction_error_deg = direction_error_deg.collect::<Result<Vec<f64>, Error>>()?;
        let mut norms = vec![f64::NAN; self.rests.len()];
        for (k, error) in found.norm_mps2 {
            norms[k] = error.unwrap_or(f64::NAN);
        }
        // Long rests are divided into epochs with their own means. The error of such a rest is the mean error of its
        // epochs.
        let mean = |own: Range<usize>| {
            let known = || norms[own.clone()].iter().filter(|error| error.is_finite());
            known().sum::<f64>() / known().count() as f64
        };
        let norm_error_mps2 = ranges_of_rests(&self.rests).into_iter().map(mean).collect();
        let gravity_direction_rms_deg = rms(direction_error_deg.iter().copied());
        Ok(CrossValidation { gravity_direction_rms_deg, direction_error_deg, norm_error_mps2 })
    }

    fn terms<'b>(&self, options: &'b Options<'_>) -> Result<Terms<'b>, Error> {
        let samples: Vec<usize> = self.recordings.iter().map(Recording::len).collect();
        let kinds = options.kinds();
        let mut terms = Terms::try_new(&options.effects, &options.user_fields, &samples, kinds)?;
        terms.allow_partly(&options.partly);
        Ok(terms)
    }

    fn prepared<T>(
        &self,
        selection: &Selection,
        model: [&Triad<f64>; 2],
        options: &Options<'_>,
        wander: Wander,
        work: impl FnOnce(&Prepared<'_>) -> Result<T, Error>,
    ) -> Result<T, Error> {
        let kinds = options.kinds();
        self.prepared_for(selection, model, options, (kinds, options.may_drift(), wander), work)
    }

    /// Prepares the input of a joint fit and passes it to `work`. `kinds` states whether the fit also has residuals of
    /// the specific force during moves, and of the encoder angles of a stand. `drifts` states whether sensors may drift
    /// during a rest. `wander` describes how the biases vary between rests.
    pub(super) fn prepared_for<T>(
        &self,
        selection: &Selection,
        [accelerometer, gyroscope]: [&Triad<f64>; 2],
        options: &Options<'_>,
        (kinds, drifts, wander): (Kinds, bool, Wander),
        work: impl FnOnce(&Prepared<'_>) -> Result<T, Error>,
    ) -> Result<T, Error> {
        let directions = self.directions(accelerometer, gyroscope);
        let held = self.held(options)?;
        let ends: Vec<_> = selection.moves.iter().map(|m| directions.readings(m, drifts)).collect();
        let widths: Vec<Width> = selection.moves.iter().map(|_| Width::default()).collect();
        work(&Prepared {
            recordings: self.recordings,
            rests: &self.rests,
            used: &selection.used,
            moves: &selection.moves,
            ends: &ends,
            widths: &widths,
            flicker: &OnceLock::new(),
            histories: &SharedHistories::default(),
            noise: self.noise(),
            gravity_mps2: options.gravity_mps2,
            wander,
            held: &held,
            encoders: kinds.encoders.then(|| Encoders::try_new(self.recordings, &self.rests)).transpose()?,
            max_iterations: options.max_iterations,
            block_s: BLOCK_S,
        })
    }
}
