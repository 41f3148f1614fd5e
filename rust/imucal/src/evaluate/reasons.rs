//! Why the figures of a calibration make its verdict poor.

use super::Figures;
use crate::finding::general;
use crate::recording::Recording;

/// What messages call the recordings that judge a calibration.
pub(super) const CONTROL_SET: &str = "control set";
/// chi2 per degree of freedom from which on a calibration is poor: residuals ten times what noise explains.
const POOR_CHI2_PER_DOF: f64 = 100.0;

impl Figures {
    /// Whether the calibration is poor, or is not judged at all.
    pub fn is_poor(&self) -> bool {
        self.moves == 0 || !(self.chi2_per_dof <= POOR_CHI2_PER_DOF)
    }

    /// Why they make the verdict on a set of recordings poor; `None` if they do not. `not_corrected` says which samples
    /// have no correction.
    pub(crate) fn poor_reason(&self, set: &str, not_corrected: &str) -> Option<String> {
        if self.moves == 0 {
            return Some(format!(
                "{set}: {} usable rests and no usable move: the gyroscope is not judged, record rests in different poses with \
                 moves between them",
                self.rests
            ));
        }
        if !self.chi2_per_dof.is_finite() {
            return Some(format!(
                "{set}: chi2 per degree of freedom has no value, nothing is judged: {}",
                if not_corrected.is_empty() { "some of its samples have no correction" } else { not_corrected }
            ));
        }
        let other = match set {
            CONTROL_SET => ", or the calibration is another unit's, or the recording is in wrong units",
            _ => "",
        };
        self.is_poor().then(|| {
            format!(
                "{set}: residuals are {} times what noise explains (more than {}): the linear model does not describe this \
                 unit or this motion{other}",
                general(self.chi2_per_dof.sqrt(), 3),
                general(POOR_CHI2_PER_DOF.sqrt(), 3)
            )
        })
    }
}

/// Which samples have no correction, and why; empty if all that were measured have one.
pub(super) fn not_corrected(recordings: &[Recording<'_>], corrected: &[Recording<'_>]) -> String {
    let is_whole = |recording: &Recording<'_>, k: usize| {
        let values = [recording.angular_rate.at(k), recording.specific_force.at(k)];
        values.as_flattened().iter().all(|value| value.is_finite())
    };
    let reason = |(recorded, corrected): (&Recording<'_>, &Recording<'_>)| {
        let is_lost = |k: &usize| is_whole(recorded, *k) && !is_whole(corrected, *k);
        let lost: Vec<usize> = (0..recorded.len()).filter(is_lost).collect();
        let first = *lost.first()?;
        let why = match recorded.temperature_degc {
            Some(degc) if !degc[first].is_finite() => {
                "temp_degc is not a number there: repair it, or leave the effects of temperature out"
            }
            _ => "the effects are too large there to be undone: estimate them again, or leave them out",
        };
        Some(format!(
            "no correction for {} of {} samples of {}, the first one {first} at {:.2} s: {why}",
            lost.len(),
            recorded.len(),
            recorded.name,
            recorded.time_s[first]
        ))
    };
    recordings.iter().zip(corrected).filter_map(reason).collect::<Vec<_>>().join("; ")
}
