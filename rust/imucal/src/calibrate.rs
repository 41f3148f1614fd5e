//! Calibration of a unit from its recordings, in six steps. First, the recordings are checked. Second, the rests are
//! detected. Third, the accelerometer is fitted to the rests. Fourth, the gyroscope is fitted, with gravity propagated
//! from rest to rest. Fifth, all parameters are fitted jointly. Sixth, the uncertainty of the result is determined.

mod accelerometer_alone;
mod checked;
mod control;
mod cross_validation;
mod design;
pub mod diagnosis;
mod held_estimates;
mod jointly;
mod mean_readings;
mod offer;
mod outcome;
mod prospect;
mod references;
mod several_units;
mod two_stages;
mod unit_data;
mod user_effects;
mod verdict;

#[cfg(test)]
mod passes;

pub use imucal_core::STANDARD_GRAVITY_MPS2;
use imucal_core::effects::Need;
#[cfg(test)]
use imucal_core::sensor::Triad;

use crate::error::Error;
use crate::frame::Frame;
use crate::held::Priors;
use crate::joint::Prepared;
pub use crate::joint::WarmStart;
pub use crate::joint::{BiasWander, EffectChoice, Kinds, Misfit, ResidualScales, TermEstimate, UnitWander, UserField};

pub use crate::parameters::{parameter_names, parameter_values};
use crate::recording::Recording;
pub use accelerometer_alone::{AccelerometerOutcome, calibrate_accelerometer};
pub use checked::Checked;
pub use control::{require_independent, rest_ranges};
pub use cross_validation::CrossValidation;
pub use held_estimates::HeldEstimate;
pub use mean_readings::{MeanNoise, MeanReadings, RestBias, calibrate_means};
pub use outcome::Outcome;
pub use prospect::{Prospect, prospect};
pub use references::References;
pub(crate) use user_effects::views;
pub use user_effects::{BriefCorrection, CorrectedSamples, SampledField, UserEffects};

/// Accepted range of local gravity, m/s^2. Gravity is 9.76 on the highest mountains of the tropics and 9.83 at the
/// poles. The range has a margin on both sides.
pub const GRAVITY_ON_EARTH_MPS2: [f64; 2] = [9.7, 9.9];

/// Default maximum number of iterations of a joint fit. The fit is repeated with updated weights, and the maximum
/// applies to the sum over all repetitions. Fits that converge need 5 to 100 iterations.
pub const MAX_ITERATIONS: u64 = 1000;

/// Options of a calibration.
#[derive(Clone, Debug)]
pub struct Options<'a> {
    /// Local gravity, m/s^2. The estimated sensitivity of every accelerometer axis is inversely proportional to this
    /// value.
    pub gravity_mps2: f64,
    /// Standard deviations of local gravity and of the clock rate. They change the stated uncertainties of the
    /// parameters, but not the estimates.
    pub references: References,
    /// Body frame of the result.
    pub frame: Frame,
    /// Minimum duration of a rest, s.
    pub min_rest_s: f64,
    /// Whether rests and moves with saturated samples are excluded. If false, a recording with saturated samples is an
    /// error.
    pub exclude_saturated: bool,
    /// Nominal sensitivity of an accelerometer that outputs counts, lsb per m/s^2. If `None`, the start values of the
    /// fit are estimated from the data.
    pub accel_nominal: Option<f64>,
    /// Nominal sensitivity of a gyroscope that outputs counts, lsb per rad/s. If `None`, the start values of the fit
    /// are estimated from the data.
    pub gyro_nominal: Option<f64>,
    /// Priors of parameters. If there is any prior, a calibration of both sensors uses the joint fit, even if `joint`
    /// is false.
    pub priors: Priors,
    /// Whether all parameters are estimated in a joint fit. If false, the result is from the two-stage fit: first the
    /// accelerometer from the rests, then the gyroscope from the moves. The two-stage fit does not support effects.
    pub joint: bool,
    /// Known bias instability and random walk of the biases. If `None`, the accelerometer biases are assumed to be
    /// constant, and the bias instability of the gyroscope is estimated from the scatter of its mean rates at the
    /// rests.
    pub wander: Option<UnitWander>,
    /// Effects of the catalogue ([`Effect`](imucal_core::effects::Effect)) that are estimated together with the base
    /// parameters (biases and sensitivities).
    pub effects: Vec<EffectChoice>,
    /// Names of effects that are estimated even if the data determine only some linear combinations of their
    /// parameters. A prior determines the other linear combinations.
    pub partly: Vec<String>,
    /// User-defined effects. Each effect is given by the derivatives of the sensor reading with respect to the
    /// parameters of the effect, at every sample. These derivatives are the field of the effect.
    pub user_fields: Vec<UserField<'a>>,
    /// Additional kinds of residuals (specific force during moves, encoder angles of a stand) that the fit uses even if
    /// its effects are observable without them.
    pub kinds: Kinds,
    /// Number of folds of a cross-validation; `None` without a cross-validation. For each fold, a fit is made without
    /// every `folds`-th move and rest. This fit predicts the omitted moves and rests.
    pub folds: Option<usize>,
    /// Maximum number of iterations of the joint fit, summed over all repetitions of the fit with updated weights. If a
    /// fit reaches this number before it converges, the verdict is `poor`.
    pub max_iterations: u64,
}

/// Options of one fit to checked recordings ([`Checked`]): the effects in the model, and the folds of a
/// cross-validation.
#[derive(Clone, Debug, Default)]
pub struct ModelOptions<'a> {
    /// Effects of the catalogue ([`Effect`](imucal_core::effects::Effect)) that are estimated together with the base
    /// parameters (biases and sensitivities).
    pub effects: Vec<EffectChoice>,
    /// Names of effects that are estimated even if the data determine only some linear combinations of their
    /// parameters. A prior determines the other linear combinations.
    pub partly: Vec<String>,
    /// User-defined effects. Each effect is given by the derivatives of the sensor reading with respect to the
    /// parameters of the effect, at every sample. These derivatives are the field of the effect.
    pub user_fields: Vec<UserField<'a>>,
    /// Additional kinds of residuals (specific force during moves, encoder angles of a stand) that the fit uses even if
    /// its effects are observable without them.
    pub kinds: Kinds,
    /// Number of folds of a cross-validation; `None` without a cross-validation. For each fold, a fit is made without
    /// every `folds`-th move and rest. This fit predicts the omitted moves and rests.
    pub folds: Option<usize>,
}

impl<'a> Options<'a> {
    /// A copy of these options without the model options (effects and folds). Effects and priors require the joint fit,
    /// so the copy has `joint` set if these options contain any of them.
    fn without_model(&self) -> Options<'static> {
        let Self {
            gravity_mps2,
            references,
            frame,
            min_rest_s,
            exclude_saturated,
            accel_nominal,
            gyro_nominal,
            priors,
            wander,
            max_iterations,
            ..
        } = self.clone();
        Options {
            gravity_mps2,
            references,
            frame,
            min_rest_s,
            exclude_saturated,
            accel_nominal,
            gyro_nominal,
            priors,
            joint: self.is_joint(),
            wander,
            max_iterations,
            ..Options::default()
        }
    }

    /// The options that describe the model to be fitted.
    pub fn model(&self) -> ModelOptions<'a> {
        let Self { effects, partly, user_fields, kinds, folds, .. } = self.clone();
        ModelOptions { effects, partly, user_fields, kinds, folds }
    }

    /// A copy of these options in which `model` replaces the model options.
    fn with_model<'b>(&self, model: &ModelOptions<'b>) -> Options<'b>
    where
        'a: 'b,
    {
        let ModelOptions { effects, partly, user_fields, kinds, folds } = model.clone();
        Options { effects, partly, user_fields, kinds, folds, ..self.clone() }
    }
}

impl Options<'_> {
    /// Returns an error for an invalid combination of model options.
    fn check_model(&self) -> Result<(), Error> {
        if let Some(folds) = self.folds.filter(|folds| *folds < 2) {
            return Err(Error::Input(format!("folds = {folds}: at least 2 are needed to leave moves out")));
        }
        if self.frame != Frame::Symmetric && self.has_effects() {
            return Err(Error::Input(
                "effects are defined in the symmetric body frame: leave frame at symmetric, or estimate no effects"
                    .into(),
            ));
        }
        Ok(())
    }

    /// Whether the result is from the joint fit. Effects, priors and additional kinds of residuals require this fit.
    fn is_joint(&self) -> bool {
        self.joint || self.has_effects() || self.kinds != Kinds::default() || !self.priors.is_empty()
    }

    /// Whether the readings of a sensor may drift during a rest, because a requested effect depends on time or
    /// temperature. A user-defined effect is assumed to depend on both.
    fn may_drift(&self) -> bool {
        let drifts = |choice: &EffectChoice| {
            choice.effect.needs.iter().any(|need| matches!(need, Need::Time | Need::Temperature))
        };
        self.effects.iter().any(drifts) || !self.user_fields.is_empty()
    }

    /// The additional kinds of residuals that the fit uses: those that its effects need, and those that were requested.
    fn kinds(&self) -> Kinds {
        Kinds::needed_by(&self.effects).union(self.kinds)
    }

    fn has_effects(&self) -> bool {
        !self.effects.is_empty() || !self.user_fields.is_empty()
    }
}

impl Default for Options<'_> {
    fn default() -> Self {
        Self {
            gravity_mps2: STANDARD_GRAVITY_MPS2,
            references: References::default(),
            frame: Frame::Symmetric,
            min_rest_s: crate::rests::MIN_REST_S,
            exclude_saturated: false,
            accel_nominal: None,
            gyro_nominal: None,
            priors: Priors::default(),
            joint: true,
            wander: None,
            effects: Vec::new(),
            partly: Vec::new(),
            user_fields: Vec::new(),
            kinds: Kinds::default(),
            folds: None,
            max_iterations: MAX_ITERATIONS,
        }
    }
}

/// Calibrates one unit from one or more recordings.
///
/// # Errors
/// * [`Error::Input`] for invalid options.
/// * [`Error::Data`] lists faults that would make the result wrong.
/// * [`Error::NotEnoughMotion`] names the parameters that are not determined and the motion to add.
/// * [`Error::Fit`] if a fit has no usable result.
pub fn calibrate(recordings: &[Recording<'_>], options: &Options<'_>) -> Result<Outcome, Error> {
    Checked::try_new(recordings, options)?.calibrate(&options.model(), None)
}

/// For tests: checks the recordings, and then calls [`Checked::prepare`] with the temperatures of these recordings.
#[cfg(test)]
pub(crate) fn prepare<T>(
    recordings: &[Recording<'_>],
    kinds: Kinds,
    work: impl FnOnce(&Prepared<'_>, &Triad<f64>, &Triad<f64>) -> Result<T, Error>,
) -> Result<T, Error> {
    let degc: Vec<_> = recordings.iter().map(|recording| recording.temperature_degc.map(<[f64]>::to_vec)).collect();
    Checked::try_new(recordings, &Options::default())?.prepare(&degc, kinds, work)
}

/// Returns an error for invalid combinations of recordings and options.
fn check_options(recordings: &[Recording<'_>], options: &Options<'_>) -> Result<(), Error> {
    let Some(first) = recordings.first() else {
        return Err(Error::Input("no recording was given".into()));
    };
    if let Some(other) = recordings.iter().find(|r| (r.accel_unit, r.gyro_unit) != (first.accel_unit, first.gyro_unit))
    {
        return Err(Error::Input(format!(
            "{} and {} are in different raw units: recordings of one unit must agree",
            first.name, other.name
        )));
    }
    options.check_model()?;
    if options.max_iterations == 0 {
        return Err(Error::Input("max_iterations = 0: a fit needs at least one iteration".into()));
    }
    options.references.check()?;
    options.wander.as_ref().map_or(Ok(()), UnitWander::check)?;
    // The data cannot distinguish a wrong value of gravity from a wrong accelerometer scale. Therefore a value of
    // gravity that does not occur on Earth is refused here.
    let [least, most] = GRAVITY_ON_EARTH_MPS2;
    if !(options.gravity_mps2 >= least && options.gravity_mps2 <= most) {
        return Err(Error::Input(format!(
            "gravity_mps2 = {}: on Earth gravity is between {least} and {most} m/s^2, give that of your place or leave \
             {STANDARD_GRAVITY_MPS2}",
            options.gravity_mps2
        )));
    }
    for (name, nominal) in [("accel_nominal", options.accel_nominal), ("gyro_nominal", options.gyro_nominal)] {
        if let Some(value) = nominal
            && !(value.is_finite() && value > 0.0)
        {
            return Err(Error::Input(format!("{name} = {value}: give lsb per SI unit, a positive number")));
        }
    }
    Ok(())
}
