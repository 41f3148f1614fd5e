//! Fits the models that the forward search compares, and linearises each fitted model together with the candidate
//! effects.

use std::sync::Arc;

use imucal_core::effects::Need;
use imucal_core::sensor::Triad;

use super::design::design;
use super::forward_search::ForwardSearch;
use super::stage::{Beside, FitKey, Member, NO_EVIDENCE, Stage};
use crate::calibrate::{EffectChoice, UserField};
use crate::error::Error;
use crate::joint::{self, Linear, Model, Prepared, Term, Terms, start_shares};
use crate::parameters::BASE;

/// Standard deviation of the prior of an effect's time constant, in multiples of the typical time constant.
const SHAPE_WIDTH: f64 = 3.0;

/// Maximum number of linearisations kept in memory. Each linearisation needs as much memory as the Jacobian of all
/// moves.
const MOST_RECENT: usize = 3;

/// Error message of a fit in which the time constant of a temperature lag is longer than the recordings.
const TOO_LONG: &str = "the time constant of the temperature lag is longer than the recordings";

impl<'a> ForwardSearch<'a> {
    /// Returns the effects `members` of a model: the catalogue effects, from `open`, and the user-defined effects.
    pub(super) fn of_members(
        &self,
        open: &[EffectChoice],
        members: &[Member],
    ) -> (Vec<EffectChoice>, Vec<UserField<'a>>) {
        let is_member = |name: &str| members.iter().any(|member| member.name == name);
        let find = |member: &Member| {
            let choice = open.iter().find(|choice| choice.effect.name == member.name)?;
            Some(EffectChoice { parameters: member.parameters, ..*choice })
        };
        let fields = self.user_fields.iter().filter(|field| is_member(field.name)).cloned().collect();
        (members.iter().filter_map(find).collect(), fields)
    }

    /// Fits a model with the effects `members`, and linearises it. If `beside` is [`Beside::Candidates`], the
    /// linearisation includes the candidate effects `open`. The fit starts at the sensor models (sensitivity and bias)
    /// `near`.
    pub(super) fn stage(
        &self,
        prepared: &Prepared<'_>,
        near: [&Triad<f64>; 2],
        open: &[EffectChoice],
        members: &[Member],
        beside: Beside,
    ) -> Result<Stage, Error> {
        let (own, fields) = self.of_members(open, members);
        let terms = Terms::try_new(&own, &fields, &self.samples, self.kinds)?;
        let mut start = joint::start_model(prepared, &terms, near[0], near[1]);
        let mut precisions = vec![0.0; terms.count];
        for term in &terms.all {
            let Some(member) = members.iter().find(|m| m.name == term.name()) else { continue };
            for (k, typical) in term.typical().iter().enumerate() {
                // The prior of a time constant has a fixed width, which does not depend on the size of the effect.
                let width = if k < term.linear { member.width } else { SHAPE_WIDTH };
                precisions[term.first + k] = 1.0 / (width * typical).powi(2);
            }
            let own = &mut start.values[term.first..term.first + term.count()];
            if member.values.len() == own.len() {
                own.copy_from_slice(&member.values);
            } else if let (true, Some(shape)) = (term.has_shape(), member.shape) {
                own[term.linear] = shape;
            }
        }
        // The fit has no prior for user-defined effects. The prior of these effects is used only in the evidence below.
        let width = |term: &Term<'_>| {
            let member = members.iter().find(|m| m.name == term.name());
            term.effect().and(member).map(|member| member.width)
        };
        let key = (
            self.kinds,
            prepared.moves.len(),
            members.iter().map(|m| (m.name.clone(), m.parameters, m.width, m.shape)).collect(),
        );
        let linear = self.fitted(prepared, &terms, &start, width, key)?;
        if terms.all.iter().any(|term| is_longer_than_recordings(term, &linear.model, prepared.longest_s())) {
            return Err(Error::Fit(TOO_LONG.into()));
        }
        let own = (&terms, precisions.as_slice());
        let design = match beside {
            Beside::Nothing => design(prepared, own, &terms, &linear)?,
            Beside::Candidates => {
                let ground = self.ground.borrow().clone();
                let joined = ground.and_then(|ground| ground.joined(prepared, own, &linear).transpose());
                let design = |all: &Terms<'_>, linear: &Arc<Linear>| design(prepared, own, all, linear);
                joined.unwrap_or_else(|| self.with_candidates(prepared, own.0, &linear.model, open, design))?
            }
        };
        let model = linear.model.clone();
        let evidence = design.gram.evidence(&design.model).ok_or_else(|| Error::Fit(NO_EVIDENCE.into()))?;
        let mut members = members.to_vec();
        for member in &mut members {
            if let Some(term) = terms.all.iter().find(|term| term.name() == member.name) {
                member.values = model.values[term.first..term.first + term.count()].to_vec();
            }
        }
        let sensors = terms.all.iter().map(|term| term.sensor).collect();
        let place = |t: &Term<'_>| (t.name().to_owned(), BASE + t.first..BASE + t.first + t.count());
        let places = terms.all.iter().map(place).collect();
        Ok(Stage { design: Arc::new(design), evidence, members, model, sensors, places })
    }

    /// Fits a model, and returns the linearisation at the solution. The fitted parameters are stored under `key`, and
    /// the most recent linearisations are kept, because several steps of the search need the same fit. `width` returns
    /// the prior width of an effect, or `None` for no prior.
    fn fitted(
        &self,
        prepared: &Prepared<'_>,
        terms: &Terms<'_>,
        start: &Model,
        width: impl Fn(&Term<'_>) -> Option<f64>,
        key: FitKey,
    ) -> Result<Arc<Linear>, Error> {
        if let Some((_, linear)) = self.recent.borrow().iter().find(|(fit, _)| *fit == key) {
            return Ok(Arc::clone(linear));
        }
        let known = self.fits.borrow().iter().find(|(fit, _)| *fit == key).map(|(_, model)| model.parameters());
        let linear = match known {
            Some(parameters) => Arc::new(prepared.linearise(terms, &parameters)?),
            None => {
                let linear = joint::fit_for_search(prepared, terms, start, width)?;
                self.fits.borrow_mut().push((key.clone(), linear.model.clone()));
                linear
            }
        };
        let mut recent = self.recent.borrow_mut();
        recent.truncate(MOST_RECENT - 1);
        recent.insert(0, (key, Arc::clone(&linear)));
        Ok(linear)
    }

    /// Linearises a model together with all candidates, and passes the linearisation to `work`. The columns of the
    /// model and of the candidates are evaluated at the same corrected signals, so one pass over the samples computes
    /// all columns.
    pub(super) fn with_candidates<T>(
        &self,
        prepared: &Prepared<'_>,
        terms: &Terms<'_>,
        model: &Model,
        open: &[EffectChoice],
        work: impl FnOnce(&Terms<'_>, &Arc<Linear>) -> Result<T, Error>,
    ) -> Result<T, Error> {
        let is_member = |name: &str| terms.all.iter().any(|term| term.name() == name);
        let of_catalogue = |term: &Term<'_>| Some(EffectChoice { effect: term.effect()?, parameters: term.linear });
        let members = terms.all.iter().filter_map(of_catalogue);
        let scored = |choice: &EffectChoice| match choice.effect.has_need(Need::TemperatureHistory) {
            // The form with the fewest parameters (for example linear instead of quadratic) suffices to find the
            // effect. The search selects the form after it has added the effect to the model.
            true => EffectChoice::plain(choice.effect),
            false => *choice,
        };
        let free = open.iter().filter(|choice| !is_member(choice.effect.name)).map(scored);
        let (timed, plain): (Vec<_>, Vec<_>) = free.partition(|choice| choice.effect.shape.is_some());
        let (fields, free): (Vec<_>, Vec<_>) = self.user_fields.iter().cloned().partition(|f| is_member(f.name));
        let all_fields: Vec<UserField<'_>> = fields.into_iter().chain(free).collect();
        let choices: Vec<EffectChoice> = members.chain(plain).collect();
        let mut all = Terms::try_new(&choices, &all_fields, &self.samples, terms.kinds)?;
        let longest_s = prepared.longest_s();
        for effect in timed.iter().map(|choice| choice.effect) {
            for share in start_shares(effect) {
                all.push_frozen(effect, share * longest_s)?;
            }
        }
        let mut values = vec![0.0; all.count];
        for term in &terms.all {
            if let Some(same) = all.all.iter().find(|other| other.name() == term.name()) {
                let own = &model.values[term.first..term.first + term.count()];
                values[same.first..same.first + same.count()].copy_from_slice(own);
            }
        }
        let parameters = Model { values, ..model.clone() }.parameters();
        work(&all, &Arc::new(prepared.linearise(&all, &parameters)?))
    }
}

/// Whether the term is a temperature lag whose time constant exceeds the duration of the longest recording. The
/// low-passed temperature then hardly changes. The regressor of the lag (low-passed temperature minus temperature) is
/// therefore nearly the negative temperature plus a constant, and the time constant is not observable.
fn is_longer_than_recordings(term: &Term<'_>, model: &Model, longest_s: f64) -> bool {
    let is_lag = term.has_shape() && term.effect().is_some_and(|effect| effect.has_need(Need::TemperatureHistory));
    is_lag && model.values[term.first + term.linear] > longest_s
}
