//! Options of the search for the missing effect, and the steps that it reports.

use imucal_core::calibration::Calibration;
use imucal_core::effects::Effect;

use crate::calibrate::{EffectChoice, UserEffects};
use crate::error::Error;
use crate::recording::Recording;

/// Options of [`find_gap`](super::find_gap).
#[derive(Clone, Default)]
pub struct GapOptions<'a> {
    /// Effects of the catalogue to look for; all of them if `None`.
    pub candidates: Option<Vec<EffectChoice>>,
    /// Effects of the user's own, which are always looked for.
    pub user_effects: Option<&'a dyn UserEffects>,
    /// A calibration to compare with; without it the fit without effects is what others are compared with.
    pub calibration: Option<GivenCalibration<'a>>,
    /// Is called before each step; an error ends the search.
    pub progress: Option<ReportProgress<'a>>,
}

/// A calibration that is judged on the control recordings, or on the recordings themselves if there are none.
#[derive(Clone, Copy)]
pub struct GivenCalibration<'a> {
    /// The calibration, in the symmetric frame, without effects of a user's own.
    pub calibration: &'a Calibration<f64>,
    /// The gravity that it was made with, m/s^2.
    pub gravity_mps2: f64,
    /// The recordings that it is judged on, corrected by it; `None` to correct them here.
    pub corrected: Option<&'a [Recording<'a>]>,
}

/// A function that is called before each step of a search; an error ends the search.
pub type ReportProgress<'a> = &'a dyn Fn(Progress<'_>) -> Result<(), Error>;

/// A step of a search.
#[derive(Clone, Copy, Debug)]
pub enum Progress<'a> {
    /// A model with these effects is fitted.
    Fit {
        /// Their names; none for the model without effects.
        effects: &'a [String],
    },
    /// So many effects are scored.
    Score {
        /// How many.
        candidates: usize,
    },
    /// The error of corrected signals is predicted.
    PredictErrors,
}

impl GapOptions<'_> {
    pub(super) fn report(&self, progress: Progress<'_>) -> Result<(), Error> {
        self.progress.map_or(Ok(()), |report| report(progress))
    }

    /// Whether this is the name of an effect of the user's own.
    pub(super) fn user_effect(&self, name: &str) -> bool {
        self.user_effects.is_some_and(|source| source.names().iter().any(|own| own == name))
    }

    pub(super) fn choices(&self) -> Vec<EffectChoice> {
        let all = || Effect::catalogue().map(|effect| EffectChoice { effect, full: false }).collect();
        self.candidates.clone().unwrap_or_else(all)
    }
}
