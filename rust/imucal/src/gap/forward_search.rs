//! Forward selection of effects: all candidates are scored, the best candidate is added to the model, and the model is
//! refitted. At the end, an effect is removed if the model without this effect explains the residuals equally well.

mod beside_patterns;
mod translation;

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::sync::Arc;

use imucal_core::effects::{Need, Sensor};
use imucal_core::sensor::Triad;

pub(super) use self::beside_patterns::OF_TIME;
use self::beside_patterns::{KnownEffects, OF_FIELDS, turns_with_heading};
use self::translation::Left;
use super::design::Design;
use super::detect::FALSE_ALARM;
use super::earth;
use super::kernel::Kernel;
use super::pattern::{BestGeneric, Pattern};
use super::score::{Judged, Judgement, gain, judge, scattering_rests, traces};
use super::stage::{Beside, FitKey, Member, Stage};
use super::{Linearised, NotPredictive, Scattering, Score, Search};
use crate::calibrate::{Checked, EffectChoice, Options, UserField};
use crate::error::Error;
use crate::joint::{INSIDE, Kinds, Linear, Model, Prepared};
use crate::numerics::stats::sample_interval_s;
use crate::recording::{REFERENCE_TEMPERATURE_DEGC, Recording};

/// Maximum number of effects in a model.
pub(super) const MOST_EFFECTS: usize = 6;
/// Maximum number of rounds. In each round, effects are first selected in a model with the generic hypotheses (unknown
/// variations of a bias or scale). Generic hypotheses are then evaluated in a model with these effects. One further
/// round is permitted if the last round shows for the first time that the gyroscope bias varies with heading.
const MOST_ROUNDS: usize = 2;
/// Smallest standard deviation of the prior of an effect's parameter, in multiples of the parameter's typical size.
pub(super) const LEAST_WIDTH: f64 = 0.03;
/// Minimum range of the temperature, in kelvin, for temperature effects to be candidates. Temperatures are averaged
/// over [`MEAN_S`] before their range is determined.
const LEAST_CHANGE_K: f64 = 0.5;
/// Time, s, over which temperature readings are averaged to reduce the noise of the readings.
const MEAN_S: f64 = 1.0;

/// Searches the checked recordings for effects among `candidates` and `user_fields`.
///
/// `is_hand_moved` is true if an earlier search with more candidates detected hand motion ([`Search::is_hand_moved`]).
/// If it is false, this search tests the recordings for hand motion.
///
/// # Errors
/// The errors of [`calibrate`](crate::calibrate::calibrate()).
pub fn search(
    checked: &Checked<'_>,
    candidates: &[EffectChoice],
    user_fields: &[UserField<'_>],
    is_hand_moved: bool,
) -> Result<Search, Error> {
    let temperatures_degc = centred_temperatures(checked.recordings());
    let run = |known| {
        let (mut search, open) = ForwardSearch::new(checked, candidates, user_fields, known);
        checked.prepare(&temperatures_degc, search.kinds, |prepared, accelerometer, gyroscope| {
            search.run(prepared, [accelerometer, gyroscope], open)
        })
    };
    let (found, left) = run(is_hand_moved.then_some(true))?;
    if !left.may_be_of_hand {
        return Ok(found);
    }
    let (without_inside, left_without) = run(Some(true))?;
    Ok(if left_without.is_consistent_with_hand(&left) { without_inside } else { found })
}

/// Computes the whitened residuals of the model without effects, and their Jacobian. They serve as input of other
/// methods of model selection, which can then be compared with [`search`]. `is_hand_moved` is the result of an earlier
/// search ([`Search::is_hand_moved`]). If it is `None`, the recordings are tested for hand motion here. The result of
/// this test depends on the candidates, and it determines which residuals are used. To obtain the same residuals for
/// different candidates, pass a value instead of `None`.
///
/// # Errors
/// The errors are those of [`search`].
pub fn linearise(
    recordings: &[Recording<'_>],
    options: &Options<'_>,
    candidates: &[EffectChoice],
    user_fields: &[UserField<'_>],
    is_hand_moved: Option<bool>,
) -> Result<Linearised, Error> {
    let checked = Checked::try_new(recordings, options)?;
    at_start(&checked, candidates, user_fields, is_hand_moved, |_, stage| {
        let Design { rows, model, residual, .. } = &*stage.design;
        let columns = rows.columns();
        let take = |range: std::ops::Range<usize>| {
            (0..columns.nrows()).map(|i| range.clone().map(|j| columns[(i, j)]).collect()).collect()
        };
        Linearised {
            residual: residual.clone(),
            base: take(0..model.len()),
            candidates: stage.design.full_forms().map(|c| (c.name.clone(), take(c.columns.clone()))).collect(),
            groups: rows.groups().to_vec(),
            items: rows.items().to_vec(),
        }
    })
}

/// Detection limits of effects. The first list has one entry for each observable effect: its name, the smallest rms
/// value of its parameters that is detected with 90 % probability, and the unit of this value. The second list has one
/// entry for each effect that is not observable: its name, and the data that would make it observable.
pub type Visible = (Vec<(String, f64, String)>, Vec<(String, String)>);

/// Computes the detection limit of each candidate effect. For this, each effect alone is added to the model without
/// effects.
/// `is_hand_moved` is true if an earlier search with more candidates detected hand motion ([`Search::is_hand_moved`]).
///
/// # Errors
/// The errors are those of [`search`].
pub fn smallest_visible(
    checked: &Checked<'_>,
    candidates: &[EffectChoice],
    is_hand_moved: bool,
) -> Result<Visible, Error> {
    at_start(checked, candidates, &[], is_hand_moved.then_some(true), |mut search, stage| {
        let judged = judge(stage);
        search.left_out.extend(judged.blind);
        (judged.visible, search.left_out)
    })
}

/// Calls `work` with the initial state of a search: the model without effects, and the effects that are excluded
/// because the recordings lack the data that these effects require.
fn at_start<T>(
    checked: &Checked<'_>,
    candidates: &[EffectChoice],
    user_fields: &[UserField<'_>],
    is_hand_moved: Option<bool>,
    work: impl FnOnce(ForwardSearch<'_>, &Stage) -> T,
) -> Result<T, Error> {
    let (mut search, open) = ForwardSearch::new(checked, candidates, user_fields, is_hand_moved);
    let (kinds, temperatures_degc) = (search.kinds, centred_temperatures(checked.recordings()));
    checked.prepare(&temperatures_degc, kinds, |prepared, accelerometer, gyroscope| {
        let (stage, _) = search.start(prepared, [accelerometer, gyroscope], open)?;
        Ok(work(search, &stage))
    })
}

/// Returns the temperatures of all recordings, shifted so that their overall mean is the reference temperature. Effects
/// of the temperature are functions of its difference from the reference temperature. Without the shift, they would
/// mostly act like constant changes of a bias or scale.
fn centred_temperatures(recordings: &[Recording<'_>]) -> Vec<Option<Vec<f64>>> {
    let (sum, count) = (recordings.iter().filter_map(|recording| recording.temperature_degc).flatten())
        .filter(|degc| degc.is_finite())
        .fold((0.0, 0.0), |(sum, count), degc| (sum + degc, count + 1.0));
    let shift_k = REFERENCE_TEMPERATURE_DEGC - if count > 0.0 { sum / count } else { 0.0 };
    let centred = |column: &[f64]| column.iter().map(|degc| degc + shift_k).collect();
    recordings.iter().map(|recording| recording.temperature_degc.map(centred)).collect()
}

/// Whether the range of the averaged temperature over all recordings is at least [`LEAST_CHANGE_K`].
fn is_warmed(recordings: &[Recording<'_>]) -> bool {
    let warmed = recordings.iter().filter_map(|recording| Some((recording, recording.temperature_degc?)));
    let means = warmed.flat_map(|(recording, degc)| {
        let samples = (MEAN_S / sample_interval_s(recording.time_s)) as usize;
        let parts = degc.chunks_exact(samples.clamp(1, recording.len()));
        parts.map(|part| part.iter().sum::<f64>() / part.len() as f64)
    });
    let (least, most) = means.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), mean| (a.min(mean), b.max(mean)));
    most - least >= LEAST_CHANGE_K
}

/// The state of a search.
pub(super) struct ForwardSearch<'a> {
    /// Kinds of residuals that the search uses.
    pub(super) kinds: Kinds,
    /// Whether accelerometer samples inside moves must be ignored, because the unit was moved by hand or because the
    /// accelerometer noise is far below the quantisation step. `None` if this is not known yet.
    pub(super) is_hand_moved: Option<bool>,
    /// Name of each effect that is not observable, and the data that would make it observable.
    pub(super) left_out: Vec<(String, String)>,
    pub(super) user_fields: &'a [UserField<'a>],
    /// Number of samples of each recording.
    pub(super) samples: Vec<usize>,
    /// The fitted models of this search. Each key contains the effects and the kinds of residuals of the fit.
    pub(super) fits: RefCell<Vec<(FitKey, Model)>>,
    /// The most recent fits, the latest first, each with the linearisation at its solution.
    pub(super) recent: RefCell<Vec<(FitKey, Arc<Linear>)>>,
    /// The linearised residuals of the model without effects, with the Jacobian columns of all candidates; `None` until
    /// they are computed.
    pub(super) ground: RefCell<Option<Arc<Design>>>,
}

impl<'a> ForwardSearch<'a> {
    /// Creates a search. The second result contains the candidates whose requirements (for example a temperature
    /// column) the recordings meet.
    fn new(
        checked: &Checked<'_>,
        candidates: &[EffectChoice],
        user_fields: &'a [UserField<'a>],
        is_hand_moved: Option<bool>,
    ) -> (Self, Vec<EffectChoice>) {
        let recordings = checked.recordings();
        let encoders = recordings.iter().all(Recording::has_stand)
            && candidates.iter().any(|choice| choice.effect.sensor == Sensor::Encoder);
        let mut search = Self {
            kinds: Kinds { in_motion: true, encoders },
            is_hand_moved: (checked.is_held() || checked.has_coarse_accelerometer()).then_some(true).or(is_hand_moved),
            left_out: Vec::new(),
            user_fields,
            samples: recordings.iter().map(Recording::len).collect(),
            fits: RefCell::new(Vec::new()),
            recent: RefCell::new(Vec::new()),
            ground: RefCell::new(None),
        };
        let open = search.with_columns(recordings, candidates);
        (search, open)
    }

    /// The candidates whose requirements the recordings meet. All other candidates are added to `left_out`.
    fn with_columns(&mut self, recordings: &[Recording<'_>], candidates: &[EffectChoice]) -> Vec<EffectChoice> {
        let warmed = is_warmed(recordings);
        let lacks = |choice: &EffectChoice| {
            let effect = choice.effect;
            if effect.needs.contains(&Need::Temperature) && !recordings.iter().all(Recording::has_temperature) {
                Some(format!("a temp_degc column without holes, and {}", effect.observable))
            } else if effect.needs.contains(&Need::Temperature) && !warmed {
                Some(format!("a temperature that changes by {LEAST_CHANGE_K} K or more: {}", effect.observable))
            } else if effect.sensor == Sensor::Encoder && !self.kinds.encoders {
                Some(format!("stand_1, stand_2 and stand_3 columns without holes, and {}", effect.observable))
            } else if effect.needs.contains(&Need::Attitude) && recordings.len() > 1 {
                Some("a single recording, because the heading is not known between recordings".to_owned())
            } else {
                None
            }
        };
        let (mut open, mut left_out) = (Vec::new(), Vec::new());
        for choice in candidates {
            match lacks(choice) {
                Some(needs) => left_out.push((choice.effect.name.to_owned(), needs)),
                None => open.push(*choice),
            }
        }
        self.left_out = left_out;
        open
    }

    /// Searches for effects. The second result tells whether a hand may have translated the unit.
    fn run(
        &mut self,
        prepared: &Prepared<'_>,
        triads: [&Triad<f64>; 2],
        open: Vec<EffectChoice>,
    ) -> Result<(Search, Left), Error> {
        let (mut start, mut open) = self.start(prepared, triads, open)?;
        let mut first = judge(&start);
        let mut selected = self.select(prepared, &open, start.clone(), &first)?;
        let not_the_earth = selected.stage.not_the_earth();
        if not_the_earth.is_some() {
            open.retain(|choice| choice.effect.name != earth::NAME);
            start = start.without(earth::NAME);
            *self.ground.borrow_mut() = Some(Arc::clone(&start.design));
            first = judge(&start);
            selected = self.select(prepared, &open, start.clone(), &first)?;
        }
        let traces = traces(&start);
        let (scale_inside, plain_scales) = (start.scale(INSIDE), start.evidence.scales);
        let (mut patterns, mut contradiction) = self.patterns(prepared, triads, &open, &selected.stage)?;
        let of_stand = |scattering: &Scattering| scattering.0.starts_with("stand");
        let scattering = contradiction.or_else(|| scattering_rests(&selected.stage, &plain_scales)).filter(of_stand);
        if scattering.is_some() {
            // The stand does not follow the stand model, so effects of the sensors are searched without the stand's
            // angles.
            (selected, patterns) = self.without_stand(prepared, triads, &open)?;
            contradiction = scattering;
            open.retain(|choice| choice.effect.sensor != Sensor::Encoder);
        }
        let (mut rounds, mut is_of_field) = (0, false);
        loop {
            // If the last round has shown for the first time that the gyroscope bias varies with heading, another round
            // removes the effects that resemble such a variation.
            let is_field_new = !is_of_field && turns_with_heading(&patterns);
            if rounds >= MOST_ROUNDS && !is_field_new {
                break;
            }
            rounds += 1;
            if is_field_new {
                is_of_field = true;
                open.retain(|choice| !OF_FIELDS.contains(&choice.effect.name));
            }
            let known = self.known_effects(prepared, triads, &open, &selected, &patterns)?;
            let Some(KnownEffects { members, path, .. }) = known else { break };
            let names = |members: &[Member]| members.iter().map(|own| own.name.clone()).collect::<BTreeSet<_>>();
            let is_settled = names(&members) == names(&selected.stage.members);
            selected.path = path;
            if is_settled {
                break;
            }
            let near = [&selected.stage.model.accelerometer, &selected.stage.model.gyroscope];
            let stage = self.stage(prepared, near, &open, &members, Beside::Candidates)?;
            selected.last = (!members.is_empty()).then(|| judge(&stage));
            selected.stage = stage;
            patterns = self.patterns(prepared, triads, &open, &selected.stage)?.0;
        }
        let Selected { stage, path, not_predictive, last } = selected;
        let winners = patterns.iter().filter_map(|pattern| match path.is_empty() {
            true => pattern.instead().or(pattern.besides()),
            false => pattern.besides(),
        });
        let best = winners.max_by(|a, b| a.log_bayes_factor.total_cmp(&b.log_bayes_factor));
        let left = Left::of(&stage, scale_inside, best, !path.is_empty(), self.kinds);
        let mut generic = best.map(BestGeneric::finding);
        if let Some(found) = generic.as_mut().filter(|found| found.kernel == Kernel::RandomWalk) {
            found.kernel = self.course(prepared, triads, &open, &stage.members, found.block)?;
        }
        let Judgement { scores, blind, visible } = first;
        let mut ranking: Vec<Score> = scores.into_iter().map(|judged| judged.score).collect();
        ranking.sort_by(|a, b| b.log_bayes_factor.total_cmp(&a.log_bayes_factor));
        // For an effect that is not in the final model, the detection limit is computed for its addition to the final
        // model. For an effect in the final model, it is computed for the addition to the model without effects.
        let mut smallest_visible = last.map(|last| last.visible).unwrap_or_default();
        for entry in visible {
            if !smallest_visible.iter().any(|(name, ..)| *name == entry.0) {
                smallest_visible.push(entry);
            }
        }
        self.left_out.extend(blind);
        let found = Search {
            path,
            ranking,
            generic,
            not_predictive,
            not_the_earth,
            not_observable: self.left_out.clone(),
            smallest_visible,
            traces,
            scattering_rests: contradiction.or_else(|| scattering_rests(&stage, &plain_scales)),
            kinds: self.kinds,
            is_hand_moved: !self.kinds.in_motion,
            warm_start: stage.warm_start(),
        };
        Ok((found, left))
    }

    /// Selects effects, and evaluates generic hypotheses, without the angles of the stand.
    fn without_stand(
        &mut self,
        prepared: &Prepared<'_>,
        triads: [&Triad<f64>; 2],
        open: &[EffectChoice],
    ) -> Result<(Selected, Vec<Pattern>), Error> {
        self.kinds.encoders = false;
        *self.ground.borrow_mut() = None;
        let inertial: Vec<EffectChoice> =
            open.iter().filter(|choice| choice.effect.sensor != Sensor::Encoder).copied().collect();
        let start = self.stage(prepared, triads, &inertial, &[], Beside::Candidates)?;
        *self.ground.borrow_mut() = Some(Arc::clone(&start.design));
        let first = judge(&start);
        let selected = self.select(prepared, &inertial, start, &first)?;
        let (patterns, _) = self.patterns(prepared, triads, &inertial, &selected.stage)?;
        Ok((selected, patterns))
    }

    /// Forward selection: adds the best candidate repeatedly, starting from `stage`, the model without effects. `first`
    /// contains the scores of the candidates relative to this model. At the end, effects that the other selected
    /// effects make superfluous are removed.
    fn select(
        &self,
        prepared: &Prepared<'_>,
        open: &[EffectChoice],
        mut stage: Stage,
        first: &Judgement,
    ) -> Result<Selected, Error> {
        let beside = |stage: &Stage, members: &[Member]| {
            let near = [&stage.model.accelerometer, &stage.model.gyroscope];
            self.stage(prepared, near, open, members, Beside::Candidates)
        };
        let mut path: Vec<Score> = Vec::new();
        let mut skipped: Vec<String> = Vec::new();
        let mut not_predictive: Vec<NotPredictive> = Vec::new();
        let mut last: Option<Judgement> = None;
        while path.len() < MOST_EFFECTS {
            let judged = last.as_ref().unwrap_or(first);
            let limit = FALSE_ALARM / judged.scores.len().max(1) as f64;
            let good = |s: &Judged| s.score.p_value < limit && !skipped.contains(&s.score.name);
            let Some((pick, rivals)) = self.best(prepared, open, &stage, &judged.scores, good) else { break };
            if let Some(gain) = gain(&stage, pick).filter(|gain| !gain.is_sure()) {
                if let Some(next) = self.with_partner(prepared, open, &stage, pick) {
                    path.push(Score { rivals, ..pick.score.clone() });
                    stage = next;
                    last = Some(judge(&stage));
                    continue;
                }
                skipped.push(pick.score.name.clone());
                not_predictive.push(NotPredictive {
                    name: pick.score.name.clone(),
                    log_bayes_factor: pick.score.log_bayes_factor,
                    gain: gain.nats,
                    gain_std: gain.std,
                });
                continue;
            }
            match beside(&stage, &pick.beside(&stage.members)) {
                Ok(next) if next.evidence.log > stage.evidence.log => {
                    path.push(Score { rivals, ..pick.score.clone() });
                    stage = next;
                    if let Some((temperature, score)) = self.temperature_of_history(&stage)
                        && let Ok(next) = beside(&stage, &temperature.beside(&stage.members))
                    {
                        path.push(score);
                        stage = next;
                    }
                    // Aliases (effects with nearly the same residuals) are compared before a second effect can
                    // compensate the residuals of a wrong first effect.
                    let is_swapped = self.swap(prepared, open, &mut stage, &mut path)?;
                    if self.choose_forms(prepared, open, &mut stage, &mut path)? || is_swapped {
                        stage = beside(&stage, &stage.members)?;
                    }
                    last = Some(judge(&stage));
                }
                // Candidates that cannot be fitted, or that do not increase the evidence after the fit, are skipped.
                _ => skipped.push(pick.score.name.clone()),
            }
        }
        if self.eliminate(prepared, open, &mut stage, &mut path)? {
            last = Some(judge(&beside(&stage, &stage.members)?));
        }
        Ok(Selected { stage, path, not_predictive, last })
    }
}

/// The result of a forward selection.
pub(super) struct Selected {
    pub(super) stage: Stage,
    pub(super) path: Vec<Score>,
    not_predictive: Vec<NotPredictive>,
    /// Scores of the candidates relative to the final model; `None` if the final model has no effects.
    last: Option<Judgement>,
}
