//! Start values and priors of joint fits.

use faer::Mat;
use imucal_core::sensor::Triad;

use super::encoders;
use super::model::Model;
use super::prepared::Prepared;
use super::terms::{Term, Terms};
use crate::parameters::STAND_PARAMETERS;

/// Sensor models and effects at the end of an earlier fit. Fits with the same effects start from them. A warm start
/// saves iterations and does not change the result.
#[derive(Clone, Debug)]
pub struct WarmStart {
    model: Model,
    /// Names of the effects, and the number of parameters of each.
    effects: Vec<(String, usize)>,
}

impl WarmStart {
    /// Warm start at `model`; `effects` are its effects in order, with the number of parameters of each.
    pub(crate) fn new(model: &Model, effects: Vec<(String, usize)>) -> Self {
        Self { model: model.clone(), effects }
    }

    pub(crate) fn of(terms: &Terms<'_>, model: &Model) -> Self {
        Self::new(model, effects(terms))
    }

    /// The model of the warm start if it has the effects of `terms`, otherwise `None`. Also `None` for effects with
    /// time constants, because their fits try several start values.
    fn model(&self, terms: &Terms<'_>) -> Option<Model> {
        let is_same = self.effects == effects(terms) && !terms.all.iter().any(Term::has_shape);
        is_same.then(|| self.model.clone())
    }
}

fn effects(terms: &Terms<'_>) -> Vec<(String, usize)> {
    terms.all.iter().map(|term| (term.name().to_owned(), term.count())).collect()
}

/// Returns the start model of a fit: the warm start if it has the effects of `terms`, otherwise the given accelerometer
/// and gyroscope with zero effects.
pub(super) fn start(
    prepared: &Prepared<'_>,
    terms: &Terms<'_>,
    [accelerometer, gyroscope]: [&Triad<f64>; 2],
    warm_start: Option<&WarmStart>,
) -> Model {
    let plain = start_model(prepared, terms, accelerometer, gyroscope);
    let same_stand = |model: &Model| model.stand.len() == plain.stand.len();
    warm_start.and_then(|warm_start| warm_start.model(terms)).filter(same_stand).unwrap_or(plain)
}

/// Returns a start model from the given accelerometer and gyroscope, with zero effects.
pub(crate) fn start_model(
    prepared: &Prepared<'_>,
    terms: &Terms<'_>,
    accelerometer: &Triad<f64>,
    gyroscope: &Triad<f64>,
) -> Model {
    Model {
        accelerometer: *accelerometer,
        gyroscope: *gyroscope,
        values: start_values(terms),
        stand: start_stand(prepared, terms, accelerometer),
    }
}

/// Start values of the stand parameters: an estimate of the mount rotation, and zero for all others.
fn start_stand(prepared: &Prepared<'_>, terms: &Terms<'_>, accelerometer: &Triad<f64>) -> Vec<f64> {
    let Some(encoders) = prepared.encoders.as_ref().filter(|_| terms.kinds.encoders) else { return Vec::new() };
    let used = (0..prepared.rests.len()).filter(|&k| prepared.used[k]);
    let (angles, up): (Vec<_>, Vec<_>) = used
        .map(|k| {
            let mean = prepared.rests[k].rest.specific_force.mean;
            (*encoders.mean(k), accelerometer.correct(mean).normalize())
        })
        .unzip();
    let mut stand = vec![0.0; STAND_PARAMETERS];
    stand[..3].copy_from_slice(encoders::mount_rotation(&angles, &up).as_slice());
    stand
}

/// Start values of the effects: zero, and the typical size for each time constant.
pub(super) fn start_values(terms: &Terms<'_>) -> Vec<f64> {
    let mut values = vec![0.0; terms.count];
    for term in terms.all.iter().filter(|term| term.has_shape()) {
        values[term.first + term.linear] = term.typical()[term.linear];
    }
    values
}

/// Normal prior with zero mean for the linear parameters of one effect (model.md (23)).
#[derive(Clone)]
pub(crate) struct Prior {
    /// Index of the first parameter of the effect in the parameter vector.
    pub(crate) first: usize,
    /// Typical size of each parameter.
    pub(crate) typical: Vec<f64>,
    /// Standard deviation of the prior, in units of the typical sizes.
    pub(crate) width: f64,
}

impl Prior {
    /// Updates the width (standard deviation) of the prior from the estimated parameters and their covariance. Repeated
    /// updates maximise the evidence (marginal likelihood, model.md (23)). If the data hardly determine the effect, the
    /// width stays unchanged.
    pub(super) fn widen(&mut self, parameters: &[f64], covariance: &Mat<f64>) {
        let (mut square, mut seen) = (0.0, 0.0);
        for (k, typical) in self.typical.iter().enumerate() {
            let p = self.first + k;
            square += (parameters[p] / typical).powi(2);
            seen += 1.0 - covariance[(p, p)] / (self.width * typical).powi(2);
        }
        // The width is at least one, so that the prior does not exclude effects of typical size.
        self.width = if seen > 1e-3 { (square / seen).sqrt().max(1.0) } else { self.width };
    }
}

/// Normal prior of the logarithm of a time constant.
#[derive(Clone)]
pub(crate) struct ShapePrior {
    /// Index of the time constant in the parameter vector.
    pub(super) place: usize,
    /// Value at which the prior is centred, s.
    pub(super) centre: f64,
}

impl ShapePrior {
    /// Standard deviation of the logarithm of the time constant. It is ln 10, so values up to a factor of 10 above or
    /// below the centre are plausible. The prior is needed because the data do not determine an extreme time constant.
    /// If the time constant is far longer than the recording, the effect acts as a drift. If it is far shorter than the
    /// first rest, the effect decays before it noticeably changes the mean of a rest.
    const WIDTH: f64 = std::f64::consts::LN_10;

    /// Residual of the prior at a value of the time constant, in standard deviations of the prior, and the derivative
    /// of the residual. If the value is not positive, the residual is NaN, and the solver takes a shorter step.
    pub(super) fn residual(&self, value: f64) -> (f64, f64) {
        ((value / self.centre).ln() / Self::WIDTH, 1.0 / (value * Self::WIDTH))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_prior_is_as_wide_as_the_directions_that_are_seen() {
        let mut prior = Prior { first: 0, typical: vec![0.1; 3], width: 100.0 };
        // The third parameter is determined only by the prior.
        let found = Mat::from_fn(3, 3, |i, j| {
            if i != j {
                0.0
            } else if i < 2 {
                1e-6
            } else {
                100.0
            }
        });
        prior.widen(&[3.0, -4.0, 0.0], &found);
        assert!((prior.width - (0.5 * 2500.0_f64).sqrt()).abs() < 1e-6, "{}", prior.width);
    }
}
