//! User-defined effects: functions of the corrected rate and force that only the caller can evaluate.
//!
//! The field of a user-defined effect contains the derivatives of the sensor reading with respect to the parameters of
//! the effect. The field may depend on the corrected rate and force, and thus on the calibration. The calibration is in
//! turn estimated with the field. Therefore the fit and the evaluation of the field alternate until the field no longer
//! changes.

use imucal_core::effects::Sensor;

use super::{Checked, ModelOptions, Outcome, UserField, WarmStart};
use crate::error::Error;
use crate::numerics::lsq::Termination;
use crate::verdict::RecordingSet;

/// Maximum number of fits until the fields converge. In each further fit, a field changes by only a few per cent of its
/// change in the previous fit. This share is about the size of the effects relative to the reading.
const MAX_FITS: usize = 20;
/// A field has converged if the last repetition changed each of its values by at most this fraction of its largest
/// value. The relative change of the parameters is then also about this fraction.
const SETTLED: f64 = 1e-7;

/// The field of a user-defined effect at every sample of the recordings of a unit. It contains the derivatives of the
/// sensor reading with respect to the parameters of the effect.
#[derive(Clone, Debug)]
pub struct SampledField {
    /// Name of the effect.
    pub name: String,
    /// The triad on which the effect acts.
    pub sensor: Sensor,
    /// Typical size of each of the p parameters of the effect, SI units.
    pub typical: Vec<f64>,
    /// For each recording, an array (N, 3, p) in C order: the derivatives of the rate or force at N samples along the
    /// three body axes with respect to the p parameters of the effect.
    pub columns: Vec<Vec<f64>>,
}

/// Corrected angular rate, rad/s, and specific force, m/s^2, of every sample of one recording, body frame.
pub type CorrectedSamples = (Vec<[f64; 3]>, Vec<[f64; 3]>);

/// Corrected rates and forces of a set of recordings, for comparison of two calibrations. The raw samples are averaged
/// over consecutive intervals of 0.1 s ([`BriefMeans`](crate::gap::BriefMeans)), and both calibrations correct these
/// means.
#[derive(Clone, Debug)]
pub struct BriefCorrection {
    /// For each recording, the means corrected by the first calibration.
    pub before: Vec<CorrectedSamples>,
    /// For each recording, the means corrected by the second calibration.
    pub after: Vec<CorrectedSamples>,
    /// Fields of the second calibration's user-defined effects at these means, in the order of the effects in this
    /// calibration.
    pub fields: Vec<SampledField>,
}

/// Evaluation of user-defined effects, implemented by the caller.
pub trait UserEffects {
    /// Names of the effects.
    fn names(&self) -> &[String];

    /// Evaluates the fields of the named effects at every sample of the calibration recordings. The fields are
    /// evaluated at the rate and force after correction by the calibration `outcome`.
    ///
    /// # Errors
    /// Any error of the caller. It ends the calculation that requested the fields.
    fn fields(&self, names: &[String], outcome: &Outcome) -> Result<Vec<SampledField>, Error>;

    /// Returns the rates and forces of a set of recordings, corrected by the calibration `outcome`. The correction
    /// includes the user-defined effects.
    ///
    /// # Errors
    /// The errors are those of [`UserEffects::fields`].
    fn corrected(&self, outcome: &Outcome, set: RecordingSet) -> Result<Vec<CorrectedSamples>, Error>;

    /// Computes means of the samples of a set of recordings over intervals of 0.1 s, and corrects the means by two
    /// calibrations. The second calibration is `after`. The first is the reference calibration that the caller has set,
    /// or `before` if the caller has set none.
    ///
    /// # Errors
    /// The errors are those of [`UserEffects::fields`].
    fn brief_means(&self, before: &Outcome, after: &Outcome, set: RecordingSet) -> Result<BriefCorrection, Error>;
}

impl SampledField {
    fn view(&self) -> UserField<'_> {
        UserField {
            name: &self.name,
            sensor: self.sensor,
            typical: self.typical.clone(),
            columns: self.columns.iter().map(Vec::as_slice).collect(),
        }
    }
}

/// Converts sampled fields to user-defined effects for [`ModelOptions`].
pub(crate) fn views(fields: &[SampledField]) -> Vec<UserField<'_>> {
    fields.iter().map(SampledField::view).collect()
}

impl Checked<'_> {
    /// Calibrates like [`Checked::calibrate`], with the user-defined effects `names` in the model. The fit and the
    /// evaluation of their fields alternate until the fields no longer change.
    ///
    /// # Errors
    /// The errors of [`Checked::calibrate`] and of `user_effects`. If the fields do not converge, this is no error, but
    /// the verdict of the result is `poor`.
    pub fn calibrate_with(
        &self,
        model: &ModelOptions<'_>,
        user_effects: &dyn UserEffects,
        names: &[String],
        warm_start: Option<&WarmStart>,
    ) -> Result<Outcome, Error> {
        let mut outcome = self.calibrate(model, warm_start)?;
        if names.is_empty() {
            return Ok(outcome);
        }
        let mut last: Vec<SampledField> = Vec::new();
        for _ in 0..MAX_FITS {
            let fields = user_effects.fields(names, &outcome)?;
            if !last.is_empty() && have_settled(&last, &fields) {
                return Ok(outcome);
            }
            outcome = self.calibrate(&ModelOptions { user_fields: views(&fields), ..model.clone() }, warm_start)?;
            last = fields;
        }
        if let Some(report) = outcome.joint_fit.as_mut().filter(|report| report.termination == Termination::Converged) {
            report.termination = Termination::FieldsNotSettled;
        }
        Ok(outcome)
    }
}

fn have_settled(before: &[SampledField], after: &[SampledField]) -> bool {
    let columns = |fields: &[SampledField]| fields.iter().flat_map(|field| field.columns.clone()).collect::<Vec<_>>();
    columns(before).iter().zip(&columns(after)).all(|(old, new)| {
        let change = largest(old.iter().zip(new).map(|(old, new)| new - old));
        change <= SETTLED * largest(new.iter().copied())
    })
}

/// The largest absolute value; NaN if any value is NaN.
fn largest(values: impl Iterator<Item = f64>) -> f64 {
    values.fold(0.0, |most: f64, value| if value.is_nan() || value.abs() > most { value.abs() } else { most })
}
