//! The verdict on a calibration: good, or poor with the reasons.

use std::fmt;

use super::Figures;
use crate::finding::general;
use crate::numerics::fit_report::FitReport;
use crate::recording::Recording;

/// chi2 per degree of freedom above which a calibration is poor: residuals are ten times what sensor noise explains, so
/// that errors other than noise dominate the result.
const POOR_CHI2_PER_DOF: f64 = 100.0;

/// A set of recordings.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RecordingSet {
    /// The recordings from which the calibration is estimated.
    Calibration,
    /// The control recordings, which are used only to evaluate the calibration.
    Control,
}

impl RecordingSet {
    /// Name of the set in messages.
    pub fn name(self) -> &'static str {
        match self {
            Self::Calibration => "calibration set",
            Self::Control => "control set",
        }
    }
}

/// Whether a calibration may be used.
#[derive(Clone, Debug, PartialEq)]
pub enum Verdict {
    /// Good: noise explains the residuals, or nearly so.
    Good,
    /// Poor for these reasons; there is at least one.
    Poor(Vec<Reason>),
}

/// Reason for a poor verdict. It is displayed as a sentence with its numbers.
#[derive(Clone, Debug, PartialEq)]
pub enum Reason {
    /// A fit that makes the estimate has not converged.
    NotConverged {
        /// Name of the fit in messages.
        fit: &'static str,
        /// Report of the fit, with the reason for its end.
        report: FitReport,
    },
    /// No move can be used, so the gyroscope is not judged.
    NoUsableMove {
        /// Set of recordings that the verdict refers to.
        set: RecordingSet,
        /// Number of usable rests.
        rests: usize,
    },
    /// chi2 has no value because some samples could not be corrected.
    NotCorrected {
        /// Set of recordings that the verdict refers to.
        set: RecordingSet,
        /// The samples without a correction, by recording; empty if they are not known.
        samples: Vec<UncorrectedSamples>,
    },
    /// Residuals are far larger than sensor noise explains.
    LargeResiduals {
        /// Set of recordings that the verdict refers to.
        set: RecordingSet,
        /// Root of chi2 per degree of freedom.
        times_noise: f64,
    },
    /// Many rests contradict the others.
    ContradictingRests {
        /// Number of rests that contradict the others.
        count: usize,
        /// Number of all rests.
        all: usize,
    },
    /// Many moves contradict the others.
    ContradictingMoves {
        /// Number of moves that contradict the others.
        count: usize,
        /// Number of all moves.
        all: usize,
    },
    /// Many rests have mean angular rates far from those of the others.
    MovingRests {
        /// Number of rests with a mean angular rate far from those of the others.
        count: usize,
        /// Number of all rests.
        all: usize,
    },
}

/// Samples of a recording that were measured and have no correction.
#[derive(Clone, Debug, PartialEq)]
pub struct UncorrectedSamples {
    /// Name of the recording.
    pub recording: String,
    /// Number of samples without a correction.
    pub count: usize,
    /// Number of samples of the recording.
    pub all: usize,
    /// Index of the first sample without a correction.
    pub first: usize,
    /// Time of this sample, s.
    pub time_s: f64,
    /// Whether the temperature of this sample is missing (not a number). Otherwise the effects are too large to be
    /// removed.
    pub is_temperature_missing: bool,
}

impl Verdict {
    /// Verdict for these reasons: poor if there is any, otherwise good.
    pub fn of(reasons: Vec<Reason>) -> Self {
        if reasons.is_empty() { Self::Good } else { Self::Poor(reasons) }
    }

    /// Name of the verdict in documents: `good` or `poor`.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Poor(_) => "poor",
        }
    }

    /// All reasons in one line; empty for a good verdict.
    pub fn words(&self) -> String {
        self.reasons().iter().map(Reason::to_string).collect::<Vec<_>>().join("; ")
    }

    /// Reasons for a poor verdict; empty for a good one.
    pub fn reasons(&self) -> &[Reason] {
        match self {
            Self::Good => &[],
            Self::Poor(reasons) => reasons,
        }
    }
}

impl Reason {
    /// Reason code: stable, lower case, for scripts.
    pub fn code(&self) -> &'static str {
        match self {
            Self::NotConverged { .. } => "not_converged",
            Self::NoUsableMove { .. } => "no_usable_move",
            Self::NotCorrected { .. } => "not_corrected",
            Self::LargeResiduals { .. } => "large_residuals",
            Self::ContradictingRests { .. } => "contradicting_rests",
            Self::ContradictingMoves { .. } => "contradicting_moves",
            Self::MovingRests { .. } => "moving_rests",
        }
    }
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let of_calibration = RecordingSet::Calibration.name();
        match self {
            Self::NotConverged { fit, report } => f.write_str(&report.reason(fit).unwrap_or_default()),
            Self::NoUsableMove { set, rests } => write!(
                f,
                "{}: {rests} usable rests and no usable move: the gyroscope is not judged, record rests in different poses \
                 with moves between them",
                set.name()
            ),
            Self::NotCorrected { set, samples } => {
                write!(f, "{}: chi2 per degree of freedom has no value, nothing is judged: ", set.name())?;
                if samples.is_empty() {
                    return f.write_str("some of its samples have no correction");
                }
                f.write_str(&samples.iter().map(UncorrectedSamples::to_string).collect::<Vec<_>>().join("; "))
            }
            Self::LargeResiduals { set, times_noise } => {
                write!(
                    f,
                    "{}: residuals are {} times what noise explains (more than {}): the linear model does not describe this \
                     unit or this motion",
                    set.name(),
                    general(*times_noise, 3),
                    general(POOR_CHI2_PER_DOF.sqrt(), 3)
                )?;
                match set {
                    RecordingSet::Calibration => Ok(()),
                    RecordingSet::Control => {
                        f.write_str(", or the calibration is another unit's, or the recording is in wrong units")
                    }
                }
            }
            Self::ContradictingRests { count, all } => write!(
                f,
                "{of_calibration}: {count} of {all} rests contradict the others: the linear model does not describe this unit \
                 or this motion"
            ),
            Self::ContradictingMoves { count, all } => write!(
                f,
                "{of_calibration}: {count} of {all} moves contradict the others: the linear model does not describe this unit \
                 or this motion"
            ),
            Self::MovingRests { count, all } => write!(
                f,
                "{of_calibration}: {count} of {all} rests are left out because their mean rates are far from those of the \
                 others: the unit was not still, its bias has jumped, as it may when power is lost, or these rests are of \
                 another unit"
            ),
        }
    }
}

impl fmt::Display for UncorrectedSamples {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { recording, count, all, first, time_s, is_temperature_missing } = self;
        let cause = if *is_temperature_missing {
            "temp_degc is not a number there: repair it, or leave the effects of temperature out"
        } else {
            "the effects are too large there to be undone: estimate them again, or leave them out"
        };
        write!(
            f,
            "no correction for {count} of {all} samples of {recording}, the first one {first} at {time_s:.2} s: {cause}"
        )
    }
}

impl Figures {
    /// Whether the calibration is poor by these figures, or is not judged at all.
    pub fn is_poor(&self) -> bool {
        self.reason(RecordingSet::Calibration, Vec::new).is_some()
    }

    /// Why these figures make a verdict poor; `None` if they do not. `uncorrected` finds the samples without a
    /// correction.
    pub fn reason(&self, set: RecordingSet, uncorrected: impl FnOnce() -> Vec<UncorrectedSamples>) -> Option<Reason> {
        if self.moves == 0 {
            return Some(Reason::NoUsableMove { set, rests: self.rests });
        }
        if !self.chi2_per_dof.is_finite() {
            return Some(Reason::NotCorrected { set, samples: uncorrected() });
        }
        let is_large = self.chi2_per_dof > POOR_CHI2_PER_DOF;
        is_large.then(|| Reason::LargeResiduals { set, times_noise: self.chi2_per_dof.sqrt() })
    }
}

/// Samples that were measured and have no correction, by recording.
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
            "no correction for 1 of 3 samples of run, the first one 1 at 0.10 s: temp_degc is not a number there: repair it, \
             or leave the effects of temperature out"
        );
    }
}
