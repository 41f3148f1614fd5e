//! Search for missing effects. An effect is a sensor error that the linear sensor model (sensitivities and biases) does
//! not contain, for example a bias that depends on temperature. All candidate effects are scored, and the candidate
//! with the largest evidence is added to the model. This step is repeated until no remaining candidate improves the fit
//! significantly (docs/model.md (23), (24)). A rest is a period without motion, and a move is the motion between two
//! rests.
//!
//! * `evidence`: evidence (marginal likelihood) of a model. The prior of an effect's parameter has a standard deviation
//!   of s times the typical size of the parameter, where s is the prior width. The noise scale (chi2 per degree of
//!   freedom) of each kind of residual is estimated.
//! * `forward_search`, `score`, `revise`: steps of the forward search.
//! * `generic`, `pattern`: generic hypotheses. A generic hypothesis is a variation of a bias or scale that no effect of
//!   the catalogue describes. It is tested whether such a variation explains the residuals instead of the selected
//!   effects, or in addition to them.
//! * `time_course`: selects how a parameter varies in time: as a random walk, smoothly, by switching between two
//!   levels, or by independent deviations in each rest and move.
//! * `predict`: cross-validation of a candidate effect on held-out rests and moves.
//! * `earth`: tests whether the rate estimated as the effect `earth_rate` has the known magnitude of the Earth's rate.
//! * `forward_search::beside_patterns`: scores effects of the catalogue with generic hypotheses in the model. Effects
//!   are therefore found even if an unknown variation is also present.
//! * `detect`: detection limit of each effect. It is the smallest size of the effect that is detected with 90 %
//!   probability.
//! * `fits`, `acceptance`: an effect is accepted unless it makes the prediction of unseen data significantly worse.
//!   Unseen data are control recordings (recordings that no fit uses) or, without control recordings, held-out rests
//!   and moves.
//! * `mount`, `clock`: detection of faults of the unit's mount on a stand (a device with motors that rotates the unit),
//!   and of errors of the time stamps. Such faults prevent conclusions about effects.
//! * `verdict`, `remainder`: the conclusion of a search, and a description of the residuals that the accepted effects
//!   do not explain.
//! * `session`: tests whether the biases changed between the calibration recordings and the control recordings.
//! * `residuals_by_place`: size of the residuals of each kind, and the rests and moves with significant residuals.
//! * `predicted_error`: expected errors of the corrected signals.
//!
//! [`find_gap()`] performs the complete search. [`search()`] selects effects without validation on unseen data.

mod acceptance;
mod clock;
mod common;
mod delay;
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
mod remainder;
mod residual_channels;
mod residual_kinds;
mod residuals_by_place;
mod revise;
mod score;
mod second_trial;
mod session;
mod shares;
mod smooth;
mod stage;
mod start;
mod temperature_memory;
mod time_course;
mod verdict;
mod weighing;

pub use acceptance::{EffectShare, Metric, Refusal, UnseenFigure};
pub use find::{Analysis, Gap, NotTheEarth, RivalFit, find_gap};
pub use fits::{Control, FOLDS, Fit};
pub use forward_search::{Visible, linearise, search, smallest_visible};
pub use generic::Block;
pub use kernel::Kernel;
pub use mount::{StandRest, loose_mounts, mount_slips, stand_mismatch_deg};
pub use options::{GapOptions, GivenCalibration, Progress, ReportProgress};
pub use predicted_error::{BriefMeans, PredictedError, PredictedErrors, UserCorrection, predicted_errors};
pub use remainder::{Remainder, RemainderKind};
pub use residual_kinds::{CorrectedFit, Regressor, ResidualKind};
pub use residuals_by_place::{ChannelResidual, Dependence, ItemResidual, ResidualsByPlace, residuals_by_place};
pub use session::SessionStep;
pub use verdict::{Contradiction, Rivals, Verdict};

use crate::calibrate::{Kinds, WarmStart};

/// The result of a forward search over candidate effects.
#[derive(Clone, Debug)]
pub struct Search {
    /// Selected effects, in the order of selection.
    pub path: Vec<Score>,
    /// Scores of all candidates relative to the model without effects, in descending order of the log Bayes factor.
    pub ranking: Vec<Score>,
    /// The variation of a bias or scale that no effect of the catalogue describes (a generic hypothesis), if such a
    /// variation explains a significant part of the residuals that the selected effects leave unexplained. If several
    /// hypotheses do so, this is the hypothesis with the largest log Bayes factor.
    pub generic: Option<GenericFinding>,
    /// Effects that are significant in the fit to these recordings. They were nevertheless not selected, because they
    /// do not improve the prediction of held-out rests and moves.
    pub not_predictive: Vec<NotPredictive>,
    /// Magnitude and standard deviation, rad/s, of a constant rate that the search estimated as the effect `earth_rate`
    /// and that differs significantly from the Earth's rate. In this case, `earth_rate` was removed from the
    /// candidates. `None` if no such rate was found.
    pub not_the_earth: Option<(f64, f64)>,
    /// Name of each effect that is not observable in these recordings, and the data that would make it observable.
    pub not_observable: Vec<(String, String)>,
    /// Detection limit of each effect: the name of the effect, the smallest rms value of its parameters that is
    /// detected with 90 % probability, and the unit of this value. The limit refers to an addition of the effect to the
    /// final model or, if the final model already contains the effect, to the model without effects.
    pub smallest_visible: Vec<(String, f64, String)>,
    /// For each effect: the residuals that remain after a fit if the unit has this effect at its typical size and the
    /// fitted model lacks the effect.
    pub traces: Vec<Trace>,
    /// The kind of residual with the largest ratio of scatter to noise under the final model; `None` if no ratio is
    /// significant. Only residuals at rests and residuals relative to the motor angles of the stand (a device that
    /// rotates the unit) are tested. If effects were selected, the tested residuals are only those of the stand and of
    /// the sensors on which these effects act. The effects are also estimated without the motor angles. If these
    /// estimates differ significantly from the estimates with the motor angles, the field instead contains the ratio of
    /// this difference to its noise, with the name `stand_and_sensors`.
    pub scattering_rests: Option<Scattering>,
    /// Kinds of residuals that the search uses.
    pub kinds: Kinds,
    /// Whether the search ignores accelerometer samples inside moves. It ignores them if the unit was moved by hand,
    /// because the specific force then contains accelerations in addition to gravity. It also ignores them if the
    /// accelerometer noise is far below the quantisation step, because the rounding errors of consecutive samples are
    /// then not independent.
    pub is_hand_moved: bool,
    /// Parameter values of the final fit of the search. Later fits with the selected effects start from them.
    pub warm_start: WarmStart,
}

/// Name of a kind of residual, ratio of the standard deviation of these residuals to their noise, and the p-value of
/// this ratio.
pub type Scattering = (&'static str, f64, f64);

/// The score of an effect relative to a model without it (docs/model.md (23)).
#[derive(Clone, Debug)]
pub struct Score {
    /// Name of the effect.
    pub name: String,
    /// Number of parameters of the effect. If the effect has several forms (for example linear and quadratic), it is
    /// the number in the form with the largest evidence.
    pub parameters: usize,
    /// Log Bayes factor of the model with the effect relative to the model without the effect, nats.
    pub log_bayes_factor: f64,
    /// Likelihood ratio statistic 2 ln(L_with / L_without), where L_with and L_without are the maximum likelihoods of
    /// the models with and without the effect.
    pub statistic: f64,
    /// Degrees of freedom of `statistic`: the number of observable directions in the space of the effect's parameters.
    pub dof: usize,
    /// p-value of `statistic` under a chi2 distribution with `dof` degrees of freedom, or with `dof` + 1 degrees of
    /// freedom if the effect has a time constant.
    pub p_value: f64,
    /// For a selected effect: names of the effects that could have been selected instead, because their log evidence
    /// differed from the log evidence of the selected effect by less than three nats. Empty for effects that were not
    /// selected.
    pub rivals: Vec<String>,
}

/// Residuals that remain if a unit has an effect of typical size and the fitted model lacks this effect. The fit of the
/// other parameters removes a part of the error that the effect causes.
#[derive(Clone, Debug)]
pub struct Trace {
    /// Name of the effect.
    pub name: String,
    /// For each kind of residual: its name, and the rms of residual / sigma. Sigma is the standard deviation of a
    /// residual from sensor noise.
    pub times_noise: Vec<(&'static str, f64)>,
    /// Share of the effect's error that the fit of the other parameters removes, 0 to 1: decrease of chi2 by the fit,
    /// divided by chi2 before the fit.
    pub taken_up: f64,
}

/// An effect that fits the calibration data but does not improve the prediction of held-out data.
#[derive(Clone, Debug)]
pub struct NotPredictive {
    /// Name of the effect.
    pub name: String,
    /// Log Bayes factor of the model with the effect relative to the model without it, on the data to which both models
    /// were fitted, nats.
    pub log_bayes_factor: f64,
    /// Increase of the log predictive density of held-out rests and moves if the effect is added, nats.
    pub gain: f64,
    /// Standard deviation of `gain`, nats.
    pub gain_std: f64,
}

/// A variation of a sensor's bias or scale that no effect of the catalogue describes (docs/model.md (24)).
#[derive(Clone, Debug)]
pub struct GenericFinding {
    /// The sensor parameter that varies: a bias or a scale of the gyroscope or the accelerometer.
    pub block: Block,
    /// Covariance kernel of the variation. It states the quantity on which the variation depends, and the form of the
    /// dependence.
    pub kernel: Kernel,
    /// Log Bayes factor relative to the model without the variation, nats.
    pub log_bayes_factor: f64,
    /// Upper bound of the p-value of the variation. The p-value is the probability that noise causes a Bayes factor of
    /// at least this size.
    pub p_value: f64,
    /// Sensor axis with the largest variation: 0, 1 or 2.
    pub axis: usize,
    /// Indices of the three rests at which the parameter deviates most from its constant value, in descending order of
    /// the deviation. For a variation that is observable only in moves: indices of the rests before the three moves
    /// with the largest deviations.
    pub rests: Vec<usize>,
    /// Rms deviation of the parameter over all rests (or moves), on the sensor axis `axis`, SI units.
    pub rms: f64,
}

/// Whitened residuals and the Jacobian of these residuals. Each row of the Jacobian belongs to one residual.
#[derive(Clone, Debug)]
pub struct Linearised {
    /// Residuals divided by their standard deviation from sensor noise.
    pub residual: Vec<f64>,
    /// Derivatives of `residual` with respect to the base parameters (sensitivities and biases) and, if the stand's
    /// angles are used, the stand parameters. Each row belongs to one residual, and each column to one parameter.
    pub base: Vec<Vec<f64>>,
    /// For each effect: its name, and the derivatives with respect to the parameters of its largest form (for example
    /// quadratic), in the layout of `base`. An effect with a time constant has one list entry for each trial value of
    /// the time constant.
    pub candidates: Vec<(String, Vec<Vec<f64>>)>,
    /// Number that identifies the kind of each residual. Residuals of the same kind have the same number.
    pub groups: Vec<usize>,
    /// Index of the rest or move to which each residual belongs. Rests and moves are numbered in order of time.
    pub items: Vec<usize>,
}
