//! How well a fit predicts rests and moves that it has not seen.

use super::Options;
use super::jointly::Selection;
use super::unit_data::UnitData;
use crate::accelerometer::AccelerometerFit;
use crate::carry::rotate;
use crate::error::Error;
use crate::joint::Item;
use crate::moves::{Move, direction_error_rad};
use crate::recording::Recording;
use crate::stats::rms;

/// How well rests and moves are predicted that the fit has not seen.
#[derive(Clone, Debug)]
pub struct CrossValidation {
    /// Rms over all moves of the angle between carried and measured gravity, each with the fit that left it out, deg.
    pub gravity_direction_rms_deg: f64,
    /// The angle of each move, deg.
    pub direction_error_deg: Vec<f64>,
    /// Error of |f| at each rest, with the joint fit that left it out, m/s^2; NaN for rests that take no part or cannot be spared.
    pub norm_error_mps2: Vec<f64>,
}

/// Fits `folds` times without every `folds`-th move and as often without every `folds`-th rest, and judges on what was left out.
///
/// # Errors
/// As [`calibrate`](super::calibrate()); [`Error::Input`] for fewer than two folds.
pub fn cross_validate(
    recordings: &[Recording<'_>],
    options: &Options<'_>,
    folds: usize,
) -> Result<CrossValidation, Error> {
    if folds < 2 {
        return Err(Error::Input(format!("folds = {folds}: at least 2 are needed to leave moves out")));
    }
    let mut data = UnitData::try_new(recordings, options)?;
    let accelerometer = data.fit_accelerometer(options)?;
    let (moves, _) = data.moves(&accelerometer, options)?;
    if options.is_joint() {
        let all = data.fit_gyroscope(&moves, &accelerometer, options)?.fit.triad;
        data.free_of_tremor(&accelerometer.triad, &all);
    }
    let mut direction_error_deg = vec![f64::NAN; moves.len()];
    for fold in 0..folds {
        let seen: Vec<Move> = (0..moves.len()).filter(|k| k % folds != fold).map(|k| moves[k]).collect();
        let gyroscope = data.fit_gyroscope(&seen, &accelerometer, options)?;
        let held_out = (fold..moves.len()).step_by(folds);
        if options.is_joint() {
            let seen = Selection::of_two_stages(&accelerometer, &gyroscope, &[]);
            let joint = data.fit_jointly(&seen, [&accelerometer.triad, &gyroscope.fit.triad], options)?;
            let unseen = Selection { moves: held_out.clone().map(|k| moves[k]).collect(), ..seen };
            let predicted = data.predict(&joint, &unseen, options)?;
            for (k, (ends, rotation)) in held_out.zip(&predicted) {
                direction_error_deg[k] = direction_error_rad(ends, rotation).to_degrees();
            }
            continue;
        }
        let (ends, _) = data.ends(&moves, &accelerometer, &gyroscope.fit.triad);
        for k in held_out {
            let m = &moves[k];
            let rotation = rotate(&recordings[m.recording], m.first, m.last, &gyroscope.fit.triad);
            direction_error_deg[k] = direction_error_rad(&ends[k], &rotation).to_degrees();
        }
    }
    let norm_error_mps2 = data.unseen_norms(&accelerometer, &moves, options, folds)?;
    let gravity_direction_rms_deg = rms(direction_error_deg.iter().copied());
    Ok(CrossValidation { gravity_direction_rms_deg, direction_error_deg, norm_error_mps2 })
}

impl UnitData<'_> {
    /// Error of |f| at each rest as the joint fit without it predicts; moves lead over the rests that are left out.
    fn unseen_norms(
        &self,
        accelerometer: &AccelerometerFit,
        moves: &[Move],
        options: &Options<'_>,
        folds: usize,
    ) -> Result<Vec<f64>, Error> {
        let mut errors = vec![f64::NAN; self.rests.len()];
        if !options.is_joint() {
            return Ok(errors);
        }
        let gyroscope = self.fit_gyroscope(moves, accelerometer, options)?;
        let all = Selection { used: accelerometer.used.clone(), moves: moves.to_vec(), left_out: Vec::new() };
        let contradicts = |m: &Move| gyroscope.moves.iter().zip(&gyroscope.fit.used).any(|(n, used)| n == m && !used);
        let bad: Vec<Item> = (0..moves.len()).filter(|&k| contradicts(&moves[k])).map(Item::Move).collect();
        let used: Vec<usize> = (0..all.used.len()).filter(|&k| all.used[k]).collect();
        for fold in 0..folds {
            let unseen: Vec<usize> = used.iter().copied().skip(fold).step_by(folds).collect();
            let items: Vec<Item> = unseen.iter().map(|&k| Item::Rest(k)).chain(bad.iter().copied()).collect();
            let seen = self.without(&all, &items);
            // Few rests determine nothing when a part of them is gone; the others are judged.
            let Ok(joint) = self.fit_jointly(&seen, [&accelerometer.triad, &gyroscope.fit.triad], options) else {
                continue;
            };
            for (k, error) in self.predict_norms(&joint, &unseen, options)? {
                errors[k] = error;
            }
        }
        Ok(errors)
    }
}
