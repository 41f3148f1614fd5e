//! Finding the missing effect: score every effect, add the one that explains most, until nothing is left (model.md
//! (23), (24)).
//!
//! * `evidence`: what a model explains, with units (priors at typical sizes), with its number of parameters and with
//!   the scatter of each kind of residual taken into account.
//! * `generic`: what is not in the catalogue competes with whole paths of named effects.
//! * `predict`: an effect has to predict what it was not fitted to.
//! * `earth`: an effect whose size is known has to have it.
//! * `detect`: how small an effect would have been seen.
//!
//! * `fits`, `acceptance`: an effect joins if control recordings, or rests and moves held out, are predicted no worse
//!   with it.
//! * `mount`, `clock`: faults of the data, which come before any effect.
//! * `verdict`: what a search concludes.
//!
//! [`find_gap()`] does all of this; [`search()`] scores and adds effects without judging them on unseen data.

mod acceptance;
mod clock;
mod common;
mod design;
mod detect;
mod earth;
mod evidence;
mod find;
mod fits;
mod generic;
mod known;
mod moments;
mod mount;
mod move_blocks;
mod parameter_uncertainty;
mod path;
mod pattern;
mod predict;
mod predicted_error;
mod products;
mod residual_channels;
mod residual_kinds;
mod residuals_by_place;
mod revise;
mod score;
mod shares;
mod smooth;
mod stage;
mod start;
mod verdict;
mod weighing;

pub use acceptance::{Metric, Refusal, UnseenFigure};
pub use earth::is_earth_rate;
pub use find::{Analysis, Gap, GapOptions, GivenCalibration, NotTheEarth, Progress, RivalFit, find_gap};
pub use fits::{Control, FOLDS, Fit};
pub use generic::{Block, Kernel};
pub use mount::{StandRest, loose_mounts, mount_slips, stand_mismatch_deg};
pub use path::{Visible, linearise, search, smallest_visible};
pub use predicted_error::{BriefMeans, PredictedError, PredictedErrors, UserCorrection, predicted_errors};
pub use residual_kinds::{CorrectedFit, Regressor, ResidualKind};
pub use residuals_by_place::{ChannelResidual, Dependence, ItemResidual, ResidualsByPlace, residuals_by_place};
pub use verdict::{Contradiction, Rivals, Verdict};

use crate::calibrate::WarmStart;

/// What a search has found.
#[derive(Clone, Debug)]
pub struct Search {
    /// Effects that join the model, in the order in which they were found.
    pub path: Vec<Score>,
    /// All candidates against the model without effects, best first.
    pub ranking: Vec<Score>,
    /// The best generic hypothesis, if it explains more than the path.
    pub generic: Option<GenericFinding>,
    /// Effects that fit these recordings and do not predict rests and moves that they were not fitted to.
    pub not_predictive: Vec<NotPredictive>,
    /// Size of what has the pattern of the Earth's rate and is clearly not it, and its standard deviation, rad/s:
    /// `earth_rate` was not looked for then.
    pub not_the_earth: Option<(f64, f64)>,
    /// Effects that these recordings cannot show, and what would.
    pub not_observable: Vec<(String, String)>,
    /// Smallest rms size of a parameter that is seen with 90 % probability beside the final model, by effect, and its
    /// unit; of a member of the path beside the model without effects.
    pub smallest_visible: Vec<(String, f64, String)>,
    /// What each effect leaves in the residuals at its typical size.
    pub traces: Vec<Trace>,
    /// Rests that scatter by more than noise and chance under the final model, about what its effects are about if it
    /// has any: the name of the residual, the factor, and the probability of it.
    pub scattering_rests: Option<Scattering>,
    /// Whether a hand moved the unit, so that the specific force inside moves is not that of gravity alone and takes no
    /// part.
    pub is_hand_moved: bool,
    /// Where the search ended, as the start of fits with the effects of its path.
    pub warm_start: WarmStart,
}

/// Name of a kind of residual, the factor by which it scatters more than noise, and the probability of that.
pub type Scattering = (&'static str, f64, f64);

/// How an effect scores.
#[derive(Clone, Debug)]
pub struct Score {
    /// Its name.
    pub name: String,
    /// Logarithm of the Bayes factor of the model with it against the model without.
    pub log_bayes_factor: f64,
    /// Twice the gain of the logarithm of the likelihood.
    pub statistic: f64,
    /// Directions of its parameters that these recordings show.
    pub dof: usize,
    /// Probability of such a gain by chance.
    pub p_value: f64,
    /// Of a member of the path: names within three nats of its evidence when it was picked.
    pub rivals: Vec<String>,
}

/// What an effect of typical size leaves in the residuals when the parameters that are always there have taken up what
/// they can.
#[derive(Clone, Debug)]
pub struct Trace {
    /// Its name.
    pub name: String,
    /// Kind of residual, and the rms of what it leaves there in units of noise.
    pub times_noise: Vec<(&'static str, f64)>,
    /// Share of its chi2 that is taken up.
    pub taken_up: f64,
}

/// An effect that explains data only where it was fitted to them.
#[derive(Clone, Debug)]
pub struct NotPredictive {
    /// Its name.
    pub name: String,
    /// Logarithm of its Bayes factor on the data that it was fitted to.
    pub log_bayes_factor: f64,
    /// Logarithm of the predictive density that it gains on rests and moves held out, stretch by stretch.
    pub gain: f64,
    /// Standard deviation of the gain.
    pub gain_std: f64,
}

/// A bias or a scale that varies in a pattern that no named effect explains.
#[derive(Clone, Debug)]
pub struct GenericFinding {
    /// What varies.
    pub block: Block,
    /// How.
    pub kernel: Kernel,
    /// Logarithm of its Bayes factor against no effect.
    pub log_bayes_factor: f64,
    /// The axis that varies most: 0, 1 or 2.
    pub axis: usize,
    /// Rests with the largest share, the largest first.
    pub rests: Vec<usize>,
    /// Rms of the variation of that axis, SI units.
    pub rms: f64,
}

/// Whitened residuals and their derivatives, row by row.
#[derive(Clone, Debug)]
pub struct Linearised {
    /// The residuals, in units of what noise explains.
    pub residual: Vec<f64>,
    /// By the parameters that are always there.
    pub base: Vec<Vec<f64>>,
    /// By the parameters of each effect; an effect with a time constant is there for several.
    pub candidates: Vec<(String, Vec<Vec<f64>>)>,
}
