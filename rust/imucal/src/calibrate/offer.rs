//! Error messages that offer a model with fewer parameters if the recordings do not determine all parameters.

use super::held_estimates::{HeldEstimate, listed};
use super::{Checked, Options, prospect};
use crate::error::Error;
use crate::finding::general;
use crate::held::{Hold, ParameterModel, PriorCost, Priors};
use crate::recording::Recording;
use crate::verdict::Verdict;

impl<'a> Checked<'a> {
    /// Checks the recordings, detects their rests and performs the two-stage fit.
    ///
    /// # Errors
    /// The errors of [`calibrate`](super::calibrate()). If the recordings determine a model with fewer parameters, the
    /// message of [`Error::NotEnoughMotion`] also offers this model.
    pub fn try_new(recordings: &[Recording<'a>], options: &Options<'_>) -> Result<Self, Error> {
        let checked = determined(recordings, options);
        if let Err(error) = &checked {
            Self::refuse_several_units(recordings, options, error)?;
        }
        match checked {
            Err(Error::NotEnoughMotion(words)) => {
                let fit = |options: &Options<'_>| {
                    let outcome = determined(recordings, options).ok()?.calibrate(&options.model(), None).ok()?;
                    let is_usable = !matches!(outcome.verdict(), Verdict::Poor(_));
                    is_usable.then_some(Reduced { held: outcome.held, cost: outcome.prior_cost, condition: None })
                };
                Err(Error::NotEnoughMotion(with_offer(options, &words, fit).unwrap_or(words)))
            }
            other => other,
        }
    }
}

/// Returns the checked recordings, or an error if they do not determine all parameters that have no prior. In the model
/// `orthogonal`, only biases and scales have no priors. If this model is requested and the unit was not rotated about
/// an axis, the function adds a prior for the gyroscope scale of this axis.
fn determined<'a>(recordings: &[Recording<'a>], options: &Options<'_>) -> Result<Checked<'a>, Error> {
    let checked = Checked::of_determined(recordings, options);
    if options.priors.model != ParameterModel::Orthogonal || !matches!(checked, Err(Error::NotEnoughMotion(_))) {
        return checked;
    }
    let found = prospect(recordings, options)?;
    let axes = ["x", "y", "z"].into_iter();
    let idle = axes.filter(|axis| {
        let name = format!("gyro_sensitivity_{axis}{axis}");
        found.names.iter().zip(&found.predicted_sigma).any(|(own, sigma)| *own == name && sigma.is_none())
    });
    let hold = idle.map(|axis| Hold { name: format!("gyro_scale_{axis}"), value: None, sigma: None });
    let mut priors = options.priors.clone();
    priors.hold.extend(hold);
    if priors == options.priors {
        return checked;
    }
    Checked::of_determined(recordings, &Options { priors, ..options.clone() }).or(checked)
}

/// A usable result of a model with fewer parameters.
pub(super) struct Reduced {
    /// Parameters with a prior in this model (held parameters), with their estimates.
    pub(super) held: Vec<HeldEstimate>,
    /// Errors that the uncertainty of the priors causes in a measured gravity direction and in a measured rotation.
    pub(super) cost: Option<PriorCost>,
    /// Condition of this result, as a clause of the message: it begins with "if" and names an option that the user must
    /// also give. `None` if no further option is needed.
    pub(super) condition: Option<&'static str>,
}

/// Returns the error message `words`, followed by an offer of a model with fewer free parameters; `None` if the data
/// determine no such model. Of all models that the data determine, the offered model has the most free parameters. The
/// message also states the error that the priors of this model cause. `fit` performs a complete calibration with the
/// given options and returns `None` if it has no usable result.
pub(super) fn with_offer(
    options: &Options<'_>,
    words: &str,
    fit: impl Fn(&Options<'_>) -> Option<Reduced>,
) -> Option<String> {
    let mut reduced = ParameterModel::ALL.into_iter().skip_while(|model| *model != options.priors.model).skip(1);
    let found = reduced.find_map(|model| {
        let priors = Priors { model, ..options.priors.clone() };
        fit(&Options { priors, ..options.clone() }).map(|result| (model, result))
    });
    found.map(|(model, result)| format!("{words}. {}", offered(model, &result)))
}

fn offered(model: ParameterModel, result: &Reduced) -> String {
    let free = match model {
        ParameterModel::Full => "all parameters",
        ParameterModel::Orthogonal => "biases and scales",
        ParameterModel::Bias => "biases",
    };
    let mut words = format!("Without more motion, model='{}' estimates {free}", model.name());
    if let Some(condition) = result.condition {
        words += &format!(" {condition}");
    }
    let undetermined: Vec<&HeldEstimate> = result.held.iter().filter(|held| !held.is_determined()).collect();
    if !undetermined.is_empty() {
        words += &format!("; {} stay at their prior", listed(&undetermined, &result.held));
    }
    if let Some(PriorCost { gravity_direction_deg, rotation_deg }) = result.cost {
        words += &format!(
            ", which leaves an error (1 sigma) of {} deg in the direction of gravity",
            general(gravity_direction_deg, 2)
        );
        // An accelerometer does not measure rotations, so the error of a rotation is NaN without a gyroscope.
        if !rotation_deg.is_nan() {
            words += &format!(" and of {} deg in a rotation by 90 deg", general(rotation_deg, 2));
        }
    }
    words
}
