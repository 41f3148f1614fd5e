//! Cross-validation: computes the prediction errors at rests and moves that a fit does not use.

use super::Options;
use super::unit_data::UnitData;
use crate::error::Error;
use crate::numerics::stats::rms;
use crate::preintegration::integrate_rotation_linear;
use crate::rests::moves::{Move, direction_error_rad};
use crate::two_stage::accelerometer::AccelerometerFit;

/// Prediction errors of a cross-validation (`folds` of [`Options`]). Each rest and each move is predicted by a fit that
/// does not use it.
#[derive(Clone, Debug)]
pub struct CrossValidation {
    /// Angle between propagated and measured gravity, rms over all moves, deg. The angle of each move is computed with
    /// a fit that does not use this move.
    pub gravity_direction_rms_deg: f64,
    /// Angle between propagated and measured gravity for each move, computed with a fit without this move, deg.
    pub direction_error_deg: Vec<f64>,
    /// For each rest, the norm |f| of the specific force minus local gravity, m/s^2, computed with a joint fit without
    /// this rest. It is NaN for the two-stage fit, for rests that are not used, and if the fit without the rest does
    /// not determine all parameters.
    pub norm_error_mps2: Vec<f64>,
}

impl CrossValidation {
    /// Root mean square of those entries of `norm_error_mps2` that are not NaN, m/s^2; `None` if all are NaN.
    pub fn gravity_norm_rms_mps2(&self) -> Option<f64> {
        let known = || self.norm_error_mps2.iter().copied().filter(|error| error.is_finite());
        known().next().map(|_| rms(known()))
    }
}

/// Performs the cross-validation of the two-stage fit. The gyroscope is fitted `folds` times. Each of these fits omits
/// every `folds`-th move, and its prediction errors are computed on the omitted moves.
pub(super) fn cross_validate(
    data: &UnitData<'_>,
    accelerometer: &AccelerometerFit,
    moves: &[Move],
    options: &Options<'_>,
    folds: usize,
) -> Result<CrossValidation, Error> {
    let mut direction_error_deg = vec![f64::NAN; moves.len()];
    for fold in 0..folds {
        let seen: Vec<Move> = (0..moves.len()).filter(|k| k % folds != fold).map(|k| moves[k]).collect();
        let gyroscope = data.fit_gyroscope(&seen, accelerometer, options)?.fit.triad;
        let (ends, _) = data.ends(moves, accelerometer, &gyroscope);
        for k in (fold..moves.len()).step_by(folds) {
            let m = &moves[k];
            let rotation = integrate_rotation_linear(&data.recordings[m.recording], m.first, m.last, &gyroscope);
            direction_error_deg[k] = direction_error_rad(&ends[k], &rotation).to_degrees();
        }
    }
    let gravity_direction_rms_deg = rms(direction_error_deg.iter().copied());
    Ok(CrossValidation {
        gravity_direction_rms_deg,
        direction_error_deg,
        norm_error_mps2: vec![f64::NAN; data.rests.len()],
    })
}
