//! A model of fewer parameters for recordings that do not determine all of them.

use super::held_estimates::{HeldEstimate, listed};
use super::{Checked, Options, Outcome, prospect};
use crate::error::Error;
use crate::finding::general;
use crate::held::{Hold, ParameterModel, PriorCost, Priors};
use crate::recording::Recording;
use crate::verdict::Verdict;

impl<'a> Checked<'a> {
    /// Checks the recordings, detects their rests and makes the two-stage fit.
    ///
    /// # Errors
    /// As [`calibrate`](super::calibrate()). The message of [`Error::NotEnoughMotion`] also offers a model of fewer
    /// parameters that the recordings determine, if there is one.
    pub fn try_new(recordings: &[Recording<'a>], options: &Options<'_>) -> Result<Self, Error> {
        let checked = determined(recordings, options);
        if let Err(error) = &checked {
            Self::refuse_several_units(recordings, options, error)?;
        }
        match checked {
            Err(Error::NotEnoughMotion(words)) => Err(Error::NotEnoughMotion(with_offer(recordings, options, &words))),
            other => other,
        }
    }
}

/// The checked recordings, which must determine all parameters without a prior. With the model of biases and scales the
/// gyroscope's scales about axes without rotation are held, too.
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

/// The words of a refusal, followed by the model with the most free parameters that the recordings determine and by
/// what it leaves uncertain. Each model is tried with a complete calibration.
fn with_offer(recordings: &[Recording<'_>], options: &Options<'_>, words: &str) -> String {
    let mut reduced = ParameterModel::ALL.into_iter().skip_while(|model| *model != options.priors.model).skip(1);
    let works = |model: ParameterModel| {
        let priors = Priors { model, ..options.priors.clone() };
        let options = Options { priors, ..options.clone() };
        let checked = determined(recordings, &options).ok()?;
        let outcome = checked.calibrate(&options.model(), None).ok()?;
        (!matches!(outcome.verdict(), Verdict::Poor(_))).then_some((model, outcome))
    };
    match reduced.find_map(works) {
        Some((model, outcome)) => format!("{words}. {}", offered(model, &outcome)),
        None => words.to_owned(),
    }
}

fn offered(model: ParameterModel, outcome: &Outcome) -> String {
    let free = match model {
        ParameterModel::Full => "all parameters",
        ParameterModel::Orthogonal => "biases and scales",
        ParameterModel::Bias => "biases",
    };
    let mut words = format!("Without more motion, model='{}' estimates {free}", model.name());
    let undetermined: Vec<&HeldEstimate> = outcome.held.iter().filter(|held| !held.is_determined()).collect();
    if !undetermined.is_empty() {
        words += &format!("; {} stay at their prior", listed(&undetermined, &outcome.held));
    }
    if let Some(PriorCost { gravity_direction_deg, rotation_deg }) = outcome.prior_cost {
        words += &format!(
            ", which leaves an error (1 sigma) of {} deg in the direction of gravity and of {} deg in a rotation by 90 deg",
            general(gravity_direction_deg, 2),
            general(rotation_deg, 2)
        );
    }
    words
}
