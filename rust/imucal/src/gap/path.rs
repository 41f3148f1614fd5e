//! The forward path: score, add, refit; then leave out again what the others have made superfluous.

use std::cell::RefCell;

use imucal_core::effects::{Effect, Need, Sensor};
use imucal_core::sensor::Triad;

use super::design::Design;
use super::detect::FALSE_ALARM;
use super::evidence::{Column, Evidence};
use super::pattern::{Pattern, best_generic};
use super::score::{Judged, Judgement, contradiction_of_stand, gain, judge, scattering_rests, traces};
use super::stage::{Beside, FitKey, Member, Stage};
use super::{Block, Linearised, NotPredictive, Score, Search};
use crate::calibrate::{Checked, EffectChoice, Options, UserField};
use crate::error::Error;
use crate::joint::{INSIDE, Kinds, Model, Prepared};
use crate::recording::Recording;

/// Rivals are this close in the logarithm of the evidence.
const RIVAL_NATS: f64 = 3.0;
/// Force inside the moves that scatters by this many times its noise, whatever effects are in the model, is that of a hand.
const CARRIED: f64 = 5.0;
const MOST_EFFECTS: usize = 6;
/// Width of the narrowest prior, in typical sizes.
const LEAST_WIDTH: f64 = 0.03;
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
    let mut hunt = Hunt::new(recordings, candidates, user_fields);
    let open = hunt.with_columns(recordings, candidates);
    checked.prepare(recordings, options, hunt.kinds, |prepared, accelerometer, gyroscope| {
        hunt.run(prepared, [accelerometer, gyroscope], open)
    })
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
    let mut hunt = Hunt::new(recordings, candidates, user_fields);
    let open = hunt.with_columns(recordings, candidates);
    Checked::try_new(recordings, options)?.prepare(
        recordings,
        options,
        hunt.kinds,
        |prepared, accelerometer, gyroscope| {
            let (stage, _) = hunt.start(prepared, [accelerometer, gyroscope], open)?;
            let Design { columns, model, candidates, .. } = &stage.design;
            let take = |range: std::ops::Range<usize>| {
                (0..columns.nrows()).map(|i| range.clone().map(|j| columns[(i, j)]).collect()).collect()
            };
            let last = columns.ncols() - 1;
            Ok(Linearised {
                residual: (0..columns.nrows()).map(|i| columns[(i, last)]).collect(),
                base: take(0..model.len()),
                candidates: candidates.iter().map(|c| (c.name.clone(), take(c.columns.clone()))).collect(),
            })
        },
    )
}

/// The smallest rms size of each effect that is seen with 90 % probability, with its unit; and the names of those that are not seen at
/// all, with what would show them.
pub type Visible = (Vec<(String, f64, String)>, Vec<(String, String)>);

/// How small each of the candidates could be and still be found beside the model without effects.
///
/// # Errors
/// As [`search`].
pub fn smallest_visible(
    recordings: &[Recording<'_>],
    options: &Options<'_>,
    candidates: &[EffectChoice],
) -> Result<Visible, Error> {
    let mut hunt = Hunt::new(recordings, candidates, &[]);
    let open = hunt.with_columns(recordings, candidates);
    Checked::try_new(recordings, options)?.prepare(
        recordings,
        options,
        hunt.kinds,
        |prepared, accelerometer, gyroscope| {
            let (stage, _) = hunt.start(prepared, [accelerometer, gyroscope], open)?;
            let judged = judge(&stage);
            hunt.left_out.extend(judged.blind);
            Ok((judged.visible, hunt.left_out.clone()))
        },
    )
}

/// What stays the same through a search.
pub(super) struct Hunt<'a> {
    pub(super) kinds: Kinds,
    /// Effects that cannot be seen, and what they need.
    left_out: Vec<(String, String)>,
    pub(super) user_fields: &'a [UserField<'a>],
    pub(super) samples: Vec<usize>,
    /// Fits that have been made: several stages stand at the same model.
    pub(super) fits: RefCell<Vec<(FitKey, Model)>>,
}

impl<'a> Hunt<'a> {
    fn new(recordings: &[Recording<'_>], candidates: &[EffectChoice], user_fields: &'a [UserField<'a>]) -> Self {
        let encoders = recordings.iter().all(|r| r.stand_rad.is_some())
            && candidates.iter().any(|choice| choice.effect.sensor == Sensor::Encoder);
        Self {
            kinds: Kinds { in_motion: true, encoders },
            left_out: Vec::new(),
            user_fields,
            samples: recordings.iter().map(Recording::len).collect(),
            fits: RefCell::new(Vec::new()),
        }
    }

    /// The candidates whose columns are there; the others are noted.
    fn with_columns(&mut self, recordings: &[Recording<'_>], candidates: &[EffectChoice]) -> Vec<EffectChoice> {
        let lacks = |choice: &EffectChoice| {
            let effect = choice.effect;
            if effect.needs.contains(&Need::Temperature) && recordings.iter().any(|r| r.temperature_degc.is_none()) {
                Some(format!("a temp_degc column, and {}", effect.observable))
            } else if effect.sensor == Sensor::Encoder && !self.kinds.encoders {
                Some(format!("stand_1, stand_2 and stand_3 columns, and {}", effect.observable))
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

    fn run(
        &mut self,
        prepared: &Prepared<'_>,
        triads: [&Triad<f64>; 2],
        open: Vec<EffectChoice>,
    ) -> Result<Search, Error> {
        let (mut stage, open) = self.start(prepared, triads, open)?;
        let first = judge(&stage);
        let traces = traces(&stage);
        let plain_scales = stage.evidence.scales.clone();
        let mut path: Vec<Score> = Vec::new();
        let mut skipped: Vec<String> = Vec::new();
        let mut not_predictive: Vec<NotPredictive> = Vec::new();
        let mut last: Option<Judgement> = None;
        while path.len() < MOST_EFFECTS {
            let judged = last.as_ref().unwrap_or(&first);
            let limit = FALSE_ALARM / judged.scores.len().max(1) as f64;
            let good = |s: &&Judged| {
                s.score.p_value < limit && s.score.log_bayes_factor > 0.0 && !skipped.contains(&s.score.name)
            };
            let Some(pick) = judged
                .scores
                .iter()
                .filter(good)
                .max_by(|a, b| a.score.log_bayes_factor.total_cmp(&b.score.log_bayes_factor))
            else {
                break;
            };
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
            let mut members = stage.members.clone();
            members.push(Member {
                name: pick.score.name.clone(),
                width: pick.width,
                shape: pick.shape,
                values: Vec::new(),
            });
            let near = [&stage.model.accelerometer, &stage.model.gyroscope];
            match self.stage(prepared, near, &open, &members, Beside::Candidates) {
                Ok(next) if next.evidence.log > stage.evidence.log => {
                    let near = |s: &&Judged| {
                        s.score.name != pick.score.name
                            && s.score.log_bayes_factor > pick.score.log_bayes_factor - RIVAL_NATS
                            && s.score.log_bayes_factor > 0.0
                    };
                    let rivals = judged.scores.iter().filter(near).map(|s| s.score.name.clone()).collect();
                    path.push(Score { rivals, ..pick.score.clone() });
                    stage = next;
                    // Before a second effect mends what the wrong one leaves.
                    if self.swap(prepared, &open, &mut stage, &mut path)? {
                        let near = [&stage.model.accelerometer, &stage.model.gyroscope];
                        stage = self.stage(prepared, near, &open, &stage.members, Beside::Candidates)?;
                    }
                    last = Some(judge(&stage));
                }
                // What is not determined, or does not help once it is really fitted, is no explanation.
                _ => skipped.push(pick.score.name.clone()),
            }
        }
        if self.eliminate(prepared, &open, &mut stage, &mut path)? {
            let near = [&stage.model.accelerometer, &stage.model.gyroscope];
            last = Some(judge(&self.stage(prepared, near, &open, &stage.members, Beside::Candidates)?));
        }
        let (patterns, contradiction) = self.patterns(prepared, triads, &open, &stage)?;
        let generic = patterns
            .into_iter()
            .filter_map(Pattern::winner)
            .max_by(|a, b| a.log_bayes_factor.total_cmp(&b.log_bayes_factor));
        let mut ranking: Vec<Score> = first.scores.iter().map(|judged| judged.score.clone()).collect();
        ranking.sort_by(|a, b| b.log_bayes_factor.total_cmp(&a.log_bayes_factor));
        // Beside the final model; of what is in it, beside the model without effects.
        let mut smallest_visible = last.map(|last| last.visible).unwrap_or_default();
        smallest_visible.extend(
            first
                .visible
                .into_iter()
                .filter(|(name, ..)| !smallest_visible.iter().any(|(n, ..)| n == name))
                .collect::<Vec<_>>(),
        );
        self.left_out.extend(first.blind);
        Ok(Search {
            path,
            ranking,
            generic: generic.map(|g| g.finding()),
            not_predictive,
            not_observable: self.left_out.clone(),
            smallest_visible,
            traces,
            scattering_rests: contradiction.or_else(|| scattering_rests(&stage, &plain_scales)),
            in_motion_left_out: (!self.kinds.in_motion).then(|| CARRIED_ALONG.to_owned()),
        })
    }

    /// The model without effects, and the candidates that are left: without those of the motion if a hand carried the unit.
    fn start(
        &mut self,
        prepared: &Prepared<'_>,
        triads: [&Triad<f64>; 2],
        mut open: Vec<EffectChoice>,
    ) -> Result<(Stage, Vec<EffectChoice>), Error> {
        if self.is_carried(prepared, triads, &open)? {
            self.kinds.in_motion = false;
            open.retain(|choice| {
                let blind = choice.effect.needs.contains(&Need::AngularAcceleration);
                if blind {
                    self.left_out.push((
                        choice.effect.name.to_owned(),
                        "turns on a stand: a hand carries the unit along".into(),
                    ));
                }
                !blind
            });
        }
        Ok((self.stage(prepared, triads, &open, &[], Beside::Candidates)?, open))
    }

    /// Generic hypotheses alone and on top of the path: on rests and moves from rest to rest, and inside the moves where these
    /// take part. With a stand, whether these residuals contradict it: the name, the factor and the chance of it.
    fn patterns(
        &mut self,
        prepared: &Prepared<'_>,
        triads: [&Triad<f64>; 2],
        open: &[EffectChoice],
        stage: &Stage,
    ) -> Result<(Vec<Pattern>, Option<(&'static str, f64, f64)>), Error> {
        let kinds = self.kinds;
        let (mut patterns, mut contradiction) = (Vec::new(), None);
        for in_motion in [false, true].into_iter().filter(|in_motion| kinds.in_motion || !in_motion) {
            self.kinds = Kinds { in_motion, encoders: false };
            // Inside the moves a scale shows better, and so do the effects that resemble it.
            let asked = |block: Block| in_motion || !kinds.in_motion || block != Block::GyroscopeScale;
            let found = self.pattern(prepared, triads, open, &stage.members, asked);
            self.kinds = kinds;
            let (pattern, with) = found?;
            patterns.push(pattern);
            if let (Some(with), true) = (with, kinds.encoders) {
                contradiction = contradiction_of_stand(&with, stage);
            }
        }
        Ok((patterns, contradiction))
    }

    /// The same on the residuals of `self.kinds`; what these do not determine says nothing here.
    fn pattern(
        &self,
        prepared: &Prepared<'_>,
        triads: [&Triad<f64>; 2],
        open: &[EffectChoice],
        members: &[Member],
        asked: impl Fn(Block) -> bool,
    ) -> Result<(Pattern, Option<Stage>), Error> {
        let is_inertial = |c: &&EffectChoice| c.effect.sensor != Sensor::Encoder;
        let inertial: Vec<EffectChoice> = open.iter().filter(is_inertial).copied().collect();
        let seen: Vec<EffectChoice> =
            inertial.iter().filter(|c| self.kinds.in_motion || !Kinds::needed_by(&[**c]).in_motion).copied().collect();
        let without = self.stage(prepared, triads, &[], &[], Beside::Generics)?;
        // What the motion shows, rests and moves may show a little, or not at all.
        let with = [inertial, seen].into_iter().find_map(|choices| {
            let own = |m: &&Member| {
                choices.iter().any(|c| c.effect.name == m.name) || self.user_fields.iter().any(|f| f.name == m.name)
            };
            let members: Vec<Member> = members.iter().filter(own).cloned().collect();
            if members.is_empty() {
                return None;
            }
            self.stage(prepared, triads, &choices, &members, Beside::Generics).ok()
        });
        let path = with.as_ref().map_or(0.0, |with| with.evidence.log - without.evidence.log);
        let best = |stage| best_generic(stage, &asked);
        let on_top = with.as_ref().and_then(best);
        Ok((Pattern { alone: best(&without), path, on_top }, with))
    }

    /// Whether the force inside the moves is that of a hand, whatever effect is allowed to explain it.
    fn is_carried(
        &self,
        prepared: &Prepared<'_>,
        triads: [&Triad<f64>; 2],
        open: &[EffectChoice],
    ) -> Result<bool, Error> {
        let is_far = |stage: &Stage, columns: &[Column]| {
            let gram = &stage.design.gram;
            let inside = gram.groups.iter().position(|group| *group == INSIDE);
            let far = |e: Evidence| inside.is_some_and(|g| e.scales[g] > CARRIED * CARRIED);
            let surely = gram.least_scale(INSIDE, columns).is_some_and(|least| least > CARRIED * CARRIED);
            surely || gram.evidence(columns).is_none_or(far)
        };
        let plain = self.stage(prepared, triads, open, &[], Beside::Nothing)?;
        // More columns only explain more.
        if !is_far(&plain, &plain.design.model) {
            return Ok(false);
        }
        let simple: Vec<EffectChoice> = open.iter().filter(|c| c.effect.shape.is_none()).copied().collect();
        let stage = self.stage(prepared, triads, &simple, &[], Beside::Candidates)?;
        let explaining = stage.design.candidates.iter().flat_map(|candidate| candidate.columns(10.0));
        let columns: Vec<Column> = stage.design.model.iter().copied().chain(explaining).collect();
        Ok(is_far(&stage, &columns))
    }

    /// Puts an alias with a time constant in the place of a member if it explains clearly more: until it is fitted its time constant is
    /// one of few. One that explains nearly as much is a rival. Says whether there was any to put.
    fn swap(
        &self,
        prepared: &Prepared<'_>,
        open: &[EffectChoice],
        stage: &mut Stage,
        path: &mut [Score],
    ) -> Result<bool, Error> {
        let mut swapped = false;
        let is_alias = |a: &Effect<f64>, b: &Effect<f64>| a.aliases.iter().any(|alias| alias.with == b.name);
        for k in 0..stage.members.len() {
            let name = stage.members[k].name.clone();
            let Some(own) = open.iter().find(|choice| choice.effect.name == name) else { continue };
            let is_other = |choice: &&EffectChoice| {
                let other = choice.effect;
                other.shape.is_some()
                    && (is_alias(other, own.effect) || is_alias(own.effect, other))
                    && !stage.members.iter().any(|member| member.name == other.name)
            };
            for other in open.iter().filter(is_other).collect::<Vec<_>>() {
                let near = [&stage.model.accelerometer, &stage.model.gyroscope];
                let typical = &other.effect.parameters[..other.effect.plain];
                let mut members = stage.members.clone();
                members[k] = Member { name: other.effect.name.to_owned(), width: 1.0, shape: None, values: Vec::new() };
                // Once to see how large it is, once with a prior as wide as that.
                let mut fit = || {
                    let found = self.stage(prepared, near, open, &members, Beside::Nothing).ok()?;
                    let sizes = found.members[k].values.iter().zip(typical).map(|(v, p)| (v / p.typical).powi(2));
                    members.clone_from(&found.members);
                    members[k].width = (sizes.sum::<f64>() / typical.len() as f64).sqrt().max(LEAST_WIDTH);
                    Some(found)
                };
                let Some(found) = fit().and_then(|_| fit()) else { continue };
                // Candidates are judged at their best time constant, and so is this one.
                let shape = found.place(other.effect.name).map_or(0, |place| place.end - 1);
                let mut columns = found.design.model.clone();
                columns.remove(shape);
                let Some(at_best) = found.design.gram.evidence(&columns) else { continue };
                let gain = at_best.log - stage.evidence.log;
                let Some(score) = path.iter_mut().find(|score| score.name == name) else { continue };
                let other = other.effect.name.to_owned();
                if gain > RIVAL_NATS {
                    *score = Score {
                        name: other,
                        log_bayes_factor: score.log_bayes_factor + gain,
                        rivals: Vec::new(),
                        ..score.clone()
                    };
                    *stage = found;
                    swapped = true;
                    break;
                } else if gain > -RIVAL_NATS && !score.rivals.contains(&other) {
                    score.rivals.push(other);
                }
            }
        }
        Ok(swapped)
    }

    /// Leaves out members that the model does as well without; says whether there were any.
    fn eliminate(
        &self,
        prepared: &Prepared<'_>,
        open: &[EffectChoice],
        stage: &mut Stage,
        path: &mut Vec<Score>,
    ) -> Result<bool, Error> {
        let before = stage.members.len();
        while stage.members.len() > 1 {
            let mut worst: Option<(usize, Stage)> = None;
            for k in 0..stage.members.len() {
                let mut members = stage.members.clone();
                members.remove(k);
                let near = [&stage.model.accelerometer, &stage.model.gyroscope];
                let Ok(without) = self.stage(prepared, near, open, &members, Beside::Nothing) else { continue };
                if without.evidence.log >= stage.evidence.log
                    && worst.as_ref().is_none_or(|(_, best)| without.evidence.log > best.evidence.log)
                {
                    worst = Some((k, without));
                }
            }
            let Some((k, without)) = worst else { break };
            path.retain(|score| score.name != stage.members[k].name);
            *stage = without;
        }
        Ok(stage.members.len() < before)
    }
}
