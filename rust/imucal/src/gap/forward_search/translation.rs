//! Recognises from the residuals that a hand translated the unit inside the moves (docs/decisions/0059).
//!
//! If a hand translated the unit, the specific force inside the moves contains accelerations. No effect and no generic
//! hypothesis (unknown variation of a bias or scale) explains them. An unknown error of the unit may also leave
//! residuals of this force unexplained. If it is an error of the gyroscope, it also changes the gravity directions
//! after the moves, whereas a translation does not change them.

use imucal_core::effects::Sensor;

use crate::gap::pattern::BestGeneric;
use crate::gap::stage::Stage;
use crate::joint::{INSIDE, Kinds, MOVE_DIRECTIONS};

/// Smallest chi2 per degree of freedom of the specific force inside moves that is attributed to a hand if a generic
/// hypothesis is significant. The value is close to 1, because accelerations by the hand may be the reason why the
/// hypothesis is significant.
const LEAST_INSIDE: f64 = 1.1;
/// Smallest chi2 per degree of freedom of the specific force inside moves that is attributed to a hand if effects are
/// selected and no generic hypothesis is significant. The value is larger than [`LEAST_INSIDE`], because noise that is
/// larger in motion than at rest also increases chi2.
const LEAST_INSIDE_BESIDE_EFFECTS: f64 = 2.0;
/// Residuals of the specific force inside moves are attributed to a hand only if more than this share of their excess
/// chi2 (chi2 beyond noise) remains after the search. A smaller share remains if a generic hypothesis or an effect in
/// the model describes the cause of the residuals.
const LEFT_BY_HAND: f64 = 0.25;
/// Largest chi2 per degree of freedom of the gravity directions after moves that is attributed to noise.
const MOST_DIRECTIONS: f64 = 2.0;

/// chi2 per degree of freedom of two groups of residuals at the end of a search, with the selected effects and the best
/// generic hypothesis in the model. The value of a group is `None` if the search does not use its residuals.
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
    /// Evaluates the residuals of the final model: the model of `stage` and the best generic hypothesis `generic`.
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
        // If encoder angles are used, a stand and not a hand moves the unit.
        let may_be_of_hand =
            !kinds.encoders && (generic.is_some() || has_effects) && before.zip(inside).is_some_and(is_large);
        let is_of_accelerometer = generic.is_some_and(|own| own.block.sensor() == Sensor::Accelerometer);
        Self { inside, directions: scale(MOVE_DIRECTIONS), may_be_of_hand, is_of_accelerometer }
    }

    /// Whether a hand may have caused the residuals `with_inside`, which a search with the specific force inside moves
    /// leaves. `self` are the residuals that a search without this force leaves. The result is `false` if chi2 of the
    /// gravity directions in `self` exceeds both chi2 of the force in `with_inside` and [`MOST_DIRECTIONS`], because an
    /// error of the gyroscope is then more likely. If the best hypothesis in `with_inside` is about the accelerometer,
    /// the result is always `true`.
    pub(super) fn is_consistent_with_hand(&self, with_inside: &Self) -> bool {
        let most = with_inside.inside.map_or(MOST_DIRECTIONS, |inside| inside.max(MOST_DIRECTIONS));
        with_inside.is_of_accelerometer || self.directions.is_none_or(|directions| directions <= most)
    }
}
