//! Goodness of fit of the rests and moves of control recordings, by kind of residual.

use imucal_core::sensor::Triad;
use nalgebra::{Matrix3, Vector3};

use super::RestReport;
use super::uncertainty::chi2_with;
use crate::numerics::stats::rms;
use crate::preintegration::integrate_rotation;
use crate::recording::Recording;
use crate::rests::moves::{Ends, Move};
use crate::verdict::{GroupMisfit, ResidualGroup};

/// The usable rests and moves of control recordings, with the triads by which they are judged.
pub(super) struct Judged<'a> {
    pub(super) recordings: &'a [Recording<'a>],
    pub(super) triads: [&'a Triad<f64>; 2],
    /// The rests that are used.
    pub(super) rests: Vec<&'a RestReport>,
    /// All usable moves, with the directions of gravity at their ends and their rotations.
    pub(super) moves: &'a [Move],
    pub(super) ends: &'a [Ends],
    pub(super) rotations: &'a [Matrix3<f64>],
}

impl Judged<'_> {
    /// Goodness of fit of both kinds of residuals. `changed` returns the triads after one standard deviation along each
    /// direction of the uncertainty of the calibration; it is asked only if noise alone does not explain the residuals.
    pub(super) fn groups(&self, changed: impl FnOnce() -> Vec<[Triad<f64>; 2]>) -> Vec<GroupMisfit> {
        let norms: Vec<f64> = self.rests.iter().map(|rest| rest.norm_error_mps2 / rest.norm_sigma_mps2).collect();
        let moves: Vec<f64> = self.move_residuals(self.triads, self.rotations);
        let mut groups =
            [self.group(ResidualGroup::RestNorms, &norms, &[]), self.group(ResidualGroup::MoveDirections, &moves, &[])];
        if groups.iter().any(GroupMisfit::is_significant) {
            let changed = changed();
            let change = |after: Vec<f64>, before: &[f64]| after.iter().zip(before).map(|(a, b)| a - b).collect();
            let of_norms: Vec<Vec<f64>> = changed.iter().map(|[triad, _]| self.norm_changes(triad)).collect();
            let of_moves: Vec<Vec<f64>> = changed
                .iter()
                .map(|triads| {
                    change(self.move_residuals([&triads[0], &triads[1]], &self.rotations_by(&triads[1])), &moves)
                })
                .collect();
            groups = [
                self.group(ResidualGroup::RestNorms, &norms, &of_norms),
                self.group(ResidualGroup::MoveDirections, &moves, &of_moves),
            ];
        }
        groups.into_iter().filter(|group| group.degrees_of_freedom > 0.0 && group.chi2.is_finite()).collect()
    }

    fn group(&self, group: ResidualGroup, z: &[f64], changes: &[Vec<f64>]) -> GroupMisfit {
        let rms = match group {
            ResidualGroup::RestNorms => rms(self.rests.iter().map(|rest| rest.norm_error_mps2)),
            _ => rms(self.ends.iter().zip(self.rotations).map(|(ends, rotation)| ends.residual(rotation).norm())),
        };
        GroupMisfit { group, rms, chi2: chi2_with(z, changes), degrees_of_freedom: z.len() as f64 }
    }

    /// Change of |f| at each rest, divided by its noise, if `triad` corrects the accelerometer.
    fn norm_changes(&self, triad: &Triad<f64>) -> Vec<f64> {
        let change = |rest: &&RestReport| {
            let mean = rest.mean_specific_force;
            (triad.correct(mean).norm() - self.triads[0].correct(mean).norm()) / rest.norm_sigma_mps2
        };
        self.rests.iter().map(change).collect()
    }

    /// Residuals of the moves, divided by their noise, if `triads` correct the samples and give these rotations.
    fn move_residuals(&self, [accelerometer, _]: [&Triad<f64>; 2], rotations: &[Matrix3<f64>]) -> Vec<f64> {
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

/// Size of gravity by which a change of the accelerometer's bias becomes a change of the direction of gravity, m/s^2.
/// Local gravity differs from it by less than 1 %.
const GRAVITY_MPS2: f64 = imucal_core::STANDARD_GRAVITY_MPS2;
