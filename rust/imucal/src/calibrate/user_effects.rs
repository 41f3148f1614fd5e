//! Effects of a user's own: functions of the corrected state that the library cannot evaluate by itself.
//!
//! A user's field may depend on the corrected rate and force, and so on the calibration that is estimated with it. Fit
//! and field are repeated in turn until the field no longer changes.

use imucal_core::effects::Sensor;

use super::{Checked, ModelOptions, Outcome, UserField, WarmStart};
use crate::error::Error;

/// Most fits until the fields have settled. Each one changes a field by the size of the effects, a per cent or so, of
/// the last change.
const MOST_ROUNDS: usize = 20;
/// A field has settled if no number of it changes by more than this share of the largest one: its parameters change by
/// as much.
const SETTLED: f64 = 1e-7;

/// A user's field at every sample of the recordings of a unit.
#[derive(Clone, Debug)]
pub struct SampledField {
    /// Name of the effect.
    pub name: String,
    /// The triad that it acts on.
    pub sensor: Sensor,
    /// Typical size of each of its p parameters, SI units.
    pub typical: Vec<f64>,
    /// For each recording (N, 3, p) in C order: derivatives of true rate or force, body frame, by the parameters.
    pub columns: Vec<Vec<f64>>,
}

/// Corrected angular rate, rad/s, and specific force, m/s^2, of every sample of one recording, body frame.
pub type CorrectedSamples = (Vec<[f64; 3]>, Vec<[f64; 3]>);

/// Which recordings are meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RecordingSet {
    /// Those that the calibration is made of.
    Calibration,
    /// Those that only judge it.
    Control,
}

/// Means over consecutive stretches of 0.1 s of a set of recordings ([`BriefMeans`](crate::gap::BriefMeans)) as two
/// calibrations correct them, in the order of the recordings.
#[derive(Clone, Debug)]
pub struct BriefCorrection {
    /// Corrected by the first calibration.
    pub before: Vec<CorrectedSamples>,
    /// Corrected by the second calibration.
    pub after: Vec<CorrectedSamples>,
    /// Fields of the user's effects of the second calibration at these means, in the order of its effects.
    pub fields: Vec<SampledField>,
}

/// Effects of a user's own.
pub trait UserEffects {
    /// Their names.
    fn names(&self) -> &[String];

    /// Fields of the named effects for the calibration set, at the state that `outcome` corrects it to.
    ///
    /// # Errors
    /// Any error, which ends the work that asked for the fields.
    fn fields(&self, names: &[String], outcome: &Outcome) -> Result<Vec<SampledField>, Error>;

    /// A set of recordings corrected by `outcome`, effects of the user's own included.
    ///
    /// # Errors
    /// As [`UserEffects::fields`].
    fn corrected(&self, outcome: &Outcome, set: RecordingSet) -> Result<Vec<CorrectedSamples>, Error>;

    /// Brief means of a set of recordings, corrected by two calibrations. The first one is the calibration that the
    /// caller compares with, or else `before`.
    ///
    /// # Errors
    /// As [`UserEffects::fields`].
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

/// Fields as a fit takes them.
pub(crate) fn views(fields: &[SampledField]) -> Vec<UserField<'_>> {
    fields.iter().map(SampledField::view).collect()
}

impl Checked<'_> {
    /// As [`Checked::calibrate`], with the named effects of a user's own.
    ///
    /// # Errors
    /// As [`Checked::calibrate`], those of `user_effects`, and [`Error::Fit`] if the fields do not settle.
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
        for _ in 0..MOST_ROUNDS {
            let fields = user_effects.fields(names, &outcome)?;
            if !last.is_empty() && have_settled(&last, &fields) {
                return Ok(outcome);
            }
            outcome = self.calibrate(&ModelOptions { user_fields: views(&fields), ..model.clone() }, warm_start)?;
            last = fields;
        }
        Err(Error::Fit(format!(
            "the field of {} still changes after {MOST_ROUNDS} fits: it depends too much on what it corrects; make it depend \
             less on rate and force",
            names.join(" and ")
        )))
    }
}

fn have_settled(before: &[SampledField], after: &[SampledField]) -> bool {
    let columns = |fields: &[SampledField]| fields.iter().flat_map(|field| field.columns.clone()).collect::<Vec<_>>();
    columns(before).iter().zip(&columns(after)).all(|(old, new)| {
        let change = largest(old.iter().zip(new).map(|(old, new)| new - old));
        change <= SETTLED * largest(new.iter().copied())
    })
}

/// The largest magnitude; NaN if there is one.
fn largest(values: impl Iterator<Item = f64>) -> f64 {
    values.fold(0.0, |most: f64, value| if value.is_nan() || value.abs() > most { value.abs() } else { most })
}
