//! The verdict on a calibration: good, incomplete or poor, with the reasons.
//!
//! [`mod@crate::calibrate`] derives a verdict from the recordings from which the calibration is estimated.
//! [`mod@crate::evaluate`] derives a verdict from control recordings.

mod group_misfit;
mod reason;

pub(crate) use group_misfit::SIGNIFICANCE;
pub use group_misfit::{GroupMisfit, ResidualGroup};
pub use reason::{Reason, UncorrectedSamples};

/// Maximum chi2 per degree of freedom. A calibration with a larger value gets the verdict `poor`, unless the
/// uncertainty of the calibration explains the residuals. At this value, the residuals are ten times as large as noise
/// explains, so errors other than noise dominate the result.
pub(crate) const POOR_CHI2_PER_DOF: f64 = 100.0;

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
    /// The result is usable without reservation. In particular, no kind of residuals exceeds its noise both
    /// significantly and by more than a factor of two.
    Good,
    /// The result is usable with a reservation. For example, the residuals are larger than noise explains, or there are
    /// too few residuals to test the result. The list contains at least one reason.
    Incomplete(Vec<Reason>),
    /// The result is not reliable. The list contains at least one reason. Reasons for the verdict `poor` come first.
    /// Reasons that alone would give the verdict `incomplete` come last.
    Poor(Vec<Reason>),
}

impl Verdict {
    /// Derives the verdict from these reasons. It is `poor` if [`Reason::is_poor`] is true for any reason, `incomplete`
    /// if there are only other reasons, and `good` if there are no reasons.
    pub fn of(reasons: Vec<Reason>) -> Self {
        let (mut poor, incomplete): (Vec<Reason>, Vec<Reason>) = reasons.into_iter().partition(Reason::is_poor);
        if poor.is_empty() {
            return if incomplete.is_empty() { Self::Good } else { Self::Incomplete(incomplete) };
        }
        poor.extend(incomplete);
        Self::Poor(poor)
    }

    /// Name of the verdict in JSON documents: `good`, `incomplete` or `poor`.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Incomplete(_) => "incomplete",
            Self::Poor(_) => "poor",
        }
    }

    /// All reasons in one line; empty for the verdict `good`.
    pub fn words(&self) -> String {
        self.reasons().iter().map(Reason::to_string).collect::<Vec<_>>().join("; ")
    }

    /// Reasons for the verdict `incomplete` or `poor`; empty for the verdict `good`.
    pub fn reasons(&self) -> &[Reason] {
        match self {
            Self::Good => &[],
            Self::Incomplete(reasons) | Self::Poor(reasons) => reasons,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gravest_reason_decides() {
        let group = GroupMisfit { group: ResidualGroup::RestNorms, rms: 0.01, chi2: 250.0, degrees_of_freedom: 10.0 };
        let lacks = Reason::above_noise(RecordingSet::Control, &[group], &[]).unwrap();
        let contradicts = Reason::ContradictingRests { count: 3, all: 9 };
        assert_eq!(Verdict::of(Vec::new()), Verdict::Good);
        assert_eq!(Verdict::of(vec![lacks.clone()]).name(), "incomplete");
        let poor = Verdict::of(vec![lacks.clone(), contradicts.clone()]);
        assert_eq!(poor, Verdict::Poor(vec![contradicts, lacks.clone()]));
        assert!(lacks.to_string().starts_with(
            "control set: residuals exceed their noise: norm of gravity at the rests 1.02 mg rms (noise 0.204 mg): the unit \
             has changed since its calibration"
        ));
    }
}
