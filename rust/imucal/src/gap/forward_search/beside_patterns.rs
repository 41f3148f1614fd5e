//! Selects effects while generic hypotheses are part of the model. A generic hypothesis is a variation of a bias or
//! scale that no effect of the catalogue describes. Effects are therefore found even if an unknown or random variation
//! is also present.
//!
//! A forward search without the variation in the model may select effects that only resemble the variation. It may also
//! miss effects, because residuals of the variation hide them. The Jacobian columns of the generic hypotheses and the
//! prior of their coefficients add the variation to the covariance of the residuals. A selected effect is kept, and a
//! further candidate is added, only if it is significant in this extended model.

use faer::Mat;
use imucal_core::effects::{Effect, Sensor};
use imucal_core::sensor::Triad;

use super::{ForwardSearch, LEAST_WIDTH, MOST_EFFECTS, Selected};
use crate::calibrate::EffectChoice;
use crate::error::Error;
use crate::gap::Score;
use crate::gap::detect::FALSE_ALARM;
use crate::gap::evidence::Column;
use crate::gap::generic::{Block, Hypothesis};
use crate::gap::kernel::Kernel;
use crate::gap::moments::Setting;
use crate::gap::pattern::{BestGeneric, Pattern};
use crate::gap::predict::Gain;
use crate::gap::score::{Judged, gain, judge};
use crate::gap::stage::{Beside, Member, Stage};
use crate::joint::{Prepared, Terms};
use crate::numerics::stats::p_value;

/// Minimum log Bayes factor, nats, for an effect to be selected if generic hypotheses (unknown variations of a bias or
/// scale) are in the model. 8 nats are odds of 3000 to 1.
const LEAST: f64 = 8.0;
/// An effect is selected only if its likelihood ratio statistic exceeds SHARE x the statistic of the generic hypotheses
/// in the model. The hypotheses describe the variation only approximately, so an effect with a smaller statistic may
/// only fit the approximation error.
const SHARE: f64 = 0.02;
/// Threshold of differences in log evidence, nats. A candidate is a rival of the best candidate if its log evidence is
/// smaller by less than this threshold. A random walk replaces other hypotheses, and an alias (effect with nearly the
/// same residuals) replaces an effect, if the log evidence increases by more than this. 3 nats are odds of 20 to 1.
const RIVAL_NATS: f64 = 3.0;
/// Effects that are not selected if the gyroscope bias varies with heading. The cause of such a variation may be an
/// external field, for example a magnetic field. The errors due to the vertical component of the field then depend on
/// the direction of gravity, like the errors of these effects.
pub(super) const OF_FIELDS: [&str; 3] = ["gyro_g_sensitivity", "gyro_g2_sensitivity", "earth_rate"];
/// Effects that are functions of time. A random walk of the bias may be mistaken for them.
pub(in crate::gap) const OF_TIME: [&str; 4] =
    ["gyro_bias_drift", "gyro_bias_warmup", "accel_bias_drift", "accel_bias_warmup"];
/// Trial standard deviations of the prior of a random walk, in multiples of the typical deviation of the bias
/// ([`Block::typical`]).
const WALK_WIDTHS: [f64; 3] = [0.1, 0.5, 2.5];
/// A parameter is removed from a model by a narrow prior with mean zero. The precision of this prior is REMOVED x the
/// information of the data about the parameter.
const REMOVED: f64 = 1e6;

/// A generic hypothesis (unknown variation of a bias or scale) whose columns are part of a model.
#[derive(Clone, Copy, PartialEq)]
pub(super) struct Varying {
    block: Block,
    kernel: Kernel,
    /// Standard deviation of the prior of each coefficient, in multiples of the typical deviation of the parameter.
    width: f64,
}

/// Returns the generic hypotheses in `patterns` that are significant in the model with the selected effects, without
/// duplicates. If no hypothesis is significant in this model, the function instead returns the hypotheses that explain
/// the residuals better than the selected effects. Such a hypothesis may describe the same errors as a selected effect.
/// For example, a smooth function of the rate can describe a cubic scale error.
fn varying(patterns: &[Pattern]) -> Vec<Varying> {
    let mut all: Vec<Varying> = Vec::new();
    let mut add = |block: Block, kernel: Kernel, width: f64| {
        if !all.iter().any(|own| (own.block, own.kernel) == (block, kernel)) {
            all.push(Varying { block, kernel, width });
        }
    };
    let besides: Vec<&BestGeneric> = patterns.iter().filter_map(Pattern::besides).collect();
    let instead = patterns.iter().filter_map(Pattern::instead).filter(|_| besides.is_empty());
    for found in besides.iter().copied().chain(instead) {
        add(found.block, found.kernel, found.width);
        if found.kernel == Kernel::Heading {
            add(found.block, Kernel::Attitude, found.width);
        }
    }
    all
}

/// Whether one of the significant hypotheses in `patterns` is a gyroscope bias that varies with heading.
pub(super) fn turns_with_heading(patterns: &[Pattern]) -> bool {
    let is_of_heading =
        |own: &Varying| own.block == Block::GyroscopeBias && matches!(own.kernel, Kernel::Heading | Kernel::Attitude);
    varying(patterns).iter().any(is_of_heading)
}

/// Effects that are significant with generic hypotheses in the model.
pub(super) struct KnownEffects {
    pub(super) members: Vec<Member>,
    pub(super) path: Vec<Score>,
    /// Log evidence of the model with these effects and the generic hypotheses.
    log: f64,
}

/// A model that contains the columns of generic hypotheses (unknown variations of a bias or scale).
struct Extended {
    stage: Stage,
    /// Likelihood ratio statistic of the model with the hypotheses relative to the model without them.
    statistic: f64,
}

impl ForwardSearch<'_> {
    /// The effects that are significant if the generic hypotheses of `patterns` are in the model; `None` if no
    /// hypothesis is significant.
    ///
    /// The random walk of a bias is tried instead of these hypotheses in two cases. In the first case, the hypotheses
    /// explain the residuals better than all selected effects, and may therefore describe one of the effects. In the
    /// second case, selected effects are functions of time, and a random walk resembles such effects.
    pub(super) fn known_effects(
        &mut self,
        prepared: &Prepared<'_>,
        triads: [&Triad<f64>; 2],
        open: &[EffectChoice],
        selected: &Selected,
        patterns: &[Pattern],
    ) -> Result<Option<KnownEffects>, Error> {
        let first = varying(patterns);
        let are_displaced = !patterns.iter().any(|pattern| pattern.besides().is_some());
        let mut best = match first.is_empty() {
            true => None,
            false => Some(self.beside_patterns(prepared, triads, open, selected, &first, &[1.0])?),
        };
        for block in [Block::GyroscopeBias, Block::AccelerometerBias] {
            let is_of_time = |score: &Score| {
                let sensor = Effect::<f64>::find(&score.name).map(|effect| effect.sensor);
                OF_TIME.contains(&score.name.as_str()) && sensor == Some(block.sensor())
            };
            let is_walk = |own: &Varying| (own.block, own.kernel) == (block, Kernel::RandomWalk);
            let is_possible = selected.path.iter().any(is_of_time)
                || (are_displaced && first.iter().any(|own| own.block.sensor() == block.sensor()));
            // The hypotheses are evaluated without the residuals of the stand, so their evidence cannot be compared
            // with the evidence of a model that includes these residuals.
            let is_comparable = best.is_some() || !self.kinds.encoders;
            if !is_possible || !is_comparable || first.iter().any(is_walk) {
                continue;
            }
            let walk = Varying { block, kernel: Kernel::RandomWalk, width: 1.0 };
            let found = self.beside_patterns(prepared, triads, open, selected, &[walk], &WALK_WIDTHS)?;
            let reference = best.as_ref().map_or(selected.stage.evidence.log, |best| best.log);
            if found.log > reference + RIVAL_NATS {
                best = Some(found);
            }
        }
        Ok(best)
    }

    /// Selects the effects that are significant if the generic hypotheses `varying` are in the model, and computes the
    /// scores of the effects in this model. The prior widths of the hypotheses are multiplied by each trial factor in
    /// `widths`, and the factor with the largest evidence is used. Effects of the stand are not candidates, because the
    /// hypotheses do not describe the residuals relative to the stand's angles.
    fn beside_patterns(
        &mut self,
        prepared: &Prepared<'_>,
        triads: [&Triad<f64>; 2],
        open: &[EffectChoice],
        selected: &Selected,
        varying: &[Varying],
        widths: &[f64],
    ) -> Result<KnownEffects, Error> {
        let kinds = self.kinds;
        let has_stand = kinds.encoders;
        let ground = if has_stand { self.ground.borrow_mut().take() } else { None };
        self.kinds.encoders = false;
        let found = self.judged_beside(prepared, triads, open, selected, (varying, widths));
        self.kinds = kinds;
        if has_stand {
            *self.ground.borrow_mut() = ground;
        }
        found
    }

    fn judged_beside(
        &self,
        prepared: &Prepared<'_>,
        triads: [&Triad<f64>; 2],
        open: &[EffectChoice],
        selected: &Selected,
        (varying, widths): (&[Varying], &[f64]),
    ) -> Result<KnownEffects, Error> {
        let is_judged = |choice: &&EffectChoice| choice.effect.sensor != Sensor::Encoder;
        let open: Vec<EffectChoice> = open.iter().filter(is_judged).copied().collect();
        let is_left = |name: &str| {
            open.iter().any(|choice| choice.effect.name == name) || self.user_fields.iter().any(|f| f.name == name)
        };
        let mut members: Vec<Member> =
            selected.stage.members.iter().filter(|member| is_left(&member.name)).cloned().collect();
        let mut path: Vec<Score> = selected.path.iter().filter(|score| is_left(&score.name)).cloned().collect();
        let with = |members: &[Member], width: f64| -> Result<Option<Extended>, Error> {
            let stage = self.stage(prepared, triads, &open, members, Beside::Candidates)?;
            let varying: Vec<Varying> =
                varying.iter().map(|own| Varying { width: width * own.width, ..*own }).collect();
            self.extended(prepared, &open, stage, &varying)
        };
        let nothing = KnownEffects { members: Vec::new(), path: Vec::new(), log: f64::NEG_INFINITY };
        let mut best: Option<(f64, Extended)> = None;
        for &width in widths {
            let Some(found) = with(&members, width)? else { return Ok(nothing) };
            if best.as_ref().is_none_or(|(_, best)| found.stage.evidence.log > best.stage.evidence.log) {
                best = Some((width, found));
            }
        }
        let Some((width, mut beside)) = best else { return Ok(nothing) };
        let extended = |members: &[Member]| with(members, width);
        let tests = beside.stage.design.candidates.len() + members.len();
        let limit = FALSE_ALARM / tests.max(1) as f64;
        let is_sound = |score: &Score, beside: &Extended| {
            score.log_bayes_factor > LEAST && score.p_value < limit && score.statistic > SHARE * beside.statistic
        };
        if retain(&beside, &mut members, &mut path, is_sound) {
            let Some(again) = extended(&members)? else { return Ok(nothing) };
            beside = again;
        }
        self.swap_aliases((&mut members, &mut path), &mut beside, &open, extended);
        let mut skipped: Vec<String> = Vec::new();
        while members.len() < MOST_EFFECTS {
            let judged = judge(&beside.stage);
            // The design may also contain columns of effects that are not candidates here, for example effects of the
            // stand.
            let judged_here = judged.scores.iter().filter(|judged| is_left(&judged.score.name));
            let pick = judged_here.filter(|judged| is_sound(&judged.score, &beside));
            let pick = pick
                .filter(|judged| !skipped.contains(&judged.score.name))
                .max_by(|a, b| a.score.log_bayes_factor.total_cmp(&b.score.log_bayes_factor));
            let Some(pick) = pick else { break };
            let joined = pick.beside(&members);
            let next = match gain(&beside.stage, pick).is_none_or(|gain| gain.is_sure()) {
                true => extended(&joined).ok().flatten(),
                false => None,
            };
            match next.filter(|next| next.stage.evidence.log > beside.stage.evidence.log) {
                Some(next) => {
                    path.push(Score { rivals: rivals(&judged.scores, pick), ..pick.score.clone() });
                    (members, beside) = (joined, next);
                }
                None => skipped.push(pick.score.name.clone()),
            }
        }
        let log = beside.stage.evidence.log;
        retain(&beside, &mut members, &mut path, is_sound);
        Ok(KnownEffects { members, path, log })
    }

    /// Replaces an effect by one of its aliases (effects that cause nearly the same residuals) if the alias has a
    /// larger evidence in the model with the hypotheses. Such a replacement may be needed, because the effect was
    /// selected in a model without the hypotheses. The unknown variation was then part of the residuals and may have
    /// favoured the wrong effect.
    fn swap_aliases(
        &self,
        (members, path): (&mut [Member], &mut [Score]),
        beside: &mut Extended,
        open: &[EffectChoice],
        extended: impl Fn(&[Member]) -> Result<Option<Extended>, Error>,
    ) {
        let is_alias = |a: &Effect<f64>, b: &Effect<f64>| a.aliases.iter().any(|alias| alias.with == b.name);
        for k in 0..members.len() {
            let Some(own) = Effect::<f64>::find(&members[k].name) else { continue };
            let is_other = |choice: &&EffectChoice| {
                let other = choice.effect;
                (is_alias(other, own) || is_alias(own, other))
                    && other.shape.is_none()
                    && !members.iter().any(|member| member.name == other.name)
            };
            for other in open.iter().filter(is_other).map(|choice| choice.effect).collect::<Vec<_>>() {
                let mut instead = members.to_vec();
                instead[k] = Member::plain(other);
                // The first fit determines the size of the alias. In the second fit, this size is the width of the
                // alias's prior.
                let Ok(Some(first)) = extended(&instead) else { continue };
                let Some(member) = first.stage.members.get(k) else { continue };
                let typical = &other.parameters[..other.plain];
                let sizes = member.values.iter().zip(typical).map(|(value, p)| (value / p.typical).powi(2));
                let width = (sizes.sum::<f64>() / typical.len() as f64).sqrt().max(LEAST_WIDTH);
                instead[k].width = width;
                let Ok(Some(found)) = extended(&instead) else { continue };
                if found.stage.evidence.log > beside.stage.evidence.log + RIVAL_NATS {
                    if let Some(score) = path.iter_mut().find(|score| score.name == members[k].name) {
                        (score.name, score.dof) = (other.name.to_owned(), typical.len());
                        score.parameters = typical.len();
                    }
                    members.clone_from_slice(&instead);
                    *beside = found;
                    break;
                }
            }
        }
    }

    /// Adds the columns of the hypotheses to the fitted model of `stage`; `None` if no hypothesis is observable.
    fn extended(
        &self,
        prepared: &Prepared<'_>,
        open: &[EffectChoice],
        stage: Stage,
        varying: &[Varying],
    ) -> Result<Option<Extended>, Error> {
        let (own, fields) = self.of_members(open, &stage.members);
        let terms = Terms::try_new(&own, &fields, &self.samples, self.kinds)?;
        let setting = Setting::new(prepared, &terms, &stage.model)?;
        if !setting.has_axes(stage.design.axes()) {
            return Ok(None);
        }
        let of = |hypothesis: &Hypothesis| {
            varying.iter().find(|own| (own.block, own.kernel) == (hypothesis.block, hypothesis.kernel))
        };
        let wanted = |block, kernel| varying.iter().any(|own| (own.block, own.kernel) == (block, kernel));
        let (mut all, mut precisions): (Vec<Mat<f64>>, Vec<f64>) = (Vec::new(), Vec::new());
        for hypothesis in setting.hypotheses(wanted) {
            let Some(own) = of(&hypothesis) else { continue };
            let columns = setting.columns(&hypothesis);
            precisions.extend(vec![(own.width * hypothesis.typical()).powi(-2); columns.ncols()]);
            all.push(columns);
        }
        let Some(rows) = all.first().map(Mat::nrows) else { return Ok(None) };
        let mut together = Mat::zeros(rows, precisions.len());
        let mut first = 0;
        for columns in &all {
            together.subcols_mut(first, columns.ncols()).copy_from(columns);
            first += columns.ncols();
        }
        let design = stage.design.with_columns(&together, &precisions);
        let Some(evidence) = design.gram.evidence_near(&design.model, &stage.evidence.scales) else { return Ok(None) };
        let statistic = stage.evidence.deviance - evidence.deviance;
        Ok(Some(Extended { stage: Stage { design: design.into(), evidence, ..stage }, statistic }))
    }
}

/// Removes effects that are not significant with the hypotheses in the model, and updates the scores of the remaining
/// effects. Returns whether an effect was removed.
fn retain(
    beside: &Extended,
    members: &mut Vec<Member>,
    path: &mut Vec<Score>,
    is_sound: impl Fn(&Score, &Extended) -> bool,
) -> bool {
    if path.is_empty() {
        return false;
    }
    let before = members.len();
    let Stage { design, evidence, .. } = &beside.stage;
    let densities = design.held().log_densities((&design.model, &evidence.scales));
    for score in &mut *path {
        let member = members.iter().find(|member| member.name == score.name);
        let again = member.zip(densities.as_ref()).and_then(|(own, all)| score_of(&beside.stage, own, score, all));
        match again.filter(|again| is_sound(again, beside)) {
            Some(again) => *score = again,
            None => members.retain(|member| member.name != score.name),
        }
    }
    path.retain(|score| members.iter().any(|member| member.name == score.name));
    members.len() < before
}

/// The score of an effect of the model relative to the same model without the effect. `None` if the model without the
/// effect cannot be evaluated, or if the effect does not improve the prediction of held-out rests and moves.
/// `densities` are the log predictive densities of all rests and moves in the model with the effect.
fn score_of(stage: &Stage, member: &Member, score: &Score, densities: &[Option<f64>]) -> Option<Score> {
    let place = stage.place(&member.name)?;
    let linear = Effect::<f64>::find(&member.name).map_or(place.len(), |effect| effect.plain.min(place.len()));
    let design = &*stage.design;
    let mut without: Vec<Column> = design.model.clone();
    for (k, column) in without[place].iter_mut().enumerate() {
        let seen: f64 = design.gram.sums.iter().map(|sum| sum[(column.place, column.place)]).sum();
        column.precision = REMOVED * seen.max(column.precision);
        // The time constant of a removed effect has no influence on the residuals. `value` is the distance from the
        // mean of the prior. With `value` = 0, the prior is centred at the present time constant, which therefore does
        // not change.
        column.value = if k < linear { column.value } else { 0.0 };
    }
    let alone = design.gram.evidence_near(&without, &stage.evidence.scales)?;
    let gain = Gain::of(&design.held().log_densities((&without, &alone.scales))?, densities);
    let statistic = (alone.deviance - stage.evidence.deviance).max(0.0);
    let again = Score {
        log_bayes_factor: stage.evidence.log - alone.log,
        statistic,
        p_value: p_value(statistic, score.dof),
        ..score.clone()
    };
    gain.is_sure().then_some(again)
}

fn rivals(scores: &[Judged], pick: &Judged) -> Vec<String> {
    let least = pick.score.log_bayes_factor - RIVAL_NATS;
    let is_rival = |own: &&Judged| own.score.name != pick.score.name && own.score.log_bayes_factor > least;
    scores.iter().filter(is_rival).map(|own| own.score.name.clone()).collect()
}
