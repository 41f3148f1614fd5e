//! The forward path: score, add, refit; then leave out again what the others have made superfluous.

use faer::Mat;
use faer::linalg::solvers::Solve;
use imucal_core::effects::{Need, Sensor};
use imucal_core::sensor::Triad;

use super::design::{Candidate, Design, design};
use super::detect::{FALSE_ALARM, p_value, visible_noncentrality};
use super::evidence::{Column, Evidence};
use super::{GenericFinding, Linearised, Score, Search};
use crate::calibrate::{self, EffectChoice, Options, UserField};
use crate::error::Error;
use crate::joint::{self, INSIDE, Kinds, Model, Prepared, SHAPE_SHARES, Terms};
use crate::recording::Recording;

/// Prior widths in units of the typical size.
const WIDTHS: [f64; 4] = [0.3, 1.0, 3.0, 10.0];
const GENERIC_WIDTHS: [f64; 5] = [0.1, 0.3, 1.0, 3.0, 10.0];
/// So wide that the prior does not count.
const NO_PRIOR: f64 = 1e4;
/// Rivals are this close in the logarithm of the evidence.
const RIVAL_NATS: f64 = 3.0;
/// A generic hypothesis has to explain this much more than the path, and this much at all.
const GENERIC_LEAD: f64 = 3.0;
const GENERIC_LEAST: f64 = 8.0;
/// Ten typical effects must move chi2 by one.
const LEAST_CHANGE: f64 = 0.01;
/// Force inside the moves that scatters by this many times its noise, whatever effects are in the model, is that of a hand.
const CARRIED: f64 = 5.0;
const MOST_EFFECTS: usize = 6;
const CARRIED_ALONG: &str = "the unit was carried along inside the moves, not turned in one place";

/// Looks for effects among `candidates` and `user_fields`.
///
/// # Errors
/// As [`calibrate`](calibrate::calibrate()).
pub fn search(
    recordings: &[Recording<'_>],
    options: &Options<'_>,
    candidates: &[EffectChoice],
    user_fields: &[UserField<'_>],
) -> Result<Search, Error> {
    let mut hunt = Hunt::new(recordings, candidates, user_fields);
    let open = hunt.with_columns(recordings, candidates);
    calibrate::prepare(recordings, options, hunt.kinds, |prepared, accelerometer, gyroscope| {
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
    calibrate::prepare(recordings, options, hunt.kinds, |prepared, accelerometer, gyroscope| {
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
    })
}

/// What stays the same through a search.
struct Hunt<'a> {
    kinds: Kinds,
    /// Effects that cannot be seen, and what they need.
    left_out: Vec<(String, String)>,
    user_fields: &'a [UserField<'a>],
    samples: Vec<usize>,
}

/// A model on the path.
struct Stage {
    design: Design,
    evidence: Evidence,
    /// The fit.
    model: Model,
    /// The catalogue's effects in it, the user's, and the prior's width of each.
    members: Vec<Member>,
}

#[derive(Clone)]
struct Member {
    name: String,
    width: f64,
    /// Where its time constant starts, if it has one.
    shape: Option<f64>,
    /// Its parameters in the last fit; empty before.
    values: Vec<f64>,
}

/// What is linearised beside a model.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Beside {
    Candidates,
    Generics,
    Nothing,
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
        let first = self.judge(&stage);
        let start_log = stage.evidence.log;
        let mut path: Vec<Score> = Vec::new();
        let mut skipped: Vec<String> = Vec::new();
        while path.len() < MOST_EFFECTS {
            let judged = self.judge(&stage);
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
                }
                // What is not determined, or does not help once it is really fitted, is no explanation.
                _ => skipped.push(pick.score.name.clone()),
            }
        }
        self.eliminate(prepared, &open, &mut stage, &mut path)?;
        let path_log_bayes_factor = stage.evidence.log - start_log;
        let excess = stage.evidence.scales.iter().copied().fold(1.0, f64::max).sqrt();
        let pattern = self.pattern(prepared, triads, &open, &stage.members)?;
        let generic_log_bayes_factor = pattern.alone.as_ref().map_or(0.0, |g| g.log_bayes_factor);
        let generic = pattern.winner();
        let mut ranking: Vec<Score> = first.scores.iter().map(|judged| judged.score.clone()).collect();
        ranking.sort_by(|a, b| b.log_bayes_factor.total_cmp(&a.log_bayes_factor));
        self.left_out.extend(first.blind);
        Ok(Search {
            path,
            ranking,
            generic: generic.map(|g| g.finding(prepared)),
            path_log_bayes_factor,
            generic_log_bayes_factor,
            not_observable: self.left_out.clone(),
            smallest_visible: first.visible,
            excess_scatter: excess,
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
        let mut stage = self.stage(prepared, triads, &open, &[], Beside::Candidates)?;
        if self.is_carried(&stage) {
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
            stage = self.stage(prepared, triads, &open, &[], Beside::Candidates)?;
        }
        Ok((stage, open))
    }

    /// Generic hypotheses alone and on top of the path, on rests and moves from rest to rest.
    fn pattern(
        &mut self,
        prepared: &Prepared<'_>,
        triads: [&Triad<f64>; 2],
        open: &[EffectChoice],
        members: &[Member],
    ) -> Result<Pattern, Error> {
        let kinds = self.kinds;
        self.kinds = Kinds { in_motion: false, encoders: false };
        let seen: Vec<EffectChoice> = open.iter().filter(|c| Kinds::needed_by(&[**c]) == self.kinds).copied().collect();
        let own = |m: &&Member| {
            seen.iter().any(|c| c.effect.name == m.name) || self.user_fields.iter().any(|f| f.name == m.name)
        };
        let members: Vec<Member> = members.iter().filter(own).cloned().collect();
        let without = self.stage(prepared, triads, &[], &[], Beside::Generics);
        let with = (!members.is_empty()).then(|| self.stage(prepared, triads, &seen, &members, Beside::Generics));
        self.kinds = kinds;
        let (without, with) = (without?, with.transpose()?);
        let path = with.as_ref().map_or(0.0, |with| with.evidence.log - without.evidence.log);
        let on_top = with.as_ref().and_then(best_generic).map_or(0.0, |g| g.log_bayes_factor);
        Ok(Pattern { alone: best_generic(&without), path, on_top })
    }

    /// Fits the model with these members, from `near`, and linearises what is beside it.
    fn stage(
        &self,
        prepared: &Prepared<'_>,
        near: [&Triad<f64>; 2],
        open: &[EffectChoice],
        members: &[Member],
        beside: Beside,
    ) -> Result<Stage, Error> {
        let is_member = |name: &str| members.iter().any(|member| member.name == name);
        let own: Vec<EffectChoice> =
            members.iter().filter_map(|m| open.iter().find(|choice| choice.effect.name == m.name)).copied().collect();
        let fields: Vec<UserField<'_>> = self.user_fields.iter().filter(|f| is_member(f.name)).cloned().collect();
        let terms = Terms::try_new(&own, &fields, &self.samples, self.kinds)?;
        let mut start = joint::start_model(prepared, &terms, near[0], near[1]);
        let mut precisions = vec![0.0; terms.count];
        for term in &terms.all {
            let Some(member) = members.iter().find(|m| m.name == term.name()) else { continue };
            for (k, typical) in term.typical().iter().enumerate() {
                precisions[term.first + k] = 1.0 / (member.width * typical).powi(2);
            }
            let own = &mut start.values[term.first..term.first + term.count()];
            if member.values.len() == own.len() {
                own.copy_from_slice(&member.values);
            } else if let (true, Some(shape)) = (term.has_shape(), member.shape) {
                own[term.linear] = shape;
            }
        }
        let model = joint::fit_for_search(prepared, &terms, &start)?;

        let rest: Vec<EffectChoice> =
            open.iter().filter(|c| beside == Beside::Candidates && !is_member(c.effect.name)).copied().collect();
        let (timed, plain): (Vec<_>, Vec<_>) = rest.into_iter().partition(|choice| choice.effect.shape.is_some());
        let free = self.user_fields.iter().filter(|f| beside == Beside::Candidates && !is_member(f.name));
        let all_fields: Vec<UserField<'_>> = fields.iter().chain(free).cloned().collect();
        let choices: Vec<EffectChoice> = own.iter().chain(&plain).copied().collect();
        let mut all = Terms::try_new(&choices, &all_fields, &self.samples, self.kinds)?;
        let longest_s = prepared.recordings.iter().map(|r| r.time_s[r.len() - 1] - r.time_s[0]).fold(0.0, f64::max);
        for (choice, share) in timed.iter().flat_map(|choice| SHAPE_SHARES.map(|share| (choice, share))) {
            all.push_frozen(choice.effect, share * longest_s)?;
        }
        let mut values = vec![0.0; all.count];
        for term in &terms.all {
            if let Some(same) = all.all.iter().find(|other| other.name() == term.name()) {
                let own = &model.values[term.first..term.first + term.count()];
                values[same.first..same.first + same.count()].copy_from_slice(own);
            }
        }
        let generics = beside == Beside::Generics;
        let design = design(prepared, (&terms, &precisions), (&all, &values), &model, generics)?;
        let evidence = design
            .gram
            .evidence(&design.model)
            .ok_or_else(|| Error::Fit("the evidence of the model cannot be computed: check the recordings".into()))?;
        let mut members = members.to_vec();
        for member in &mut members {
            if let Some(term) = terms.all.iter().find(|term| term.name() == member.name) {
                member.values = model.values[term.first..term.first + term.count()].to_vec();
            }
        }
        Ok(Stage { design, evidence, members, model })
    }

    /// Whether the force inside the moves is that of a hand, whatever effect is allowed to explain it.
    fn is_carried(&self, stage: &Stage) -> bool {
        let mut columns = stage.design.model.clone();
        for candidate in stage.design.candidates.iter().filter(|c| c.shape.is_none()) {
            columns.extend(candidate.columns(10.0));
        }
        let explained = stage.design.gram.evidence(&columns);
        let inside = stage.design.gram.groups.iter().position(|group| *group == INSIDE);
        let scale = |e: Evidence| inside.is_some_and(|g| e.scales[g] > CARRIED * CARRIED);
        explained.is_none_or(scale)
    }

    /// Scores all candidates beside the model of a stage.
    fn judge(&self, stage: &Stage) -> Judgement {
        let Design { gram, model, candidates, .. } = &stage.design;
        let mut names: Vec<&str> = candidates.iter().map(|c| c.name.as_str()).collect();
        names.dedup();
        let (mut scores, mut blind, mut visible): (Vec<Judged>, Vec<_>, Vec<_>) = (Vec::new(), Vec::new(), Vec::new());
        let mut spectra = Vec::new();
        for candidate in candidates {
            let spectrum = projected(gram, model, candidate, &stage.evidence.scales);
            spectra.push(spectrum.into_iter().filter(|value| *value >= LEAST_CHANGE).collect::<Vec<f64>>());
        }
        let tests = {
            let mut seen: Vec<&str> =
                candidates.iter().zip(&spectra).filter(|(_, s)| !s.is_empty()).map(|(c, _)| c.name.as_str()).collect();
            seen.sort_unstable();
            seen.dedup();
            seen.len()
        };
        for (candidate, spectrum) in candidates.iter().zip(&spectra) {
            if spectrum.is_empty() {
                if !blind.iter().any(|(name, _)| *name == candidate.name) {
                    blind.push((candidate.name.clone(), self.observable(&candidate.name)));
                }
                continue;
            }
            let dof = spectrum.len();
            let noncentrality = visible_noncentrality(dof, tests);
            let size = (noncentrality / spectrum.iter().sum::<f64>()).sqrt() * candidate.typical[0];
            match visible.iter_mut().find(|(name, _, _): &&mut (String, f64, String)| *name == candidate.name) {
                Some(entry) => entry.1 = entry.1.min(size),
                None => visible.push((candidate.name.clone(), size, self.unit(&candidate.name))),
            }
            let with = |width: f64| {
                let columns: Vec<Column> = model.iter().copied().chain(candidate.columns(width)).collect();
                gram.evidence(&columns)
            };
            let best = WIDTHS
                .iter()
                .filter_map(|&width| Some((with(width)?.log - stage.evidence.log, width)))
                .max_by(|a, b| a.0.total_cmp(&b.0));
            let (Some((log_bayes_factor, width)), Some(free)) = (best, with(NO_PRIOR)) else { continue };
            let statistic = (stage.evidence.deviance - free.deviance).max(0.0);
            let score = Score {
                name: candidate.name.clone(),
                log_bayes_factor,
                statistic,
                dof,
                p_value: p_value(statistic, dof + usize::from(candidate.shape.is_some())),
                rivals: Vec::new(),
            };
            let judged = Judged { score, width, shape: candidate.shape };
            match scores.iter_mut().find(|other| other.score.name == candidate.name) {
                Some(other) if other.score.log_bayes_factor >= log_bayes_factor => {}
                Some(other) => *other = judged,
                None => scores.push(judged),
            }
        }
        blind.retain(|(name, _)| !scores.iter().any(|judged| judged.score.name == *name));
        Judgement { scores, blind, visible }
    }

    fn observable(&self, name: &str) -> String {
        imucal_core::effects::Effect::<f64>::find(name)
            .map_or_else(|| "data in which its field changes".to_owned(), |effect| effect.observable.to_owned())
    }

    fn unit(&self, name: &str) -> String {
        let effect = imucal_core::effects::Effect::<f64>::find(name);
        effect.and_then(|effect| effect.parameters.first()).map_or_else(String::new, |p| p.unit.to_owned())
    }

    /// Leaves out members that the model does as well without.
    fn eliminate(
        &self,
        prepared: &Prepared<'_>,
        open: &[EffectChoice],
        stage: &mut Stage,
        path: &mut Vec<Score>,
    ) -> Result<(), Error> {
        while stage.members.len() > 1 {
            let mut worst: Option<(usize, Stage)> = None;
            for k in 0..stage.members.len() {
                let mut members = stage.members.clone();
                members.remove(k);
                let near = [&stage.model.accelerometer, &stage.model.gyroscope];
                let without = self.stage(prepared, near, open, &members, Beside::Nothing)?;
                if without.evidence.log >= stage.evidence.log
                    && worst.as_ref().is_none_or(|(_, best)| without.evidence.log > best.evidence.log)
                {
                    worst = Some((k, without));
                }
            }
            let Some((k, without)) = worst else { return Ok(()) };
            path.retain(|score| score.name != stage.members[k].name);
            *stage = without;
        }
        Ok(())
    }
}

struct Judged {
    score: Score,
    width: f64,
    shape: Option<f64>,
}

struct Judgement {
    scores: Vec<Judged>,
    blind: Vec<(String, String)>,
    visible: Vec<(String, f64, String)>,
}

impl Candidate {
    /// Its columns with a prior of this width.
    fn columns(&self, width: f64) -> impl Iterator<Item = Column> {
        self.columns.clone().zip(&self.typical).map(move |(place, typical)| Column {
            place,
            precision: 1.0 / (width * typical).powi(2),
            value: 0.0,
        })
    }
}

/// What each direction of an effect's parameters, at typical size, moves chi2 by, after projection of the model.
fn projected(gram: &super::evidence::Gram, model: &[Column], candidate: &Candidate, scales: &[f64]) -> Vec<f64> {
    let sum = |i: usize, j: usize| gram.sums.iter().zip(scales).map(|(g, s)| g[(i, j)] / s).sum::<f64>();
    let n = model.len();
    let size: Vec<f64> = model.iter().map(|c| sum(c.place, c.place).sqrt().max(1e-300)).collect();
    let normal = Mat::from_fn(n, n, |i, j| {
        let jitter = if i == j { 1e-12 } else { 0.0 };
        sum(model[i].place, model[j].place) / (size[i] * size[j]) + jitter
    });
    let p = candidate.typical.len();
    let place = |k: usize| candidate.columns.start + k;
    let cross = Mat::from_fn(n, p, |i, k| sum(model[i].place, place(k)) / size[i] * candidate.typical[k]);
    let own = Mat::from_fn(p, p, |a, b| sum(place(a), place(b)) * candidate.typical[a] * candidate.typical[b]);
    let Ok(factor) = normal.llt(faer::Side::Lower) else { return Vec::new() };
    let left = own - cross.transpose() * factor.solve(&cross);
    let symmetric = Mat::from_fn(p, p, |a, b| (left[(a, b)] + left[(b, a)]) / 2.0);
    let Ok(eigen) = symmetric.self_adjoint_eigen(faer::Side::Lower) else { return Vec::new() };
    // What is below the rounding of what was subtracted is nothing.
    let rounding = 1e-9 * (0..p).map(|k| sum(place(k), place(k)) * candidate.typical[k].powi(2)).sum::<f64>();
    (0..p).map(|k| eigen.S()[k]).map(|value| if value > rounding { value } else { 0.0 }).collect()
}

struct BestGeneric {
    index: usize,
    block: super::Block,
    kernel: super::Kernel,
    log_bayes_factor: f64,
    /// Bias of each epoch, SI units.
    biases: Vec<[f64; 3]>,
}

/// The generic hypothesis with the largest evidence beside a model.
fn best_generic(stage: &Stage) -> Option<BestGeneric> {
    let Design { gram, model, generics, .. } = &stage.design;
    let mut best: Option<BestGeneric> = None;
    for (index, generic) in generics.iter().enumerate() {
        for width in GENERIC_WIDTHS {
            let precision = 1.0 / (width * generic.typical).powi(2);
            let own = generic.columns.clone().map(|place| Column { place, precision, value: 0.0 });
            let columns: Vec<Column> = model.iter().copied().chain(own).collect();
            let Some(evidence) = gram.evidence(&columns) else { continue };
            let log_bayes_factor = evidence.log - stage.evidence.log;
            if best.as_ref().is_some_and(|best| best.log_bayes_factor >= log_bayes_factor) {
                continue;
            }
            let weights = &evidence.theta[model.len()..];
            let bias = |epoch: usize, axis: usize| -> f64 {
                (0..generic.factor.ncols()).map(|c| generic.factor[(epoch, c)] * weights[3 * c + axis]).sum()
            };
            let biases = (0..generic.factor.nrows()).map(|e| [0, 1, 2].map(|axis| bias(e, axis))).collect();
            best = Some(BestGeneric { index, block: generic.block, kernel: generic.kernel, log_bayes_factor, biases });
        }
    }
    let found = best?;
    let generic = &generics[found.index];
    let raw = generic.typical / generic.block.typical_si();
    Some(BestGeneric { biases: found.biases.iter().map(|b| b.map(|v| v / raw)).collect(), ..found })
}

/// Logarithms of Bayes factors on the residuals that generic hypotheses act on.
struct Pattern {
    /// The best one against no effect.
    alone: Option<BestGeneric>,
    /// The path against no effect.
    path: f64,
    /// The best one on top of the path, against the path.
    on_top: f64,
}

impl Pattern {
    /// The generic hypothesis, if it explains more than the path, or if with it the path explains nothing more.
    fn winner(self) -> Option<BestGeneric> {
        let (path, on_top) = (self.path, self.on_top);
        self.alone.filter(|g| {
            let more = g.log_bayes_factor > path + GENERIC_LEAD;
            let superfluous = on_top > GENERIC_LEAST && path + on_top < g.log_bayes_factor + GENERIC_LEAD;
            g.log_bayes_factor > GENERIC_LEAST && (more || superfluous)
        })
    }
}

impl BestGeneric {
    fn finding(self, prepared: &Prepared<'_>) -> GenericFinding {
        let used: Vec<usize> = (0..prepared.rests.len()).filter(|&k| prepared.used[k]).collect();
        let rms = |axis: usize| {
            (self.biases.iter().map(|b| b[axis] * b[axis]).sum::<f64>() / self.biases.len().max(1) as f64).sqrt()
        };
        let axis = (0..3).max_by(|&a, &b| rms(a).total_cmp(&rms(b))).unwrap_or(0);
        let mut order: Vec<usize> = (0..self.biases.len()).collect();
        order.sort_by(|&a, &b| self.biases[b][axis].abs().total_cmp(&self.biases[a][axis].abs()));
        GenericFinding {
            block: self.block,
            kernel: self.kernel,
            log_bayes_factor: self.log_bayes_factor,
            axis,
            rests: order.into_iter().take(3).map(|e| used[e]).collect(),
            rms: rms(axis),
        }
    }
}
