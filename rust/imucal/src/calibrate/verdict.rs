//! Verdict on a calibration, derived from the recordings from which the calibration was estimated.

use super::Outcome;
use super::held_estimates::{HeldEstimate, listed};
use super::unit_data::NOT_STILL;
use crate::evaluate::unknown_direction;
use crate::finding::{Finding, general};
use crate::frame::Frame;
use crate::held::{PriorCost, most_changed};
use crate::numerics::lsq::Termination;
use crate::parameters::parameter_names;
use crate::recording::Recording;
use crate::verdict::{Reason, RecordingSet, Verdict};

/// The verdict is `poor` if more than this share of the rests, or of the moves, contradicts the other rests or moves. A
/// few rests or moves may be disturbed accidentally, but a larger share shows that the model is wrong.
pub(super) const MAX_CONTRADICTING_SHARE: f64 = 0.1;
/// The verdict is `poor` if more than this share of the rests is excluded because their mean rates are far from those
/// of the other rests. A smaller share is accepted, because the rest detection may mistake a few slow rotations for
/// rests.
const MAX_MOVING_SHARE: f64 = 0.2;
/// If the p-value of chi2 is above this limit, the residuals are reported as too small for the estimated noise. With a
/// correct noise estimate, this happens in one of a million calibrations.
const OVERESTIMATED: f64 = 1.0 - 1e-6;

impl Outcome {
    /// The verdict `good`, or the verdict `incomplete` or `poor` with its reasons. Control recordings have a separate
    /// verdict, see [`evaluate`](mod@crate::evaluate).
    pub fn verdict(&self) -> Verdict {
        // The reasons are collected in the order in which messages list them.
        let mut reasons = self.fits_not_converged();
        reasons.extend(self.figures.reason(RecordingSet::Calibration, Vec::new));
        let contradicts = |excluded: &Option<&str>| excluded.is_some_and(|reason| reason.starts_with("contradicts"));
        let all = self.rests.len();
        let count = self.rests.iter().filter(|rest| contradicts(&rest.excluded)).count();
        if are_many(count, all, MAX_CONTRADICTING_SHARE) {
            reasons.push(Reason::ContradictingRests { count, all });
        }
        let count = self.moves.iter().filter(|span| contradicts(&span.excluded)).count();
        if are_many(count, self.moves.len(), MAX_CONTRADICTING_SHARE) {
            reasons.push(Reason::ContradictingMoves { count, all: self.moves.len() });
        }
        let count = self.rests.iter().filter(|rest| rest.excluded == Some(NOT_STILL)).count();
        if are_many(count, all, MAX_MOVING_SHARE) {
            reasons.push(Reason::MovingRests { count, all });
        }
        reasons.extend(self.contradicted_priors());
        reasons.extend(held_by_default(&self.held, self.prior_cost));
        reasons.extend(unknown_direction(RecordingSet::Calibration, &self.moves));
        reasons.extend(Reason::above_noise(RecordingSet::Calibration, &self.groups, &self.findings));
        Verdict::of(reasons)
    }

    /// Returns one reason for each prior that the recordings contradict. All priors that come from an earlier
    /// calibration of the accelerometer share one reason.
    fn contradicted_priors(&self) -> Vec<Reason> {
        let sigmas = |held: &HeldEstimate| held.contradiction.unwrap_or_default();
        let of = |held: &HeldEstimate| Reason::PriorContradicted {
            parameter: held.prior.name.clone(),
            prior: [held.prior.value, held.prior.sigma],
            sigmas: sigmas(held),
        };
        let contradicted = self.held.iter().filter(|held| held.is_contradicted());
        let (calibrated, given): (Vec<_>, Vec<_>) = contradicted.partition(|held| held.prior.is_of_calibration());
        let most = calibrated.iter().map(|held| sigmas(held).abs()).reduce(f64::max);
        let changed = most_changed(self.held.iter().map(|held| (&held.prior, held.estimate)));
        let of_calibration = most.zip(changed).map(|(sigmas, (parameter, _))| Reason::CalibrationContradicted {
            parameter: parameter_names(Frame::Symmetric)[parameter].clone(),
            sigmas,
        });
        of_calibration.into_iter().chain(given.into_iter().map(of)).collect()
    }

    /// Returns one reason for each fit that has not converged. If there is a joint fit, only this fit is examined,
    /// otherwise the accelerometer fit and the gyroscope fit.
    fn fits_not_converged(&self) -> Vec<Reason> {
        let two_stages = [("the accelerometer fit", self.accelerometer_fit), ("the gyroscope fit", self.gyroscope_fit)];
        let fits = self.joint_fit.map_or(two_stages.to_vec(), |joint| vec![("the joint fit", joint)]);
        let not_converged = fits.into_iter().filter(|(_, report)| report.termination != Termination::Converged);
        not_converged.map(|(fit, report)| Reason::NotConverged { fit, report }).collect()
    }

    /// Returns a warning if the residuals are significantly smaller than the estimated noise predicts. Motion at the
    /// rests was then mistaken for noise.
    pub(super) fn overestimated_noise(&self, recordings: &[Recording<'_>]) -> Option<Finding> {
        let misfit = self.misfit.filter(|misfit| misfit.p_value >= OVERESTIMATED)?;
        let ratio = (misfit.chi2 / misfit.degrees_of_freedom as f64).sqrt();
        let names: Vec<&str> = recordings.iter().map(|recording| recording.name).collect();
        Some(Finding {
            count: misfit.degrees_of_freedom,
            value: ratio,
            unit: "1",
            message: format!(
                "residuals are {} times what the noise at the rests explains: standard deviations are too large by as much, \
                 and small effects are not visible",
                general(ratio, 2)
            ),
            way_out:
                "for a hand-held unit, record at 100 Hz or more, so that hand tremor can be separated from sensor \
                 noise; for a unit on a table, make sure that nothing shakes the table"
                    .into(),
            ..Finding::warning("noise_overestimated", &names.join(" and "))
        })
    }
}

/// Returns the reason for the verdict `incomplete` if some of the held parameters (parameters with a prior) are
/// determined neither by the recordings nor by a prior that the user gave; `None` if there are no such parameters.
pub(super) fn held_by_default(held: &[HeldEstimate], cost: Option<PriorCost>) -> Option<Reason> {
    let unknown: Vec<&HeldEstimate> = held.iter().filter(|held| held.is_unknown()).collect();
    let cost = cost.filter(|_| !unknown.is_empty())?;
    Some(Reason::ParametersHeld { parameters: listed(&unknown, held), cost })
}

pub(super) fn are_many(count: usize, all: usize, share: f64) -> bool {
    count as f64 > share * all as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::unit_data::CONTRADICTS_MOVES;
    use crate::calibrate::{Options, calibrate};
    use crate::numerics::fit_report::FitReport;
    use crate::simulate::{Program, RandomMoves, Unit, simulate};

    #[test]
    fn many_contradictions_many_moving_rests_and_too_small_residuals_are_noticed() {
        let program = Program::random(&RandomMoves { moves: 20, ..RandomMoves::default() }, 1).unwrap();
        let run = simulate(&program, &Unit::paper(), 100.0, 9.80665, 1).unwrap();
        let recordings = [run.recording("run")];
        let mut outcome = calibrate(&recordings, &Options::default()).unwrap();
        assert_eq!(outcome.verdict(), Verdict::Good);
        assert_eq!(outcome.overestimated_noise(&recordings), None);

        let all = outcome.moves.len();
        outcome.moves.iter_mut().take(all / 10).for_each(|span| span.excluded = Some(CONTRADICTS_MOVES));
        assert_eq!(outcome.verdict(), Verdict::Good);
        outcome.moves.iter_mut().take(all / 10 + 1).for_each(|span| span.excluded = Some(CONTRADICTS_MOVES));
        let rests = outcome.rests.len();
        outcome.rests.iter_mut().take(rests / 2).for_each(|rest| rest.excluded = Some(NOT_STILL));
        let expected = [
            Reason::ContradictingMoves { count: all / 10 + 1, all },
            Reason::MovingRests { count: rests / 2, all: rests },
        ];
        assert_eq!(outcome.verdict().reasons(), expected);

        let report = FitReport { termination: Termination::Stalled, ..outcome.joint_fit.unwrap() };
        outcome.joint_fit = Some(report);
        assert_eq!(outcome.verdict().reasons()[0], Reason::NotConverged { fit: "the joint fit", report });
        assert!(outcome.verdict().words().starts_with("the joint fit stalled after"));

        let misfit = outcome.misfit.as_mut().unwrap();
        (misfit.p_value, misfit.chi2) = (1.0, 0.25 * misfit.degrees_of_freedom as f64);
        let warning = outcome.overestimated_noise(&recordings).unwrap();
        assert_eq!((warning.code, warning.recording.as_str(), warning.value), ("noise_overestimated", "run", 0.5));
        assert!(warning.message.starts_with("residuals are 0.5 times what the noise at the rests explains"));
    }
}
