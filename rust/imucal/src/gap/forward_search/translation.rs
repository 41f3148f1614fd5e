//! Recognises a hand that translated the unit inside the moves (docs/decisions/0059).
//!
//! The specific force inside the moves then contains accelerations that no effect and no hypothesis explains. An error
//! of the unit that no effect and no hypothesis explains leaves residuals there, too. If it is an error of the
//! gyroscope, it also changes the gravity directions after the moves. A translation does not.

use imucal_core::effects::Sensor;

use crate::gap::pattern::BestGeneric;
use crate::gap::stage::Stage;
use crate::joint::{INSIDE, Kinds, MOVE_DIRECTIONS};

/// Smallest chi2 per degree of freedom of the specific force inside moves that is attributed to a hand if a generic
/// hypothesis wins. The accelerations by the hand may have caused the evidence of the hypothesis.
const LEAST_INSIDE: f64 = 1.1;
/// As [`LEAST_INSIDE`], if effects are selected and no hypothesis wins. Noise that is larger in motion also increases
/// chi2.
const LEAST_INSIDE_BESIDE_EFFECTS: f64 = 2.0;
/// Smallest share of the excess chi2 (chi2 beyond noise) of the specific force inside moves that remains if a hand has
/// caused it. A hypothesis or an effect that describes the cause leaves a smaller share.
const LEFT_BY_HAND: f64 = 0.25;
/// Largest chi2 per degree of freedom of the gravity directions after moves that noise leaves.
const MOST_DIRECTIONS: f64 = 2.0;

/// What a search leaves unexplained of two groups of residuals: chi2 per degree of freedom, with the selected effects
/// and the best generic hypothesis in the model. `None` if the search does not use the residuals.
pub(super) struct Left {
    /// The specific force inside moves.
    inside: Option<f64>,
    /// Gravity directions after moves.
    directions: Option<f64>,
    /// Whether a hand may have caused the residuals inside the moves.
    pub(super) may_be_of_hand: bool,
    /// Whether the best generic hypothesis is about the accelerometer.
    is_of_accelerometer: bool,
}

impl Left {
    /// `before` is chi2 per degree of freedom of the specific force inside moves in the model without effects.
    pub(super) fn of(
        stage: &Stage,
        before: Option<f64>,
        generic: Option<&BestGeneric>,
        has_effects: bool,
        kinds: Kinds,
    ) -> Self {
        let scale = |group| match generic {
            Some(own) => stage.design.gram.place(group).map(|place| own.scales[place]),
            None => stage.scale(group),
        };
        let inside = scale(INSIDE);
        let least = if generic.is_some() { LEAST_INSIDE } else { LEAST_INSIDE_BESIDE_EFFECTS };
        let is_large = |(before, left): (f64, f64)| left > least && left - 1.0 > LEFT_BY_HAND * (before - 1.0);
        // Encoders show that the unit turns on a stand.
        let may_be_of_hand =
            !kinds.encoders && (generic.is_some() || has_effects) && before.zip(inside).is_some_and(is_large);
        let is_of_accelerometer = generic.is_some_and(|own| own.block.sensor() == Sensor::Accelerometer);
        Self { inside, directions: scale(MOVE_DIRECTIONS), may_be_of_hand, is_of_accelerometer }
    }

    /// Whether a search without the specific force inside moves, which leaves `self`, confirms that a hand caused what
    /// the search with this force has left. It does not if the cause may be an error of the gyroscope, because the
    /// gravity directions have the larger residuals.
    pub(super) fn is_consistent_with_hand(&self, with_inside: &Self) -> bool {
        let most = with_inside.inside.map_or(MOST_DIRECTIONS, |inside| inside.max(MOST_DIRECTIONS));
        with_inside.is_of_accelerometer || self.directions.is_none_or(|directions| directions <= most)
    }
}
