//! The terms of a fit are the effects that it estimates in addition to the base parameters (biases and sensitivities).
//! An effect is from the catalogue, or user-defined by its derivatives at every sample.
//!
//! ```text
//! seen = true + sum_c Phi_c(true) theta_c,   true = seen - sum_c Phi_c(true) theta_c        model.md (15), (16)
//! ```
//!
//! `seen` is the rate or force computed from the reading with the sensitivity and the bias only, without the effects.
//! `true` is the true rate or force. The column Phi_c is the derivative of `seen` with respect to the parameter
//! theta_c. The parameters of a term are consecutive in the parameter vector. The last parameter may be a nonlinear
//! shape parameter, for example a time constant. The column of a shape parameter is `d(Phi theta)/d(shape)`.

use std::borrow::Cow;

use imucal_core::effects::{Columns, Effect, MAX_PARAMETERS, Need, Sensor, State};
use nalgebra::Vector3;

use super::choices::{EffectChoice, Kinds, UserField};
use super::histories::{Sample, SharedHistories, TemperatureHistories};
use crate::error::Error;
use crate::parameters::{BASE, STAND_PARAMETERS};
use crate::recording::Recording;

/// Step of the central difference with respect to a shape parameter (time constant), as a fraction of its value. The
/// relative error of the derivative is about the square of this step.
const SHAPE_STEP: f64 = 1e-4;

/// One effect of a fit, from the catalogue or user-defined.
#[derive(Clone, Debug)]
pub(crate) struct Term<'a> {
    pub(super) kind: Kind<'a>,
    pub(crate) sensor: Sensor,
    /// Number of linear parameters.
    pub(crate) linear: usize,
    /// Index of the first parameter of this term among the parameters of all terms.
    pub(crate) first: usize,
    /// Whether the fit may use a prior if the recordings do not determine all parameters of the effect.
    pub(crate) partly: bool,
    /// Temperature histories at the time constant of this term; `None` before [`Terms::with_histories`] is called, and
    /// if the term does not depend on them.
    pub(super) histories: Option<TemperatureHistories>,
    /// Derivatives of the temperature histories with respect to the time constant, if the time constant is estimated.
    pub(super) by_time_constant: Option<TemperatureHistories>,
}

#[derive(Clone, Debug)]
pub(super) enum Kind<'a> {
    Catalogue(&'static Effect<f64>),
    /// Catalogue effect with a fixed shape parameter (time constant).
    Frozen(&'static Effect<f64>, f64),
    User(&'a UserField<'a>),
}

impl Term<'_> {
    pub(crate) fn name(&self) -> &str {
        match self.kind {
            Kind::Catalogue(effect) | Kind::Frozen(effect, _) => effect.name,
            Kind::User(field) => field.name,
        }
    }

    /// Description of the effect in the catalogue; `None` for a user-defined effect.
    pub(crate) fn effect(&self) -> Option<&'static Effect<f64>> {
        match self.kind {
            Kind::Catalogue(effect) | Kind::Frozen(effect, _) => Some(effect),
            Kind::User(_) => None,
        }
    }

    /// Value of the fixed shape parameter (time constant); `None` if it is estimated or if the effect has none.
    pub(crate) fn frozen_shape(&self) -> Option<f64> {
        match self.kind {
            Kind::Frozen(_, shape) => Some(shape),
            _ => None,
        }
    }

    pub(crate) fn has_shape(&self) -> bool {
        matches!(self.kind, Kind::Catalogue(effect) if effect.shape.is_some())
    }

    /// Computes the derivatives of the sensor reading with respect to the parameters of this term at `state`. They are
    /// written to the first entries of `own`, a buffer of [`MAX_PARAMETERS`] vectors.
    #[inline]
    pub(super) fn columns_at(&self, values: &[f64], state: &State<f64>, sample: Sample, own: &mut [Vector3<f64>]) {
        match self.kind {
            Kind::User(field) => {
                let p = self.linear;
                let row = &field.columns[sample.recording][3 * p * sample.index..3 * p * (sample.index + 1)];
                for (k, column) in own[..p].iter_mut().enumerate() {
                    *column = Vector3::new(row[k], row[p + k], row[2 * p + k]);
                }
            }
            Kind::Frozen(effect, shape) => set_field(effect, state, self.histories.as_ref(), sample, shape, own),
            Kind::Catalogue(effect) if effect.shape.is_some() => {
                let (linear, shape) = values[self.first..=self.first + self.linear].split_at(self.linear);
                set_field(effect, state, self.histories.as_ref(), sample, shape[0], own);
                own[self.linear] = self.shape_column(effect, linear, shape[0], state, sample);
            }
            Kind::Catalogue(effect) => set_field(effect, state, self.histories.as_ref(), sample, 1.0, own),
        }
    }

    /// Computes the derivative `d(Phi theta)/d(shape)` of an effect with respect to its shape parameter.
    fn shape_column(
        &self,
        effect: &Effect<f64>,
        linear: &[f64],
        shape: f64,
        state: &State<f64>,
        sample: Sample,
    ) -> Vector3<f64> {
        let sum = |shape: f64, histories: Option<&TemperatureHistories>| {
            let mut columns: Columns<f64> = [Vector3::zeros(); MAX_PARAMETERS];
            set_field(effect, state, histories, sample, shape, &mut columns);
            columns.iter().zip(linear).map(|(column, value)| column * *value).sum::<Vector3<f64>>()
        };
        // The field Phi is linear in the temperature history. Its derivative with respect to the time constant is
        // therefore the field at the derivative of the history.
        if self.by_time_constant.is_some() {
            return sum(shape, self.by_time_constant.as_ref());
        }
        let step = SHAPE_STEP * shape;
        (sum(shape + step, None) - sum(shape - step, None)) / (2.0 * step)
    }

    /// Whether the term may vary during a rest, because it depends on time or on a known temperature.
    pub(super) fn changes_at_rest(&self, temperature_is_known: bool) -> bool {
        self.needs(Need::Time) || (temperature_is_known && self.needs(Need::Temperature))
    }

    /// Whether the term depends on the quantity `need`, for example temperature or attitude.
    pub(super) fn needs(&self, need: Need) -> bool {
        self.effect().is_some_and(|effect| effect.needs.contains(&need))
    }

    /// Whether the term depends on the true value of the quantity that `sensor` measures.
    pub(super) fn reads(&self, sensor: Sensor) -> bool {
        self.effect().is_some_and(|effect| effect.reads.contains(&sensor))
    }

    /// Number of linear parameters of each form of the effect, from the plain form (with the fewest parameters) to the
    /// form of this term.
    pub(crate) fn forms(&self) -> impl Iterator<Item = usize> {
        let plain = self.effect().map_or(self.linear, |effect| effect.plain);
        (plain..=self.linear).step_by(plain.max(1))
    }

    /// Number of parameters, including an estimated shape parameter.
    pub(crate) fn count(&self) -> usize {
        self.linear + usize::from(self.has_shape())
    }

    /// Names `<effect>_<parameter>` of all parameters. The parameters of a user-defined effect are numbered from 0.
    pub(crate) fn parameter_names(&self) -> Vec<String> {
        let full = |name: &str| format!("{}_{name}", self.name());
        match self.kind {
            Kind::User(_) => (0..self.linear).map(|k| full(&k.to_string())).collect(),
            Kind::Catalogue(effect) | Kind::Frozen(effect, _) => {
                effect.parameters[..self.linear].iter().chain(&effect.shape).map(|p| full(p.name)).collect()
            }
        }
    }

    /// Typical size of each parameter in a MEMS sensor. The shape parameter (time constant) is last.
    pub(crate) fn typical(&self) -> Vec<f64> {
        match self.kind {
            Kind::User(field) => field.typical.clone(),
            Kind::Catalogue(effect) => effect.parameters[..self.linear]
                .iter()
                .chain(&effect.shape)
                .map(|parameter| parameter.typical)
                .collect(),
            Kind::Frozen(effect, _) => effect.parameters[..self.linear].iter().map(|p| p.typical).collect(),
        }
    }
}

/// All terms of a fit, in the order of their parameters.
#[derive(Clone, Debug)]
pub(crate) struct Terms<'a> {
    pub(crate) all: Vec<Term<'a>>,
    /// Number of parameters of all terms.
    pub(crate) count: usize,
    /// For each parameter, the sensor on which it acts.
    pub(crate) sensors: Vec<Sensor>,
    /// Residuals that the fit uses in addition to those of every fit: force norms at rests, mean rates at rests, and
    /// gravity directions after moves.
    pub(crate) kinds: Kinds,
}

/// Terms that act on one sensor, with consecutive parameters.
pub(super) struct SideBySide<'a> {
    /// The terms. Their parameters are numbered from 0 within this set.
    pub(super) terms: Terms<'a>,
    /// Values of the parameters of these terms. `places` contains the index of each parameter among the parameters of
    /// all terms.
    pub(super) values: Vec<f64>,
    pub(super) places: Vec<usize>,
}

impl<'a> Terms<'a> {
    pub(crate) fn try_new(
        choices: &[EffectChoice],
        fields: &'a [UserField<'a>],
        samples: &[usize],
        kinds: Kinds,
    ) -> Result<Self, Error> {
        let mut terms = Self { all: Vec::new(), count: 0, sensors: Vec::new(), kinds };
        for choice in choices {
            terms.push(Kind::Catalogue(choice.effect), choice.effect.sensor, choice.parameters)?;
        }
        for field in fields {
            let width = 3 * field.typical.len();
            let fits = field.columns.len() == samples.len()
                && field.columns.iter().zip(samples).all(|(columns, samples)| columns.len() == samples * width);
            if !fits || width == 0 || field.typical.len() > MAX_PARAMETERS {
                return Err(Error::Input(format!(
                    "the field of {} does not have (samples, 3, {}) numbers for each recording, with 1 to {MAX_PARAMETERS} \
                     parameters",
                    field.name,
                    field.typical.len()
                )));
            }
            terms.push(Kind::User(field), field.sensor, field.typical.len())?;
        }
        Ok(terms)
    }

    /// Adds a catalogue effect with a fixed shape parameter (time constant). One effect may be added several times with
    /// different values of its shape parameter.
    pub(crate) fn push_frozen(&mut self, effect: &'static Effect<f64>, shape: f64) -> Result<(), Error> {
        self.push(Kind::Frozen(effect, shape), effect.sensor, effect.plain)
    }

    /// Permits a prior for these effects. The prior is used if the recordings determine the parameters only in some
    /// directions.
    pub(crate) fn allow_partly(&mut self, names: &[String]) {
        for term in &mut self.all {
            term.partly = names.iter().any(|name| name == term.name());
        }
    }

    fn push(&mut self, kind: Kind<'a>, sensor: Sensor, linear: usize) -> Result<(), Error> {
        let (first, partly) = (self.count, false);
        let term = Term { kind, sensor, linear, first, partly, histories: None, by_time_constant: None };
        let twice = |other: &Term<'_>| other.name() == term.name() && other.frozen_shape().is_none();
        if self.all.iter().any(twice) {
            return Err(Error::Input(format!("{} is requested twice: name each effect once", term.name())));
        }
        self.count += term.count();
        self.sensors.resize(self.count, sensor);
        self.all.push(term);
        Ok(())
    }

    /// Buffer for the derivatives of the sensor readings with respect to the parameters of all terms. Each term writes
    /// the derivatives of its full form. If fewer parameters are estimated, the next term overwrites the superfluous
    /// derivatives.
    pub(super) fn room(&self) -> Vec<Vector3<f64>> {
        vec![Vector3::zeros(); self.count + MAX_PARAMETERS]
    }

    /// Computes the derivative of the sensor readings with respect to each parameter at the true state `state`. `room`
    /// is a buffer from [`Self::room`]. Its entries after the last parameter are undefined.
    #[inline]
    pub(super) fn columns_at(&self, values: &[f64], state: &State<f64>, sample: Sample, room: &mut [Vector3<f64>]) {
        for term in &self.all {
            term.columns_at(values, state, sample, &mut room[term.first..term.first + MAX_PARAMETERS]);
        }
    }

    /// Sum of the contributions of the terms that act on `sensor` (gyroscope rad/s, accelerometer m/s^2, encoders rad).
    #[inline]
    pub(super) fn sum_of(&self, sensor: Sensor, values: &[f64], columns: &[Vector3<f64>]) -> Vector3<f64> {
        let mut sum = Vector3::zeros();
        for term in self.all.iter().filter(|term| term.sensor == sensor) {
            for p in term.first..term.first + term.linear {
                sum += columns[p] * values[p];
            }
        }
        sum
    }

    /// Total contributions of all terms to the angular rate (rad/s) and to the specific force (m/s^2).
    #[inline]
    pub(super) fn sums(&self, values: &[f64], columns: &[Vector3<f64>]) -> (Vector3<f64>, Vector3<f64>) {
        (self.sum_of(Sensor::Gyroscope, values, columns), self.sum_of(Sensor::Accelerometer, values, columns))
    }

    /// Number of all parameters: base parameters, parameters of the terms, and parameters of the stand if encoders are
    /// used.
    pub(crate) fn total(&self) -> usize {
        BASE + self.count + if self.kinds.encoders { STAND_PARAMETERS } else { 0 }
    }

    /// The terms with at least one nonzero parameter.
    pub(crate) fn active(&self, values: &[f64]) -> Self {
        let is_active =
            |term: &&Term<'_>| values[term.first..term.first + term.linear].iter().any(|value| *value != 0.0);
        Self { all: self.all.iter().filter(is_active).cloned().collect(), ..self.clone() }
    }

    /// The terms that act on one sensor. The indices of their parameters do not change.
    pub(super) fn of(&self, sensor: Sensor) -> Self {
        Self { all: self.all.iter().filter(|term| term.sensor == sensor).cloned().collect(), ..self.clone() }
    }

    /// The terms that act on one sensor. Their parameters get new, consecutive indices.
    pub(super) fn side_by_side(&self, sensor: Sensor, values: &[f64]) -> SideBySide<'a> {
        let mut terms = Self { all: Vec::new(), count: 0, sensors: Vec::new(), kinds: self.kinds };
        for term in self.all.iter().filter(|term| term.sensor == sensor) {
            terms.all.push(Term { first: terms.count, ..term.clone() });
            terms.count += term.count();
        }
        terms.sensors = vec![sensor; terms.count];
        let places: Vec<usize> = self.parameters_of(sensor).collect();
        SideBySide { terms, values: places.iter().map(|p| values[*p]).collect(), places }
    }

    /// Indices of the parameters that act on one sensor.
    pub(super) fn parameters_of(&self, sensor: Sensor) -> impl Iterator<Item = usize> {
        (0..self.count).filter(move |&p| self.sensors[p] == sensor)
    }

    /// Whether any term depends on the true value of the quantity that `sensor` measures.
    pub(super) fn reads(&self, sensor: Sensor) -> bool {
        self.all.iter().any(|term| term.reads(sensor))
    }

    /// Whether any term depends on the quantity `need`.
    pub(crate) fn needs(&self, need: Need) -> bool {
        self.all.iter().any(|term| term.needs(need))
    }
}

impl Terms<'_> {
    /// Returns the terms with the temperature histories of the recordings at the time constants in `values`. Without
    /// the histories, all effects that depend on them are zero.
    pub(super) fn with_histories(
        &self,
        recordings: &[Recording<'_>],
        shared: &SharedHistories,
        values: &[f64],
    ) -> Cow<'_, Self> {
        if !self.needs(Need::TemperatureHistory) {
            return Cow::Borrowed(self);
        }
        let mut terms = self.clone();
        for term in terms.all.iter_mut().filter(|term| term.needs(Need::TemperatureHistory)) {
            if term.has_shape() {
                let tau_s = values[term.first + term.linear];
                term.histories = Some(TemperatureHistories::new(recordings, Some(tau_s)));
                term.by_time_constant = Some(TemperatureHistories::derivative(recordings, tau_s, SHAPE_STEP * tau_s));
            } else {
                term.histories = Some(shared.get(recordings, term.frozen_shape()));
            }
        }
        Cow::Owned(terms)
    }
}

/// Computes the derivatives of the sensor reading with respect to the parameters of a catalogue effect. An effect of
/// the temperature history is evaluated with the history at `sample`. The derivatives are written to the first entries
/// of `room`, which has space for at least [`MAX_PARAMETERS`] vectors.
#[inline]
fn set_field(
    effect: &Effect<f64>,
    state: &State<f64>,
    histories: Option<&TemperatureHistories>,
    sample: Sample,
    shape: f64,
    room: &mut [Vector3<f64>],
) {
    let Some(columns) = room.first_chunk_mut() else { return };
    let Some(histories) = histories else { return effect.field(state, shape, columns) };
    let mut state = *state;
    state.surroundings.temperature_history = histories.at(sample);
    effect.field(&state, shape, columns);
}
