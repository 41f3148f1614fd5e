//! The forward path: score, add, refit; then leave out again what the others have made superfluous.

use std::cell::RefCell;
use std::sync::Arc;

use imucal_core::effects::{Need, Sensor};
use imucal_core::sensor::Triad;

use super::design::Design;
use super::detect::FALSE_ALARM;
use super::earth;
use super::pattern::Pattern;
use super::score::{Judged, Judgement, gain, judge, scattering_rests, traces};
use super::stage::{Beside, FitKey, Member, Stage};
use super::{Linearised, NotPredictive, Score, Search};
use crate::calibrate::{Checked, EffectChoice, Options, UserField};
use crate::error::Error;
use crate::joint::{Kinds, Linear, Model, Near, Prepared};
use crate::numerics::stats::sample_interval_s;
use crate::recording::{REFERENCE_TEMPERATURE_DEGC, Recording};

const MOST_EFFECTS: usize = 6;
/// Width of the narrowest prior, in typical sizes.
pub(super) const LEAST_WIDTH: f64 = 0.03;
/// A temperature that changes by less, in means over so long, says nothing of what it does.
const LEAST_CHANGE_K: f64 = 0.5;
const MEAN_S: f64 = 1.0;
const CARRIED_ALONG: &str = "the unit was carried along inside the moves, not turned in one place";

/// Looks for effects among `candidates` and `user_fields` in the recordings that are checked.
///
/// # Errors
/// As [`calibrate`](crate::calibrate::calibrate()).
pub fn search(
    checked: &Checked,
    recordings: &[Recording<'_>],
    options: &Options<'_>,
    candidates: &[EffectChoice],
    user_fields: &[UserField<'_>],
) -> Result<Search, Error> {
    let columns = centred_temperatures(recordings);
    let recordings = &with_temperatures(recordings, &columns);
    let (mut hunt, open) = Hunt::new(checked, recordings, candidates, user_fields);
    let found = checked.prepare(recordings, options, hunt.kinds, |prepared, accelerometer, gyroscope| {
        hunt.run(prepared, [accelerometer, gyroscope], open)
    });
    if hunt.is_carried {
        checked.carried.get_or_init(|| ());
    }
    let (found, near) = found?;
    checked.ends_near(near);
    Ok(found)
}

/// The whitened residuals of the model without effects, and what they depend on: for other ways to choose effects.
///
/// # Errors
/// As [`search`].
pub fn linearise(
    recordings: &[Recording<'_>],
    options: &Options<'_>,
    candidates: &[EffectChoice],
    user_fields: &[UserField<'_>],
) -> Result<Linearised, Error> {
    let checked = Checked::try_new(recordings, options)?;
    at_start(&checked, recordings, options, candidates, user_fields, |_, stage| {
        let Design { rows, model, candidates, residual, .. } = &*stage.design;
        let columns = rows.columns();
        let take = |range: std::ops::Range<usize>| {
            (0..columns.nrows()).map(|i| range.clone().map(|j| columns[(i, j)]).collect()).collect()
        };
        Linearised {
            residual: residual.clone(),
            base: take(0..model.len()),
            candidates: candidates.iter().map(|c| (c.name.clone(), take(c.columns.clone()))).collect(),
        }
    })
}

/// The smallest rms size of each effect that is seen with 90 % probability, with its unit; and the names of those that are not seen at
/// all, with what would show them.
pub type Visible = (Vec<(String, f64, String)>, Vec<(String, String)>);

/// How small each of the candidates could be and still be found beside the model without effects, in the recordings that are checked.
///
/// # Errors
/// As [`search`].
pub fn smallest_visible(
    checked: &Checked,
    recordings: &[Recording<'_>],
    options: &Options<'_>,
    candidates: &[EffectChoice],
) -> Result<Visible, Error> {
    at_start(checked, recordings, options, candidates, &[], |mut hunt, stage| {
        let judged = judge(stage);
        hunt.left_out.extend(judged.blind);
        (judged.visible, hunt.left_out)
    })
}

/// What a search has in hand at its start: the model without effects, and what is left out already.
fn at_start<T>(
    checked: &Checked,
    recordings: &[Recording<'_>],
    options: &Options<'_>,
    candidates: &[EffectChoice],
    user_fields: &[UserField<'_>],
    work: impl FnOnce(Hunt<'_>, &Stage) -> T,
) -> Result<T, Error> {
    let columns = centred_temperatures(recordings);
    let recordings = &with_temperatures(recordings, &columns);
    let (mut hunt, open) = Hunt::new(checked, recordings, candidates, user_fields);
    let kinds = hunt.kinds;
    checked.prepare(recordings, options, kinds, |prepared, accelerometer, gyroscope| {
        let (stage, _) = hunt.start(prepared, [accelerometer, gyroscope], open)?;
        Ok(work(hunt, &stage))
    })
}

/// Temperatures about their mean over all recordings: an effect of them has columns like those of the sensor's own parameters
/// times how far that mean is from where temperatures count from, and what noise makes of the difference would be explained by noise.
fn centred_temperatures(recordings: &[Recording<'_>]) -> Vec<Option<Vec<f64>>> {
    let (sum, count) = (recordings.iter().filter_map(|recording| recording.temperature_degc).flatten())
        .filter(|degc| degc.is_finite())
        .fold((0.0, 0.0), |(sum, count), degc| (sum + degc, count + 1.0));
    let shift_k = REFERENCE_TEMPERATURE_DEGC - if count > 0.0 { sum / count } else { 0.0 };
    let centred = |column: &[f64]| column.iter().map(|degc| degc + shift_k).collect();
    recordings.iter().map(|recording| recording.temperature_degc.map(centred)).collect()
}

fn with_temperatures<'a>(recordings: &[Recording<'a>], columns: &'a [Option<Vec<f64>>]) -> Vec<Recording<'a>> {
    let with = |(recording, column): (&Recording<'a>, &'a Option<Vec<f64>>)| Recording {
        temperature_degc: column.as_deref(),
        ..*recording
    };
    recordings.iter().zip(columns).map(with).collect()
}

/// Whether the temperature changes enough to show what it does, noise of its readings aside.
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

/// What stays the same through a search.
pub(super) struct Hunt<'a> {
    pub(super) kinds: Kinds,
    /// Whether a hand carried the unit, as far as is known.
    pub(super) is_carried: bool,
    /// Effects that cannot be seen, and what they need.
    pub(super) left_out: Vec<(String, String)>,
    pub(super) user_fields: &'a [UserField<'a>],
    pub(super) samples: Vec<usize>,
    /// Fits that have been made.
    pub(super) fits: RefCell<Vec<(FitKey, Model)>>,
    /// The last of them, the latest first, linearised where they ended.
    pub(super) recent: RefCell<Vec<(FitKey, Arc<Linear>)>>,
    /// The model without effects and all candidates beside it, once it is known.
    pub(super) ground: RefCell<Option<Arc<Design>>>,
}

impl<'a> Hunt<'a> {
    /// With the candidates that are open.
    fn new(
        checked: &Checked,
        recordings: &[Recording<'_>],
        candidates: &[EffectChoice],
        user_fields: &'a [UserField<'a>],
    ) -> (Self, Vec<EffectChoice>) {
        let encoders = recordings.iter().all(Recording::has_stand)
            && candidates.iter().any(|choice| choice.effect.sensor == Sensor::Encoder);
        let mut hunt = Self {
            kinds: Kinds { in_motion: true, encoders },
            is_carried: checked.is_carried(),
            left_out: Vec::new(),
            user_fields,
            samples: recordings.iter().map(Recording::len).collect(),
            fits: RefCell::new(Vec::new()),
            recent: RefCell::new(Vec::new()),
            ground: RefCell::new(None),
        };
        let open = hunt.with_columns(recordings, candidates);
        (hunt, open)
    }

    /// The candidates whose columns are there; the others are noted.
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
                Some("one recording: the heading is not known from one to the next".to_owned())
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

    /// What is found, and where the search ends.
    fn run(
        &mut self,
        prepared: &Prepared<'_>,
        triads: [&Triad<f64>; 2],
        open: Vec<EffectChoice>,
    ) -> Result<(Search, Near), Error> {
        let (mut start, mut open) = self.start(prepared, triads, open)?;
        let mut first = judge(&start);
        let mut walk = self.walk(prepared, &open, start.clone(), &first)?;
        let not_the_earth = walk.stage.not_the_earth();
        if not_the_earth.is_some() {
            open.retain(|choice| choice.effect.name != earth::NAME);
            start = start.without(earth::NAME);
            *self.ground.borrow_mut() = Some(Arc::clone(&start.design));
            first = judge(&start);
            walk = self.walk(prepared, &open, start.clone(), &first)?;
        }
        let traces = traces(&start);
        let plain_scales = start.evidence.scales;
        let Walk { stage, path, not_predictive, last } = walk;
        let (patterns, contradiction) = self.patterns(prepared, triads, &open, &stage)?;
        let generic = patterns
            .into_iter()
            .filter_map(Pattern::winner)
            .max_by(|a, b| a.log_bayes_factor.total_cmp(&b.log_bayes_factor));
        let Judgement { scores, blind, visible } = first;
        let mut ranking: Vec<Score> = scores.into_iter().map(|judged| judged.score).collect();
        ranking.sort_by(|a, b| b.log_bayes_factor.total_cmp(&a.log_bayes_factor));
        // Beside the final model; of what is in it, beside the model without effects.
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
            generic: generic.map(|g| g.finding()),
            not_predictive,
            not_the_earth,
            not_observable: self.left_out.clone(),
            smallest_visible,
            traces,
            scattering_rests: contradiction.or_else(|| scattering_rests(&stage, &plain_scales)),
            in_motion_left_out: (!self.kinds.in_motion).then(|| CARRIED_ALONG.to_owned()),
        };
        Ok((found, stage.near()))
    }

    /// Adds the best candidate again and again, from the model without effects, and leaves out what is superfluous at the end.
    fn walk(
        &self,
        prepared: &Prepared<'_>,
        open: &[EffectChoice],
        mut stage: Stage,
        first: &Judgement,
    ) -> Result<Walk, Error> {
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
                    // Before a second effect mends what the wrong one leaves.
                    if self.swap(prepared, open, &mut stage, &mut path)? {
                        stage = beside(&stage, &stage.members)?;
                    }
                    last = Some(judge(&stage));
                }
                // What is not determined, or does not help once it is really fitted, is no explanation.
                _ => skipped.push(pick.score.name.clone()),
            }
        }
        if self.eliminate(prepared, open, &mut stage, &mut path)? {
            last = Some(judge(&beside(&stage, &stage.members)?));
        }
        Ok(Walk { stage, path, not_predictive, last })
    }
}

/// Where a path has come to.
struct Walk {
    stage: Stage,
    path: Vec<Score>,
    not_predictive: Vec<NotPredictive>,
    /// Of the candidates beside the last model; `None` where that is the first one.
    last: Option<Judgement>,
}
