//! Finding the missing effect: score every effect and add the one with the largest evidence, until noise explains the
//! residuals (model.md (23), (24)).
//!
//! * `evidence`: the evidence of a model, with priors at the typical sizes of effects and the scatter of each kind of
//!   residual.
//! * `forward_search`, `score`, `revise`: the steps of the search.
//! * `generic`, `pattern`: deviations that are not in the catalogue compete with all named effects together.
//! * `predict`: an effect must predict rests and moves that it was not fitted to.
//! * `earth`: `earth_rate` must have the known size.
//! * `detect`: the smallest size at which an effect would have been detected.
//! * `fits`, `acceptance`: an effect joins if control recordings, or rests and moves held out, are predicted no worse
//!   with it.
//! * `mount`, `clock`: faults of the data, which exclude other conclusions.
//! * `verdict`: the conclusion of a search.
//! * `residuals_by_place`, `predicted_error`: the disagreement, and the errors of corrected signals.
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
mod fit_models;
mod fits;
mod forward_search;
mod generic;
mod judge_patterns;
mod kernel;
mod known;
mod moments;
mod mount;
mod move_blocks;
mod options;
mod parameter_uncertainty;
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
pub use find::{Analysis, Gap, NotTheEarth, RivalFit, find_gap};
pub use fits::{Control, FOLDS, Fit};
pub use forward_search::{Visible, linearise, search, smallest_visible};
pub use generic::Block;
pub use kernel::Kernel;
pub use mount::{StandRest, loose_mounts, mount_slips, stand_mismatch_deg};
pub use options::{GapOptions, GivenCalibration, Progress, ReportProgress};
pub use predicted_error::{BriefMeans, PredictedError, PredictedErrors, UserCorrection, predicted_errors};
pub use residual_kinds::{CorrectedFit, Regressor, ResidualKind};
pub use residuals_by_place::{ChannelResidual, Dependence, ItemResidual, ResidualsByPlace, residuals_by_place};
pub use verdict::{Contradiction, Rivals, Verdict};

use crate::calibrate::WarmStart;

/// What a search has found.
#[derive(Clone, Debug)]
pub struct Search {
    /// Selected effects, in the order of selection.
    pub path: Vec<Score>,
    /// Scores of all candidates against the model without effects, the best one first.
    pub ranking: Vec<Score>,
    /// The best generic hypothesis, if it explains more than the selected effects.
    pub generic: Option<GenericFinding>,
    /// Effects that fit these recordings but do not predict rests and moves held out.
    pub not_predictive: Vec<NotPredictive>,
    /// Size and standard deviation, rad/s, of a rate with the pattern of the Earth's that cannot be it. `earth_rate`
    /// was excluded from the candidates then.
    pub not_the_earth: Option<(f64, f64)>,
    /// Effects that these recordings cannot show, and what each needs.
    pub not_observable: Vec<(String, String)>,
    /// Smallest rms size of a parameter that is detected with 90 % probability, by effect, and its unit: relative to
    /// the final model, and for effects in that model relative to the model without effects.
    pub smallest_visible: Vec<(String, f64, String)>,
    /// Residuals that each effect causes at its typical size.
    pub traces: Vec<Trace>,
    /// Kind of residual at rests whose scatter under the final model exceeds noise significantly; with effects in the
    /// model only residuals of their sensors count.
    pub scattering_rests: Option<Scattering>,
    /// Whether a hand moved the unit, so that the specific force inside moves is not that of gravity alone and takes no
    /// part.
    pub is_hand_moved: bool,
    /// Where the search ended, as the start of fits with the effects of its path.
    pub warm_start: WarmStart,
}

/// Name of a kind of residual, ratio of its scatter to noise, and probability of that under the null hypothesis.
pub type Scattering = (&'static str, f64, f64);

/// The score of an effect.
#[derive(Clone, Debug)]
pub struct Score {
    /// Its name.
    pub name: String,
    /// Log Bayes factor of the model with the effect against the model without it, nats.
    pub log_bayes_factor: f64,
    /// Twice the gain of the log likelihood.
    pub statistic: f64,
    /// Number of observable directions of its parameters.
    pub dof: usize,
    /// Probability of such a gain under the null hypothesis.
    pub p_value: f64,
    /// Of a selected effect: names of the effects within three nats of its evidence when it was selected.
    pub rivals: Vec<String>,
}

/// Residuals that an effect of typical size causes after the base parameters have compensated what they can.
#[derive(Clone, Debug)]
pub struct Trace {
    /// Its name.
    pub name: String,
    /// Kind of residual, and the rms of the residuals over their noise.
    pub times_noise: Vec<(&'static str, f64)>,
    /// Share of its chi2 that the base parameters compensate.
    pub taken_up: f64,
}

/// An effect that does not predict data that it was not fitted to.
#[derive(Clone, Debug)]
pub struct NotPredictive {
    /// Its name.
    pub name: String,
    /// Log Bayes factor on the data that it was fitted to, nats.
    pub log_bayes_factor: f64,
    /// Gain of the log predictive density of rests and moves held out, nats.
    pub gain: f64,
    /// Standard deviation of the gain.
    pub gain_std: f64,
}

/// A bias or a scale that varies in a pattern without a name in the catalogue.
#[derive(Clone, Debug)]
pub struct GenericFinding {
    /// The parameter that varies.
    pub block: Block,
    /// The quantity that it varies with.
    pub kernel: Kernel,
    /// Log Bayes factor against the model without effects, nats.
    pub log_bayes_factor: f64,
    /// The axis that varies most: 0, 1 or 2.
    pub axis: usize,
    /// Rests with the largest deviations, the largest first.
    pub rests: Vec<usize>,
    /// Rms of the variation of that axis, SI units.
    pub rms: f64,
}

/// Whitened residuals and their derivatives, row by row.
#[derive(Clone, Debug)]
pub struct Linearised {
    /// The residuals in units of their standard deviation from noise.
    pub residual: Vec<f64>,
    /// Derivatives by the base parameters.
    pub base: Vec<Vec<f64>>,
    /// Derivatives by the parameters of each effect; an effect with a time constant has an entry for each trial value.
    pub candidates: Vec<(String, Vec<Vec<f64>>)>,
}
