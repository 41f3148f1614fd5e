//! Effects that a fit estimates in addition to the base parameters (biases and sensitivities of both sensors), and the
//! kinds of residuals that the fit uses.

use imucal_core::effects::{Effect, Need, Sensor};

/// An effect of the catalogue that a fit estimates.
#[derive(Clone, Copy, Debug)]
pub struct EffectChoice {
    /// Entry of the effect in the catalogue.
    pub effect: &'static Effect<f64>,
    /// Number of parameters to be estimated. It selects one of the forms of the effect, which differ in their number of
    /// parameters ([`Effect::has_form`]).
    pub parameters: usize,
}

impl EffectChoice {
    /// The plain form of an effect, with the fewest parameters.
    pub fn plain(effect: &'static Effect<f64>) -> Self {
        Self { effect, parameters: effect.plain }
    }

    /// The effect as a candidate of a search for effects. An effect of the temperature has its full form, because the
    /// search itself selects the degree of the polynomial in the temperature. Any other effect has its plain form.
    pub fn candidate(effect: &'static Effect<f64>) -> Self {
        if effect.needs.contains(&Need::Temperature) { Self::full(effect) } else { Self::plain(effect) }
    }

    /// The full form of an effect, with all parameters.
    pub fn full(effect: &'static Effect<f64>) -> Self {
        Self { effect, parameters: effect.parameters.len() }
    }
}

/// User-defined effect, given by the derivatives of the sensor reading with respect to its parameters, at every sample.
#[derive(Clone, Debug)]
pub struct UserField<'a> {
    /// Name of the effect, used in messages and results.
    pub name: &'a str,
    /// Sensor on which the effect acts.
    pub sensor: Sensor,
    /// Typical size of each parameter, in SI units.
    pub typical: Vec<f64>,
    /// Derivatives of the sensor reading with respect to the parameters, one slice per recording. Each slice has the
    /// shape (N, 3, p) in C order: sample, axis, parameter.
    pub columns: Vec<&'a [f64]>,
}

/// Kinds of residuals that a fit may use in addition to the three kinds of every fit: force norms at rests, mean rates
/// at rests, and gravity directions after moves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Kinds {
    /// Whether the fit uses the specific force inside the moves (model.md (20)).
    pub in_motion: bool,
    /// Whether the fit uses the encoder angles of a stand (model.md (21)). It then also estimates the parameters of the
    /// stand.
    pub encoders: bool,
}

impl Kinds {
    /// Returns the additional kinds of residuals without which the effects `choices` are not observable.
    pub(crate) fn needed_by(choices: &[EffectChoice]) -> Self {
        Self {
            in_motion: choices.iter().any(|choice| choice.effect.needs.contains(&Need::AngularAcceleration)),
            encoders: choices.iter().any(|choice| choice.effect.sensor == Sensor::Encoder),
        }
    }

    /// The kinds that are in `self` or in `other`.
    pub(crate) fn union(self, other: Self) -> Self {
        Self { in_motion: self.in_motion || other.in_motion, encoders: self.encoders || other.encoders }
    }

    /// Whether the fit uses residuals inside the moves. These are residuals of the specific force, or of the attitude
    /// relative to the stand.
    pub(super) fn look_inside(self) -> bool {
        self.in_motion || self.encoders
    }
}
