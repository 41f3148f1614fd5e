//! Options and progress reports of the search for missing effects.

use imucal_core::calibration::Calibration;
use imucal_core::effects::Effect;

use crate::calibrate::{EffectChoice, UserEffects};
use crate::error::Error;
use crate::recording::Recording;

/// Options of [`find_gap`](super::find_gap).
#[derive(Clone, Default)]
pub struct GapOptions<'a> {
    /// Candidate effects from the catalogue. If `None`, all effects of the catalogue are candidates.
    pub candidates: Option<Vec<EffectChoice>>,
    /// User-defined effects, which are always candidates.
    pub user_effects: Option<&'a dyn UserEffects>,
    /// A calibration with which the result is compared. If `None`, the result is compared with the fit without effects.
    pub calibration: Option<GivenCalibration<'a>>,
    /// Function that is called before each step of the search. If it returns an error, the search ends.
    pub progress: Option<ReportProgress<'a>>,
}

/// A given calibration, with which the result of the search is compared. It is evaluated on the control recordings or,
/// without control recordings, on the calibration recordings.
#[derive(Clone, Copy)]
pub struct GivenCalibration<'a> {
    /// The calibration, without its user-defined effects. Its body frame is the symmetric one, in which the
    /// accelerometer's sensitivity matrix is symmetric.
    pub calibration: &'a Calibration<f64>,
    /// Local gravity with which the calibration was made, m/s^2.
    pub gravity_mps2: f64,
    /// The recordings for the evaluation, after correction by this calibration. If `None`, this crate corrects the
    /// recordings. Corrected recordings are required if the calibration has user-defined effects, because this crate
    /// cannot evaluate such effects.
    pub corrected: Option<&'a [Recording<'a>]>,
}

/// A function that is called before each step of a search. If it returns an error, the search ends.
pub type ReportProgress<'a> = &'a dyn Fn(Progress<'_>) -> Result<(), Error>;

/// A step of a search.
#[derive(Clone, Copy, Debug)]
pub enum Progress<'a> {
    /// Fit of a model with these effects.
    Fit {
        /// Names of the effects; empty for the model without effects.
        effects: &'a [String],
    },
    /// Scoring of candidate effects.
    Score {
        /// Number of candidates.
        candidates: usize,
    },
    /// Prediction of the errors of corrected signals.
    PredictErrors,
}

impl GapOptions<'_> {
    pub(super) fn report(&self, progress: Progress<'_>) -> Result<(), Error> {
        self.progress.map_or(Ok(()), |report| report(progress))
    }

    /// Whether `name` is the name of a user-defined effect.
    pub(super) fn user_effect(&self, name: &str) -> bool {
        self.user_effects.is_some_and(|source| source.names().iter().any(|own| own == name))
    }

    pub(super) fn choices(&self) -> Vec<EffectChoice> {
        let all = || Effect::catalogue().map(EffectChoice::candidate).collect();
        self.candidates.clone().unwrap_or_else(all)
    }
}
