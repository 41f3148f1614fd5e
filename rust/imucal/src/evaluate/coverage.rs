//! Tests whether control recordings would show errors of the calibration.

use imucal_core::STANDARD_GRAVITY_MPS2;
use imucal_core::sensor::Triad;
use nalgebra::{DMatrix, Matrix2x3, Matrix3, Vector3};

use super::group_misfits::Judged;
use crate::preintegration::preintegrate;
use crate::recording::Recording;

/// Relative error of the scale of an axis that control recordings must be able to show. It is larger than the scale
/// errors of most uncalibrated sensors. A single move about the axis is sufficient to show so large an error.
const TESTED_SCALE: f64 = 0.05;
/// Error of the bias of an accelerometer axis that control recordings must be able to show, m/s^2. At a rest with this
/// axis vertical, this bias error changes the measured force as much as the scale error [`TESTED_SCALE`] does.
const TESTED_BIAS_MPS2: f64 = TESTED_SCALE * STANDARD_GRAVITY_MPS2;
/// An error of the calibration changes the residuals. It is visible if the norm of the vector of these changes is
/// larger than this value. Each change is divided by the standard deviation of its residual due to noise.
const VISIBLE: f64 = 5.0;
/// An axis takes part in a linear combination of errors if the squared coefficients of the errors of this axis add up
/// to at least this value. The squared coefficients of all errors add up to one.
const LEAST_SHARE: f64 = 0.1;

impl Judged<'_> {
    /// Finds the axes of the accelerometer and of the gyroscope that the residuals do not test. These axes take part in
    /// an error of the calibration, or in a linear combination of such errors, that would change the residuals by less
    /// than [`VISIBLE`]. The errors are:
    ///
    /// * scales and biases of the accelerometer: a scale error and a bias error of an axis may compensate each other
    ///   unless the axis points up at one rest and down at another,
    /// * scales of the gyroscope,
    /// * the response of all gyroscope axes to rotation about one direction. Without rotation about this direction, the
    ///   response may be arbitrarily wrong.
    pub(super) fn untested_axes(&self) -> [Vec<usize>; 2] {
        [self.untested_forces(), self.untested_rotations()]
    }

    fn untested_forces(&self) -> Vec<usize> {
        let accelerometer = self.triads[0];
        let before = self.move_residuals(accelerometer, self.rotations);
        let of = |error: usize| {
            let changed = with_error(accelerometer, error)?;
            let after = self.move_residuals(&changed, self.rotations);
            let mut changes = self.norm_changes(&changed);
            changes.extend(after.iter().zip(&before).map(|(after, before)| after - before));
            Some(changes)
        };
        (0..6).map(of).collect::<Option<Vec<_>>>().map_or_else(|| vec![0, 1, 2], |changes| axes_of_invisible(&changes))
    }

    fn untested_rotations(&self) -> Vec<usize> {
        // `changes` contains a matrix for each move and each axis j. The entry in row r and column a is the change of
        // direction residual r of the move if the response of gyroscope axis a to rotation about axis j has the error
        // `TESTED_SCALE`.
        let changes: Vec<[Matrix2x3<f64>; 3]> = self
            .moves
            .iter()
            .zip(self.ends)
            .map(|(m, ends)| {
                let Recording { time_s, angular_rate, .. } = self.recordings[m.recording];
                let (rotation, sums) = preintegrate(time_s, angular_rate, m.first, m.last, self.triads[1]);
                let turned = ends.across() * rotation.transpose() * ends.before.cross_matrix();
                sums.sensitivity.map(|sum| turned * sum * (TESTED_SCALE / ends.sigma_rad))
            })
            .collect();
        let scales = [0, 1, 2].map(|j| changes.iter().flat_map(|own| [own[j][(0, j)], own[j][(1, j)]]).collect());
        let directions = [0, 1, 2].map(|j| changes.iter().flat_map(|own| own[j].iter().copied()).collect());
        let mut axes = axes_of_invisible(&scales);
        axes.extend(axes_of_invisible(&directions));
        axes.sort_unstable();
        axes.dedup();
        axes
    }
}

/// Returns the accelerometer with an error of one axis. The values 0 to 2 of `error` select the scale error of axis x,
/// y or z, and the values 3 to 5 select the bias error of axis x, y or z.
fn with_error(triad: &Triad<f64>, error: usize) -> Option<Triad<f64>> {
    let (mut scale, mut bias) = (Vector3::repeat(1.0), Vector3::zeros());
    match error {
        0..3 => scale[error] += TESTED_SCALE,
        _ => bias[error % 3] = TESTED_BIAS_MPS2,
    }
    let sensitivity = triad.sensitivity() * Matrix3::from_diagonal(&scale);
    Triad::try_new(sensitivity, triad.bias() + triad.sensitivity() * bias).ok()
}

/// Axes that take part in the linear combinations of errors that change the residuals by less than [`VISIBLE`].
/// `changes` contains, for each error, the changes of all residuals. The squared coefficients of a combination add up
/// to one. Error k belongs to axis k modulo 3.
fn axes_of_invisible(changes: &[Vec<f64>]) -> Vec<usize> {
    let dot = |a: usize, b: usize| changes[a].iter().zip(&changes[b]).map(|(a, b)| a * b).sum::<f64>();
    let normal = DMatrix::from_fn(changes.len(), changes.len(), dot);
    if normal.iter().any(|number| !number.is_finite()) {
        return vec![0, 1, 2];
    }
    let eigen = normal.symmetric_eigen();
    let invisible: Vec<usize> = (0..changes.len()).filter(|&k| eigen.eigenvalues[k] <= VISIBLE * VISIBLE).collect();
    let share = |axis: usize, k: usize| {
        (axis..changes.len()).step_by(3).map(|error| eigen.eigenvectors[(error, k)].powi(2)).sum::<f64>()
    };
    (0..3).filter(|&axis| invisible.iter().any(|&k| share(axis, k) >= LEAST_SHARE)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_that_compensate_each_other_are_invisible() {
        // The first residual shows the sum of the first two errors, and the second residual shows the third error.
        let changes = [vec![10.0, 0.0], vec![10.0, 0.0], vec![0.0, 10.0]];
        assert_eq!(axes_of_invisible(&changes), [0, 1]);
        // A third residual shows the difference of the first two errors. For the linear combination with the
        // coefficients 1 / sqrt(2) and -1 / sqrt(2), this residual changes by 10.2 / sqrt(2) = 7.2, which is above
        // `VISIBLE`.
        let seen = [vec![10.0, 0.0, 5.1], vec![10.0, 0.0, -5.1], vec![0.0, 10.0, 0.0]];
        assert!(axes_of_invisible(&seen).is_empty());
        let faint = [vec![10.0, 0.0, 3.4], vec![10.0, 0.0, -3.4], vec![0.0, 10.0, 0.0]];
        assert_eq!(axes_of_invisible(&faint), [0, 1]);
        assert_eq!(axes_of_invisible(&[vec![f64::NAN], vec![1.0], vec![1.0]]), [0, 1, 2]);
    }
}
