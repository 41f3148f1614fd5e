//! Derives the reasons for the verdict `incomplete` or `poor` from the evaluation of a calibration.

use imucal_core::sensor::Triad;

use super::{Figures, MoveReport};
use crate::numerics::stats::{median, quantile};
use crate::recording::Recording;
use crate::verdict::{GroupMisfit, POOR_CHI2_PER_DOF, Reason, RecordingSet, UncorrectedSamples};

/// A gyroscope is judged only if noise causes at most this standard deviation of the gravity direction after a move,
/// deg (median over the moves). With a larger value, noise would hide relevant errors of scale and alignment. With
/// consumer sensors, this standard deviation is about 0.1 deg.
const MAX_DIRECTION_SIGMA_DEG: f64 = 5.0;
/// Largest plausible rate, deg/s. A calibration that gives higher corrected rates must have wrong units. The limit is
/// the range of the fastest MEMS gyroscopes on the market (ADXRS649).
const FASTEST_DEGPS: f64 = 20_000.0;
/// At most this share of the samples may be above [`FASTEST_DEGPS`]. The share is not zero, because single wrong
/// samples are no evidence against a calibration.
const MAX_FAST_SHARE: f64 = 1e-3;
/// An accelerometer without a gyroscope is judged only from at least this number of usable rests. If there are both
/// sensors, a single move is sufficient, because it connects two rests.
const MIN_RESTS: usize = 2;
/// The calibration makes the unit worse if the rms residual with the calibration exceeds this multiple of the rms
/// residual without it. At smaller ratios, the calibrated and the uncalibrated unit have errors of about equal size. An
/// example is a unit that the manufacturer has already calibrated.
const WORSE: f64 = 1.1;

impl Figures {
    /// Whether these figures of merit make the verdict `poor`: there are no moves, or chi2 is large or not finite.
    pub fn is_poor(&self) -> bool {
        self.reason(RecordingSet::Calibration, Vec::new).is_some()
    }

    /// Returns the reason why these figures of merit make a verdict `poor`; `None` if they do not. `uncorrected`
    /// returns the samples that could not be corrected. The message lists these samples if chi2 is not finite.
    pub fn reason(&self, set: RecordingSet, uncorrected: impl FnOnce() -> Vec<UncorrectedSamples>) -> Option<Reason> {
        if self.moves == 0 {
            return Some(Reason::NoUsableMove { set, rests: self.rests });
        }
        self.reason_of_residuals(set, uncorrected)
    }

    /// As [`Self::reason`], for control recordings. The verdict is `incomplete` instead of `poor` if three conditions
    /// hold. First, the residuals are large compared with noise alone, even without outliers (`kept_chi2_per_dof`).
    /// Second, noise and the uncertainty of the calibration together explain the residuals (`groups`). Third, the rms
    /// direction error is at most [`MAX_DIRECTION_SIGMA_DEG`].
    pub(super) fn reason_beside(
        &self,
        kept_chi2_per_dof: f64,
        groups: &[GroupMisfit],
        uncorrected: impl FnOnce() -> Vec<UncorrectedSamples>,
    ) -> Option<Reason> {
        let is_explained = kept_chi2_per_dof > POOR_CHI2_PER_DOF
            && !groups.is_empty()
            && !groups.iter().any(GroupMisfit::exceeds_noise)
            && self.gravity_direction_rms_deg <= MAX_DIRECTION_SIGMA_DEG;
        match self.reason(RecordingSet::Control, uncorrected)? {
            Reason::LargeResiduals { set, times_noise } if is_explained => {
                Some(Reason::CalibrationUncertain { set, times_noise })
            }
            reason => Some(reason),
        }
    }

    /// Returns the reason why these figures of merit of an accelerometer without a gyroscope make a verdict `poor`;
    /// `None` if they do not. No moves are needed.
    pub fn reason_of_accelerometer(&self, set: RecordingSet) -> Option<Reason> {
        if self.rests < MIN_RESTS {
            return Some(Reason::TooFewRests { set, rests: self.rests });
        }
        self.reason_of_residuals(set, Vec::new)
    }

    fn reason_of_residuals(
        &self,
        set: RecordingSet,
        uncorrected: impl FnOnce() -> Vec<UncorrectedSamples>,
    ) -> Option<Reason> {
        if !self.chi2_per_dof.is_finite() {
            return Some(Reason::NotCorrected { set, samples: uncorrected() });
        }
        let is_large = self.chi2_per_dof > POOR_CHI2_PER_DOF;
        is_large.then(|| Reason::LargeResiduals { set, times_noise: self.chi2_per_dof.sqrt() })
    }
}

/// Returns the reason for the verdict `poor` if noise hides the gravity direction after most moves; `None` otherwise.
pub(crate) fn unknown_direction(set: RecordingSet, moves: &[MoveReport]) -> Option<Reason> {
    let used = moves.iter().filter(|m| m.excluded.is_none()).map(|m| m.direction_sigma_deg);
    let sigma_deg = median(&mut used.collect::<Vec<f64>>());
    let limit_deg = MAX_DIRECTION_SIGMA_DEG;
    (sigma_deg > limit_deg).then_some(Reason::UnknownDirection { set, sigma_deg, limit_deg })
}

/// Returns a reason for each recording whose rates, corrected by `gyroscope`, are larger than any sensor can measure.
pub(super) fn impossible_rates(recordings: &[Recording<'_>], gyroscope: &Triad<f64>) -> Vec<Reason> {
    let of_recording = |recording: &Recording<'_>| {
        let rates = (0..recording.len()).map(|k| gyroscope.correct(recording.angular_rate.at(k).into()).norm());
        let mut rates: Vec<f64> = rates.filter(|rate| rate.is_finite()).collect();
        let rate_degps = quantile(&mut rates, 1.0 - MAX_FAST_SHARE).to_degrees();
        let (recording, limit_degps) = (recording.name.to_owned(), FASTEST_DEGPS);
        (rate_degps > FASTEST_DEGPS).then_some(Reason::ImpossibleRates { recording, rate_degps, limit_degps })
    };
    recordings.iter().filter_map(of_recording).collect()
}

/// Returns one reason for each kind of residual that the calibration makes worse. These are the kinds whose calibrated
/// residuals exceed their noise significantly and have an rms of more than [`WORSE`] x the uncalibrated rms.
pub(super) fn worse(after: &[GroupMisfit], before: &[GroupMisfit]) -> Vec<Reason> {
    let reason = |after: &GroupMisfit| {
        let before = before.iter().find(|before| before.group == after.group)?;
        let is_worse = after.is_significant() && after.rms > WORSE * before.rms;
        let set = RecordingSet::Control;
        is_worse.then_some(Reason::WorseThanUncalibrated { set, after: *after, before: *before })
    };
    after.iter().filter_map(reason).collect()
}

/// Finds, for each recording, the samples that were measured but could not be corrected.
pub(super) fn uncorrected_samples(
    recordings: &[Recording<'_>],
    corrected: &[Recording<'_>],
) -> Vec<UncorrectedSamples> {
    let is_known = |recording: &Recording<'_>, sample: usize| {
        let values = [recording.angular_rate.at(sample), recording.specific_force.at(sample)];
        values.as_flattened().iter().all(|value| value.is_finite())
    };
    let of_recording = |(recorded, corrected): (&Recording<'_>, &Recording<'_>)| {
        let is_lost = |sample: &usize| is_known(recorded, *sample) && !is_known(corrected, *sample);
        let mut lost = (0..recorded.len()).filter(is_lost);
        let first = lost.next()?;
        Some(UncorrectedSamples {
            recording: recorded.name.into(),
            count: 1 + lost.count(),
            all: recorded.len(),
            first,
            time_s: recorded.time_s[first],
            is_temperature_missing: recorded.temperature_degc.is_some_and(|degc| !degc[first].is_finite()),
        })
    };
    recordings.iter().zip(corrected).filter_map(of_recording).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::verdict::Verdict;

    fn figures(chi2_per_dof: f64, moves: usize) -> Figures {
        Figures { chi2_per_dof, gravity_norm_rms_mps2: 0.01, gravity_direction_rms_deg: 0.1, rests: 12, moves }
    }

    #[test]
    fn figures_are_poor_without_moves_without_a_value_and_with_large_residuals() {
        let none = || Vec::new();
        assert_eq!(figures(99.0, 11).reason(RecordingSet::Control, none), None);
        let reason = |chi2, moves| figures(chi2, moves).reason(RecordingSet::Control, none).unwrap();
        assert_eq!(reason(1.0, 0), Reason::NoUsableMove { set: RecordingSet::Control, rests: 12 });
        assert_eq!(reason(f64::NAN, 3).code(), "not_corrected");
        let large = reason(400.0, 3);
        assert_eq!(large, Reason::LargeResiduals { set: RecordingSet::Control, times_noise: 20.0 });
        assert_eq!(
            large.to_string(),
            "control set: residuals are 20 times what noise explains (more than 10): the linear model does not describe this \
             unit or this motion, or the calibration is another unit's, or the recording is in wrong units"
        );
        assert_eq!(Verdict::of(vec![large]).name(), "poor");
    }

    #[test]
    fn samples_that_lost_their_correction_are_counted() {
        let (time_s, rate) = ([0.0, 0.1, 0.2], [[0.0; 3]; 3]);
        let degc = [20.0, f64::NAN, 20.0];
        let force = [[0.0, 0.0, 9.8], [0.0, 0.0, 9.8], [f64::NAN, 0.0, 9.8]];
        let recorded =
            Recording { temperature_degc: Some(&degc), ..Recording::try_new("run", &time_s, &force, &rate).unwrap() };
        let lost = [[0.0, 0.0, 9.8], [f64::NAN; 3], [f64::NAN; 3]];
        let corrected = Recording::try_new("run", &time_s, &lost, &rate).unwrap();
        let found = uncorrected_samples(&[recorded], &[corrected]);
        assert_eq!(
            found[0].to_string(),
            "no correction for 1 of 3 samples of run, the first is sample 1 at 0.10 s: temp_degc is not a number there: \
             repair it, or leave the effects of temperature out"
        );
    }
}
