//! Goodness of fit of a calibration on control recordings. There are two kinds of residuals: the norm of the specific
//! force at each rest, and the gravity direction after each move.

use imucal_core::sensor::Triad;
use nalgebra::{Matrix3, Vector3};

use super::RestReport;
use super::uncertainty::chi2_with;
use crate::finding::Finding;
use crate::numerics::stats::{median, p_value, rms};
use crate::preintegration::integrate_rotation;
use crate::recording::Recording;
use crate::rests::moves::{Ends, Move};
use crate::verdict::{GroupMisfit, ResidualGroup};

/// The usable rests and moves of control recordings, and the sensors (triads) that are evaluated.
pub(super) struct Judged<'a> {
    pub(super) recordings: &'a [Recording<'a>],
    pub(super) triads: [&'a Triad<f64>; 2],
    /// The rests that are used.
    pub(super) rests: Vec<&'a RestReport>,
    /// All usable moves. `ends` contains the gravity directions at their ends, and `rotations` contains their
    /// rotations.
    pub(super) moves: &'a [Move],
    pub(super) ends: &'a [Ends],
    pub(super) rotations: &'a [Matrix3<f64>],
}

impl Judged<'_> {
    /// Computes the goodness of fit of both kinds of residuals (norms and directions). If one of the two p-values is
    /// below [`UNLIKELY`], noise alone does not explain the residuals. Then the goodness of fit also takes the
    /// uncertainty of the calibration into account, and only then is `changed` called. For each eigenvector of the
    /// correlation matrix of the parameters, `changed` returns the triads after a change by one standard deviation
    /// along this eigenvector.
    pub(super) fn groups(&self, changed: impl FnOnce() -> Vec<[Triad<f64>; 2]>) -> Vec<GroupMisfit> {
        let [norms, moves] = self.residuals();
        let mut groups =
            [self.group(ResidualGroup::RestNorms, &norms, &[]), self.group(ResidualGroup::MoveDirections, &moves, &[])];
        if groups.iter().any(|group| group.p_value() < UNLIKELY) {
            let changed = changed();
            let change = |after: Vec<f64>, before: &[f64]| after.iter().zip(before).map(|(a, b)| a - b).collect();
            let of_norms: Vec<Vec<f64>> = changed.iter().map(|[triad, _]| self.norm_changes(triad)).collect();
            let of_moves: Vec<Vec<f64>> = changed
                .iter()
                .map(|triads| change(self.move_residuals(&triads[0], &self.rotations_by(&triads[1])), &moves))
                .collect();
            groups = [
                self.group(ResidualGroup::RestNorms, &norms, &of_norms),
                self.group(ResidualGroup::MoveDirections, &moves, &of_moves),
            ];
        }
        groups.into_iter().filter(|group| group.degrees_of_freedom > 0.0 && group.chi2.is_finite()).collect()
    }

    /// Residuals of the norms of the specific force at the rests, and two direction residuals of each move. All are
    /// divided by their standard deviations due to noise.
    fn residuals(&self) -> [Vec<f64>; 2] {
        let norm = |rest: &&RestReport| rest.norm_error_mps2 / rest.norm_sigma_mps2;
        [self.rests.iter().map(norm).collect(), self.move_residuals(self.triads[0], self.rotations)]
    }

    /// Computes chi2 per degree of freedom of the norm and direction residuals without outliers. This chi2 compares the
    /// residuals with noise alone, and does not include the uncertainty of the calibration.
    pub(super) fn kept_chi2_per_dof(&self) -> f64 {
        let [norms, moves] = self.residuals();
        let squares = |z: &[f64], size: usize| -> Vec<f64> {
            without_outliers(z, size).iter().flat_map(|&k| &z[size * k..size * (k + 1)]).map(|z| z * z).collect()
        };
        let kept = [squares(&norms, 1), squares(&moves, 2)].concat();
        kept.iter().sum::<f64>() / kept.len() as f64
    }

    /// Returns a warning if rests or moves are outliers. The goodness of fit ([`Self::groups`]) does not include them,
    /// but the figures of merit do.
    pub(super) fn outliers(&self) -> Option<Finding> {
        let [norms, moves] = self.residuals();
        let outside = |z: &[f64], size: usize| -> Vec<usize> {
            let kept = without_outliers(z, size);
            (0..z.len() / size).filter(|k| !kept.contains(k)).collect()
        };
        let (rests, moves) = (outside(&norms, 1), outside(&moves, 2));
        let starts = rests.iter().map(|&k| (self.rests[k].recording, self.rests[k].first));
        let (recording, first) =
            starts.chain(moves.iter().map(|&k| (self.moves[k].recording, self.moves[k].first))).min()?;
        let recording = &self.recordings[recording];
        Some(Finding {
            count: rests.len() + moves.len(),
            value: (rests.len() + moves.len()) as f64,
            unit: "rests and moves",
            message: format!(
                "{} of {} rests and {} of {} moves contradict the others and do not count in the verdict; the first one \
                 begins at {:.2} s",
                rests.len(),
                self.rests.len(),
                moves.len(),
                self.moves.len(),
                recording.time_s[first]
            ),
            way_out:
                "look at them: the unit may have been touched, or its biases may have changed, as just after power-on"
                    .into(),
            ..Finding::warning("control_outliers", recording.name)
        })
    }

    fn group(&self, group: ResidualGroup, z: &[f64], changes: &[Vec<f64>]) -> GroupMisfit {
        // Number of residuals of one rest or of one move.
        let size = if group == ResidualGroup::RestNorms { 1 } else { 2 };
        let errors: Vec<f64> = match group {
            ResidualGroup::RestNorms => self.rests.iter().map(|rest| rest.norm_error_mps2).collect(),
            _ => {
                let moves = self.ends.iter().zip(self.rotations);
                moves.map(|(ends, rotation)| ends.residual(rotation).norm()).collect()
            }
        };
        let kept = without_outliers(z, size);
        let of_kept = |values: &[f64]| -> Vec<f64> {
            kept.iter().flat_map(|&k| values[size * k..size * (k + 1)].iter().copied()).collect()
        };
        let changes: Vec<Vec<f64>> = changes.iter().map(|change| of_kept(change)).collect();
        GroupMisfit {
            group,
            rms: rms(kept.iter().map(|&k| errors[k])),
            chi2: chi2_with(&of_kept(z), &changes),
            degrees_of_freedom: (size * kept.len()) as f64,
        }
    }

    /// Computes, for each rest, the change of the norm of the specific force if the accelerometer is `triad` instead of
    /// the accelerometer of the calibration. The change is divided by the standard deviation of the norm due to noise.
    pub(super) fn norm_changes(&self, triad: &Triad<f64>) -> Vec<f64> {
        let change = |rest: &&RestReport| {
            let mean = rest.mean_specific_force;
            (triad.correct(mean).norm() - self.triads[0].correct(mean).norm()) / rest.norm_sigma_mps2
        };
        self.rests.iter().map(change).collect()
    }

    /// Computes the direction residuals of the moves, divided by their standard deviations due to noise, with the
    /// accelerometer `accelerometer` and the rotations `rotations`, which may differ from those of the calibration.
    pub(super) fn move_residuals(&self, accelerometer: &Triad<f64>, rotations: &[Matrix3<f64>]) -> Vec<f64> {
        let again = |up: &Vector3<f64>| {
            let measured = self.triads[0].sensitivity() * up * GRAVITY_MPS2 + self.triads[0].bias();
            accelerometer.correct(measured).normalize()
        };
        let of = |(ends, rotation): (&Ends, &Matrix3<f64>)| {
            let difference = rotation.tr_mul(&again(&ends.before)) - again(&ends.after);
            <[f64; 2]>::from(ends.across() * difference / ends.sigma_rad)
        };
        self.ends.iter().zip(rotations).flat_map(of).collect()
    }

    fn rotations_by(&self, gyroscope: &Triad<f64>) -> Vec<Matrix3<f64>> {
        let rotation = |m: &Move| integrate_rotation(&self.recordings[m.recording], m.first, m.last, gyroscope);
        self.moves.iter().map(rotation).collect()
    }
}

/// Returns the indices of the rests or moves that are not outliers. `z` contains `size` residuals of each rest or move.
/// As in a calibration, a few disturbed rests or moves are excluded, for example rests that were detected in a slow
/// part of a move.
fn without_outliers(z: &[f64], size: usize) -> Vec<usize> {
    let chi2: Vec<f64> = z.chunks_exact(size).map(|own| own.iter().map(|z| z * z).sum()).collect();
    // For noise, the median of chi2 is 0.455 with one residual and 1.386 with two. `scale` is the ratio of the measured
    // median to this value. If all rests or moves scatter equally, but more than noise, dividing chi2 by `scale`
    // prevents their exclusion.
    let expected = if size == 1 { 0.455 } else { 1.386 };
    let scale = (median(&mut chi2.clone()) / expected).max(1.0);
    let mut order: Vec<usize> = (0..chi2.len()).collect();
    order.sort_by(|&a, &b| chi2[b].total_cmp(&chi2[a]));
    let most = (MAX_OUTLIER_SHARE * chi2.len() as f64) as usize;
    let is_outlier = |k: &&usize| p_value(chi2[**k] / scale, size) < OUTLIER_SIGNIFICANCE;
    let outliers: Vec<usize> = order.iter().take(most).take_while(is_outlier).copied().collect();
    (0..chi2.len()).filter(|k| !outliers.contains(k)).collect()
}

/// If the p-value of the residuals is above this limit, noise explains them. Otherwise, the uncertainty of the
/// calibration is also taken into account.
const UNLIKELY: f64 = 0.1;
/// Maximum share of rests, or of moves, that are excluded as outliers. It equals `MAX_CONTRADICTING_SHARE`, the share
/// above which the verdict on a calibration is `poor`.
const MAX_OUTLIER_SHARE: f64 = 0.1;
/// A rest or move is an outlier if its p-value is below this limit. The limit equals the significance level of the
/// outlier detection in a joint fit.
const OUTLIER_SIGNIFICANCE: f64 = 1e-5;
/// Magnitude of gravity, m/s^2. It is used to compute how a change of the accelerometer changes the gravity direction.
/// Local gravity differs from it by less than 1 %.
const GRAVITY_MPS2: f64 = imucal_core::STANDARD_GRAVITY_MPS2;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_few_outliers_are_left_out_and_a_uniform_scatter_is_not() {
        let mut z = vec![1.0; 40];
        z[7] = 30.0;
        assert_eq!(without_outliers(&z, 2), (0..20).filter(|k| *k != 3).collect::<Vec<_>>());
        assert_eq!(without_outliers(&[30.0; 40], 2).len(), 20);
        z[11..21].fill(30.0);
        assert_eq!(without_outliers(&z, 2).len(), 18);
    }
}
