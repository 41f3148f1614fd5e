//! Tries refused effects again with all residuals of the search (docs/decisions/0058).
//!
//! On a stand, the search also uses residuals of the specific force inside moves and, with encoders, residuals of the
//! stand's angles. The fits that follow the search use these two kinds of residuals only for effects that are not
//! observable from the other residuals. An effect that is observable from the other residuals may have a large
//! uncertainty.

use std::rc::Rc;

use super::Search;
use super::acceptance::{Accepted, Refusal, unless_it_fails};
use super::earth;
use super::fits::{Fit, Fits};
use crate::calibrate::Kinds;
use crate::error::Error;

impl Fits<'_> {
    /// Accepts or refuses the effects that the search has selected. If an effect is refused, perhaps because the
    /// residuals of the fits hardly determine it, all selected effects are tried again with fits that use all kinds of
    /// residuals of the search. The result of this second trial is used if it contains all effects that the first trial
    /// accepted, and further effects.
    pub(super) fn accept(&mut self, before: &Rc<Fit>, search: &Search) -> Result<Accepted, Error> {
        let first = self.accept_selected(before, before, &search.path)?;
        let Some(kinds) = kinds_of_second_trial(&first, search) else { return Ok(first) };
        let of_first = std::mem::replace(&mut self.kinds, kinds);
        if let Ok(reference) = unless_it_fails(self.with(&[]))? {
            let second = self.accept_selected(before, &reference, &search.path)?;
            if second.path.len() > first.path.len() && first.path.iter().all(|name| second.path.contains(name)) {
                return Ok(second);
            }
        }
        self.kinds = of_first;
        Ok(first)
    }
}

/// The kinds of residuals of a second trial; `None` if no second trial is made. No second trial is made if an effect
/// that is a function of time was refused, because the search is then repeated. It is also not made if the search
/// selected `earth_rate`, because the magnitude of this rate was tested in a fit that used neither the specific force
/// inside moves nor the stand's angles.
fn kinds_of_second_trial(first: &Accepted, search: &Search) -> Option<Kinds> {
    // The kinds are those of the search. The stand's angles are left out if the stand deviates from its model.
    let is_of_stand = search.scattering_rests.is_some_and(|(name, ..)| name.starts_with("stand"));
    let kinds = Kinds { encoders: search.kinds.encoders && !is_of_stand, ..search.kinds };
    let is_undetermined = first.refused.iter().any(Refusal::may_be_undetermined)
        && first.refused.iter().all(|refusal| refusal.of_time().is_none());
    let has_earth_rate = search.path.iter().any(|score| score.name == earth::NAME);
    (is_undetermined && !has_earth_rate && kinds != Kinds::default()).then_some(kinds)
}
